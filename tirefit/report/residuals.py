"""Residuals over every input, their distribution and their sequence, as arrays."""

from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from tirefit.data.run_names import clipped, run_names
from tirefit.data.table import TireData
from tirefit.fitting.likelihood import CHANNEL_SLIP
from tirefit.fitting.residuals import means_by, means_over, ordered_correlation, standardised
from tirefit.fitting.result import FitResult
from tirefit.report.curves import slip_axis
from tirefit.report.numbers import plain_text

_INDEPENDENT = 0.9
"""Effective share of the rows above which their order in the file has no meaning."""
_MOST_RUNS = 30  # largest number of runs for a panel of runs
_TICK = 12  # largest length of the name of a run below an axis
_LABEL = {
    "fz": ("load $F_z$", "N"),
    "v": ("speed $v$", "m/s"),
    "time": ("time", "s"),
    "gamma": (r"camber $\gamma$", "deg"),
    "pressure": ("pressure", "kPa"),
    "temperature": ("temperature", "°C"),
}
_SHOWN = {"gamma": 180 / np.pi, "pressure": 1e-3}


class Scatter(NamedTuple):
    """Standardised residuals against one input: points (n,), and means over bins (k,)."""

    label: str
    x: np.ndarray
    residual: np.ndarray
    center: np.ndarray
    mean: np.ndarray
    half: np.ndarray  # half-width of the 95 % interval of a bin's mean
    ticks: tuple[str, ...]  # values of a categorical input, empty for a number


class Residuals(NamedTuple):
    """All panels of one force; autocorrelations are None if the rows have no order."""

    channel: str
    scatters: tuple[Scatter, ...]
    edges: np.ndarray
    density: np.ndarray
    normal: np.ndarray  # (n,) quantiles of a standard normal for ``ordered``
    ordered: np.ndarray  # (n,) sorted residuals
    lags: np.ndarray | None
    correlation: np.ndarray | None
    limit: float  # of the correlation, 95 % under independence


def _fitted_rows(problem, data: TireData | None) -> np.ndarray | None:
    """The rows (len(data),) bool of the table that the fit used, None if unknown.

    A fit may be limited to an interval of slip, found from its smallest and largest slip.
    """
    if data is None:
        return None
    name = problem.slip_name
    slip = problem.used(getattr(problem.rows.inputs, name))
    with np.errstate(invalid="ignore"):
        rows = data.used & (data[name] >= slip.min()) & (data[name] <= slip.max())
    return rows if np.count_nonzero(rows) == problem.n else None


def _inputs(result: FitResult, slip: str) -> dict[str, tuple[str, np.ndarray]]:
    """Input -> (label, values as drawn (n,)) of every input that varies."""
    problem = result.problem
    inputs = problem.rows.inputs
    shown = {}
    for name in dict.fromkeys((slip, "sigma_x", "alpha")):
        values = problem.used(getattr(inputs, name))
        axis = slip_axis(name, values)
        shown[name] = (f"{axis.label} [{axis.unit}]", axis.shown(values))
    columns = {"fz": problem.used(inputs.fz), "v": problem.used(inputs.v)}
    rows = _fitted_rows(problem, result.table)
    if rows is not None:
        others = [name for name in _LABEL if name in result.table]
        columns.update({name: result.table[name][rows] for name in others})
    for name in _LABEL:
        if name in columns:
            label, unit = _LABEL[name]
            shown[name] = (f"{label} [{unit}]", columns[name] * _SHOWN.get(name, 1.0))
    return {
        name: (label, values)
        for name, (label, values) in shown.items()
        if np.all(np.isfinite(values)) and np.ptp(values) > 1e-6 * max(np.max(np.abs(values)), 1e-9)
    }


def _in_order(result: FitResult, residual, inputs) -> np.ndarray | None:
    """Autocorrelation in the order of time, or of the file; None without an order."""
    problem, statistics = result.problem, result.statistics
    time = inputs["time"][1] if "time" in inputs else None
    if time is None and statistics.n_effective > _INDEPENDENT * statistics.n:
        return None
    return ordered_correlation(residual, problem.used(problem.rows.run), time)


def _runs(result: FitResult, residual, inflation: float) -> list[Scatter]:
    problem = result.problem
    codes, position = np.unique(problem.used(problem.rows.run), return_inverse=True)
    if not 1 < len(codes) <= _MOST_RUNS:
        return []
    # Next to each other, so that points of a run do not overlap.
    spread = np.random.default_rng(0).uniform(-0.25, 0.25, len(position))
    means = means_by(position, position, residual, inflation)
    short = run_names(problem.layout.runs).short
    names = tuple(plain_text(clipped(short[int(code)], _TICK)) for code in codes)
    return [Scatter("run", position + spread, residual, *means, names)]


def residual_panels(result: FitResult, channel: str | None = None) -> Residuals:
    """Standardised residuals of one force over every input that varies.

    Args:
        result: a fit with its problem.
        channel: a fitted force; the first one if None.
    """
    problem = result.problem
    channel = channel or problem.channels[0].name
    residual = standardised(result, channel)
    inflation = max(result.statistics.n / max(result.statistics.n_effective, 1), 1.0)
    inputs = _inputs(result, CHANNEL_SLIP[channel])
    scatters = [
        Scatter(label, x, residual, *means_over(x, residual, inflation), ())
        for label, x in inputs.values()
    ]
    correlation = _in_order(result, residual, inputs)
    lags = None if correlation is None else np.arange(len(correlation))
    reach = max(4.0, float(np.max(np.abs(residual))))
    count = int(np.clip(1.2 * np.sqrt(problem.n), 8, 40))
    density, edges = np.histogram(residual, np.linspace(-reach, reach, count + 1), density=True)
    ordered = np.sort(residual)
    normal = ndtri((np.arange(problem.n) + 0.5) / problem.n)
    return Residuals(
        channel,
        tuple(scatters + _runs(result, residual, inflation)),
        edges,
        density,
        normal,
        ordered,
        lags,
        correlation,
        1.96 / np.sqrt(problem.n),
    )
