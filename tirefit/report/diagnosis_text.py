"""A diagnosis in the terminal: what one can act on, in one screen."""

import textwrap
from collections.abc import Mapping

from tirefit.diagnosis.effects import EFFECTS
from tirefit.report.diagnosis_panels import mean_load
from tirefit.report.diagnosis_words import (
    covariate_text,
    names_an_effect,
    parameter_text,
    range_text,
    share_text,
    untestable_groups,
    words_on,
)
from tirefit.report.numbers import format_number

__all__ = [
    "chosen_candidate",
    "confused_lines",
    "diagnosis_text",
    "gap_lines",
    "map_lines",
    "noise_line",
    "smallest_lines",
    "step_text",
    "verdict_sentence",
]

_WIDTH = 88
_LEVEL = 0.05


def verdict_sentence(content: Mapping) -> str:
    """The verdict as one sentence."""
    verdict = content["verdict"]
    probability = f"probability {verdict['probability']:.2f}"
    effects = " + ".join(verdict["effects"])
    status = verdict["status"]
    if status == "none" or (status == "named" and not names_an_effect(verdict)):
        noise = f"; its noise shows {effects}" if effects else ""
        return f"no gap beyond the noise ({probability}){noise}"
    if status == "named":
        return f"{effects} ({probability})"
    if status == "incomplete":
        return f"{effects}, and something no listed effect explains ({probability})"
    if status == "cannot_tell":
        rivals = ", ".join(verdict["also_possible"])
        return f"{effects} ({probability}), or {rivals}: this data cannot tell"
    return f"a gap that no listed effect explains ({probability})"


def chosen_candidate(content: Mapping) -> Mapping | None:
    """The record among the candidates that the verdict names, None if it names none."""
    effects = list(content["verdict"]["effects"])
    same = (c for c in content["candidates"] if list(c["effects"]) == effects)
    return next(same, None) if names_an_effect(content["verdict"]) else None


def _verdict(content: Mapping) -> list[str]:
    lines = [f"  {verdict_sentence(content)}"]
    verdict, chosen = content["verdict"], chosen_candidate(content)
    if chosen is not None:
        lines.append(f"  {parameter_text(chosen)}")
    for effect in (*verdict["effects"], *verdict["also_possible"]):
        means, remedy = words_on(effect)
        if means:
            lines.append(f"  {effect}: {means}; {remedy}")
    return lines


def gap_lines(result) -> list[str]:
    """How large the gap is and how far it shrinks, as sentences."""
    content, load = result.content, mean_load(result)
    gap = content["gap"]

    def size(force: float) -> str:
        share = format_number(100 * force / load, 2)
        return f"{format_number(force, 3)} N ({share} % of mean F_z)"

    lines = [f"{size(gap['rms'])} rms beyond the noise"]
    if not gap["resolvable"]:
        return [f"{lines[0]}: too small to say how much of it closes"]
    if not names_an_effect(content["verdict"]):
        return lines
    for here, where in ((gap, "on these rows"), (gap.get("holdout"), "")):
        if not here:
            continue
        where = where or f"on {here['on']}"
        if here["closed"] is None:
            lines.append(f"{where}: {size(here['rms'])}, too small to say")
            continue
        energy = 1 - (1 - here["closed"]) ** 2
        lines.append(
            f"{where}: closed {share_text(here['closed'], here['closed_ci'])},"
            f" {100 * energy:.0f} % of its energy;"
            f" {size(here['rms'])} to {size(here['remaining_rms'])}"
        )
    shares = gap.get("shares") or {}
    if shares:
        parts = (f"{name} {100 * share:.0f} %" for name, share in shares.items())
        lines.append(f"of the energy closed, in any order: {', '.join(parts)}")
    return lines


def _where(content: Mapping, most: int = 4) -> list[str]:
    """One line a covariate, those that sort the gap best first."""
    groups: dict[str, list] = {}
    for region in content["where"]:
        groups.setdefault(region["covariate"], []).append(region)
    found = []
    for name, regions in groups.items():
        if min(region["p_value"] for region in regions) > _LEVEL:
            continue
        even = 1 / len(regions)
        spread = sum(abs(region["share"] - even) for region in regions)
        parts = (
            f"{100 * region['share']:.0f} % at {range_text(region)}"
            for region in sorted(regions, key=lambda region: region["low"])
        )
        found.append((spread, f"  {covariate_text(name)}: {', '.join(parts)}"))
    found.sort(key=lambda pair: -pair[0])
    lines = [line for _, line in found[:most]]
    return lines or ["  no region stands out at a false-discovery rate of 5 %"]


