"""The numbers of ``expected.toml``: the same fit by SciPy on S(18) as printed."""

from pathlib import Path

import numpy as np

from fits.formulas import fit_scipy
from fits.lugre_figure_11.make_data import TRUTH, lugre

HERE = Path(__file__).parent


ALMOST_ZERO = 6.1441746e-6
"""sigma2 [s/m] at |z| = 12 of its bijection: 1 / (1 + e^12)."""


def almost_zero(kappa, force, fz, v, best) -> float:
    """sigma1 of the best fit with the smallest sigma2 of a fit by tirefit."""
    values, _, _ = fit_scipy(
        lambda s0, s1, *rest: lugre(kappa, fz, v, s0, s1, ALMOST_ZERO, *rest),
        force,
        [np.delete(best, 2)],
        [0.1, 0, 0.01, 0.01, 0.1],
        [1e6, 10, 5, 5, 1000],
    )
    return float(values[1])


def held_friction(kappa, force, fz, v, best) -> dict[str, float]:
    """log(S / S_min) with mu_c held below its estimate, each started from the last fit."""
    last = np.delete(best, 4)
    smallest = np.sum((lugre(kappa, fz, v, *best) - force) ** 2)
    found = {}
    for mu_c in (0.44, 0.4, 0.35, 0.3, 0.25, 0.2, 0.15, 0.1, 0.05):
        inside = np.maximum(last, [0.11, 1e-6, 1e-6, 0.011, 0.11])
        last, _, rmse = fit_scipy(
            lambda *p, m=mu_c: lugre(kappa, fz, v, *p[:4], m, p[4]),
            force,
            [inside],
            [0.1, 0, 0, 0.01, 0.1],
            [1e6, 10, 1, 5, 1000],
        )
        name = f"log(S / S_min), mu_c = {mu_c}"
        found[name] = float(np.log(rmse**2 * len(force) / smallest))
    return found


def reference() -> dict[str, float]:
    """Parameters, ``rmse`` [N] and ``gap`` (largest error over F_z) of the fit of figure10."""
    kappa, force, fz, v = np.loadtxt(HERE / "figure10.csv", delimiter=",", skiprows=1, unpack=True)
    starts = [
        np.array([140.0, 0.1, 0.001, 3 * mu, 0.5, v_st]) for mu in (0.3, 0.9) for v_st in (0.5, 5.0)
    ]
    values, _, rmse = fit_scipy(
        lambda *p: lugre(kappa, fz, v, *p),
        force,
        starts,
        [0.1, 0, 0, 0.01, 0.01, 0.1],
        [1e6, 10, 1, 5, 5, 1000],
    )
    found = dict(zip(TRUTH, map(float, values), strict=True))
    found["sigma1, sigma2 almost 0"] = almost_zero(kappa, force, fz, v, values)
    found |= held_friction(kappa, force, fz, v, values)
    miss = lugre(kappa, fz, v, *values) - force
    found["gap"] = float(np.abs(miss / fz).max())
    return found | {"rmse": rmse}


if __name__ == "__main__":
    for key, value in reference().items():
        print(f"{key:10s} {value:.8g}")
