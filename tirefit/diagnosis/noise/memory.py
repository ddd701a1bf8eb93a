"""Correlation in time of the noise.

The noise is judged on the remainder after smooth functions, which take up slow noise:
its correlation is biased downwards. The restricted likelihood corrects that.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from tirefit.diagnosis.negligible import NONZERO, ROUNDING, SILENT
from tirefit.fitting.noise import autocorrelation_time


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

_LEAST_CHANCE = 0.02
"""Smallest probability of a correlation that is kept."""

CORRELATED = 2.5
"""Significant lag-one correlation, in standard errors: one white record in 160."""

_FACTS = 20
"""Smallest number of independent rows: more correlation is taken for a gap."""


def memory_of(
    white, unit, stretches: Sequence[np.ndarray], most: float = np.inf
) -> tuple[Memory, ...]:
    """Possible correlations of a noise, the most probable first; :data:`FORGETFUL`
    where the correlation of neighbours is not significant.

    Args:
        white: (n,) remainder after smooth functions, zero for excluded rows.
        unit: (n, q) those functions, orthonormal.
        stretches: rows in the order of time (index arrays), which share no row.
        most: largest variance of the noise, so that a slow gap beside noise of a known
            level is not taken for correlated noise.
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
    chance[chance < _LEAST_CHANCE * chance.sum()] = 0.0
    chance /= chance.sum()
    ranked = np.argsort(-chance)[: np.count_nonzero(chance)]
    return tuple(
        Memory(float(_FADES[k]), float(_FADES[k] > 0), float(chance[k])) for k in ranked
    )


def _log_likelihoods(white, unit, stretches, most: float) -> np.ndarray:
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


def in_order(time, run) -> list[np.ndarray]:
    """Rows of each run in the order they were measured: index arrays."""
    order = np.arange(len(run)) if time is None else np.lexsort((time, run))
    return [order[run[order] == code] for code in np.unique(run)]


def correlation(white, time, run) -> float:
    """Number of rows per independent row of a remainder, at least 1."""
    parts = [white[rows] for rows in in_order(time, run)]
    together = sum(float(p[1:] @ p[:-1]) for p in parts)
    lag_one = together / max(float(white @ white), NONZERO)
    if lag_one < CORRELATED / np.sqrt(len(white)):
        return 1.0
    first_order = (1 + lag_one) / max(1 - lag_one, ROUNDING)
    return min(max(autocorrelation_time(parts), first_order), len(white) / _FACTS)


def rows_per_independent(memory: Sequence[Memory], white, time, run) -> float:
    """Number of rows per independent row of a noise, at least 1.

    Args:
        memory: possible correlations.
        white: (n,) remainder over the standard deviation, zero for excluded rows.
    """
    each = sum(one.chance * one.rows_each for one in memory)
    if each <= 1:
        return 1.0
    return min(max(each, correlation(white, time, run)), len(white) / _FACTS)
