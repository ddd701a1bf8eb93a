"""Noise scale of the forces and the effective number of samples."""

import numpy as np
from scipy.special import chdtrc

__all__ = [
    "MAD",
    "autocorrelation",
    "autocorrelation_time",
    "effective_inflation",
    "robust_scale",
]


MAD = 1.4826
"""Standard deviation of a normal law over its median absolute deviation."""

_LEAST_RUNS = 4
"""With fewer runs their scatter says nothing."""


def autocorrelation(residuals: list[np.ndarray]) -> np.ndarray:
    """Autocorrelation at lags 0, 1, ..., runs pooled: (rows of the longest run,).

    Args:
        residuals: one array (n_run,) per run, in order; where all are zero the
            correlation is that of lag zero alone, (1,).
    """
    total = sum(float(part @ part) for part in residuals)
    if total <= 0:
        return np.ones(1)
    correlation = np.zeros(max(len(part) for part in residuals))
    for part in residuals:
        size = 2 ** int(np.ceil(np.log2(2 * len(part))))
        spectrum = np.abs(np.fft.rfft(part, size)) ** 2
        correlation[: len(part)] += np.fft.irfft(spectrum, size)[: len(part)]
    return correlation / total


def autocorrelation_time(residuals: list[np.ndarray]) -> float:
    """Integrated autocorrelation time of residuals in time order, at least 1.

    Sum of the autocorrelation over lags by Geyer's initial positive sequence, runs
    pooled. Where the lag-one autocorrelation is not significant at 0.1 % the residuals
    count as independent.

    Args:
        residuals: one array (n_run,) per run, in the order they were measured.
    """
    parts = [part - 0.0 for part in residuals if len(part) > 2]
    count = sum(len(part) for part in parts)
    correlation = autocorrelation(parts)
    longest = len(correlation)
    if longest < 2:
        return 1.0
    if correlation[1] < 3.3 / np.sqrt(count):
        return 1.0
    time = 1.0
    for lag in range(1, longest - 1, 2):
        pair = correlation[lag] + correlation[lag + 1]
        if pair <= 0:
            # The first lag of a pair that ends below zero may still be positive.
            time += 2 * max(correlation[lag], 0.0)
            break
        time += 2 * pair
    return float(min(max(time, 1.0), count / 4))


def effective_inflation(scores, run, time) -> float:
    """Rows per independent row: how much more the estimates vary than if rows were
    independent.

    The largest autocorrelation time of the rows' contributions to the gradient, over
    orthonormal directions of the parameters. The residuals alone would mislead: a
    constant bias has an endless autocorrelation but cancels in the gradient of a
    parameter whose sensitivity changes sign.

    Args:
        scores: contribution of every row to the gradient, shape (n, p).
        run: run of each row, shape (n,).
        time: time of each row (n,), or None to take the order of the file.
    """
    # A parameter that no row informs about has no direction of its own.
    left, size, _ = np.linalg.svd(scores, full_matrices=False)
    known = size > 1e-8 * max(size.max(), 1e-300)
    # The parameters' own directions too: those of equal size are arbitrary in the SVD.
    directions = np.concatenate([left[:, known], scores], axis=1)
    order = np.arange(len(run)) if time is None else np.lexsort((time, run))
    parts = [order[run[order] == code] for code in np.unique(run)]
    return max(
        (_inflation([column[part] for part in parts]) for column in directions.T),
        default=1.0,
    )


def _inflation(parts: list[np.ndarray]) -> float:
    """Autocorrelation time within the runs, raised where the runs disagree by more.

    Runs measured on other days or floors differ as wholes, which no autocorrelation
    within a run can show. Their sums then scatter more than chi-squared allows (0.1 %).
    """
    time = autocorrelation_time(parts)
    freedom = len(parts) - 1
    if freedom < _LEAST_RUNS - 1:
        return time
    scatter = sum(float(part.sum()) ** 2 for part in parts)
    scatter /= time * sum(float(part @ part) for part in parts) / len(parts)
    return time * scatter / freedom if chdtrc(freedom, scatter) < 1e-3 else time


def robust_scale(residual) -> float:
    """Standard deviation from the median absolute deviation, shape (n,) -> scalar."""
    return float(MAD * np.median(np.abs(residual - np.median(residual))))
