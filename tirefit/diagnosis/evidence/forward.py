"""Forces of every row under the base model in a given state, and their slopes."""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np

from tirefit.diagnosis.effects.state import (
    Covariates,
    State,
    force_of_state,
    peak_ratio,
)
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

    @property
    def forces(self) -> np.ndarray:
        """Observed forces (C, n), in the order of their names: that of programs."""
        return np.stack([self.observed[c] for c in sorted(self.observed)])

    def weights(self, keep=None) -> np.ndarray:
        """What whitens each row (C, n), of other rows that count if given."""
        scales = np.stack([self.scale[c] for c in sorted(self.observed)])
        return np.asarray(self.keep if keep is None else keep, float) / scales


_AT_ZERO = 1e-6
"""Slip [-] at which stiffness is taken: at zero itself some laws have half a slope."""

_HALF_LENGTH = 0.1
"""Half-length of the patch [m] of models that state none, as of a car's tire: it scales
what a change of shape does to the aligning moment, and nothing else."""

MOST = 64
"""Hypotheses that are compared at once, at most."""

_LEAST_DIVISOR = 0.05
"""x / (1 - w x) has a pole at slips of 1 / w; it grows no more than twentyfold."""


def _is_plain(model) -> bool:
    return (
        type(model) is Brush
        and type(model.pressure) is Parabolic
        and not model.friction.laws
    )


def _reference(tire, where: "Where", mode: str):
    """(c_p a^2 (n,), mu, half-length) of the brush with the base's slope and peak."""
    fz, v = where.reference
    name = "fy" if mode == "y" else "fx"

    def force(slip, sample):
        where = {"alpha": slip} if mode == "y" else {"sigma_x": slip}
        return getattr(tire(sample._replace(**where)), name)

    def slope(sample):
        return jax.jvp(lambda s: force(s, sample), (_AT_ZERO,), (1.0,))[1]

    stiffness = jax.vmap(slope)(where.inputs) / 2
    arm = getattr(tire, "half_length", _HALF_LENGTH)
    return stiffness, peak_ratio(tire, fz, v), arm


class Linear(NamedTuple):
    """A fit linearised, whitened: residual r (m,), J = d force / dz (m, p), T = d force
    / d amplitude in units of prior scales (m, K), and d force / d field of the state
    (m, F)."""

    residual: np.ndarray
    jacobian: np.ndarray
    columns: np.ndarray
    fields: np.ndarray


@runtime_checkable
class ForwardModel(Protocol):
    """What predicts the forces of rows from parameters z and amplitudes of atoms: all
    that the search, refits and leaving out need of a tire, or of a vehicle."""

    def forces(self, fits, design: Design) -> Iterator:
        """Mean forces (C, n) of each of some (z, amplitudes of all atoms), and their
        variances over the slip."""

    def linearised(self, z, amplitudes, design: Design, n: int) -> Linear:
        """The first n rows linearised in everything."""

    def slopes(self, points, sets, design: Design) -> Iterator:
        """Of each hypothesis the mean forces (C, n), and their slopes by z and by the
        amplitudes in prior scales of its atoms (p + k, C, n)."""


class Where(NamedTuple):
    """The part of a :class:`Design` that forces depend on."""

    inputs: TireInputs
    slip: Values
    weight: Values
    second: Values
    offset: Mapping[str, Values]
    reference: Values

    @classmethod
    def of(cls, design: Design) -> "Where":
        return cls(*(getattr(design, name) for name in cls._fields))


def _mean_and_spread(model, layout, mode: str, where: Where) -> Callable:
    """(z, reference, state, slips, weights, second, inputs) of one row -> mean and
    variance of each force over the latent slip, without offset: two tuples."""

    def row(z, reference, state, slips, weights, second, inputs):
        tire = with_values(model, layout.natural(z))

        def at(slip):
            moved = slip + state.shift
            moved = moved / jnp.maximum(1 - state.curvature * moved, _LEAST_DIVISOR)
            pair = (state.other, moved) if mode == "y" else (moved, state.other)
            if mode == "xy":
                pair = (moved, second * (1 + moved))
            fx, fy, mz = force_of_state(tire, reference, state, *pair, inputs)
            extra = (0.0, state.force) if mode == "y" else (state.force, 0.0)
            forces = {"fx": fx + extra[0], "fy": fy + extra[1], "mz": mz + state.moment}
            return tuple(forces[channel] for channel in where.offset)

        forces = jax.vmap(at)(slips)
        means = [jnp.sum(force * weights) for force in forces]
        pairs = zip(forces, means, strict=True)
        return means, [jnp.sum((f - mean) ** 2 * weights) for f, mean in pairs]

    return row


