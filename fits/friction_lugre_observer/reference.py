"""Independent numbers: ``python -m fits.friction_lugre_observer.reference``.

NumPy and SciPy alone: theta for a given peak, from the largest steady force of S(18) by
quadrature over the patch.
"""

import numpy as np
from scipy.optimize import brentq, minimize_scalar

FRICTIONS = (0.9, 0.6, 0.4)
V, LENGTH = 20.0, 0.2
MU_S, MU_C, V_ST, EXPONENT = 1.2, 0.6, 10.0, 0.5
SIGMA = (100.0, 0.1, 0.001)
_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(400)


def share(slip, theta):
    """Force over load of S(18) with theta g: the mean over the bristles, with the
    deflection by S(17a)."""
    rolling = V / (1 + slip)
    v_s = slip * rolling
    g = theta * (MU_C + (MU_S - MU_C) * np.exp(-((v_s / V_ST) ** EXPONENT)))
    place = LENGTH * (1 + _POINTS) / 2
    grown = np.exp(-SIGMA[0] * slip * place / g)
    z = g / SIGMA[0] * (1 - grown)
    each = SIGMA[0] * z + SIGMA[1] * v_s * grown + SIGMA[2] * v_s
    return _WEIGHTS @ each / 2


def peak(theta):
    best = minimize_scalar(
        lambda slip: -share(np.exp(slip), theta), bounds=(-5.0, 1.0), options={"xatol": 1e-9}
    )
    return -best.fun


def reference() -> dict[str, float]:
    """theta with each friction as steady peak at 20 m/s."""
    return {
        f"mu = {mu:g}: theta": brentq(lambda theta, m=mu: peak(theta) - m, 0.1, 3.0)
        for mu in FRICTIONS
    }


if __name__ == "__main__":
    for name, value in reference().items():
        print(f"{name:18s} {value:.6g}")
