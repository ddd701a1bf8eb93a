"""A base model with all effects, looked at on any design, and the force that it has."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tirefit.diagnosis.effects import Effect
from tirefit.diagnosis.evidence.changes import (
    changes_of,
    count_atoms,
    present_in,
    states_of,
)
from tirefit.diagnosis.evidence.forward import (
    MOST,
    Design,
    Linear,
    Refit,
    fill,
    moments,
    refit_all,
    tangents,
)
from tirefit.diagnosis.rows.prepared import Prepared
from tirefit.fitting.layout import Layout
from tirefit.models import AbstractTire
from tirefit.padding import pad_rows


@dataclass(frozen=True, kw_only=True)
class Tire:
    """A base model with all effects: what can be looked at on any design.

    ``mode`` says which slip drives, ``layout`` where in z each parameter stands.
    """

    model: AbstractTire
    layout: Layout
    effects: tuple[Effect, ...]
    mode: str

    def moments(self, z, amplitudes, design: Design, n: int):
        """Mean force and its variance over the slip of the first n rows, by channel."""
        states = states_of(self.effects, amplitudes, design.rows)
        both = moments(self.model, self.layout, self.mode, z, states, design)
        return tuple({c: np.asarray(x)[:n] for c, x in part.items()} for part in both)

    def refitted(self, z, design: Design) -> Refit:
        """Its own parameters refitted, without effects, from z."""
        return self.refit([(z, np.zeros(0))], [()], design)

    def refit(
        self, starts, sets, design: Design, meanwhile: Callable = lambda: None
    ) -> Refit:
        """Hypotheses refitted: ``starts`` are (z, amplitudes in prior scales) of each
        of the ``sets`` of atoms; ``meanwhile`` is done while JAX refits."""
        every = self.refit_folds(starts, sets, [design.keep], design, meanwhile)
        return Refit(*(values[0] for values in every))

    def refit_folds(
        self, starts, sets, keeps, design: Design, meanwhile: Callable = lambda: None
    ) -> Refit:
        """The same on each of the sets of rows ``keeps`` (f, n), 0 or 1, in the place
        of that of the design: leading axes (f, sets)."""
        starts, index = fill(starts, sets, count_atoms(self.effects))
        fold, mine = np.divmod(np.arange(len(keeps) * len(sets)), len(sets))
        keeps = np.asarray(keeps) > 0
        tire, parts = (self.model, self.layout, self.effects, self.mode), []
        for first in range(0, len(mine), MOST):
            jobs = np.arange(first, min(first + MOST, len(mine)))
            # The first ones again, up to one shape: one program.
            own, which = mine[np.resize(jobs, MOST)], fold[np.resize(jobs, MOST)]
            arrays = starts[own], index[own], keeps[which], len(jobs)
            parts.append((len(jobs), refit_all(*tire, *arrays, design)))
        meanwhile()
        shape = len(keeps), len(sets)
        found = (
            np.concatenate([np.asarray(refit[k])[:count] for count, refit in parts])
            for k in range(len(Refit._fields))
        )
        return Refit(*(values.reshape(*shape, *values.shape[1:]) for values in found))

    def linearised(self, z, amplitudes, design: Design) -> Linear:
        """All rows linearised in everything."""
        rows, present = design.rows, present_in(amplitudes)
        states = states_of(self.effects, amplitudes, rows)
        scale, center = design.prior_scale, design.prior_center
        changes = changes_of(self.effects, states, present, rows, scale, center)
        tire = self.model, self.layout, self.mode
        return tangents(*tire, z, states, changes, design)


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
