"""Importance sampling of the posterior: points around the optimum, weighted.

Nine in ten points come from a multivariate Student's t in the whitened space, where a
well-identified posterior is nearly a unit Gaussian, and one in ten from anywhere within the bounds.
They are weighted by posterior over proposal; the largest weights are smoothed by a generalized
Pareto distribution, whose shape k-hat says whether the proposal covers the posterior at all (PSIS:
Vehtari, Simpson, Gelman, Yao and Gabry, Journal of Machine Learning Research 25(72), 2024). One
evaluation of the posterior per point, no chain, and nothing to tune.

Without that tenth a bulk far from the optimum is missed: k-hat was 0.46 for a brush on
``fits/cmu_wheel`` (smooth wheel, straight): its stiffness is 4 to 16 N around the best
fit and above 1e6 N by the volume of its prior. With it, k-hat is 2.9.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.special import gammaln

from tirefit.params import Values

Density = Callable[[Values], Values]
"""Log density (n,) of points (n, p)."""

LARGEST_K_HAT = 0.7
"""Above this, weighted means do not converge at any practical size (Vehtari et al.)."""

_DEGREES_OF_FREEDOM = 5.0
_WIDE = 0.1  # share of the points from anywhere within the bounds
_BLOCK = 256
_FEWEST, _SURE = 4096, 0.4
"""Points by which k-hat is judged unless it is below the second number: of 1280 points it
scatters by 0.1."""
_LEAST_SHARE = 0.02
"""Effective samples per point below which an ensemble is as cheap, and safer."""


class Weighted(NamedTuple):
    """Result of the weighting."""

    draws: np.ndarray  # (m, p) in the whitened space, worth m independent ones
    k_hat: float
    points: int  # evaluated
    refused: str  # why the draws must not be used, "" if they may
    interrupted: bool  # by the user, with fewer draws than requested


def _pareto_fit(tail: np.ndarray) -> tuple[float, float]:
    """Shape k and scale of a generalized Pareto distribution, tail (m,) ascending.

    The empirical Bayes estimate of Zhang and Stephens (Technometrics 51, 2009), with
    the shape pulled towards 0.5 with the weight of ten observations (Vehtari et al., G).
    """
    count = len(tail)
    grid = 30 + int(np.sqrt(count))
    theta = 1 - np.sqrt(grid / (np.arange(1, grid + 1) - 0.5))
    theta = theta / (3 * tail[int(count / 4 + 0.5) - 1]) + 1 / tail[-1]
    shapes = np.mean(np.log1p(-theta[:, None] * tail), axis=1)
    likelihood = count * (np.log(-theta / shapes) - shapes - 1)
    weight = np.exp(likelihood - likelihood.max())
    best = float(np.sum(theta * weight) / np.sum(weight))
    shape = float(np.mean(np.log1p(-best * tail)))
    return (count * shape + 10 * 0.5) / (count + 10), -shape / best


def smoothed(log_weights: np.ndarray) -> tuple[np.ndarray, float]:
    """Pareto-smoothed weights (n,) that sum to one, and k-hat.

    The largest min(n / 5, 3 sqrt(n)) weights are replaced by expected order statistics
    of the Pareto distribution fitted to them, never above the largest raw one. k-hat is
    infinite where too few weights are left to fit.
    """
    count = len(log_weights)
    top = np.max(log_weights)
    if not np.isfinite(top):
        return np.full(count, 1 / count), np.inf
    weights = np.exp(log_weights - top)
    order = np.argsort(weights, kind="stable")
    length = int(np.ceil(min(count / 5, 3 * np.sqrt(count))))
    tail, cut = order[-length:], weights[order[-length - 1]]
    tail = tail[weights[tail] > max(cut, np.finfo(float).tiny)]
    if len(tail) <= 4:
        return weights / weights.sum(), np.inf
    shape, scale = _pareto_fit(weights[tail] - cut)
    rank = -np.log1p(-(np.arange(len(tail)) + 0.5) / len(tail))
    small = abs(shape) < np.finfo(float).eps
    excess = scale * (rank if small else np.expm1(shape * rank) / shape)
    weights[tail] = np.minimum(cut + excess, 1.0)
    return weights / weights.sum(), shape


def _resampled(weights: np.ndarray, count: int, generator: np.random.Generator) -> np.ndarray:
    """Indices (count,) of systematic resampling (Kitagawa 1996), in random order.

    Point i is drawn floor or ceil of count w_i times: where no weight exceeds
    1 / count no point is drawn twice, and with count = 1 / sum w^2 a mean over the
    draws varies as much as one over ``count`` independent draws of the posterior.
    """
    shuffled = generator.permutation(len(weights))
    places = (np.arange(count) + generator.uniform()) / count
    ends = np.cumsum(weights[shuffled])
    chosen = shuffled[np.searchsorted(ends / ends[-1], places, side="right")]
    return generator.permutation(chosen)


def _proposed(
    points: int, center: np.ndarray, root: np.ndarray, generator: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, p) of the mixture and its log density (n,) at them.

    The wide part is logistic in z: evenly within the bounds, or over their logarithms.
    """
    nu, size = _DEGREES_OF_FREEDOM, len(center)
    wide = int(_WIDE * points)
    normal = generator.standard_normal((points - wide, size))
    near = normal / np.sqrt(generator.chisquare(nu, (points - wide, 1)) / nu)
    wide_points = generator.logistic(size=(wide, size)) - center
    u = np.concatenate([near, np.linalg.solve(root, wide_points.T).T])
    peak = gammaln((nu + size) / 2) - gammaln(nu / 2) - size / 2 * np.log(nu * np.pi)
    student = peak - (nu + size) / 2 * np.log1p(np.sum(u**2, axis=1) / nu)
    z = np.abs(center + u @ root.T)
    logistic = np.sum(-z - 2 * np.log1p(np.exp(-z)), axis=1)
    logistic = logistic + np.linalg.slogdet(root)[1]
    share = wide / points
    return u, np.logaddexp(np.log1p(-share) + student, np.log(share) + logistic)


