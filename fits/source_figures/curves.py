"""The arrays of S Figures 9, 10, 12, 14, 16, 19, 20 and 25, from tirefit's models.

``draw.py`` draws them and computes the asserted numbers. S prints values only for
Figure 10; the others use the tires given here.
"""

import jax
import numpy as np
from scipy.optimize import least_squares

import tirefit
from fits.formulas import magic_formula
from fits.magic_formula_curve.make_data import FIGURE10, SPEED, truck
from fits.source_figures.taylor import asymmetric_coefficients, coefficients, truncated_force
from tirefit.models import (
    Asymmetric,
    Brush,
    Friction,
    LinearInSpeed,
    MagicFormula,
    Parabolic,
    Quartic,
)

jax.config.update("jax_enable_x64", True)

CAR_LOAD = 4000.0
TIRES = ((0.9, 5e4), (0.9, 2.5e4), (0.45, 5e4))
"""Friction and c_p a^2 [N] of the curves of Figure 9."""
FRICTIONS = (0.2, 0.4, 0.6, 0.8, 1.0)
ANGLES = (0.5, 1.0, 2.0, 3.0, 4.0, 6.0)
"""Slip angles [deg] of the lines across the curves of Figure 12."""
HALF_LENGTH = 0.1
LEANS = (-0.3, 0.5)
"""d of the asymmetric pressures of Figure 14."""
TRUCK = truck()
TRUCK_STIFFNESS = 2.5e5
EXPANDED = {"19, d = -0.2": -0.2, "19, d = 0.1": 0.1}
MU_0, FALL = 1.05, 0.0075
"""mu_0 and n [s/m], as printed with Figure 18."""
OPTIMISED = (-0.2, 0.0, 0.2)
"""d of Figure 25, as given by S for Figure 26."""
INTERVAL = np.linspace(0, 0.04, 201)[1:]
"""kappa of the fit of Figure 25: up to 60 % of the peak (S section 5.4)."""


def brake_force(tire, sigma, fz, v=0.0):
    """Force [N] in pure braking at physical slip (n,)."""
    return np.asarray(tirefit.forces(tire, tirefit.TireInputs(sigma, 0.0, fz, v)).fx)


def force_slip(family: str, mu: float, cpa2: float, sigma):
    """F_x / F_z (n,) of Figure 9; ``family`` is brush or uniform."""
    tire = tirefit.with_values(tirefit.MODELS[family], {"cpa2": cpa2, "mu": mu})
    return brake_force(tire, sigma, CAR_LOAD) / CAR_LOAD


def friction_curve(kappa):
    """F / F_z (n,) of Figure 10, to the locked wheel at kappa = 1."""
    factors = {name: FIGURE10[name] for name in "BCDE"}
    return np.asarray(MagicFormula(**factors).pure(kappa, 1.0))


def gough(mu, alpha):
    """(-M_z / F_z [m], F_y / F_z [-]) of Figure 12; mu or alpha [rad] is (n,)."""

    def at(mu, alpha):
        found = Brush(5e4, mu, HALF_LENGTH)(tirefit.TireInputs(0.0, alpha, CAR_LOAD, 0.0))
        return -found.mz / CAR_LOAD, found.fy / CAR_LOAD

    moment, force = jax.vmap(at)(*np.broadcast_arrays(mu, alpha))
    return np.asarray(moment), np.asarray(force)


def pressures(xi) -> dict[str, np.ndarray]:
    """a q_z / F_z (n,) of Figure 14, by name."""
    laws = {"S(23)": Parabolic(), "S(25)": Quartic()}
    laws |= {f"S(24), d = {d:g}": Asymmetric(d) for d in LEANS}
    return {name: np.asarray(law.density(1 + xi)) for name, law in laws.items()}


def pressure_effect(kappa) -> dict[str, np.ndarray]:
    """F_x / F_z (n,) of Figure 16: the truck curve and two brushes of its slope."""
    load, sigma = TRUCK["fz"], kappa / (1 - kappa)
    found = {"Magic Formula": magic_formula(kappa, **TRUCK) / load}
    for name, law in (("parabolic", Parabolic()), ("fourth order", Quartic())):
        tire = Brush(TRUCK_STIFFNESS, TRUCK["D"], pressure=law)
        found[name] = brake_force(tire, sigma, load) / load
    return found


def expanded(name: str) -> Brush:
    """The brush that Figure 19 (``19, d = ...``) or Figure 20 (``20``) expands."""
    if name == "20":
        law = LinearInSpeed(FALL, static_too=True)
        return Brush(TRUCK_STIFFNESS, MU_0, friction=Friction((law,)))
    return Brush(TRUCK_STIFFNESS, TRUCK["D"], pressure=Asymmetric(EXPANDED[name]))


def convergence(name: str, sigma) -> dict[str, np.ndarray]:
    """F_x / F_z (n,) of Figure 19 or 20: exact, and by three and four terms."""
    tire, load = expanded(name), TRUCK["fz"]
    found = {"exact": brake_force(tire, sigma, load, SPEED) / load}
    for order in (3, 4):
        terms = coefficients(tire, load, SPEED, order)
        found[f"{order} terms"] = np.asarray(truncated_force(terms, sigma)) / load
    return found


def optimised(d: float, order: int) -> tuple[float, float]:
    """(c_p a^2 [N], mu F_z [N]) of the fit of truncated S(38) to the truck curve."""
    sigma, force = INTERVAL / (1 - INTERVAL), magic_formula(INTERVAL, **TRUCK)
    start = np.array([TRUCK_STIFFNESS, TRUCK["D"] * TRUCK["fz"]])

    def miss(scale):
        terms = asymmetric_coefficients(*(scale * start), d, order)
        return (np.asarray(truncated_force(terms, sigma)) - force) / TRUCK["fz"]

    found = least_squares(miss, [1.0, 1.0], xtol=1e-14, ftol=1e-14, gtol=1e-14)
    cpa2, mu_fz = found.x * start
    return float(cpa2), float(mu_fz)


def optimised_curve(d: float, order: int, kappa):
    """F_x / F_z (n,) of Figure 25: S(29) with the parameters of :func:`optimised`."""
    cpa2, mu_fz = optimised(d, order)
    tire = Brush(cpa2, mu_fz / TRUCK["fz"], pressure=Asymmetric(d))
    return brake_force(tire, kappa / (1 - kappa), TRUCK["fz"]) / TRUCK["fz"]
