"""The first screen of a diagnosis: the answer, and what a reader acts on."""

from collections.abc import Iterator

import numpy as np

from tirefit.diagnosis.engine import NONZERO
from tirefit.diagnosis.engine.decide import Status
from tirefit.diagnosis.engine.left_out import AS_GIVEN, NOISE, OWN_MODEL, SMOOTH
from tirefit.diagnosis.summary.closure import WORST
from tirefit.diagnosis.summary.result import UNITS, Diagnosis, NextMeasurement, Readings, Shrinkage
from tirefit.report.diagnosis import words
from tirefit.report.diagnosis.answer import readings_section, worse_steps
from tirefit.report.numbers import format_estimate, format_number
from tirefit.report.page import Section, first_of

_SHOWN = (
    "signs read as",
    "sign convention declared",
    "warning: the simulator",
    "found by tirefit derive",
    "windows of",
    "the forces of derive",
)
"""Texts that mark the notes to show: on signs, on a simulator, on findings of derive, and on
the windows and tires of a car."""


MOST_MISSING = 8  # number of needs on the first screen; the details have the others


def subject(result: Diagnosis) -> str:
    """The file, and the model or the simulated forces with which it is compared."""
    is_forces = result.simulator is not None and result.simulator.kind == "columns"
    against = "the simulator's own forces" if is_forces else result.model
    return f"{result.data.name} against {against}"


def head_lines(result: Diagnosis) -> Iterator[str]:
    """Number of rows, noise, and warnings that come before the answer."""
    data, noise = result.data, result.noise
    levels = ", ".join(
        f"{words.channel_name(name)} {format_number(level, 3)} {UNITS[name]}"
        for name, level in noise.forces.items()
    )
    yield f"{result.n} rows; noise {levels} (standard deviation, {noise.source})"
    if noise.excess > 1.5:
        yield f"the noise is {noise.excess:.2g} times what is stated"
    yield from (s for s in data.assumptions if any(part in s for part in _SHOWN))
    # A simulator with readings may be far from rows that are right.
    for channel, forces in result.rows.items() if not result.readings else ():
        force = np.asarray(result.table[channel]) if result.table else np.nan
        missed = np.nanmean((force - forces["base"]) ** 2)
        explained = 1 - missed / max(np.nanmean(force**2), NONZERO)
        if explained < 0.5:
            yield (
                f"warning: {result.model} explains {max(explained, 0.0):.0%} of the"
                f" mean square of {words.channel_name(channel)}: check columns, units and"
                " signs before you read on"
            )
    check = result.slip_check
    if check is not None and check.fits != check.read_as:
        yield words.slip_check_line(check)


def foot_line(result: Diagnosis) -> str:
    """Signs, units, seed and version of the report."""
    convention = result.data.convention  # of forces
    signs = f"braking positive, SI units (the file: {convention})" if convention else "SI units"
    return f"{signs}; seed {result.seed}, tirefit {result.version}"


def step_label(result: Diagnosis, number: int) -> str:
    """Label of a step of the ladder: its addition to the previous step."""
    steps = result.ladder.steps
    effects = steps[number].effects
    if effects == AS_GIVEN:
        return "the simulator"
    if not effects:
        return "+ its parameters" if number else f"{result.model}, no effect"
    if effects in (SMOOTH, NOISE):
        return "noise floor" if effects == NOISE else SMOOTH[0]
    if effects == OWN_MODEL and result.readings:
        return f"a {result.readings.model} with effects"
    added = [words.name_of(e) for e in effects if e not in steps[number - 1].effects]
    return f"+ {' + '.join(added)}"


