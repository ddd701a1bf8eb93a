"""Independent numbers: ``python -m fits.friction_while_braking.reference``.

NumPy and SciPy alone: the brush S(12) closest to the Magic Formula S(40) up to
the largest slip of each amplitude, the best possible result of the estimators.
"""

import numpy as np
from scipy.optimize import brentq, least_squares

from fits.formulas import brush, magic_formula
from fits.magic_formula_curve.make_data import truck

AMPLITUDES = (0.5, 0.6, 0.75)
LESS = 0.875
"""Peak of the second tire of S Figure 24: 56 % of it is 50 % of the first peak."""
ASYMMETRIES = (-0.2, 0.0, 0.2)
"""Of S Figure 26."""


def reference() -> dict[str, float]:
    """Largest slip and closest brush of both tires; mu of two terms."""
    curve = truck()
    peak = curve["D"]
    # The same stiffness: B C D is not changed.
    other = curve | {"D": LESS, "B": curve["B"] * peak / LESS}
    numbers = closest(curve, peak, "")
    numbers |= closest(other, peak, ", second tire")
    return numbers | two_terms(curve)


def rows(curve, force):
    """Slips sigma with equal steps of force, as the torque rises linearly, and the forces."""
    forces = np.linspace(0.1, 1, 200) * force
    kappas = [brentq(lambda k, f=f: magic_formula(k, **curve) - f, 1e-6, 0.4) for f in forces]
    return np.array(kappas) / (1 - np.array(kappas)), forces


def two_terms(curve) -> dict[str, float]:
    """mu by S(38) with two terms, from 60 % of the peak, by linear regression."""
    load = curve["fz"]
    sigma, force = rows(curve, 0.6 * curve["D"] * load)
    linear, square = np.linalg.lstsq(np.c_[sigma, sigma**2], force)[0]
    # Second term: C^2 / (3 (d - 1) mu F_z).
    return {
        f"60 %: mu of two terms, d = {d:g}": float(-(linear**2) / (3 * (1 - d) * load * square))
        for d in ASYMMETRIES
    }


def closest(curve, peak: float, suffix: str) -> dict[str, float]:
    """Largest slip and closest brush at shares of a peak, its own or that of another tire."""
    load = curve["fz"]
    numbers = {}
    for amplitude in AMPLITUDES:
        force = amplitude * peak * load
        kappa = brentq(lambda k, f=force: magic_formula(k, **curve) - f, 1e-3, 0.4)
        sigma, target = rows(curve, force)

        def gap(x, sigma=sigma, target=target):
            return brush(sigma, load, 0.0, 1e5 * x[0], x[1]) - target

        best = least_squares(gap, [2.5, 0.9], xtol=1e-14).x
        percent = f"{100 * amplitude:.0f} %{suffix}"
        numbers[f"{percent}: largest sigma"] = kappa / (1 - kappa)
        numbers[f"{percent}: mu"] = float(best[1])
        numbers[f"{percent}: cpa2"] = float(1e5 * best[0])
    return numbers


if __name__ == "__main__":
    for name, value in reference().items():
        print(f"{name:25s} {value:.7g}")
