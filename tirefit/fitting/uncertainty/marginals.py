"""Densities of posterior draws, and profiles, on grids for figures."""

from collections.abc import Sequence

import numpy as np

_BINS = 36
_FAR = 6.0
"""Length of an axis from the median, in units of the distance to the end of the central 68.27 % on
that side: 6 standard deviations of a Gaussian. A rare bulk far away does not stretch the axis."""
_SHARES = (0.001, 0.15866, 0.5, 0.84134, 0.999)
"""Ends of 99.8 % of the draws, of the central 68.27 %, and the median."""
_KERNEL = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16
"""Binomial: one standard deviation of one bin."""
_NARROW = 1e-6
"""Width over size below which an axis is widened, by a hundredth on either side."""
_ABOVE = 2.5  # deviance over its level up to which a profile is worth drawing
_POINTS = 300


def bin_edges(draws: np.ndarray) -> np.ndarray:
    """Bin edges (bins + 1,) over 99.8 % of the draws at most, never of zero width."""
    low, left, median, right, high = np.quantile(draws, _SHARES)
    low = max(low, median - _FAR * (median - left))
    high = min(high, median + _FAR * (right - median))
    size = max(abs(low), abs(high)) or 1.0
    if high - low < _NARROW * size:
        low, high = low - 0.01 * size, high + 0.01 * size
    return np.linspace(low, high, _BINS + 1)


def _smooth(counts: np.ndarray) -> np.ndarray:
    """Counts convolved with a narrow binomial kernel along every axis."""
    for axis in range(counts.ndim):
        counts = np.apply_along_axis(np.convolve, axis, counts, _KERNEL, "same")
    return counts


def marginal_density(draws: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Smoothed density (bins,) of the draws (m,), which peaks at 1."""
    counts = _smooth(np.histogram(draws, edges)[0].astype(float))
    return counts / max(float(counts.max()), 1e-300)


def joint_density(first: np.ndarray, second: np.ndarray, edges: Sequence[np.ndarray]) -> np.ndarray:
    """Smoothed counts (bins, bins) of two parameters' draws (m,), one pair of edges."""
    return _smooth(np.histogram2d(first, second, edges)[0])


def enclosing(density: np.ndarray, shares: tuple[float, float]) -> tuple[float, float]:
    """Densities whose contours enclose these shares, decreasing shares, increasing."""
    order = np.sort(density.ravel())[::-1]
    share = np.cumsum(order) / order.sum()
    outer, inner = (float(order[np.searchsorted(share, s)]) for s in shares)
    return outer, inner


def near_level(deviance: np.ndarray, level: float) -> np.ndarray:
    """Which points (m,) of a profile are drawn: those up to a margin above a level."""
    near = np.flatnonzero(deviance <= _ABOVE * level)
    rows = np.zeros(len(deviance), bool)
    rows[max(near[0] - 1, 0) : near[-1] + 2] = True
    return rows & np.isfinite(deviance)


def dense_profile(
    value: np.ndarray, deviance: np.ndarray, best: float, logarithmic: bool
) -> tuple[np.ndarray, np.ndarray]:
    """A profile on a dense grid, interpolated by its signed root (linear if quadratic)."""
    value, first = np.unique(value, return_index=True)
    root = np.sign(value - best) * np.sqrt(np.maximum(deviance[first], 0.0))
    space = np.geomspace if logarithmic else np.linspace
    grid = np.clip(space(value[0], value[-1], _POINTS), value[0], value[-1])
    return grid, np.interp(grid, value, root) ** 2
