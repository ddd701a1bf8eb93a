"""Report of online estimates: text and figure."""

import numpy as np

from tirefit.online.base import PARAMETERS, Flag, code
from tirefit.online.result import Estimates, changes
from tirefit.report.canvas import COLORS, DARK, GREY, Picture, frame, tidy
from tirefit.report.numbers import format_estimate, format_number
from tirefit.report.page import table

_ROOM = 0.15  # margin of an axis, over the range of the estimates


def _cells(result: Estimates) -> list[list[str]]:
    rows = [["method", "parameter", "at the end", "unit", "flagged rows", "last flag"]]
    for name, method in result.methods.items():
        flagged = int(np.count_nonzero(method.flag))
        last = method.reasons[-1] or "none"
        for parameter in method.parameters:
            value, std = method[parameter][-1], method.std_of(parameter)[-1]
            rows.append(
                [
                    name,
                    parameter,
                    format_estimate(value, std),
                    PARAMETERS[parameter].unit,
                    f"{flagged} of {len(method.flag)}",
                    last,
                ]
            )
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
    notes = [f"  {note}" for note in _notes(result)]
    return "\n".join([head, *table(_cells(result), right=(2,)), *notes])


def shaded_spans(time: np.ndarray, flag: np.ndarray) -> list[tuple[float, float]]:
    """Spans [s] in which rows are flagged, without single detections of a change.

    Args:
        time: (n,) [s], in order; flag: (n,) codes.
    """
    bad = (flag > 0) & (flag != code(Flag.CHANGED)) & np.isfinite(time)
    edges = np.flatnonzero(np.diff(np.r_[False, bad, False].astype(int)))
    last = len(time) - 1
    return [
        (float(time[begin]), float(time[min(end, last)]))
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
    room = _ROOM * max(high - low, 0.2 * abs(high))
    return max(low - room, 0.0), high + room


def _draw(axes, result: Estimates, parameter: str) -> None:
    """One parameter by all methods that estimate it: line, band, flagged rows."""
    for color, (name, method) in zip(COLORS, result.methods.items(), strict=False):
        if parameter not in method.parameters:
            continue
        value, std = method[parameter], method.std_of(parameter)
        axes.plot(result.time, value, color=color, linewidth=1.1, label=name)
        axes.fill_between(
            result.time, value - std, value + std, color=color, alpha=0.2, linewidth=0
        )
        for change in changes(result.time, method):
            if change.parameter == parameter:
                axes.axvline(change.time, color=color, linewidth=0.8, linestyle=":")
    limits = _limits(result, parameter)
    if limits is not None:
        axes.set_ylim(*limits)
    unit = PARAMETERS[parameter].unit
    label = f"${PARAMETERS[parameter].symbol}$ [{'–' if unit == '-' else unit}]"
    tidy(axes, "", label)


def _shade(axes, result: Estimates) -> None:
    """Draw a strip of flags for every method at the bottom of an axes."""
    height = 0.03
    for k, (color, method) in enumerate(zip(COLORS, result.methods.values(), strict=False)):
        for begin, end in shaded_spans(result.time, method.flag):
            low = k * height
            axes.axvspan(begin, end, low, low + height, color=color, linewidth=0)
    common = np.min(np.stack([m.flag for m in result.methods.values()]), axis=0)
    for begin, end in shaded_spans(result.time, common):
        axes.axvspan(begin, end, color=GREY, alpha=0.15, linewidth=0)


def estimates_figure(result: Estimates) -> Picture:
    """All methods in one panel per parameter, with the used friction below.

    Bands are one standard deviation. Grey spans are flagged by every method, the strips
    at the bottom by the method of their colour.
    """
    parameters = list(dict.fromkeys(p for m in result.methods.values() for p in m.parameters))
    panels = len(parameters) + (result.use is not None)
    title = f"online estimates of {result.data['name']}"
    foot = f"tirefit {result.version} · braking positive, SI · band: one standard deviation · grey"
    foot += " and strips: flagged rows"
    picture = frame(title, "", foot, (7.0, 0.5 + 1.9 * panels))
    all_axes = picture.subplots(panels, 1, sharex=True, squeeze=False)[:, 0]
    for axes, parameter in zip(all_axes, parameters, strict=False):
        _draw(axes, result, parameter)
        _shade(axes, result)
    if result.use is not None:
        all_axes[-1].plot(result.time, result.use, color=DARK, linewidth=0.5)
        tidy(all_axes[-1], "", "used: $F_x / F_z$ [–]")
        known = result.use[np.isfinite(result.use)]
        if len(known):
            all_axes[-1].set_ylim(min(known.min(), 0.0), 1.1 * known.max())
    all_axes[-1].set_xlabel("time [s]", fontsize=8.5, color=DARK)
    all_axes[0].legend(fontsize=7.5, frameon=False, loc="upper right", ncols=5)
    return picture
