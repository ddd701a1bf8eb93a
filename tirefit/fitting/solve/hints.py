"""Find inputs that the residuals of a fit depend on."""

from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from tirefit.fitting.problem.likelihood import CHANNEL_SLIP, FitProblem
from tirefit.fitting.problem.noise import CHANCE, autocorrelation_time, effective_inflation
from tirefit.fitting.solve.inference import Linearised

_COLUMNS = {
    "fz": ("load", "N"),
    "v": ("speed", "m/s"),
    "gamma": ("camber", "rad"),
    "pressure": ("pressure", "Pa"),
}
"""Input that a test varies -> its name and its unit."""

_VARIES = 0.2  # smallest relative range (central 95 %) of a column that is tested

_LEAST = 0.1
"""A trend counts if it explains this share of the residuals' variance, and if its
chi-square at the effective number of residuals has less than :data:`CHANCE` of probability."""

_ROWS = 4096  # largest number of rows, evenly taken: enough to find a share of 0.1


class Followed(NamedTuple):
    """A column that the residuals depend on: the ends of its central 95 %, and the
    share of the residuals' variance that trends in it explain."""

    column: str
    low: float
    high: float
    share: float

    @property
    def sentence(self) -> str:
        """The dependence that the fitted model does not describe."""
        name, unit = _COLUMNS[self.column]
        return (
            f"the model does not describe how the force depends on the {name}: for"
            f" {name}s from {self.low:.4g} to {self.high:.4g} {unit}, trends with it explain"
            f" {100 * self.share:.0f} % of the variance of the residuals"
        )


class Misfit(NamedTuple):
    """The columns that the residuals depend on, the strongest first."""

    columns: tuple[Followed, ...] = ()
    rows_per_one: float = 1.0  # independent row, without trends at their variance


def misfit_by_setting(problem: FitProblem, at: Linearised, time: np.ndarray | None) -> Misfit:
    """Select the columns that the residuals depend on, by forward selection.

    If a force varies with a column, its residuals resemble the column times a constant
    or times the derivative in a parameter, even or odd in the slip (camber). The result
    is empty with noise of the slip, as a row then has no residual of its own.

    Args:
        at: residuals and derivatives of the used rows at the estimate.
        time: time of each row (n,), or None to take the order of the file.
    """
    if any(name not in at.values for name in at.mean):
        return Misfit()
    some = np.linspace(0, problem.n - 1, min(problem.n, _ROWS)).astype(int)
    values = np.concatenate([np.asarray(at.values[name])[some] for name in at.mean])
    slopes = np.concatenate([np.asarray(at.slopes[name])[some] for name in at.mean])
    inputs = {k: problem.used(x) for k, x in problem.rows.inputs._asdict().items()}
    side = np.concatenate([np.sign(inputs[CHANNEL_SLIP[k]][some]) for k in at.mean])
    names = np.array([parameter.name for _, parameter in problem.layout.elements])
    shared = slopes @ (names[:, None] == np.unique(names))
    base = np.column_stack([np.ones(len(values)), shared, shared * side[:, None]])
    whole, known, columns = float(values @ values), np.hstack([base, slopes]), []
    ends = {k: np.percentile(inputs[k], [2.5, 50, 97.5]) for k in _COLUMNS}
    left = [k for k, e in ends.items() if e[2] - e[0] > _VARIES * abs(e[1])]

    def with_trends(k: str) -> np.ndarray:
        low, middle, high = ends[k]
        relative = np.tile((inputs[k][some] - middle) / (high - low), len(at.mean))
        return np.hstack([known, base * relative[:, None]])

    while left and whole > 0:
        (before, fewer), explained = remainder(values, known), {}
        for k in left:
            rest, rank = remainder(values, with_trends(k))
            gain, square = float(before @ before - rest @ rest), float(rest @ rest)
            effective = len(rest) / autocorrelation_time([rest])
            limit = chdtri(rank - fewer, CHANCE) * max(square, 1e-300)
            explained[k] = gain if effective * gain > limit else 0.0
        best = max(left, key=lambda k: explained[k])
        if not explained[best] > _LEAST * whole:
            break
        left.remove(best)
        low, _, high = ends[best].tolist()
        columns.append(Followed(best, low, high, explained[best] / whole))
        known = with_trends(best)
    if not columns:
        return Misfit()
    rest, _ = remainder(values, known)
    run = np.tile(problem.used(problem.rows.run)[some], len(at.mean))
    time = None if time is None else np.tile(time[some], len(at.mean))
    inflation = effective_inflation(rest[:, None] * slopes, run, time)
    share = float(rest @ rest) / whole * problem.n / len(some)
    return Misfit(tuple(columns), max(1.0, share * inflation))


def remainder(values: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, int]:
    """Residuals (n,) of a regression of the values on columns (n, k), and its rank."""
    solution, _, rank, _ = np.linalg.lstsq(columns, values)
    return values - columns @ solution, int(rank)
