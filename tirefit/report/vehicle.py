"""Reports of a car: of a replay with what its errors say of tires, effects and steering, and of
a fit by trajectory."""

from functools import partial
from typing import Any

import numpy as np

from tirefit.diagnosis.summary.result import UNITS
from tirefit.models import TireInputs, forces
from tirefit.report import canvas
from tirefit.report.numbers import format_estimate, format_number
from tirefit.report.page import Section, page, report_text, verdict_of
from tirefit.vehicle.errors import FEWEST, QUANTITIES
from tirefit.vehicle.replay import Replay
from tirefit.vehicle.start import UNKNOWNS
from tirefit.vehicle.trajectory import TrajectoryFit

_NAMES = {
    "yaw_rate": "yaw rate",
    "sideslip": "sideslip",
    "a_y": "lateral acceleration",
    "heading": "heading",
    "lateral": "lateral position",
}
_MODELS = {
    "tire": ("these tires", canvas.BLUE),
    "linear tire": ("linear tires", canvas.ORANGE),
    "no slip": ("no slip", canvas.GREY),
    "floor": ("noise floor", canvas.GREEN),
    "with the effects": ("with effects", canvas.RED),
}
"""Compared car -> its label and colour."""
_SHOWN = 40  # largest number of windows that are drawn: about ten seconds of driving
_FAN = 1.0  # duration [s] of a drawn prediction
_PREDICTED = f"predicted, {_FAN:g} s"


_AS_WELL = 1.05  # ratio of two rms errors up to which one model predicts as well as the other
_OFF, _SURE = 0.05, 3.0  # smallest error of the turning that is told, and its standard errors


def _worse(result: Replay, model: str, other: str) -> str:
    """Where a model predicts worse than another one by the largest ratio, such as ``the yaw rate
    after 5 s by 23 rad/s instead of 0.57``; empty if it is nowhere worse."""
    worst, most = "", _AS_WELL
    errors, reference = (result.models[k].rms() for k in (model, other))
    for name in ("yaw_rate", "lateral"):
        each = zip(result.horizons, result.windows, errors[name], reference[name], strict=True)
        for horizon, count, wrong, less in each:
            if count >= FEWEST and wrong and less and wrong > most * less:
                most = wrong / less
                worst = f"the {_NAMES[name]} after {horizon:g} s by {wrong:.2g} {QUANTITIES[name]}"
                worst += f" instead of {less:.2g}"
    return worst


def conclusions(result: Replay) -> list[str]:
    """Sentences on what predicts better, and on what limits the prediction; empty where nothing
    can be said."""
    said = []
    if worse := _worse(result, "tire", "linear tire"):
        said.append(f"The tires predict worse than linear tires: they miss {worse}.")
    if "with the effects" in result.models:
        if worse := _worse(result, "with the effects", "tire"):
            said.append(f"The effects make the prediction worse: with them it misses {worse}.")
    place = result.place
    rms = {k: errors.rms()["yaw_rate"][place] or 0.0 for k, errors in result.models.items()}
    # Rms error over that of the noise from which models can be compared.
    if rms["tire"] < 2.0 * rms["floor"]:
        return said
    if rms["no slip"] <= _AS_WELL * rms["tire"]:
        said.append("The tires are not what limits: a car without slip predicts as well.")
    elif rms["linear tire"] <= _AS_WELL * rms["tire"]:
        said.append("The tires' bend is not what limits: linear tires predict as well.")
    ratio = result.turning
    if ratio is not None and abs(ratio[0] - 1) > max(_OFF, _SURE * ratio[1]):
        text = f"The car turns {ratio[0]:.2f} ± {ratio[1]:.2f} times as much as predicted:"
        text += " `tirefit diagnose --vehicle` tells steering, masses and tires apart."
        said.append(text)
    return said


def answer(result: Replay) -> str:
    """What limits the prediction; the error of the car, of the noise of the log, and of the
    baselines."""
    place = result.place
    rms = {name: errors.rms() for name, errors in result.models.items()}

    def size(model: str, quantity: str = "lateral") -> str:
        value = rms[model][quantity][place]
        return f"{format_number(value, 2)} {QUANTITIES[quantity]}"

    more = ""
    if (name := "with the effects") in rms:
        more = f" With the effects these errors are {size(name)} and"
        more += f" {size(name, 'yaw_rate')}."
    return (
        "".join(f"{sentence} " for sentence in conclusions(result))
        + f"{result.horizons[place]:g} s after a start, the predicted car has an rms"
        f" error of {size('tire')} in lateral position and"
        f" {size('tire', 'yaw_rate')} in yaw rate.{more} The noise of the log causes"
        f" {size('floor')} and {size('floor', 'yaw_rate')} of it. The lateral position"
        f" is wrong by {size('linear tire')} with linear tires and by"
        f" {size('no slip')} for a car without slip."
    )


