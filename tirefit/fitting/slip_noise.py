"""The distribution of the true slips of a file, from slips measured with noise.

Maximum likelihood by expectation maximisation of a piecewise linear density, the
empirical-Bayes prior of each row's latent slip.
A flat prior instead biases the friction where slips crowd (S §5.1 noise: by 0.6
standard deviations; with the estimated distribution by less than 0.1).
"""

import numpy as np

__all__ = ["latent_nodes", "slip_density"]

_REACH = 4.0
"""Nodes span this many slip standard deviations on both sides of the measured slip."""


def slip_density(slip, std, hats: int = 20, iterations: int = 200):
    """Density of the true slips.

    Args:
        slip: measured slips, shape (n,).
        std: their standard deviations, shape (n,).
        hats: number of triangular functions the density is made of, fewer where their
            spacing would fall below the slip noise: what is finer cannot be seen, and
            a rougher density would only draw rows to where other rows happen to lie.
        iterations: steps of expectation maximisation.

    Returns:
        (grid, density): knots of a piecewise linear density, shape (hats + 2,), which
        is zero at the first and last and integrates to one.
    """
    # Some thousands of slips give the distribution as well as all of them.
    every = max(len(slip) // 4000, 1)
    slip, std = slip[::every], std[::every]
    width = max(float(np.ptp(slip)), float(np.median(std)))
    count = int(np.clip(width / max(float(np.median(std)), 1e-300), 3, hats))
    spacing = width / (count - 1)
    knots = slip.min() + spacing * np.arange(-1, count + 1)
    hat = _hat_likelihood(slip, std, knots, spacing)
    weight = np.full(count, 1 / count)
    for _ in range(iterations):
        share = hat * weight
        share /= np.maximum(share.sum(1, keepdims=True), 1e-300)
        weight = share.mean(0)
    return knots, np.concatenate([[0.0], weight / spacing, [0.0]])


def _hat_likelihood(slip, std, knots, spacing):
    """Likelihood of each slip under each hat of unit area, (n, hats), by quadrature."""
    offset, mass = np.polynomial.hermite_e.hermegauss(15)
    true = slip[:, None] + std[:, None] * offset
    hat = 1 - np.abs(true[..., None] - knots[1:-1]) / spacing
    return np.einsum("q,nqk->nk", mass / mass.sum(), np.maximum(hat, 0)) / spacing


def latent_nodes(slip, std, density, steepness):
    """Trapezoid nodes of the latent slip and the log of their weights.

    Args:
        slip: measured slips, shape (n,).
        std: their standard deviations, shape (n,).
        density: what :func:`slip_density` gives for them.
        steepness: the largest of (slope of the force x slip std / force std): sets the
            number of nodes so that their spacing stays below the width of the product.

    Returns:
        (slips, log weights): arrays of shape (n, nodes).
    """
    grid, density = density
    count = int(np.clip(np.ceil(2 * _REACH * np.hypot(1, steepness)), 9, 400)) + 1
    offset = np.linspace(-_REACH, _REACH, count)
    nodes = slip[:, None] + std[:, None] * offset
    prior = np.interp(nodes, grid, density, left=0.0, right=0.0)
    # A floor far below one row's share: no latent slip is impossible, only unlikely.
    log_weight = np.log(prior + 1e-9 * density.max()) - 0.5 * offset**2
    return nodes, log_weight
