"""A diagnosis in the terminal: what one can act on, in one screen."""

import textwrap

from tirefit.diagnosis.decide.adequacy import LEAST_P, refused
from tirefit.diagnosis.effects import EFFECTS
from tirefit.diagnosis.effects.per_run import RELATIVE
from tirefit.diagnosis.summary.records import Region, Shrinkage
from tirefit.diagnosis.summary.result import Diagnosis
from tirefit.report.diagnosis_budget import budget_lines, change_texts
from tirefit.report.diagnosis_outlook import confused_lines, smallest_lines, step_lines
from tirefit.report.diagnosis_words import (
    AGAINST,
    UNLISTED,
    amount_text,
    closed_text,
    covariate_text,
    listed_candidates,
    look_text,
    nothing,
    p_text,
    parameter_text,
    range_text,
    remaining_text,
    said_effects,
    said_unit,
    share_text,
    slip_check_line,
    untestable_groups,
    words_on,
)
from tirefit.report.numbers import format_estimate, format_number

_WIDTH = 88
_RUNS = "RUNS (how they differ beside what else is named, each by itself)"
_LEVEL = 0.05
_OF_SIGNS = ("signs read as", "sign convention declared", "warning: the simulator")
"""What sentences on the signs of the data, or of a simulator, have in them."""
_FEW = 10
"""Effects that are named one by one."""


def subject(result: Diagnosis) -> str:
    """Which file is held against what: a model, or a simulator's own forces."""
    is_forces = result.simulator is not None and result.simulator.kind == "columns"
    against = "the simulator's own forces" if is_forces else result.model
    return f"{result.data.name} against {against}"


def stand_in(result: Diagnosis) -> str:
    """The tire that stands in where only a simulator's forces are known; else empty."""
    if result.simulator is None or result.simulator.kind != "columns":
        return ""
    return f"{result.simulator.surrogate.model} stands in for the simulator"


def verdict_sentence(result: Diagnosis) -> str:
    """The verdict as one sentence; of a simulator, its parameters first."""
    changes = change_texts(result)
    if not changes:
        return _sentence_on_effects(result)
    said = f"{' and '.join(changes)} in the simulator"
    if result.verdict.status == "none":
        else_ = _or_else(result)
        return f"{said}, and nothing else ({_probability(result)}){else_}"
    return f"{said}; {_sentence_on_effects(result)}"


def _probability(result: Diagnosis) -> str:
    return f"probability {result.verdict.probability:.2f}"


def _sentence_on_effects(result: Diagnosis) -> str:
    verdict, probability = result.verdict, _probability(result)
    effects = " + ".join(verdict.effects)
    status = verdict.status
    if status == "none" or (status == "named" and not verdict.names_an_effect):
        noise = f"; its noise shows {effects}" if effects else ""
        return f"no gap beyond the noise ({probability}){_or_else(result)}{noise}"
    if status == "named":
        return f"{effects} ({probability})"
    if status == "incomplete":
        among = f" ({more})" if (more := _or_else(result).removeprefix(", ")) else ""
        rest = "something no listed effect explains"
        return f"{effects}{among}, and {rest} ({probability})"
    if status == "cannot_tell":
        return f"{effects} ({probability}){_or_else(result)}"
    return f"a gap that no listed effect explains ({probability}){_or_else(result)}"


def _or_else(result: Diagnosis) -> str:
    """What this data cannot tell from what is said, in its place and beside it; empty
    for nothing."""
    verdict = result.verdict
    beside = [e for e in verdict.also_possible if _only_beside(result, e)]
    instead = [e for e in verdict.also_possible if e not in beside]
    said = [f"or {', '.join(instead)}"] if instead else []
    said += [f"perhaps with {' or '.join(beside)} beside it"] if beside else []
    return f", {', '.join(said)}: this data cannot tell" if said else ""


def _only_beside(result: Diagnosis, effect: str) -> bool:
    """Whether the candidates that hold an effect hold all that is named as well."""
    named = set(result.verdict.effects) if result.verdict.names_an_effect else set()
    holding = [set(c.effects) for c in result.candidates if effect in c.effects]
    return bool(named and holding) and all(named < one for one in holding)


