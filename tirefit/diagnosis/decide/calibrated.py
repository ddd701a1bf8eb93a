"""Probabilities that were checked against trials whose cause is known.

The evidence compares what is listed; whether something unlisted is there as well it
cannot say. What can be said of that was learned: two logistic regressions on a few
clues, shrunk, their numbers in ``calibration.json`` with the script that made them
(``python -m fits.calibration``) and how well they do on families that they were not
taught. A last one, of the verdict as a whole, says how often verdicts of its status
that were as sure were right.
"""

import json
from collections.abc import Iterable, Mapping
from functools import cache
from importlib import resources
from typing import NamedTuple

import numpy as np

from tirefit.diagnosis.decide.adequacy import Adequacy
from tirefit.diagnosis.decide.standing import Standing

_SMALLEST_P = 1e-3
"""The smallest p-value that the tests can take."""

_STEADIEST = 300.0
"""Amplitude over its error between regimes, beyond which more says no more."""

_LEAST_LOG = -12.0
"""Logarithm to ten of a probability below which smaller ones say no more."""

_WEAKEST = (
    "amplitude over error", "share alone", "share lost without",
    "evidence lost without", "steady", "evidence over a remainder",
)  # fmt: skip
"""Clues of an effect that tell of its set, by the least of its effects."""


@cache
def _numbers() -> dict:
    file = resources.files("tirefit.diagnosis") / "calibration.json"
    return json.loads(file.read_text())


def _compressed(value: float) -> float:
    """Log evidence on a scale where a thousand is not a hundred times ten."""
    return float(np.sign(value) * np.log1p(abs(value)))


class Part(NamedTuple):
    """One effect of a refitted set: what tells that it is there, whatever else is.

    Attributes:
        error: its amplitude over its error.
        alone: log evidence of this effect alone, None where it was not refitted.
        lost: log evidence that the set loses without it.
        steady: its amplitude over its error between regimes.
        changed: its largest change by one regime, over the amplitude; see
            :func:`tirefit.diagnosis.decide.standing.steadiness`.
        over_rest: log evidence of the set and a remainder of any kind over the set
            without it and such a remainder.
        in_sets: probability of the sets that hold it, if something unlisted is there.
    """

    error: float
    alone: float | None
    lost: float
    steady: float
    changed: float
    over_rest: float
    in_sets: float


class Explanation(NamedTuple):
    """A refitted set of effects, what it leaves, and how it stands beside others.

    Attributes:
        standing: of the set.
        gains: log evidence of each kind of remainder beside the set.
        gains_of_none: the same without any effect.
        evidence: log evidence of the set over none.
        of_form: what of it another form of the effects adds to their formulas.
        ahead: log evidence over the best other set of no more effects, or over none.
        nothing_listed: probability of a gap without any listed effect, by evidence.
        effects: number of effects in the set.
        rows: number of rows.
    """

    standing: Standing
    gains: Mapping[str, float]
    gains_of_none: Mapping[str, float]
    evidence: float
    of_form: float
    ahead: float
    nothing_listed: float
    effects: int
    rows: int


def _signs(adequacy: Adequacy) -> np.ndarray:
    """What the tests say against a set: zeros before their p-values."""
    tested = [p for p in adequacy[:-1] if p is not None] or [1.0]
    return -np.log10(np.maximum(tested, _SMALLEST_P))


