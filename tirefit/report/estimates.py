"""Report of online estimates: text and figure."""

from functools import partial
from operator import methodcaller
from typing import Any

import numpy as np

from tirefit.online.base import PARAMETERS, Flag, code
from tirefit.online.result import Estimates, changes
from tirefit.report.canvas import COLORS, DARK, GREY, Picture, axes_panel, together
from tirefit.report.numbers import format_estimate, format_number
from tirefit.report.page import Rows, Section, report_text


def _rows(result: Estimates) -> Rows:
    rows = [["method", "parameter", "at the end", "unit", "flagged rows", "last flag"]]
    for name, method in result.methods.items():
        flagged = f"{np.count_nonzero(method.flag)} of {len(method.flag)}"
        for parameter in method.parameters:
            value = format_estimate(method[parameter][-1], method.std_of(parameter)[-1])
            unit, last = PARAMETERS[parameter].unit, method.reasons[-1] or "none"
            rows.append([name, parameter, value, unit, flagged, last])
    return rows


def _notes(result: Estimates) -> list[str]:
    notes = []
    for name, method in result.methods.items():
        counted = [f"{rows} {reason}" for reason, rows in method.counts().items()]
        notes += [f"{name}: {', '.join(counted)}"] if counted else []
        notes += [
            f"{name}: change at {format_number(c.time)} s: {c.parameter} from"
            f" {format_number(c.before)} to {format_number(c.after)}"
            for c in changes(result.time, method)
        ]
    return notes


def estimates_text(result: Estimates) -> str:
    """Estimates at the end of the log, flags and changes; for the terminal."""
    head = f"ONLINE ESTIMATES of {result.data['name']}, {result.data['rows']} rows"
    section = Section("", _notes(result), _rows(result), right=(2,), names=2)
    return f"{head}\n{report_text([section])}"


def _draw(axes: Any, result: Estimates, parameter: str) -> None:
    """One parameter by all methods that estimate it: line, band, changes, flagged rows."""
    values, time = [], result.time
    for color, (name, method) in zip(COLORS, result.methods.items(), strict=False):
        if parameter not in method.parameters:
            continue
        value, std, is_good = method[parameter], method.std_of(parameter), method.flag == 0
        axes.plot(time, value, color=color, linewidth=1.1, label=name)
        axes.fill_between(time, value - std, value + std, color=color, alpha=0.2, linewidth=0)
        for change in changes(time, method):
            if change.parameter == parameter:
                axes.axvline(change.time, color=color, linewidth=0.8, linestyle=":")
        values.append(value[is_good] if is_good.any() else value)
    known = np.concatenate(values)
    if len(known := known[np.isfinite(known)]):  # the axis ends at the supported estimates
        low, high = np.percentile(known, [0.5, 99.5])
        room = 0.15 * max(high - low, 0.2 * abs(high))
        axes.set_ylim(low - room if low < 0 else max(low - room, 0.0), high + room)
    flags = [(m.flag > 0) & (m.flag != code(Flag.CHANGED)) for m in result.methods.values()]
    grey = {"transform": axes.get_xaxis_transform(), "color": GREY, "alpha": 0.15, "linewidth": 0}
    axes.fill_between(time, 0, 1, where=np.all(flags, axis=0), **grey)


def estimates_figure(result: Estimates) -> Picture:
    """All methods in one panel per parameter, with the used friction below.

    Bands are one standard deviation. Grey spans are flagged by every method.
    """
    panels = []
    for name in dict.fromkeys(p for m in result.methods.values() for p in m.parameters):
        unit = PARAMETERS[name].unit.replace("-", "–")
        label = f"${PARAMETERS[name].symbol}$ [{unit}]"
        draw = partial(_draw, result=result, parameter=name)
        panels.append(axes_panel(draw, name, "time [s]", label))
    if result.use is not None:
        draw_use = methodcaller("plot", result.time, result.use, color=DARK, linewidth=0.5)
        panels.append(axes_panel(draw_use, "used friction", "time [s]", "$F_x / F_z$ [–]"))
    foot = f"tirefit {result.version} · braking positive, SI"
    text = "band: one standard deviation; grey: rows that every method flags"
    return together(panels, f"Online estimates of {result.data['name']}", text, foot)
