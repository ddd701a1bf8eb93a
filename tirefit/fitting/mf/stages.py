"""The search in stages, as tire engineers do it: each part alone, then all together."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from tirefit.fitting.mf.parts import MOMENTS, PARTS, coefficients_of
from tirefit.fitting.mf.rows import ForceRows, NoiseLaw, noise_law
from tirefit.fitting.mf.solve import (
    Block,
    Minimum,
    Problem,
    blocks_of,
    minimise,
    row_gradients,
)
from tirefit.fitting.noise import MAD, autocorrelation_time
from tirefit.models import TireInputs

__all__ = ["FAR", "Search", "Stage", "problem_of", "search", "starts_of"]

_ENOUGH = 4096
"""Rows, evenly taken, from which the best of several starts is chosen."""

_TRIES, _ROUGHLY = 60, 0.01
"""Passes, and the deviance left to gain, of a stage that others follow."""

_LAW_RESTS = 0.01
"""Change of the noise from one round to the next at which it is settled."""

_HELD = 0.98
"""Share of the prior's variance that is left, above which the data say nothing."""


FAR = 7.0
"""Standard deviations, of the middle of the residuals, beyond which a row is named."""


class Stage(NamedTuple):
    """One stage: rows, coefficients moved, sum of squares over the noise at its end."""

    name: str
    rows: int
    moved: int
    chi2: float
    steps: int
    converged: bool


@dataclass
class Search:
    """What is known so far: u (p,), the noise of each force, the stages.

    ``near``: whether the first u was of a tire that may be near.
    ``moved`` are the coefficients of the stages that had rows, ``held`` those of them
    that the data do not tell. ``inflation`` is, by force, how many rows count as one,
    and ``fitted`` the root mean square of the residuals [N, N m] and their number, and
    ``far`` how many of them lie beyond :data:`FAR` standard deviations, where some do;
    ``covariance`` (p, p) is that of u at the end.
    """

    problem: Problem
    rows: Mapping[str, ForceRows]
    u: np.ndarray
    near: bool = False
    laws: dict[str, NoiseLaw] = field(default_factory=dict)
    inflation: dict[str, float] = field(default_factory=dict)
    stages: list[Stage] = field(default_factory=list)
    moved: frozenset[str] = frozenset()
    held: frozenset[str] = frozenset()
    fitted: dict[str, tuple[float, int]] = field(default_factory=dict)
    far: dict[str, int] = field(default_factory=dict)
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))

    def std(self, force: str) -> np.ndarray:
        """Noise of each row of a force, (n,), with what is known of it so far."""
        rows = self.rows[force]
        if not rows.estimated or force not in self.laws:
            return rows.std
        least = 1e-6 * float(np.sqrt(np.mean(rows.observed**2)))
        return np.maximum(self.laws[force].std(rows.inputs.fz), least)

    def blocks(self, force: str, part: str, most: int | None = None) -> list[Block]:
        """Blocks of the rows of a force that a part takes; ``most`` of them evenly."""
        rows = self.rows[force]
        chosen = np.flatnonzero(rows.parts[part])
        if most is not None and len(chosen) > most:
            chosen = chosen[np.linspace(0, len(chosen) - 1, most).astype(int)]
        if not len(chosen):
            return []
        inputs = TireInputs(*(rows.column(name)[chosen] for name in TireInputs._fields))
        std = self.noise(force)[chosen]
        return list(blocks_of(force, inputs, rows.observed[chosen], std))

    def noise(self, force: str) -> np.ndarray:
        """Noise of each row, (n,), that makes correlated rows count as fewer."""
        return self.std(force) * np.sqrt(self.inflation.get(force, 1.0))