def verdict_lines(result: Diagnosis) -> list[str]:
    """Amplitudes of what is named, each effect in words, and what they leave."""
    verdict, lines = result.verdict, []
    same = (c for c in result.candidates if c.effects == verdict.effects)
    if verdict.names_an_effect and (chosen := next(same, None)) is not None:
        lines.append(parameter_text(chosen))
        if result.simulator:
            lines.append(AGAINST)
    for effect in (*verdict.effects, *verdict.also_possible):
        means, remedy = words_on(effect, result.library)
        if means:
            lines.append(f"{effect}: {means}; {remedy}")
    left = (elsewhere_line(result), adequacy_line(result))
    return [*lines, *filter(None, left), *look_lines(result)]


def elsewhere_line(result: Diagnosis) -> str:
    """Why there is something more, where rows left out tell; empty where they do
    not."""
    verdict, gap = result.verdict, result.gap
    if not verdict.fails_elsewhere:
        return ""
    on = f" ({gap.holdout.on})" if gap.holdout is not None else ""
    if verdict.status == "unknown" or gap.holdout is None:
        return (
            "the listed effects that fit these rows best do not predict the rows left"
            f" out{on}: none is named"
        )
    return (
        f"something more is said to be there because rows left out{on} are predicted"
        f" far worse than the rows fitted: closed"
        f" {closed_text(gap.holdout.net_closed)} there, {closed_text(gap.net_closed)}"
        " here"
    )


def look_lines(result: Diagnosis) -> list[str]:
    """What an unlisted remainder looks like, as sentences."""
    return [
        f"it looks like {look_text(look)} (probability {look.probability:.2f} among"
        f" simple shapes; takes {100 * look.explains:.0f} % of its mean square away)"
        for look in result.verdict.looks_like
    ]


_LEFT = {
    "time": "rows next to one another in time miss alike",
    "slip_order": "rows next to one another in slip miss alike",
    "line": "a wave stands out",
    "pure_error": "it scatters more than repeats do",
    "local": "one region is missed",
    "held_out": "a load, speed, sign, time or range of slip left out is not predicted",
}


def adequacy_line(result: Diagnosis) -> str:
    """What the named effects leave, as one sentence; empty where nothing was tested."""
    adequacy, verdict = result.verdict.adequacy, result.verdict
    values = adequacy._asdict()
    tested = [name for name in _LEFT if values[name] is not None]
    if not tested:
        return ""
    what = (
        "what the named effects leave" if verdict.names_an_effect else "the remainder"
    )
    failed = refused(adequacy)
    if not failed and verdict.fails_elsewhere:
        return ""  # not randomness here, but rows left out decided
    if not failed:
        return f"{what} looks random in {len(tested)} tests"
    least = LEAST_P * len(result.data.channels)
    parts = (f"{_LEFT[name]} (p {p_text(values[name], least)})" for name in failed)
    return f"{what} has structure: {'; '.join(parts)}"


def gap_lines(result: Diagnosis) -> list[str]:
    """How large the gap is and how far it shrinks, as sentences."""
    gap = result.gap

    def size(force: float) -> str:
        share = format_number(100 * force / result.mean_load, 2)
        return f"{format_number(force, 3)} N ({share} % of mean F_z)"

    lines = [f"{size(gap.rms)} rms beyond the noise"]
    if not (result.verdict.names_an_effect or result.simulator):
        roughly = "" if gap.resolvable else ", roughly"
        others = [gap.holdout] if gap.holdout is not None else []
        said = (f"on {other.on}: {size(other.rms)}" for other in others)
        return [f"{lines[0]}{roughly}{_in_the_noise(result)}", *said]
    if not gap.resolvable:
        return [f"{lines[0]}: too uncertain to say how much of it closes"]
    places: list[tuple[Shrinkage, str]] = [(gap, "on these rows")]
    if gap.holdout is not None:
        places.append((gap.holdout, f"on {gap.holdout.on}"))
    for here, where in places:
        closed = here.net_closed
        if closed is None:
            lines.append(f"{where}: {size(here.rms)}, too uncertain to say")
            continue
        lines.append(
            f"{where}: closed"
            f" {closed_text(closed, here.closed_ci, here.energy_closed)};"
            f" {size(here.rms)} to {remaining_text(closed, size(here.remaining_rms))}"
        )
    if gap.shares:
        parts = (f"{name} {100 * share:.0f} %" for name, share in gap.shares.items())
        lines.append(f"of the energy closed, in any order: {', '.join(parts)}")
    return lines


