"""Forces of every row under the base model with effects, and their refits."""

from collections.abc import Mapping
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from tirefit.diagnosis.effects.state import (
    Covariates,
    State,
    force_of_state,
    peak_ratio,
)
from tirefit.diagnosis.evidence.changes import MOST_EFFECTS, Changes, Present, state_of
from tirefit.diagnosis.negligible import FLAT
from tirefit.fitting.least_squares import damped_gauss_newton
from tirefit.models import Brush, Parabolic, TireInputs
from tirefit.params import Values, with_values


class Design(NamedTuple):
    """Everything a refit needs, as arrays, padded to few shapes.

    ``slip`` and ``weight`` are the nodes of the latent slip and their probabilities,
    (n, q); ``observed`` and ``scale`` (n,) by channel; ``offset`` (n,) by channel is
    what a simulator says beyond the tire that stands in for it, zero for a form that
    was fitted; ``keep`` (n,) is 0 for padding and outliers. ``hold`` is the stiffness
    that keeps a refit's z where it starts, 0 where it is free. Of the amplitudes (K,),
    ``prior_scale`` is in their own units, ``prior_center``, ``low`` and ``high`` are in
    prior scales; ``reference`` is load and speed.
    """

    inputs: TireInputs
    slip: Values
    weight: Values
    second: Values
    observed: Mapping[str, Values]
    scale: Mapping[str, Values]
    offset: Mapping[str, Values]
    keep: Values
    hold: Values
    rows: Covariates
    prior_scale: Values
    prior_center: Values
    low: Values
    high: Values
    reference: Values


_AT_ZERO = 1e-6
"""Slip [-] at which stiffness is taken: at zero itself some laws have half a slope."""

_HALF_LENGTH = 0.1
"""Half-length of the patch [m] of models that state none, as of a car's tire: it scales
what a change of shape does to the aligning moment, and nothing else."""

_LEAST_DIVISOR = 0.05
"""x / (1 - w x) has a pole at slips of 1 / w; it grows no more than twentyfold."""


def _is_plain(model) -> bool:
    return (
        type(model) is Brush
        and type(model.pressure) is Parabolic
        and not model.friction.laws
    )


def _reference(tire, design: Design, mode: str):
    """(c_p a^2 (n,), mu, half-length) of the brush with the base's slope and peak."""
    fz, v = design.reference
    name = "fy" if mode == "y" else "fx"

    def force(slip, sample):
        where = {"alpha": slip} if mode == "y" else {"sigma_x": slip}
        return getattr(tire(sample._replace(**where)), name)

    def slope(sample):
        return jax.jvp(lambda s: force(s, sample), (_AT_ZERO,), (1.0,))[1]

    stiffness = jax.vmap(slope)(design.inputs) / 2
    arm = getattr(tire, "half_length", _HALF_LENGTH)
    return stiffness, peak_ratio(tire, fz, v), arm


def forces_of(model, layout, mode: str, z, state: State, design: Design):
    """Mean and variance over the latent slip of every force: dicts of (n,).

    Args:
        model, layout, z: the base model and its free parameters.
        mode: which slip drives: x, y or xy.
        state: the tire and its measurement, effects applied.
    """
    tire = with_values(model, layout.natural(z))
    plain = _is_plain(model)
    reference = None if plain else _reference(tire, design, mode)

    def row(state, stiffness, slips, second, inputs):
        own = None if reference is None else (stiffness, *reference[1:])

        def at(slip):
            moved = slip + state.shift
            moved = moved / jnp.maximum(1 - state.curvature * moved, _LEAST_DIVISOR)
            pair = (state.other, moved) if mode == "y" else (moved, state.other)
            if mode == "xy":
                pair = (moved, second * (1 + moved))
            fx, fy, mz = force_of_state(tire, own, state, *pair, inputs)
            extra = (0.0, state.force) if mode == "y" else (state.force, 0.0)
            forces = {"fx": fx + extra[0], "fy": fy + extra[1], "mz": mz + state.moment}
            return {c: forces[c] for c in design.observed}

        return jax.vmap(at)(slips)

    none = jnp.zeros_like(design.second)
    stiffness = none if reference is None else reference[0]
    at_nodes = jax.vmap(row)(
        state, stiffness, design.slip, design.second, design.inputs
    )
    mean = {c: jnp.sum(f * design.weight, axis=1) for c, f in at_nodes.items()}
    spread = {
        c: jnp.sum((f - mean[c][:, None]) ** 2 * design.weight, axis=1)
        for c, f in at_nodes.items()
    }
    return {c: force + design.offset[c] for c, force in mean.items()}, spread


