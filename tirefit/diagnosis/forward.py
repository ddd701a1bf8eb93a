"""Forces of every row under the base model with effects, and their refits."""

from collections.abc import Mapping
from functools import lru_cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from tirefit.diagnosis.negligible import FLAT
from tirefit.diagnosis.state import (
    Covariates,
    State,
    force_of_state,
    null_state,
    peak_ratio,
)
from tirefit.fitting.least_squares import damped_gauss_newton
from tirefit.models import Brush, Parabolic, TireInputs
from tirefit.params import Values, with_values

__all__ = [
    "Design",
    "Linear",
    "Present",
    "Refit",
    "Wanted",
    "brush_of_base",
    "count_atoms",
    "forces_of",
    "moments",
    "present_in",
    "refit_all",
    "residuals",
    "tangents",
]


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

_LIBRARIES = 64
"""Libraries of effects whose arrays are kept, at most."""


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


class Present(NamedTuple):
    """The effects of one hypothesis: ``atom`` (h,) their numbers, K for none, and
    ``amplitude`` (h,) in their own units."""

    atom: Values
    amplitude: Values


def _per_row(state, count: int):
    """Every field of the state as (n,)."""
    return type(state)(
        *(jnp.broadcast_to(jnp.asarray(value, float), (count,)) for value in state)
    )


@lru_cache(maxsize=_LIBRARIES)
def _atoms(effects) -> tuple[np.ndarray, np.ndarray]:
    """Which effect each atom is of (K + 1,), and its constants (K + 1, c), padded; the
    last atom is of none."""
    owner = [k for k, effect in enumerate(effects) for _ in effect.variants]
    rows = [constants for effect in effects for constants in effect.variants]
    table = np.zeros((len(rows) + 1, max(map(len, rows), default=0)))
    for row, constants in zip(table, rows, strict=False):
        row[: len(constants)] = constants
    return np.array([*owner, len(effects)]), table


def count_atoms(effects) -> int:
    """Variants of all effects."""
    return sum(len(effect.variants) for effect in effects)


def _apply(effects, k, state, amplitude, rows: Covariates):
    """The state with atom k added; K adds none. Only its effect is computed."""
    count = rows.fz.shape[0]
    owner, table = _atoms(effects)

    def branch(effect):
        width = len(effect.variants[0])

        def change(state, a, constants, rows):
            return _per_row(effect.change(state, a, constants[:width], rows), count)

        return change

    branches = [branch(effect) for effect in effects]
    branches.append(lambda state, a, constants, rows: state)
    constants = jnp.asarray(table)[k]
    return jax.lax.switch(
        jnp.asarray(owner)[k], branches, state, amplitude, constants, rows
    )


def _state_of(effects, present: Present, rows: Covariates):
    def add(state, one):
        atom, amplitude = one
        return _apply(effects, atom, state, amplitude, rows), None

    start = _per_row(null_state(), rows.fz.shape[0])
    return jax.lax.scan(add, start, (present.atom, present.amplitude))[0]


def forces_of(model, layout, effects, mode: str, z, present: Present, design: Design):
    """Mean and variance over the latent slip of every force: dicts of (n,).

    Args:
        model, layout, z: the base model and its free parameters.
        effects: all of them, static; ``present`` says which are there.
        mode: which slip drives: x, y or xy.
    """
    state = _state_of(effects, present, design.rows)
    return _forces_at(model, layout, mode, z, state, design)


def _forces_at(model, layout, mode: str, z, state, design: Design):
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


def residuals(model, layout, effects, mode, z, present: Present, design: Design):
    """Whitened residuals of all channels, one after the other: (channels x n,)."""
    mean, _ = forces_of(model, layout, effects, mode, z, present, design)
    return _whitened(mean, design)


_STATIC = ("layout", "effects", "mode")


@partial(jax.jit, static_argnames=_STATIC)
def moments(model, layout, effects, mode, z, present: Present, design: Design):
    """Compiled :func:`forces_of`."""
    return forces_of(model, layout, effects, mode, z, present, design)


class Linear(NamedTuple):
    """A fit linearised, whitened; see :func:`tangents`."""

    residual: Values
    jacobian: Values
    columns: Values
    fields: Values


class Wanted(NamedTuple):
    """Which columns :func:`tangents` works out: the first ``size`` of ``atom`` (K,).
    ``far`` (K,) is 1 where a column is a finite difference over one prior scale (or to
    the expected amplitude): its tangent vanishes or misleads."""

    atom: Values
    size: Values
    far: Values