def _in_the_noise(result: Diagnosis) -> str:
    """That what is left looks like something larger than the gap: none of it is smooth,
    and it counts as noise; empty where it does not."""
    noise = result.noise.forces[result.data.channels[0]]
    alike = result.verdict.looks_like
    shown = noise * max((look.explains for look in alike), default=0.0) ** 0.5
    if shown <= result.gap.rms:
        return ""
    rms = format_number(shown, 3)
    return (
        f"; what is left looks like {rms} N of a finer shape, which the noise contains"
    )


def _where(result: Diagnosis, most: int = 4) -> list[str]:
    """One line a covariate, those that sort the gap best first."""
    groups: dict[str, list[Region]] = {}
    for region in result.where:
        groups.setdefault(region.covariate, []).append(region)
    spread_lines = []
    for name, regions in groups.items():
        if min(region.p_value for region in regions) > _LEVEL:
            continue
        even = 1 / len(regions)
        spread = sum(abs(region.share - even) for region in regions)
        parts = (
            f"{100 * region.share:.0f} % at {range_text(region)}"
            for region in sorted(regions, key=lambda region: region.low)
        )
        spread_lines.append((spread, f"  {covariate_text(name)}: {', '.join(parts)}"))
    spread_lines.sort(key=lambda pair: -pair[0])
    lines = [line for _, line in spread_lines[:most]]
    lines += [f"  {line}" for line in spot_lines(result)]
    return lines or ["  no region stands out at a false-discovery rate of 5 %"]


def spot_lines(result: Diagnosis) -> list[str]:
    """Short stretches that hold much of the gap, a line each."""
    return [
        f"in one place: {covariate_text(spot.covariate)} {range_text(spot)}:"
        f" {share_text(spot.share)} in {share_text(spot.rows)} of the rows"
        for spot in result.spots
    ]


def _candidates(result: Diagnosis, most: int = 5) -> list[str]:
    none = nothing(result)
    lines = [f"  {none[1]:.2f}  {none[0]}"] if none else []
    for candidate in listed_candidates(result.candidates)[:most]:
        if candidate.probability < 0.005:
            break
        effects = " + ".join(said_effects(candidate, result.verdict))
        closed = candidate.closed
        tail = "" if not closed else f", closes {closed_text(closed)}"
        values = parameter_text(candidate) if candidate.probability >= 0.05 else ""
        lines.append(
            f"  {candidate.probability:.2f}  {effects}{tail}"
            + (f"  ({values})" if values else "")
        )
    if (unlisted := result.verdict.unlisted) >= 0.005:
        lines.append(f"  {unlisted:.2f}  {UNLISTED}")
    return lines or ["  none"]


def map_lines(result: Diagnosis, most: int = 3) -> list[str]:
    """Parameters that would have to vary, as sentences; none where none stands out."""
    return [
        f"{cell.parameter} that varies with {covariate_text(cell.covariate)}:"
        f" log evidence {cell.log_evidence:.0f}, explains up to"
        f" {100 * cell.explains:.0f} % of the misfit"
        for cell in result.map[:most]
        if cell.log_evidence > 3
    ]


_BEYOND = 1.5
"""Noise over the stated one from which it is said how many times that it is."""


def rows_line(result: Diagnosis) -> str:
    """How many rows, and the noise: its levels, where they come from, as how many
    independent rows it averages, and what is wrong with it."""
    noise, n = result.noise, result.n
    units = {"fx": " N", "fy": " N", "mz": " N m", "alpha": " rad"}

    def said_of(levels, source) -> str:
        each = ", ".join(
            f"{name} {format_number(level, 3)}{units.get(name, '')}"
            for name, level in levels.items()
        )
        return f"{each} ({source})"

    of_forces = said_of(noise.forces, noise.source)
    if noise.excess > _BEYOND:
        of_forces += f", {noise.excess:.2g} times what is stated"
    of_slip = said_of({noise.slip_name: noise.slip}, noise.slip_source)
    flags = f"; {', '.join(noise.flags)}" if noise.flags else ""
    if noise.outliers:
        flags += f"; {noise.outliers} rows set aside as outliers"
    said = f"{n} rows; noise {of_forces}, {of_slip}"
    if round(result.n_effective) < n:
        said += f", averages as that of {result.n_effective:.0f} independent rows"
    return said + flags


