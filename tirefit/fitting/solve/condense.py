r"""Groups of similar rows (cells) that replace the rows while a posterior is sampled.

If the model is smooth, rows with nearly the same inputs hold the same information on
the parameters. A cell replaces its rows at their mean input, with their mean residual
:math:`\bar r` at the estimate and their number n as its weight. With :math:`\Delta`,
the change of the force from the estimate to z in standard deviations,

.. math::
   \sum_i (r_i - \Delta_i)^2 = \sum_i r_i^2 - n \bar r^2 + n (\bar r - \Delta)^2

except for the variation of :math:`\Delta_i` within the cell. Terms that do not depend on
z are kept as a number. The error is therefore a share of the change of the deviance, for
any number of rows. The cells are cut where :math:`\Delta` varies most, over points in
the range of the posterior. If the deviance of a row is not a square (a robust loss, noisy
slip), cells are also cut by the residual. The deviance itself shows if they are accurate.
"""

import heapq
import itertools
from collections.abc import Iterable
from functools import partial

import jax
import numpy as np
from jaxtyping import Float, Int

from tirefit.arrays import Numbers
from tirefit.fitting.problem.likelihood import FitProblem, moments, root_deviance, row_moments
from tirefit.fitting.result import FitResult
from tirefit.fitting.solve.inference import deviance, linearise
from tirefit.fitting.solve.multistart import Solved
from tirefit.padding import pad_rows
from tirefit.params import Values

FEWEST = 4096  # smallest number of rows that are condensed; fewer are as fast as cells

_REACH = 2.5  # standard deviations at which the change of the force is computed

_TRIES = ((512, 1e-3), (2048, 2.5e-4), (8192, 6e-5))
"""Largest number of cells, and share of the squared change that may be lost in them. It is
a share of the information on the parameters: the first is 0.05 % of a standard deviation.
There are few numbers of cells, as each needs a compiled program."""

_CLOSE = 0.05
"""Largest error of the log density by cells, at points where it has fallen by 3."""

_MOVES = 3
"""Steps that give cells the slope of the rows; one is enough if deviances are squares."""

_COMPARED = 64


def condensed(solved: Solved, root: Float[np.ndarray, "p p"]) -> FitProblem | None:
    """The problem with cells instead of rows; None if cells are not accurate enough.

    Args:
        solved: the least-squares fit.
        root: (p, p) columns of one standard deviation along the axes of the posterior.

    The model must apply to single rows; a transient one applies to whole series.
    """
    problem, z = solved.problem, solved.z
    if problem.n < FEWEST or problem.model.transient:
        return None
    points = z + _REACH * np.concatenate([root.T, -root.T])
    there = _deviances(problem, z, points)
    for most, share in _TRIES:
        cells = cells_of(solved, points, most, share)
        if 2 * cells.n > problem.n:
            return None
        error = np.abs(_deviances(cells, z, points) - there) / 2
        if np.all(error <= _CLOSE * np.maximum(there / 6, 1)):
            return cells
    return None


def apart(sampled: FitResult, cells: FitProblem) -> float:
    """Standard deviation of the error of the log density by cells, over some draws of
    a posterior; zero without draws."""
    if sampled.chains is None:
        return 0.0
    flat = sampled.chains.reshape(-1, sampled.chains.shape[-1])
    some = flat[np.linspace(0, len(flat) - 1, _COMPARED).astype(int)]
    points = cells.layout.unconstrained(dict(zip(sampled.labels, some.T, strict=True))).T
    errors = [deviance(cells, z) - deviance(sampled.problem, z) for z in points]
    return float(np.std(errors) / 2)


def _deviances(
    problem: FitProblem, z: Float[Values, " p"], points: Iterable[np.ndarray]
) -> np.ndarray:
    base = float(deviance(problem, z))
    return np.array([float(deviance(problem, point)) - base for point in points])


