"""Noise of the forces: its scale, its law (a constant, a share of load, a share of force,
and one beyond the measured loads) and the effective number of samples."""

import itertools
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtrc, chdtri

from tirefit.arrays import Numbers

_CLEAR_TERM = 10.8  # chi-square of one degree of freedom at the level of 0.1 %

_ROUNDS, _SETTLED = 50, 1e-4
"""Limit of regressions, and the change of a share of the variance that ends them."""


class NoiseLaw(NamedTuple):
    """Variance of one value: constant^2 + (share F_z)^2 + (of_force F)^2, and beyond the
    loads + beyond^2 x F^2, x of :func:`beyond_loads`: the relative error of the formula is
    a random walk in log F_z. Below the loads, the noise is that of the least load."""

    constant: float  # [N, N m] noise of the sensor
    share: float  # [-, m] proportional to load
    of_force: float = 0.0  # [-] with force, as friction that varies between sweeps
    beyond: float = 0.0  # [-] std of the formula's error at e times the largest load
    loads: tuple[float, float] = (0.0, np.inf)  # [N] (least, largest) measured

    def variance(self, fz: Numbers, force: Numbers) -> np.ndarray:
        """Variance at loads fz [N] and forces [N, N m], any shape."""
        of_force = self.of_force**2 + self.beyond**2 * beyond_loads(fz, self.loads)
        of_load = self.share * np.maximum(fz, self.loads[0])
        return np.asarray(self.constant**2 + of_load**2 + of_force * force**2)

    def std(self, fz: Numbers, force: Numbers) -> np.ndarray:
        """Standard deviation at loads fz [N] and forces [N, N m], any shape."""
        return np.asarray(np.sqrt(self.variance(fz, force)))


def beyond_loads(fz: Numbers, loads: tuple[float, float]) -> np.ndarray:
    """Logarithm of a load fz [N] (any shape) over the nearest of the (least, largest)
    ``loads``, positive on either side; zero between them."""
    fz = np.maximum(fz, 1e-9)
    return np.asarray(np.log(np.maximum(np.maximum(loads[0] / fz, fz / loads[1]), 1.0)))


def noise_law(
    residual: np.ndarray,
    fz: np.ndarray,
    force: np.ndarray,
    known: np.ndarray | float = 0.0,
    each: np.ndarray | float = 1.0,
) -> NoiseLaw:
    """Fit the law to the squares of residuals.

    The share of force is zero unless it raises the likelihood at the level of 0.1 %.

    Args:
        residual: (n,) [N, N m].
        fz, force: load [N] and force of each, (n,).
        known: known part of each variance, (n,) or a number.
        each: number of residuals per independent residual, (n,) or a number.
    """
    terms = np.stack([np.full(len(fz), 1.0), fz**2, force**2], axis=1)
    plain = np.append(law_shares(residual, terms[:, :2], known), 0.0)
    shares = law_shares(residual, terms, known)
    variances = [np.maximum(terms @ x + known, 1e-300) for x in (plain, shares)]
    deviances = [np.sum((np.log(v) + residual**2 / v) / each) for v in variances]
    is_clear = deviances[0] - deviances[1] > _CLEAR_TERM
    return NoiseLaw(*np.sqrt(shares if is_clear else plain).tolist())


def law_shares(
    residual: np.ndarray, terms: np.ndarray, known: np.ndarray | float = 0.0
) -> np.ndarray:
    """Regress squared residuals on variance terms (n, k): non-negative shares (k,).

    A square of expectation v has the variance 2 v^2, so each row is weighted by 1 / v.
    The regression is repeated until the shares settle.

    Args:
        residual: (n,).
        known: known part of each variance, (n,) or a number.
    """
    scale = float(np.mean(residual**2)) or 1e-18
    size = np.maximum(np.mean(terms, axis=0), 1e-300)
    scaled, known = terms / size, known / scale
    wanted = residual**2 / scale - known
    shares = np.full(terms.shape[1], 1 / terms.shape[1])
    for _ in range(_ROUNDS):
        variance = scaled @ shares + known + 1e-9
        weighted = scaled / variance[:, None]
        # Normal equations, as there are few unknowns and many rows.
        normal = weighted.T @ weighted
        # Terms may be equal, for instance if there is only one load.
        ridge = 1e-9 * np.trace(normal) * np.eye(len(normal))
        aim = weighted.T @ (wanted / variance)
        shares, last = non_negative(normal + ridge, aim), shares
        if np.max(np.abs(shares - last)) < _SETTLED:
            break
    return shares * scale / size


