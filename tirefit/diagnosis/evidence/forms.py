"""Other forms of a listed effect: the same parameter varies with the same quantity, in
a shape that no formula has."""

from itertools import product

import numpy as np

from tirefit.diagnosis.effects.state import State
from tirefit.diagnosis.negligible import FLAT
from tirefit.diagnosis.rows.basis import FULL_SLIDING, bumps, without
from tirefit.diagnosis.rows.prepared import coincides

PLACE = {name: k for k, name in enumerate(State._fields)}
"""Column of each field of the state in :class:`evidence.forward.Linear`."""


_WIDTHS = (0.004, 0.02, 0.05, 0.1)
"""Widths of a change that are tried, as shares of the record: sudden to gradual."""

_TIMES = np.linspace(-0.46, 0.46, 93)
"""Its times, as shares of the record about its middle: a hundredth apart."""

_LENGTHS = (0.08, 0.12, 0.17, 0.24, 0.34, 0.48)
"""Lengths of a change that ends, in the same unit."""


_OF_SLIP, _OWN = 12, 0.1
"""Functions of the slip that a covariate may follow, and the share of its variance that
is its own where it does."""


def form_columns(effects, fields, prepared, slip_fraction) -> np.ndarray:
    """Columns of the free forms of these effects, in units of their priors: (m, k).

    Args:
        effects: records of a hypothesis.
        fields: (m, F) of :class:`tirefit.diagnosis.evidence.forward.Linear`.
        slip_fraction: signed slip over that of full sliding, (n,).
    """
    rows, channels = prepared.covariates, len(prepared.channels)
    blocks = [np.zeros((len(fields), 0))]
    # Effects of one family share their forms, which count once.
    for form in dict.fromkeys(f for effect in effects for f in effect.forms):
        if form.needs and form.needs not in prepared.has:
            continue
        if form.by and follows(getattr(rows, form.by), slip_fraction):
            continue
        shapes = form.size * form.shapes(rows, slip_fraction)
        blocks.append(
            fields[:, PLACE[form.field], None] * np.tile(shapes, (channels, 1))
        )
    return np.concatenate(blocks, axis=1)


def follows(values, slip_fraction) -> bool:
    """Whether a covariate (n,) is a function of the slip, as a load that moves with the
    braking is: of its variance hardly a tenth is its own."""
    inside = np.clip(slip_fraction, -FULL_SLIDING, FULL_SLIDING)
    shapes = bumps(inside, _OF_SLIP)
    own = without(
        values - values.mean(), np.column_stack([np.ones(len(values)), shapes])
    )
    return bool(0 < np.sum(own**2) <= _OWN * len(values) * np.var(values))


def shape_of_change(time, friction, used_up, residual, blocks) -> np.ndarray:
    """Step or stretch of the friction at the time and of the width that explain most:
    (n,).

    Args:
        time: (n,) from -1/2 to 1/2.
        friction: (m,) d force / d friction, whitened.
        used_up: (m, p) columns of the rest of the hypothesis.
        residual: (m,) of it, the step left out.
        blocks: (k, 2) stretches that a setting has as well, see
            :func:`rows.prepared.blocks_of_settings`: none of them is tried.
    """
    repeats = len(friction) // len(time)
    residual = without(residual, used_up)
    best, best_gain = np.zeros(len(time)), 0.0
    for width, length in product(_WIDTHS, (None, *_LENGTHS)):
        if length is not None and length < 2 * width:
            continue
        begin = _TIMES[~coincides(_TIMES, _TIMES + (length or np.inf), blocks)]
        shapes = 0.5 * np.tanh((time[:, None] - begin) / width)
        if length is not None:
            shapes -= 0.5 * np.tanh((time[:, None] - begin - length) / width) + 0.5
        columns = friction[:, None] * np.tile(shapes, (repeats, 1))
        columns = without(columns, used_up)
        size = np.sum(columns**2, axis=0)
        gain = (columns.T @ residual) ** 2 / np.maximum(size, FLAT)
        if gain.max() > best_gain:
            best, best_gain = shapes[:, int(np.argmax(gain))], gain.max()
    return best
