"""Other forms of a listed effect: the same parameter varies with the same quantity, in
a shape that no formula has."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from tirefit.data.levels import levels
from tirefit.diagnosis.basis import bumps, without
from tirefit.diagnosis.state import State

__all__ = ["PLACE", "form_columns", "functions_of", "shape_of_change"]


PLACE = {name: k for k, name in enumerate(State._fields)}
"""Column of each field of the state in :class:`tirefit.diagnosis.forward.Linear`."""

_LEVELS = 4


def functions_of(values, count: int) -> np.ndarray:
    """Smooth functions of a covariate, or one for each of its few levels: (n, k)."""
    settings = levels(values)
    if settings.few(_LEVELS):
        return np.eye(len(settings.center))[settings.code]
    return bumps(values, count)


class _Form(NamedTuple):
    """``field`` of the state that moves by ``size`` times smooth functions of what
    ``shapes(rows, u)`` gives, (n, k); u is slip over that of full sliding, (n,).
    ``needs`` is what the data must hold: at one speed any function of the sliding speed
    is one of the slip, and would explain whatever there is."""

    field: str
    size: float
    shapes: Callable
    needs: str = ""


def _of(name: str, count: int):
    return lambda rows, u: functions_of(getattr(rows, name), count)


def _by_slip(sign: str, count: int = 4):
    """Functions of the size of the slip, times a sign of the rows."""
    return lambda rows, u: (
        functions_of(np.minimum(np.abs(u), 3), count) * (getattr(rows, sign)[:, None])
    )


def _of_shape(rows, u):
    """Force over load as any odd function of the slip fraction."""
    return _by_slip("side", 9)(rows, u) * (rows.fz * rows.load)[:, None]


def _of_sliding(rows, u):
    return functions_of(np.sqrt(rows.sliding), 8)


def _moving(name: str):
    """Rate of change of the slip as a covariate has it, freely over the slip."""
    return lambda rows, u: (
        functions_of(np.minimum(np.abs(u), 3), 4) * (getattr(rows, name)[:, None])
    )


def _of_rate(rows, u):
    """Functions of how fast the slip grows or shrinks in size."""
    rate = rows.rate * rows.side
    return functions_of(np.clip(rate / max(np.mean(np.abs(rate)), 1e-12), -3, 3), 6)


_SHAPE = (_Form("force", 0.01, _of_shape),)
FORMS: dict[str, tuple[_Form, ...]] = {  # fmt: skip
    "pressure": _SHAPE,
    "friction": _SHAPE,
    "structure": _SHAPE,
    "friction x speed": (
        _Form("friction", 0.06, _of_sliding, "speeds"),
        _Form("kinetic", 0.06, _of_sliding, "speeds"),
    ),
    "transient": (_Form("shift", 0.1, _moving("lag")),),
    "friction x load": (_Form("friction", 0.03, _of("fz", 4)),),
    "stiffness x load": (_Form("stiffness", 0.06, _of("fz", 4)),),
    "friction x temperature": (_Form("friction", 0.03, _of("temperature", 5)),),
    "stiffness x temperature": (_Form("stiffness", 0.06, _of("temperature", 5)),),
    "friction x time": (_Form("friction", 0.02, _of("time", 4)),),
    "stiffness x time": (_Form("stiffness", 0.04, _of("time", 4)),),
    "friction x direction": (
        _Form("friction", 0.02, _by_slip("turning")),
        _Form("friction", 0.02, _of_rate),
    ),
    "friction x sign": (_Form("friction", 0.02, _by_slip("side")),),
    "inputs": (_Form("friction", 0.03, _of("other", 5)),),
    "lateral inputs": (_Form("shift", 0.002, _of("gamma", 5)),),
}


def form_columns(families, fields, prepared, slip_fraction) -> np.ndarray:
    """Columns of the other forms of these families, in units of their priors: (m, k).

    Args:
        families: of the effects of a hypothesis.
        fields: (m, F) of :class:`tirefit.diagnosis.forward.Linear`.
        slip_fraction: signed slip over that of full sliding, (n,).
    """
    rows, channels = prepared.covariates, len(prepared.channels)
    found = [np.zeros((len(fields), 0))]
    forms = dict.fromkeys(f for name in families for f in FORMS.get(name, ()))
    for form in forms:
        if form.needs and form.needs not in prepared.has:
            continue
        shapes = form.size * form.shapes(rows, slip_fraction)
        found.append(
            fields[:, PLACE[form.field], None] * np.tile(shapes, (channels, 1))
        )
    return np.concatenate(found, axis=1)


def shape_of_change(time, friction, used_up, residual) -> np.ndarray:
    """Step of the friction at the time and of the width that explain most: (n,).

    Args:
        time: (n,) from -1/2 to 1/2.
        friction: (m,) d force / d friction, whitened.
        used_up: (m, p) columns of the rest of the hypothesis.
        residual: (m,) of it, the step left out.
    """
    repeats = len(friction) // len(time)
    residual = without(residual, used_up)
    best, best_gain = np.zeros(len(time)), 0.0
    for width in (0.004, 0.02, 0.05, 0.1):
        at = np.linspace(-0.46, 0.46, 93)
        shapes = 0.5 * np.tanh((time[:, None] - at) / width)
        columns = friction[:, None] * np.tile(shapes, (repeats, 1))
        columns = without(columns, used_up)
        size = np.sum(columns**2, axis=0)
        gain = (columns.T @ residual) ** 2 / np.maximum(size, 1e-9)
        if gain.max() > best_gain:
            best, best_gain = shapes[:, int(np.argmax(gain))], gain.max()
    return best
