r"""Outliers: rows far outside the noise about the prediction of the other rows.

The noise of a fit is taken as normal, except for a few rows in a hundred with any kind
of error: a wrong unit, a wrong sign, a stuck channel. The deviance of a row is then

.. math::
   \min(r^2, c^2)

of its standardised residual r: squares up to the distance c, and constant beyond. The rows beyond c
are excluded and listed; the others are fitted as if there were no more, so that intervals, profiles
and posteriors are those of normal noise. The distance c grows with the number of rows so that fewer
than one in 200 clean files loses a row: clean data are fitted by plain least squares.

Each row is compared with what the *other* rows predict for it, with the uncertainty of
that prediction: a row that alone determines a parameter is kept, however extreme its
slip or load. The scale is that of the smallest 90 % of the residuals, or of the row's
neighbours in slip and load where that is larger: rows that miss the curve together
show a wrong model, not outliers. A row is excluded by this rule alone, with one exception: a
load far from all others is always excluded. Other values far from their column (``data.far``) are
excluded in the first fit only, and name the column in the report.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri, stdtrit

from tirefit.data.far import FAR_COLUMNS, FarValue, far_values, problem_at, why_far
from tirefit.data.table import CANONICAL, TireData
from tirefit.fitting.problem.build import FitTask, build
from tirefit.fitting.problem.config import FitConfig
from tirefit.fitting.problem.likelihood import CHANNEL_SLIP
from tirefit.fitting.problem.noise import MAD
from tirefit.fitting.solve.inference import REACH
from tirefit.fitting.solve.multistart import Solved, on_rows, solve_problem
from tirefit.results import InputProblem
from tirefit.slip import LOCKED

_CHANCE = 0.005  # share of clean data sets that may lose a row
_TAILS = 30
"""Largest number of degrees of freedom of the Student's t assumed for the noise: tails
of measured noise are slightly heavier than normal, and a long log may well have a row
at six standard deviations. The distance is 4.7 at 80 rows, 7 at 50,000."""
_MOST = 0.1
"""Largest share of rows that are excluded; more rows than this are not outliers."""
_ROUNDS = 8
_NEAR, _MISSED = 6, 2.0
"""Number of neighbours, and standard deviations: where the median residual of the
neighbours is larger, the row is compared with it, as all miss the curve together."""
_ON_A_LINE = np.sqrt(1.5)
"""Standard deviation of a residual from the mean of two others."""
_AROUND, _LOUDER = 30, 1.4
"""Number of neighbours, and ratio: where the noise of the neighbours exceeds that of all
rows by this ratio, it is used instead."""
_REMEMBERED = 30
"""Rows on either side that an error in one row of a transient tire may affect."""
_ROUNDING = 1e-6  # share of a force's range below which no deviation is an outlier
_LOAD_STEP = 0.1  # loads whose logarithms differ by less are alike, ...
_SLIP_STEP = 0.02  # ... and so are values of the slip across the force.


@dataclass(frozen=True)
class FarRow:
    """An outlier, and whether it was excluded."""

    file: str
    row: int  # line of the file
    column: str  # where to look first
    value: float
    force: str
    predicted: float  # ``force`` by the other rows
    distance: float  # from that, in standard deviations
    set_aside: bool
    reason: str
    remedy: str

    def __str__(self) -> str:
        place = InputProblem(self.reason, self.remedy, self.file, self.row, self.column)
        return str(place)


class Settled(NamedTuple):
    """A fit without the excluded rows."""

    task: FitTask
    solved: Solved
    outliers: tuple[FarRow, ...]
    limit: float
    note: str


class _Judged(NamedTuple):
    """How far the rows lie from what the others predict: by channel (k, n)."""

    distance: np.ndarray  # in standard deviations
    ratio: np.ndarray  # of this distance, less that of the neighbours, to the limit
    predicted: np.ndarray  # force


def settle(data: TireData, name: str, config: FitConfig) -> Settled:
    """Solve a fit without outliers.

    Values far from the others of their column are excluded at first: a transient tire remembers a
    wrong slip. Rows are then excluded and restored until the set is stable. With a loss other than
    ``trimmed`` all rows are kept, and the outliers are only listed.

    Raises:
        UsageError, DataError: as ``problem.build``.
    """
    whole = build(data, name, config)
    suspects, trims = _suspects(whole), config.noise.loss == "trimmed"
    # Standard deviations that a row of clean data exceeds with probability ``_CHANCE``.
    values = whole.problem.n * len(whole.problem.channels)
    dof = min(max(values - whole.problem.layout.size - 1, 1), _TAILS)
    limit = float(stdtrit(dof, 1 - _CHANCE / (2 * values)))
    most = max(1, int(_MOST * whole.problem.n))
    first = np.zeros(whole.problem.n, bool)
    first[list(suspects)] = trims and len(suspects) <= most
    kept = ~_leaving_runs(first, whole)
    for _ in range(_ROUNDS):
        task, solved = _fitted(whole, kept, config)
        judged = _judge(whole, task, solved, kept, limit)
        ratio = np.max(judged.ratio, axis=0)
        # At small slip the force hardly depends on the load: a wrong load may agree by chance.
        ratio[[i for i, value in suspects.items() if value.column == "fz"]] = np.inf
        if whole.problem.model.transient:
            from scipy.ndimage import maximum_filter1d  # for transient tires alone

            # One wrong slip affects a transient tire for a while: only the worst row counts.
            worst = maximum_filter1d(np.where(kept, ratio, 0.0), 2 * _REMEMBERED + 1)
            ratio = np.where(kept & (ratio < worst), np.minimum(ratio, 1.0), ratio)
        beyond = _leaving_runs(ratio > 1, whole)
        order = np.argsort(np.where(beyond, -ratio, 0.0), kind="stable")
        others = np.ones_like(beyond)  # than the farthest rows beyond the limit
        others[order[: min(most, np.count_nonzero(beyond))]] = False
        if not trims or np.array_equal(others, kept):
            break
        kept = others
    else:
        task, solved = _fitted(whole, kept, config)
    note = ""
    if trims and beyond.sum() > most:
        note = (
            f"{beyond.sum()} of {whole.problem.n} rows lie further than {limit:.1f}"
            " standard deviations from what the others predict: too many to exclude"
        )
        kept[:] = True
        task, solved = _fitted(whole, kept, config)
    rows = sorted({*np.flatnonzero(beyond | ~kept).tolist(), *suspects})
    outliers = [
        _far_row(whole, judged, i, bool(kept[i]), bool(beyond[i]), suspects.get(i)) for i in rows
    ]
    return Settled(task, solved, tuple(outliers), limit, note)


def _suspects(task: FitTask) -> dict[int, FarValue]:
    """Values far from the others in a column that the fit uses, by position of the row.

    If a row has several, the first column of ``FAR_COLUMNS`` counts: a wrong load also
    makes the force in its row look wrong.
    """
    channels = task.problem.channels
    used = {"fz", *task.problem.model.needs}
    used |= {c.name for c in channels} | {CHANNEL_SLIP[c.name] for c in channels}
    position = np.cumsum(task.data.used) - 1
    suspects: dict[int, FarValue] = {}
    values = far_values(task.data, [c for c in FAR_COLUMNS if c in used], locking=False)
    for value in sorted(values, key=lambda value: FAR_COLUMNS.index(value.column)):
        suspects.setdefault(int(position[value.row]), value)
    return suspects


def _leaving_runs(aside: np.ndarray, task: FitTask) -> np.ndarray:
    """Rows to exclude, except in runs that would lose half of their rows."""
    run = task.problem.used(task.problem.rows.run)
    share = np.bincount(run, aside) / np.maximum(np.bincount(run), 1)
    return aside & (share <= 0.5)[run]


def _fitted(whole: FitTask, kept: np.ndarray, config: FitConfig) -> tuple[FitTask, Solved]:
    if kept.all():
        return whole, solve_problem(whole, config)
    rows = np.zeros(len(whole.data), bool)
    rows[np.flatnonzero(whole.data.used)[kept]] = True
    # Padded to the size of all rows, so that one program serves both.
    task = build(whole.data.where(rows), whole.name, config, len(whole.problem.rows.weight))
    return task, solve_problem(task, config)


def _judge(
    whole: FitTask, task: FitTask, solved: Solved, kept: np.ndarray, limit: float
) -> _Judged:
    """Distances of all rows from what a fit of the kept rows predicts."""
    problem, at = solved.problem, solved.at
    if not kept.all():
        problem, at = on_rows(whole, kept, task, solved)
    # R with R R' the covariance of z if all rows are independent.
    parts = [v if k == "prior" else v[kept] for k, v in at.slopes.items()]
    values, vectors = np.linalg.eigh(sum(part.T @ part for part in parts))
    root = vectors / np.sqrt(np.maximum(values, 1 / REACH**2))
    by_channel = []
    for channel in problem.channels:
        slopes = at.slopes[problem.block_of(channel)] @ root
        share = np.sum(slopes**2, axis=1)
        unit = np.sqrt(at.variance[channel.name])
        observed = problem.used(problem.rows.observed[channel.name])
        residual = (observed - at.mean[channel.name]) / unit
        if problem.block_channels(channel.slip) == (channel,):
            # The density of the force at the measured slip is not normal where the curve
            # bends within the noise of the slip.
            std = problem.used(problem.rows.scale[channel.name])
            unlikely = at.unlikely[channel.slip] - np.log(at.variance[channel.name] / std**2)
            residual = np.sign(residual) * np.sqrt(np.maximum(unlikely, 0.0))
        # A kept row pulls the fit towards itself, so its residual is too small.
        spread = np.where(kept, np.maximum(1 - share, _ROUNDING), 1 + share)
        off = np.nan_to_num(residual / np.sqrt(spread), nan=np.inf)
        floor = _ROUNDING * np.ptp(observed[kept]) / np.median(unit[kept])
        scale = max(_scale(np.abs(off[kept])), floor, np.finfo(float).tiny)
        off /= scale if channel.noise_estimated else max(scale, 1.0)
        ratio = np.abs(off) / limit
        beyond = np.flatnonzero(ratio > 1)
        if len(beyond):
            order = _by_state(whole.data, CHANNEL_SLIP[channel.name])
            ratio[beyond] = _beside(beyond, off, order, kept) / limit
        by_channel.append((np.abs(off), ratio, at.mean[channel.name]))
    return _Judged(*map(np.array, zip(*by_channel, strict=True)))


def _scale(off: np.ndarray) -> float:
    """Standard deviation of normal noise, from the smallest nine in ten distances (m,);
    the others have no influence."""
    count = max(int(np.ceil((1 - _MOST) * len(off))), 1)
    share = count / len(off)
    end = ndtri((1 + min(share, 1 - 1e-9)) / 2)
    density = np.exp(-(end**2) / 2) / np.sqrt(2 * np.pi)
    part = np.partition(off, count - 1)[:count]
    return float(np.sqrt(np.mean(part**2) / (1 - 2 * end * density / share)))


def _beside(rows: np.ndarray, off: np.ndarray, order: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Distances of some rows, less those of their neighbours, (m,).

    Args:
        rows: (m,) rows to compute.
        off: (n,) signed distances, in standard deviations.
        order: (n,) indices that put neighbours next to each other.
        counts: (n,) bool, the rows that may be neighbours.
    """
    members, is_member = order[counts[order]], counts[rows].astype(int)
    before = np.empty(len(order), int)
    before[order] = np.cumsum(counts[order]) - counts[order]
    before = before[rows]

    def near(most: int) -> np.ndarray:
        size = min(most, len(members) - 1)
        start = np.clip(before - size // 2, 0, len(members) - is_member - size)
        at = start[:, None] + np.arange(size)
        return off[members[at + ((at >= before[:, None]) & (is_member[:, None] > 0))]]

    after = before + is_member
    inner = (before > 0) & (after < len(members))
    ends = members[before - 1], members[np.minimum(after, len(members) - 1)]
    line = np.where(inner, (off[ends[0]] + off[ends[1]]) / 2, 0.0)
    left = np.abs(off[rows])
    for missed, wider in ((np.median(near(_NEAR), axis=1), 1.0), (line, _ON_A_LINE)):
        beside = np.abs(off[rows] - missed) / wider
        left = np.where(np.abs(missed) > _MISSED, np.minimum(left, beside), left)
    louder = MAD * np.median(np.abs(near(_AROUND)), axis=1)
    return left / np.where(louder > _LOUDER, louder, 1.0)


def _by_state(data: TireData, slip: str) -> np.ndarray:
    """Order (n_used,) of the used rows by run, load, the other slip, and slip: neighbours
    in it were measured in similar states."""
    load = np.round(np.log(data.usable("fz")) / _LOAD_STEP)
    other = {"sigma_x": "alpha", "alpha": "sigma_x"}[slip]
    across = data.usable(other) if other in data else np.zeros(data.n)
    alike = np.round(np.minimum(across, LOCKED) / _SLIP_STEP)
    return np.lexsort((data.usable(slip), alike, load, data.run[data.used]))


_REMEDY = "correct or delete the row"
_KEEP = f"{_REMEDY}, or keep it with noise.loss = 'squares'"


def _far_row(
    whole: FitTask, judged: _Judged, i: int, kept: bool, beyond: bool, suspect: FarValue | None
) -> FarRow:
    problem, channel = whole.problem, int(np.argmax(judged.ratio[:, i]))
    force, inputs = problem.channels[channel].name, problem.rows.inputs
    slip, unit = CHANNEL_SLIP[force], CANONICAL[force][0]
    columns = problem.rows.observed[force], getattr(inputs, slip), inputs.fz
    measured, at, load = (float(problem.used(values)[i]) for values in columns)
    predicted, distance = (float(of[channel, i]) for of in (judged.predicted, judged.distance))
    column, value = (force, measured) if suspect is None else suspect[1:3]
    off = (
        f"{force} = {measured:.6g} {unit} at {slip} = {at:.4g}, fz = {load:.6g} N is"
        f" {distance:.3g} standard deviations from the {predicted:.4g} {unit} that the"
        " other rows predict"
    )
    messages = [] if suspect is None else [why_far(suspect)]
    if beyond or not kept or suspect is not None:
        messages.append(off)
    remedy = _KEEP if not kept else _REMEDY if beyond else "check the row"
    row = int(np.flatnonzero(whole.data.used)[i])
    place = problem_at(whole.data, row, column, "; ".join(messages), remedy)
    return FarRow(
        place.file, place.row or 0, place.column or column, value, force, predicted,
        distance, not kept, place.reason, place.remedy,
    )  # fmt: skip
