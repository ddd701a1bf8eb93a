"""Standardised residuals of a fit: their means over an input, and their order."""

from typing import NamedTuple

import numpy as np

from tirefit.data.rig.levels import cells, levels
from tirefit.fitting.problem.likelihood import row_moments
from tirefit.fitting.result import FitResult

_BINS = 12
"""Largest number of settings with a mean each; more are grouped into bins of equal size."""
_FEWEST = 3  # fewest rows of a bin whose scatter gives an error of its mean
_HALF_95 = 1.96  # half of a 95 % interval of a normal distribution, in standard errors
_LAGS = 40  # largest lag, but at most a quarter of the longest run


class Means(NamedTuple):
    """Means over bins, (k,) each."""

    center: np.ndarray  # of the input
    mean: np.ndarray  # of the residuals
    half: np.ndarray  # half-width of the mean's 95 % interval


def standardised(result: FitResult, channel: str) -> np.ndarray:
    """(observed - fitted) / standard deviation of a measurement, (n,)."""
    problem = result.problem
    mean, variance = row_moments(problem, result.z)
    observed = problem.used(problem.rows.observed[channel])
    return (observed - mean[channel]) / np.sqrt(variance[channel])


def means_over(x: np.ndarray, residual: np.ndarray, inflation: float) -> Means:
    """Means at the settings of an input, or over bins of it, of at least three rows.

    Args:
        x: (n,) input.
        residual: (n,) standardised.
        inflation: rows per independent row.
    """
    settings = levels(x)
    if settings.few(_BINS):
        codes = settings.code
    else:
        edges = np.unique(np.quantile(x, np.linspace(0, 1, _BINS + 1)[1:-1]))
        codes = np.searchsorted(edges, x)
    means = means_by(codes, x, residual, inflation)
    kept = np.bincount(codes) >= _FEWEST
    return Means(*(part[kept] for part in means))


def means_by(codes: np.ndarray, x: np.ndarray, residual: np.ndarray, inflation: float) -> Means:
    """Means of each group of rows; ``codes`` (n,) number the groups from 0."""
    size = int(np.max(codes)) + 1
    count, mean, std = cells(codes, size, residual)
    half = _HALF_95 * std * np.sqrt(inflation / np.maximum(count, 1))
    return Means(cells(codes, size, x)[1], mean, half)
