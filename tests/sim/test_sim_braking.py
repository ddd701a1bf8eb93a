"""The wheel of S section 5.1 and the rig, against balances and another integrator."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import tirefit
from tirefit.sim.braking import LOAD, PEAK, Braking, simulate_braking, source_tire
from tirefit.sim.rig import simulate_rig


def test_the_source_tire_has_what_is_printed():
    tire = source_tire()
    assert abs(float(tire.pure(0.04, LOAD)) / (PEAK * LOAD) - 0.6) < 1e-12
    assert abs(float(tire.pure(1e-6, LOAD)) / 1e-6 - 5e5) < 1.0
    softer = source_tire(0.5)
    assert abs(float(softer.pure(1e-6, LOAD)) / 1e-6 - 5e5) < 1.0
    assert float(softer.pure(np.linspace(0, 1, 500), LOAD).max()) <= 0.5 * LOAD


def test_the_wheel_moves_as_scipy_integrates_it():
    how = Braking(amplitude=0.6, teeth=1, slip_variance=0, force_variance=0)
    truth, tire = simulate_braking(how).truth, source_tire()

    def rate(t, omega):
        force = float(tire.pure(1 - omega[0] * how.radius / how.v, how.fz))
        torque = 0.6 * how.radius * PEAK * LOAD * t / 2
        return [(how.radius * force - torque) / how.inertia]

    peer = solve_ivp(
        rate, (0, 1.99), [40.0], "LSODA", truth["time"], rtol=1e-8, atol=1e-9
    )
    np.testing.assert_allclose(truth["omega"], peer.y[0], rtol=1e-6)
    np.testing.assert_allclose(
        truth["sigma_x"], how.v / (truth["omega"] * how.radius) - 1, rtol=1e-9
    )


def test_noise_has_the_variance_asked_for_and_no_other():
    log = simulate_braking(Braking(teeth=20, slip_variance=1e-5, force_variance=4e-4))
    noise = log.columns["sigma_x"] - log.truth["sigma_x"]
    assert abs(np.var(noise) / 1e-5 - 1) < 0.1
    noise = (log.columns["fx"] - log.truth["fx"]) / LOAD
    assert abs(np.var(noise) / 4e-4 - 1) < 0.1
    again = simulate_braking(Braking(teeth=20, slip_variance=1e-5, force_variance=4e-4))
    np.testing.assert_array_equal(again.columns["fx"], log.columns["fx"])


def test_a_wheel_locks_on_ice_and_comes_back():
    log = simulate_braking(Braking(amplitude=0.75, teeth=4, drop=(4.5, 0.2)))
    sigma, time = log.truth["sigma_x"], log.truth["time"]
    assert sigma[time < 4.5].max() < 0.1
    assert sigma[(time > 5.5) & (time < 6)].max() > 90  # locked
    assert np.isfinite(sigma).all()
    assert set(np.unique(log.truth["mu"])) == {0.2, 0.98}
    # At 7.9 s the brake asks for more than ice holds; at 6.4 s for less.
    assert sigma[np.isclose(time, 6.4)] < 0.1


@pytest.mark.parametrize("lateral", [False, True])
def test_a_rig_sweep_is_fitted_back(lateral):
    values = {"cpa2": 6e4, "mu": 0.8}
    made = simulate_rig("brush", values, lateral=lateral, loads=[3e3, 5e3])
    data = tirefit.read_frame(made.columns)
    fit = tirefit.fit(data, "brush", config={"force": "fy" if lateral else "fx"})
    for name, truth in values.items():
        estimate = fit.parameters[name]
        assert abs(estimate.value - truth) < 4 * estimate.std
    assert set(made.truth) == set(made.columns)
