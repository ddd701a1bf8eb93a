"""Derived quantities against the closed forms of the paper."""

import numpy as np
import pytest
from recipes import FZ, GIVEN, TRUTH, curve, solved

from tirefit.fitting.derived import derived_values
from tirefit.fitting.estimate import derived_estimates
from tirefit.fitting.layout import FreeParameter, Layout
from tirefit.models import MODELS
from tirefit.params import specs


def derived(model, values, channel="fx"):
    template = MODELS[model]
    free = tuple(FreeParameter(k, s) for k, s in specs(template).items() if k in values)
    layout = Layout(free)
    z = np.asarray(layout.unconstrained(values))[None]
    slip = "sigma_x" if channel == "fx" else "alpha"
    found = derived_values(template, layout, z, channel, slip, FZ, 20.0)
    return {name: float(value[0]) for name, value in found.items()}


@pytest.mark.parametrize("channel", ["fx", "fy"])
def test_brush_peaks_where_it_slides_entirely(channel):
    found = derived("brush", TRUTH, channel)
    # S(11): full sliding at 3 mu F_z / C with C = 2 c.
    np.testing.assert_allclose(
        found["slip_at_peak"], 1.5 * TRUTH["mu"] * FZ / TRUTH["cpa2"], rtol=1e-3
    )
    np.testing.assert_allclose(found["F_max"], TRUTH["mu"] * FZ, rtol=1e-9)
    np.testing.assert_allclose(found["C_x"], 2 * TRUTH["cpa2"], rtol=1e-9)
    np.testing.assert_allclose(found["mu_fz"], TRUTH["mu"] * FZ, rtol=1e-9)


@pytest.mark.parametrize("m", [0.7, 0.85])
def test_peak_with_kinetic_friction(m):
    found = derived("brush-m", TRUTH | {"m": m})
    mu, c = TRUTH["mu"], TRUTH["cpa2"]
    # F(u)/(mu F_z) with rho = 3 u/4 is 3u(1 - u/2)^2/2 + m u^2 (3 - u)/4; its slope is
    # zero at u = 2/(3 - 2m) (S(32)), where it is (4 - 3m)/(3 - 2m)^2 (S(33)).
    np.testing.assert_allclose(
        found["slip_at_peak"], 1.5 * mu * FZ / c / (3 - 2 * m), rtol=1e-4
    )
    peak = (4 - 3 * m) / (3 - 2 * m) ** 2
    np.testing.assert_allclose(found["F_max"], mu * FZ * peak, rtol=1e-8)
    np.testing.assert_allclose(found["F_max_over_fz"], mu * peak, rtol=1e-8)


def test_uniform_pressure_has_no_peak():
    found = derived("uniform", TRUTH)
    assert np.isnan(found["slip_at_peak"])
    assert found["F_max"] < TRUTH["mu"] * FZ


def test_magic_formula_has_no_static_friction():
    found = derived("magic-formula", {"B": 10.0, "C": 1.6, "D": 0.9, "E": 0.0})
    np.testing.assert_allclose(found["C_x"], 10 * 1.6 * 0.9 * FZ, rtol=1e-9)
    np.testing.assert_allclose(found["F_max"], 0.9 * FZ, rtol=1e-8)
    kappa = np.tan(np.pi / 2 / 1.6) / 10
    np.testing.assert_allclose(found["slip_at_peak"], kappa / (1 - kappa), rtol=1e-4)
    assert "mu_fz" not in found


def test_uncertainty_follows_from_the_parameters(given):
    mu, stiffness = given.least_squares["mu"], given.least_squares["cpa2"]
    found = given.derived
    # 512 draws: 3 % of a standard deviation, four of them.
    np.testing.assert_allclose(found["C_x"].std, 2 * stiffness.std, rtol=0.13)
    np.testing.assert_allclose(found["mu_fz"].std, mu.std * FZ, rtol=0.13)
    np.testing.assert_allclose(found["mu_fz"].value, mu.value * FZ, rtol=1e-9)
    low, high = found["F_max"].ci95
    np.testing.assert_allclose(
        [low, high], np.array(mu.ci95) * FZ, atol=0.4 * FZ * mu.std
    )
    assert found["C_x"].unit == "N" and found["slip_at_peak"].unit == "-"


def test_what_is_not_defined_has_no_number():
    end = solved(curve(), GIVEN, "uniform")
    draws = end.z + 1e-3 * np.random.default_rng(0).standard_normal((40, 2))
    found = derived_estimates(end, draws)
    slip = found["slip_at_peak"]
    assert not slip.identified and np.isnan(slip.value)
    assert slip.std is None and slip.ci95 == (None, None)
    assert found["C_x"].identified and found["C_x"].std > 0