def run_lines(result: Diagnosis) -> list[str]:
    """How far the runs of the file differ, one line for each kind of offset."""
    lines = []
    for kind, runs in result.runs.items():
        factor, unit = said_unit(runs.unit)
        common = f"{amount_text(runs.common, runs.std, runs.unit)} for all, "
        if runs.unit == RELATIVE:  # what is common is the tire's own parameter
            common = ""
        spread = amount_text(runs.spread, None, runs.unit, 2)
        low, high = (format_number(factor * end, 2) for end in runs.spread_ci)
        own = (
            f"{name} {format_estimate(factor * value, factor * std)}"
            for name, (value, std) in runs.values.items()
        )
        shrunk = f"shrunk{f' [{unit}]' * bool(unit)}: {', '.join(own)}"
        lines.append(
            f"{kind}: {common}spread between runs {spread} [{low}, {high}]"
            f" (p {p_text(runs.p_value)} of none); {shrunk}"
        )
    return lines


def _wrapped(lines) -> list[str]:
    return [
        part
        for line in lines
        for part in textwrap.wrap(
            line, _WIDTH, subsequent_indent="    ", break_long_words=False
        )
    ]


def _not_looked_for(result: Diagnosis) -> list[str]:
    """A line on the listed effects that the caller left out; none where all count."""
    out = [one.id for one in EFFECTS if one.id not in result.settings.effects]
    few = (
        ", ".join(out) if len(out) <= _FEW else f"{len(out)} of {len(EFFECTS)} effects"
    )
    return [f"  not looked for: {few}"] if out else []


def diagnosis_text(result: Diagnosis) -> str:
    """The report of one file."""
    lines = [
        f"DIAGNOSIS of {subject(result)}",
        f"  {rows_line(result)}",
        *(f"  {s}" for s in result.data.assumptions if any(m in s for m in _OF_SIGNS)),
        *([f"  {slip_check_line(result)}"] if result.slip_check else []),
        *(f"  set aside: {said}" for said in result.data.set_aside),
        *_not_looked_for(result),
        *(f"  {said}" for said in (*result.data.motion, *result.data.together)),
        "VERDICT", f"  {verdict_sentence(result)}",
        *(f"  {line}" for line in verdict_lines(result)),
        *(["BUDGET"] if result.simulator else []),
        *(f"  {line}" for line in budget_lines(result)),
        "GAP", *(f"  {line}" for line in gap_lines(result)),
        *([_RUNS] if result.runs else []),
        *(f"  {line}" for line in run_lines(result)),
        "WHERE (shares of its energy)", *_where(result),
        *(f"  {line}" for line in map_lines(result)),
        "CANDIDATES (listed ones by evidence, before what they leave was tested)",
        *_candidates(result),
    ]  # fmt: skip
    if confused := confused_lines(result):
        lines += ["HARD TO TELL HERE (forecast)", *(f"  {line}" for line in confused)]
    if steps := step_lines(result):
        lines += ["NEXT MEASUREMENT", *(f"  {line}" for line in steps)]
    if not result.verdict.names_an_effect:
        smallest = (f"  {line}" for line in smallest_lines(result))
        lines += ["WOULD HAVE BEEN SEEN", *smallest]
    if result.untestable:
        groups = untestable_groups(result)
        lines += ["NOT TESTABLE ON THIS DATA"] + [
            f"  {effects}: needs {needs}" for needs, effects in groups
        ]
    lines.append(
        f"braking positive, SI units (the file: {result.data.convention}); seed"
        f" {result.seed}, tirefit {result.version}"
    )
    return "\n".join(_wrapped(lines))
