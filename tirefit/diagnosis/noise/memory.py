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


class Memory(NamedTuple):
    """Noise of which a ``share`` of the variance, of all rows or of each (n,), is a
    first-order process in time, with the correlation ``fade`` of neighbours, and the
    rest is independent; that it is this one has the probability ``chance``, and then
    the mean ``variance`` of the rows is so large, over what it was thought to be."""

    fade: float
    share: float | np.ndarray
    chance: float = 1.0
    variance: float = 1.0

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

_BESIDE = tuple(Memory(f, s) for f in (0.2, 0.35, 0.5, 0.65) for s in (0.3, 0.5, 0.7))
"""Memories that are tried beside independent noise. None of them is long: a slow part
beside independent noise is a drift, which is no noise."""

_ALONE = tuple(Memory(k / 20, 1.0) for k in range(2, 20))
"""Memories that are tried without any: a filter's."""

_SPACING = 3
"""How many memories without independent noise lie as close as two beside it."""

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


def _remembers(white, unit, stretches) -> bool:
    """Whether neighbours are more alike than by chance."""
    if not stretches or np.sqrt(np.mean(white**2)) < SILENT:
        return False
    chance = 1 / np.sqrt(sum(len(rows) for rows in stretches))
    return _lag_one(white, unit, stretches) > _CORRELATED * chance


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


def _likelihood(products, rows: int, log_factor: float, wanted: "_Wanted"):
    """Log likelihood of a residual, and its likeliest variance.

    Args:
        products: (q + 1, q + 1) of what is new in the smooth functions, and in the
            residual, the last.
        rows: as many went into them.
        log_factor: of :func:`_innovations`.
    """
    smooth, score = products[:-1, :-1], products[:-1, -1]
    factor = cho_factor(smooth + ROUNDING * np.eye(len(smooth)))
    left = float(products[-1, -1] - score @ cho_solve(factor, score))
    freedom = rows - len(smooth) if wanted.restricted else rows
    variance = min(max(left, NONZERO) / freedom, wanted.most)
    log = -0.5 * (freedom * np.log(variance) + left / variance) - log_factor
    if wanted.restricted:
        log -= float(np.sum(np.log(np.diag(factor[0]))))
    return log, variance


class _Wanted(NamedTuple):
    """The likelihood with the likeliest variance, of at most ``most``; ``restricted``
    to what smooth functions leave, which finds the memory without bias: the other
    compares different smooth functions."""

    most: float
    restricted: bool


def _likelihoods(white, unit, stretches, wanted: _Wanted) -> np.ndarray:
    """Of :data:`_BESIDE` and :data:`_ALONE`, after that of none, on the rows of the
    stretches alone: log likelihoods and variances, (2, memories).

    Where all of the noise fades, what is new in a row is it less the one before, times
    the fade: the products of all fades are made of the same three.
    """
    order = np.concatenate(stretches)
    ends = np.cumsum([len(rows) for rows in stretches])[:-1]
    stretches = np.split(np.arange(len(order)), ends)
    both = np.concatenate([unit[order], white[order, None]], axis=1)
    logs = [_likelihood(both.T @ both, len(both), 0.0, wanted)]
    for memory in _BESIDE:
        new, log_factor = _innovations(both, memory, stretches)
        logs.append(_likelihood(new.T @ new, len(both), log_factor, wanted))
    heads, tails = (
        np.concatenate([rows[part] for rows in stretches])
        for part in (slice(None, -1), slice(1, None))
    )
    starts = both[[rows[0] for rows in stretches]]
    before, after = both[heads], both[tails]
    across = after.T @ before
    starts, before, after = (x.T @ x for x in (starts, before, after))
    for memory in _ALONE:
        fade, left = memory.fade, 1 - memory.fade**2
        new = after - fade * (across + across.T) + fade**2 * before
        log_factor = 0.5 * len(heads) * np.log(left) + np.log(_SPACING)
        products = starts + new / left
        logs.append(_likelihood(products, len(both), log_factor, wanted))
    return np.array(logs).T


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
    white, unit, stretches: Sequence[np.ndarray], own=None, most: float = np.inf
) -> tuple[Memory, ...]:
    """What the memory of a noise may be, the likeliest first; none where the
    correlation of neighbours is that of chance.

    Args:
        white: (n,) residual, smooth functions taken out, zero for rows set aside.
        unit: (n, q) those functions, orthonormal.
        stretches: rows in the order of time (index arrays), which share no row.
        own: (n,) share of the variance of each row that is the force's own, not that
            of the slip; None where it is all of it.
        most: variance that the noise may have. One with a memory differs little from
            row to row: a gap beside noise of a known level is none of that kind.
    """
    stretches = [rows for rows in stretches if len(rows) >= _SHORTEST]
    if not _remembers(white, unit, stretches):
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
                memory._replace(
                    share=np.minimum(memory.share * each, 1.0),
                    variance=1 + float(np.mean(each)) * (memory.variance - 1),
                )
                for memory in _likely(white, unit, inside, most)
            )
    return _likely(white, unit, stretches, most)


def scatter_between(triples, memory: Sequence[Memory], stretches, rows: int) -> float:
    """Mean variance of the middle of three rows less the mean of the outer two, for
    noise of unit variance: 1.5 where it is independent.

    Args:
        triples: (3, t) row numbers: the middle, and the outer two.
        memory: what the noise may be.
        stretches: rows in the order of time (index arrays).
        rows: as many there are.
    """
    place, stretch = np.zeros((2, rows), dtype=int)
    for k, part in enumerate(stretches):
        place[part], stretch[part] = np.arange(len(part)), k
    variance = np.full(triples.shape[1], 1.5)
    for one in memory:
        share = np.sqrt(np.broadcast_to(one.share, rows))
        for (a, b), weight in (((0, 1), -1.0), ((0, 2), -1.0), ((1, 2), 0.5)):
            first, second = triples[a], triples[b]
            apart = np.abs(place[first] - place[second])
            alike = share[first] * share[second] * one.fade**apart
            among = stretch[first] == stretch[second]
            variance += one.chance * weight * np.where(among, alike, 0.0)
    return float(np.mean(variance))


def _likely(white, unit, stretches, most: float) -> tuple[Memory, ...]:
    """The memories, of those tried, that the rows of the stretches may have."""
    tried = (FORGETFUL, *_BESIDE, *_ALONE)
    logs, variances = _likelihoods(white, unit, stretches, _Wanted(most, True))
    chance = np.exp(logs - logs.max())
    chance[chance < _LEAST_CHANCE * chance.sum()] = 0.0
    chance /= chance.sum()
    ranked = np.argsort(-chance)[: np.count_nonzero(chance)]
    return tuple(
        tried[k]._replace(chance=float(chance[k]), variance=float(variances[k]))
        for k in ranked
    )


def likeliest(white, unit, stretches: Sequence[np.ndarray], most: float) -> float:
    """Log likelihood of a residual under its likeliest memory, one where its neighbours
    are no more alike than by chance.

    Args:
        white, unit, stretches, most: as in :func:`memory_of`.
    """
    stretches = [rows for rows in stretches if len(rows) >= _SHORTEST]
    wanted = _Wanted(most, False)
    if _remembers(white, unit, stretches):
        return float(np.max(_likelihoods(white, unit, stretches, wanted)[0]))
    alone = white[np.concatenate(stretches)] if stretches else white
    return _likelihood(np.array([[alone @ alone]]), len(alone), 0.0, wanted)[0]
