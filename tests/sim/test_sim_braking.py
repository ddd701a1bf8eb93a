"""The wheel of S section 5.1 and the rig: balances and another integrator."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import tirefit
from tirefit.models import LuGre, TireInputs, forces
from tirefit.sim.braking import (
    BRAKE_GAIN,
    LOAD,
    PEAK,
    STEADY,
    Braking,
    braked_wheel,
    lugre_tire,
    simulate_braking,
    source_tire,
)
from tirefit.sim.simulate import simulate


def test_the_source_tire_has_the_printed_values():
    tire = source_tire()
    assert abs(float(tire.pure(0.04, LOAD)) / (PEAK * LOAD) - 0.6) < 1e-12
    assert abs(float(tire.pure(1e-6, LOAD)) / 1e-6 - 5e5) < 1.0
    softer = source_tire(0.5)
    assert abs(float(softer.pure(1e-6, LOAD)) / 1e-6 - 5e5) < 1.0
    assert float(softer.pure(np.linspace(0, 1, 500), LOAD).max()) <= 0.5 * LOAD


def test_the_wheel_motion_agrees_with_scipy():
    # Of four teeth, as the logs below, which then share its program: the first.
    how = Braking(amplitude=0.6, teeth=4, slip_variance=0, force_variance=0)
    truth = {name: values[:200] for name, values in simulate_braking(how).truth.items()}
    tire = source_tire()

    def rate(t, omega):
        force = float(tire.pure(1 - omega[0] * how.radius / how.speed, how.load))
        torque = 0.6 * how.radius * PEAK * LOAD * t / 2
        return [(how.radius * force - torque) / how.inertia]

    peer = solve_ivp(rate, (0, 1.99), [40.0], "LSODA", truth["time"], rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(truth["omega"], peer.y[0], rtol=1e-6)
    np.testing.assert_allclose(
        truth["sigma_x"], how.speed / (truth["omega"] * how.radius) - 1, rtol=1e-9
    )


@pytest.mark.long
def test_a_braking_of_too_many_steps_is_refused_with_a_remedy():
    numbers = 4e3, 2.0, 0.3, 1.0, 12.0, LOAD, np.inf, 0.01
    tires = source_tire(), source_tire()
    with pytest.raises(tirefit.UsageError, match="(?s)more than 3 steps.*remedy: shorten"):
        braked_wheel(numbers, tires, STEADY, np.arange(5) / 100, 1, max_steps=3)


def test_noise_has_exactly_the_requested_variance():
    def made(seed):
        how = Braking(teeth=4, slip_variance=1e-5, force_variance=4e-4, seed=seed)
        return simulate_braking(how)

    logs = [made(seed) for seed in range(5)]
    noise = np.concatenate([log.columns["sigma_x"] - log.truth["sigma_x"] for log in logs])
    assert abs(np.var(noise) / 1e-5 - 1) < 0.1  # 4,000 rows: 2 %
    noise = np.concatenate([log.columns["fx"] - log.truth["fx"] for log in logs]) / LOAD
    assert abs(np.var(noise) / 4e-4 - 1) < 0.1
    np.testing.assert_array_equal(made(4).columns["fx"], logs[4].columns["fx"])


def test_a_wheel_locks_on_ice_and_recovers():
    log = simulate_braking(Braking(amplitude=0.75, teeth=4, drop=(4.5, 0.2)))
    sigma, time = log.truth["sigma_x"], log.truth["time"]
    assert sigma[time < 4.5].max() < 0.1
    assert sigma[(time > 5.5) & (time < 6)].max() > 90  # locked
    assert np.isfinite(sigma).all()
    assert set(np.unique(log.truth["mu"])) == {0.2, 0.98}
    # At 7.9 s the brake asks for more than ice holds; at 6.4 s for less.
    assert sigma[np.isclose(time, 6.4)] < 0.1


def test_a_lugre_wheel_satisfies_the_balance_and_its_steady_force():
    how = Braking(tire="lugre", teeth=1, rate=1000, friction=0.7, amplitude=0.7)
    truth = simulate_braking(how).truth
    slope = np.gradient(truth["omega"], truth["time"])
    balance = how.radius * truth["fx"] - truth["torque"]
    start, end = 100, -5  # the bristles have come in, the tooth is not over
    np.testing.assert_allclose(
        how.inertia * slope[start:end], balance[start:end], atol=1e-3 * 0.5 * LOAD
    )
    # Two seconds are slow for bristles that pass the patch in 10 ms.
    tire = lugre_tire(0.7, how.speed)
    at = TireInputs(sigma_x=truth["sigma_x"], fz=np.full(2000, LOAD), v=np.full(2000, 20.0))
    steady = np.asarray(forces(tire, at).fx)
    np.testing.assert_allclose(truth["fx"][200:], steady[200:], rtol=0.02)
    at_rest = TireInputs(sigma_x=np.full(2000, 1e-6), fz=LOAD, v=20.0)
    np.testing.assert_allclose(forces(tire, at_rest).fx, 2e-6 * truth["cpa2"][0], rtol=1e-4)


def test_the_lugre_tire_has_the_requested_peak():
    slip = np.geomspace(0.005, 3, 2000)
    for peak, v in ((0.98, 20.0), (0.3, 8.0)):
        tire = lugre_tire(peak, v)
        found = forces(tire, TireInputs(sigma_x=slip, fz=1.0, v=v)).fx
        assert abs(float(np.max(found)) - peak) < 1e-3
        assert tire.mu_s / tire.mu_c == LuGre().mu_s / LuGre().mu_c
    with pytest.raises(tirefit.UsageError, match="no tire 'brush'"):
        simulate("braking", tire="brush")


def test_the_brake_pressure_gives_the_torque():
    log = simulate_braking(Braking(teeth=4)).columns
    np.testing.assert_allclose(log["brake_pressure"] * BRAKE_GAIN * 0.5, log["torque"])


@pytest.mark.parametrize("lateral", [False, True])
def test_a_fit_recovers_the_tire_of_a_rig_sweep(lateral):
    values = {"cpa2": 6e4, "mu": 0.8}
    made = simulate("rig", model="brush", values=values, lateral=lateral, load=[3e3, 5e3])
    data = tirefit.read_frame(made.columns)
    fit = tirefit.fit(data, "brush", config={"force": "fy" if lateral else "fx"})
    for name, truth in values.items():
        estimate = fit.parameters[name]
        assert abs(estimate.value - truth) < 4 * estimate.std
    assert set(made.truth) == set(made.columns)
