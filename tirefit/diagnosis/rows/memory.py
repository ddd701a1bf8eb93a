"""How far the remainders of neighbouring rows are correlated."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from tirefit.diagnosis.engine import NONZERO, ROUNDING, SILENT
from tirefit.fitting.problem.noise import autocorrelation_time
from tirefit.params import Values


class Memory(NamedTuple):
    """A first-order autoregressive noise, or with a ``share`` of 0 independent noise.

    ``fade`` is the correlation of neighbours, ``chance`` the probability of this one.
    """

    fade: float = 0.0
    share: float = 0.0
    chance: float = 1.0

    @property
    def rows_each(self) -> float:
        """Number of rows per independent row."""
        return 1 + 2 * self.share * self.fade / (1 - self.fade)


FORGETFUL = Memory()
"""Independent rows."""


_FADES = np.arange(20) / 20
"""Correlations of neighbours that are compared."""


CORRELATED = 2.5
"""Significant lag-one correlation, in standard errors: one white record in 160."""


FACTS = len(_FADES)
"""Smallest number of independent rows; stronger correlation is treated as a gap."""


def memory_of(
    white: np.ndarray, unit: np.ndarray, stretches: Sequence[np.ndarray], most: float = np.inf
) -> tuple[Memory, ...]:
    """Correlations of a noise of 2 % probability or more, the most probable first;
    :data:`FORGETFUL` where the correlation of neighbours is not significant.

    Smooth functions absorb slow noise, so the correlation of the remainder is biased
    downwards; the restricted likelihood corrects that.

    Args:
        white: (n,) remainder after smooth functions, zero for excluded rows.
        unit: (n, q) those functions, orthonormal.
        stretches: rows in the order of time (index arrays), which share no row.
        most: largest variance of the noise, so that a slow gap with noise of a known
            level is not treated as correlated noise.
    """
    stretches = [rows for rows in stretches if len(rows) > 2]
    if not stretches or np.sqrt(np.mean(white**2)) < SILENT:
        return (FORGETFUL,)
    rows, q = unit.shape
    variance = float(white @ white) / max(rows - q, 1)
    together = sum(float(white[s][1:] @ white[s][:-1]) for s in stretches)
    taken = sum(float(np.sum(unit[s][1:] * unit[s][:-1])) for s in stretches)
    lag_one = (together + variance * taken) / max(variance * rows, NONZERO)
    if lag_one < CORRELATED / np.sqrt(sum(len(rows) for rows in stretches)):
        return (FORGETFUL,)
    logs = _log_likelihoods(white, unit, stretches, most)
    chance = np.exp(logs - logs.max())
    chance[chance < 0.02 * chance.sum()] = 0.0
    chance /= chance.sum()
    ranked = np.argsort(-chance)[: np.count_nonzero(chance)]
    return tuple(Memory(float(_FADES[k]), float(_FADES[k] > 0), float(chance[k])) for k in ranked)


def _log_likelihoods(
    white: np.ndarray, unit: np.ndarray, stretches: Sequence[np.ndarray], most: float
) -> np.ndarray:
    """Restricted log likelihood of each of the correlations.

    The innovation of a row is x_t - fade x_(t-1): the products of the innovations of
    all correlations are sums of the same three.
    """
    both = np.concatenate([unit, white[:, None]], axis=1)
    heads, tails = (
        np.concatenate([rows[part] for rows in stretches])
        for part in (slice(None, -1), slice(1, None))
    )
    starts, before, after = both[[s[0] for s in stretches]], both[heads], both[tails]
    across = after.T @ before
    starts, before, after = (x.T @ x for x in (starts, before, after))
    freedom, logs = len(heads) + len(stretches) - unit.shape[1], []
    for fade in _FADES:
        left = 1 - fade**2
        new = after - fade * (across + across.T) + fade**2 * before
        products = starts + new / left
        smooth, score = products[:-1, :-1], products[:-1, -1]
        factor = cho_factor(smooth + ROUNDING * np.eye(len(smooth)))
        rest = float(products[-1, -1] - score @ cho_solve(factor, score))
        variance = min(max(rest, NONZERO) / freedom, most)
        log = -0.5 * (freedom * np.log(variance) + rest / variance)
        log -= 0.5 * len(heads) * np.log(left)
        logs.append(log - float(np.sum(np.log(np.diag(factor[0])))))
    return np.array(logs)


def in_order(time: Values | None, run: np.ndarray) -> list[np.ndarray]:
    """Rows of each run in the order they were measured: index arrays."""
    order = np.arange(len(run)) if time is None else np.lexsort((time, run))
    return [order[run[order] == code] for code in np.unique(run)]


def correlation(white: np.ndarray, time: Values | None, run: np.ndarray) -> float:
    """Number of rows per independent row of a remainder (n,), at least 1 and at most
    n / :data:`FACTS`; excluded rows are zero."""
    each = autocorrelation_time([white[rows] for rows in in_order(time, run)])
    return min(each, len(white) / FACTS)
