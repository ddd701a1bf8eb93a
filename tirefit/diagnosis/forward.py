"""Forces of every row under the base model with effects, and their refits."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from tirefit.diagnosis.state import (
    FALLS,
    Covariates,
    force_of_state,
    null_state,
    peak_ratio,
)
from tirefit.models import Brush, Parabolic, TireInputs
from tirefit.params import with_values

__all__ = [
    "Design",
    "Refit",
    "brush_of_base",
    "forces_of",
    "moments",
    "refit_all",
    "residuals",
    "tangents",
]


class Design(NamedTuple):
    """Everything a refit needs, as arrays, padded to few shapes.

    ``slip`` and ``weight`` are the nodes of the latent slip and their probabilities,
    (n, q); ``observed`` and ``scale`` (n,) by channel; ``keep`` (n,) is 0 for padding
    and outliers. ``prior_scale`` and ``prior_center`` (K,) belong to the amplitudes,
    in their own units and in prior scales; ``reference`` is load, speed.
    """

    inputs: TireInputs
    slip: Array
    weight: Array
    second: Array
    observed: dict[str, Array]
    scale: dict[str, Array]
    keep: Array
    rows: Covariates
    prior_scale: Array
    prior_center: Array
    reference: Array


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
        return jax.jvp(lambda s: force(s, sample), (1e-6,), (1.0,))[1]

    stiffness = jax.vmap(slope)(design.inputs) / 2
    arm = getattr(tire, "half_length", 0.1)
    return stiffness, peak_ratio(tire, fz, v), arm


def _state_of(atoms, amplitudes, rows: Covariates):
    state = null_state()
    for k, atom in enumerate(atoms):
        state = atom.change(state, amplitudes[k], rows)
    count = rows.fz.shape[0]

    def per_row(value):
        value = jnp.asarray(value)
        # The falls of friction are one vector for all rows.
        wide = value.shape == (len(FALLS),) and count != len(FALLS)
        return jnp.broadcast_to(value, (count, *(value.shape if wide else ())))

    return type(state)(*(per_row(value) for value in state))


def forces_of(model, layout, atoms, mode: str, z, amplitudes, design: Design):
    """Mean and variance over the latent slip of every force: dicts of (n,).

    Args:
        model, layout, z: the base model and its free parameters.
        atoms: the effects, static; ``amplitudes`` (K,) in their own units.
        mode: which slip drives: x, y or xy.
    """
    state = _state_of(atoms, amplitudes, design.rows)
    return _forces_at(model, layout, mode, z, state, design)


def _forces_at(model, layout, mode: str, z, state, design: Design):
    tire = with_values(model, layout.natural(z))
    plain = _is_plain(model)
    reference = None if plain else _reference(tire, design, mode)

    def row(state, stiffness, slips, second, inputs):
        own = None if plain else (stiffness, *reference[1:])

        def at(slip):
            moved = slip + state.shift
            moved = moved / jnp.maximum(1 - state.curvature * moved, 0.05)
            pair = (state.other, moved) if mode == "y" else (moved, state.other)
            if mode == "xy":
                pair = (moved, second * (1 + moved))
            fx, fy, mz = force_of_state(tire, own, state, *pair, inputs)
            extra = (0.0, state.force) if mode == "y" else (state.force, 0.0)
            return jnp.stack([fx + extra[0], fy + extra[1], mz + state.moment])

        return jax.vmap(at)(slips)

    stiffness = jnp.zeros_like(design.second) if plain else reference[0]
    found = jax.vmap(row)(state, stiffness, design.slip, design.second, design.inputs)
    mean = jnp.einsum("nqc,nq->nc", found, design.weight)
    spread = jnp.einsum("nqc,nq->nc", (found - mean[:, None]) ** 2, design.weight)
    order = ("fx", "fy", "mz")
    return (
        {c: mean[:, order.index(c)] for c in design.observed},
        {c: spread[:, order.index(c)] for c in design.observed},
    )


def _whitened(mean, design: Design):
    return jnp.concatenate(
        [
            design.keep * (design.observed[c] - mean[c]) / design.scale[c]
            for c in design.observed
        ]
    )


def residuals(model, layout, atoms, mode, z, amplitudes, design: Design):
    """Whitened residuals of all channels, one after the other: (channels x n,)."""
    mean, _ = forces_of(model, layout, atoms, mode, z, amplitudes, design)
    return _whitened(mean, design)


_STATIC = ("layout", "atoms", "mode")


@partial(jax.jit, static_argnames=_STATIC)
def moments(model, layout, atoms, mode, z, amplitudes, design: Design):
    """Compiled :func:`forces_of`."""
    return forces_of(model, layout, atoms, mode, z, amplitudes, design)


@partial(jax.jit, static_argnames=(*_STATIC, "finite"))
def tangents(model, layout, atoms, mode, z, amplitudes, design: Design, finite):
    """Residual r (m,), J = d force / dz (m, p), T = d force / d amplitude in units of
    prior scales (m, K), all whitened.

    Args:
        finite: atoms whose column is a finite difference over one prior scale (or
            to the expected amplitude): their tangent vanishes or misleads.
    """
    state = _state_of(atoms, amplitudes, design.rows)

    def at(z, state):
        mean, _ = _forces_at(model, layout, mode, z, state, design)
        return -_whitened(mean, design)

    value = at(z, state)
    jacobian = jax.lax.map(
        lambda e: jax.jvp(lambda x: at(x, state), (z,), (e,))[1], jnp.eye(z.size)
    )
    effects = _through_state(at, z, state, atoms, amplitudes, design)
    sign = jnp.where(design.prior_center < 0, -1.0, 1.0)
    size = sign * jnp.maximum(jnp.abs(design.prior_center), 1.0)

    def secant(k):
        move = jnp.zeros(amplitudes.size).at[k].set(size[k] * design.prior_scale[k])
        moved = _state_of(atoms, amplitudes + move, design.rows)
        return (at(z, moved) - value) / size[k]

    if finite:
        index = jnp.array(finite)
        effects = effects.at[index].set(jax.lax.map(secant, index))
    return -value, jacobian.T, effects.T


def _through_state(at, z, state, atoms, amplitudes, design: Design):
    """Tangents of the atoms by the chain rule over the fields of the state: (K, m).

    A row's force depends on its own state alone, so one tangent per field serves all
    atoms; what an atom does to the fields costs next to nothing.
    """
    leaves, structure = jax.tree.flatten(state)
    flat = jnp.concatenate([x.reshape(x.shape[0], -1) for x in leaves], axis=1)
    sizes = [1 if x.ndim == 1 else x.shape[1] for x in leaves]

    def from_flat(flat):
        parts = jnp.split(flat, np.cumsum(sizes)[:-1].tolist(), axis=1)
        shaped = [p.reshape(x.shape) for p, x in zip(parts, leaves, strict=True)]
        return jax.tree.unflatten(structure, shaped)

    def by_field(direction):
        move = jnp.broadcast_to(direction, flat.shape)
        return jax.jvp(lambda f: at(z, from_flat(f)), (flat,), (move,))[1]

    fields = jax.lax.map(by_field, jnp.eye(flat.shape[1]))

    def of_atom(direction):
        def amounts(a):
            parts = jax.tree.leaves(_state_of(atoms, a, design.rows))
            return jnp.concatenate([x.reshape(x.shape[0], -1) for x in parts], axis=1)

        return jax.jvp(amounts, (amplitudes,), (direction,))[1]

    changes = jax.lax.map(of_atom, jnp.diag(design.prior_scale))
    by_channel = fields.reshape(flat.shape[1], -1, flat.shape[0])
    found = jnp.einsum("fcn,knf->kcn", by_channel, changes)
    return found.reshape(amplitudes.size, -1)


@partial(jax.jit, static_argnames=("layout", "mode"))
def brush_of_base(model, layout, mode, z, design: Design):
    """(c_p a^2 (n,), mu) of the brush with the base model's slope and peak."""
    stiffness, mu, _ = _reference(with_values(model, layout.natural(z)), design, mode)
    return stiffness, mu


