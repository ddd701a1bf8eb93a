"""The next measurement, effects that this data hardly tells apart, and the smallest
amplitudes that it would show, as lines of text."""

from tirefit.diagnosis.summary.records import NextMeasurement, Status
from tirefit.diagnosis.summary.result import Diagnosis
from tirefit.report.diagnosis_words import amount_text, name_of

_SEEN = 0.5
"""Probability of being seen below which an effect may be there and not show."""

_TELLS_MORE = 0.1
"""Rise of the probability of telling two effects apart from which a measurement is
proposed: less is not worth another day at the rig."""


def confused_lines(result: Diagnosis, most: int = 6) -> list[str]:
    """Effects that these rows would show and yet take for others, as sentences, and
    those that they would not show at their usual size."""
    lines = [
        f"{name_of(chance.effect)} of"
        f" {amount_text(chance.amplitude, None, chance.unit, 2)}: recognised with"
        f" probability {chance.recognised:.2f}, else taken for"
        f" {name_of(chance.taken_for)}"
        for chance in sorted(result.forecast, key=lambda one: one.recognised)
        if chance.taken_for and chance.seen >= max(_SEEN, chance.recognised / 0.75)
    ]
    unseen = [
        name_of(chance.effect)
        for chance in result.forecast
        if chance.seen < _SEEN and chance.effect not in result.verdict.effects
    ]
    at_usual_size = f"not seen here at their usual size: {', '.join(unseen)}"
    return lines[:most] + [at_usual_size] * bool(unseen)


def step_lines(result: Diagnosis) -> list[str]:
    """Next measurements, each with its reason; where none tells much more, which would
    tell most, or, of an open verdict, why none would."""
    why, steps = result.next_measurement_reason, result.next_measurement
    if not steps:
        is_open = result.verdict.status == Status.CANNOT_TELL
        return [why] if is_open and why is not None else []
    worth = [step for step in steps if step.p_after - step.p_now >= _TELLS_MORE]
    if not worth:
        best = max(steps, key=lambda step: step.p_after - step.p_now)
        return [
            f"no single listed measurement would tell much more: at best {best.add},"
            f" which {_tells_apart(best)}"
        ]
    return [f"measure {step.add}: it {_tells_apart(step)}" for step in worth]


def _tells_apart(step: NextMeasurement) -> str:
    one, other = map(name_of, step.separates)
    return (
        f"tells {one} from {other} with probability {step.p_after:.2f}, instead of"
        f" {step.p_now:.2f} now"
    )


def smallest_lines(result: Diagnosis) -> list[str]:
    """The smallest amplitudes that would have been seen four times in five."""
    units = {effect.id: effect.unit for effect in result.library}
    parts = (
        f"{name_of(effect)} {amount_text(value, None, units.get(effect, ''), 2)}"
        for effect, value in result.resolution.smallest_effects.items()
    )
    return [", ".join(parts)] if result.resolution.smallest_effects else []
