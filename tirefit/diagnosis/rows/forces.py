"""Forces of every row under a base model with effects, and their slopes."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from tirefit.diagnosis.effects import Effect, atoms_of
from tirefit.diagnosis.effects.record import States
from tirefit.diagnosis.effects.state import (
    Covariates,
    State,
    arm_of,
    force_of_state,
    is_plain,
    peak_ratio,
    slip_of_state,
    slope_at_rest,
    with_offsets,
)
from tirefit.diagnosis.engine.fit import Priors
from tirefit.diagnosis.rows.prepared import Prepared
from tirefit.fitting.problem.layout import Layout
from tirefit.models import AbstractTire, TireInputs
from tirefit.padding import pad_rows
from tirefit.params import Values, with_values


class Design(NamedTuple):
    """Data of a refit as arrays, padded to few shapes.

    ``slip`` and ``weight`` (n, q) are the nodes of the latent slip and their probabilities.
    ``observed``, ``scale`` and ``offset`` (force of a simulator minus that of its tire) are (n,) by
    channel; ``keep`` (n,) is 0 for padding and outliers; ``priors`` are those of the amplitudes;
    ``reference`` is load and speed.
    """

    inputs: TireInputs
    slip: Values
    weight: Values
    second: Values
    observed: Mapping[str, Values]
    scale: Mapping[str, Values]
    offset: Mapping[str, Values]
    keep: Values
    rows: Covariates
    priors: Priors
    reference: Values

    @property
    def forces(self) -> np.ndarray:
        """Observed forces (C, n), in the order of their names."""
        return np.stack([self.observed[c] for c in sorted(self.observed)])

    def weights(self) -> np.ndarray:
        """Reciprocal noise (C, n), zero where ``keep`` is."""
        scales = np.stack([self.scale[c] for c in sorted(self.observed)])
        return np.asarray(self.keep, float) / scales

    def whitened(self, values: np.ndarray, n: int | None = None) -> np.ndarray:
        """Values (..., C, rows) of the first n rows over the noise, (..., C n)."""
        values = (values * self.weights())[..., :n]
        return values.reshape(*values.shape[:-2], -1)


class Linear(NamedTuple):
    """A fit linearised, whitened: residual r (m,), J = d force / dz (m, p), T = d force / d
    amplitude in units of prior scales (m, K), and d force / d field of the state (m, F)."""

    residual: np.ndarray
    jacobian: np.ndarray
    columns: np.ndarray
    fields: np.ndarray


class _Where(NamedTuple):
    """The part of a :class:`Design` that forces depend on."""

    inputs: TireInputs
    slip: Values
    weight: Values
    second: Values
    offset: Mapping[str, Values]
    reference: Values

    @classmethod
    def of(cls, design: Design) -> "_Where":
        return cls(*(getattr(design, name) for name in cls._fields))

    def each(self) -> tuple[Values, Values, Values, TireInputs]:
        return self.slip, self.weight, self.second, self.inputs


def _reference(
    tire: AbstractTire, where: _Where, mode: str
) -> tuple[jax.Array, jax.Array, Values | float]:
    """(c_p a^2 (n,), mu, half-length) of the brush with the base's slope and peak."""
    stiffness = jax.vmap(lambda inputs: slope_at_rest(tire, inputs, mode))(where.inputs) / 2
    return stiffness, peak_ratio(tire, *where.reference), arm_of(tire)


def _carrier(
    model: AbstractTire, layout: Layout, mode: str, z: jax.Array, where: _Where
) -> tuple[jax.Array, ...] | None:
    """:func:`_reference` for changes of shape, each (n,); None for the plain brush."""
    if is_plain(model):
        return None
    brush = _reference(with_values(model, layout.natural(z)), where, mode)
    return tuple(jnp.broadcast_to(value, where.second.shape) for value in brush)


