"""The answer of a diagnosis: the largest part of the error first, with its size and remedy; and
the two readings of a simulator, its structure and both described by one model."""

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise

import numpy as np

from tirefit.diagnosis.engine.decide import Status
from tirefit.diagnosis.summary.closure import PARAMETERS
from tirefit.diagnosis.summary.readings import SLOPE
from tirefit.diagnosis.summary.result import Change, Diagnosis, Estimate, Readings
from tirefit.report.diagnosis import words
from tirefit.report.numbers import format_estimate, format_number
from tirefit.report.page import Section

_SHORT = {"mu": "friction", "cpa2": "stiffness", "mu_peak": "peak friction"}
"""Short names of parameters for sentences."""

_FRICTION = ("mu", "LMUX", "LMUY", "mu_peak")  # parameters that limit the force


_MANY_TIMES = 3.0
"""Ratio of simulated to measured value above which its number says nothing: the rows hardly
determine it."""


def answer(result: Diagnosis) -> str:
    """The answer: the largest part of the error first, what to do about it, what else there
    is, and what is left."""
    changes, verdict = change_texts(result), result.verdict
    shares = {part.part: part.share for part in result.budget}
    sentences = [_on_effects(result, shares, "its parameters and " * bool(changes))]
    if changes:
        share = shares.get(PARAMETERS)
        of_error = "" if share is None else f", {words.share_text(share)} of its error"
        largest = max((shares.get(effect, 0.0) for effect in verdict.effects), default=0.0)
        after = verdict.names_an_effect and (share or 0.0) < largest
        sentences.insert(after, f"The simulator has {words.listing(changes)}{of_error}.")
    sentences += _how_much(result)
    if result.readings:
        sentences = [*_of_readings(result, result.readings, " ".join(sentences))]
    return " ".join(sentences)


def _how_much(result: Diagnosis) -> Iterator[str]:
    """The rms of the gap without and with the effects that help, or that it is small; and a
    sentence if they predict the held-out files worse."""
    gap, unit, helping = result.gap, result.unit, result.verdict.helping
    if not helping:
        return
    before, after = (format_number(x, 2) for x in (gap.rms, gap.remaining_rms))
    if gap.resolvable:
        takes = "This takes" if len(helping) == 1 else "These take"
        yield f"{takes} the gap from {before} to {after} {unit} (rms)."
    else:
        noise = result.noise.forces.get(result.data.channels[0])
        beside = f" beside {format_number(noise, 2)} {unit} of noise" if noise else ""
        yield f"The gap is small: {before} {unit} (rms){beside}."
    plain, with_effects = _on_held_out(result)
    if with_effects and with_effects[-1] > plain:
        old, new = (format_number(x, 3) for x in (plain, with_effects[-1]))
        yield (
            f"On the files held out it does not help ({old} to {new} {unit} rms): the"
            " answer is of the diagnosed files alone."
        )


def _on_effects(result: Diagnosis, shares: Mapping[str, float], beyond: str) -> str:
    verdict = result.verdict
    like = _acting(result, shares, "the error" if verdict.names_an_effect else "it")
    if verdict.status == Status.UNKNOWN:
        return (
            f"There is a gap beyond {beyond}the noise, and no listed effect is its likely"
            f" cause. Probability {verdict.left.unlisted:.2f} of an unlisted effect.{like}"
        )
    if not verdict.names_an_effect:
        of_noise = [words.name_of(e) for e in verdict.effects if e != "unknown"]
        tail = f" The noise shows {words.listing(of_noise)}." if of_noise else ""
        text = f"There is no gap beyond {beyond}the noise. Probability {verdict.probability:.2f}"
        return f"{text} of no effect, listed or unlisted.{tail}"
    parts = []
    for effect in carried(result, verdict.effects, shares):
        each, text = verdict.each[effect], words.sized_name(effect, words.size_of(result, effect))
        if each.twins:
            names = words.listing([words.name_of(twin) for twin in each.twins], "or")
            text += f" or {names}, which this data cannot tell apart"
        text += f" ({each.probability:.2f})"
        if effect in shares:
            text += f", {words.share_text(shares[effect])} of the error's mean square"
        # The first remedy; all are under the effects.
        remedies = words.words_on(effect, result.library, bool(result.data.motion))[1]
        remedy = remedies.partition(";")[0]
        parts.append(f"{text}: {remedy}" if remedy and not each.twins else text)
    beside = ""
    if verdict.status == Status.INCOMPLETE:
        beside = f"; an unlisted effect is likely as well ({verdict.left.unlisted:.2f})"
    part = " in part" if beside or like else ""
    return f"The gap comes{part} from {'; then from '.join(parts)}{beside}.{like}"


def _on_held_out(result: Diagnosis) -> tuple[float, list[float]]:
    """The rms on held-out files without effects, and of each later step of the ladder."""
    steps = [(s.effects, s.rms_held_out) for s in result.ladder.steps if s.rms_held_out is not None]
    place = next((k for k, (effects, _) in enumerate(steps) if not effects), len(steps))
    return next((rms for _, rms in steps[place:]), np.inf), [rms for _, rms in steps[place + 1 :]]


