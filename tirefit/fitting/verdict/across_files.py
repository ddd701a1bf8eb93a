"""Statistics of one quantity over many files: median, scatter, drift, outlying files.

The value y_i of a file has the standard deviation s_i; in addition, files scatter by
tau. The line over time is fitted with Huber's weights; tau is such that half of the
files are within 0.6745 sqrt(s_i^2 + tau^2). A few outlying files change neither.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.special import ndtri, stdtrit

from tirefit.fitting.problem.noise import HUBER

_MEDIAN = float(ndtri(0.75))

_ERROR = 0.01
"""False alarm probability of an outlier among all files, and of a drift."""

_ROUNDS = 30

_LEAST_SCALE = 1e-12
"""Smallest scale of a file over the largest one; a smaller one does not improve a slope."""


class AcrossFiles(NamedTuple):
    """One quantity over many files."""

    middle: float  # at the mean time
    scatter: float  # of the files beyond their own standard deviations
    change: float  # from the first to the last time
    change_std: float  # standard deviation
    drifts: bool
    pulls: np.ndarray  # (n,) distances from the line in standard deviations
    outlier: np.ndarray  # (n,)


def across_files(value: ArrayLike, std: ArrayLike, when: ArrayLike) -> AcrossFiles:
    """Middle, scatter, drift and outliers of a quantity.

    Args:
        value: (n,) finite, n at least 1.
        std: (n,) standard deviation of each file, not negative.
        when: (n,) time or number of the files, any unit.
    """
    value, std, when = (np.asarray(column, float) for column in (value, std, when))
    span = float(np.ptp(when))
    x = (when - when.mean()) / span if span else np.zeros_like(when)
    is_line = len(value) > 3 and span > 0
    design = np.column_stack([np.ones_like(x), x] if is_line else [np.ones_like(x)])
    # The fitted line removes part of the scatter: correct for its degrees of freedom.
    widened = np.sqrt(len(value) / max(len(value) - design.shape[1], 1))
    at = np.array([np.median(value), 0.0])[: design.shape[1]]
    least = 1e-12 * float(np.max(np.abs(value))) + 1e-300  # of a scale, without scatter
    for _ in range(_ROUNDS):
        residual = value - design @ at
        scatter = _scatter(residual * widened, std)
        scale = np.hypot(std, scatter) + least
        root = np.sqrt(np.minimum(1.0, HUBER / np.abs(residual / scale).clip(1e-9)))
        left = design * (root / scale)[:, None]
        before, at = at, np.linalg.lstsq(left, value * root / scale, rcond=None)[0]
        if np.all(np.abs(at - before) <= 1e-4 * np.median(scale)):
            break
    residual = value - design @ at
    pulls = residual / scale
    change = float(at[1]) if is_line else 0.0
    change_std = _std(design, pulls, scale) if is_line else 0.0
    freedom = max(len(value) - 2, 1)
    limit = -stdtrit(freedom, _ERROR / 2)
    return AcrossFiles(
        float(at[0]),
        scatter,
        change,
        change_std,
        bool(abs(change) > limit * change_std > 0),
        pulls,
        np.abs(pulls) > -stdtrit(freedom, _ERROR / (2 * len(value))),
    )


def _scatter(residual: np.ndarray, std: np.ndarray) -> float:
    """tau at which the median of |r_i| / sqrt(s_i^2 + tau^2) is that of a Gaussian."""
    size = np.abs(residual)
    most = float(np.max(size)) / _MEDIAN

    def excess(tau: float) -> float:
        return float(np.median(size - _MEDIAN * np.hypot(std, tau)))

    return float(brentq(excess, 0.0, most, xtol=1e-6 * most)) if excess(0.0) > 0 else 0.0


def _std(design: np.ndarray, pulls: np.ndarray, scale: np.ndarray) -> float:
    """Standard error of the slope: Huber's second moment with his small-sample
    correction (Robust Statistics, 1981, eq. 7.6.2)."""
    n, p = design.shape
    psi = np.clip(pulls, -HUBER, HUBER)
    share = max(float(np.mean(np.abs(pulls) < HUBER)), 0.5)
    correction = 1 + p / n * (1 - share) / share
    variance = correction**2 * float(psi @ psi) / (n - p) / share**2
    # Files that agree exactly have no scatter.
    rows = design / np.maximum(scale, _LEAST_SCALE * np.max(scale))[:, None]
    return float(np.sqrt(variance * np.linalg.pinv(rows.T @ rows)[1, 1]))
