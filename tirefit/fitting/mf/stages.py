"""The search in stages, as tire engineers do it: each force from its own rows.

F_x and F_y share no coefficient. Each is found from its rows of pure slip, then, with
what these told kept, from those of combined slip. A moment depends on the coefficients
of the forces too: it takes them as known within their errors and moves its own alone,
so that a moment which the formula describes badly worsens no force.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from tirefit.fitting.mf.cells import Group
from tirefit.fitting.mf.parts import MOMENTS, PARTS, coefficients_of, own_coefficients
from tirefit.fitting.mf.rows import ForceRows
from tirefit.fitting.mf.solve import (
    Block,
    Minimum,
    Problem,
    blocks_of,
    curvature_at,
    limits_of,
    minimise,
    row_gradients,
    row_values,
)
from tirefit.fitting.mf.starts import first_values
from tirefit.fitting.noise import autocorrelation_time, design_effect
from tirefit.fitting.noise_law import noise_law
from tirefit.models import TireInputs

_ENOUGH = 2048
"""Cells, evenly taken, from which the best of several starts is chosen."""

_TRIES, _ROUGHLY = 60, 0.01
"""Passes, and the deviance left to gain, while the noise is still to be learnt."""

_ROUNDS = 10
_SETTLED = 0.02
"""Rounds of search and noise, at most, and the change of the noise that ends them."""

_TOLD = 0.5
"""Share of the prior's variance that is left, below which the rows tell a coefficient:
later rows do not move it."""

_HELD = 0.98
"""Share of the prior's variance that is left, above which the rows say nothing."""

Progress = Callable[[str], None]


class Stage(NamedTuple):
    """One stage: the force, its rows and their cells, coefficients moved, sum of
    squares over the noise at its end, passes, whether it converged within its limit.

    ``rmse``: root mean square [N, N m] of what the means of its cells miss at its own
    end, and ``rmse_at_end`` at the end of all.
    """

    name: str
    force: str
    pure: bool
    rows: int
    cells: int
    moved: int
    chi2: float
    steps: int
    converged: bool
    rmse: float
    rmse_at_end: float

    @property
    def part(self) -> str:
        """The part, of :data:`~tirefit.fitting.mf.parts.PARTS`, to which it belongs."""
        return self.force if self.pure else "combined"


@dataclass
class Search:
    """What is known so far: u (p,) and its covariance (p, p), and the stages taken.

    ``groups``: the cells of each force. ``near``: whether the first u was of a tire
    that may be near. ``moved`` are the coefficients of the stages that had rows,
    ``held`` those of them that the data do not tell.
    """

    problem: Problem
    groups: dict[str, list[Group]]
    u: np.ndarray
    covariance: np.ndarray
    near: bool = False
    stages: list[Stage] = field(default_factory=list)
    moved: set[str] = field(default_factory=set)
    held: set[str] = field(default_factory=set)

    def rmse(self, group: Group) -> float:
        """Root mean square [N, N m] of what the means of cells miss, each as often as
        it has rows."""
        cells = group.cells
        missed = row_values(self.problem, self.u, group.force, cells.inputs)
        squares = (missed - cells.observed) ** 2
        return float(np.sqrt(np.average(squares, weights=cells.rows)))

    def rows_per_one(self, force: str) -> float:
        """How many rows of a force count as one."""
        ones, rows = 0.0, 0
        for group in self.groups[force]:
            fz, observed = np.asarray(group.cells.inputs.fz), group.cells.observed
            share = group.row_variance(fz, observed) / group.variance(observed)
            ones += float(np.sum(share)) / group.each
            rows += int(np.sum(group.cells.rows))
        return max(rows / ones, 1.0)

    def stages_at_end(self) -> list[Stage]:
        """The stages, with what their rows miss now."""
        of = {(g.force, g.pure): g for groups in self.groups.values() for g in groups}
        return [
            stage._replace(rmse_at_end=self.rmse(of[stage.force, stage.pure]))
            for stage in self.stages
        ]


def search(
    problem: Problem,
    rows: Mapping[str, ForceRows],
    groups: Mapping[str, list[Group]],
    first: np.ndarray | None = None,
    progress: Progress = lambda text: None,
) -> Search:
    """Each force from its own rows, pure slip first; moments after the forces.

    Args:
        problem: without rows; ``free`` says which coefficients are not fixed.
        rows: of every force that the data hold.
        groups: their cells.
        first: u (p,) of a tire that may be near, to start from too.
    """
    start = np.zeros(len(problem.names)) if first is None else first
    nothing = np.diag(problem.free.astype(float))
    work = Search(problem, dict(groups), start, nothing, near=first is not None)
    for force in (force for force in PARTS if force in groups):
        for count in range(1, len(groups[force]) + 1):
            progress(_title(groups[force][count - 1]))
            _one_stage(work, force, count, rows[force])
    return work