def cells_of(
    solved: Solved, points: Float[np.ndarray, "k p"], most: int, share: float
) -> FitProblem:
    """The problem with at most ``most`` cells for its rows.

    Args:
        points: (k, p) values of z, over which the rows of a cell must change equally.
        share: of the squared change that may be lost; fewer cells are used if possible.
    """
    problem = solved.problem
    group = problem.used(problem.rows.run) * problem.layout.is_sparse
    code = _codes(_places(solved), _changes(solved, points), group, most, share)
    return _of_cells(solved, code, most)


def _is_plain(problem: FitProblem) -> bool:
    return problem.loss == "squares" and not problem.rows.nodes


def _places(solved: Solved) -> Float[np.ndarray, "n d"]:
    """Coordinates by which rows are grouped: inputs, and residuals if they have slip noise."""
    problem = solved.problem
    columns = [problem.used(column) for column in problem.rows.inputs]
    columns += [problem.used(std) for std in problem.rows.slip_std.values()]
    if not _is_plain(problem):
        columns += list(_residuals(solved).values())
        columns += [problem.used(scale) for scale in problem.rows.scale.values()]
    varying = [column for column in columns if np.ptp(column) > 0]
    return np.stack(varying or columns[:1], axis=1)


def _residuals(solved: Solved) -> dict[str, np.ndarray]:
    """Residuals (n,) of each force at the estimate, in its unit."""
    problem = solved.problem
    return {
        name: problem.used(observed) - solved.at.mean[name]
        for name, observed in problem.rows.observed.items()
    }


def _changes(solved: Solved, points: Iterable[np.ndarray]) -> Float[np.ndarray, "n m"]:
    """The change of each row from the estimate to each point: of forces in standard
    deviations of a common row, or of deviances if these are not squares."""
    problem, at, changes = solved.problem, solved.at, []
    for point in points:
        if _is_plain(problem):
            mean, _ = row_moments(problem, point)
            for name, force in mean.items():
                precision = np.mean(problem.used(problem.rows.scale[name]) ** -2)
                changes.append((force - at.mean[name]) * np.sqrt(precision))
            continue
        for name, block in root_deviance(problem, point).items():
            changes.append(problem.used(block) ** 2 - at.values[name] ** 2)
    return np.stack(changes, axis=1)


def _codes(
    place: np.ndarray, change: np.ndarray, group: np.ndarray, most: int, share: float
) -> Int[np.ndarray, " n"]:
    """The cell of each row. Cells are cut one by one: always the cell with the largest loss."""
    number = itertools.count()
    queue: list[tuple[float, int, np.ndarray]] = []  # - loss, number, rows of each cell
    whole: list[tuple[float, int, np.ndarray]] = []  # those of one place

    def add(rows: np.ndarray) -> float:
        loss = _loss(change[rows])
        heapq.heappush(queue, (-loss, next(number), rows))  # the smallest is popped first
        return loss

    lost = sum(add(np.flatnonzero(group == code)) for code in np.unique(group))
    bearable = share * float(np.sum(change**2))
    while queue and len(queue) + len(whole) < most and lost > bearable:
        least, _, rows = cell = heapq.heappop(queue)
        where = _best_cut(place[rows], change[rows])
        if where is None:
            whole.append(cell)
            continue
        axis, middle = where
        above = place[rows, axis] > middle
        lost += least + add(rows[~above]) + add(rows[above])
    code = np.empty(len(place), int)
    for k, (_, _, rows) in enumerate(sorted([*whole, *queue], key=lambda cell: cell[1])):
        code[rows] = k
    return code


def _loss(change: np.ndarray) -> float:
    return float(np.sum((change - change.mean(axis=0)) ** 2))


def _best_cut(place: np.ndarray, change: np.ndarray) -> tuple[int, float] | None:
    """The axis along which the largest change varies most, by a parabola, and the mean
    coordinate of the rows along it; None if all rows are in one place."""
    centred = change - change.mean(axis=0)
    most = centred[:, np.argmax(np.sum(centred**2, axis=0))]
    middle = place.mean(axis=0)
    straight = place - middle
    spread = np.mean(straight**2, axis=0)
    wide = spread > 1e-24 * np.max(np.abs(place), axis=0) ** 2
    if not np.any(wide):
        return None
    safe = np.where(wide, spread, 1.0)
    curved = straight**2 - spread - np.mean(straight**3, axis=0) / safe * straight
    explained = np.zeros(len(middle))
    for part in (straight, curved):
        size = np.sum(part**2, axis=0)
        slope = (most @ part) ** 2 / np.where(size > 0, size, 1.0)
        explained += np.where(size > 0, slope, 0.0)
    axis = int(np.argmax(np.where(wide, explained, -1.0)))
    return axis, float(middle[axis])


