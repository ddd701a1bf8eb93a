"""A replay as text and as a picture."""

import textwrap

import numpy as np

from tirefit.report.canvas import BLUE, DARK, GREY, ORANGE, Picture
from tirefit.report.numbers import format_number
from tirefit.report.text import WIDTH, table
from tirefit.vehicle.replay import QUANTITIES, Replay

_NAMES = {
    "yaw_rate": "yaw rate", "sideslip": "sideslip", "a_y": "lateral acceleration",
    "heading": "heading", "lateral": "lateral position",
}  # fmt: skip
_COLORS = {"tire": BLUE, "linear tire": ORANGE, "no slip": GREY}
_LABELS = {"tire": "these tires", "linear tire": "linear tires", "no slip": "no slip"}
_AHEAD = 0.5
"""Horizon [s] of the answer, or the nearest."""
_SHOWN = 40
"""Windows drawn as fans, at most: some ten seconds of driving."""


def answer(result: Replay) -> str:
    """How far the car is off, and how far the baselines are."""
    reached = result.horizons[: sum(count > 0 for count in result.windows)]
    place = int(np.argmin([abs(h - _AHEAD) for h in reached]))
    rms = {name: errors.rms() for name, errors in result.models.items()}

    def size(model, quantity):
        value = rms[model][quantity][place]
        return f"{format_number(value, 2)} {QUANTITIES[quantity]}"

    return (
        f"{result.horizons[place]:g} s ahead the car on these tires is off by"
        f" {size('tire', 'lateral')} to the side and {size('tire', 'yaw_rate')} in yaw"
        f" rate (rms); on linear tires by {size('linear tire', 'lateral')} and"
        f" {size('linear tire', 'yaw_rate')}, without slip by"
        f" {size('no slip', 'lateral')} and {size('no slip', 'yaw_rate')}."
    )


def replay_text(result: Replay) -> str:
    """The report: the answer, the errors by horizon, what was assumed."""
    fitted = [name for name, is_fitted in result.logs.items() if is_fitted]
    others = [name for name, is_fitted in result.logs.items() if not is_fitted]
    head = f"REPLAY of {len(result.logs)} logs, {result.windows[0]} starts"
    rows = [["rms of", "model", *(f"{h:g} s" for h in result.horizons)]]
    for name, unit in QUANTITIES.items():
        for model, errors in result.models.items():
            values = errors.rms()[name]
            cells = ["-" if x is None else format_number(x, 3) for x in values]
            what = f"{_NAMES[name]} [{unit}]" if model == "tire" else ""
            rows.append([what, _LABELS[model], *cells])
    rows.append(["starts", "", *map(str, result.windows)])
    lines = [head, "ANSWER", *_wrapped(answer(result)), "ERROR BY TIME AFTER THE START"]
    lines += table(rows, tuple(range(2, len(rows[0]))))
    if result.held:
        each = ", ".join(
            f"{_NAMES[name]} {share:.0%}"
            for name, (share, *_) in result.held.items()
            if share is not None
        )
        lines += _wrapped(
            "the 95 % band of the tires' parameters holds, of the measured values"
            f" {result.horizons[0]:g} s ahead: {each}; the rest of the error is none of"
            " the parameters' uncertainty"
        )
    told = "the tires were fitted to: " + (", ".join(fitted) or "none of these logs")
    lines += ["LOGS", *_wrapped(told)]
    if fitted and others:
        lines += _wrapped(f"not fitted to: {', '.join(others)}")
    lines += ["ASSUMED", *(line for note in result.notes for line in _wrapped(note))]
    return "\n".join(lines)


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(text, WIDTH, initial_indent="  ", subsequent_indent=" " * 6)


def replay_figure(result: Replay) -> Picture:
    """Error of the lateral position over the horizon, and a stretch of the path with
    its predictions."""
    picture = Picture(figsize=(9.0, 4.0), layout="constrained")
    left, right = picture.subplots(1, 2)
    for model, errors in result.models.items():
        values = errors.rms()["lateral"]
        left.plot(
            result.horizons, [np.nan if v is None else v for v in values], "o-",
            color=_COLORS[model], label=_LABELS[model],
        )  # fmt: skip
    left.set(xscale="log", yscale="log", xlabel="time after the start [s]")
    left.set_xticks(result.horizons, [f"{h:g}" for h in result.horizons])
    left.minorticks_off()
    left.set_ylabel("rms of the lateral position [m]")
    left.set_title("How far the car is off", loc="left", fontsize=10)
    left.legend(frameon=False, fontsize=9)
    name, fans = max(result.paths.items(), key=lambda item: len(item[1].measured))
    ahead = min(fans.measured.shape[1], 1 + fans.steps_of(1.0))
    measured, predicted = (p[:_SHOWN, :ahead] for p in fans[:2])
    for k, (true, found) in enumerate(zip(measured, predicted, strict=True)):
        right.plot(*true.T, color=DARK, lw=1.2, label="measured" * (k == 0))
        right.plot(*found.T, color=BLUE, lw=0.9, label="predicted, 1 s" * (k == 0))
    right.set_aspect("equal", "datalim")
    right.set(xlabel="x [m]", ylabel="y [m]")
    right.set_title(f"A stretch of {name}", loc="left", fontsize=10)
    right.legend(frameon=False, fontsize=9)
    return picture