def carried(result: Diagnosis, effects: Sequence[str], shares: Mapping[str, float]) -> list[str]:
    """The effects, the largest share of the error first, without those that predict held-out
    files worse, unless no step predicts them better than the model without effects."""
    steps = result.ladder.steps
    added = [{*steps[k].effects} - {*steps[k - 1].effects} for k in worse_steps(result)]
    kept = [effect for effect in effects if effect not in set().union(*added)]
    plain, with_effects = _on_held_out(result)
    if not kept or plain < min(with_effects, default=0.0):
        kept = [*effects]
    return sorted(kept, key=lambda effect: -shares.get(effect, 0.0))


def worse_steps(result: Diagnosis) -> Iterator[int]:
    """Numbers of the steps that predict the held-out files worse than the previous step."""
    for k, (before, after) in enumerate(pairwise(result.ladder.steps), 1):
        old, new = before.rms_held_out, after.rms_held_out
        if old is not None and new is not None and new > old:
            yield k


def _acting(result: Diagnosis, shares: Mapping[str, float], what: str) -> str:
    """A sentence on effects that help without being the likely cause; empty for none."""
    parts = []
    for effect in carried(result, result.verdict.acts_like, shares):
        each = result.verdict.each[effect]
        text = words.sized_name(effect, words.size_of(result, effect))
        removes = f"it removes {words.share_text(each.closed_left_out)} on data left out"
        parts.append(f"{text} ({each.probability:.2f} that this is the cause; {removes})")
    return f" In the model, {what} acts like {words.listing(parts)}." if parts else ""


def change_texts(result: Diagnosis) -> list[str]:
    """Errors of the simulator's parameters, such as ``friction 9 ± 1 % too high``, most
    significant first; only those that differ from the measurement."""
    wrong = [(k, c) for k, c in result.verdict.parameters.items() if c.differs]
    wrong.sort(key=lambda kc: kc[1].std / abs(kc[1].simulated - kc[1].measured))
    structure = result.readings.structure if result.readings else ()
    if any(feature.id == "no_saturation" for feature in structure):
        wrong = [(name, change) for name, change in wrong if name not in _FRICTION]
    meanings = {**result.meanings, **_SHORT}
    # A simulator that is known by its forces has none of the scaling factors; those of the axles
    # of a car are of this diagnosis.
    is_columns = result.simulator is not None and result.simulator.kind == "columns"
    scaling = ("front.", "rear.", *(("LM", "LK") if is_columns else ()))
    return [
        _change_text(result, name, meanings.get(name, name), change, name.startswith(scaling))
        for name, change in wrong
    ]


def _change_text(
    result: Diagnosis, name: str, meaning: str, change: Change, is_factor: bool = False
) -> str:
    """How far a parameter is off, and what to do; of a ratio that is far from one what it means:
    up to the friction that the rows use, there is no limit."""
    verb = "measured:" if name == SLOPE else f"set {name} to"  # the slope is no parameter
    todo = f"{'multiply it by' if is_factor else verb} {format_number(change.measured, 3)}"
    off = change.simulated - change.measured
    side = f"too {'high' if off > 0 else 'low'} ({todo})"
    if min(change.simulated, change.measured) <= 0:
        return f"{meaning} {format_estimate(abs(off), change.std)} {side}"
    ratio = change.simulated / change.measured
    if ratio > _MANY_TIMES:
        if name not in _FRICTION:
            return f"{meaning} more than {_MANY_TIMES:.0f} times too high ({todo})"
        used = format_number(_used_friction(result), 2)
        return f"no friction limit below {used} F_z in these rows ({todo})"
    if name not in _FRICTION and abs(math.log(math.degrees(ratio))) < 0.1:  # 1/57 to a tenth
        return f"{meaning} {1 / ratio:.0f} times too low, as if it were per degree ({todo})"
    error = ratio * change.std / change.measured
    return f"{meaning} {format_estimate(100 * abs(ratio - 1), 100 * error)} % {side}"


def _used_friction(result: Diagnosis) -> float:
    """The largest force of the simulator, which is the base of the gap, over the load."""
    load = np.asarray(result.table["fz"]) if result.table else np.inf  # a car has no rows
    every = [rows["base"] for channel, rows in result.rows.items() if channel != "mz"]
    return max((float(np.nanmax(np.abs(force) / load)) for force in every), default=0.0)


# --- both readings of a simulator -----------------------------------------------------


