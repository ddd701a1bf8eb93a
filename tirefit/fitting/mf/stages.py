"""Fit a Magic Formula in stages, each force from its own rows.

F_x and F_y share no coefficient. Each is fitted to its rows of pure slip first. Its
rows of combined slip then move the other coefficients; those that pure slip determined
are kept. A moment also depends on the coefficients of the forces. Its stage takes these
as known within their errors and moves only its own coefficients, so a moment that the
formula describes badly does not worsen a force.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tirefit.fitting.mf.parts import PARTS, coefficients_of, own_coefficients
from tirefit.fitting.mf.rows import Group
from tirefit.fitting.mf.solve import (
    Problem,
    blocks_of,
    limit_of,
    minimise,
    normal_equations,
    row_gradients,
    row_values,
)
from tirefit.fitting.problem.noise import autocorrelation_time, design_effect, noise_law

_ENOUGH = 2048  # number of rows, evenly taken, by which the best of several starts is chosen
_TRIES, _ROUGHLY = 60, 0.01  # most passes, deviance left to gain, while the noise is estimated
_ROUNDS, _SETTLED = 10, 0.02  # of search and noise; the change of the noise that ends them
_DETERMINED = 0.5  # posterior over prior variance below which later stages keep a coefficient
_HELD = 0.98  # the same ratio above which the rows do not identify a coefficient

Progress = Callable[[str], None]


@dataclass
class Search:
    """The state of the search: u (p,), its covariance (p, p), and the stages done."""

    problem: Problem
    groups: dict[str, list[Group]]  # of each force
    u: np.ndarray
    covariance: np.ndarray
    stages: dict[str, bool] = field(default_factory=dict)  # stage -> whether it converged
    moved: set[str] = field(default_factory=set)  # coefficients that some stage moved
    held: set[str] = field(default_factory=set)  # those that the data do not identify

    def rows_per_one(self, force: str) -> float:
        """Number of rows of a force per independent row."""
        counts = [(len(group.rows.observed), group.each) for group in self.groups[force]]
        return sum(rows for rows, _ in counts) / sum(rows / each for rows, each in counts)


def search(
    problem: Problem, groups: Mapping[str, list[Group]], progress: Progress = lambda text: None
) -> Search:
    """Fit each force to its own rows, pure slip first; the moments after the forces.

    Args:
        problem: without rows; ``free`` marks the coefficients that are not fixed.
        groups: of every force in the data.
    """
    start = np.zeros(len(problem.names))
    work = Search(problem, {}, start, np.diag(problem.free.astype(float)))
    for force in (force for force in PARTS if force in groups):
        for group in groups[force]:
            progress(group.title)
            # In combined slip from the end of the stage of pure slip.
            values = [] if force in work.groups else first_values(group)
            starts = [problem.started(work.u, given) for given in values]
            _one_stage(work, group, starts, is_last=group is groups[force][-1])
    return work


def without(work: Search, gone: Mapping[str, Sequence[int]]) -> Search:
    """Fit the rows without some settings, from the end of a search.

    Args:
        gone: by force, the settings that are left out.
    """
    covariance = np.diag(work.problem.free.astype(float))
    left = Search(work.problem, {}, work.u.copy(), covariance)
    for force, whole in work.groups.items():
        kept = [
            replace(group, rows=group.rows.part(~np.isin(group.rows.setting, gone[force])))
            for group in whole
        ]
        groups = [group for group in kept if len(group.rows.observed)]
        for group in groups:
            _one_stage(left, group, [], is_last=group is groups[-1])
    return left


def _one_stage(work: Search, group: Group, starts: Sequence[np.ndarray], is_last: bool) -> None:
    """Fit a new group of a force together with the groups of that force before it.

    Args:
        starts: u (p,) to choose from; that of ``work`` if there is none.
        is_last: whether it is the last group of the force.
    """
    groups = work.groups.setdefault(group.force, [])
    groups.append(group)
    names = _to_move(work, group.force, is_last)
    if starts:
        few = problem_of(work, groups, names, _ENOUGH)
        ends = [minimise(few, start, _TRIES, _ROUGHLY) for start in starts]
        work.u = min(ends, key=lambda end: end.cost).z
    rows = group.rows
    for _ in range(_ROUNDS):
        work.u = minimise(problem_of(work, groups, names), work.u, _TRIES, _ROUGHLY).z
        predicted = row_values(work.problem, work.u, group.force, rows.inputs)
        law = noise_law(predicted - rows.observed, rows.column("fz"), predicted)
        before, group = group.variance(predicted), replace(group, law=law)
        groups[-1] = group
        if np.max(np.abs(np.sqrt(group.variance(predicted) / before) - 1)) < _SETTLED:
            break
    groups[-1] = group = replace(group, each=_rows_per_one(work, group, names))
    problem = problem_of(work, groups, names)
    end = minimise(problem, work.u)
    if is_last:  # hold what the rows do not identify at the centre of its prior
        left = np.diagonal(_covariance(work.covariance, problem, end.z))
        held, every = problem.free & (left > _HELD), np.array(problem.names)
        of_force = own_coefficients(problem.tire.version, group.force)
        work.held = (work.held - set(of_force)) | set(every[held].tolist())
        left_free = problem.with_free(every[problem.free & ~held].tolist())
        end = minimise(left_free, np.where(held, 0.0, end.z))
    work.u, work.moved = end.z, work.moved | set(names)
    # The covariance includes the held coefficients: the rows may determine them at this end.
    work.covariance = _covariance(work.covariance, problem, end.z)
    work.stages[group.title] = end.converged


def _to_move(work: Search, force: str, is_last: bool) -> list[str]:
    """The coefficients that a stage moves: those of pure slip; in combined slip all of
    the force except those that pure slip determined."""
    names, version = work.problem.names, work.problem.tire.version
    free = {n for n, is_free in zip(names, work.problem.free, strict=True) if is_free}
    of_force = [name for name in own_coefficients(version, force) if name in free]
    if is_last and not all(group.pure for group in work.groups[force]):
        variance = dict(zip(names, np.diagonal(work.covariance), strict=True))
        return [n for n in of_force if variance[n] > _DETERMINED or n not in work.moved]
    part = coefficients_of(version)
    return [name for name in of_force if part[name] == force]


def problem_of(
    work: Search, groups: Sequence[Group], names: Collection[str], most: int = 10**9
) -> Problem:
    """The problem of some groups of a force, with the coefficients ``names`` free; at
    most ``most`` rows of a group, evenly taken."""
    blocks = limit_of(groups[0].force, [group.rows.inputs for group in groups])
    for group in groups:
        count = len(group.rows.observed)
        chosen = np.linspace(0, count - 1, min(most, count)).astype(int)
        std = np.sqrt(group.each * group.variance(group.rows.observed))[chosen]
        some = group.rows.part(chosen)
        blocks += blocks_of(group.force, some.inputs, some.observed, std)
    return replace(work.problem.with_free(names), blocks=tuple(blocks))


def _rows_per_one(work: Search, group: Group, names: Collection[str]) -> float:
    """Number of rows of a group per independent row: the larger of the autocorrelation time of
    the residuals along the slip, and of the design effect of the settings on the slope of the
    deviance. The misfit of neighbouring rows of a sweep is correlated."""
    problem = problem_of(work, [replace(group, each=1.0)], names)
    residual, slopes = row_gradients(problem, work.u)
    setting = group.rows.setting
    parts = [residual[setting == code] for code in np.unique(setting)]
    by_setting = design_effect(residual, slopes[:, problem.free], setting)
    return max(autocorrelation_time(parts), by_setting)


def _covariance(before: np.ndarray, problem: Problem, u: np.ndarray) -> np.ndarray:
    """The covariance (p, p) of u after a stage. The known coefficients k keep theirs. The moved
    ones m have H_mm^-1 given k and change by -H_mm^-1 H_mk; H: curvature of rows and priors."""
    moved, known = np.flatnonzero(problem.free), np.flatnonzero(~problem.free)
    _, curvature, _ = normal_equations(problem, u, np.full(len(u), True))
    # Of a noise-free test the curvature spans 1e12: only a product with its own transpose
    # has no negative eigenvalue after rounding.
    root = np.linalg.cholesky(curvature[np.ix_(moved, moved)] + np.eye(len(moved)))
    root = np.linalg.inv(root)
    inverse = root.T @ root
    follows = -inverse @ curvature[np.ix_(moved, known)]
    covariance = before.copy()
    across = follows @ before[np.ix_(known, known)]
    covariance[np.ix_(moved, known)] = across
    covariance[np.ix_(known, moved)] = across.T
    covariance[np.ix_(moved, moved)] = inverse + across @ follows.T
    return covariance


_SHAPES: dict[str, tuple[dict[str, float], ...]] = {
    "fx": ({}, {"PCX1": 1.2}, {"PCX1": 1.8}),
    "fy": ({}, {"PCY1": 1.1}, {"PCY1": 1.8}),
    "mz": ({"QEZ1": -0.5}, {"QCZ1": 1.1, "QEZ1": -3.0}, {"QCZ1": 1.5, "QEZ1": -1.0}),
    "mx": ({}, {"QSX2": -1.0, "QSX3": 0.5, "QSX4": -1.0}, {"QSX2": 1.0, "QSX3": -0.5, "QSX4": 1.0}),
}
"""Shapes of the curves to start from. Curves with a peak, without a peak and with a
sharp peak belong to different local minima."""


def first_values(group: Group) -> list[dict[str, float]]:
    """Coefficients to start from, one set per shape: friction from the largest forces,
    and stiffness from the slope at small slips."""
    values, inputs, force = {}, group.rows.inputs, group.rows.observed
    if group.force in ("fx", "fy"):
        slip = np.asarray(inputs.sigma_x if group.force == "fx" else inputs.alpha)
        fz, size = np.asarray(inputs.fz), np.abs(slip)
        low = size <= max(np.quantile(size, 0.2), 0.1 * size.max())
        peak = float(np.clip(np.quantile(np.abs(force) / fz, 0.98), 0.1, 3.0))
        share = slip[low] * fz[low]
        slope = 1.2 * float(share @ force[low] / max(share @ share, 1e-12))
        slope = max(slope, peak / max(size.max(), 1e-6))
        # K = PKY1 F_z0 sin(2 arctan(F_z / (PKY2 F_z0))) at F_z = F_z0.
        at_nominal = np.sin(2 * np.arctan(1 / 2.5))
        values = {"PDY1": peak, "PKY1": -slope / at_nominal, "PKY2": 2.5}
        if group.force == "fx":
            values = {"PDX1": peak, "PKX1": slope}
    return [values | shape for shape in _SHAPES.get(group.force, ({},))]