def _mean_and_spread(
    model: AbstractTire, layout: Layout, mode: str, where: _Where
) -> Callable[..., Any]:
    """(z, reference, state, slips, weights, second, inputs) of one row -> mean and
    variance of each force over the latent slip, without offset: two lists."""

    def row(
        z: jax.Array, reference: tuple[Any, ...] | None, state: State, slips: jax.Array,
        weights: jax.Array, second: jax.Array, inputs: TireInputs,
    ) -> tuple[list[jax.Array], list[jax.Array]]:  # fmt: skip
        tire = with_values(model, layout.natural(z))

        def at(slip: jax.Array) -> tuple[Values, ...]:
            moved = slip_of_state(state, slip)
            pair: tuple[Any, Any] = (state.other, moved) if mode == "y" else (moved, state.other)
            if mode == "xy":
                pair = (moved, second * (1 + moved))
            three = force_of_state(tire, reference, state, *pair, inputs)
            three = with_offsets(three, state, mode)
            forces = dict(zip(("fx", "fy", "mz"), three, strict=True))
            return tuple(forces[channel] for channel in where.offset)

        forces = jax.vmap(at)(slips)
        means = [jnp.sum(force * weights) for force in forces]
        pairs = zip(forces, means, strict=True)
        return means, [jnp.sum((f - mean) ** 2 * weights) for f, mean in pairs]

    return row


