"""Combined slip by the friction ellipse, against its published form with the angle beta."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.models.test_mf import MF52, iso, jacobian, values_of
from tests.models.test_mf_similarity import ALPHA, KAPPA
from tirefit.models import TireInputs
from tirefit.models.mf import mf_tire

TRUCK = "chrono/335_65R22_5_G275MSA_60psi.tir"
SHIFTED = {"PHX1": 2e-3, "PVX1": 0.01, "PVY1": 0.02, "PHY1": -3e-3}


def elliptic(name, **other):
    return mf_tire("5.2", values_of(name) | other, combination="ellipse")


def published(values, kappa, alpha, fz):
    """F_x and F_y of an upright wheel by the equations of PAC2002 as Chrono prints them."""
    c = {"PEX4": 0.0} | values
    dfz = (fz - c["FNOMIN"]) / c["FNOMIN"]

    def curve(slip, shape, peak, stiffness, bend):
        x = stiffness / (shape * peak) * slip
        bend = np.minimum(bend, 1.0)
        return peak * np.sin(shape * np.arctan(x - bend * (x - np.arctan(x))))

    shift_x, shift_y = (fz * (c[f"PV{i}1"] + c[f"PV{i}2"] * dfz) for i in "XY")
    off_x, off_y = (c[f"PH{i}1"] + c[f"PH{i}2"] * dfz for i in "XY")
    peak_x, peak_y = (fz * (c[f"PD{i}1"] + c[f"PD{i}2"] * dfz) for i in "XY")
    stiff_x = fz * (c["PKX1"] + c["PKX2"] * dfz) * np.exp(c["PKX3"] * dfz)
    stiff_y = c["PKY1"] * c["FNOMIN"]
    stiff_y *= np.sin(2 * np.arctan(fz / (c["PKY2"] * c["FNOMIN"])))
    bend_x = c["PEX1"] + c["PEX2"] * dfz + c["PEX3"] * dfz**2
    bend_x = bend_x * (1 - c["PEX4"] * np.sign(kappa + off_x))
    bend_y = (c["PEY1"] + c["PEY2"] * dfz) * (1 - c["PEY3"] * np.sign(alpha + off_y))
    fx0 = curve(kappa + off_x, c["PCX1"], peak_x, stiff_x, bend_x)
    fy0 = curve(alpha + off_y, c["PCY1"], peak_y, stiff_y, bend_y)
    kappa_c = kappa + off_x + shift_x / stiff_x
    alpha_s = np.sin(alpha + off_y + shift_y / stiff_y)
    beta = np.arccos(abs(kappa_c) / np.hypot(kappa_c, alpha_s))
    act_x, act_y = abs(fx0) / fz, abs(fy0) / fz
    mu_x = 1 / np.hypot(1 / act_x, np.tan(beta) / (peak_y / fz))
    mu_y = np.tan(beta) / np.hypot(1 / (peak_x / fz), np.tan(beta) / act_y)
    return (fx0 + shift_x) * mu_x / act_x, (fy0 + shift_y) * mu_y / act_y


@pytest.mark.parametrize("name", [MF52, TRUCK])
@pytest.mark.parametrize("shifts", [{}, SHIFTED])
def test_forces_are_those_of_the_published_ellipse(name, shifts):
    values, tire = values_of(name) | shifts, elliptic(name, **shifts)
    for share in (0.5, 1.0, 1.7):
        fz = share * values["FNOMIN"]
        found = iso(tire, KAPPA, ALPHA, fz)
        for ours, theirs in zip(found[:2], published(values, KAPPA, ALPHA, fz), strict=True):
            # The quotient of both loses digits where a slip is small.
            np.testing.assert_allclose(ours, theirs, rtol=1e-7, atol=1e-6 * fz)


def test_values_and_gradients_are_finite_everywhere():
    """In 32 bit, also at rest and in pure slip, where the published form is 0 / 0."""
    value, slopes = jacobian(elliptic(MF52, **SHIFTED), dtype=jnp.float32)
    assert np.isfinite(value).all()
    assert all(np.isfinite(leaf).all() for leaf in slopes)


def test_the_slope_in_the_other_pure_slip_is_the_limit_of_nearby_slips():
    """At kappa = 0 and a slip angle: K_x / sqrt(1 + (K_x sin(alpha) / (mu_y F_z))^2)."""
    tire = elliptic(TRUCK, PHX1=0.0, PVX1=0.0, PHY1=0.0, PHY2=0.0, PVY1=0.0, PVY2=0.0)
    values = values_of(TRUCK)
    fz, alpha = values["FNOMIN"], 0.05
    slope = jax.jit(jax.grad(lambda s: tire(TireInputs(s, alpha, fz)).fx))(0.0)
    stiffness = values["PKX1"] * fz
    expected = stiffness / np.hypot(1, values["PKX1"] * np.sin(alpha) / values["PDY1"])
    np.testing.assert_allclose(abs(slope), expected, rtol=1e-6)
