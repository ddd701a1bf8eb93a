"""What the figure of a diagnosis shows beside its arrays: bars and labels."""

import math
from typing import NamedTuple

from tirefit.diagnosis.left_out import NOISE, SMOOTH
from tirefit.diagnosis.summary.result import Diagnosis
from tirefit.diagnosis.summary.views import LoadCurve, ResidualMap
from tirefit.report.diagnosis_sections import step_label
from tirefit.report.diagnosis_words import (
    NAMED_VALUES,
    covariate_text,
    covariate_unit,
    name_of,
)
from tirefit.report.numbers import format_number


class LadderBar(NamedTuple):
    """A step of the ladder: ``rms`` [N] on data left out, the standard ``error`` of its
    gain over the step before, as that of an rms (None where none is known), and the
    share ``closed``; ``kind`` is base, effect, smooth or noise."""

    label: str
    rms: float
    error: float | None
    closed: float | None
    kind: str


class ChanceBar(NamedTuple):
    """The probability that an effect is there: ``kind`` is verdict, other or unknown,
    that of something unlisted."""

    label: str
    probability: float
    kind: str


def ladder_bars(result: Diagnosis) -> list[LadderBar]:
    """The steps of the ladder, in order; where nothing could be left out, the model
    alone and the noise on the rows fitted."""
    kinds = {(): "base", SMOOTH: "smooth", NOISE: "noise"}
    if not result.ladder.steps:
        noise = result.noise.forces[result.data.channels[0]]
        before = math.hypot(result.gap.rms, noise)
        alone = LadderBar("no effect", before, None, None, "base")
        return [alone, LadderBar("noise floor", noise, None, None, "noise")]
    return [
        LadderBar(
            step_label(result, k), step.rms_left_out,
            # d(rms) = d(rms^2) / (2 rms)
            step.gain_std / (2 * step.rms_left_out) if step.effects else None,
            step.closed if step.effects else None, kinds.get(step.effects, "effect"),
        )
        for k, step in enumerate(result.ladder.steps)
    ]  # fmt: skip


def chance_bars(result: Diagnosis) -> list[ChanceBar]:
    """Probability of every effect of the verdict, named ones first, unlisted last."""
    verdict = result.verdict
    kinds = dict.fromkeys(verdict.also_possible, "other")
    kinds |= dict.fromkeys(verdict.effects, "verdict")
    named_first = sorted(verdict.each, key=lambda e: e not in verdict.effects)
    bars = [
        ChanceBar(name_of(e), verdict.each[e].probability, kinds.get(e, "other"))
        for e in named_first
    ]
    return [*bars, ChanceBar("something unlisted", verdict.left.unlisted, "unknown")]


def covariate_label(panel: ResidualMap) -> str:
    """Axis label of what the map is drawn over beside the slip."""
    unit = covariate_unit(panel.covariate)
    return covariate_text(panel.covariate) + f" [{unit}]" * bool(unit)


def level_labels(panel: ResidualMap) -> tuple[str, ...]:
    """Names of the levels of the map: one value, or from - to."""
    named = NAMED_VALUES.get(panel.covariate, {})
    return tuple(named.get(low) or _range(low, high) for low, high in panel.levels)


def _range(low: float, high: float) -> str:
    if low == high:
        return format_number(float(low))
    return f"{format_number(float(low), 3)}-{format_number(float(high), 3)}"


def load_label(curve: LoadCurve) -> str:
    """Name of the load of a curve."""
    return f"$F_z$ = {_range(*curve.load)} N"


def after_label(result: Diagnosis) -> str:
    """What the curves after stand for."""
    if not result.comparison.named:
        return "base + located gap"
    named = map(name_of, result.effects) if result.verdict.names_an_effect else ()
    return " + ".join((*(["parameters"] if result.simulator else []), *named))
