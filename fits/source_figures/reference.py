"""The numbers of ``expected.toml`` without tirefit: SciPy on bristles and on S's forms.

The brushes of Figures 9, 12 and 16 are integrated bristle by bristle: each carries the
smaller of its elastic force and the friction.
"""

import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq, minimize_scalar

from fits import formulas
from fits.formulas import magic_formula
from fits.magic_formula_curve.make_data import FIGURE10, truck

LOAD, STIFFNESS, SPEED = 27e3, 2.5e5, 20.0
MU = 0.98


def parabolic(x, d=0.0):
    """S(23), and S(24) with d; times a / F_z."""
    return 0.75 * (1 - x**2) * (1 + d * x)


def fourth_order(x):
    """S(25)."""
    return 0.625 * (1 - x**4)


def uniform(x):
    return 0.5


def patch(pressure, ratio, mu, power=0):
    """Integral of x^power times bristle force over F_z; ratio is c sigma / F_z."""

    def spare(x):
        return mu * pressure(x) - ratio * (1 - x)

    # At most one change from sliding to sticking.
    ends = (-1 + 1e-12, 1 - 1e-9)
    changes = spare(ends[0]) < 0 < spare(ends[1])
    parts = [-1.0, *([brentq(spare, *ends)] if changes else []), 1.0]
    return sum(
        quad(lambda x: x**power * min(ratio * (1 - x), mu * pressure(x)), *part)[0]
        for part in zip(parts[:-1], parts[1:], strict=True)
    )


def of_9() -> dict[str, float]:
    found = {}
    for i, (mu, c) in enumerate(((0.9, 5e4), (0.9, 2.5e4), (0.45, 5e4))):
        for name, pressure in (("brush", parabolic), ("uniform", uniform)):
            found[f"{name} {i} force"] = patch(pressure, c * 0.03 / 4000, mu)
    return found


def of_10() -> dict[str, float]:
    def minus(kappa):
        return -magic_formula(kappa, **FIGURE10) / FIGURE10["fz"]

    peak = minimize_scalar(minus, bounds=(0.05, 0.3), options={"xatol": 1e-10})
    return {
        "10 kappa": peak.x,
        "10 half": brentq(lambda k: minus(k) + 0.35, 1e-6, 0.1),
        "10 locked": -minus(1.0),
    }


def of_12() -> dict[str, float]:
    found = {}
    for mu in (0.4, 1.0):
        best = minimize_scalar(
            lambda ratio, mu=mu: patch(parabolic, ratio, mu, 1),
            bounds=(0, 1.5 * mu),
            options={"xatol": 1e-9},
        )
        found[f"12 moment {mu:g}"] = -best.fun
        found[f"12 force {mu:g}"] = patch(parabolic, best.x, mu)
    return found


def of_14() -> dict[str, float]:
    found = {"14 crossing": brentq(lambda x: parabolic(x) - fourth_order(x), 0.1, 0.9)}
    for d in (-0.3, 0.5):
        top = minimize_scalar(lambda x, d=d: -parabolic(x, d), bounds=(-1, 1))
        found[f"14 peak {d:g}"], found[f"14 place {d:g}"] = -top.fun, top.x
        found[f"14 centre {d:g}"] = quad(lambda x, d=d: x * parabolic(x, d), -1, 1)[0]
    return found


def of_16() -> dict[str, float]:
    def force(pressure, kappa):
        return patch(pressure, STIFFNESS * kappa / (1 - kappa) / LOAD, MU)

    def miss(pressure, kappa):
        return force(pressure, kappa) - magic_formula(kappa, **truck()) / LOAD

    lead = minimize_scalar(
        lambda k: force(fourth_order, k) - force(parabolic, k), bounds=(0.05, 0.13)
    )
    at_70 = brentq(lambda k: magic_formula(k, **truck()) / LOAD - 0.7 * MU, 1e-3, 0.3)
    found = {
        "16 lead": -lead.fun,
        "16 kappa": lead.x,
        "16 fourth order": force(fourth_order, 0.1),
        "16 kappa at 70 %": at_70,
    }
    for name, pressure in (("parabolic", parabolic), ("fourth order", fourth_order)):
        rows = [miss(pressure, k) for k in np.linspace(0, at_70, 60)[1:]]
        found[f"16 miss, {name}"] = max(rows, key=abs)
    return found