def _whitened(mean, design: Design):
    return jnp.concatenate(
        [
            design.keep * (design.observed[c] - mean[c]) / design.scale[c]
            for c in design.observed
        ]
    )


@partial(jax.jit, static_argnames=("layout", "mode"))
def moments(model, layout, mode, z, states, design: Design):
    """Compiled :func:`forces_of`, of the last of the states (h + 1, F, n)."""
    return forces_of(model, layout, mode, z, State(*states[-1]), design)


class Linear(NamedTuple):
    """A fit linearised, whitened; see :func:`tangents`."""

    residual: Values
    jacobian: Values
    columns: Values
    fields: Values


@partial(jax.jit, static_argnames=("layout", "mode"))
def tangents(
    model, layout, mode, z, states, changes: Changes, design: Design
) -> Linear:
    """Residual r (m,), J = d force / dz (m, p), T = d force / d amplitude in units of
    prior scales (m, K), and d force / d field of the state (m, F), all whitened.

    Args:
        states: (h + 1, F, n) of which the last is the one to linearise at.
        changes: what each atom does to it.
    """

    def at(z, flat):
        mean, _ = forces_of(model, layout, mode, z, State(*flat), design)
        return -_whitened(mean, design)

    # A row's force depends on its own state alone: one pass back for each channel
    # serves all fields, and fields all atoms: what those do to them costs next to
    # nothing.
    flat = states[-1]
    value, back = jax.vjp(partial(at, z), flat)
    each = jnp.repeat(jnp.eye(len(design.observed)), flat.shape[1], axis=1)
    by_row = jnp.swapaxes(jax.lax.map(lambda one: back(one)[0], each), 0, 1)
    ahead = partial(jax.jvp, lambda z: at(z, flat), (z,))
    jacobian = jax.lax.map(lambda e: ahead((e,))[1], jnp.eye(z.size))
    columns = {
        effect: jnp.sum(
            jnp.stack([by_row[None, f] * by[:, None] for f, by in slopes.items()]), 0
        )
        for effect, slopes in changes.slopes.items()
    }
    if changes.ends:
        ends = jnp.concatenate([*changes.ends.values()])
        secants = jax.lax.map(lambda end: at(z, end) - value, ends)
        secants /= jnp.concatenate([*changes.sizes.values()])[:, None]
        counts = np.cumsum([len(size) for size in changes.sizes.values()])
        columns |= zip(changes.ends, jnp.split(secants, counts[:-1]), strict=True)
    in_order = [columns[k].reshape(-1, value.size) for k in sorted(columns)]
    fields = by_row.reshape(len(flat), -1)
    return Linear(-value, jacobian.T, jnp.concatenate(in_order).T, fields.T)


@partial(jax.jit, static_argnames=("layout", "mode"))
def brush_of_base(model, layout, mode, z, design: Design):
    """(c_p a^2 (n,), mu) of the brush with the base model's slope and peak."""
    stiffness, mu, _ = _reference(with_values(model, layout.natural(z)), design, mode)
    return stiffness, mu


class Refit(NamedTuple):
    """One hypothesis refitted: parameters, sum of squares, log determinant of the
    curvature, covariance of (z, amplitudes in prior scales)."""

    z: Values
    amplitude: Values
    chi2: Values
    log_det: Values
    covariance: Values
    penalty: Values


