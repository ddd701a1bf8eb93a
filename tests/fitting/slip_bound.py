"""Smallest scatter that any estimate can have if slips are measured with noise.

The Cramer-Rao bounds of 400 rows with and without a known density of the true slips. Without
it, the information on the parameters is what remains of their scores (slopes of the log
likelihood of a row) after projection on the scores of the density (Bickel, Klaassen, Ritov and
Wellner, Efficient and Adaptive Estimation for Semiparametric Models, 1993): of the mass in
each narrow cell, or, for set points, of their places and shares. Run as a script:

    python tests/fitting/slip_bound.py
"""

import numpy as np
from recipes import brush_force

CPA2, MU, FZ = 3e4, 0.95, 4000.0
TURNED, ROWS = 0.15, 400  # largest slip angle
CELLS = 901
PARTS = 4000  # cells of the measured values that are in memory at once


def force_of(slip, cpa2=CPA2, mu=MU):
    return brush_force(slip, cpa2, mu, fz=FZ)


def true_slips(shape: str):
    """(slips, probability of each) of a uniform slip, a sine, or ten set points."""
    if shape == "steps":
        return np.linspace(-TURNED, TURNED, 10), np.full(10, 0.1)
    edges = np.linspace(-TURNED, TURNED, CELLS + 1)
    share = np.diff(edges / 2 if shape == "uniform" else np.arcsin(edges / TURNED) / np.pi)
    return (edges[1:] + edges[:-1]) / 2, share / share.sum()


def smallest_scatter(shape: str, fy_std: float, alpha_std: float):
    """Standard deviations (2,) of cpa2 and mu if the density is known, and if it is not."""
    slip, share = true_slips(shape)
    alpha = np.arange(-TURNED - 5 * alpha_std, TURNED + 5 * alpha_std, alpha_std / 2)
    most = force_of(np.array([TURNED]))[0] + 5.5 * fy_std
    fy = np.arange(-most, most, fy_std / 1.4)

    def of(slips):
        """Probability of each measured slip and force for each true slip."""
        off = (alpha[:, None] - np.arctan(slips)) / alpha_std
        missed = (fy[:, None] - force_of(slips)) / fy_std
        parts = np.exp(-(off**2) / 2) / 2, np.exp(-(missed**2) / 2) / 1.4
        return *(part / np.sqrt(2 * np.pi) for part in parts), missed / fy_std

    of_slip, of_force, pull = of(slip)
    together = (of_slip * share) @ of_force.T
    there = np.nonzero(together > 1e-9 * together.max())
    root = np.sqrt(together[there])
    columns = []
    for d in ((1e-4 * CPA2, 0.0), (0.0, 1e-4 * MU)):
        rise = force_of(slip, CPA2 + d[0], MU + d[1]) - force_of(slip, CPA2 - d[0], MU - d[1])
        slopes = of_force * pull * rise / (2 * sum(d))
        columns.append(((of_slip * share) @ slopes.T)[there] / root)
    scores = np.stack(columns, axis=1)
    if shape == "steps":
        # Two masses beside each set point: their sum is its share, their difference its place.
        apart = 4e-7 * fy_std
        slip = np.concatenate([slip - apart, slip + apart])
    of_slip, of_force, _ = of(slip)
    square, mixed = np.zeros((len(slip), len(slip))), np.zeros((len(slip), 2))
    for part in np.split(np.arange(len(root)), np.arange(PARTS, len(root), PARTS)):
        mass = of_slip[there[0][part]] * of_force[there[1][part]] / root[part, None]
        square += mass.T @ mass
        mixed += mass.T @ scores[part]
    size = np.sqrt(np.diag(square))
    values, axes = np.linalg.eigh(square / size / size[:, None])
    kept = values > 1e-9 * values[-1]
    lost = (axes[:, kept].T @ (mixed / size[:, None])) / np.sqrt(values[kept, None])
    information = scores.T @ scores
    return tuple(
        np.sqrt(np.diag(np.linalg.inv(ROWS * left)))
        for left in (information, information - lost.T @ lost)
    )


if __name__ == "__main__":
    for alpha_std in (0.01, 0.02, 0.03):
        for fy_std in (20.0, 80.0, 400.0):
            for shape in ("uniform", "sine", "steps"):
                known, unknown = smallest_scatter(shape, fy_std, alpha_std)
                ratio = unknown / known
                print(shape, fy_std, alpha_std, *known, *unknown, *ratio)
