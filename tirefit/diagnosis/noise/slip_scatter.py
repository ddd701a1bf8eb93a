"""The noise of a slip that nobody stated, as the forces show it.

What a slip is off by moves a force the more, the steeper the curve is; the force's own
noise knows nothing of that. Neighbours that scatter more where the curve is steep show
the noise of their slips.
"""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import nnls

from tirefit.diagnosis.negligible import NONZERO

_CLEAR = 2.5
"""Standard errors from which the scatter follows the steepness: one record in 160
without any noise of the slip."""

_ENOUGH = 0.3
"""Share of the rows with neighbours, from which these speak for all."""

_FAR = 12.0
"""Square over its mean at which it is cut: one normal number in 2,000 is larger."""

_ROUNDS = 6
"""Rounds of weighting by the law of the variance itself."""

_LEAST = 1e-3
"""Variance over the mean one, at least."""

_TOGETHER = 1.94
"""Squares of second differences that count as one: 1 + 2 (4/9 + 1/36), as each shares
rows with two to either side, correlations -2/3 and 1/6."""


def slip_scatter(residual, steepness, fz, alike: Sequence, in_time: Sequence) -> float:
    """Standard deviation of the slip's noise, zero where none shows; what the slips of
    rows that follow each other are off by together is none.

    Args:
        residual: (n,) [N].
        steepness: (n,) square of the force's slope over the slip [N^2].
        fz: (n,) load, with which the force's own noise may grow.
        alike: rows whose neighbours differ by noise alone: index arrays.
        in_time: rows in the order of time: index arrays.
    """
    alike = [rows for rows in alike if len(rows) > 2]
    if sum(len(rows) - 2 for rows in alike) < _ENOUGH * len(residual):
        return 0.0
    own = np.stack([np.ones_like(fz), (fz / np.mean(fz)) ** 2], axis=1)
    parts = np.concatenate([own, steepness[:, None]], axis=1)
    parts = np.concatenate([_middle(parts[rows], 0.25) for rows in alike])
    middle = np.concatenate([rows[1:-1] for rows in alike])
    second = np.concatenate([_middle(residual[rows], -0.5) for rows in alike])
    clear, variance = _share_of_slip(second**2, parts)
    if clear < _CLEAR:
        return 0.0
    local, slope = np.zeros((2, len(residual)))
    local[middle], slope[middle] = second, np.sqrt(parts[:, -1])
    together = _shared(local, slope, in_time)
    return float(np.sqrt(max(variance - together, 0.0)))


def _share_of_slip(square, parts) -> tuple[float, float]:
    """How clearly squares (m,) follow the last of the parts (m, k), in standard errors
    of a score that has no bound at zero, and how large that part then is."""
    without = _law(square, parts[:, :-1])
    # The score of the slip's share, the own parts that it resembles taken out.
    over = np.minimum(square / without, _FAR) - 1
    own, along = parts[:, :-1] / without[:, None], parts[:, -1] / without
    along = along - own @ np.linalg.lstsq(own, along, rcond=None)[0]
    chance = max(2.0, float(np.var(over))) * _TOGETHER * float(along @ along)
    law = _law(square, parts)
    sizes, _ = nnls(parts / law[:, None], np.minimum(square / law, _FAR))
    return float(over @ along) / np.sqrt(max(chance, NONZERO)), float(sizes[-1])


def _shared(local, slope, in_time) -> float:
    """Covariance of what the slips of neighbours in time are off by.

    Args:
        local: (n,) second differences of the residual, 0 for rows without.
        slope: (n,) root of what the slip's variance is of theirs.
        in_time: rows in the order of time: index arrays. A force that remembers is
            alike whatever the slopes.
    """
    first, second = (
        np.concatenate([rows[part] for rows in in_time])
        for part in (slice(None, -1), slice(1, None))
    )
    both = slope[first] * slope[second]
    parts = np.stack([both > 0, both], axis=1)
    sizes, *_ = np.linalg.lstsq(parts, local[first] * local[second], rcond=None)
    return max(float(sizes[1]), 0.0)


def _middle(values, weight: float):
    """Each row but the first and the last plus ``weight`` times its neighbours."""
    return values[1:-1] + weight * (values[2:] + values[:-2])


def _law(square, parts) -> np.ndarray:
    """Mean of the squares (m,) as the parts (m, k), none of them negative, make it up,
    each row weighed by that."""
    mean = max(float(np.mean(square)), NONZERO)
    law = np.full(len(square), mean)
    for _ in range(_ROUNDS):
        size, _ = nnls(parts / law[:, None], np.minimum(square / law, _FAR))
        law = np.maximum(parts @ size, _LEAST * mean)
    return law
