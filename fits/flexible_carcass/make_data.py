"""Writes three lateral Magic Formula curves without noise:
``python -m fits.flexible_carcass.make_data``. S prints no coefficients of its Figure 13.

``figure10.csv``: the coefficients of S Figure 10, F_z = 4 kN, to 8 degrees, a quarter
beyond the peak.
``g275_70psi.csv``, ``g275_95psi.csv``: the lateral coefficients of a Goodyear G275
335/65R22.5 truck tire, fitted to measurements, from the MF-Tyre files of Project Chrono
(BSD-3, in tests/data/tir/chrono), at nominal load and without the shifts, to 11
degrees, where the measurement ends.
"""

import math
from pathlib import Path

import numpy as np

from fits.formulas import magic_formula
from fits.magic_formula_curve.make_data import FIGURE10

HERE = Path(__file__).parent
ROWS = 30


def measured(fz, PCY1, PDY1, PEY1, PKY1, PKY2) -> dict[str, float]:
    """S(16) of a tire at nominal load, no camber; PDY1 and PKY1 without sign."""
    stiffness = PKY1 * math.sin(2 * math.atan(1 / PKY2))
    return {"fz": fz, "B": stiffness / (PCY1 * PDY1), "C": PCY1, "D": PDY1, "E": PEY1}


CURVES = {
    "figure10": (FIGURE10, 8.0),
    "g275_70psi": (measured(24046.0, 1.1449, 0.74238, 0.061291, 11.106, 2.4329), 11.0),
    "g275_95psi": (measured(29912.0, 0.54764, 1.1188, 0.056372, 9.5432, 2.4559), 11.0),
}
"""Name -> (coefficients, largest slip angle [deg])."""


def main() -> None:
    for name, (coefficients, largest) in CURVES.items():
        alpha = np.deg2rad(np.linspace(0, largest, ROWS + 1)[1:])
        force = magic_formula(alpha, **coefficients)
        fz = coefficients["fz"]
        lines = ["alpha,fy,fz"]
        lines += [f"{a:.8f},{f:.4f},{fz:.0f}" for a, f in zip(alpha, force, strict=True)]
        (HERE / f"{name}.csv").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
