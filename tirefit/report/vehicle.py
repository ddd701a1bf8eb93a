"""Reports of a car: of a replay with what its errors say of tires, effects and steering, and of
a fit by trajectory."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from tirefit.diagnosis.summary.result import UNITS
from tirefit.report.canvas import (
    BLUE,
    DARK,
    GREEN,
    GREY,
    ORANGE,
    RED,
    Panel,
    Picture,
    axes_panel,
    dots,
    images_of,
    together,
)
from tirefit.report.numbers import format_estimate, format_number
from tirefit.report.page import Section, page, report_text, verdict_of
from tirefit.vehicle.errors import QUANTITIES, Fans
from tirefit.vehicle.replay import Replay
from tirefit.vehicle.trajectory import UNKNOWNS, TrajectoryFit

_NAMES = {
    "yaw_rate": "yaw rate",
    "sideslip": "sideslip",
    "a_y": "lateral acceleration",
    "heading": "heading",
    "lateral": "lateral position",
}
_MODELS = {
    "tire": ("these tires", BLUE),
    "linear tire": ("linear tires", ORANGE),
    "no slip": ("no slip", GREY),
    "floor": ("noise floor", GREEN),
    "with the effects": ("with effects", RED),
}
"""Compared car -> its label and colour."""
_SHOWN = 40  # largest number of windows that are drawn: about ten seconds of driving
_FAN = 1.0  # duration [s] of a drawn prediction


def answer(result: Replay) -> str:
    """What limits the prediction; the error of the car, of the noise of the log, and of the
    baselines."""
    place = result.place
    rms = {name: errors.rms() for name, errors in result.models.items()}

    def size(model: str, quantity: str = "lateral") -> str:
        value = rms[model][quantity][place]
        return f"{format_number(value, 2)} {QUANTITIES[quantity]}"

    sentences = [
        *result.conclusions,
        f"{result.horizons[place]:g} s after a start, the predicted car has an rms error of"
        f" {size('tire')} in lateral position and {size('tire', 'yaw_rate')} in yaw rate.",
        f"The noise of the log causes {size('floor')} and {size('floor', 'yaw_rate')} of it.",
        f"The lateral position is wrong by {size('linear tire')} with linear tires and by"
        f" {size('no slip')} for a car without slip.",
    ]
    if (name := "with the effects") in rms:
        errors = f"{size(name)} and {size(name, 'yaw_rate')}"
        sentences.insert(-2, f"With the effects these errors are {errors}.")
    return " ".join(sentences)


def _sections(result: Replay) -> list[Section]:
    """Errors by horizon, logs, assumptions."""
    rows = [["rms of", "model", *(f"{h:g} s" for h in result.horizons)]]
    for name, unit in QUANTITIES.items():
        for model, errors in result.models.items():
            cells = ["-" if x is None else format_number(x, 2) for x in errors.rms()[name]]
            what = f"{_NAMES[name]} [{unit}]" if model == "tire" else ""
            rows.append([what, _MODELS[model][0], *cells])
    rows.append(["starts", "", *map(str, result.windows)])
    fitted = [name for name, is_fitted in result.logs.items() if is_fitted]
    logs = [f"the tires were fitted to {', '.join(fitted) or 'none of these logs'}"]
    title, right = "Error by time after the start", range(2, len(rows[0]))
    return [
        # On the page the panels have the errors.
        Section(title, (), rows, right=right, folded=True),
        Section("Logs", logs),
        Section("Assumed", result.notes),
    ]


def replay_text(result: Replay) -> str:
    """The report: the answer, the errors by horizon, assumptions."""
    sections = [Section("Answer", [answer(result)]), *_sections(result)]
    return f"{_head(result)}\n{report_text(sections)}"


def _head(result: Replay) -> str:
    logs = "1 log" if len(result.logs) == 1 else f"{len(result.logs)} logs"
    return f"REPLAY of {logs}, {result.windows[0]} starts"


def plotted(result: Replay, what: str = "path") -> Picture:
    """Error over the horizon and the ``path``; or the ``series`` of yaw rate and
    lateral acceleration."""
    panels = {"path": _path_panels, "series": _series_panels}[what](result)
    return together(panels, _head(result), answer(result), "braking positive, SI")


def replay_page(result: Replay) -> str:
    """The replay as one HTML document with its pictures, no script or resource."""
    panels = [*_path_panels(result), *_series_panels(result)]
    sections = [Section("", pictures=images_of(panels)), *_sections(result)]
    verdict = verdict_of(answer(result), (), not result.outcomes)
    return page(_head(result), sections, verdict, record=result.to_json())


def _path_panels(result: Replay) -> list[Panel]:
    """Errors over the horizon, and a stretch of the path with its predictions."""
    name, fans, _ = _stretch(result)

    def errors_of(axes: Any, quantity: str) -> None:
        for model, errors in result.models.items():
            values = [np.nan if v is None else v for v in errors.rms()[quantity]]
            style, (label, color) = ".:" if model == "floor" else ".-", _MODELS[model]
            axes.plot(result.horizons, values, style, color=color, label=label)
        axes.set(xscale="log", yscale="log")
        axes.set_xticks(result.horizons, [f"{h:g}" for h in result.horizons])
        axes.minorticks_off()

    def draw(axes: Any) -> None:
        _draw_stretch(axes, result, lambda of, row: (of["x"][row], of["y"][row]))
        axes.set_aspect("equal", "datalim")

    x_label = "time after the start [s]"
    panels = []
    for key in ("lateral", "yaw_rate"):
        title = f"Error of the {_NAMES[key]} over the horizon"
        y_label = f"rms error of the {_NAMES[key]} [{QUANTITIES[key]}]"
        panels.append(axes_panel(partial(errors_of, quantity=key), title, x_label, y_label))
    return [*panels, axes_panel(draw, f"A stretch of {name}, with predictions", "x [m]", "y [m]")]


def _series_panels(result: Replay) -> list[Panel]:
    """Yaw rate and lateral acceleration of the same stretch, measured and predicted."""
    name, fans, rows = _stretch(result)

    def draw(axes: Any, key: str) -> None:
        _draw_stretch(axes, result, lambda of, row: (fans.time[row], of[key][row]))
        axes.plot(fans.time[rows, 0], fans.predicted[key][rows, 0], ".", color=BLUE, ms=4)

    title, note = f"The same stretch of {name}", "dots: starts of a prediction"
    units = {"yaw_rate": "rad/s", "a_y": "m/s²"}
    return [
        axes_panel(partial(draw, key=key), title, "time [s]", f"{_NAMES[key]} [{unit}]", note)
        for key, unit in units.items()
    ]


def _draw_stretch(
    axes: Any, result: Replay, series: Callable[[Mapping[str, Any], int], tuple[Any, ...]]
) -> None:
    """Draw the first second of every window of a stretch, measured and predicted.

    Args:
        series: x and y of the line of one window.
    """
    _, fans, rows = _stretch(result)
    label = f"predicted, {_FAN:g} s"
    styles = (fans.measured, DARK, 1.4, "measured"), (fans.predicted, BLUE, 0.9, label)
    for k, row in enumerate(rows):
        near = fans.time[row] <= fans.time[row][0] + _FAN
        for of, color, width, label in styles:
            x, y = series(of, row)
            axes.plot(x[near], y[near], color=color, lw=width, label=label * (k == 0))


def _stretch(result: Replay) -> tuple[str, Fans, np.ndarray]:
    """The longest log, and the numbers of its windows that are drawn, from its middle."""
    name, fans = max(result.fans.items(), key=lambda item: len(item[1].time))
    first = max((len(fans.time) - _SHOWN) // 2, 0)
    return name, fans, np.arange(first, min(first + _SHOWN, len(fans.time)))


def _trajectory_head(fit: TrajectoryFit) -> str:
    models = ", ".join(f"{axle} {tire.name}" for axle, tire in fit.axles.items())
    return f"FIT BY TRAJECTORY: {models}; {fit.windows} windows of {', '.join(fit.logs)}"


def _noise(fit: TrajectoryFit) -> str:
    noise = (f"{name} {format_number(std, 2)} {UNITS[name]}" for name, std in fit.noise.items())
    return f"rms error of the car within a window, on these tires: {', '.join(noise)}"


def trajectory_text(fit: TrajectoryFit) -> str:
    """The report: tires and unknowns of the car, noise, assumptions."""
    rows = [["parameter", "value ± std", "95 % interval", "unit", ""]]
    for name, parameter in fit.parameters.items():
        interval = " to ".join(format_number(end, 3) for end in parameter.ci95)
        note = UNKNOWNS[name].meaning if name in UNKNOWNS else ""
        note = note if parameter.identified else "NOT IDENTIFIED"
        rows.append(
            [name, format_estimate(parameter.value, parameter.std), interval, parameter.unit, note]
        )
    notes = [
        "95 % by covariance; by profile for a tire whose peak is not reached",
        f"{fit.blocks} blocks of windows count as independent",
        "speed and steering are those of the log; axle loads are static; no drive force",
    ]
    first = Section("Answer", [*fit.conclusions, *fit.warnings, _noise(fit)])
    sections = [first, Section("Found", (), rows), Section("Notes", notes)]
    return f"{_trajectory_head(fit)}\n{report_text(sections)}"


def trajectory_figure(fit: TrajectoryFit) -> Picture:
    """Lateral force of both axles with its 95 % band, over the points that ``derive``
    gives, with the steering as late as the yaw rate shows."""
    generator, panels = np.random.default_rng(0), []
    labels = "slip angle [rad]", "lateral force of the axle [N]"

    def draw(axes: Any, axle: str) -> None:
        tire, rows = fit.axles[axle], fit.rows[axle]
        some = generator.permutation(len(rows))[:1500]
        dots(axes, rows["alpha"][some], rows["fy"][some], 1.4, GREY, label="derived from the log")
        reach = np.percentile(np.abs(rows["alpha"]), 99.5)
        alpha = np.linspace(-reach, reach, 121)
        force, half = fit.force(axle, alpha)
        axes.fill_between(
            alpha, force - half, force + half, color=BLUE, alpha=0.3, lw=0, label="95 %"
        )
        axes.plot(alpha, force, color=BLUE, lw=1.4, label=tire.name)

    for axle in fit.axles:
        title = f"{axle.capitalize()} axle, by trajectory"
        panels.append(axes_panel(partial(draw, axle=axle), title, *labels))
    return together(panels, _trajectory_head(fit), _noise(fit), "braking positive, SI")
