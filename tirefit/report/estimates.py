"""Report of online estimates: text and figure."""

from functools import partial
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
    return f"{head}\n{report_text([Section('', _notes(result), _rows(result), right=(2,))])}"


def shaded_spans(result: Estimates) -> list[tuple[float, float]]:
    """Spans [s] in which every method flags the rows, without detections of a change."""
    flags = [(m.flag > 0) & (m.flag != code(Flag.CHANGED)) for m in result.methods.values()]
    bad = np.all(flags, axis=0) & np.isfinite(result.time)
    edges = np.flatnonzero(np.diff(np.r_[False, bad, False].astype(int)))
    last = len(result.time) - 1
    return [
        (float(result.time[begin]), float(result.time[min(end, last)]))
        for begin, end in zip(edges[::2], edges[1::2], strict=True)
    ]


def _limits(result: Estimates, parameter: str) -> tuple[float, float] | None:
    """Range of the supported estimates of a parameter with a margin; of all if none is."""
    values = []
    for method in result.methods.values():
        if parameter in method.parameters:
            series, good = method[parameter], method.flag == 0
            values.append(series[good] if good.any() else series)
    known = np.concatenate(values)
    known = known[np.isfinite(known)]
    if not len(known):
        return None
    low, high = np.percentile(known, [0.5, 99.5])
    # Margin of an axis, over the range of the estimates.
    room = 0.15 * max(high - low, 0.2 * abs(high))
    return max(low - room, 0.0), high + room


def _draw(axes: Any, result: Estimates, parameter: str) -> None:
    """One parameter by all methods that estimate it: line, band, flagged rows."""
    for color, (name, method) in zip(COLORS, result.methods.items(), strict=False):
        if parameter in method.parameters:
            value, std = method[parameter], method.std_of(parameter)
            axes.plot(result.time, value, color=color, linewidth=1.1, label=name)
            low, high = value - std, value + std
            axes.fill_between(result.time, low, high, color=color, alpha=0.2, linewidth=0)
            for change in changes(result.time, method):
                if change.parameter == parameter:
                    axes.axvline(change.time, color=color, linewidth=0.8, linestyle=":")
    if (limits := _limits(result, parameter)) is not None:
        axes.set_ylim(*limits)
    for begin, end in shaded_spans(result):
        axes.axvspan(begin, end, color=GREY, alpha=0.15, linewidth=0)


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
        use = result.use

        def draw_use(axes: Any) -> None:
            axes.plot(result.time, use, color=DARK, linewidth=0.5)

        panels.append(axes_panel(draw_use, "used friction", "time [s]", "$F_x / F_z$ [–]"))
    foot = f"tirefit {result.version} · braking positive, SI"
    text = "band: one standard deviation; grey: rows that every method flags"
    return together(panels, f"Online estimates of {result.data['name']}", text, foot)
