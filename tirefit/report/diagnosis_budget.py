"""The budget of a simulator's error: in words, and as the steps of a waterfall."""

from typing import NamedTuple

import numpy as np

from tirefit.diagnosis.records import Change, Part
from tirefit.diagnosis.result import Diagnosis
from tirefit.report.numbers import format_estimate, format_number

__all__ = [
    "Step",
    "budget_lines",
    "budget_sentence",
    "change_texts",
    "waterfall_steps",
]

_SEEN = 1e-3
"""Share of the energy below which a part is not worth a clause."""


_SHORT = {"mu": "friction", "cpa2": "stiffness", "mu_peak": "peak friction"}
"""Parameters whose meaning in the tables is longer than a sentence can carry."""


class Step(NamedTuple):
    """One bar of the waterfall, in N rms of what is left: from ``before`` to ``after``.

    ``kind`` is whole, parameters, effect, unexplained or noise; ``text`` says the part
    by itself.
    """

    label: str
    before: float
    after: float
    kind: str
    text: str


def change_texts(result: Diagnosis) -> list[str]:
    """What is wrong with the simulator's parameters: ``friction 9 ± 1 % too high``, the
    surest first; only those that differ from the measurement."""
    wrong = [(k, c) for k, c in result.verdict.parameters.items() if c.differs]
    wrong.sort(key=lambda item: -_sureness(item[1]))
    words = {**result.meanings, **_SHORT}
    return [_change_text(words.get(name, name), change) for name, change in wrong]


def _sureness(change: Change) -> float:
    return abs(change.simulated - change.measured) / max(change.std, 1e-300)


def _change_text(meaning: str, change: Change) -> str:
    off = change.simulated - change.measured
    side = "high" if off > 0 else "low"
    if min(change.simulated, change.measured) > 0:
        share = format_estimate(
            100 * abs(off) / change.measured, 100 * change.std / change.measured
        )
        return f"{meaning} {share} % too {side}"
    return f"{meaning} {format_estimate(abs(off), change.std)} too {side}"


def _words(result: Diagnosis, part: Part) -> str:
    if part.part == "parameters":
        changes = change_texts(result)
        said = " and ".join(changes) if changes else "parameters, none of them surely"
        return f"is {said} {'' if changes else 'wrong '}in the simulator"
    if part.part == "unexplained":
        return "has no name"
    if part.part == "noise":
        return "is noise"
    name = part.part.replace("_", " ")
    article = "an" if name[0] in "aeiou" else "a"
    return f"is {article} {name} that it does not have"


def _whole(result: Diagnosis) -> float:
    """Error of the simulator, noise and all, rms [N]."""
    sure = max(result.budget, key=lambda part: part.share)
    return sure.rms / np.sqrt(sure.share)


def budget_sentence(result: Diagnosis) -> str:
    """The error of a simulator and its parts as one sentence."""
    parts = [part for part in result.budget if part.share >= _SEEN]
    clauses = (f"{format_number(p.rms, 3)} N {_words(result, p)}" for p in parts)
    whole = format_number(_whole(result), 3)
    return f"of {whole} N (rms; the parts add in squares), {', '.join(clauses)}"


def budget_lines(result: Diagnosis) -> list[str]:
    """The sentence, each parameter, and how well the tire follows the simulator; none
    where a form was fitted."""
    if result.simulator is None:
        return []
    lines = [budget_sentence(result)]
    for name, change in result.verdict.parameters.items():
        measured = format_estimate(change.measured, change.std)
        verdict = "differs" if change.differs else "agrees"
        simulated = format_number(change.simulated)
        lines.append(f"{name}: simulated {simulated}, measured {measured}: {verdict}")
    followed = result.simulator.surrogate
    if followed["of_force"] > 1e-6:
        lines.append(
            f"{followed['model']}, which stands in for the simulator, misses"
            f" {format_number(followed['rms'], 3)} N of it,"
            f" {format_number(100 * followed['of_force'], 2)} % of its force and"
            f" {format_number(100 * followed['of_gap'], 2)} % of the gap"
        )
    return lines


_LABELS = {
    "parameters": "its parameters", "unexplained": "no name", "noise": "noise",
}  # fmt: skip


def waterfall_steps(result: Diagnosis) -> list[Step]:
    """From the simulator's error down to the noise, each part from what is left before
    it to what is left after it."""
    whole = _whole(result)
    left, steps = (
        1.0,
        [
            Step(
                "simulator's error", whole, 0.0, "whole", f"{format_number(whole, 3)} N"
            )
        ],
    )
    for part in result.budget:
        rest = max(left - part.share, 0.0) if part.part != "noise" else 0.0
        kind = part.part if part.part in _LABELS else "effect"
        low, high = part.closed_ci
        text = (
            f"{format_number(part.rms, 3)} N, {100 * part.share:.0f} %"
            f" [{100 * low:.0f}, {100 * high:.0f}] of the energy"
        )
        label = _LABELS.get(part.part, part.part.replace("_", " "))
        ends = (float(whole * np.sqrt(end)) for end in (left, rest))
        steps.append(Step(label, *ends, kind, text))
        left = rest
    return steps