def _sections(result: Replay) -> list[Section]:
    """Errors by horizon, logs, assumptions."""
    rows = [["rms of", "model", *(f"{h:g} s" for h in result.horizons)]]
    for name, unit in QUANTITIES.items():
        for model, errors in result.models.items():
            cells = ["-" if x is None else format_number(x, 2) for x in errors.rms()[name]]
            what = f"{_NAMES[name]} [{unit}]" if model == "tire" else ""
            rows.append([what, _MODELS[model][0], *cells])
    rows.append(["starts", "", *map(str, result.windows)])
    each = (
        f"{_NAMES[k]} {share:.0%}" for k, (share, *_) in result.held.items() if share is not None
    )
    held = "share of the measured values within the 95 % band of the tires' parameters"
    held += f" {result.horizons[0]:g} s ahead: {', '.join(each)}; the uncertainty of the"
    held += " parameters explains no more of the error"
    fitted = [name for name, is_fitted in result.logs.items() if is_fitted]
    others = [name for name, is_fitted in result.logs.items() if not is_fitted]
    logs = [f"the tires were fitted to {', '.join(fitted) or 'none of these logs'}"]
    if fitted and others:
        logs.append(f"the tires were not fitted to {', '.join(others)}")
    title, right = "Error by time after the start", range(2, len(rows[0]))
    return [
        # On the page the panels have the errors.
        Section(title, [held] * bool(result.held), rows, right=right, folded=True),
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


def plotted(result: Replay, what: str = "path") -> canvas.Picture:
    """Error over the horizon and the ``path``; or the ``series`` of yaw rate and
    lateral acceleration."""
    panels = _panels(result)[what]
    return canvas.together(panels, _head(result), answer(result), "braking positive, SI")


def replay_page(result: Replay) -> str:
    """The replay as one HTML document with its pictures, no script or resource."""
    panels = [panel for panels in _panels(result).values() for panel in panels]
    sections = [Section("", pictures=canvas.images_of(panels)), *_sections(result)]
    verdict = verdict_of(answer(result), (), not result.outcomes)
    return page(_head(result), sections, verdict, record=result.to_json())


def _panels(result: Replay) -> dict[str, list[canvas.Panel]]:
    """Figure -> its panels: errors over the horizon with a stretch of the longest log's path and
    its predictions; yaw rate and lateral acceleration of the same stretch."""
    name, fans = max(result.fans.items(), key=lambda item: len(item[1].time))
    first = max((len(fans.time) - _SHOWN) // 2, 0)  # from the middle of the log
    rows = range(first, min(first + _SHOWN, len(fans.time)))

    def errors_of(axes: Any, quantity: str) -> None:
        for model, errors in result.models.items():
            values = [np.nan if v is None else v for v in errors.rms()[quantity]]
            style, (label, color) = ".:" if model == "floor" else ".-", _MODELS[model]
            axes.plot(result.horizons, values, style, color=color, label=label)
        axes.set(xscale="log", yscale="log")
        axes.set_xticks(result.horizons, [f"{h:g}" for h in result.horizons])
        axes.minorticks_off()

    def stretch(axes: Any, x: str, y: str) -> None:
        time = {"time": fans.time}
        measured = fans.measured, canvas.DARK, 1.4, "measured"
        for row in rows:
            near = fans.time[row] <= fans.time[row][0] + _FAN
            for of, color, width, label in (
                measured,
                (fans.predicted, canvas.BLUE, 0.9, _PREDICTED),
            ):
                across, up = (time | dict(of))[x][row], of[y][row]
                label *= row == first
                axes.plot(across[near], up[near], color=color, lw=width, label=label)
        if x == "time":
            starts = fans.time[rows, 0], fans.predicted[y][rows, 0]
            axes.plot(*starts, ".", color=canvas.BLUE, ms=4)
        else:
            axes.set_aspect("equal", "datalim")

    path, axes_panel = [], canvas.axes_panel
    for key in ("lateral", "yaw_rate"):
        title = f"Error of the {_NAMES[key]} over the horizon"
        labels = "time after the start [s]", f"rms error of the {_NAMES[key]} [{QUANTITIES[key]}]"
        path.append(axes_panel(partial(errors_of, quantity=key), title, *labels))
    title = f"A stretch of {name}, with predictions"
    path.append(axes_panel(partial(stretch, x="x", y="y"), title, "x [m]", "y [m]"))
    title, note, series = f"The same stretch of {name}", "dots: starts of a prediction", []
    for key, unit in {"yaw_rate": "rad/s", "a_y": "m/s²"}.items():
        labels = "time [s]", f"{_NAMES[key]} [{unit}]"
        series.append(axes_panel(partial(stretch, x="time", y=key), title, *labels, note))
    return {"path": path, "series": series}


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
    first = Section("Answer", [*fit.warnings, _noise(fit)])
    sections = [first, Section("Found", (), rows), Section("Notes", notes)]
    return f"{_trajectory_head(fit)}\n{report_text(sections)}"


def trajectory_figure(fit: TrajectoryFit) -> canvas.Picture:
    """Lateral force of both axles with its 95 % band, over the points that ``derive``
    gives, with the steering as late as the yaw rate shows."""
    generator, panels = np.random.default_rng(0), []
    labels = "slip angle [rad]", "lateral force of the axle [N]"

    def draw(axes: Any, axle: str) -> None:
        tire, rows = fit.axles[axle], fit.rows[axle]
        some = generator.permutation(len(rows))[:1500]
        canvas.dots(
            axes,
            rows["alpha"][some],
            rows["fy"][some],
            1.4,
            canvas.GREY,
            label="derived from the log",
        )
        reach = np.percentile(np.abs(rows["alpha"]), 99.5)
        alpha = np.linspace(-reach, reach, 121)
        at = TireInputs(alpha=alpha, fz=rows["fz"][0], v=rows["v"].mean())
        drawn = [np.asarray(forces(sample, at).fy) for sample in tire.drawn(generator, 60)]
        low, high = np.percentile(drawn, (2.5, 97.5), axis=0)
        axes.fill_between(alpha, low, high, color=canvas.BLUE, alpha=0.3, lw=0, label="95 %")
        axes.plot(alpha, forces(tire.tire, at).fy, color=canvas.BLUE, lw=1.4, label=tire.name)

    for axle in fit.axles:
        title = f"{axle.capitalize()} axle, by trajectory"
        panels.append(canvas.axes_panel(partial(draw, axle=axle), title, *labels))
    return canvas.together(panels, _trajectory_head(fit), _noise(fit), "braking positive, SI")