def clues_of_rest(explanation: Explanation) -> dict[str, float]:
    """What tells of a set of effects as a whole."""
    standing, gains, evidence = (
        explanation.standing,
        explanation.gains,
        explanation.evidence,
    )
    signs, of_formulas = _signs(standing.adequacy), _signs(standing.formulas)
    wide = max(gains["smooth"], gains["cells"])
    narrow = max(gains["waves"], gains["patterns"])
    whole, more = max(evidence, 1.0), max(wide, narrow, 0.0)
    in_form = float(standing.in_other_form)
    nothing_listed = np.log10(max(explanation.nothing_listed, 10**_LEAST_LOG))
    explained = {k: explanation.gains_of_none[k] - gains[k] for k in ("cells", "waves")}
    return {
        "worst test": float(signs.max()),
        "mean test": float(signs.mean()),
        "worst test of the formulas": float(of_formulas.max()),
        "mean test of the formulas": float(of_formulas.mean()),
        "another form": in_form,
        # What shows well has a form of its own more often.
        "another form, by evidence": in_form * _compressed(evidence),
        "evidence": _compressed(evidence),
        "evidence ahead": _compressed(explanation.ahead),
        "nothing listed": float(nothing_listed),
        "cells explained": _compressed(explained["cells"]),
        "waves explained": _compressed(explained["waves"]),
        "wide remainder": _compressed(wide),
        "narrow remainder": _compressed(narrow),
        "share of remainder": more / (whole + more),
        "two effects": float(explanation.effects > 1),
        "three effects": float(explanation.effects > 2),
        "cancels": float(np.log(max(standing.cancels, 0.1))),
        "rows": float(np.log(explanation.rows)),
    }


def clues_of_effect(part: Part, explanation: Explanation) -> dict[str, float]:
    """What tells that an effect is there, whatever else is.

    Args:
        explanation: by its set.
    """
    whole, rest = max(explanation.evidence, 1.0), clues_of_rest(explanation)
    single = 0.0 if part.alone is None else float(np.clip(part.alone / whole, 0, 1))
    kept = (
        "worst test", "wide remainder", "narrow remainder", "share of remainder",
        "two effects", "three effects",
    )  # fmt: skip
    over_patterns = explanation.evidence - explanation.gains_of_none["patterns"]
    return {
        "amplitude over error": float(np.log(max(part.error, 0.1))),
        "share alone": single,
        "not alone": float(part.alone is None),
        "share lost without": float(np.clip(part.lost / whole, 0, 1)),
        "evidence lost without": _compressed(part.lost),
        "steady": float(np.log(np.clip(part.steady, 0.1, _STEADIEST))),
        "changed by one regime": float(np.log(np.clip(part.changed, 1e-3, 10.0))),
        "evidence over a remainder": _compressed(part.over_rest),
        "evidence over patterns": _compressed(over_patterns),
        "evidence of another form": _compressed(explanation.of_form),
        "share of sets with it": part.in_sets,
        **{name: rest[name] for name in kept},
    }


def clues_of_set(
    rest: Mapping[str, float], of_effects: Iterable[Mapping[str, float]]
) -> dict[str, float]:
    """What tells that a set of effects is not all that there is: what it leaves, and
    its weakest part. Where something else is there, an effect only imitates it.

    Args:
        rest: :func:`clues_of_rest` of the set.
        of_effects: :func:`clues_of_effect` of each of its effects.
    """
    each = list(of_effects)
    return {**rest, **{f"least {k}": min(one[k] for one in each) for k in _WEAKEST}}


def _logistic(which: str, clues: Mapping[str, float]) -> float:
    numbers = _numbers()[which]
    total = numbers["bias"]
    for name, (center, spread, weight) in numbers["clues"].items():
        total += weight * (clues[name] - center) / spread
    return float(1 / (1 + np.exp(-total)))


def probability_of_more(clues: Mapping[str, float]) -> float:
    """Probability that something unlisted is there beside a set of effects."""
    return _logistic("more", clues)


def probability_beside(clues: Mapping[str, float]) -> float:
    """Probability that an effect is there, given that something unlisted is."""
    return _logistic("beside", clues)


_NEVER_SURER = 0.005
"""A probability nearer to zero or one than this counts as this far."""


def as_often_right(status: str, probability: float) -> float:
    """Share of verdicts of this status and this probability that are right.

    Args:
        status: of the verdict; "noise" where it names an effect on the noise alone.
    """
    offset, slope = _numbers()["said"].get(status, (0.0, 1.0))
    p = np.clip(probability, _NEVER_SURER, 1 - _NEVER_SURER)
    return float(1 / (1 + np.exp(-offset - slope * np.log(p / (1 - p)))))