def _each(
    count: jax.Array, of_fit: Callable[..., Any], z: jax.Array, states: jax.Array
) -> tuple[jax.Array, ...]:
    """``of_fit`` for each of the first ``count`` fits in turn; zero for the others."""
    shapes = jax.eval_shape(of_fit, z[0], states[0])
    blank = jax.tree.map(lambda a: jnp.zeros((len(z), *a.shape), a.dtype), shapes)

    def body(k: jax.Array, results: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
        here = of_fit(z[k], states[k])
        return jax.tree.map(lambda all, new: all.at[k].set(new), results, here)

    return jax.lax.fori_loop(0, count, body, blank)


@partial(jax.jit, static_argnames=("layout", "mode"))
def _forces_of(
    model: AbstractTire, layout: Layout, mode: str, z: jax.Array, states: jax.Array,
    count: jax.Array, where: _Where,
) -> tuple[jax.Array, ...]:  # fmt: skip
    """Mean and variance over the latent slip of the forces (b, C, n) of the first
    ``count`` fits, of z (b, p) and states with effects (b, F, n)."""
    row = _mean_and_spread(model, layout, mode, where)
    row = jax.vmap(row, (None, 0, 0, 0, 0, 0, 0))

    def of_fit(z: jax.Array, state: jax.Array) -> tuple[jax.Array, jax.Array]:
        carrier = _carrier(model, layout, mode, z, where)
        mean, spread = row(z, carrier, State(*state), *where.each())
        return jnp.stack(mean) + jnp.stack([*where.offset.values()]), jnp.stack(spread)

    return _each(count, of_fit, z, states)


@partial(jax.jit, static_argnames=("layout", "mode"))
def _slopes_of(
    model: AbstractTire, layout: Layout, mode: str, z: jax.Array, states: jax.Array,
    count: jax.Array, where: _Where,
) -> tuple[jax.Array, ...]:  # fmt: skip
    """Mean forces (b, C, n) of some fits and their slopes by z (b, C, p, n) and by the
    fields of the state (b, C, F, n). A row's force depends on z and its own state
    alone: one pass back for each channel serves all, with a z for every row."""
    row = jax.vmap(_mean_and_spread(model, layout, mode, where))

    def of_fit(z: jax.Array, state: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        def mean(z: jax.Array, carrier: tuple[Any, ...] | None, state: jax.Array) -> jax.Array:
            return jnp.stack(row(z, carrier, State(*state), *where.each())[0])

        def carried(z: jax.Array) -> tuple[Any, ...] | None:
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

    return _each(count, of_fit, z, states)


@partial(jax.jit, static_argnames=("layout", "mode"))
def _brush_of(
    model: AbstractTire, layout: Layout, mode: str, z: jax.Array, where: _Where
) -> tuple[jax.Array, jax.Array]:
    return _reference(with_values(model, layout.natural(z)), where, mode)[:2]


@dataclass(frozen=True)
class Tire:
    """A base model with all effects. ``mode`` says which slip drives (x, y or xy),
    ``layout`` holds the places of the parameters in z."""

    model: AbstractTire
    layout: Layout
    effects: tuple[Effect, ...]
    mode: str

    def states(self, design: Design) -> States:
        """States of the rows of a design under hypotheses of these effects."""
        return States(atoms_of(self.effects), design.rows, design.priors.scale)

    def _run(
        self, program: Callable[..., Any], points: np.ndarray, states: Iterator[Any], design: Design
    ) -> Iterator[tuple[np.ndarray, ...]]:
        """Results of a program for z (h, p) and the states (F, n) of fits, one by one;
        the next states are computed while JAX evaluates the last ones."""
        size, where, waiting, count = len(design.keep), _Where.of(design), (), 0
        room = int(np.clip(16384 // size, 1, 16))  # fits in one call, by the rows of all of them
        for first in range(0, len(points), room):
            some = points[first : first + room]
            z = np.zeros((room, some.shape[1]))
            several = np.zeros((room, len(State._fields), size))
            z[: len(some)] = some
            for state in several[: len(some)]:
                state[:] = next(states)
            computed = program(self.model, self.layout, self.mode, z, several, len(some), where)
            yield from _one_by_one(waiting, count)
            waiting, count = computed, len(some)
        yield from _one_by_one(waiting, count)

    def moments(
        self, z: np.ndarray, design: Design, n: int, amplitudes: np.ndarray | tuple[Any, ...] = ()
    ) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        """Mean and variance over the slip for one fit, of the first n rows, by channel."""
        states = iter([self.states(design).state(_present(amplitudes))])
        both = next(self._run(_forces_of, np.array([z]), states, design))
        names = sorted(design.observed)
        mean, spread = ({c: x[:n] for c, x in zip(names, part, strict=True)} for part in both)
        return mean, spread

    def brush(self, z: np.ndarray, design: Design) -> tuple[jax.Array, jax.Array]:
        """(c_p a^2 (n,), mu) of the brush of its slope and peak."""
        return _brush_of(self.model, self.layout, self.mode, z, _Where.of(design))

    @np.errstate(invalid="ignore")  # the engine refuses an effect without a slope
    def linearised(self, z: np.ndarray, amplitudes: np.ndarray, design: Design, n: int) -> Linear:
        """The first n rows linearised in everything."""
        present, points = _present(amplitudes), np.asarray(z)[None]
        states, scale = self.states(design), design.priors.scale
        state, changes = states.state(present), states.changes(present, design.priors.center)
        mean, by_z, fields = next(self._run(_slopes_of, points, iter([state]), design))
        columns = np.zeros((len(scale), *mean.shape))
        for atom, slopes in changes.slopes.items():
            columns[atom] = _along(fields, slopes, float(scale[atom]))
        points = np.repeat(points, len(changes.ends), axis=0)
        ends = self._run(_forces_of, points, iter(changes.ends.values()), design)
        for (atom, size), (moved, _) in zip(changes.sizes.items(), ends, strict=True):
            columns[atom] = (moved - mean) / size

        by_z, fields = np.swapaxes(by_z, 0, 1), np.swapaxes(fields, 0, 1)
        parts = design.forces - mean, by_z, columns, fields
        return Linear(*(np.ascontiguousarray(design.whitened(part, n).T) for part in parts))

    def slopes(
        self, points: np.ndarray, sets: Sequence[tuple[Any, ...]], design: Design
    ) -> Iterator[tuple[np.ndarray, ...]]:
        """Mean forces (C, n) of each hypothesis, a set of atoms at a point (z, amplitudes, ...),
        and slopes (p + k, C, n) by z and amplitudes in prior scales."""
        p, scale, by_amplitude = self.layout.size, design.priors.scale, []
        of_rows = self.states(design)

        def states() -> Iterator[np.ndarray]:
            for point, atoms in zip(points, sets, strict=True):
                sizes = point[p : p + len(atoms)] * scale[list(atoms)]
                present = list(zip(atoms, sizes.tolist(), strict=True))
                state, slopes = of_rows.slopes(present)
                by_amplitude.append(slopes)
                yield state

        results = self._run(_slopes_of, points[:, :p], states(), design)
        for atoms, (mean, by_z, by_field) in zip(sets, results, strict=True):
            columns = np.empty((p + len(atoms), *mean.shape))
            columns[:p] = np.swapaxes(by_z, 0, 1)
            each = zip(columns[p:], atoms, by_amplitude.pop(0), strict=True)
            for column, atom, slopes in each:
                column[:] = _along(by_field, slopes, float(scale[atom]))
            yield mean, columns


def _present(amplitudes: np.ndarray | tuple[Any, ...]) -> list[tuple[int, float]]:
    """Atoms with an amplitude, from amplitudes of all (K,) in their own units."""
    return [(int(k), float(amplitudes[k])) for k in np.flatnonzero(amplitudes)]


def _one_by_one(results: tuple[Any, ...], count: int) -> Iterator[tuple[np.ndarray, ...]]:
    """Results of a program for each of the first ``count`` fits."""
    parts = [np.asarray(part) for part in results]
    yield from (tuple(part[k] for part in parts) for k in range(count))


def _along(by_field: np.ndarray, slopes: Mapping[int, np.ndarray], size: float) -> Values | float:
    """Slopes of the forces (C, n) for these changes of the fields of the state."""
    return sum(by_field[:, field] * (size * slope) for field, slope in slopes.items())


def with_force(prepared: Prepared, tire: Tire, design: Design, z: np.ndarray) -> Design:
    """The force of the base model over its peak, for effects that depend on it."""
    channel, fz = prepared.channels[0], prepared.inputs.fz
    mean = tire.moments(z, design, prepared.n)[0][channel]
    share = mean / (np.max(np.abs(mean) / fz) * fz)
    before = _pull(prepared, tire, design, z)
    fields = {
        "force": share,
        "usage": np.abs(share),
        "traction": mean / prepared.covariates.load,
        "pull": before[channel],
        "twist": before.get("mz", np.zeros_like(before[channel])),
    }
    if prepared.derived is not None:
        # The measured acceleration contains the force itself, so it must not explain it.
        fields["lean"] = -mean / fz
    padded = {name: pad_rows(values, len(design.keep)) for name, values in fields.items()}
    return design._replace(rows=design.rows._replace(**padded))


def _pull(prepared: Prepared, tire: Tire, design: Design, z: np.ndarray) -> dict[str, np.ndarray]:
    """Forces of the base model at the past of every row: (n, k) by channel."""
    past = prepared.covariates.past
    if "sweeps" not in prepared.has:
        return {c: np.zeros_like(past) for c in prepared.channels}
    alone, size = np.zeros_like(design.weight), len(design.keep)
    alone[:, 0] = 1.0
    # The past of a simulator beyond its tire is not known.
    offset, columns = {c: np.zeros(size) for c in design.offset}, []
    for k in range(past.shape[1]):
        slip = np.repeat(pad_rows(past[:, [k]], size), alone.shape[1], axis=1)
        earlier = (pad_rows(np.asarray(part)[:, k], size) for part in prepared.before)
        inputs = type(design.inputs)(*earlier)
        then = design._replace(slip=slip, weight=alone, inputs=inputs, offset=offset)
        columns.append(tire.moments(z, then, prepared.n)[0])
    return {c: np.stack([column[c] for column in columns], axis=1) for c in columns[0]}