def non_negative(normal: np.ndarray, aim: np.ndarray) -> np.ndarray:
    """The x >= 0 (k,) that minimises x' normal x / 2 - aim' x. All 2^k sets of non-zero entries are
    tried: for four entries this is faster than importing ``scipy.optimize``."""
    best, least = np.zeros(len(aim)), 0.0
    for free in itertools.product((False, True), repeat=len(aim)):
        at = np.flatnonzero(free)
        x = np.linalg.solve(normal[np.ix_(at, at)], aim[at])
        if np.all(x >= 0) and -aim[at] @ x < least:
            best, least = np.zeros(len(aim)), float(-aim[at] @ x)
            best[at] = x
    return best


MAD = 1.4826  # standard deviation of a normal law over its median absolute deviation
HUBER = 1.345
"""Standard deviations up to which Huber's loss is the square; it is linear beyond (95 %
efficiency at normal noise; Huber 1964)."""

CHANCE = 5e-5  # level of significance of a difference in noise, and of a trend in residuals

_CLEAR = 3.1
"""Standard errors by which a design effect must exceed one (0.1 %, one-sided)."""

_ALONE = 0.9
"""Leverage of one setting in a direction above which its residuals there are ignored:
no other setting can contradict them."""

_LEAST_RUNS = 4  # smallest number of runs whose scatter is tested


def autocorrelation(residuals: list[np.ndarray]) -> np.ndarray:
    """Autocorrelation at lags 0, 1, ..., runs pooled: (rows of the longest run,).

    Args:
        residuals: one array (n_run,) per run, in order; if all are zero only lag zero is
            returned, (1,).
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
    pooled; 1 where the lag-one autocorrelation is not significant at 0.1 %.

    Args:
        residuals: one array (n_run,) per run, in the order they were measured.
    """
    parts = [part - 0.0 for part in residuals if len(part) > 2]
    count = sum(len(part) for part in parts)
    correlation = autocorrelation(parts)
    longest = len(correlation)
    if longest < 2 or correlation[1] < 3.3 / np.sqrt(count):
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


def effective_inflation(scores: np.ndarray, run: np.ndarray, time: np.ndarray | None) -> float:
    """Rows per independent row: by how much autocorrelation raises the variance.

    The largest autocorrelation time of the rows' contributions to the gradient, over
    orthonormal directions of the parameters. The residuals alone are not enough: a
    constant bias has an infinite autocorrelation time but cancels in the gradient of a
    parameter whose sensitivity changes sign.

    Args:
        scores: contribution of every row to the gradient, shape (n, p).
        run: run of each row, shape (n,).
        time: time of each row (n,), or None to take the order of the file.
    """
    # A parameter without information has no direction.
    left, size, _ = np.linalg.svd(scores, full_matrices=False)
    known = size > 1e-8 * max(size.max(), 1e-300)
    # Also the directions of the parameters: the SVD is arbitrary for equal singular values.
    directions = np.concatenate([left[:, known], scores[:, np.any(scores, axis=0)]], axis=1)
    order = np.arange(len(run)) if time is None else np.lexsort((time, run))
    parts = [order[run[order] == code] for code in np.unique(run)]
    freedom, largest = len(parts) - 1, 1.0
    for column in directions.T:
        within = [column[part] for part in parts]
        inflation = autocorrelation_time(within)
        if freedom >= _LEAST_RUNS - 1:
            # Runs measured on different days or floors differ as a whole, which the
            # autocorrelation within a run does not show: their sums then scatter more than
            # chi-squared allows (0.1 %).
            square = inflation * sum(float(run @ run) for run in within) / len(within)
            scatter = sum(float(run.sum()) ** 2 for run in within) / square
            if chdtrc(freedom, scatter) < 1e-3:
                inflation *= scatter / freedom
        largest = max(largest, inflation)
    return largest


