"""Two things that were learned from trials whose cause is known: the probability of
something unlisted, and how often verdicts of a status are right.

The numbers stand in ``calibration.json`` with the script that made them
(``python -m fits.calibration``) and how well they do on kinds of unlisted effects that
they were not taught.
"""

import json
import math
from collections.abc import Mapping
from functools import cache
from importlib import resources

import numpy as np

from tirefit.diagnosis.decide.verdict import Tests
from tirefit.diagnosis.evidence.posterior import Key, Weighed
from tirefit.diagnosis.evidence.search import PRIOR_OF_UNKNOWN

_FARTHEST = 7.0
"""Logarithms of odds beyond this say no more."""


@cache
def _numbers() -> dict:
    file = resources.files("tirefit.diagnosis") / "calibration.json"
    return json.loads(file.read_text())


def log_odds(probability: float) -> float:
    """Log odds of a probability, within :data:`_FARTHEST`."""
    p = np.clip(probability, 1e-12, 1 - 1e-12)
    return float(np.clip(np.log(p / (1 - p)), -_FARTHEST, _FARTHEST))


def clues_of_unlisted(weighed: Weighed, key: Key) -> dict[str, float]:
    """What tells that a set of effects is not all that there is.

    Returns:
        "evidence": log odds of a discrepancy by the evidence; "narrow": log evidence of
        the best sharp shape in the remainder, compressed.
    """
    gains = weighed.gains.get(key, {})
    narrow = max(gains.get("waves", 0.0), gains.get("patterns", 0.0))
    return {
        "evidence": log_odds(weighed.unlisted),
        "narrow": float(np.sign(narrow) * np.log1p(abs(narrow))),
    }


def probability_of_unlisted(weighed: Weighed, key: Key) -> float:
    """Probability that something unlisted is there beside a set, by a logistic
    regression on :func:`clues_of_unlisted`."""
    return _logistic(_numbers()["unlisted"], clues_of_unlisted(weighed, key))


def probability_by_tests(tests: Tests) -> float:
    """The same by the smallest p-value of the tests of the remainder (Bonferroni).

    They see what the discrepancy has no shape for, as the hum of the mains. The largest
    Bayes factor that a p-value stands for is 1 / (-e p log p) (Sellke, Bayarri and
    Berger 2001); the prior odds are those of something unlisted.
    """
    made = [p for p in tests if p is not None]
    p = max(len(made), 1) * min(made, default=1.0)
    odds = PRIOR_OF_UNKNOWN / (1 - PRIOR_OF_UNKNOWN)
    if p < 1 / math.e:
        odds /= -math.e * p * math.log(p)
    return float(odds / (1 + odds))


def _logistic(numbers: Mapping, clues: Mapping[str, float]) -> float:
    total = numbers["bias"]
    for name, (center, spread, weight) in numbers["clues"].items():
        total += weight * (clues[name] - center) / spread
    return float(1 / (1 + np.exp(-total)))


def as_often_right(status: str, probability: float) -> float:
    """Share of verdicts of this status and this probability that are right.

    Args:
        status: of the verdict; "noise" where it names an effect on the noise alone.
    """
    offset, slope = _numbers()["said"].get(status, (0.0, 1.0))
    return float(1 / (1 + np.exp(-offset - slope * log_odds(probability))))
