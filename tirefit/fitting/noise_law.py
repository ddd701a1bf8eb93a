"""The noise law of a force: a constant, a share of load and a share of force."""

from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls

_CLEAR = 10.8  # chi-square of one degree of freedom at the level of 0.1 %

_ROUNDS, _SETTLED = 50, 1e-4
"""Limit of regressions, and the change of a share of the variance that ends them."""


class NoiseLaw(NamedTuple):
    """Variance of one value: constant^2 + (share F_z)^2 + (of_force F)^2.

    ``constant`` [N, N m] is the noise of the sensor, ``share`` [-, m] the part
    proportional to load, and ``of_force`` [-] the part proportional to force, such as
    friction that varies between sweeps.
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


def noise_law(residual, fz, force, known=0.0, each=1.0) -> NoiseLaw:
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
    deviances = [_deviance(residual, terms @ x + known, each) for x in (plain, shares)]
    is_clear = deviances[0] - deviances[1] > _CLEAR
    return NoiseLaw(*np.sqrt(shares if is_clear else plain).tolist())


def _deviance(residual, variance, each) -> float:
    variance = np.maximum(variance, 1e-300)
    return float(np.sum((np.log(variance) + residual**2 / variance) / each))


def law_shares(residual, terms, known=0.0) -> np.ndarray:
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
        # Terms may be the same, as those of one load are.
        ridge = 1e-9 * np.trace(normal) * np.eye(len(normal))
        upper = np.linalg.cholesky(normal + ridge).T
        aim = np.linalg.solve(upper.T, weighted.T @ (wanted / variance))
        shares, last = nnls(upper, aim)[0], shares
        if np.max(np.abs(shares - last)) < _SETTLED:
            break
    return shares * scale / size
