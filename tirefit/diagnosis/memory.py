"""The memory of a noise: what of it neighbours in time share, and for how long.

Smooth functions are taken out of a residual before its noise is judged, and take slow
noise with them: the correlation of what they leave is too small, below zero for noise
without any memory. Both answers here count what was taken.

A force through an amplifier remembers; the noise of a slip may not. Where the curve is
steep most of a row's noise is that of the slip, where the tire slides it is that of the
force: which rows remember tells whose memory it is.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.signal import lfilter

from tirefit.diagnosis.negligible import NONZERO, ROUNDING, SILENT

__all__ = ["FORGETFUL", "Memory", "memory_of"]


class Memory(NamedTuple):
    """Noise of which a ``share`` of the variance, of all rows or of each (n,), is a
    first-order process in time, with the correlation ``fade`` of neighbours, and the
    rest is independent; that it is this one has the probability ``chance``."""

    fade: float
    share: float | np.ndarray
    chance: float = 1.0

    @property
    def rows_each(self):
        """Rows that count as one, of all rows or of each (n,)."""
        return 1 + 2 * self.share * self.fade / (1 - self.fade)

    def of(self, rows) -> "Memory":
        """That of some of the rows (bool or index array)."""
        if np.ndim(self.share) == 0:
            return self
        return self._replace(share=np.asarray(self.share)[rows])


FORGETFUL = Memory(0.0, 0.0)
"""Of independent rows."""

_LEAST_CHANCE = 0.02
"""Probability from which a memory counts among what may be."""


_CORRELATED = 2.5
"""Standard errors of the correlation at lag one that count: one white record in 160."""

_SHORT = tuple(
    Memory(f, s) for f in (0.2, 0.35, 0.5, 0.65) for s in (0.3, 0.5, 0.7, 1.0)
)
_LONG = tuple(Memory(f, 1.0) for f in (0.8, 0.9, 0.95))
"""Memories that are tried. A long one has no independent noise beside it: a filter's. A
slow part beside independent noise is a drift, which is no noise."""

_SHORTEST = 3
"""Rows of a stretch, at least."""

_MOSTLY, _ENOUGH = 0.5, 0.2
"""Share of a row's variance from which it is mostly the force's own, and the share of
the rows that have so much, from which the memory is that of these."""

_TRIED = np.linspace(0.0, 0.9, 19)
"""Correlations of neighbours that are tried."""


def _lag_one(white, unit, stretches) -> float:
    """Correlation of neighbours, what the smooth functions took of it put back."""
    rows, q = unit.shape
    variance = float(white @ white) / max(rows - q, 1)
    together = sum(float(white[s][1:] @ white[s][:-1]) for s in stretches)
    taken = sum(float(np.sum(unit[s][1:] * unit[s][:-1])) for s in stretches)
    return (together + variance * taken) / max(variance * rows, NONZERO)


def _innovations(columns, memory: Memory, stretches):
    """What is new in each row of the columns (n, k), of unit variance, and the log of
    the factor that this took, summed over the rows.

    A first-order process beside independent noise is one with a moving average: its
    coefficient from the two covariances of x_t - fade x_t-1.
    """
    fade, share = memory.fade, memory.share
    start = (1 - share) * (1 + fade**2) + share * (1 - fade**2)
    next_to = -fade * (1 - share)
    ratio = next_to / start
    mix = 2 * ratio / (1 + np.sqrt(1 - 4 * ratio**2))
    variance = start / (1 + mix**2)
    out, scaled = np.empty_like(columns), 0
    for rows in stretches:
        x = columns[rows]
        new = x[1:] - fade * x[:-1]
        new, _ = lfilter([1.0], [1.0, mix], new, axis=0, zi=-mix * variance * x[:1])
        out[rows] = np.concatenate([x[:1], new / np.sqrt(variance)])
        scaled += len(rows) - 1
    return out, 0.5 * scaled * float(np.log(variance))


def _likelihood(both, memory: Memory, stretches) -> float:
    """Restricted log likelihood of the residual, the last of the columns, given those
    of the smooth functions before it; its variance maximised."""
    new, log_factor = _innovations(both, memory, stretches)
    smooth, residual = new[:, :-1], new[:, -1]
    gram = smooth.T @ smooth + ROUNDING * np.eye(smooth.shape[1])
    factor = cho_factor(gram)
    score = smooth.T @ residual
    left = float(residual @ residual - score @ cho_solve(factor, score))
    freedom = len(both) - smooth.shape[1]
    half_log_det = float(np.sum(np.log(np.diag(factor[0]))))
    return -0.5 * freedom * np.log(max(left, NONZERO)) - half_log_det - log_factor


def _likelihood_of_pairs(white, stretches, remembers) -> float:
    """Largest log likelihood of the pairs of neighbours, each as two normal numbers.

    Args:
        white: (n,) of unit variance.
        remembers: (n,) share of the variance of each row that may have a memory.
    """
    first = np.concatenate([rows[:-1] for rows in stretches])
    second = np.concatenate([rows[1:] for rows in stretches])
    a, b = white[first], white[second]
    most = np.sqrt(remembers[first] * remembers[second])
    values = []
    for correlation in _TRIED:
        each = correlation * most
        left = 1 - each**2
        quadratic = (a**2 - 2 * each * a * b + b**2) / left
        values.append(-0.5 * float(np.sum(np.log(left) + quadratic)))
    return max(values)


def _where(inside, stretches) -> list[np.ndarray]:
    """The parts of the stretches that lie inside (n,) bool."""
    parts = []
    for rows in stretches:
        breaks = np.flatnonzero(np.diff(inside[rows].astype(int))) + 1
        parts += [part for part in np.split(rows, breaks) if inside[part[0]]]
    return [part for part in parts if len(part) >= _SHORTEST]


def memory_of(
    white, unit, stretches: Sequence[np.ndarray], own=None
) -> tuple[Memory, ...]:
    """What the memory of a noise may be, the likeliest first; none where the
    correlation of neighbours is that of chance.

    Args:
        white: (n,) residual, smooth functions taken out, zero for rows set aside.
        unit: (n, q) those functions, orthonormal.
        stretches: rows in the order of time (index arrays), which share no row.
        own: (n,) share of the variance of each row that is the force's own, not that
            of the slip; None where it is all of it.
    """
    stretches = [rows for rows in stretches if len(rows) >= _SHORTEST]
    if not stretches or np.sqrt(np.mean(white**2)) < SILENT:
        return (FORGETFUL,)
    if _lag_one(white, unit, stretches) < _CORRELATED / np.sqrt(
        sum(len(rows) for rows in stretches)
    ):
        return (FORGETFUL,)
    if own is not None:
        inside = _where(own >= _MOSTLY, stretches)
        among = np.concatenate([np.arange(0), *inside])
        alike = np.ones(len(white))
        if len(among) >= _ENOUGH * len(white) and (
            _likelihood_of_pairs(white, stretches, own)
            > _likelihood_of_pairs(white, stretches, alike)
        ):
            each = own / np.mean(own[among])
            return tuple(
                memory._replace(share=np.minimum(memory.share * each, 1.0))
                for memory in _likely(white, unit, inside)
            )
    return _likely(white, unit, stretches)


def _likely(white, unit, stretches) -> tuple[Memory, ...]:
    """The memories, of those tried, that the rows of the stretches may have."""
    order = np.concatenate(stretches)
    ends = np.cumsum([len(rows) for rows in stretches])[:-1]
    stretches = np.split(np.arange(len(order)), ends)
    both = np.concatenate([unit[order], white[order, None]], axis=1)
    tried = (FORGETFUL, *_SHORT, *_LONG)
    logs = np.array([_likelihood(both, memory, stretches) for memory in tried])
    chance = np.exp(logs - logs.max())
    chance[chance < _LEAST_CHANCE * chance.sum()] = 0.0
    chance /= chance.sum()
    ranked = np.argsort(-chance)[: np.count_nonzero(chance)]
    return tuple(tried[k]._replace(chance=float(chance[k])) for k in ranked)
