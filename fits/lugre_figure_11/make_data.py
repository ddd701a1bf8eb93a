"""Writes the data of this case: ``python -m fits.lugre_figure_11.make_data``.

``figure10.csv``: the Magic Formula of S Figure 10 at F_z = 4 kN and v = 20 m/s over the
whole range of slip, no noise.
``speeds.csv``: the LuGre tire S(18) with the parameters ``TRUTH`` at three speeds, with
noise of 20 N.
"""

from pathlib import Path

import numpy as np

from fits.formulas import magic_formula
from fits.magic_formula_curve.make_data import FIGURE10, SPEED

HERE = Path(__file__).parent
TRUTH = {"sigma0": 180.0, "sigma1": 0.05, "sigma2": 0.003, "mu_s": 1.4, "mu_c": 0.6, "v_st": 6.0}
SPEEDS = (5.0, 15.0, 30.0)


def lugre(kappa, fz, v, sigma0, sigma1, sigma2, mu_s, mu_c, v_st):
    """S(18) as printed, the patch 0.2 m long; kappa > 0."""
    sliding, slip = v * kappa, kappa / (1 - kappa)
    g = mu_c + (mu_s - mu_c) * np.exp(-np.sqrt(sliding / v_st))
    rise = g / (sigma0 * 0.2 * slip) * np.expm1(-sigma0 * 0.2 * slip / g)
    return fz * (g * (1 + (1 - sigma1 * sliding / g) * rise) + sigma2 * sliding)


def _write(name: str, kappa, force, v) -> None:
    lines = ["kappa,fx,fz,v"]
    lines += [
        f"{k:.3f},{f:.4f},{FIGURE10['fz']:.0f},{speed:.0f}"
        for k, f, speed in zip(kappa, force, v, strict=True)
    ]
    (HERE / name).write_text("\n".join(lines) + "\n")


def main() -> None:
    kappa = np.linspace(0, 1, 201)[1:-1]
    v = np.full(len(kappa), SPEED)
    _write("figure10.csv", kappa, magic_formula(kappa, **FIGURE10), v)
    v, kappa = (part.ravel() for part in np.meshgrid(SPEEDS, np.arange(1, 91) / 100))
    noise = 20 * np.random.default_rng(0).normal(size=len(kappa))
    _write("speeds.csv", kappa, lugre(kappa, FIGURE10["fz"], v, **TRUTH) + noise, v)


if __name__ == "__main__":
    main()