def _ladder(result: Diagnosis) -> Section:
    ladder, unit, held_out = result.ladder, result.unit, bool(result.settings.holdout)
    on = f" ({ladder.on}; {result.n} rows)" if ladder.on else ""
    table = [("model", f"rms left out [{unit}]", "closed", f"held out [{unit}]")[: 3 + held_out]]
    for k, step in enumerate(ladder.steps):
        rms, closed = format_number(step.rms_held_out, 3), step.closed_held_out
        share = f"{format_estimate(100 * step.closed, 100 * step.closed_std or None)} %"
        row = step_label(result, k), format_number(step.rms_left_out, 3), share if k else "-"
        table.append((*row, *[rms + f" ({closed or 0:.0%})" * bool(closed)] * held_out))
    lines = ["closed: removed share of the first row's rms beyond the noise, ± std"]
    if not ladder.steps:
        lines = ["no part of these rows can be left out"]
        lines += [gap_line(result, result.gap, "the rows fitted")]
    elif held_out:
        lines[0] += "; held out: rms on those files (share closed there)"
    for k in worse_steps(result):
        old, new = (format_number(ladder.steps[i].rms_held_out, 3) for i in (k - 1, k))
        lines += [
            f"{step_label(result, k)}: predicts the files held out worse ({old} to {new}"
            f" {unit} rms): do not carry it over to other data"
        ]
    if held_out and (held := result.gap.holdout) is not None:
        lines.append(gap_line(result, held, f"files held out ({held.on})"))
    if stand_in := stand_in_line(result):
        lines.append(stand_in)
    # On the page the first panel has the ladder.
    return Section(f"How far the gap shrinks on data left out{on}", lines, table, folded=True)


def gap_line(result: Diagnosis, gap: Shrinkage, where: str) -> str:
    """A line on the size of the gap on some rows, and its closure."""
    unit = result.unit

    def size(force: float) -> str:
        text = f"{format_number(force, 3)} {unit}"
        if result.table is None or unit != "N":  # of a car, or a moment
            return text
        share = 100 * force / np.mean(result.table.usable("fz"))
        return f"{text} ({format_number(share, 2)} % of mean F_z)"

    line = f"{where}: gap of {size(gap.rms)} rms beyond the noise"
    if not (result.verdict.helping or result.simulator):
        return line
    if not gap.resolvable or gap.closed is None:
        return f"{line}, too uncertain to say how much of it closes"
    more = " or more" * (gap.closed <= WORST)
    share = words.closed_text(gap.closed, gap.closed_ci)
    return (
        f"{line}, {size(gap.remaining_rms)}{more} with the answer; closed [90 % interval]: {share}"
    )


def stand_in_line(result: Diagnosis) -> str:
    """A line on the error of the stand-in of a simulator; empty if there is none."""
    if result.simulator is None or result.simulator.surrogate.of_force <= 1e-6:
        return ""
    followed, resolvable = result.simulator.surrogate, result.gap.resolvable
    line = f"{followed.model} stands in for the simulator and differs from it by"
    line += f" {format_number(followed.rms, 3)} N rms,"
    line += f" {words.share_text(followed.of_force)} of its force"
    line += f" and {words.share_text(followed.of_gap)} of the gap" * resolvable
    # Of twelve simulators of other tires, four were diagnosed correctly with a brush, eleven with a
    # tire that followed them.
    if resolvable and followed.of_gap > 0.5:
        line += "; the steps are rough"
    return line


def _effect_lines(result: Diagnosis) -> Iterator[str]:
    verdict = result.verdict
    helping = verdict.helping or verdict.effects
    for effect in (*helping, *verdict.also_possible):
        named, means = effect in helping, words.words_on(effect, result.library)
        size = words.size_of(result, effect)
        name = words.name_of(effect) + f" ({effect})" * (words.name_of(effect) != effect)
        tail = "" if named else "not named"
        if named and size:
            tail = words.amplitude_text(size) + words.in_the_file(result, size)
        yield f"{name}: {tail}" if tail else name
        if (each := verdict.each.get(effect)) is not None:
            cause = words.listing(["it", *map(words.name_of, each.twins)], "or")
            text = f"probability {each.probability:.2f} that {cause} is the cause"
            text += ": this data cannot tell them apart" * bool(each.twins)
            closed = format_estimate(100 * each.closed_left_out, 100 * each.closed_left_out_std)
            yield f"    {text}; closes {closed} % of the gap on data left out"
        if groups := verdict.sizes.get(effect):
            # Those by the covariate over which they are most unequal.
            by, (factor, unit) = groups[0], words.readable_unit(size.unit if size else "")
            pairs = zip(by.size, by.std, strict=True)
            each_size = ", ".join(format_estimate(factor * x, factor * std) for x, std in pairs)
            text = f"size by {words.covariate_text(by.covariate)}: {each_size} {unit}".rstrip()
            share = f"{100 * by.spread:.0f} % of the whole"
            yield f"    {text}; beyond their errors they spread by {share}"
        if means[0]:
            yield f"    {means[0]}" + (f"; to do: {means[1]}" if named else "")
    if verdict.helping and result.simulator:
        yield "amplitudes are measurement minus simulator; either may be wrong"