def _candidates(content: Mapping, most: int = 5) -> list[str]:
    lines = []
    for candidate in content["candidates"][:most]:
        if candidate["probability"] < 0.005:
            break
        closed = candidate["closed"]
        tail = "" if not closed else f", closes {share_text(closed)}"
        values = parameter_text(candidate) if candidate["probability"] >= 0.05 else ""
        lines.append(
            f"  {candidate['probability']:.2f}  {' + '.join(candidate['effects'])}"
            f"{tail}" + (f"  ({values})" if values else "")
        )
    return lines or ["  none"]


def map_lines(content: Mapping, most: int = 3) -> list[str]:
    """Parameters that would have to vary, as sentences; none where none stands out."""
    return [
        f"{cell['parameter']} that varies with {covariate_text(cell['covariate'])}:"
        f" log evidence {cell['log_evidence']:.0f}, explains up to"
        f" {100 * cell['explains']:.0f} % of the misfit"
        for cell in content["map"][:most]
        if cell["log_evidence"] > 3
    ]


def confused_lines(content: Mapping, most: int = 6) -> list[str]:
    """Effects that these rows would show and yet take for others, as sentences."""
    found = [
        f"{record['effect']} of {format_number(record['amplitude'], 2)}"
        f" {'' if record['unit'] == '-' else record['unit']}".rstrip()
        + f": recognised with probability {record['recognised']:.2f}, else taken for"
        f" {record['taken_for']}"
        for record in sorted(content["forecast"], key=lambda one: one["recognised"])
        if record["taken_for"] and record["recognised"] < 0.75 * record["seen"]
    ]
    return found[:most]


def step_text(step: Mapping) -> str:
    """A next measurement as a sentence."""
    return (
        f"measure {step['add']}: tells {step['separates'][0]} from"
        f" {step['separates'][1]} with probability {step['p_after']:.2f}"
        f" (now {step['p_now']:.2f})"
    )


def smallest_lines(content: Mapping) -> list[str]:
    """What would have been seen, had it been there, as sentences."""
    resolution = dict(content["resolution"])
    smallest = resolution.pop("smallest_effects", {})
    lines = [f"{what}: {format_number(v, 3)} N" for what, v in resolution.items()]
    units = {effect.id: effect.unit for effect in EFFECTS if effect.unit != "-"}
    parts = [
        f"{effect} {format_number(value, 2)} {units.get(effect, '')}".rstrip()
        for effect, value in smallest.items()
    ]
    return lines + ([f"amplitudes of {', '.join(parts)}"] if parts else [])


def noise_line(content: Mapping) -> str:
    """Levels of the noise, where they come from, and what is wrong with them."""
    noise, channels = content["noise"], content["data"]["channels"]
    units = {"fx": " N", "fy": " N", "mz": " N m", "alpha": " rad"}
    levels = ", ".join(
        f"{name} {format_number(noise[name], 3)}{units.get(name, '')}"
        for name in (*channels, "sigma_x", "alpha")
        if name in noise
    )
    flags = f"; {', '.join(noise['flags'])}" if noise["flags"] else ""
    return f"{levels} ({noise['source']}){flags}"


def _wrapped(lines) -> list[str]:
    return [
        part
        for line in lines
        for part in textwrap.wrap(
            line, _WIDTH, subsequent_indent="    ", break_long_words=False
        )
    ]


def diagnosis_text(result) -> str:
    """The report of one file."""
    content = result.content
    data = content["data"]
    lines = [
        f"DIAGNOSIS of {data['name']} against {content['model']}",
        f"  {content['n']} rows, {content['n_effective']:.0f} of them independent;"
        f" noise {noise_line(content)}",
        "VERDICT", *_verdict(content),
        "GAP", *(f"  {line}" for line in gap_lines(result)),
        "WHERE (shares of its energy)", *_where(content),
        *(f"  {line}" for line in map_lines(content)),
        "CANDIDATES", *_candidates(content),
    ]  # fmt: skip
    if confused := confused_lines(content):
        lines += ["HARD TO TELL HERE (forecast)", *(f"  {line}" for line in confused)]
    if content["next_measurement"]:
        steps = (f"  {step_text(step)}" for step in content["next_measurement"])
        lines += ["NEXT MEASUREMENT", *steps]
    if not names_an_effect(content["verdict"]):
        smallest = (f"  {line}" for line in smallest_lines(content))
        lines += ["WOULD HAVE BEEN SEEN", *smallest]
    if content["untestable"]:
        groups = untestable_groups(content["untestable"])
        lines += ["NOT TESTABLE ON THIS DATA"] + [
            f"  {effects}: needs {needs}" for needs, effects in groups
        ]
    lines.append(
        f"braking positive, SI units (the file: {data['convention']}); seed"
        f" {content['seed']}, tirefit {content['version']}"
    )
    return "\n".join(_wrapped(lines))
