"""95 % intervals of a fit by trajectory from its likelihood: profile and importance.

Both evaluate the likelihood away from the optimum; the start states are profiled out by
a linear step with the derivatives at the optimum. The likelihood ignores the correlation
of residuals of neighbouring samples, so each interval is widened by the ratio of the
standard error of the sandwich to that of the likelihood.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from tirefit.fitting.importance import LARGEST_K_HAT, smoothed
from tirefit.results import UsageError
from tirefit.vehicle.shooting import Data, eliminate, eliminated

INTERVALS = ("covariance", "profile", "importance")
NORMAL_95 = 1.96
_ROUNDS, _STEPS = 4, 3
"""Secant steps to the end of a profile, and steps of the other parameters at each."""
_DRAWS, _FREEDOM = 1000, 5.0
"""Number of points of the proposal, a Student's t, and its degrees of freedom."""


class Optimum(NamedTuple):
    """The optimum of a fit: the function of the residuals of a window, parameters (p,),
    start states (w, s), residuals with their derivatives, noise (c,), precision (p,) of
    the priors, and the windows."""

    missed: Callable
    z: jax.Array
    starts: jax.Array
    now: tuple
    noise: jax.Array
    pull: jax.Array
    data: Data


def ends_by(how: str, optimum: Optimum, std: np.ndarray, reach: float, seed: int):
    """Ends (2, p) of the 95 % intervals.

    Args:
        how: of :data:`INTERVALS`.
        std: standard errors (p,) of the sandwich.
        reach: half width of a 95 % interval in standard errors.
        seed: of the draws.

    Raises:
        UsageError: the draws do not cover the posterior.
    """
    z = np.asarray(optimum.z)
    if how == "covariance":
        return z + reach * np.outer((-1, 1), std)
    cost, information = _likelihood(optimum)
    inverse = np.linalg.inv(information)
    own = np.sqrt(np.diag(inverse))
    if how == "profile":
        ends = _profiled(cost, z, information, inverse)
    else:
        ends = _weighted(cost, z, inverse, seed)
    return z + ends * reach / NORMAL_95 * std / own


def _likelihood(at: Optimum):
    """The squares and half their gradient at z, without the start states, and the
    information (p, p) at the optimum."""
    _, by_z, by_start = at.now
    _, information, _, tied = eliminate(*at.now, at.noise)
    missed = jax.vmap(at.missed, (None, 0, 0))

    @jax.jit
    def cost(z):
        found = missed(z, at.starts + tied @ (z - at.z), at.data)
        score, _, step, _ = eliminated(found, by_z, by_start, at.noise)
        rest = found + jnp.einsum("wkcs,ws->wkc", by_start, step)
        squares = jnp.sum((rest / at.noise[None, None]) ** 2)
        return squares + at.pull @ z**2, score.sum(axis=0) + at.pull * z

    return cost, np.asarray(information.sum(axis=0)) + np.diag(at.pull)


def _profiled(cost, z, information, inverse) -> np.ndarray:
    """Ends (2, p), relative to z, where the log profile has fallen by half of 1.96^2."""
    ends, least = np.zeros((2, len(z))), float(cost(z)[0])
    for k in range(len(z)):
        others = np.arange(len(z)) != k
        within = np.linalg.inv(information[np.ix_(others, others)])
        for side, sign in enumerate((-1, 1)):
            far = sign * NORMAL_95 * np.sqrt(inverse[k, k])
            for _ in range(_ROUNDS):
                there = z + far * inverse[k] / inverse[k, k]
                for _ in range(_STEPS):
                    there[others] -= within @ np.asarray(cost(there)[1])[others]
                gained = float(cost(there)[0]) - least
                if not np.isfinite(gained):
                    far /= 2
                    continue
                far *= np.clip(NORMAL_95 / np.sqrt(max(gained, 1e-9)), 0.5, 2.0)
            ends[side, k] = far
    return ends


def _weighted(cost, z, inverse, seed: int) -> np.ndarray:
    """Central 95 % (2, p) of weighted draws around z."""
    generator, root = np.random.default_rng(seed), np.linalg.cholesky(inverse)
    u = generator.standard_normal((_DRAWS, len(z)))
    u /= np.sqrt(generator.chisquare(_FREEDOM, (_DRAWS, 1)) / _FREEDOM)
    draws = u @ root.T
    squares = np.array([float(cost(z + one)[0]) for one in draws])
    proposal = -(_FREEDOM + len(z)) / 2 * np.log1p(np.sum(u**2, axis=1) / _FREEDOM)
    log_weights = np.where(np.isfinite(squares), -squares / 2, -np.inf) - proposal
    weights, k_hat = smoothed(log_weights)
    if k_hat > LARGEST_K_HAT:
        reason = f"importance sampling does not cover the posterior: k-hat {k_hat:.2f}"
        raise UsageError(reason, "use --intervals profile")
    order = np.argsort(draws, axis=0)
    sums = np.cumsum(weights[order], axis=0)
    return np.array(
        [
            [np.interp(share, sums[:, k], draws[order[:, k], k]) for k in range(len(z))]
            for share in (0.025, 0.975)
        ]
    )
