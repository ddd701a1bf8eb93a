"""How far the gap shrinks: on the rows fitted, and on data not used."""

from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from tirefit.diagnosis.negligible import NONZERO, ROUNDING

_DRAWS = 400
"""Bootstrap draws: twenty beyond either end of a 90 % interval."""

INTERVAL = (0.05, 0.95)
"""Quantiles at the ends of a 90 % interval."""

_RESOLVED = 3.0
"""Standard deviations of the energy of noise from which a gap is resolved."""

_FEWEST_ROWS = 2.0
"""Independent rows that a file counts as, at least."""

_GRID, _FARTHEST = 400, 6.0
"""Steps of an energy's root; standard errors above its figure at which they end."""

WORST = -1.0
"""Closure that counts as the worst there is: the gap doubled."""

_LEAST_BLOCK, _BLOCKS = 5, 60
"""Rows of a block at least, and blocks of a record at most."""


class Closure(NamedTuple):
    """Size of a gap and how much of it an extension closes.

    ``rms`` [N] is the base gap beyond noise, ``remaining`` [N] what the extension
    leaves, ``closed`` = 1 - remaining / rms with its 90 % interval, None where the gap
    may be too small to say (below 3 sqrt(2 / n_effective) of the noise's energy; on the
    rows fitted, in more than one draw of twenty). It ends at -1, where the extension
    doubles the gap: beyond, a small gap sets its size. Of several runs it is no
    narrower than their differences allow.
    """

    rms: float
    remaining: float
    closed: float | None
    low: float | None
    high: float | None
    resolvable: bool


def _is_resolvable(gap, variance, inflation) -> bool:
    """Whether a gap of this energy [N^2] is one that noise does not have."""
    effective = max(len(variance) / inflation, _FEWEST_ROWS)
    return bool(gap >= _RESOLVED * np.sqrt(2 / effective) * np.mean(variance))


def closure_on_rows(truth, before, after, variance, run, inflation) -> Closure:
    """Closure on the rows that were fitted, from what the force there may truly be: the
    median and the interval of its draws.

    Args:
        truth: (n, draws) of :func:`summary.plausible.plausible_forces` [N].
        before, after: (n,) forces [N] of the base and of the extension.
        variance: (n,) noise variance [N^2].
        run: (n,) runs.
        inflation: rows per independent row.
    """
    gaps, rests = (truth - before[:, None]) ** 2, (truth - after[:, None]) ** 2
    gap, closed = gaps.mean(axis=0), _closed(gaps.mean(axis=0), rests.mean(axis=0))
    rms, middle = float(np.sqrt(np.median(gap))), float(np.median(closed))
    remaining = (1 - middle) * rms
    if not _is_resolvable(np.quantile(gap, INTERVAL[0]), variance, inflation):
        return Closure(rms, remaining, None, None, None, False)
    low, high = np.quantile(closed, INTERVAL)
    one_less = zip(without_each(gaps, run), without_each(rests, run), strict=True)
    each = np.array([np.median(_closed(*means)) for means in one_less])
    if len(each):
        low, high = of_so_few_runs(middle, low, high, each)
    return Closure(rms, remaining, middle, float(low), float(high), True)


def _closed(gap, left) -> np.ndarray:
    """1 - root of the ratio of the energies left and of the gap, no less than -1."""
    ratio = np.asarray(left) / np.maximum(gap, NONZERO)
    return np.maximum(1 - np.sqrt(ratio), WORST)


