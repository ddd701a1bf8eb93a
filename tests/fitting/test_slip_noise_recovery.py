"""A fit whose slips are measured with much noise and whose forces with little."""

import numpy as np
import pytest
from recipes import brush_force, table
from scipy.stats import binom

from tirefit.fitting.config import parse_config
from tirefit.fitting.far_rows import settle

CPA2, MU, FZ = 3e4, 0.95, 4000.0
TURNED, ROWS = 0.15, 400  # largest slip angle


def errors(shape: str, fy_std: float, alpha_std: float, seed: int):
    """(errors of cpa2 and mu in standard errors, number of excluded rows) of one file."""
    generator = np.random.default_rng(seed)
    slip = {
        "uniform": generator.uniform(-TURNED, TURNED, ROWS),
        "sine": TURNED * np.sin(0.065 * np.arange(ROWS)),
        "steps": np.repeat(np.linspace(-TURNED, TURNED, 10), ROWS // 10),
    }[shape]
    columns = {
        "alpha": np.arctan(slip) + alpha_std * generator.standard_normal(ROWS),
        "fy": brush_force(slip, CPA2, MU, fz=FZ) + fy_std * generator.standard_normal(ROWS),
        "fz": np.full(ROWS, FZ),
    }
    noise = {"fy": fy_std, "alpha": alpha_std}
    config = parse_config({"noise": noise, "solver": "gauss-newton", "starts": 1})
    settled = settle(table(columns), "brush", config)
    solved = settled.solved
    truth = solved.problem.layout.unconstrained({"cpa2": CPA2, "mu": MU})
    off = (solved.z - np.asarray(truth)) / np.sqrt(np.diag(solved.covariance))
    return off, sum(row.set_aside for row in settled.far)


@pytest.mark.parametrize(("shape", "fy_std"), [("uniform", 20.0), ("sine", 200.0)])
def test_much_slip_noise_leaves_estimates_within_their_errors(shape, fy_std):
    """Four files each: rms of eight errors below 2.2 of their own, where 1 is right and a
    density by which clean rows were excluded gave errors up to 7.5."""
    off, excluded = zip(*(errors(shape, fy_std, 0.02, seed) for seed in range(4)), strict=True)
    assert np.sqrt(np.mean(np.square(off))) < 2.2
    assert sum(excluded) == 0


@pytest.mark.statistics
@pytest.mark.parametrize(
    ("fy_std", "alpha_std"),
    [(5.0, 0.02), (20.0, 0.02), (20.0, 0.003), (80.0, 0.01), (200.0, 0.02), (400.0, 0.03)],
)
@pytest.mark.parametrize("shape", ["uniform", "sine", "steps"])
def test_intervals_hold_with_slip_noise(shape, fy_std, alpha_std):
    off = np.array([errors(shape, fy_std, alpha_std, seed)[0] for seed in range(100)])
    low, high = binom.ppf([0.0005, 0.9995], 100, 0.95) / 100
    share = np.mean(np.abs(off) < 1.96, axis=0)
    assert np.all((share >= low) & (share <= high)), share
