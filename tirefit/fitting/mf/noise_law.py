"""The noise of a force: a constant, a share of the load and a share of the force."""

from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls

__all__ = ["NoiseLaw", "noise_law", "variance_shares"]

_CLEAR = 10.8
"""Deviance of one degree of freedom at the level of 0.1 %."""

_ROUNDS, _SETTLED = 50, 1e-4
"""Regressions, at most, and the change of a share of the variance that ends them."""


class NoiseLaw(NamedTuple):
    """Variance of one value: constant^2 + (share F_z)^2 + (of_force F)^2.

    ``constant`` [N, N m]: the sensor; ``share`` [-, m]: what grows with the load;
    ``of_force`` [-]: what grows with the force itself, as friction that differs from
    sweep to sweep. A wheel that rolls freely has little of the last one.
    """

    constant: float
    share: float
    of_force: float = 0.0

    def variance(self, fz, force):
        """Variance at loads fz [N] and forces [N, N m], any shape."""
        return self.constant**2 + (self.share * fz) ** 2 + (self.of_force * force) ** 2

    def std(self, fz, force):
        """Standard deviation at loads fz [N] and forces [N, N m], any shape."""
        return np.sqrt(self.variance(fz, force))


def noise_law(residual, fz, force, known=0.0) -> NoiseLaw:
    """The law whose squares the residuals (n,) follow best.

    Args:
        residual: (n,) [N, N m].
        fz, force: load [N] and force of each, (n,).
        known: part of each variance that is known already, (n,).
    """
    terms = np.stack([np.full(len(fz), 1.0), fz**2, force**2], axis=1)
    return NoiseLaw(*np.sqrt(variance_shares(residual, terms, known, 1)).tolist())


def variance_shares(residual, terms, known=0.0, optional: int = 0, each=1.0):
    """Non-negative shares (k,) of the terms (n, k) that squares of residuals follow.

    Args:
        residual: (n,).
        known: part of each variance that is known already, (n,) or a number.
        optional: how many of the last terms are used only where they raise the
            likelihood at the level of 0.1 %; others have the share zero.
        each: how many residuals count as one, (n,) or a number.
    """
    count = terms.shape[1] - optional
    shares = np.zeros(terms.shape[1])
    used = list(range(count))
    shares[used] = _shares(residual, terms[:, used], known)
    deviance = _deviance(residual, terms @ shares + known, each)
    for term in range(count, terms.shape[1]):
        trial = np.zeros(terms.shape[1])
        trial[[*used, term]] = _shares(residual, terms[:, [*used, term]], known)
        gained = deviance - _deviance(residual, terms @ trial + known, each)
        if gained > _CLEAR:
            shares, used, deviance = trial, [*used, term], deviance - gained
    return shares


def _deviance(residual, variance, each) -> float:
    variance = np.maximum(variance, 1e-300)
    return float(np.sum((np.log(variance) + residual**2 / variance) / each))


def _shares(residual, terms, known) -> np.ndarray:
    """Squares are regressed on the terms, each row weighted by its own variance, twice
    the square of which is the variance of a square; until the variance settles."""
    scale = float(np.mean(residual**2)) or 1e-18
    size = np.maximum(np.mean(terms, axis=0), 1e-300)
    scaled, known = terms / size, known / scale
    wanted = residual**2 / scale - known
    shares = np.full(terms.shape[1], 1 / terms.shape[1])
    ridge = 1e-9 * np.eye(terms.shape[1])
    for _ in range(_ROUNDS):
        variance = scaled @ shares + known + 1e-9
        weighted = scaled / variance[:, None]
        # The normal equations: few unknowns, whatever the number of rows.
        upper = np.linalg.cholesky(weighted.T @ weighted + ridge).T
        aim = np.linalg.solve(upper.T, weighted.T @ (wanted / variance))
        shares, last = nnls(upper, aim)[0], shares
        if np.max(np.abs(shares - last)) < _SETTLED:
            break
    return shares * scale / size