def without(work: Search, keeps: Mapping[str, Sequence[np.ndarray]]) -> Search:
    """The same search from where it ended, of some of the cells: what the others are
    held against.

    Args:
        keeps: by force, which cells of each group are kept, (m,) bool.
    """
    problem, covariance = work.problem, np.diag(work.problem.free.astype(float))
    groups = {
        force: [
            group.part(keep)
            for group, keep in zip(work.groups[force], kept, strict=True)
            if np.any(keep)
        ]
        for force, kept in keeps.items()
        if any(map(np.any, kept))
    }
    left = Search(problem, groups, work.u.copy(), covariance, near=True)
    for force in groups:
        for count in range(1, len(groups[force]) + 1):
            _one_stage(left, force, count, None)
    return left


def _title(group: Group) -> str:
    slip = "pure" if group.pure else "combined"
    return group.force + ("" if group.force in MOMENTS else f" in {slip} slip")


def _one_stage(work: Search, force: str, count: int, rows: ForceRows | None) -> None:
    """Takes the first ``count`` groups of a force, of which the last is new."""
    is_last = count == len(work.groups[force])
    names = _to_move(work, force, is_last)
    if rows is not None:
        work.u = _best_start(work, force, count, names)
    end = None
    for _ in range(_ROUNDS):
        problem = problem_of(work, force, count, names)
        end = minimise(problem, work.u, _TRIES, _ROUGHLY)
        work.u = end.u
        if _learn_noise(work, force, count, rows) < _SETTLED:
            break
    _learn_weight(work, force, count, names)
    problem = problem_of(work, force, count, names)
    end = minimise(problem, work.u)
    if is_last:
        problem, end = _hold(work, problem, end)
    work.u, work.moved = end.u, work.moved | set(names)
    work.covariance = _covariance(work.covariance, problem, end.u)
    _note(work, force, count, problem, end)


def _to_move(work: Search, force: str, is_last: bool) -> list[str]:
    """Coefficients that a stage moves: those of pure slip, then those of combined slip
    and what pure slip did not tell."""
    free = dict(zip(work.problem.names, work.problem.free, strict=True))
    variance = dict(zip(work.problem.names, np.diagonal(work.covariance), strict=True))
    own = own_coefficients(work.problem.tire.version, force)
    pure = [g.pure for g in work.groups[force]]
    if not all(pure) and is_last:
        told = {name for name in own if variance[name] <= _TOLD and free[name]}
        return [n for n in own if free[n] and n not in told & work.moved]
    part = coefficients_of(work.problem.tire.version)
    return [name for name in own if free[name] and part[name] == force]


def _blocks(work: Search, group: Group, most: int | None = None) -> list[Block]:
    """Blocks of a group's cells with their noise; ``most`` of them evenly taken."""
    cells = group.cells
    chosen = np.arange(len(cells.rows))
    if most is not None and len(chosen) > most:
        chosen = chosen[np.linspace(0, len(chosen) - 1, most).astype(int)]
    inputs = TireInputs(*(np.asarray(column)[chosen] for column in cells.inputs))
    std = np.sqrt(group.each * group.variance(cells.observed))[chosen]
    return list(blocks_of(group.force, inputs, cells.observed[chosen], std))


def problem_of(work: Search, force: str, count: int, names, most=None) -> Problem:
    """The first ``count`` groups of a force, and which coefficients are moved; ``most``
    cells of a group, evenly taken."""
    groups = work.groups[force][:count]
    blocks = [block for group in groups for block in _blocks(work, group, most)]
    limits = limits_of(force, [group.cells.inputs for group in groups])
    return work.problem.with_free(names).with_blocks(blocks, limits)


def _best_start(work: Search, force: str, count: int, names) -> np.ndarray:
    few = problem_of(work, force, count, names, _ENOUGH)
    starts = _starts_of(work, work.groups[force][count - 1])
    ends = [minimise(few, start, _TRIES, _ROUGHLY) for start in starts]
    return min(ends, key=lambda end: end.cost).u