def _of_cells(solved: Solved, code: Int[np.ndarray, " n"], size: int) -> FitProblem:
    """The problem with a row for each cell, padded to ``size``."""
    problem, rows = solved.problem, solved.problem.rows
    count = np.bincount(code)
    given = count > 0
    precision = {k: 1 / problem.used(v) ** 2 for k, v in rows.scale.items()}
    whole = np.sum([v / v.mean() for v in precision.values()], axis=0)

    def mean(values: Numbers, weight: np.ndarray = whole) -> np.ndarray:
        if np.ndim(values) > 1:
            columns = np.moveaxis(problem.used(values), -1, 0)
            return np.stack([mean(column, weight) for column in columns], axis=-1)
        total = np.bincount(code, problem.used(values) * weight)
        return total[given] / np.bincount(code, weight)[given]

    padded, number = partial(pad_rows, size=size), count[given]
    residual = {k: mean(v, precision[k]) for k, v in _residuals(solved).items()}
    weight = np.zeros(size)
    weight[: len(number)] = np.sqrt(number)
    small = problem.with_rows(
        inputs=type(rows.inputs)(*(padded(mean(column)) for column in rows.inputs)),
        run=padded(np.rint(mean(rows.run)).astype(int)),
        weight=weight,
        observed={name: padded(values) for name, values in residual.items()},
        scale={k: padded(mean(v, np.ones(len(v))) ** -0.5) for k, v in precision.items()},
        slip_std={k: padded(mean(v)) for k, v in rows.slip_std.items()},
        nodes={
            k: jax.tree.map(lambda values: padded(mean(values)), v) for k, v in rows.nodes.items()
        },
    )
    force = linearise(small, solved.z).mean
    observed = {name: padded(r) + force[name] for name, r in residual.items()}
    return _with_the_same_slope(solved, small.with_rows(observed=observed))


def _with_the_same_slope(solved: Solved, small: FitProblem) -> FitProblem:
    """The cells with shifted forces, so that their deviance has the slope and the value of
    that of the rows at the estimate.

    Shifting the forces by the change of the model for a step in z moves the best fit by
    that step.
    """
    z, steps = solved.z, np.diag(1e-3 * np.sqrt(np.diag(solved.covariance)))
    # Slopes (n, p) of each force over z, including padding rows.
    ends = [[moments(small, z + side * step)[0] for side in (1, -1)] for step in steps]
    slopes = {
        name: np.stack([above[name] - below[name] for above, below in ends], axis=1)
        / (2 * np.diag(steps))
        for name in small.rows.observed
    }
    for _ in range(_MOVES):
        at = linearise(small, z)
        observed = {k: np.array(force) for k, force in small.rows.observed.items()}
        for name in small.rules:
            of_rows, of_cells = np.asarray(solved.at.slopes[name]), np.asarray(at.slopes[name])
            # Half the slopes of the deviances, and half the curvature of that of the rows.
            wanted, here = of_rows.T @ solved.at.values[name], of_cells.T @ at.values[name]
            if name in small.rows.nodes:
                of_rows = of_rows * solved.at.values[name][:, None]
            step = np.linalg.lstsq(of_rows.T @ of_rows, here - wanted)[0]
            for channel in small.block_channels(name):
                observed[channel.name] += slopes[channel.name] @ step
        small = small.with_rows(observed=observed)
    at = linearise(small, z)
    rules = {}
    for name, rule in solved.problem.rules.items():
        beside = np.sum(solved.at.values[name] ** 2) - np.sum(at.values[name] ** 2)
        rules[name] = rule._replace(within=float(beside))
    return small.with_rules(rules)
