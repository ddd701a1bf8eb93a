"""Report of a replay: text, figures and page."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from tirefit.report.canvas import BLUE, DARK, GREEN, GREY, ORANGE, RED, Picture, panel_title, tidy
from tirefit.report.numbers import format_number
from tirefit.report.page import Section, image_of, indented, page, table
from tirefit.vehicle.replay import QUANTITIES, Fans, Replay

_NAMES = {
    "yaw_rate": "yaw rate",
    "sideslip": "sideslip",
    "a_y": "lateral acceleration",
    "heading": "heading",
    "lateral": "lateral position",
}
_COLORS = {
    "tire": BLUE,
    "linear tire": ORANGE,
    "no slip": GREY,
    "floor": GREEN,
    "with the effects": RED,
}
_LABELS = {
    "tire": "these tires",
    "linear tire": "linear tires",
    "no slip": "no slip",
    "floor": "noise floor",
    "with the effects": "with effects",
}
_AHEAD = 0.5
"""Horizon [s] of the answer; the nearest one is used."""
_SHOWN = 40
"""Largest number of windows that are drawn: about ten seconds of driving."""
_FAN = 1.0
"""Duration [s] of a drawn prediction."""
_PREDICTED = f"predicted, {_FAN:g} s"


def answer(result: Replay) -> str:
    """The error of the car, of the noise of the log, and of the baselines."""
    reached = result.horizons[: sum(count > 0 for count in result.windows)]
    place = int(np.argmin([abs(h - _AHEAD) for h in reached]))
    rms = {name: errors.rms() for name, errors in result.models.items()}

    def size(model, quantity="lateral"):
        value = rms[model][quantity][place]
        return f"{format_number(value, 2)} {QUANTITIES[quantity]}"

    more = ""
    if (name := "with the effects") in rms:
        more = f" With the effects these errors are {size(name)} and"
        more += f" {size(name, 'yaw_rate')}."
    return (
        f"{result.horizons[place]:g} s after a start, the predicted car has an rms"
        f" error of {size('tire')} in lateral position and"
        f" {size('tire', 'yaw_rate')} in yaw rate.{more} The noise of the log causes"
        f" {size('floor')} and {size('floor', 'yaw_rate')} of it. The lateral position"
        f" is wrong by {size('linear tire')} with linear tires and by"
        f" {size('no slip')} for a car without slip."
    )


def replay_text(result: Replay) -> str:
    """The report: the answer, the errors by horizon, assumptions."""
    fitted = [name for name, is_fitted in result.logs.items() if is_fitted]
    others = [name for name, is_fitted in result.logs.items() if not is_fitted]
    rows = [["rms of", "model", *(f"{h:g} s" for h in result.horizons)]]
    for name, unit in QUANTITIES.items():
        for model, errors in result.models.items():
            values = errors.rms()[name]
            cells = ["-" if x is None else format_number(x, 2) for x in values]
            what = f"{_NAMES[name]} [{unit}]" if model == "tire" else ""
            rows.append([what, _LABELS[model], *cells])
    rows.append(["starts", "", *map(str, result.windows)])
    lines = [_head(result), "ANSWER", *indented(answer(result))]
    lines += ["ERROR BY TIME AFTER THE START"]
    lines += table(rows, tuple(range(2, len(rows[0]))))
    if result.held:
        each = ", ".join(
            f"{_NAMES[name]} {share:.0%}"
            for name, (share, *_) in result.held.items()
            if share is not None
        )
        lines += indented(
            "share of the measured values within the 95 % band of the tires' parameters"
            f" {result.horizons[0]:g} s ahead: {each}; the uncertainty of the"
            " parameters explains no more of the error"
        )
    fitted_to = "the tires were fitted to " + (", ".join(fitted) or "none of these logs")
    lines += ["LOGS", *indented(fitted_to)]
    if fitted and others:
        lines += indented(f"the tires were not fitted to {', '.join(others)}")
    lines += ["ASSUMED", *(line for note in result.notes for line in indented(note))]
    return "\n".join(lines)


def _head(result: Replay) -> str:
    logs = "1 log" if len(result.logs) == 1 else f"{len(result.logs)} logs"
    return f"REPLAY of {logs}, {result.windows[0]} starts"


def plotted(result: Replay, what: str = "path") -> Picture:
    """Error over the horizon and the ``path``; or the ``series`` of yaw rate and
    lateral acceleration."""
    return {"path": replay_figure, "series": series_figure}[what](result)


def replay_page(result: Replay) -> str:
    """The replay as one HTML document with its pictures, no script or resource."""
    pictures = [
        image_of(replay_figure(result), "error over the horizon, path with predictions"),
        image_of(series_figure(result), "yaw rate and lateral acceleration over time"),
    ]
    sections = [Section("", pictures=pictures), Section("Report", text=replay_text(result))]
    return page(_head(result), sections, record=result.to_json())


_HELD = {"lateral": "lateral position [m]", "yaw_rate": "yaw rate [rad/s]"}


def replay_figure(result: Replay) -> Picture:
    """Errors of lateral position and yaw rate over the horizon, and a stretch of the
    path with its predictions."""
    picture = Picture(figsize=(11.0, 3.8), layout="constrained")
    *axes, path = picture.subplots(1, 3, width_ratios=(1, 1, 1.5))
    for ax, (name, label) in zip(axes, _HELD.items(), strict=True):
        for model, errors in result.models.items():
            values = [np.nan if v is None else v for v in errors.rms()[name]]
            style = ".:" if model == "floor" else ".-"
            ax.plot(result.horizons, values, style, color=_COLORS[model], label=_LABELS[model])
        ax.set(xscale="log", yscale="log")
        ax.set_xticks(result.horizons, [f"{h:g}" for h in result.horizons])
        ax.minorticks_off()
        tidy(ax, "time after the start [s]", f"rms error of the {label}")
    panel_title(axes[0], "Error over the horizon")
    axes[0].legend(frameon=False, fontsize=7.5)
    name, fans = _longest(result)
    _draw_stretch(path, fans, lambda of, row: (of["x"][row], of["y"][row]))
    path.set_aspect("equal", "datalim")
    tidy(path, "x [m]", "y [m]")
    panel_title(path, f"A stretch of {name}, with predictions")
    path.legend(frameon=False, fontsize=7.5)
    return picture


def _draw_stretch(axes: Any, fans: Fans, series: Callable[[Mapping, int], tuple]) -> None:
    """Draw the first second of every window of a stretch, measured and predicted.

    Args:
        series: x and y of the line of one window.
    """
    styles = (fans.measured, DARK, 1.4, "measured"), (fans.predicted, BLUE, 0.9, _PREDICTED)
    for k, row in enumerate(_stretch(fans)):
        near = fans.time[row] <= fans.time[row][0] + _FAN
        for of, color, width, label in styles:
            x, y = series(of, row)
            axes.plot(x[near], y[near], color=color, lw=width, label=label * (k == 0))


def series_figure(result: Replay) -> Picture:
    """Yaw rate and lateral acceleration of the same stretch, measured and predicted."""
    picture = Picture(figsize=(11.0, 4.2), layout="constrained")
    name, fans = _longest(result)
    axes = picture.subplots(2, 1, sharex=True)
    labels = {"yaw_rate": "yaw rate [rad/s]", "a_y": "lateral acceleration [m/s²]"}
    rows = _stretch(fans)
    for ax, (key, label) in zip(axes, labels.items(), strict=True):

        def series(of: Mapping, row: int, key: str = key) -> tuple:
            return fans.time[row], of[key][row]

        _draw_stretch(ax, fans, series)
        ax.plot(fans.time[rows, 0], fans.predicted[key][rows, 0], ".", color=BLUE, ms=4)
        tidy(ax, "", label)
    axes[1].set_xlabel("time [s]", fontsize=8.5)
    panel_title(axes[0], f"The same stretch of {name}", "dots: starts of a prediction")
    axes[0].legend(frameon=False, fontsize=7.5)
    return picture


def _longest(result: Replay) -> tuple[str, Fans]:
    return max(result.fans.items(), key=lambda item: len(item[1].time))


def _stretch(fans: Fans) -> np.ndarray:
    """Numbers of the windows that are drawn, from the middle of the log."""
    first = max((len(fans.time) - _SHOWN) // 2, 0)
    return np.arange(first, min(first + _SHOWN, len(fans.time)))
