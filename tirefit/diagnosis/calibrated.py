"""Probabilities that were checked against trials whose cause is known.

The evidence compares what is listed; whether something unlisted is there as well it
cannot say. What can be said of that was learned: two logistic regressions on a few
clues, shrunk, their numbers in ``calibration.json`` with the script that made them
(``python -m fits.calibration``) and how well they do on families that they were not
taught.
"""

import json
from collections.abc import Mapping
from functools import cache
from importlib import resources

import numpy as np

from tirefit.diagnosis.adequacy import Adequacy

__all__ = [
    "clues_of_effect",
    "clues_of_rest",
    "probability_beside",
    "probability_of_more",
]

_SMALLEST_P = 1e-3
"""The smallest p-value that the tests can take."""


_STEADIEST = 300.0
"""Amplitude over its error between regimes, beyond which more says no more."""


@cache
def _numbers() -> dict:
    file = resources.files("tirefit.diagnosis") / "calibration.json"
    return json.loads(file.read_text())


def _compressed(value: float) -> float:
    """Log evidence on a scale where a thousand is not a hundred times ten."""
    return float(np.sign(value) * np.log1p(abs(value)))


def clues_of_rest(
    adequacy: Adequacy,
    gains: Mapping[str, float],
    evidence: float,
    parts: float | None,
    errors,
    cancels: float,
    rows: int,
) -> dict[str, float]:
    """What tells that a set of effects is not all that there is.

    Args:
        adequacy: the tests of what the set leaves.
        gains: log evidence of each kind of remainder beside the set.
        evidence: log evidence of the set over none.
        parts: that of the best refitted set with one effect less; None for none.
        errors: amplitude over its error of each effect.
        cancels: see :class:`tirefit.diagnosis.standing.Standing`.
        rows: number of rows.
    """
    tested = [p for p in adequacy[:-1] if p is not None] or [1.0]
    signs = -np.log10(np.maximum(tested, _SMALLEST_P))
    wide = max(gains["smooth"], gains["cells"])
    narrow = max(gains["waves"], gains["patterns"])
    whole, more = max(evidence, 1.0), max(wide, narrow, 0.0)
    last = 1.0 if parts is None else float(np.clip((evidence - parts) / whole, 0, 1))
    return {
        "worst test": float(signs.max()),
        "mean test": float(signs.mean()),
        "wide remainder": _compressed(wide),
        "narrow remainder": _compressed(narrow),
        "share of remainder": more / (whole + more),
        "two effects": float(len(errors) > 1),
        "three effects": float(len(errors) > 2),
        "weakest effect": float(np.log(max(min(errors), 0.1))),
        "share of last effect": last,
        "cancels": float(np.log(max(cancels, 0.1))),
        "rows": float(np.log(rows)),
    }


def clues_of_effect(
    rest: Mapping[str, float],
    error: float,
    alone: float | None,
    without: float,
    evidence: float,
    steady: tuple[float, float],
    over_rest: float,
) -> dict[str, float]:
    """What tells that an effect is there, whatever else is.

    Args:
        rest: :func:`clues_of_rest` of its set.
        error: its amplitude over its error.
        alone: log evidence of this effect alone, None where it was not refitted.
        without: log evidence of the set without it, zero for a single one.
        evidence: log evidence of the set.
        steady: its amplitude over its error between regimes, and its largest change by
            one of them; see :func:`tirefit.diagnosis.standing.steadiness`.
        over_rest: log evidence of the set and a remainder of any kind over the set
            without it and such a remainder.
    """
    whole = max(evidence, 1.0)
    single = 0.0 if alone is None else float(np.clip(alone / whole, 0, 1))
    kept = ("worst test", "wide remainder", "narrow remainder", "share of remainder")
    return {
        "amplitude over error": float(np.log(max(error, 0.1))),
        "share alone": single,
        "not alone": float(alone is None),
        "share lost without": float(np.clip((evidence - without) / whole, 0, 1)),
        "evidence lost without": _compressed(evidence - without),
        "steady": float(np.log(np.clip(steady[0], 0.1, _STEADIEST))),
        "changed by one regime": float(np.log(np.clip(steady[1], 1e-3, 10.0))),
        "evidence over a remainder": _compressed(over_rest),
        "two effects": rest["two effects"],
        "three effects": rest["three effects"],
        **{name: rest[name] for name in kept},
    }


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