@partial(jax.jit, static_argnames=_STATIC)
def tangents(
    model, layout, effects, mode, z, present, design: Design, wanted: Wanted
) -> Linear:
    """Residual r (m,), J = d force / dz (m, p), T = d force / d amplitude in units of
    prior scales (m, K), and d force / d field of the state (m, F), all whitened; T is
    NaN of atoms that are not wanted."""
    sign = jnp.where(design.prior_center < 0, -1.0, 1.0)
    size = sign * jnp.maximum(jnp.abs(design.prior_center), 1.0)
    states = _states_without(effects, present, design.rows)

    def at(z, flat):
        mean, _ = _forces_at(model, layout, mode, z, State(*flat), design)
        return -_whitened(mean, design)

    # A row's force depends on its own state alone, so one tangent per field serves all
    # atoms; what an atom does to the fields costs next to nothing.
    flat = jnp.stack([field[-1] for field in states])
    directions = jnp.eye(z.size + len(flat))
    moved = jax.lax.map(
        lambda e: jax.jvp(
            at, (z, flat),
            (e[: z.size], jnp.broadcast_to(e[z.size :, None], flat.shape)),
        )[1],
        directions,
    )  # fmt: skip
    value, fields = at(z, flat), moved[z.size :]
    by_row = fields.reshape(len(flat), -1, flat.shape[1])

    # A secant asks for its far end, a tangent for the slope here; all in one loop, as
    # the changes of all effects are most of what is compiled.
    def column(k):
        mine = present.atom == k
        gone = jnp.where(jnp.any(mine), jnp.argmax(mine), mine.size)
        others = jax.tree.map(lambda field: field[gone], states)
        own = jnp.sum(jnp.where(mine, present.amplitude, 0.0))

        def flat_at(change):
            return jnp.stack(_apply(effects, k, others, own + change, design.rows))

        far, scale = wanted.far[k], design.prior_scale[k]
        end, change = jax.jvp(flat_at, (far * size[k] * scale,), (scale,))
        return jax.lax.cond(
            far > 0,
            lambda: (at(z, end) - value) / size[k],
            lambda: jnp.sum(by_row * change[:, None], axis=0).ravel(),
        )

    def body(number, columns):
        k = wanted.atom[number]
        return columns.at[k].set(column(k))

    blank = jnp.full((count_atoms(effects), value.size), jnp.nan)
    columns = jax.lax.fori_loop(0, wanted.size, body, blank)
    return Linear(-value, moved[: z.size].T, columns.T, fields.T)


def _states_without(effects, present: Present, rows: Covariates) -> State:
    """Fields (h + 1, n): the state without each of the h atoms, and with all."""
    numbers = jnp.arange(present.atom.size)

    def without(gone):
        atom = jnp.where(numbers == gone, count_atoms(effects), present.atom)
        return _state_of(effects, present._replace(atom=atom), rows)

    return jax.lax.map(without, jnp.arange(numbers.size + 1))


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


MOST_EFFECTS = 3
"""Effects of one hypothesis, at most."""


def present_in(amplitudes) -> Present:
    """The atoms that amplitudes of all (K,) have, at most :data:`MOST_EFFECTS`."""
    chosen = np.flatnonzero(amplitudes)
    index, values = np.full(MOST_EFFECTS, len(amplitudes)), np.zeros(MOST_EFFECTS)
    index[: len(chosen)], values[: len(chosen)] = chosen, np.asarray(amplitudes)[chosen]
    return Present(index, values)


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

    Sets smaller than :data:`MOST_EFFECTS` are filled with an effect that does nothing,
    and the number of hypotheses, at most :data:`MOST`, up to one shape: one program.
    """
    size = MOST_EFFECTS
    rows = [
        np.concatenate([z, amplitude, np.zeros(size - len(amplitude))])
        for z, amplitude in starts
    ]
    index = [(*chosen, *[atoms] * (size - len(chosen))) for chosen in sets]
    repeat = np.arange(MOST) % len(rows)
    return np.array(rows)[repeat], np.array(index, int)[repeat], len(rows)


@partial(jax.jit, static_argnames=_STATIC)
def refit_all(model, layout, effects, mode, starts, index, count, design):
    """Refit hypotheses, by damped Gauss-Newton.

    Args:
        starts: (h, p + size): z and amplitudes in prior scales.
        index: (h, size) of the atoms; K stands for none.
        count: how many of the h hypotheses are wanted; the rest is skipped.
    """
    size = index.shape[1]
    p = starts.shape[1] - size
    scale = jnp.append(design.prior_scale, 0.0)
    centers = jnp.append(design.prior_center, 0.0)
    lowest = jnp.maximum(jnp.append(design.low, -_FARTHEST), -_FARTHEST)
    highest = jnp.minimum(jnp.append(design.high, _FARTHEST), _FARTHEST)

    def one(start, index):
        low, high = lowest[index], highest[index]

        def pull(amplitude):
            return amplitude - centers[index]

        def whole(x):
            present = Present(index, x[p:] * scale[index])
            misfit = residuals(model, layout, effects, mode, x[:p], present, design)
            held = design.hold * (x[:p] - start[:p])
            return jnp.concatenate([misfit, pull(x[p:]), held])

        def allowed(x):
            return jnp.concatenate([x[:p], jnp.clip(x[p:], low, high)])

        return _refit(whole, pull, allowed, allowed(start), p)

    def body(number, refits):
        here = one(starts[number], index[number])
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
