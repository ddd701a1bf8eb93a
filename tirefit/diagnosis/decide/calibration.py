"""How often verdicts of a status are right, and how often something unlisted is there,
learned from trials whose cause is known: two numbers for each.

``python -m fits.calibration`` writes the numbers into ``calibration.json``.
"""

import json
import math
from functools import cache
from importlib import resources

import numpy as np

from tirefit.diagnosis.decide.verdict import Tests
from tirefit.diagnosis.evidence.search import PRIOR_OF_UNKNOWN

_FARTHEST = 7.0
"""Logarithms of odds beyond this say no more."""


@cache
def _numbers() -> dict:
    file = resources.files("tirefit.diagnosis") / "calibration.json"
    return json.loads(file.read_text())


def _log_odds(probability: float) -> float:
    """Log odds of a probability, within :data:`_FARTHEST`."""
    p = np.clip(probability, 1e-12, 1 - 1e-12)
    return float(np.clip(np.log(p / (1 - p)), -_FARTHEST, _FARTHEST))


def probability_by_tests(tests: Tests) -> float:
    """Probability of something unlisted by the smallest p-value of the tests of the
    remainder (Bonferroni).

    They see what the discrepancy has no shape for, such as mains hum. The largest
    Bayes factor that a p-value stands for is 1 / (-e p log p) (Sellke, Bayarri and
    Berger 2001); the prior odds are those of something unlisted.
    """
    made = [p for p in tests if p is not None]
    p = max(len(made), 1) * min(made, default=1.0)
    odds = PRIOR_OF_UNKNOWN / (1 - PRIOR_OF_UNKNOWN)
    if p < 1 / math.e:
        odds /= -math.e * p * math.log(p)
    return float(odds / (1 + odds))


def as_often_right(status: str, probability: float) -> float:
    """Share of verdicts of this status and this probability that are right.

    Args:
        status: of the verdict; "noise" where it names an effect on the noise alone;
            "unlisted" for the probability of something unlisted.
    """
    offset, slope = _numbers().get(status, (0.0, 1.0))
    return float(1 / (1 + np.exp(-offset - slope * _log_odds(probability))))
