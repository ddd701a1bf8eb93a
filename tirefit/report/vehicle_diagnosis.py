"""A diagnosis of a car as text and as a picture."""

import numpy as np

from tirefit.diagnosis.engine.decide import Status
from tirefit.diagnosis.engine.left_out import NOISE
from tirefit.report.canvas import BLUE, GREY, ORANGE, Picture, panel_title, tidy
from tirefit.report.diagnosis_answer import or_twins
from tirefit.report.diagnosis_draw import draw_ladder
from tirefit.report.diagnosis_panels import LadderBar
from tirefit.report.diagnosis_sections import each_text, sizes_text
from tirefit.report.diagnosis_words import amount_text, listing, name_with_id, set_name, share_text
from tirefit.report.numbers import format_number
from tirefit.report.panels import legend_below
from tirefit.report.text import indented, table
from tirefit.vehicle.diagnose import Miss, VehicleDiagnosis

_UNITS = {"v_y": "m/s", "yaw_rate": "rad/s", "heading": "rad", "x": "m", "y": "m"}
_CHANNELS = {
    "v_y": "lateral speed",
    "yaw_rate": "yaw rate",
    "heading": "heading",
    "x": "x",
    "y": "y",
}
_KINDS = {"noise": "noise", "anything smooth": "smooth", "tires fitted": "base"}
_STATES = ("as given", "tires fitted", "with the effects")


def _effect_text(result: VehicleDiagnosis, effect: str) -> str:
    amplitude = result.amplitudes[effect]
    amount = amount_text(*amplitude[:3])
    return f"{name_with_id(effect)}, {amount} {amplitude.formula}".rstrip()


def answer(result: VehicleDiagnosis) -> str:
    """The effects that the model of the car lacks, and its error without and with them."""
    verdict = result.verdict
    if verdict.status == Status.NONE:
        return (
            "With fitted tires, the error of the car is within the noise of these logs:"
            " they show no missing effect."
        )
    like = [
        f"{_effect_text(result, e)} ({verdict.each[e].probability:.2f} that this is the cause)"
        for e in verdict.acts_like
    ]
    acting = f" In the model, the error acts like {listing(like)}." if like else ""
    names = [
        f"{_effect_text(result, e)}{or_twins(result, e)} ({verdict.each[e].probability:.2f})"
        for e in verdict.effects
        if e in verdict.each
    ]
    text = f"The model of the car lacks {listing(names)}." if names else ""
    if not names:
        text = "There is an error, and no listed effect is its likely cause."
    text += acting
    if not verdict.key:
        return text
    channel = next(c for c in ("yaw_rate", "heading") if c in result.noise)
    before, after = (
        f"{format_number(part[channel], 2)}"
        for part in (result.miss.fitted, result.miss.with_effects)
    )
    text += f" Over {result.window:g} s the rms error of its {_CHANNELS[channel]} is {after}"
    text += f" {_UNITS[channel]} (noise included) instead of {before}."
    if verdict.status == Status.INCOMPLETE:
        text += " A further error remains that no listed effect explains."
    twins = {twin for each in verdict.each.values() for twin in each.twins}
    if others := [e for e in verdict.also_possible if e not in twins]:
        text += f" These logs do not rule out {listing([*map(name_with_id, others)], 'or')}."
    return text


def _effects(result: VehicleDiagnosis) -> list[str]:
    lines = []
    for effect, each in result.verdict.each.items():
        record = result.effects[effect]
        lines += [f"{_effect_text(result, effect)}: {each_text(each)}"]
        if sizes := result.sizes.get(effect):
            lines += [sizes_text(sizes[0], result.amplitudes[effect][2])]
        lines += [f"{record.means}; {record.remedy}"]
        if each.twins or result.verdict.also_possible:
            lines += [f"to distinguish it from similar effects: {record.told_apart_by}"]
    return [line for text in lines for line in indented(text)]


