"""Text and figure of small records: many fits, a simulated log, an exported file."""

from collections.abc import Mapping

import numpy as np

from tirefit.data.table import CANONICAL
from tirefit.fitting.batch import BatchFit
from tirefit.report.canvas import BLUE, GREY, WIDTH, Picture, drawn, tidy
from tirefit.report.numbers import format_number
from tirefit.report.page import table
from tirefit.sim.braking import SimulatedLog


def _panels(count: int, columns: int = 1) -> tuple[Picture, list]:
    rows = -(-count // columns)
    size = (WIDTH, 0.5 + (1.2 if columns == 1 else 2.2) * rows)
    picture = Picture(figsize=size, layout="constrained")
    return picture, list(picture.subplots(rows, columns, squeeze=False).ravel())


def _quantiles(values: Mapping[str, np.ndarray], first: str) -> list[str]:
    rows = [[first, "lowest", "median", "largest"]]
    for name, each in values.items():
        known = each[np.isfinite(each)]
        ends = np.quantile(known, (0, 0.5, 1)) if len(known) else [np.nan] * 3
        rows.append([name, *(format_number(float(x)) for x in ends)])
    return table(rows, right=(1, 2, 3))


def batch_text(fits: BatchFit) -> str:
    """The range of each parameter over the data sets, and how many converged."""
    values = dict(zip(fits.names, fits.values.T, strict=True))
    done = f"{int(fits.converged.sum())} of {len(fits.converged)} fits converged"
    return "\n".join([done, *_quantiles(values, "parameter")])


def batch_figure(fits: BatchFit) -> Picture:
    """Each parameter by data set, with one standard deviation."""
    picture, panels = _panels(len(fits.names))
    for axes, name, value, std in zip(panels, fits.names, fits.values.T, fits.std.T, strict=True):
        number = np.arange(len(value))
        axes.errorbar(number, value, std, fmt=".", color=BLUE, ecolor=GREY)
        tidy(axes, "", name)
    panels[-1].set_xlabel("data set", fontsize=8.5)
    return picture


def log_text(log: SimulatedLog) -> str:
    """The range of each measured column, in SI units."""
    rows = f"{len(log.columns['time'])} rows, braking positive, SI units"
    return "\n".join([rows, *_quantiles(log.columns, "column")])


def log_figure(log: SimulatedLog) -> Picture:
    """Each measured column over time, and the truth."""
    time = log.columns["time"]
    names = [name for name in log.columns if name != "time"]
    picture, panels = _panels(len(names), 2)
    some = drawn(time)
    for axes, name in zip(panels, names, strict=False):
        axes.plot(time[some], log.columns[name][some], color=GREY, linewidth=0.8)
        axes.plot(time[some], log.truth[name][some], color=BLUE, linewidth=0.8)
        tidy(axes, "", f"{name} [{CANONICAL[name][0]}]")
    for axes in panels[len(names) :]:
        axes.set_axis_off()
    return picture


def export_text(done) -> str:
    """Checks of the tire of a :class:`tirefit.targets.export.Exported`, and notes."""
    notes = (n if n.startswith("warning") else f"note: {n}" for n in done.notes)
    return "\n".join([f"{done.target}: {done.path}", *done.shape.sentences, *notes])


def export_figure(done) -> Picture:
    """Each pure force of the written tire over its slip."""
    picture, panels = _panels(len(done.shape.curves), 2)
    curves = done.shape.curves.items()
    for axes, (name, (slip, force)) in zip(panels, curves, strict=False):
        axes.plot(slip, force, color=BLUE)
        label = "slip [-]" if name.endswith("fx") else "slip angle [rad]"
        tidy(axes, label, f"{name} [N]")
    for axes in panels[len(curves) :]:
        axes.set_axis_off()
    return picture