def _learn_noise(work: Search, force: str, count: int, rows) -> float:
    """The noise of the newest group from its residuals; by how much it changed."""
    group = work.groups[force][count - 1]
    cells = group.cells
    predicted = row_values(work.problem, work.u, force, cells.inputs)
    residual = predicted - cells.observed
    before = group.variance(predicted)
    if rows is not None and group.given is None:
        some = rows.part(rows.chosen([group.pure]))
        of_rows = row_values(work.problem, work.u, force, some.inputs)
        group = replace(group, white=cells.white_law(some, of_rows))
    known = group.known(predicted)
    misfit = noise_law(residual, np.asarray(cells.inputs.fz), predicted, known)
    group = replace(group, misfit=misfit)
    work.groups[force][count - 1] = group
    return float(np.max(np.abs(np.sqrt(group.variance(predicted) / before) - 1)))


def _learn_weight(work: Search, force: str, count: int, names) -> None:
    """How many cells of the newest group count as one.

    Cells of a sweep miss the formula alike. The larger of two measures: their
    autocorrelation time along the slip, and by how much the slope of the deviance
    varies more from setting to setting than that of independent cells would.
    """
    group = replace(work.groups[force][count - 1], each=1.0)
    work.groups[force][count - 1] = group
    problem = work.problem.with_free(names).with_blocks(_blocks(work, group))
    residual, slopes = row_gradients(problem, work.u)
    setting = group.cells.setting
    parts = [residual[setting == code] for code in np.unique(setting)]
    by_setting = design_effect(residual, slopes[:, problem.free], setting)
    each = max(autocorrelation_time(parts), by_setting)
    work.groups[force][count - 1] = replace(group, each=each)


def _hold(work: Search, problem: Problem, end: Minimum) -> tuple[Problem, Minimum]:
    """What the rows do not tell goes back to the centre of its prior."""
    covariance = _covariance(work.covariance, problem, end.u)
    left = np.diagonal(covariance)
    moving = np.flatnonzero(problem.free)
    held = [problem.names[i] for i in moving if left[i] > _HELD]
    own = own_coefficients(problem.tire.version, problem.blocks[0].force)
    work.held = (work.held - set(own)) | set(held)
    u, at = end.u.copy(), np.isin(problem.names, held)
    u[at] = 0.0
    work.covariance[at], work.covariance[:, at] = 0.0, 0.0
    work.covariance[at, at] = 1.0
    moved = [problem.names[i] for i in moving if problem.names[i] not in held]
    problem = problem.with_free(moved)
    return problem, minimise(problem, u)


def _covariance(before: np.ndarray, problem: Problem, u: np.ndarray) -> np.ndarray:
    """Of u (p,): of what was moved, given the rest, and of the rest as before.

    With H the curvature of rows and priors, the moved ones m follow the known ones k by
    -H_mm^-1 H_mk.
    """
    moved, known = np.flatnonzero(problem.free), np.flatnonzero(~problem.free)
    curvature = curvature_at(problem, u)
    inverse = np.linalg.inv(curvature[np.ix_(moved, moved)] + np.eye(len(moved)))
    follows = -inverse @ curvature[np.ix_(moved, known)]
    covariance = before.copy()
    across = follows @ before[np.ix_(known, known)]
    covariance[np.ix_(moved, known)] = across
    covariance[np.ix_(known, moved)] = across.T
    covariance[np.ix_(moved, moved)] = inverse + across @ follows.T
    return covariance


def _note(work: Search, force: str, count: int, problem: Problem, end: Minimum):
    group = work.groups[force][count - 1]
    rmse = work.rmse(group)
    work.stages.append(
        Stage(
            name=_title(group),
            force=force,
            pure=group.pure,
            rows=int(np.sum(group.cells.rows)),
            cells=len(group.cells.rows),
            moved=int(np.count_nonzero(problem.free)),
            chi2=end.cost - float(end.u @ end.u),
            steps=end.steps,
            converged=end.converged,
            rmse=rmse,
            rmse_at_end=rmse,
        )
    )


def _starts_of(work: Search, group: Group) -> list[np.ndarray]:
    """First values of u; combined slip begins where pure slip, if there, ended."""
    problem = work.problem
    if any(stage.force == group.force for stage in work.stages):
        return [work.u]
    starts = [work.u] if work.near else []
    for values in first_values(group):
        u = work.u.copy()
        for i, name in enumerate(problem.names):
            if name in values and problem.free[i]:
                u[i] = problem.unit(name, values[name])
        starts.append(u)
    return starts