_REFIT_STEPS = 26
"""Steps of a refit, at most."""
_REFIT_TOLERANCE = 1e-3
"""Chi-squared that one more step of a refit could still gain: evidence is counted in
whole units."""

MOST = 64
"""Hypotheses of one call of :func:`refit_all`."""

_FARTHEST = 20.0
"""Amplitudes, in prior scales, beyond which no refit goes."""


def fill(starts, sets, atoms: int):
    """Starts (z, amplitudes) and sets of atoms as the arrays of :func:`refit_all`.

    Sets smaller than :data:`MOST_EFFECTS` are filled with an effect that does nothing.
    """
    size = MOST_EFFECTS
    rows = [
        np.concatenate([z, amplitude, np.zeros(size - len(amplitude))])
        for z, amplitude in starts
    ]
    index = [(*chosen, *[atoms] * (size - len(chosen))) for chosen in sets]
    return np.array(rows), np.array(index, int)


@partial(jax.jit, static_argnames=("layout", "effects", "mode"))
def refit_all(model, layout, effects, mode, starts, index, keeps, count, design):
    """Refit hypotheses, by damped Gauss-Newton.

    Args:
        starts: (h, p + size): z and amplitudes in prior scales.
        index: (h, size) of the atoms; K stands for none.
        keeps: (h, n) the rows that count for each, in place of those of the design.
        count: how many of the h hypotheses are wanted; the rest is skipped.
    """
    size = index.shape[1]
    p = starts.shape[1] - size
    scale = jnp.append(design.prior_scale, 0.0)
    centers = jnp.append(design.prior_center, 0.0)
    lowest = jnp.maximum(jnp.append(design.low, -_FARTHEST), -_FARTHEST)
    highest = jnp.minimum(jnp.append(design.high, _FARTHEST), _FARTHEST)

    def one(start, index, keep):
        low, high = lowest[index], highest[index]

        def pull(amplitude):
            return amplitude - centers[index]

        def whole(x):
            present = Present(index, x[p:] * scale[index])
            state = state_of(effects, present, design.rows)
            mean, _ = forces_of(model, layout, mode, x[:p], state, design)
            misfit = _whitened(mean, design._replace(keep=keep.astype(float)))
            held = design.hold * (x[:p] - start[:p])
            return jnp.concatenate([misfit, pull(x[p:]), held])

        def allowed(x):
            return jnp.concatenate([x[:p], jnp.clip(x[p:], low, high)])

        return _refit(whole, pull, allowed, allowed(start), p)

    def body(number, refits):
        here = one(starts[number], index[number], keeps[number])
        return jax.tree.map(lambda all, x: all.at[number].set(x), refits, here)

    h, width = starts.shape
    shapes = ((p,), (size,), (), (), (width, width), ())
    blank = Refit(*(jnp.full((h, *shape), jnp.nan) for shape in shapes))
    return jax.lax.fori_loop(0, count, body, blank)


def _refit(whole, pull, allowed, start, p: int) -> Refit:
    """One hypothesis; ``pull`` (size,) of the amplitudes' prior is part of it."""

    def residual(x):
        values = whole(x)
        return values, jnp.ones_like(values)

    end = damped_gauss_newton(
        residual, start, allowed=allowed, max_steps=_REFIT_STEPS,
        relative=0.0, absolute=_REFIT_TOLERANCE,
    )  # fmt: skip
    penalty = jnp.sum(pull(end.z[p:]) ** 2)
    # A parameter at its bound has no curvature; what is left of it cancels.
    identity = jnp.eye(start.size)
    curvature = end.normal + FLAT * identity
    return Refit(
        end.z[:p], end.z[p:], end.cost - penalty, jnp.linalg.slogdet(curvature)[1],
        jnp.linalg.solve(curvature, identity), penalty,
    )  # fmt: skip
