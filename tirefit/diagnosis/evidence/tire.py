"""A base model with all effects, looked at on any design, and the force that it has."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tirefit.diagnosis.effects import Effect
from tirefit.diagnosis.effects.state import State
from tirefit.diagnosis.evidence.changes import Library, count_atoms, library_of
from tirefit.diagnosis.evidence.forward import (
    Design,
    Linear,
    Where,
    brush_of_base,
    forces_of,
    slopes_of,
)
from tirefit.diagnosis.rows.prepared import Prepared
from tirefit.fitting.layout import Layout
from tirefit.models import AbstractTire
from tirefit.padding import pad_rows

_FIELDS, _AT_ONCE, _MOST_ROWS = len(State._fields), 16, 2**14
"""Fields of a state; fits of one call of a program, and rows of all of them at once, at
most."""


@dataclass(frozen=True, kw_only=True)
class Tire:
    """A base model with all effects, a :class:`forward.ForwardModel`.

    ``mode`` says which slip drives, ``layout`` where in z each parameter stands.
    """

    model: AbstractTire
    layout: Layout
    effects: tuple[Effect, ...]
    mode: str

    @cached_property
    def library(self) -> Library:
        return library_of(self.effects)

    def _run(self, program, points, states, design: Design) -> Iterator:
        """What a program gives for z (h, p) and the states (F, n) of fits, one by one;
        the next states are made while JAX works on the last."""
        size, where, waiting = len(design.keep), Where.of(design), None
        room = int(np.clip(_MOST_ROWS // size, 1, _AT_ONCE))
        for first in range(0, len(points), room):
            some = points[first : first + room]
            z, several = (
                np.zeros((room, some.shape[1])),
                np.zeros((room, _FIELDS, size)),
            )
            z[: len(some)] = some
            for state in several[: len(some)]:
                state[:] = next(states)
            tire = self.model, self.layout, self.mode
            found = program(*tire, z, several, len(some), where)
            if waiting is not None:
                yield from _one_by_one(*waiting)
            waiting = found, len(some)
        if waiting is not None:
            yield from _one_by_one(*waiting)

    def forces(self, fits, design: Design) -> Iterator:
        """Mean forces (C, n) of each of some (z, amplitudes of all atoms), and their
        variances over the slip."""
        points = np.array([z for z, _ in fits])
        some = (self.library.state(_present(a), design.rows) for _, a in fits)
        return self._run(forces_of, points, some, design)

    def moments(self, z, amplitudes, design: Design, n: int):
        """Those of one fit, of the first n rows, by channel."""
        both, names = self.forces([(z, amplitudes)], design), sorted(design.observed)
        return tuple(
            {c: x[:n] for c, x in zip(names, part, strict=True)} for part in next(both)
        )

    def brush(self, z, design: Design):
        """(c_p a^2 (n,), mu) of the brush of its slope and peak."""
        where = Where.of(design)
        return brush_of_base(self.model, self.layout, self.mode, z, where)

    def linearised(self, z, amplitudes, design: Design, n: int) -> Linear:
        """The first n rows linearised in everything."""
        present, rows, points = _present(amplitudes), design.rows, np.asarray(z)[None]
        state = self.library.state(present, rows)
        scale, center = design.prior_scale, design.prior_center
        changes = self.library.changes(present, rows, scale, center)
        mean, by_z, fields = next(self._run(slopes_of, points, iter([state]), design))
        weight, observed = design.weights(), design.forces
        columns = np.zeros((count_atoms(self.effects), *mean.shape))
        for atom, slopes in changes.slopes.items():
            with np.errstate(invalid="ignore"):  # the engine refuses such an effect
                columns[atom] = _along(fields, slopes, float(scale[atom]))
        if changes.ends:
            points = np.repeat(points, len(changes.ends), axis=0)
            ends = self._run(forces_of, points, iter(changes.ends.values()), design)
            for (atom, size), (far, _) in zip(changes.sizes.items(), ends, strict=True):
                columns[atom] = (far - mean) / size

        def flat(values):
            """Of the first n rows, whitened, from (..., C, n)."""
            values = (values * weight)[..., :n]
            return np.ascontiguousarray(values.reshape(*values.shape[:-2], -1).T)

        return Linear(
            flat(observed - mean), flat(np.swapaxes(by_z, 0, 1)), flat(columns),
            flat(np.swapaxes(fields, 0, 1)),
        )  # fmt: skip

    def slopes(self, points, sets, design: Design) -> Iterator:
        """Of each hypothesis the mean forces (C, n), and their slopes by z and by the
        amplitudes in prior scales of its atoms (p + k, C, n).

        Args:
            points: (h, p + k) or wider, z and amplitudes.
            sets: atoms of each.
        """
        p, scale, by_amplitude = self.layout.size, design.prior_scale, []

        def states():
            for point, atoms in zip(points, sets, strict=True):
                sizes = point[p : p + len(atoms)] * scale[list(atoms)]
                present = list(zip(atoms, sizes.tolist(), strict=True))
                state, slopes = self.library.slopes(present, design.rows)
                by_amplitude.append(slopes)
                yield state

        found = self._run(slopes_of, points[:, :p], states(), design)
        for atoms, (mean, by_z, by_field) in zip(sets, found, strict=True):
            columns = np.empty((p + len(atoms), *mean.shape))
            columns[:p] = np.swapaxes(by_z, 0, 1)
            each = zip(columns[p:], atoms, by_amplitude.pop(0), strict=True)
            for column, atom, slopes in each:
                column[:] = _along(by_field, slopes, float(scale[atom]))
            yield mean, columns


def _present(amplitudes) -> list[tuple[int, float]]:
    """The atoms that amplitudes of all (K,), in their own units, have."""
    return [(int(k), float(amplitudes[k])) for k in np.flatnonzero(amplitudes)]


def _one_by_one(found, count: int) -> Iterator:
    """Of each of the first ``count`` fits, what a program gave."""
    parts = [np.asarray(part) for part in found]
    yield from (tuple(part[k] for part in parts) for k in range(count))


def _along(by_field, slopes, size: float) -> np.ndarray:
    """Slopes of the forces (C, n) where the fields of the state change by these."""
    return sum(by_field[:, field] * (size * slope) for field, slope in slopes.items())


def with_force(prepared: Prepared, tire: Tire, design: Design, z) -> Design:
    """The base model's force over its peak, for the effects that follow it."""
    channel, fz = prepared.channels[0], prepared.inputs.fz
    silent = np.zeros(count_atoms(tire.effects))
    mean = tire.moments(z, silent, design, prepared.n)[0][channel]
    size = len(design.keep)
    share = pad_rows(mean / (np.max(np.abs(mean) / fz) * fz), size)
    before = _pull(prepared, tire, design, z, silent)
    rows = design.rows._replace(
        force=share, usage=np.abs(share),
        traction=pad_rows(mean / prepared.covariates.load, size),
        pull=pad_rows(before[channel], size),
        twist=pad_rows(before.get("mz", np.zeros_like(before[channel])), size),
    )  # fmt: skip
    if prepared.derived is not None:
        # The acceleration is the force itself: what would explain it is not measured.
        rows = rows._replace(lean=pad_rows(-mean / fz, size))
    return design._replace(rows=rows)


def _pull(prepared, tire: Tire, design: Design, z, silent) -> dict[str, np.ndarray]:
    """Forces of the base model at the past of every row: (n, k) by channel."""
    past = prepared.covariates.past
    if "sweeps" not in prepared.has:
        return {c: np.zeros_like(past) for c in prepared.channels}
    alone, size = np.zeros_like(design.weight), len(design.keep)
    alone[:, 0] = 1.0
    columns = []
    for k in range(past.shape[1]):
        slip = np.repeat(pad_rows(past[:, [k]], size), alone.shape[1], axis=1)
        earlier = (pad_rows(part[:, k], size) for part in prepared.before)
        there = type(design.inputs)(*earlier)
        # A simulator's past beyond its tire is not known.
        then = design._replace(
            slip=slip, weight=alone, inputs=there,
            offset={c: np.zeros(size) for c in design.offset},
        )  # fmt: skip
        columns.append(tire.moments(z, silent, then, prepared.n)[0])
    return {c: np.stack([one[c] for one in columns], axis=1) for c in columns[0]}
