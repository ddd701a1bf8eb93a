"""Tests whether the residual of a model resembles noise: runs of signs, local means."""

import numpy as np
from scipy.stats import f as variance_ratio
from scipy.stats import norm

from fits.withheld.library import Inputs

__all__ = ["lack_of_fit", "local_means", "runs"]

LEAST = 6  # rows per block


def runs(values: np.ndarray) -> float:
    """One-sided p-value of the number of sign changes (Wald and Wolfowitz)."""
    above = values > np.median(values)
    n, ups = len(values), int(above.sum())
    pairs = 2.0 * ups * (n - ups)
    spread = pairs * (pairs - n) / (n**2 * (n - 1)) if n > 1 else 0.0
    if spread <= 0:
        return 1.0
    count = 1 + int(np.sum(above[1:] != above[:-1]))
    return float(norm.cdf((count - 1 - pairs / n) / np.sqrt(spread)))


def local_means(values: np.ndarray) -> float:
    """p-value of the spread of block means: analysis of variance over blocks."""
    n = len(values)
    parts = max(min(int(np.sqrt(n)), n // LEAST), 1)
    if parts < 2:
        return 1.0
    blocks = np.array_split(values, parts)
    means = np.array([np.mean(b) for b in blocks])
    sizes = np.array([len(b) for b in blocks])
    between = np.sum(sizes * (means - values.mean()) ** 2) / (parts - 1)
    within = sum(np.sum((b - np.mean(b)) ** 2) for b in blocks) / (n - parts)
    return float(variance_ratio.sf(between / max(within, 1e-12), parts - 1, n - parts))


def lack_of_fit(x: Inputs, left: np.ndarray) -> float:
    """p-value (Bonferroni) of a residual (n,), ordered by time, by slip, and by slip within
    each load and speed."""
    cells = np.lexsort((x.slip, np.round(x.v, 1), np.round(x.fz / x.fz.mean(), 1)))
    orders = [np.argsort(x.time, kind="stable"), np.argsort(x.slip), cells]
    tests = [test(left[order]) for order in orders for test in (runs, local_means)]
    return min(1.0, len(tests) * min(tests))
