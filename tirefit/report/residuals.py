"""Residuals over every input, their distribution and their sequence: arrays and panels."""

from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtri

from tirefit.data.run_names import clipped, run_names
from tirefit.data.table import TireData
from tirefit.fitting.problem.likelihood import CHANNEL_SLIP, FitProblem
from tirefit.fitting.result import FitResult
from tirefit.fitting.verdict.residuals import (
    means_by,
    means_over,
    ordered_correlation,
    standardised,
)
from tirefit.report.canvas import BLUE, DARK, GREY, ORANGE, WIDE, Panel, dots, drawn, tidy
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
    ticks: tuple[str, ...] = ()  # values of a categorical input


def _fitted_rows(problem: FitProblem, data: TireData | None) -> np.ndarray | None:
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
    inputs, shown = problem.rows.inputs, {}
    for name in dict.fromkeys((slip, "sigma_x", "alpha")):
        values = problem.used(getattr(inputs, name))
        axis = slip_axis(name, values)
        shown[name] = (f"{axis.label} [{axis.unit}]", axis.shown(values))
    columns = {"fz": problem.used(inputs.fz), "v": problem.used(inputs.v)}
    rows = _fitted_rows(problem, result.table)
    if rows is not None:
        columns |= {name: result.table[name][rows] for name in _LABEL if name in result.table}
    for name in (name for name in _LABEL if name in columns):
        label, unit = _LABEL[name]
        shown[name] = (f"{label} [{unit}]", columns[name] * _SHOWN.get(name, 1.0))
    return {
        name: (label, values)
        for name, (label, values) in shown.items()
        if np.all(np.isfinite(values)) and np.ptp(values) > 1e-6 * max(np.max(np.abs(values)), 1e-9)
    }


def _runs(result: FitResult, residual: np.ndarray, inflation: float) -> list[Scatter]:
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


def scatters_of(result: FitResult, channel: str) -> list[Scatter]:
    """Standardised residuals of one fitted force over every input that varies."""
    residual = standardised(result, channel)
    inflation = max(result.statistics.n / max(result.statistics.n_effective, 1), 1.0)
    scatters = [
        Scatter(label, x, residual, *means_over(x, residual, inflation))
        for label, x in _inputs(result, CHANNEL_SLIP[channel]).values()
    ]
    return scatters + _runs(result, residual, inflation)


def correlation_of(result: FitResult, channel: str) -> np.ndarray | None:
    """Autocorrelation of the residuals in the order of time, or of the file; None without
    an order."""
    problem, statistics = result.problem, result.statistics
    inputs = _inputs(result, CHANNEL_SLIP[channel])
    time = inputs["time"][1] if "time" in inputs else None
    if time is None and statistics.n_effective > _INDEPENDENT * statistics.n:
        return None
    residual = standardised(result, channel)
    return ordered_correlation(residual, problem.used(problem.rows.run), time)


def residual_panels(result: FitResult) -> list[Panel]:
    """Residuals of the first force over each input, their distribution and sequence.

    Further forces of a joint fit are shown against their slip.
    """
    first, *others = result.forces
    scatters = [(first, panel) for panel in scatters_of(result, first)]
    scatters[1:1] = [(force, scatters_of(result, force)[0]) for force in others]
    panels = [
        Panel(
            partial(_draw_scatter, panel=panel, force=force),
            f"Residuals of {force} against {panel.label}",
            (WIDE, 2.3 + 0.4 * bool(panel.ticks)),
        )
        for force, panel in scatters
    ]
    normal = partial(_draw_quantiles, residual=standardised(result, first))
    panels.append(Panel(normal, "Sorted residuals against normal quantiles"))
    if (correlation := correlation_of(result, first)) is not None:
        order = partial(_draw_correlation, correlation=correlation, count=result.problem.n)
        panels.append(Panel(order, "Autocorrelation of the residuals"))
    return panels


def _draw_scatter(figure: Any, panel: Scatter, force: str) -> None:
    """Residuals against one input, and their means over bins with 95 % intervals."""
    axes = figure.subplots()
    size = float(np.clip(40 / np.sqrt(max(len(panel.x), 1)), 1.0, 3.5))
    some = drawn(panel.residual)
    axes.axhline(0, color=DARK, lw=0.7, zorder=1)
    dots(axes, panel.x[some], panel.residual[some], size, BLUE, 0.35)
    axes.errorbar(
        panel.center, panel.mean, panel.half, fmt="o", color=ORANGE, markersize=4,
        markeredgecolor=DARK, markeredgewidth=0.5, elinewidth=1.6, ecolor=ORANGE,
        zorder=3,
    )  # fmt: skip
    tidy(axes, panel.label, f"{force} residual / std")
    reach = max(3.5, 1.05 * float(np.max(np.abs(panel.residual), initial=0.0)))
    axes.set_ylim(-reach, reach)
    if panel.ticks:
        every = 1 if len(panel.ticks) <= 16 else 2
        axes.set_xticks(range(0, len(panel.ticks), every), panel.ticks[::every])
        if sum(map(len, panel.ticks)) >= 40:
            axes.tick_params(axis="x", labelrotation=90, labelsize=6.5)


def _draw_quantiles(figure: Any, residual: np.ndarray) -> None:
    """Sorted residuals against normal quantiles: on the line if they are normal."""
    axes, ordered = figure.subplots(), np.sort(residual)
    normal = ndtri((np.arange(len(ordered)) + 0.5) / len(ordered))
    reach = max(3.0, float(np.max(np.abs(normal))))
    axes.plot([-reach, reach], [-reach, reach], color=DARK, lw=0.8)
    some = drawn(ordered)
    dots(axes, normal[some], ordered[some], 2.2, BLUE)
    tidy(axes, "quantile of a normal", "residual / std")


def _draw_correlation(figure: Any, correlation: np.ndarray, count: int) -> None:
    """Autocorrelation over lags, with the 95 % range of so many independent rows."""
    axes, limit = figure.subplots(), 1.96 / np.sqrt(count)
    axes.axhspan(-limit, limit, color=GREY, alpha=0.25, lw=0)
    axes.axhline(0, color=DARK, lw=0.7)
    axes.vlines(np.arange(1, len(correlation)), 0, correlation[1:], color=BLUE, lw=2)
    highest = float(np.max(correlation[1:], initial=0.0))
    axes.set_ylim(min(-3 * limit, 1.1 * float(correlation.min())), max(3 * limit, 1.1 * highest))
    tidy(axes, "lag [rows in time order]", "autocorrelation")
