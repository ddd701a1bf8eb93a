"""Writes two Magic Formula curves without noise:
``python -m fits.magic_formula_curve.make_data``.

``figure10.csv``: the coefficients S prints with its Figure 10, at F_z = 4 kN.
``truck.csv``: D = 0.98 and C_x = BCD F_z = 5e5 N at F_z = 27 kN (S section 5); of the
pairs (C, E) with 60 % of the peak at kappa = 4 %, the one whose peak comes first.
"""

from pathlib import Path

import numpy as np
from scipy.optimize import brentq

from fits.formulas import magic_formula

HERE = Path(__file__).parent
SPEED = 20.0

FIGURE10 = {"fz": 4000.0, "B": 8.0, "C": 2.5, "D": 0.7, "E": 1.0}


def truck(C: float = 1.22) -> dict[str, float]:
    """Coefficients of the truck curve; E solved for 60 % of the peak at kappa = 4 %."""
    fz, D = 27e3, 0.98
    B = 5e5 / (C * D * fz)
    E = brentq(lambda E: magic_formula(0.04, 1.0, B, C, D, E) - 0.6 * D, -20, 1)
    return {"fz": fz, "B": B, "C": C, "D": D, "E": E}


CURVES = {"figure10": (FIGURE10, 0.25), "truck": (truck(), 0.65)}
"""Name -> (coefficients, largest sigma)."""


def main() -> None:
    for name, (coefficients, largest) in CURVES.items():
        sigma = np.linspace(0, largest, 201)[1:]
        force = magic_formula(sigma / (1 + sigma), **coefficients)
        fz = coefficients["fz"]
        lines = ["sigma_x,fx,fz,v"]
        lines += [
            f"{s:.6f},{f:.4f},{fz:.0f},{SPEED:.0f}" for s, f in zip(sigma, force, strict=True)
        ]
        (HERE / f"{name}.csv").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