def s38(sigma, c, top, d, order):
    """S(38) as printed; order 3 is S(41)."""
    terms = (
        2 * c * sigma,
        4 / 3 * c**2 / ((d - 1) * top) * sigma**2,
        -8 / 27 * (3 * d + 1) * c**3 / ((d - 1) ** 3 * top**2) * sigma**3,
        16 / 27 * (3 * d + 1) * c**4 * d / ((d - 1) ** 5 * top**3) * sigma**4,
    )
    return sum(terms[:order])


def s39(sigma, order):
    """S(39) as printed, with the values of Figure 18."""
    c, nv, mu_0 = STIFFNESS, 0.0075 * SPEED, 1.05
    top = LOAD * mu_0
    square = 4 * c**2 / (3 * top)
    terms = (
        2 * c * sigma,
        -square * sigma**2,
        square * (2 * c / (9 * top) - nv / mu_0) * sigma**3,
        square * nv * (4 * c / (9 * top * mu_0) + 1 / mu_0 - nv / mu_0**2) * sigma**4,
    )
    return sum(terms[:order])


def falling(sigma):
    """S(12) with mu from S(35)."""
    mu = 1.05 - 0.0075 * SPEED * sigma / (1 + sigma)
    return formulas.two_levels(sigma, LOAD, STIFFNESS, mu, mu)


def of_19_20() -> dict[str, float]:
    found = {}
    pairs = {"20": (falling, s39)}
    for d in (-0.2, 0.1):
        pairs[f"19, d = {d:g}"] = (
            lambda s, d=d: formulas.brush_d(s, LOAD, SPEED, STIFFNESS, MU, d),
            lambda s, order, d=d: s38(s, STIFFNESS, MU * LOAD, d, order),
        )
    for name, (exact, series) in pairs.items():
        for order in (3, 4):
            found[f"{name} miss {order}"] = (series(0.1, order) - exact(0.1)) / LOAD
            sigma = np.linspace(0.01, 0.3, 30_000)
            over = np.abs(series(sigma, order) / exact(sigma) - 1) > 0.01
            found[f"{name} radius {order}"] = sigma[np.argmax(over)]
    sliding = brentq(lambda s: STIFFNESS * s / LOAD - 1.5 * (1.05 - 0.15 * s / (1 + s)), 0.1, 0.3)
    top = minimize_scalar(lambda s: -falling(s) / LOAD, bounds=(0.1, sliding))
    found |= {"20 sliding": sliding, "20 peak": -top.fun, "20 sigma": top.x}
    return found


def of_25() -> dict[str, float]:
    """Least squares as a search over r = c / (mu F_z): S(38) is linear in c then."""
    tire, found = truck(), {}
    end = brentq(lambda k: magic_formula(k, **tire) / LOAD - 0.6 * MU, 1e-3, 0.2)
    kappa = np.linspace(0, end, 201)[1:]
    sigma, force = kappa / (1 - kappa), magic_formula(kappa, **tire)
    at_5 = 0.05 / 0.95
    for d in (-0.2, 0.0, 0.2):
        for order in (2, 3):

            def linear(r, d=d, order=order):
                shape = s38(sigma, 1.0, 1 / r, d, order)
                c = shape @ force / (shape @ shape)
                return c, np.sum((c * shape - force) ** 2)

            r = minimize_scalar(lambda r: linear(r)[1], bounds=(2, 40), options={"xatol": 1e-10}).x
            c, name = linear(r)[0], f"{d:g} {order}"
            found[f"25 stiffness {name}"], found[f"25 mu {name}"] = (c / 1e3, c / r / LOAD)
            found[f"25 force {name}"] = (
                formulas.brush_d(at_5, LOAD, SPEED, c, c / r / LOAD, d) / LOAD
            )
    return found


def reference() -> dict[str, float]:
    parts = (of_9, of_10, of_12, of_14, of_16, of_19_20, of_25)
    return {name: float(value) for part in parts for name, value in part().items()}


if __name__ == "__main__":
    for key, value in reference().items():
        print(f"{key:32s} {value:.8g}")