def left_lines(result: Diagnosis) -> Iterator[str]:
    """The remainder: its rms, and the function that it resembles."""
    left, unit = result.verdict.left, result.unit
    of_gap = f", {100 * left.share:.0f} % of the gap's mean square" * result.gap.resolvable
    yield (
        f"{format_number(left.rms, 3)} {unit} rms beyond the noise{of_gap}; probability"
        f" {left.unlisted:.2f} of an unlisted effect"
    )
    for shape in left.looks_like[:1]:
        yield (
            f"it resembles this: {words.shape_text(shape)} (probability"
            f" {shape.probability:.2f} among such functions; explains"
            f" {100 * shape.explains:.0f} % of its mean square)"
        )
    if not result.verdict.names_an_effect:
        smallest = format_number(result.resolution, 3)
        yield f"smallest unlisted effect that would be detected: {smallest} {unit} rms"


def step_lines(result: Diagnosis) -> list[str]:
    """The next measurements that would tell effects apart; if none does, the best one."""
    # Without a forecast (NaN) every measurement is listed.
    useful = [x for x in result.next_measurement if not x.p_after - x.p_now < 0.1]
    if useful or not result.next_measurement:
        return [f"measure {step.add}: it {_tells_apart(step)}" for step in useful[:3]]
    best = max(result.next_measurement, key=lambda step: step.p_after - step.p_now)
    text = f"no single listed measurement would decide it: at best {best.add}, which"
    return [f"{text} {_tells_apart(best)}"]


def _tells_apart(step: NextMeasurement) -> str:
    first, second = (words.set_name([effect]) for effect in step.separates)
    forecast = f"with probability {step.p_after:.2f}, instead of {step.p_now:.2f} now"
    if np.isnan(step.p_after):
        forecast = f"(these rows: with probability {step.p_now:.2f})"
    return f"separates {first} from {second} {forecast}"


def missing_lines(result: Diagnosis) -> list[str]:
    """A line for each missing need with the effects that cannot be tested without it, the one
    with most effects first."""
    groups: dict[str, list[str]] = {}
    for item in result.untestable:
        needs = words.needs_text(item.needs, bool(result.data.motion))
        groups.setdefault(needs, []).append(words.name_of(item.effect))
    ranked = sorted(groups.items(), key=lambda group: -len(group[1]))
    return [f"{needs}: {', '.join(effects)}" for needs, effects in ranked]


def both_described(result: Diagnosis) -> Readings | None:
    """Both readings of a simulator, if the answer compares them: no change of the simulator
    predicts the measured rows as well as the library's own model."""
    return result.readings if result.readings and result.readings.first == "described" else None


def first_screen(result: Diagnosis) -> list[Section]:
    """Sections of the short report: both readings of a simulator, the ladder, and what
    :func:`of_effects` has, unless the answer compares two descriptions."""
    sections = [_ladder(result)]
    if result.readings:
        sections.insert(0, readings_section(result.readings, result.unit))
    if (both := both_described(result)) is None:
        return [*sections, *of_effects(result)]
    lines = []
    if helping := [words.name_of(effect) for effect in result.verdict.helping]:
        what = f"what the simulator acts like if it is changed ({words.listing(helping)})"
        lines += [f"{what}: among the details (--full)"]
    lines += ["effects on the measured forces, the remainder, and the next measurement:"]
    lines += [f"    tirefit diagnose FILE --model {both.model}"]
    return [*sections, Section("More", lines)]


def of_effects(result: Diagnosis) -> list[Section]:
    """Effects, remainder, next measurement, effects that cannot be tested."""
    steps = step_lines(result) if result.verdict.status != Status.NONE else []
    missing = first_of(missing_lines(result), MOST_MISSING, " in the details")
    return [
        Section("Effects", list(_effect_lines(result))),
        Section("What is left", list(left_lines(result))),
        Section("Next measurement", steps),
        Section("Not testable on this data (missing: effects that need it)", missing),
    ]
