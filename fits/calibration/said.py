"""How often verdicts are right, by status and by how sure they were."""

from collections import defaultdict
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.optimize import minimize

__all__ = ["as_said", "checked", "lines_of"]

FARTHEST = 7.0  # log odds beyond which more say no more, as in decide/findings.py
RIDGE = 2.0  # 1 / variance of offset and slope about 0 and 1

Said = tuple[str, float, bool]
"""Status, probability, right: of one verdict."""


def _log_odds(probability) -> np.ndarray:
    p = np.clip(probability, 1e-12, 1 - 1e-12)
    return np.clip(np.log(p / (1 - p)), -FARTHEST, FARTHEST)


def lines_of(verdicts: Sequence[Said]) -> dict[str, list[float]]:
    """Offset and slope, by status, of the log odds of being right over the log odds
    that were said, by logistic regression, drawn towards 0 and 1."""
    each = defaultdict(list)
    for status, said, right in verdicts:
        each[str(status)].append((said, right))
    lines = {}
    for status, cases in sorted(each.items()):
        said, right = np.array(cases, float).T
        odds = _log_odds(said)

        def loss(line, odds=odds, right=right):
            t = line[0] + line[1] * odds
            drawn = line[0] ** 2 + (line[1] - 1) ** 2
            return np.sum(np.logaddexp(0, t) - right * t) + RIDGE / 2 * drawn

        lines[status] = [round(float(v), 4) for v in minimize(loss, [0.0, 1.0]).x]
    return lines


def as_said(lines: Mapping, status: str, probability: float) -> float:
    """Share of verdicts of this status and probability that are right."""
    offset, slope = lines.get(status, (0.0, 1.0))
    return float(1 / (1 + np.exp(-offset - slope * _log_odds(probability))))


def checked(verdicts: Sequence[Said], halves: Sequence[int]) -> dict[str, float]:
    """Brier score and calibration error of what was said, and of what the other half of
    the verdicts teaches to say; ``halves``: 0 or 1 for each."""
    right = np.array([right for *_, right in verdicts], float)
    before = np.array([said for _, said, _ in verdicts])
    lines = [
        lines_of([v for v, half in zip(verdicts, halves, strict=True) if half != own])
        for own in (0, 1)
    ]
    after = np.array(
        [
            as_said(lines[half], status, said)
            for (status, said, _), half in zip(verdicts, halves, strict=True)
        ]
    )
    return {
        "verdicts": len(verdicts),
        "Brier score before": float(np.mean((before - right) ** 2)),
        "Brier score": float(np.mean((after - right) ** 2)),
        "calibration error before": _calibration_error(before, right),
        "calibration error": _calibration_error(after, right),
    }


def _calibration_error(said, right) -> float:
    """Mean distance of said and observed share over tenths of the probability."""
    place = np.minimum((said * 10).astype(int), 9)
    return float(np.abs(np.bincount(place, said - right)).sum() / len(said))