def _carrier(model, layout, mode: str, z, where: Where):
    """What carries changes of shape: see :func:`_reference`, each (n,); None where the
    base is the plain brush."""
    if _is_plain(model):
        return None
    found = _reference(with_values(model, layout.natural(z)), where, mode)
    return tuple(jnp.broadcast_to(value, where.second.shape) for value in found)


def _rows_of(where: Where):
    return where.slip, where.weight, where.second, where.inputs


def _each(count, one: Callable, z, states):
    """``one`` of the first ``count`` of some fits, one after the other; nothing of the
    rest."""
    shapes = jax.eval_shape(one, z[0], states[0])
    blank = jax.tree.map(lambda a: jnp.zeros((len(z), *a.shape), a.dtype), shapes)

    def body(k, found):
        here = one(z[k], states[k])
        return jax.tree.map(lambda all, new: all.at[k].set(new), found, here)

    return jax.lax.fori_loop(0, count, body, blank)


@partial(jax.jit, static_argnames=("layout", "mode"))
def forces_of(model, layout, mode: str, z, states, count, where: Where):
    """Mean and variance over the latent slip of the forces of some fits: (b, C, n).

    Args:
        model, layout: the base model and where in z its free parameters stand.
        mode: which slip drives: x, y or xy.
        z, states: (b, p), and the states (b, F, n) with effects.
        count: how many of them are wanted; the rest is skipped.
    """
    row = jax.vmap(
        _mean_and_spread(model, layout, mode, where), (None, 0, 0, 0, 0, 0, 0)
    )

    def one(z, state):
        carrier = _carrier(model, layout, mode, z, where)
        mean, spread = row(z, carrier, State(*state), *_rows_of(where))
        offset = jnp.stack([*where.offset.values()])
        return jnp.stack(mean) + offset, jnp.stack(spread)

    return _each(count, one, z, states)


@partial(jax.jit, static_argnames=("layout", "mode"))
def slopes_of(model, layout, mode: str, z, states, count, where: Where):
    """Mean forces (b, C, n) of some fits and their slopes by z (b, C, p, n) and by the
    fields of the state (b, C, F, n); arguments as those of :func:`forces_of`.

    A row's force depends on z and its own state alone: one pass back for each channel
    serves all of them, with a z for every row.
    """
    row = jax.vmap(_mean_and_spread(model, layout, mode, where))

    def one(z, state):
        def mean(z, carrier, state):
            found, _ = row(z, carrier, State(*state), *_rows_of(where))
            return jnp.stack(found)

        def carried(z):
            return _carrier(model, layout, mode, z, where)

        spread = jnp.broadcast_to(z, (state.shape[1], z.size))
        value, back = jax.vjp(mean, spread, carried(z), state)
        each = jnp.repeat(jnp.eye(len(value)), state.shape[1], axis=1)
        each = each.reshape(len(value), len(value), -1)
        by_z, by_carrier, by_field = jax.lax.map(back, each)
        by_z = jnp.swapaxes(by_z, 1, 2)
        if by_carrier is not None:
            ahead = partial(jax.jvp, carried, (z,))
            moved = jax.lax.map(lambda e: ahead((e,))[1], jnp.eye(z.size))
            for by, change in zip(by_carrier, moved, strict=True):
                by_z += by[:, None, :] * change[None]
        return value + jnp.stack([*where.offset.values()]), by_z, by_field

    return _each(count, one, z, states)


@partial(jax.jit, static_argnames=("layout", "mode"))
def brush_of_base(model, layout, mode, z, where: Where):
    """(c_p a^2 (n,), mu) of the brush with the base model's slope and peak."""
    stiffness, mu, _ = _reference(with_values(model, layout.natural(z)), where, mode)
    return stiffness, mu
