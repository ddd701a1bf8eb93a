"""How far the gap shrinks: beyond the noise, paired, and on data not used."""

from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

__all__ = [
    "INTERVAL",
    "Closure",
    "block_means",
    "closure_of",
    "of_so_few_runs",
    "without_each",
]

_DRAWS = 400
"""Bootstrap draws: twenty beyond either end of a 90 % interval."""

INTERVAL = (0.05, 0.95)
"""Quantiles at the ends of a 90 % interval."""

_RESOLVED = 3.0
"""Standard deviations of the energy of noise from which a gap is resolved."""

_WORST = -1.0
"""Closure that counts as the worst there is: the gap doubled."""

_LEAST_BLOCK, _BLOCKS = 5, 60
"""Rows of a block at least, and blocks of a record at most."""


class Closure(NamedTuple):
    """Size of a gap and how much of it an extension closes.

    ``rms`` [N] is the base gap beyond noise, ``remaining`` [N] what the extension
    leaves, ``closed`` = 1 - remaining / rms with its 90 % interval, None where the gap
    is too small to say (below 3 sqrt(2 / n_effective) of the noise's energy). It ends
    at -1, where the extension doubles the gap: beyond, a small gap sets its size. Of
    several runs it is no narrower than their differences allow.
    """

    rms: float
    remaining: float
    closed: float | None
    low: float | None
    high: float | None
    resolvable: bool


def _energies(mean, lost):
    """Mean squares beyond noise (base gap, what is left) [N^2].

    Args:
        mean: means of before^2, of before^2 - after^2 and of the noise variance.
        lost: share of the noise that the parameters of both fits absorbed.
    """
    gap = mean[0] - mean[2] * (1 - lost[0])
    return gap, gap - (mean[1] + mean[2] * (lost[0] - lost[1]))


def closure_of(
    before, after, variance, parameters, run, inflation, generator, in_sample=True
) -> Closure:
    """Closure of the gap between two fits on the same rows.

    Args:
        before, after: (n,) residuals [N] of the base and of the extension.
        variance: (n,) noise variance [N^2].
        parameters: free parameters of both fits.
        run: (n,) runs, which the blocks of the bootstrap do not cross.
        inflation: rows per independent row.
        in_sample: whether both were fitted to these rows.
    """
    n = len(before)
    lost = np.array(parameters, float) * inflation / n * (1.0 if in_sample else 0.0)
    terms = np.stack([before**2, before**2 - after**2, variance], axis=1)
    gap, left = _energies(terms.mean(axis=0), lost)
    noise = float(np.mean(variance))
    effective = max(n / inflation, 2.0)
    resolvable = bool(gap >= _RESOLVED * np.sqrt(2 / effective) * noise)
    # Even the right extension misses by the uncertainty of its parameters.
    floor = noise * lost[1]
    rms = float(np.sqrt(max(gap, 0.0)))
    remaining = float(np.sqrt(max(left, 0.0) + floor)) if gap > 0 else 0.0
    if not resolvable:
        return Closure(rms, remaining, None, None, None, False)
    gaps, rests = _energies(block_means(terms, run, inflation, generator).T, lost)
    good = gaps > 0
    shares = np.sqrt((np.maximum(rests, 0.0) + floor)[good] / gaps[good])
    values = np.maximum(1 - shares, _WORST)
    closed = max(1 - remaining / rms, _WORST)
    low, high = np.quantile(values, INTERVAL) if good.any() else (closed, closed)
    one_less = without_each(terms, run)
    if len(one_less):
        fewer, rest = _energies(one_less.T, lost)
        share = np.sqrt((np.maximum(rest, 0.0) + floor) / np.maximum(fewer, gap * 1e-6))
        low, high = of_so_few_runs(closed, low, high, np.maximum(1 - share, _WORST))
    return Closure(
        rms, remaining, closed, float(min(low, closed)), float(max(high, closed)), True
    )


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
    low = np.maximum(np.minimum(low, value - reach), _WORST)
    return low, np.minimum(np.maximum(high, value + reach), 1.0)


def _blocks(run, length: int) -> list[np.ndarray]:
    blocks = []
    for code in np.unique(run):
        rows = np.flatnonzero(run == code)
        blocks += np.array_split(rows, max(len(rows) // length, 1))
    return blocks
