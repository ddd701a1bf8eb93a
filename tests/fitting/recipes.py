"""Synthetic data, and independent tire formulas in plain NumPy."""

import numpy as np

from tirefit.data.table import TireData
from tirefit.fitting.problem.build import build
from tirefit.fitting.problem.config import parse_config
from tirefit.fitting.solve.multistart import Solved, solve_problem

FZ = 4000.0
STD = 40.0
TRUTH = {"cpa2": 5e4, "mu": 1.0}
FULL_SLIDING = 1.5 * TRUTH["mu"] * FZ / TRUTH["cpa2"]
GIVEN = {"noise": {"fx": STD}, "solver": "gauss-newton"}
VAGUE_NOISE = 30.0
"""In units of STD: to 20 % of full sliding, the bend of the curve drowns in it."""
ESTIMATED = {"solver": "gauss-newton"}
SAMPLING = {"effective_samples": 500, "walkers": 16}
"""A quarter of the usual walkers: half the time, and still 4,000 effective samples."""


def brush_force(slip, cpa2, mu, d=0.0, m=1.0, fz=FZ):
    """Bristle forces integrated over the patch by Gauss-Legendre (exact here)."""
    slip, fz = np.broadcast_arrays(np.asarray(slip, float), fz)
    size = np.abs(slip)
    scale = 0.75 * mu * fz
    # cpa2 s = scale (1 + xi)(1 + d xi), the root that is -1 without slip.
    first, rest = scale * (1 + d), scale - cpa2 * size
    root = np.sqrt(np.maximum(first**2 - 4 * scale * d * rest, 0.0))
    xi = np.clip(-2 * rest / (first + root), -1.0, 1.0)
    nodes, weights = np.polynomial.legendre.leggauss(4)
    at = -1 + (xi[:, None] + 1) * (nodes + 1) / 2
    density = 0.75 * (1 - at**2) * (1 + d * at)
    sliding = m * mu * fz * (xi + 1) / 2 * (density @ weights)
    return np.sign(slip) * (sliding + cpa2 * size * (1 - xi) ** 2 / 2)


def magic_force(slip, B, C, D, E, fz=FZ):
    x = B * slip / (1 + slip)
    return D * fz * np.sin(C * np.arctan(x - E * (x - np.arctan(x))))


def curve(
    truth=None, *, force=brush_force, reach=1.6, noise=STD, n=400, seed=1,
    slip_std=0.0, extra=None, name="r",
) -> TireData:  # fmt: skip
    """Slips uniform from 0 to ``reach`` times full sliding, with Gaussian noise."""
    generator = np.random.default_rng(seed)
    slip = generator.uniform(0, reach * FULL_SLIDING, n)
    true = force(slip, **(TRUTH if truth is None else truth))
    columns = {
        "sigma_x": slip + slip_std * generator.standard_normal(n),
        "fx": true + noise * generator.standard_normal(n),
        "fz": np.full(n, FZ),
    }
    return table(columns | (extra or {}), name)


def table(columns, name="r", run=None, runs=None) -> TireData:
    n = len(columns["fz"])
    run = np.zeros(n, int) if run is None else run
    return TireData(name, columns, np.ones(n, bool), run, runs or (name,))


def solved(data, config: dict, model="brush") -> Solved:
    """Only least squares: no profile and no derived quantities."""
    parsed = parse_config(config)
    return solve_problem(build(data, model, parsed), parsed)