def search(
    problem: Problem,
    rows: Mapping[str, ForceRows],
    parts: Sequence[str],
    first: np.ndarray | None = None,
) -> Search:
    """Every part from its own rows, then all of them from all rows, then M_x and M_y,
    which leave the forces as they are.

    Args:
        problem: without rows; ``free`` says which coefficients are not fixed.
        rows: of every force that the data hold.
        parts: names in the order of :data:`PARTS`.
        first: u (p,) of a tire that may be near, to start from too.
    """
    nothing = np.zeros(len(problem.names))
    work = Search(problem, rows, nothing if first is None else first, first is not None)
    of_part = coefficients_of(problem.tire.version)
    movable = {n for n, free in zip(problem.names, problem.free, strict=True) if free}
    moved: list[str] = []
    for part in (part for part in parts if part not in MOMENTS):
        forces = [force for force in PARTS[part].forces if force in rows]
        if part == "combined" and len(forces) > 1:
            forces = [force for force in forces if force != "mz"]
        blocks = {force: work.blocks(force, part) for force in forces}
        names = [n for n, own in of_part.items() if own == part and n in movable]
        if not any(blocks.values()) or (part == "combined" and not _combined(rows)):
            continue
        _one_stage(work, part, forces, names)
        moved += names
    part = "combined" if "combined" in parts else parts[0]
    forces = [f for f in rows if f not in MOMENTS and work.blocks(f, part)]
    if forces:
        _together(work, "together", part, forces, moved)
    for part in (part for part in MOMENTS if part in parts and part in rows):
        names = [n for n, own in of_part.items() if own == part and n in movable]
        _one_stage(work, part, [part], names)
        work.stages.pop()
        _together(work, part, part, [part], names)
    return work


def _combined(rows: Mapping[str, ForceRows]) -> bool:
    """Whether some row has both slips."""
    return any(not np.all(of_force.parts[force]) for force, of_force in rows.items())


def problem_of(work: Search, forces, part: str, names, most=None) -> Problem:
    """The rows of these forces that a part takes, and which coefficients it moves;
    ``most`` rows of a force, evenly taken."""
    blocks = [b for force in forces for b in work.blocks(force, part, most)]
    return work.problem.with_free(names).with_blocks(blocks)


def _one_stage(work: Search, part: str, forces: Sequence[str], names: list[str]):
    few = problem_of(work, forces, part, names, _ENOUGH)
    ends = [minimise(few, start, _TRIES, _ROUGHLY) for start in starts_of(work, part)]
    best = min(ends, key=lambda end: end.cost)
    work.u = best.u
    problem = problem_of(work, forces, part, names)
    work.u = minimise(problem, work.u, _TRIES, _ROUGHLY).u
    _learn_noise(work, part, forces)
    problem = problem_of(work, forces, part, names)
    end = minimise(problem, work.u, _TRIES, _ROUGHLY)
    work.u = end.u
    _note(work, part, problem, end)


def _note(work: Search, name: str, problem: Problem, end: Minimum) -> None:
    rows = sum(int(np.count_nonzero(block.weight)) for block in problem.blocks)
    moved = int(np.count_nonzero(problem.free))
    chi2 = end.cost - float(end.u @ end.u)
    work.stages.append(Stage(name, rows, moved, chi2, end.steps, end.converged))


def _learn_noise(work: Search, part: str, forces: Sequence[str]) -> float:
    """Noise laws from the residuals of these rows; by how much the noise changed."""
    change = 0.0
    for force in forces:
        rows = work.rows[force]
        if not rows.estimated:
            continue
        before = work.std(force)
        residual = _residual(work, force, part)
        work.laws[force] = noise_law(residual, rows.column("fz")[rows.parts[part]])
        change = max(change, float(np.max(np.abs(work.std(force) / before - 1))))
    return change


def _residual(work: Search, force: str, part: str) -> np.ndarray:
    """What the rows (n,) of a part miss of the measured force [N, N m]."""
    residual, _ = row_gradients(problem_of(work, [force], part, ()), work.u)
    return residual * work.noise(force)[work.rows[force].parts[part]]


def _together(
    work: Search, name: str, part: str, forces: list[str], moved: list[str]
) -> None:
    """All rows of these forces at once, the noise settled; then what the data leave
    open is held. ``name`` is that of the stage."""
    for _ in range(5):
        problem = problem_of(work, forces, part, moved)
        work.u = minimise(problem, work.u, settled=_ROUGHLY).u
        if _learn_noise(work, part, forces) < _LAW_RESTS:
            break
    for force in forces:
        work.inflation[force] = _rows_per_one(work, force, part)
    problem = problem_of(work, forces, part, moved)
    end = minimise(problem, work.u, settled=_ROUGHLY)
    free = np.flatnonzero(problem.free)
    left = np.linalg.inv(end.curvature[np.ix_(free, free)] + np.eye(len(free)))
    held = frozenset(
        problem.names[i]
        for i, share in zip(free, np.diagonal(left), strict=True)
        if share > _HELD
    )
    work.moved, work.held = work.moved | frozenset(moved), work.held | held
    work.u = end.u.copy()
    work.u[np.isin(problem.names, list(held))] = 0.0
    problem = problem.with_free([name for name in moved if name not in work.held])
    end = minimise(problem, work.u)
    work.u = end.u
    work.covariance = _covariance(work, problem, end)
    for force in forces:
        missed = _residual(work, force, part)
        work.fitted[force] = float(np.sqrt(np.mean(missed**2))), len(missed)
        relative = np.abs(missed / work.std(force)[work.rows[force].parts[part]])
        far = int(np.count_nonzero(relative > FAR * MAD * np.median(relative)))
        if far:
            work.far[force] = far
    _note(work, name, problem, end)


