"""Residuals over every input: arrays and panels."""

import re
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from tirefit.data.rig.levels import cells, levels
from tirefit.fitting.problem.likelihood import CHANNEL_SLIP
from tirefit.fitting.result import FitResult
from tirefit.report.canvas import BLUE, DARK, ORANGE, Panel, dots, drawn, tidy
from tirefit.report.fit.curves import slip_axis

_LABEL = {
    "fz": ("load $F_z$", "N"),
    "v": ("speed $v$", "m/s"),
    "time": ("time", "s"),
    "gamma": (r"camber $\gamma$", "deg"),
    "pressure": ("pressure", "kPa"),
    "temperature": ("temperature", "°C"),
}
_SHOWN = {"gamma": 180 / np.pi, "pressure": 1e-3}
_BINS = 12
"""Largest number of settings with a mean each; more are grouped into bins of equal size."""


class Means(NamedTuple):
    """Means over bins, (k,) each."""

    center: np.ndarray  # of the input
    mean: np.ndarray  # of the residuals
    half: np.ndarray  # half-width of the mean's 95 % interval


def standardised(result: FitResult, channel: str) -> np.ndarray:
    """(observed - fitted) / standard deviation of a measurement, (n,)."""
    return result.solved.residual(channel) / np.sqrt(result.solved.at.variance[channel])


def means_over(x: np.ndarray, residual: np.ndarray, inflation: float) -> Means:
    """Means at the settings of an input, or over bins of it, of at least three rows.

    Args:
        x: (n,) input.
        residual: (n,) standardised.
        inflation: rows per independent row.
    """
    settings = levels(x)
    if settings.few(_BINS):
        codes = settings.code
    else:
        edges = np.unique(np.quantile(x, np.linspace(0, 1, _BINS + 1)[1:-1]))
        codes = np.searchsorted(edges, x)
    means = means_by(codes, x, residual, inflation)
    kept = np.bincount(codes) >= 3
    return Means(*(part[kept] for part in means))


def means_by(codes: np.ndarray, x: np.ndarray, residual: np.ndarray, inflation: float) -> Means:
    """Means of each group of rows; ``codes`` (n,) number the groups from 0."""
    size = int(np.max(codes)) + 1
    count, mean, std = cells(codes, size, residual)
    half = 1.96 * std * np.sqrt(inflation / np.maximum(count, 1))
    return Means(cells(codes, size, x)[1], mean, half)


class Scatter(NamedTuple):
    """Standardised residuals against one input: points (n,), and their means."""

    label: str
    x: np.ndarray
    residual: np.ndarray
    means: Means


def _inputs(result: FitResult, slip: str) -> dict[str, tuple[str, np.ndarray]]:
    """Input -> (label, values as drawn (n,)) of every input that varies."""
    problem = result.problem
    inputs, shown = problem.rows.inputs, {}
    for name in dict.fromkeys((slip, "sigma_x", "alpha")):
        values = problem.used(getattr(inputs, name))
        axis = slip_axis(name, values)
        shown[name] = (f"{axis.label} [{axis.unit}]", axis.shown(values))
    columns = {"fz": problem.used(inputs.fz), "v": problem.used(inputs.v)}
    if result.table is not None:
        rows = result.table.used
        columns |= {name: result.table[name][rows] for name in _LABEL if name in result.table}
    for name in (name for name in _LABEL if name in columns):
        label, unit = _LABEL[name]
        shown[name] = (f"{label} [{unit}]", columns[name] * _SHOWN.get(name, 1.0))
    return {
        name: (label, values)
        for name, (label, values) in shown.items()
        if np.all(np.isfinite(values)) and np.ptp(values) > 1e-6 * max(np.max(np.abs(values)), 1e-9)
    }


def scatters_of(result: FitResult, channel: str) -> list[Scatter]:
    """Standardised residuals of one fitted force over every input that varies."""
    residual = standardised(result, channel)
    inflation = max(result.statistics.n / max(result.statistics.n_effective, 1), 1.0)
    return [
        Scatter(label, x, residual, means_over(x, residual, inflation))
        for label, x in _inputs(result, CHANNEL_SLIP[channel]).values()
    ]


def residual_panels(result: FitResult) -> list[Panel]:
    """Residuals of the first force over each input, of further forces over their slip."""
    first, *others = result.forces
    scatters = [(first, panel) for panel in scatters_of(result, first)]
    scatters[1:1] = [(force, scatters_of(result, force)[0]) for force in others]
    return [
        Panel(
            partial(_draw_scatter, panel=panel, force=force),
            f"Residuals of {force} against {re.sub(r'[$].*[$] ', '', panel.label)}",
        )
        for force, panel in scatters
    ]


def _draw_scatter(figure: Any, panel: Scatter, force: str) -> None:
    """Residuals against one input, and their means over bins with 95 % intervals."""
    axes = figure.subplots()
    size = float(np.clip(40 / np.sqrt(max(len(panel.x), 1)), 1.0, 3.5))
    some = drawn(panel.residual)
    axes.axhline(0, color=DARK, lw=0.7, zorder=1)
    dots(axes, panel.x[some], panel.residual[some], size, BLUE, 0.35)
    axes.errorbar(
        *panel.means, fmt="o", color=ORANGE, markersize=4,
        markeredgecolor=DARK, markeredgewidth=0.5, elinewidth=1.6, ecolor=ORANGE,
        zorder=3,
    )  # fmt: skip
    tidy(axes, panel.label, f"{force} residual / std")
    reach = max(3.5, 1.05 * float(np.max(np.abs(panel.residual), initial=0.0)))
    axes.set_ylim(-reach, reach)