class Refit(NamedTuple):
    """One hypothesis refitted: parameters, sum of squares, log determinant of the
    curvature, covariance of (z, amplitudes in prior scales)."""

    z: Array
    amplitude: Array
    chi2: Array
    log_det: Array
    covariance: Array
    penalty: Array


MOST = 64
"""Hypotheses of one call of :func:`refit_all`."""


def fill(starts, sets, atoms: int, size: int, sign=None):
    """Starts (z, amplitudes) and sets of atoms as the arrays of :func:`refit_all`.

    Sets smaller than ``size`` are filled with an effect that does nothing, and the
    number of hypotheses, at most :data:`MOST`, up to one shape: one program.
    """
    sign = np.zeros(atoms) if sign is None else sign
    rows = [
        np.concatenate([z, amplitude, np.zeros(size - len(amplitude))])
        for z, amplitude in starts
    ]
    index = [(*chosen, *[atoms] * (size - len(chosen))) for chosen in sets]
    signs = [[*sign[list(chosen)], *[0.0] * (size - len(chosen))] for chosen in sets]
    repeat = np.arange(MOST) % len(rows)
    return (
        np.array(rows)[repeat], np.array(index, int)[repeat], np.array(signs)[repeat],
        len(rows),
    )  # fmt: skip


@partial(jax.jit, static_argnames=(*_STATIC, "size"))
def refit_all(
    model, layout, atoms, mode, starts, index, signs, count, design, size: int
):
    """Refit hypotheses of ``size`` effects each, by damped Gauss-Newton.

    Args:
        starts: (h, p + size): z and amplitudes in prior scales.
        index: (h, size) of the atoms; K stands for none.
        signs: (h, size): +1, -1 where only that sign is allowed, else 0.
        count: how many of the h hypotheses are wanted; the rest is skipped.
    """
    atoms_count = design.prior_scale.size
    p = starts.shape[1] - size
    scale = jnp.append(design.prior_scale, 0.0)
    centers = jnp.append(design.prior_center, 0.0)

    def one(start, index, signs):
        center = centers[index]

        def whole(x):
            amplitudes = jnp.zeros(atoms_count + 1).at[index].add(x[p:] * scale[index])
            amplitudes = amplitudes[:atoms_count]
            misfit = residuals(model, layout, atoms, mode, x[:p], amplitudes, design)
            return jnp.concatenate([misfit, x[p:] - center])

        def allowed(x):
            a = x[p:]
            a = jnp.where(signs > 0, jnp.maximum(a, 0), a)
            a = jnp.where(signs < 0, jnp.minimum(a, 0), a)
            return jnp.concatenate([x[:p], jnp.clip(a, -20.0, 20.0)])

        return _gauss_newton(whole, allowed, start, p, size)

    def body(number, found):
        here = one(starts[number], index[number], signs[number])
        return jax.tree.map(lambda all, x: all.at[number].set(x), found, here)

    shapes = jax.eval_shape(one, starts[0], index[0], signs[0])
    blank = jax.tree.map(
        lambda x: jnp.full((starts.shape[0], *x.shape), jnp.nan), shapes
    )
    return jax.lax.fori_loop(0, count, body, blank)


