"""The contact patch by numerical integration: the reference for every brush model.

Written apart from ``tirefit``: physical coordinates, quadrature, root finding, no
closed form. A bristle at x in [-a, a] needs c_p sigma (a - x) per length to stick; the
road holds it up to mu_s q_z(x). Going back from the leading edge x = a, bristles
stick up to the first point where the need exceeds that limit and slide with
mu_k q_z(x) behind it.
"""

from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

NODES, WEIGHTS = np.polynomial.legendre.leggauss(24)
SCAN = np.cos(np.linspace(0, np.pi, 801))


class Patch(NamedTuple):
    """Force and moment of a patch, and the same integrals of absolute values."""

    force: float
    moment: float
    force_scale: float
    moment_scale: float
    breakaway: float


def reference_density(family, d, xi):
    """Pressure density over xi = x/a: S(10), uniform, S(24), S(25)."""
    if family == "uniform":
        return np.full_like(xi, 0.5)
    if family == "quartic":
        return 5 / 8 * (1 - xi**4)
    return 3 / 4 * (1 - xi**2) * (1 + d * xi)


def holding_ratio(family, d, xi):
    """Density over (1 - xi): the demand ratio rho at which the bristle slides."""
    if family == "uniform":
        return 0.5 / np.maximum(1 - xi, 1e-300)
    if family == "quartic":
        return 5 / 8 * (1 + xi) * (1 + xi**2)
    return 3 / 4 * (1 + xi) * (1 + d * xi)


def breakaway_point(family, d, rho):
    """xi of the first bristle, from the leading edge, that does not hold."""
    fails = holding_ratio(family, d, SCAN) < rho
    if not fails.any():
        return -1.0
    first = int(np.argmax(fails))
    if first == 0:
        return 1.0
    return brentq(
        lambda xi: float(holding_ratio(family, d, np.float64(xi))) - rho,
        SCAN[first],
        SCAN[first - 1],
        xtol=1e-15,
        rtol=4 * np.finfo(float).eps,
    )


def _panel(function, low, high, a):
    """Integral over x = -a cos(angle), in which a vertical end is smooth."""
    low, high = np.arccos(-low / a), np.arccos(-high / a)
    half = (high - low) / 2
    angle = low + half * (1 + NODES)
    weights = half * WEIGHTS * a * np.sin(angle)
    return (weights * np.stack(function(-a * np.cos(angle)))).sum(axis=-1)


def integrate_patch(family, d, cpa2, mu_s, mu_k, fz, slip, a=0.1):
    """Patch of slip >= 0 and load > 0."""
    c_p = cpa2 / a**2
    xi_s = breakaway_point(family, d, c_p * a**2 * slip / (mu_s * fz))

    def moments_of(density):
        def integrands(x):
            f = density(x)
            return f, x * f, np.abs(f), np.abs(x * f)

        return integrands

    def sticking(x):
        return c_p * slip * (a - x)

    def sliding(x):
        return mu_k * fz / a * reference_density(family, d, x / a)

    # A node at x = 0 keeps the absolute moment polynomial on every panel.
    edges = sorted({-a, 0.0, a * xi_s, a})
    total = np.zeros(4)
    for low, high in zip(edges, edges[1:], strict=False):
        law = sliding if (low + high) / 2 < a * xi_s else sticking
        total += _panel(moments_of(law), low, high, a)
    return Patch(*total, xi_s)


def reference_friction(letters, values, v_s):
    """(mu_s, mu_k) of the friction encoded in the letters of a model's name."""
    mu = values["mu"]
    static, kinetic = mu, mu
    if "m" in letters:
        kinetic = values["m"] * mu
    if "n" in letters:
        kinetic = kinetic - values["n"] * v_s
        if "s" in letters:
            static = mu - values["n"] * v_s
    if "h" in letters:
        h = values["h"]
        share = h + (1 - h) * np.exp(-((v_s / values["v_st"]) ** values["exponent"]))
        kinetic = kinetic * share
        if "s" in letters:
            static = mu * share
    return static, kinetic


def reference_stribeck(static_too, values, v_s):
    """(mu_s, mu_k) of S(36)."""
    fall = np.exp(-((v_s / values["v_st"]) ** values["exponent"]))
    kinetic = values["mu_c"] + (values["mu"] - values["mu_c"]) * fall
    return (kinetic if static_too else values["mu"]), kinetic


def reference_tire(name, values, sigma_x, alpha, fz, v):
    """(longitudinal patch, lateral patch) of a registered brush model, one sample.

    The signs of the inputs are left to the caller: both patches are of positive slip.
    """
    family, _, letters = name.partition("-")

    def friction(v_s):
        if letters.startswith("stribeck"):
            return reference_stribeck(letters.endswith("-s"), values, v_s)
        if letters == "ln":
            mu = values["mu"] * (1 + values["g"] * np.log(v_s + 0.02))
            return mu, mu
        if letters == "m-peak":
            m = values["m"]
            mu = values["mu_peak"] * (3 - 2 * m) ** 2 / (4 - 3 * m)
            return mu, m * mu
        return reference_friction(letters, values, v_s)

    d = values.get("d", 0.0)
    patches = []
    for slip, v_s in ((sigma_x, v * sigma_x / (1 + sigma_x)), (np.tan(alpha), v * np.tan(alpha))):
        mu_s, mu_k = friction(abs(v_s))
        patches.append(
            integrate_patch(
                family, d, values["cpa2"], mu_s, mu_k, fz, abs(slip), a=values["half_length"]
            )
        )
    return tuple(patches)
