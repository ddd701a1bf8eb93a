"""The sources' formulas in NumPy, independent of tirefit, for the tests of the cases.

Each is the printed closed form of S ("A survey ...", section 2.3 and 4) with its errata
corrected, not the composition of a pressure and a friction law that tirefit uses. All
take arrays or scalars, braking positive, SI; ``c`` is c_p a^2.
"""

import numpy as np
from scipy.optimize import least_squares

__all__ = [
    "brush",
    "brush_d",
    "brush_h",
    "brush_m",
    "brush_m_peak",
    "brush_n",
    "fit_scipy",
    "magic_formula",
    "two_levels",
]


def two_levels(sigma, fz, c, mu_s, mu_k):
    """S(31) with S(12) as its case mu_k = mu_s; sigma >= 0."""
    cs = c * sigma
    sticking = (
        2 * cs
        + 4 * cs**2 * (mu_k - 2 * mu_s) / (3 * fz * mu_s**2)
        + 8 * cs**3 * (3 * mu_s - 2 * mu_k) / (27 * fz**2 * mu_s**3)
    )
    return np.where(cs < 1.5 * mu_s * fz, sticking, mu_k * fz)


def brush(sigma, fz, v, c, mu):
    """S(12)."""
    return two_levels(sigma, fz, c, mu, mu)


def brush_m(sigma, fz, v, c, mu, m):
    """S(31), mu_k = m mu_s."""
    return two_levels(sigma, fz, c, mu, m * mu)


def brush_m_peak(sigma, fz, v, c, peak, m):
    """S(34), with the factor 1/(3 - 2m)^2 of the sigma^2 term that is missing in print.

    ``peak`` is F_max / F_z.
    """
    cs, top = c * sigma, fz * peak
    sticking = (
        2 * cs
        + 4 * cs**2 * (m - 2) * (4 - 3 * m) / (3 * top * (3 - 2 * m) ** 2)
        + 8 * cs**3 * (4 - 3 * m) ** 2 / (27 * top**2 * (3 - 2 * m) ** 3)
    )
    mu_s = peak * (3 - 2 * m) ** 2 / (4 - 3 * m)
    return np.where(cs < 1.5 * mu_s * fz, sticking, m * mu_s * fz)


def brush_n(sigma, fz, v, c, mu, n):
    """S(31) with S(35), static friction constant."""
    return two_levels(sigma, fz, c, mu, mu - n * v * sigma / (1 + sigma))


def brush_h(sigma, fz, v, c, mu, h):
    """S(31) with S(37), static friction constant, v_st = 30 m/s, exponent 1/2."""
    decay = np.exp(-np.sqrt(v * sigma / (1 + sigma) / 30))
    return two_levels(sigma, fz, c, mu, mu * (h + (1 - h) * decay))


def brush_d(sigma, fz, v, c, mu, d):
    """S(29) corrected (sigma multiplies only the second term before the root)."""
    if abs(d) < 1e-3:  # S(29) divides by d^3
        return brush(sigma, fz, v, c, mu)
    top = mu * fz
    root = np.sqrt(np.maximum((d - 1) ** 2 + 16 * d * c * sigma / (3 * top), 0))
    force = (
        top / (32 * d**3) * (1 - d) ** 3 * (3 * d + 1)
        + c / (4 * d**2) * (2 * d + 5 * d**2 + 1) * sigma
        + (c * sigma) ** 2 / (3 * top * d)
        - (top / (32 * d**3) * (d - 1) ** 2 + c * sigma / (6 * d**2)) * (3 * d + 1) * root
    )
    return np.where(c * sigma < 1.5 * top * (1 + d), force, top)


def magic_formula(x, fz, B, C, D, E):
    """S(16); x is kappa or alpha."""
    bx = B * x
    return D * fz * np.sin(C * np.arctan(bx - E * (bx - np.arctan(bx))))


def fit_scipy(function, observed, starts, lower, upper):
    """Best of SciPy's bounded least squares over several starts.

    Args:
        function: parameters (p,) -> force (n,).
        observed: force (n,).
        starts: list of (p,).
        lower, upper: bounds (p,).

    Returns:
        (values (p,), standard errors (p,) as if rows were independent, RMSE).
    """
    found = [
        least_squares(
            lambda p: function(*p) - observed,
            start,
            bounds=(lower, upper),
            x_scale=np.abs(start) + 0.1,
            xtol=1e-14,
            ftol=1e-14,
            gtol=1e-14,
        )
        for start in starts
    ]
    best = min(found, key=lambda result: result.cost)
    squares = 2 * best.cost
    variance = squares / (len(observed) - len(best.x))
    # A parameter at its bound has almost no slope: use the pseudo-inverse.
    covariance = np.linalg.pinv(best.jac.T @ best.jac) * variance
    return best.x, np.sqrt(np.diag(covariance)), float(np.sqrt(squares / len(observed)))