def closure_elsewhere(before, after, variance, run, inflation, generator) -> Closure:
    """Closure on rows that neither fit has seen, from the energies of what they miss.

    The energy that is left is one of the residuals less that of the noise, and may come
    out below zero where there is little: what is given is the median and the interval
    of what it may be, any root of it from zero on as likely beforehand.

    Args:
        before, after: (n,) residuals [N] of the base and of the extension.
        variance: (n,) noise variance [N^2].
        run: (n,) runs, which the blocks of the bootstrap do not cross.
        inflation: rows per independent row.
    """
    terms = np.stack([before**2 - after**2, after**2 - variance], axis=1)
    gain, left = terms.mean(axis=0)
    rms = float(np.sqrt(max(gain + left, 0.0)))
    means = block_means(terms, run, inflation, generator)
    # What the extension gains is known well, and goes with what it leaves as it does
    # from one bootstrap to the other.
    gains = means[np.argsort(means[:, 1]), 0]
    # Of a block or two the spread is no error; the noise alone makes this much.
    of_noise = np.sqrt(2 * np.mean(variance**2) * inflation / len(variance))
    error = float(max(np.std(means[:, 1]), of_noise))
    lefts = _not_negative(left, error, len(gains))
    closed = _closed(np.maximum(gains + lefts, 0.0), lefts)
    middle = float(np.median(closed))
    remaining = (1 - middle) * rms
    if not _is_resolvable(gain + left, variance, inflation):
        return Closure(rms, remaining, None, None, None, False)
    low, high = np.quantile(closed, INTERVAL)
    fewer = without_each(terms, run)
    if len(fewer):
        over = np.array(
            [np.median(_not_negative(x, error, _DRAWS)) for x in fewer[:, 1]]
        )
        each = _closed(np.maximum(fewer[:, 0] + over, 0.0), over)
        low, high = of_so_few_runs(middle, low, high, each)
    return Closure(rms, remaining, middle, float(low), float(high), True)


def _not_negative(value: float, error: float, count: int) -> np.ndarray:
    """Quantiles (count,), ascending, of an energy of which a figure with a normal error
    is known: its root may be anything from zero on.

    A right figure far above its error keeps its own value; one that is below zero says
    that there is a part of its error at most.
    """
    error = max(error, ROUNDING * abs(value), NONZERO)
    most = np.sqrt(max(value, 0.0) + _FARTHEST * error)
    root = (np.arange(_GRID) + 0.5) / _GRID * most
    off = (root**2 - value) / error
    weight = np.exp(-0.5 * (off**2 - np.min(off**2)))
    below = np.cumsum(weight) / np.sum(weight)
    return np.interp((np.arange(count) + 0.5) / count, below, root) ** 2


def block_means(terms, run, inflation, generator) -> np.ndarray:
    """Means of terms (n, k) over rows drawn anew in blocks: (draws, k)."""
    length = int(max(2 * inflation, _LEAST_BLOCK, len(terms) // _BLOCKS))
    blocks = _blocks(run, length)
    sizes = np.array([len(rows) for rows in blocks])
    begins = np.cumsum(sizes) - sizes
    sums = np.add.reduceat(terms[np.concatenate(blocks)], begins, axis=0)
    drawn = generator.multinomial(len(blocks), [1 / len(blocks)] * len(blocks), _DRAWS)
    return drawn @ sums / (drawn @ sizes)[:, None]


def without_each(terms, run) -> np.ndarray:
    """Means of terms (n, k) with each run left out: (R, k); none of a single run."""
    codes = np.unique(run)
    if len(codes) < 2:
        return np.zeros((0, terms.shape[1]))
    sums = np.array([terms[run == code].sum(axis=0) for code in codes])
    counts = np.array([np.sum(run == code) for code in codes])
    return (sums.sum(axis=0) - sums) / (counts.sum() - counts)[:, None]


def of_so_few_runs(value, low, high, one_less):
    """An interval of 90 % that knows how few runs there are: at least the jackknife's
    over the runs, by Student's t of one degree of freedom less than there are runs.

    Args:
        value, low, high: figures and their intervals from blocks of rows, (...).
        one_less: (R, ...) figures with each run left out.
    """
    count = len(one_less)
    off = one_less - one_less.mean(axis=0)
    error = np.sqrt((count - 1) / count * np.sum(off**2, axis=0))
    reach = float(stdtrit(count - 1, 0.95)) * error
    low = np.maximum(np.minimum(low, value - reach), WORST)
    return low, np.minimum(np.maximum(high, value + reach), 1.0)


def _blocks(run, length: int) -> list[np.ndarray]:
    blocks = []
    for code in np.unique(run):
        rows = np.flatnonzero(run == code)
        blocks += np.array_split(rows, max(len(rows) // length, 1))
    return blocks