def _linear(whole, x):
    value = whole(x)
    jacobian = jax.lax.map(lambda e: jax.jvp(whole, (x,), (e,))[1], jnp.eye(x.size))
    return value, jacobian @ jacobian.T, jacobian @ value


def _gauss_newton(whole, allowed, start, p: int, size: int, steps=25) -> Refit:
    def body(carry):
        x, cost, normal, gradient, damping, count, _ = carry
        damped = normal + damping * jnp.diag(jnp.diagonal(normal) + 1e-9)
        move = -jnp.linalg.solve(damped, gradient)
        move = move * jnp.minimum(1.0, 3.0 / jnp.maximum(jnp.max(jnp.abs(move)), 1e-9))
        new = allowed(x + move)
        value, new_normal, new_gradient = _linear(whole, new)
        new_cost = value @ value
        better = new_cost < cost
        gain = jnp.where(better, cost - new_cost, jnp.inf)
        done = (gain < 1e-3) | (damping > 1e6)
        keep = partial(jnp.where, better)
        return (
            keep(new, x), keep(new_cost, cost), keep(new_normal, normal),
            keep(new_gradient, gradient),
            jnp.clip(keep(damping / 10, damping * 10), 1e-9, 1e9), count + 1, done,
        )  # fmt: skip

    value, normal, gradient = _linear(whole, start)
    first = (
        start, value @ value, normal, gradient, jnp.array(1e-4), jnp.array(0),
        jnp.array(False),
    )  # fmt: skip
    x, cost, normal, *_ = jax.lax.while_loop(
        lambda c: ~c[-1] & (c[-2] < steps), body, first
    )
    last = whole(x)
    penalty = jnp.sum(last[last.size - size :] ** 2) if size else jnp.zeros(())
    identity = jnp.eye(x.size)
    return Refit(
        x[:p], x[p:], cost - penalty, jnp.linalg.slogdet(normal)[1],
        jnp.linalg.solve(normal + 1e-9 * identity, identity), penalty,
    )  # fmt: skip