def _covariance(work: Search, problem: Problem, end: Minimum) -> np.ndarray:
    """Of u: of what was moved by rows and priors, of the rest that may move by priors
    alone, of what is fixed zero; what was moved before stays as it is."""
    covariance = work.covariance
    if not len(covariance):
        covariance = np.diag(work.problem.free.astype(float))
    free = np.flatnonzero(problem.free)
    covariance[np.ix_(free, free)] = np.linalg.inv(
        end.curvature[np.ix_(free, free)] + np.eye(len(free))
    )
    return covariance


def _rows_per_one(work: Search, force: str, part: str) -> float:
    """How many rows of this force count as one: residuals within runs that resemble
    their neighbours are a curve that is missed, or noise that was filtered."""
    residual, run = _residual(work, force, part), work.rows[force].run
    residual = residual / work.std(force)[work.rows[force].parts[part]]
    run = run[work.rows[force].parts[part]]
    return autocorrelation_time([residual[run == code] for code in np.unique(run)])


_SHAPES: dict[str, tuple[dict[str, float], ...]] = {
    "fx": ({}, {"PCX1": 1.2}, {"PCX1": 1.8}),
    "fy": ({}, {"PCY1": 1.1}, {"PCY1": 1.8}),
    "mz": ({"QEZ1": -0.5}, {"QCZ1": 1.1, "QEZ1": -3.0}, {"QCZ1": 1.5, "QEZ1": -1.0}),
    "combined": ({},),
    "mx": (
        {},
        {"QSX2": -1.0, "QSX3": 0.5, "QSX4": -1.0},
        {"QSX2": 1.0, "QSX3": -0.5, "QSX4": 1.0},
    ),
    "my": ({},),
}
"""Shapes of the curves to start from; curves with a peak, without, and sharp ones lie
in different valleys."""


def starts_of(work: Search, part: str) -> list[np.ndarray]:
    """First values: what a look at the curve gives, with several shapes."""
    problem = work.problem
    looked = _look(work, part)
    starts = [work.u] if work.near else []
    for shape in _SHAPES[part]:
        u = work.u.copy()
        values = looked | shape
        for name in values.keys() & set(problem.names):
            i, value = problem.names.index(name), values[name]
            if problem.free[i]:
                u[i] = problem.unit(name, value)
        starts.append(u)
    return starts


def _look(work: Search, part: str) -> dict[str, float]:
    """Friction and stiffness, from the largest forces and the slope at small slips."""
    if part not in ("fx", "fy"):
        return {}
    rows = work.rows[part]
    chosen = rows.parts[part]
    slip = rows.column("sigma_x" if part == "fx" else "alpha")[chosen]
    force, fz = rows.observed[chosen], rows.column("fz")[chosen]
    size = np.abs(slip)
    low = size <= max(np.quantile(size, 0.2), 0.1 * size.max())
    peak = float(np.clip(np.quantile(np.abs(force) / fz, 0.98), 0.1, 3.0))
    share = slip[low] * fz[low]
    slope = 1.2 * float(share @ force[low] / max(share @ share, 1e-12))
    slope = max(slope, peak / max(size.max(), 1e-6))
    if part == "fx":
        return {"PDX1": peak, "PKX1": slope}
    # Of K = PKY1 F_z0 sin(2 arctan(F_z / (PKY2 F_z0))) at the nominal load.
    at_nominal = np.sin(2 * np.arctan(1 / 2.5))
    return {"PDY1": peak, "PKY1": -slope / at_nominal, "PKY2": 2.5}