def design_effect(residual: np.ndarray, slopes: np.ndarray, setting: np.ndarray) -> float:
    """Variance of the gradient of the deviance over that of independent residuals.

    It is the mean over the directions of the coefficients; settings are independent.
    It is one unless it exceeds one by 3.1 of its standard errors (0.1 %). The residuals
    of each setting are corrected for the fit (CR2 of Bell and McCaffrey (2002)).

    Args:
        residual: (n,) over their noise.
        slopes: (n, p), derivatives of the residuals in coefficients with unit priors.
        setting: (n,) number of the setting of each residual.
    """
    size = slopes.shape[1]
    values, axes = np.linalg.eigh(slopes.T @ slopes + np.eye(size))
    # The priors contribute one; rounding may give less.
    whitened = slopes @ (axes / np.sqrt(np.maximum(values, 1.0)))
    observed, expected, squares = 0.0, 0.0, 0.0
    for code in np.unique(setting):
        part = whitened[setting == code]
        eigenvalues, directions = np.linalg.eigh(part.T @ part)
        score = directions.T @ (part.T @ residual[setting == code])
        share = np.minimum(eigenvalues, 1.0)
        judged = share < _ALONE
        observed += float(np.sum(score[judged] ** 2 / (1 - share[judged])))
        expected += float(np.sum(share[judged]))
        squares += float(np.sum(share[judged] ** 2))
    is_clear = observed - expected > _CLEAR * np.sqrt(2 * squares)
    return observed / expected if is_clear else 1.0


def noise_by_row(
    residual: np.ndarray, fz: np.ndarray, force: np.ndarray, run: np.ndarray, names: Sequence[str]
) -> dict[str, Any]:
    """The record of a noise that varies among rows; empty if it is not significant.

    Its variance is that of :class:`NoiseLaw`. ``by_run`` holds a further factor of the
    standard deviation for each run, if the runs differ.

    Args:
        residual, fz, force: (n,) observed - fitted, load, fitted force [N].
        run: (n,) index in ``names`` of the run of each row.
    """
    terms = np.stack([np.full(len(fz), 1.0), fz**2, force**2], axis=1)
    shares = law_shares(residual, terms)
    size = np.mean(residual**2)
    squares = residual**2 / size
    variance = np.maximum(terms @ shares / size, 1e-6)
    gain = np.sum(squares - np.log(variance) - squares / variance)
    parts = [(squares / variance)[run == code] for code in np.unique(run)]
    rows_per_one = autocorrelation_time([part / part.mean() - 1 for part in parts])
    law: dict[str, Any] = {}
    if gain > rows_per_one * chdtri(2, CHANCE):
        keys = "constant", "share_of_load", "share_of_force"
        law = dict(zip(keys, np.sqrt(shares).tolist(), strict=True))
        squares = squares / variance
    count = np.bincount(run, minlength=len(names))
    by_run = np.bincount(run, squares, len(names)) / np.maximum(count, 1)
    by_run = np.where(count > 0, np.maximum(by_run, 1e-6), 1.0)
    apart = np.sum(count * (by_run - 1 - np.log(by_run)))
    if apart > rows_per_one * chdtri(len(names) - 1, CHANCE) > 0:
        law["by_run"] = dict(zip(names, np.sqrt(by_run).tolist(), strict=True))
    return law


def noise_std(
    record: Mapping[str, Any],
    fz: np.ndarray,
    force: np.ndarray,
    runs: Iterable[str] | None = None,
    reference: float | None = None,
) -> np.ndarray:
    """Standard deviation (n,) of one measurement, from the noise record of a fit.

    Args:
        fz, force: (n,) load and fitted force.
        runs: (n,) names of the runs, if the rows have runs.
        reference: load [N] of ``median_std``, for noise proportional to the load.
    """
    std = np.broadcast_to(float(record["median_std"]), np.shape(fz))
    if "share_of_load" in record:
        shares = record["share_of_load"], record.get("share_of_force", 0.0)
        loads = tuple(record.get("loads", (0.0, np.inf)))
        law = NoiseLaw(record["constant"], *shares, record.get("share_beyond", 0.0), loads)
        std = law.std(fz, force)
    elif record.get("proportional_to_load"):
        std = std * fz / reference
    factors = record.get("by_run", {})
    if runs is not None and factors:
        std = std * np.array([factors.get(name, 1.0) for name in runs])
    return std