def draw_weighted(
    density: Density,
    center: np.ndarray,
    root: np.ndarray,
    seed: int,
    target: int,
    progress: Callable[[float, str], None] | None = None,
) -> Weighted:
    """At least ``target`` draws of the posterior, each worth an independent one.

    Args:
        density: log posterior density (n,) of points (n, p) of the whitened space, up
            to a constant; -inf where there is none.
        center, root: (p,), (p, p); z = center + root u is unbounded in u.
        seed: the same seed draws the same samples.
        target: draws wanted; refused where they would take 50 times as many points.
        progress: called with (share done, message).
    """
    generator = np.random.default_rng(seed)
    u, log_weights = np.empty((0, len(center))), np.empty(0)
    weights, k_hat, effective = np.empty(0), np.inf, 0.0
    missing, interrupted = 1.25 * target, False
    try:
        while missing > 0:
            blocks = int(np.ceil(missing / _BLOCK))
            more, proposal = _proposed(blocks * _BLOCK, center, root, generator)
            # All blocks are submitted before the first result is awaited.
            parts = [density(block) for block in np.split(more, blocks)]
            added = np.concatenate([np.asarray(part) for part in parts]) - proposal
            u, log_weights = np.concatenate([u, more]), np.append(log_weights, added)
            weights, k_hat = smoothed(log_weights)
            effective = 1 / np.sum(weights**2)
            share = effective / len(u)
            if k_hat > _SURE and len(u) < _FEWEST:
                missing = _FEWEST - len(u)
                continue
            if k_hat > LARGEST_K_HAT or share < _LEAST_SHARE or effective >= target:
                break
            missing = 1.1 * (target - effective) / share
            if progress is not None:
                progress(effective / target, f"{len(u)} points, k-hat {k_hat:.2f}")
    except KeyboardInterrupt:
        interrupted = True
    return Weighted(
        u[_resampled(weights, int(effective), generator)] if len(u) else u,
        float(k_hat),
        len(u),
        _reason(k_hat, effective, len(u)),
        interrupted,
    )


def _reason(k_hat: float, effective: float, points: int) -> str:
    """The reason not to use the draws; empty if they can be used."""
    if points == 0:
        return "no point was evaluated"
    if k_hat > LARGEST_K_HAT:
        return f"k-hat {k_hat:.2f} is above {LARGEST_K_HAT}"
    if effective < _LEAST_SHARE * points:
        return f"{points} points have the weight of only {effective:.0f}"
    return ""
