"""Text and figure of small records: many fits, a simulated log, an exported file."""

from collections.abc import Mapping
from functools import partial
from operator import methodcaller
from typing import Any

import numpy as np

from tirefit.data.table import CANONICAL
from tirefit.fitting.solve.batch import BatchFit
from tirefit.report.canvas import BLUE, GREY, Picture, axes_panel, drawn, together
from tirefit.report.page import spread, table
from tirefit.sim.braking import SimulatedLog


def _quantiles(values: Mapping[str, np.ndarray], first: str) -> list[str]:
    rows = [[name, *spread(each)] for name, each in values.items()]
    return table([[first, "lowest", "median", "largest"], *rows], right=(1, 2, 3))


def batch_text(fits: BatchFit) -> str:
    """The range of each parameter over the data sets, and how many converged."""
    values = dict(zip(fits.names, fits.values.T, strict=True))
    done = f"{int(fits.converged.sum())} of {len(fits.converged)} fits converged"
    return "\n".join([done, *_quantiles(values, "parameter")])


def batch_figure(fits: BatchFit) -> Picture:
    """Each parameter by data set, with one standard deviation."""
    number, style = np.arange(len(fits.values)), {"fmt": ".", "color": BLUE, "ecolor": GREY}
    panels = [
        axes_panel(methodcaller("errorbar", number, *values, **style), name, "data set", name)
        for name, *values in zip(fits.names, fits.values.T, fits.std.T, strict=True)
    ]
    return together(panels, batch_text(fits).partition("\n")[0], "", "")


def log_text(log: SimulatedLog) -> str:
    """The range of each measured column, in SI units."""
    rows = f"{len(log.columns['time'])} rows, braking positive, SI units"
    return "\n".join([rows, *_quantiles(log.columns, "column")])


def log_figure(log: SimulatedLog) -> Picture:
    """Each measured column over time, and the truth."""
    time, some = log.columns["time"], drawn(log.columns["time"])

    def draw(axes: Any, name: str) -> None:
        for values, color in ((log.columns[name], GREY), (log.truth[name], BLUE)):
            axes.plot(time[some], values[some], color=color, linewidth=0.8)

    panels = [
        axes_panel(partial(draw, name=name), name, "time [s]", f"{name} [{CANONICAL[name][0]}]")
        for name in log.columns
        if name != "time"
    ]
    return together(panels, "Simulated log", "grey: measured; blue: truth", "")


def export_text(done: Any) -> str:
    """Checks of the tire of a :class:`tirefit.targets.export.Exported`, and notes."""
    notes = (n if n.startswith("warning") else f"note: {n}" for n in done.notes)
    return "\n".join([f"{done.target}: {done.path}", *done.shape.sentences, *notes])


def export_figure(done: Any) -> Picture:
    """Each pure force of the written tire over its slip."""

    panels = []
    for name, (slip, force) in done.shape.curves.items():
        x_label = "slip [-]" if name.endswith("fx") else "slip angle [rad]"
        draw = methodcaller("plot", slip, force, color=BLUE)
        panels.append(axes_panel(draw, name, x_label, f"{name} [N]"))
    return together(panels, f"{done.target}: {done.path.name}", "", "")
