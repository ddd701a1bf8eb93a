"""Independent numbers: ``python -m fits.friction_slip_slope.reference``.

NumPy and SciPy alone: the straight line (slip over force) closest to the Magic Formula
S(40) up to a use of friction, the best possible slope of the slip curve.
"""

import numpy as np
from scipy.optimize import brentq

from fits.formulas import magic_formula
from fits.magic_formula_curve.make_data import truck

USE = 0.25


def reference() -> dict[str, float]:
    """Slope and offset of the closest line; slope at zero slip."""
    curve = truck()
    load = curve["fz"]
    share = np.linspace(0.001, USE, 400) * curve["D"]
    kappa = [brentq(lambda k, f=f * load: magic_formula(k, **curve) - f, 0.0, 0.1) for f in share]
    sigma = np.array(kappa) / (1 - np.array(kappa))
    inverse, offset = np.linalg.lstsq(np.c_[share, np.ones(400)], sigma)[0]
    at_rest = magic_formula(1e-6, **curve) / load / 1e-6
    return {"slope": float(1 / inverse), "offset": float(offset), "slope at rest": float(at_rest)}


if __name__ == "__main__":
    for name, value in reference().items():
        print(f"{name:14s} {value:.6g}")
