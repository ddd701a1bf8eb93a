"""The same fit by SciPy on S(18) as printed: the numbers of ``expected.toml``."""

from pathlib import Path

import numpy as np

from fits.formulas import fit_scipy
from fits.lugre_figure_11.make_data import TRUTH, lugre

HERE = Path(__file__).parent


def reference() -> dict[str, float]:
    """Parameters, ``rmse`` [N], ``gap`` (largest miss over F_z) of figure10's fit."""
    kappa, force, fz, v = np.loadtxt(
        HERE / "figure10.csv", delimiter=",", skiprows=1, unpack=True
    )
    starts = [
        np.array([140.0, 0.1, 0.001, 3 * mu, 0.5, v_st])
        for mu in (0.3, 0.9)
        for v_st in (0.5, 5.0)
    ]
    values, _, rmse = fit_scipy(
        lambda *p: lugre(kappa, fz, v, *p), force, starts,
        [0.1, 0, 0, 0.01, 0.01, 0.1], [1e6, 10, 1, 5, 5, 1000],
    )  # fmt: skip
    found = dict(zip(TRUTH, map(float, values), strict=True))
    miss = lugre(kappa, fz, v, *values) - force
    found["gap"] = float(np.abs(miss / fz).max())
    return found | {"rmse": rmse}


if __name__ == "__main__":
    for key, value in reference().items():
        print(f"{key:10s} {value:.8g}")
