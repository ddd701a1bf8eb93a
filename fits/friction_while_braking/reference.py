"""Independent numbers: ``python -m fits.friction_while_braking.reference``.

NumPy and SciPy alone: the brush S(12) closest to the Magic Formula S(40) up to
the largest slip of each amplitude, which is what the estimators could find at best.
"""

import numpy as np
from scipy.optimize import brentq, least_squares

from fits.formulas import brush, magic_formula
from fits.magic_formula_curve.make_data import truck

AMPLITUDES = (0.5, 0.6, 0.75)


def reference() -> dict[str, float]:
    """Largest slip, and mu and C_x of the closest brush, of each amplitude."""
    curve = truck()
    load, peak = curve["fz"], curve["D"]
    numbers = {}
    for amplitude in AMPLITUDES:
        force = amplitude * peak * load
        kappa = brentq(lambda k, f=force: magic_formula(k, **curve) - f, 1e-3, 0.4)
        # The torque rises evenly, so rows are even in force.
        share = np.linspace(0.1, 1, 200)
        kappas = np.array(
            [
                brentq(lambda k, f=f: magic_formula(k, **curve) - f, 1e-5, 0.4)
                for f in share * force
            ]
        )
        sigma = kappas / (1 - kappas)

        def gap(x, sigma=sigma, target=share * force):
            return brush(sigma, load, 0.0, 1e5 * x[0], x[1]) - target

        best = least_squares(gap, [2.5, 0.9], xtol=1e-14).x
        percent = f"{100 * amplitude:.0f} %"
        numbers[f"{percent}: largest sigma"] = kappa / (1 - kappa)
        numbers[f"{percent}: mu"] = float(best[1])
        numbers[f"{percent}: cpa2"] = float(1e5 * best[0])
    return numbers


if __name__ == "__main__":
    for name, value in reference().items():
        print(f"{name:25s} {value:.7g}")