def _of_readings(result: Diagnosis, readings: Readings, changed: str) -> Iterator[str]:
    """The answer on a simulator: its structure, then the reading that predicts data left out
    better, then a sentence on the other one.

    Args:
        changed: the answer that the simulator with its parameters and effects changed gives.
    """
    unit, measured = result.unit, readings.measured
    rms, of_it = (format_number(x, 3) for x in (measured.rms_left_out, readings.rms_changed))
    for part in readings.structure:
        channel = words.channel_name(part.channel)
        yield f"The simulator's {channel} shows that {part.means}. To do: {part.remedy}."
    simulated = readings.simulator.effects if readings.simulator else {}
    likely = {e: x for e, x in simulated.items() if (x.probability or 0.0) >= 0.5}
    if likely:
        shown = words.listing([words.sized_name(effect, x) for effect, x in likely.items()])
        yield f"The simulator's own forces show {shown}."
    if surplus := [words.name_of(e) for e in likely if e not in measured.effects]:
        names = words.listing(surplus, "or")
        yield f"The measured forces do not show {names}: take it out of the simulator."
    fitted = f"A {readings.model} with effects, fitted to the measured rows, predicts rows left out"
    fitted += f" to {rms} {unit}"
    if readings.first == "changed":
        yield changed
        if rms != of_it:
            yield f"({fitted}, the changed simulator to {of_it} {unit}.)"
        return
    yield from _differences(result, readings)
    why = "so the answer describes both the rows and the simulator by this model"
    if readings.gain <= readings.gain_std:
        why = "neither is better, and this model needs no stand-in for the simulator"
    changes = "the simulator, with parameters and effects changed"
    yield f"{fitted}; {changes}, to {of_it} {unit}: {why}."


def _differences(result: Diagnosis, readings: Readings) -> Iterator[str]:
    """Sentences on parameters that differ, and on effects of one side alone."""
    here, there = readings.measured, readings.simulator
    wrong = []
    for name, measured in here.parameters.items():
        simulated = _simulated(readings, name)
        if there is not None and name == SLOPE:
            continue  # it follows from the others
        if simulated is None or min(measured.value, simulated.value) <= 0:
            continue
        error = np.hypot(measured.std / measured.value, simulated.std / simulated.value)
        ratio = simulated.value / measured.value
        if abs(ratio - 1) > 2.0 * ratio * error:
            both = Change(simulated.value, measured.value, error * measured.value, True)
            wrong.append(_change_text(result, name, _SHORT.get(name, name), both))
    if wrong:
        yield f"The simulator has {words.listing(wrong)}."
    if there is None:
        values = [
            f"{_SHORT.get(k, k)} {words.amount_text(x.value, x.std or None, x.unit)} ({k})"
            for k, x in here.parameters.items()
            if k != SLOPE
        ]
        yield f"A {readings.model} of the measured rows has {words.listing(values)}."
    ranked = sorted(here.effects.items(), key=lambda pair: -(pair[1].probability or 0.0))
    lacks = [
        f"{words.sized_name(effect, size)} ({size.probability:.2f} that this is the cause)"
        for effect, size in ranked
        if there is None or effect not in there.effects
    ]
    if lacks:
        yield f"The measured forces act like {words.listing(lacks)}."


def _simulated(readings: Readings, name: str) -> Estimate | None:
    if readings.simulator is not None:
        return readings.simulator.parameters[name]
    slopes = [x.slope for x in readings.structure if x.slope is not None and name == SLOPE]
    return Estimate(slopes[0], 0.0, "") if slopes else None


def readings_section(readings: Readings, unit: str) -> Section:
    """Both described by one model: parameters, effects that help, error on data left out."""
    table: list[tuple[str, ...]] = [(f"{readings.model} with effects", "simulator", "measured")]
    sides = [dict(side.effects) if side else {} for side in (readings.simulator, readings.measured)]
    pairs: dict[str, tuple[Estimate | None, ...]] = {
        name: (_simulated(readings, name), x) for name, x in readings.measured.parameters.items()
    }
    pairs |= {words.name_of(k): tuple(x.get(k) for x in sides) for k in sides[0] | sides[1]}
    for name, pair in pairs.items():
        said = words.readable_unit(next(filter(None, pair[::-1])).unit)[1]
        table.append((f"{name} [{said}]" if said not in ("", "-") else name, *map(_cell, pair)))
    both = readings.simulator, readings.measured
    left = (format_number(side.rms_left_out, 3) if side else "-" for side in both)
    table.append((f"rms left out [{unit}]", *left))
    nearest = f"of the {readings.model} without effects whose forces are nearest to these"
    lines = ["in brackets: probability of an effect to be the cause", f"parameters: {nearest}"]
    lines *= any(sides)
    for feature in readings.structure:
        lines += [f"{words.channel_name(feature.channel)} of the simulator: {feature.means}"]
        lines += [f"    to do: {feature.remedy}"]
    if readings.simulator is None and not readings.structure:
        lines.append("the model cannot be fitted to the simulator's forces")
    return Section("Both described by one model", lines, table)


def _cell(number: Estimate | None) -> str:
    if number is None:
        return "-"
    factor = words.readable_unit(number.unit)[0]
    text = format_estimate(factor * number.value, factor * number.std or None)
    return text if number.probability is None else f"{text} ({number.probability:.2f})"
