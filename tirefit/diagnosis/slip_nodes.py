"""The slips that a noisy one may stand for, by the density of the slips of the file."""

import numpy as np

from tirefit.diagnosis.negligible import FLAT
from tirefit.fitting.slip_noise import slip_distribution

__all__ = ["slip_nodes"]

_COUNTS = (3, 5)
"""Gauss-Hermite nodes of the slip noise: exact for a force that is a polynomial of
degree 5 or 9 within it."""
_STEEP, _LARGE = 0.01, 0.9
"""Noise of the slip over a large slip from which the force bends within it, and the
quantile of the slips that is large."""
_NODES = {count: np.polynomial.hermite_e.hermegauss(count) for count in _COUNTS}


def slip_nodes(slip, std):
    """Latent slips (n, k) and their probabilities (n, k).

    Args:
        slip: (n,) measured values.
        std: (n,) their noise; without any a row has one slip, its own.
    """
    if not np.any(std > 0):
        return slip[:, None], np.ones((len(slip), 1))
    # Enough nodes for the curvature of the force within the slip noise.
    steep = float(np.median(std)) / max(float(np.quantile(np.abs(slip), _LARGE)), FLAT)
    offset, mass = _NODES[_COUNTS[0] if steep < _STEEP else _COUNTS[1]]
    mean, spread = slip_distribution(slip, np.maximum(std, FLAT)).moments(slip, std)
    nodes = mean[:, None] + spread[:, None] * offset
    return nodes, np.tile(mass / mass.sum(), (len(slip), 1))
