"""The budget of a simulator's error: in words, and as the steps of a waterfall."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tirefit.diagnosis.summary.records import Change, Part
from tirefit.diagnosis.summary.result import Diagnosis
from tirefit.report.diagnosis_words import words_on
from tirefit.report.fit_tables import FORCE_UNIT
from tirefit.report.numbers import format_estimate, format_number

_SEEN = 1e-3
"""Share of the energy below which a part is not worth a clause."""


_SHORT = {"mu": "friction", "cpa2": "stiffness", "mu_peak": "peak friction"}
"""Parameters whose meaning in the tables is longer than a sentence can carry."""


_MANY_TIMES = 4.0
"""Simulated over measured value from which it is said as such, not in per cent."""

_FEW_WORDS, _LACKING = 2, ", which it does not have"


class Step(NamedTuple):
    """One bar of the waterfall: of the simulator's squared error, the share that is
    left goes from ``before`` to ``after``. Shares, as the parts add in squares: the
    bars are as long as the parts are large.

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
        ratio = change.simulated / change.measured
        error = ratio * change.std / change.measured
        if ratio > _MANY_TIMES:
            return f"{meaning} {format_estimate(ratio, error)} times too high"
        share = format_estimate(100 * abs(ratio - 1), 100 * error)
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
    if len(name.split()) > _FEW_WORDS:  # then it is no noun that explains itself
        means, _ = words_on(part.part, result.library)
        return f"is {part.part}" + (f" ({means})" if means else "") + _LACKING
    article = "an" if name[0] in "aeiou" else "a"
    return f"is {article} {name} that it does not have"


def channel_name(channel: str) -> str:
    """``F_x``, ``F_y`` or ``M_z``."""
    return f"{channel[0].upper()}_{channel[1:]}"


def _whole(parts: Sequence[Part]) -> float:
    """Error of the simulator, noise and all, rms."""
    sure = max(parts, key=lambda part: part.share)
    return sure.rms / np.sqrt(sure.share)


def _sentence(result: Diagnosis, channel: str) -> str:
    unit, whole = FORCE_UNIT[channel], _whole(result.budgets[channel])
    parts = [part for part in result.budgets[channel] if part.share >= _SEEN]
    clauses = (f"{format_number(p.rms, 3)} {unit} {_words(result, p)}" for p in parts)
    of_what = f" of {channel_name(channel)}" if len(result.budgets) > 1 else ""
    return (
        f"of {format_number(whole, 3)} {unit}{of_what} (rms; the parts add in squares),"
        f" {', '.join(clauses)}"
    )


def budget_sentences(result: Diagnosis) -> list[str]:
    """The error of a simulator and its parts, one sentence a channel."""
    return [_sentence(result, channel) for channel in result.budgets]


_ROUGH = 0.5
"""Share of the gap that a stand-in may miss before the parts of a budget are rough: of
twelve simulators of other tires four were judged right beside a brush, eleven beside
what followed them."""


def budget_lines(result: Diagnosis) -> list[str]:
    """The sentences, each parameter, and how well the tire follows the simulator; none
    where a form was fitted."""
    if result.simulator is None:
        return []
    lines = budget_sentences(result)
    for name, change in result.verdict.parameters.items():
        measured = format_estimate(change.measured, change.std)
        verdict = "differs" if change.differs else "agrees"
        simulated = format_number(change.simulated)
        lines.append(f"{name}: simulated {simulated}, measured {measured}: {verdict}")
    followed = result.simulator.surrogate
    if followed.of_force > 1e-6:
        of_gap = f" and {format_number(100 * followed.of_gap, 2)} % of the gap"
        lines.append(
            f"{followed.model}, which stands in for the simulator, misses"
            f" {format_number(followed.rms, 3)} N of it,"
            f" {format_number(100 * followed.of_force, 2)} % of its force"
            f"{of_gap if result.gap.resolvable else ''}"
        )
        if result.gap.resolvable and followed.of_gap > _ROUGH:
            lines[-1] += "; the parts are rough: without --model one that follows it"
            lines[-1] += " closer is looked for"
    return lines


_LABELS = {
    "parameters": "its parameters", "unexplained": "no name", "noise": "noise",
}  # fmt: skip


def waterfall_steps(result: Diagnosis, channel: str | None = None) -> list[Step]:
    """From the simulator's error down to the noise, each part from what is left before
    it to what is left after it.

    Args:
        channel: the first if None.
    """
    channel = channel or next(iter(result.budgets))
    unit, whole = FORCE_UNIT[channel], _whole(result.budgets[channel])
    said = f"{format_number(whole, 3)} {unit} (rms), 100 %"
    left, steps = 1.0, [Step("simulator's error", 1.0, 0.0, "whole", said)]
    for part in result.budgets[channel]:
        rest = max(left - part.share, 0.0) if part.part != "noise" else 0.0
        kind = part.part if part.part in _LABELS else "effect"
        low, high = part.closed_ci
        text = (
            f"{format_number(part.rms, 3)} {unit} (rms), {100 * part.share:.0f} %"
            f" [{100 * low:.0f}, {100 * high:.0f}]"
        )
        label = _LABELS.get(part.part, part.part.replace("_", " "))
        steps.append(Step(label, float(left), float(rest), kind, text))
        left = rest
    return steps
