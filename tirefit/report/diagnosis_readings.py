"""The two readings of a simulator in words: its structure, and both described by one model."""

from collections.abc import Iterator

import numpy as np

from tirefit.diagnosis.summary.readings import SLOPE, Estimate, Readings
from tirefit.diagnosis.summary.result import Diagnosis
from tirefit.report.diagnosis_words import amount_text, channel_name, listing, name_of, said_unit
from tirefit.report.numbers import format_estimate, format_number
from tirefit.report.page import Section

_LIKELY = 0.5  # probability of an effect that the simulator's own forces show
_DIFFERS = 2.0  # standard errors beyond which parameters differ

_MANY_TIMES = 3.0
"""Ratio of simulated to measured value above which its number says nothing: the rows hardly
determine it."""

FRICTION = ("mu", "LMUX", "LMUY", "mu_peak")
"""Parameters that limit the force."""


def readings_text(result: Diagnosis, changed: str) -> str:
    """The answer on a simulator: its structure, then the reading that predicts data left out
    better, then a sentence on the other one.

    Args:
        changed: the answer that the simulator with its parameters and effects changed gives.
    """
    both = result.simulator.readings if result.simulator else None
    if both is None:
        return changed
    unit = result.unit
    own, of_it = (format_number(x, 3) for x in (both.measured.rms_left_out, both.rms_changed))
    parts = [
        f"The simulator's {channel_name(s.channel)} shows that {s.means}." for s in both.structure
    ]
    own_effects = both.simulator.effects if both.simulator else {}
    sure = [
        _amount(e, one) for e, one in own_effects.items() if (one.probability or 0.0) >= _LIKELY
    ]
    if sure:
        parts.append(f"The simulator's own forces show {listing(sure)}.")
    if both.first == "changed" and own == of_it:
        return " ".join([*parts, changed])
    if both.first == "changed":
        parts += [
            changed,
            f"(A {both.model} with effects, fitted to the measured rows, predicts rows",
        ]
        parts += [f"left out to {own} {unit}, the changed simulator to {of_it} {unit}.)"]
        return " ".join(parts)
    parts += [f"A {both.model} with effects, fitted to the measured rows, predicts rows left out"]
    parts += [
        f"to {own} {unit}; the simulator, with parameters and effects changed, to {of_it} {unit}."
    ]
    parts += [
        "So this model describes both, and the answer compares them.",
        *_differences(result, both),
    ]
    return " ".join(parts)


def used_friction(result: Diagnosis) -> float:
    """The largest force of the simulator, which is the base of the gap, over the load."""
    if result.table is None:
        return 0.0
    load = np.asarray(result.table["fz"])
    every = [rows["base"] for channel, rows in result.rows.items() if channel != "mz"]
    return max((float(np.nanmax(np.abs(force) / load)) for force in every), default=0.0)


def set_text(name: str, measured: float) -> str:
    """What to do about a parameter."""
    verb = "measured:" if name == SLOPE else f"set {name} to"  # the slope is no parameter
    return f"{verb} {format_number(measured, 3)}"


def ratio_text(
    name: str, meaning: str, ratio: float, error: float, measured: float, used: float
) -> str:
    """A parameter that is ``ratio`` times the measured one, and its measured value; of a ratio
    that is far from one what it means: up to the friction ``used``, there is no limit."""
    todo = set_text(name, measured)
    if ratio > _MANY_TIMES and name in FRICTION:
        return f"no friction limit below {format_number(used, 2)} F_z in these rows ({todo})"
    if ratio > _MANY_TIMES:
        return f"{meaning} more than {_MANY_TIMES:.0f} times too high ({todo})"
    share = format_estimate(100 * abs(ratio - 1), 100 * error)
    return f"{meaning} {share} % too {'high' if ratio > 1 else 'low'} ({todo})"


def _differences(result: Diagnosis, both: Readings) -> Iterator[str]:
    """Sentences on parameters that differ, and on effects of one side alone."""
    here, there = both.measured, both.simulator
    wrong = []
    for name, own in here.parameters.items():
        simulated = _simulated(both, name)
        if there is not None and name == SLOPE:
            continue  # it follows from the others
        if simulated is None or min(own.value, simulated.value) <= 0:
            continue
        ratio = simulated.value / own.value
        error = ratio * np.hypot(own.std / own.value, simulated.std / simulated.value)
        if abs(ratio - 1) > _DIFFERS * error:
            used = used_friction(result)
            wrong.append(ratio_text(name, name, ratio, float(error), own.value, used))
    if wrong:
        yield f"The simulator has {listing(wrong)}."
    lacks = [
        f"{_amount(effect, one)} ({one.probability:.2f} that this is the cause)"
        for effect, one in here.effects.items()
        if there is None or effect not in there.effects
    ]
    if lacks:
        yield f"The measured forces act like {listing(lacks)}."


def _amount(effect: str, one: Estimate) -> str:
    return f"{name_of(effect)} of {amount_text(one.value, one.std, one.unit)}"


def _simulated(both: Readings, name: str) -> Estimate | None:
    if both.simulator is not None:
        return both.simulator.parameters[name]
    slopes = [one.slope for one in both.structure if one.slope is not None and name == SLOPE]
    return Estimate(slopes[0], 0.0, "") if slopes else None


def readings_section(both: Readings, unit: str) -> Section:
    """Both described by one model: parameters, effects that help, error on data left out."""
    table: list[tuple[str, ...]] = [(f"{both.model} with effects", "simulator", "measured")]
    for name, own in both.measured.parameters.items():
        table.append((_label(name, own), _cell(_simulated(both, name)), _cell(own)))
    sides = [side.effects if side else {} for side in (both.simulator, both.measured)]
    for effect in dict.fromkeys(e for side in sides for e in side):
        cells = [side.get(effect) for side in sides]
        label = _label(name_of(effect), next(filter(None, cells)))
        table.append((label, *map(_cell, cells)))
    left = (format_number(s.rms_left_out, 3) if s else "-" for s in (both.simulator, both.measured))
    table.append((f"rms left out [{unit}]", *left))
    lines = ["in brackets: probability of an effect to be the cause"] if any(sides) else []
    for one in both.structure:
        lines += [f"{channel_name(one.channel)} of the simulator: {one.means}"]
        lines += [f"    to do: {one.remedy}"]
    if both.simulator is None and not both.structure:
        lines.append("the model cannot be fitted to the simulator's forces")
    return Section("Both described by one model", lines, table)


def _label(name: str, one: Estimate) -> str:
    unit = said_unit(one.unit)[1]
    return f"{name} [{unit}]" if unit not in ("", "-") else name


def _cell(one: Estimate | None) -> str:
    if one is None:
        return "-"
    factor, sure = said_unit(one.unit)[0], one.probability
    text = format_estimate(factor * one.value, factor * one.std or None)
    return text if sure is None else f"{text} ({sure:.2f})"