def _miss_rows(result: VehicleDiagnosis, miss: Miss) -> list[str]:
    rows = [["rms over a window", *_STATES, "noise"]]
    for channel, noise in result.noise.items():
        values = (part[channel] for part in miss)
        cells = [format_number(value, 3) for value in (*values, noise)]
        rows.append([f"{_CHANNELS[channel]} [{_UNITS[channel]}]", *cells])
    return table(rows, (1, 2, 3, 4))


def _steps(result: VehicleDiagnosis) -> list[str]:
    """Names of the steps of the ladder."""
    return [set_name(s.effects) if s.effects else "tires fitted" for s in result.ladder.steps]


def _ladder(result: VehicleDiagnosis) -> list[str]:
    rows = [["step", "rms over the noise", "closed"]]
    for name, step in zip(_steps(result), result.ladder.steps, strict=True):
        closed = share_text(step.closed) if step.effects != NOISE else "-"
        rows.append([name, format_number(step.rms_left_out, 3), closed])
    return table(rows, (1, 2))


def vehicle_diagnosis_text(result: VehicleDiagnosis) -> str:
    """The report: the answer, the effects, what to do, errors without and with effects."""
    logs = ", ".join(result.logs)
    lines = [f"DIAGNOSIS OF A CAR: {result.windows} windows of {logs}"]
    lines += ["ANSWER", *indented(answer(result))]
    if result.verdict.each:
        lines += ["EFFECTS", *_effects(result)]
    lines += ["ERROR OF THE CAR", *_miss_rows(result, result.miss)]
    if result.held_out:
        lines += ["ERROR ON THE HELD-OUT LOGS", *_miss_rows(result, result.held_out)]
    lines += [f"STEP BY STEP, {result.ladder.on}", *_ladder(result)]
    rows = [["factor on", "value"]]
    rows += [[name, amount_text(*one[:3])] for name, one in result.parameters.items()]
    lines += ["TIRES, FITTED WITH THE EFFECTS", *table(rows)]
    left = f"probability of an unlisted effect: {result.verdict.unlisted:.2f}"
    lines += ["WHAT IS LEFT", *indented(left), "NOTES"]
    if result.untestable:
        lacks = (f"{e} ({', '.join(n)})" for e, n in result.untestable.items())
        lines += indented(f"these logs cannot show: {', '.join(lacks)}")
    return "\n".join([*lines, *(x for note in result.notes for x in indented(note))])


def vehicle_diagnosis_figure(result: VehicleDiagnosis) -> Picture:
    """The rms over the noise on data left out, step by step, and the errors of the car by
    channel."""
    picture = Picture(figsize=(10.0, 3.6), layout="constrained")
    first, second = picture.subfigures(1, 2, squeeze=False, width_ratios=(1.5, 1))[0]
    bars = [
        LadderBar(
            name,
            step.rms_left_out,
            None,
            None if step.effects in ((), NOISE) else step.closed,
            _KINDS.get(name, "effect"),
        )
        for name, step in zip(_steps(result), result.ladder.steps, strict=True)
    ]
    draw_ladder(first, bars, "× noise", result.ladder.on)
    right = second.subplots()
    miss, width = result.held_out or result.miss, 0.25
    for k, (label, part, color) in enumerate(zip(_STATES, miss, (GREY, ORANGE, BLUE), strict=True)):
        values = [part[c] / result.noise[c] for c in result.noise]
        right.bar(np.arange(len(values)) + (k - 1) * width, values, width, color=color, label=label)
    right.set_xticks(range(len(result.noise)), [_CHANNELS[c] for c in result.noise])
    right.axhline(1.0, color=GREY, lw=0.8, ls=":")
    tidy(right, "", f"rms over {result.window:g} s, over the noise")
    on = "held-out logs" if result.held_out else "these logs"
    panel_title(right, "Error of the car", on)
    legend_below(second, right.get_legend_handles_labels()[0], columns=3)
    return picture
