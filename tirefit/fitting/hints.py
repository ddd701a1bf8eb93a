"""Columns that the residuals of a fit follow, and the models that have them."""

from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from tirefit.fitting.inference import Linearised
from tirefit.fitting.likelihood import CHANNEL_SLIP, FitProblem
from tirefit.fitting.noise import autocorrelation_time, effective_inflation

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
    some = np.linspace(0, problem.n - 1, min(problem.n, _ROWS)).astype(int)
    values = np.concatenate([np.asarray(at.values[name])[some] for name in at.mean])
    slopes = np.concatenate([np.asarray(at.slopes[name])[some] for name in at.mean])
    inputs = {k: problem.used(x) for k, x in problem.rows.inputs._asdict().items()}
    side = np.concatenate([np.sign(inputs[CHANNEL_SLIP[k]][some]) for k in at.mean])
    names = np.array([parameter.name for _, parameter in problem.layout.elements])
    shared = slopes @ (names[:, None] == np.unique(names))
    base = np.column_stack([np.ones(len(values)), shared, shared * side[:, None]])
    whole, known, found = float(values @ values), np.hstack([base, slopes]), []
    ends = {k: np.percentile(inputs[k], [2.5, 50, 97.5]) for k in _COLUMNS}
    left = [k for k, e in ends.items() if e[2] - e[0] > _VARIES * abs(e[1])]
    while left and whole > 0:
        more = {}
        for k in left:
            share = (inputs[k][some] - ends[k][1]) / (ends[k][2] - ends[k][0])
            share = np.tile(share, len(at.mean))[:, None]
            more[k] = np.hstack([known, base * share])
        explained = {k: _explained(values, known, more[k]) for k in left}
        best = max(left, key=lambda k: explained[k])
        if not explained[best] > _LEAST * whole:
            break
        left.remove(best)
        low, _, high = ends[best].tolist()
        found.append(Followed(best, low, high, explained[best] / whole))
        known = more[best]
    if not found:
        return Misfit()
    rest, _ = _remainder(values, known)
    run = np.tile(problem.used(problem.rows.run)[some], len(at.mean))
    time = None if time is None else np.tile(time[some], len(at.mean))
    inflation = effective_inflation(rest[:, None] * slopes, run, time)
    share = float(rest @ rest) / whole * problem.n / len(some)
    return Misfit(tuple(found), max(1.0, share * inflation))


def _explained(values, known, more) -> float:
    """Sum of squares that more columns explain; zero where that is not clear."""
    (before, fewer), (rest, rank) = _remainder(values, known), _remainder(values, more)
    explained, left = float(before @ before - rest @ rest), float(rest @ rest)
    effective = len(rest) / autocorrelation_time([rest])
    clear = effective * explained > chdtri(rank - fewer, _CHANCE) * max(left, 1e-300)
    return explained if clear else 0.0


def _remainder(values, columns):
    """What the columns (n, k) leave of the values (n,), and their rank."""
    solution, _, rank, _ = np.linalg.lstsq(columns, values)
    return values - columns @ solution, int(rank)
