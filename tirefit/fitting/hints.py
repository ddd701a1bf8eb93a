"""Columns that the residuals of a fit follow, and the models that have them."""

from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from tirefit.fitting.inference import Linearised
from tirefit.fitting.likelihood import FitProblem
from tirefit.fitting.noise import autocorrelation_time, effective_inflation

__all__ = ["Followed", "Misfit", "misfit_by_setting"]

_LOAD = {"brush": "brush-load"} | {f"brush-{k}": f"brush-load-{k}" for k in "dmnh"}
"""Brush of one stiffness and friction at every load -> the one that follows it."""

_COLUMNS = {
    "fz": ("load", "N", "mf61"),
    "v": ("speed", "m/s", "brush-h (or brush-n, brush-stribeck)"),
    "gamma": ("camber", "rad", "mf61"),
    "pressure": ("pressure", "Pa", "mf61"),
}
"""Inputs that a test is set to: name, unit, and the model that has it."""

_VARIES = 0.2
"""Relative spread of a column (central 95 %) from which it can show anything."""

_LEAST, _CHANCE = 0.1, 5e-5
"""Share of the residuals' variance, and probability by chance of a chi-square of that
size at the effective number of what is left, that are clear."""

_ROWS = 4096
"""Rows, evenly spread, that show a share of 0.1."""


class Followed(NamedTuple):
    """A column of the inputs that the residuals follow: the ends of its central 95 %,
    and the share of the residuals' variance that trends in it explain."""

    column: str
    low: float
    high: float
    share: float

    def sentence(self, model: str) -> str:
        """What the fitted model lacks, and which model has it."""
        name, unit, other = _COLUMNS[self.column]
        advice = f"{other} has the {name}; or fit parameters per run (per_run = true)"
        if self.column == "fz" and model in _LOAD:
            advice = f"{_LOAD[model]} lets stiffness and friction change with the load"
        return (
            f"the model lacks the {name}: {name}s from {self.low:.4g} to"
            f" {self.high:.4g} {unit}, and {100 * self.share:.0f} % of the residuals'"
            f" variance follows them: {advice}"
        )


class Misfit(NamedTuple):
    """The columns that the residuals follow, the one that explains most first.

    ``rows_per_one``: rows per independent row were the misfit not there, at the
    variance that the residuals have with it.
    """

    columns: tuple[Followed, ...] = ()
    rows_per_one: float = 1.0

    @property
    def share(self) -> float:
        """Of the residuals' variance."""
        return sum(one.share for one in self.columns)


def misfit_by_setting(problem: FitProblem, at: Linearised, time) -> Misfit:
    """The part of the residuals that follows columns of the inputs.

    A force that changes with a column leaves residuals like the column times an offset
    or the slope of a parameter, on both sides of zero slip alike or not (camber). Each
    further column is judged by what those before it leave. Empty with noise of the
    slip, where a row has no residual of its own.

    Args:
        at: of the used rows, at the estimate.
        time: of each row (n,), or None to take the order of the file.
    """
    if any(name not in at.values for name in at.mean):
        return Misfit()
    rows = np.linspace(0, problem.n - 1, min(problem.n, _ROWS)).astype(int)
    values = {name: np.asarray(at.values[name])[rows] for name in at.mean}
    slopes = {name: np.asarray(at.slopes[name])[rows] for name in at.mean}
    base = {name: _base(problem, slopes[name], rows) for name in at.mean}
    known = {name: np.hstack([base[name], slopes[name]]) for name in at.mean}
    whole = sum(float(part @ part) for part in values.values())
    open_columns, found = _varying(problem, rows), []
    while open_columns and whole > 0:
        tried = {
            column: {k: np.hstack([known[k], base[k] * share]) for k in base}
            for column, (_, _, share) in open_columns.items()
        }
        explained = {k: _explained(values, known, more) for k, more in tried.items()}
        best = max(explained, key=lambda column: explained[column][0])
        if not (explained[best][0] > _LEAST * whole and explained[best][1]):
            break
        low, high, _ = open_columns.pop(best)
        found.append(Followed(best, low, high, explained[best][0] / whole))
        known = tried[best]
    if not found:
        return Misfit()
    run = problem.used(problem.rows.run)[rows]
    time = None if time is None else time[rows]
    per_one = []
    for name, residual in values.items():
        rest, _ = _remainder(residual, known[name])
        inflation = effective_inflation(rest[:, None] * slopes[name], run, time)
        share = float(rest @ rest) / max(float(residual @ residual), 1e-300)
        per_one.append(share * inflation * problem.n / len(rows))
    return Misfit(tuple(found), max(1.0, *per_one))


def _base(problem: FitProblem, slopes, rows) -> np.ndarray:
    """Shapes (n, k) that residuals may take at one setting: an offset, and the slopes
    of the parameters (per run or not), as they are and turned over at zero slip."""
    names = [parameter.name for _, parameter in problem.layout.elements]
    shared = np.array([[n == one for one in dict.fromkeys(names)] for n in names])
    slopes = slopes @ shared
    slip = problem.used(getattr(problem.rows.inputs, problem.slip_name))[rows]
    offset = np.ones((len(rows), 1))
    return np.hstack([offset, slopes, slopes * np.sign(slip)[:, None]])


def _varying(problem: FitProblem, rows) -> dict[str, tuple]:
    """The columns that vary: low, high, and their values (n, 1) as shares of that."""
    varying = {}
    for name in _COLUMNS:
        column = problem.used(getattr(problem.rows.inputs, name))
        low, middle, high = np.percentile(column, [2.5, 50, 97.5])
        if high - low > _VARIES * abs(middle):
            share = (column[rows, None] - middle) / (high - low)
            varying[name] = float(low), float(high), share
    return varying


def _explained(values, known, more) -> tuple[float, bool]:
    """Sum of squares that more columns explain, and whether that is clear."""
    explained = left = effective = 0.0
    count = 0
    for name, residual in values.items():
        (before, fewer), (rest, rank) = (
            _remainder(residual, columns[name]) for columns in (known, more)
        )
        explained += float(before @ before - rest @ rest)
        left += float(rest @ rest)
        effective += len(rest) / autocorrelation_time([rest])
        count += rank - fewer
    clear = effective * explained > chdtri(count, _CHANCE) * max(left, 1e-300)
    return explained, bool(clear)


def _remainder(values, columns):
    """What the columns (n, k) leave of the values (n,), and their rank."""
    solution, _, rank, _ = np.linalg.lstsq(columns, values)
    return values - columns @ solution, int(rank)
