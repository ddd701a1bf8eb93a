"""Share of right verdicts by status and stated probability, as a logistic line."""

from collections import defaultdict
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.optimize import minimize

__all__ = ["calibrated", "checked", "lines_of"]

FARTHEST = 7.0  # limit of the log odds, as in tirefit/diagnosis/engine/decide.py
RIDGE = 2.0  # 1 / variance of offset and slope about 0 and 1

Stated = tuple[str, float, bool]
"""Status, stated probability, and whether right, of one verdict."""


def _log_odds(probability) -> np.ndarray:
    p = np.clip(probability, 1e-12, 1 - 1e-12)
    return np.clip(np.log(p / (1 - p)), -FARTHEST, FARTHEST)


def lines_of(verdicts: Sequence[Stated]) -> dict[str, list[float]]:
    """Offset and slope by status: log odds of being right over the stated log odds, by
    logistic regression with a ridge towards 0 and 1."""
    each = defaultdict(list)
    for status, stated, right in verdicts:
        each[str(status)].append((stated, right))
    lines = {}
    for status, cases in sorted(each.items()):
        stated, right = np.array(cases, float).T
        odds = _log_odds(stated)

        def loss(line, odds=odds, right=right):
            t = line[0] + line[1] * odds
            penalty = line[0] ** 2 + (line[1] - 1) ** 2
            return np.sum(np.logaddexp(0, t) - right * t) + RIDGE / 2 * penalty

        lines[status] = [round(float(v), 4) for v in minimize(loss, [0.0, 1.0]).x]
    return lines


def calibrated(lines: Mapping, status: str, probability: float) -> float:
    """Expected share of right verdicts of this status and stated probability."""
    offset, slope = lines.get(status, (0.0, 1.0))
    return float(1 / (1 + np.exp(-offset - slope * _log_odds(probability))))


def checked(verdicts: Sequence[Stated], halves: Sequence[int]) -> dict[str, float]:
    """Brier score and calibration error of the stated probabilities, before and after a
    calibration on the other half of the verdicts; ``halves``: 0 or 1 for each."""
    right = np.array([right for *_, right in verdicts], float)
    before = np.array([stated for _, stated, _ in verdicts])
    lines = [
        lines_of([v for v, half in zip(verdicts, halves, strict=True) if half != own])
        for own in (0, 1)
    ]
    after = np.array(
        [
            calibrated(lines[half], status, stated)
            for (status, stated, _), half in zip(verdicts, halves, strict=True)
        ]
    )
    return {
        "verdicts": len(verdicts),
        "Brier score before": float(np.mean((before - right) ** 2)),
        "Brier score": float(np.mean((after - right) ** 2)),
        "calibration error before": _calibration_error(before, right),
        "calibration error": _calibration_error(after, right),
    }


def _calibration_error(stated, right) -> float:
    """Mean absolute difference of stated and observed share over tenths of the probability."""
    place = np.minimum((stated * 10).astype(int), 9)
    return float(np.abs(np.bincount(place, stated - right)).sum() / len(stated))
