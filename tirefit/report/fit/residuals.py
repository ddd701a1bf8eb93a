"""Residuals over every input: arrays and panels."""

from functools import partial
from typing import Any, NamedTuple

import numpy as np

from tirefit.fitting.problem.likelihood import CHANNEL_SLIP
from tirefit.fitting.result import FitResult
from tirefit.fitting.verdict.residuals import means_over, standardised
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


class Scatter(NamedTuple):
    """Standardised residuals against one input: points (n,), and means over bins (k,)."""

    label: str
    x: np.ndarray
    residual: np.ndarray
    center: np.ndarray
    mean: np.ndarray
    half: np.ndarray  # half-width of the 95 % interval of a bin's mean


def _inputs(result: FitResult, slip: str) -> dict[str, tuple[str, np.ndarray]]:
    """Input -> (label, values as drawn (n,)) of every input that varies."""
    problem = result.problem
    inputs, shown = problem.rows.inputs, {}
    for name in dict.fromkeys((slip, "sigma_x", "alpha")):
        values = problem.used(getattr(inputs, name))
        axis = slip_axis(name, values)
        shown[name] = (f"{axis.label} [{axis.unit}]", axis.shown(values))
    columns = {"fz": problem.used(inputs.fz), "v": problem.used(inputs.v)}
    if (table := result.table) is not None:
        # A fit may be limited to an interval of slip.
        ends = problem.used(getattr(inputs, problem.slip_name))
        with np.errstate(invalid="ignore"):
            inside = np.clip(table[problem.slip_name], ends.min(), ends.max())
            rows = table.used & (inside == table[problem.slip_name])
        if np.count_nonzero(rows) == problem.n:
            columns |= {name: table[name][rows] for name in _LABEL if name in table}
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
        Scatter(label, x, residual, *means_over(x, residual, inflation))
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
            f"Residuals of {force} against {panel.label}",
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
        panel.center, panel.mean, panel.half, fmt="o", color=ORANGE, markersize=4,
        markeredgecolor=DARK, markeredgewidth=0.5, elinewidth=1.6, ecolor=ORANGE,
        zorder=3,
    )  # fmt: skip
    tidy(axes, panel.label, f"{force} residual / std")
    reach = max(3.5, 1.05 * float(np.max(np.abs(panel.residual), initial=0.0)))
    axes.set_ylim(-reach, reach)
