"""The simulated drive, checked by another integrator and by balances."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tirefit.results import UsageError
from tirefit.sim.drive import Car, Drive, simulate_drive

CAR = Car()
SHORT = {"duration": 1.6, "bend": 0.5, "bend_period": 3.0, "brake": 0.5, "rate": 100.0}
ICE = {**SHORT, "bend": 0.0, "brake": 0.9, "drop": (1.0, 0.2)}
STEPS = 2**14
"""Of every drive here, which has 160 rows: one program serves all."""


def simulated(**how):
    return simulate_drive(Drive(**how), max_steps=STEPS)


def wheel_forces(omega, v_x, v_y, r, delta, loads, mu):
    """Forces (4,) of S(12) on the resultant slip, along and across."""
    front = delta - np.arctan((v_y + CAR.l_f * r) / v_x)
    alpha = np.array([front] * 2 + [-np.arctan((v_y - CAR.l_r * r) / v_x)] * 2)
    speed = v_x + CAR.track / 2 * r * np.array([-1, 1, -1, 1])
    sigma = speed / (omega * CAR.radius) - 1
    stiffness = np.array([CAR.stiffness_f] * 2 + [CAR.stiffness_r] * 2)
    across = np.tan(alpha) * (1 + sigma)
    slip = np.maximum(np.hypot(sigma, across), 1e-12)
    stuck = np.maximum(1 - stiffness * slip / (3 * mu), 0)
    force = mu * loads * (1 - stuck**3)
    return force * sigma / slip, force * across / slip


@pytest.mark.long
def test_the_motion_of_the_car_agrees_with_scipy():
    how = Drive(**SHORT)
    truth = simulated(**SHORT).truth
    time = truth["time"]
    given = {
        k: [np.interp(t, time, truth[k]) for t in time]
        for k in ("steering", "torque_fl", "torque_rl")
    }
    weight = CAR.mass * 9.81 / 2.6

    def rate(t, s):
        v_x, v_y, r, *omega, roll, p, lag = s
        omega = np.array(omega)
        delta, front, rear = (np.interp(t, time, given[k]) for k in given)
        shift = CAR.mass * CAR.height * lag / 2.6
        moment = CAR.roll_stiffness * roll + CAR.roll_damping * p
        aside = moment / CAR.track / 2 * np.array([-1, 1, -1, 1])
        axles = np.array([weight * CAR.l_r + shift, weight * CAR.l_f - shift])
        loads = np.repeat(axles / 2, 2) + aside
        along, across = wheel_forces(omega, v_x, v_y, r, delta, loads, how.friction)
        turn = np.array([delta, delta, 0, 0])
        ahead = -along * np.cos(turn) - across * np.sin(turn)
        left = across * np.cos(turn) - along * np.sin(turn)
        arms = np.array([CAR.l_f, CAR.l_f, -CAR.l_r, -CAR.l_r])
        tracks = CAR.track / 2 * np.array([1, -1, 1, -1])
        a_x, a_y = ahead.sum() / CAR.mass, left.sum() / CAR.mass
        spin = CAR.radius * along - np.array([front, front, rear, rear])
        rolled = CAR.height * left.sum() - moment
        return [
            a_x + v_y * r,
            a_y - v_x * r,
            np.sum(arms * left - tracks * ahead) / CAR.yaw_inertia,
            *(spin / CAR.wheel_inertia),
            p,
            rolled / CAR.roll_inertia,
            (-a_x - lag) / 0.1,
        ]

    start = [25.0, 0, 0, *[25 / CAR.radius] * 4, 0, 0, 0]
    peer = solve_ivp(rate, (0, 0.6), start, "LSODA", [0.2, 0.6], rtol=1e-6, atol=1e-8)
    rows = [20, 60]
    names = ("v", "v_y", "yaw_rate", "omega_fl", "omega_fr", "omega_rl", "omega_rr")
    ours = np.array([truth[name][rows] for name in names])
    # The steering is interpolated between rows: 1e-4 of what it does.
    np.testing.assert_allclose(ours, peer.y[:7], rtol=1e-4, atol=2e-5)
    assert abs(ours[2, 1]) > 0.05 and ours[0, 1] < 24.9  # it turns and brakes


def test_forces_and_motion_are_in_balance():
    truth = simulated(**SHORT).truth
    time, n = truth["time"], len(truth["time"])
    inner = slice(5, n - 5)
    yaw_acceleration = np.gradient(truth["yaw_rate"], time)
    turned = CAR.yaw_inertia * yaw_acceleration
    arms = CAR.l_f * truth["fy_f"] - CAR.l_r * truth["fy_r"]
    assert np.max(abs(turned - arms)[inner]) < 0.1 * np.max(abs(arms))
    loads = sum(truth[f"fz_{w}"] for w in ("fl", "fr", "rl", "rr"))
    np.testing.assert_allclose(loads, CAR.mass * 9.81, rtol=1e-9)
    course = truth["heading"] + np.arctan(truth["v_y"] / truth["v"])
    np.testing.assert_allclose(
        (np.gradient(truth["y"], time) / np.gradient(truth["x"], time))[inner],
        np.tan(course)[inner],
        atol=1e-4,
    )


def test_noise_has_the_stated_level_and_follows_the_seed():
    one, two, other = (simulated(**SHORT, seed=k) for k in (1, 1, 2))
    np.testing.assert_array_equal(one.columns["offset"], two.columns["offset"])
    assert np.any(one.columns["offset"] != other.columns["offset"])
    for name, std in (("offset", 0.02), ("yaw_rate", 0.002), ("omega_rr", 0.05)):
        noise = one.columns[name] - one.truth[name]
        assert abs(np.std(noise) / std - 1) < 0.25  # 160 rows: 5.6 %
    np.testing.assert_array_equal(one.columns["steering"], one.truth["steering"])


def test_wheels_lock_on_a_slippery_road_with_finite_values():
    # They stand from 1.26 s on, which takes many steps.
    truth = simulated(**ICE | {"duration": 1.3, "rate": 160 / 1.3}).truth
    assert set(truth["mu"]) == {0.9, 0.2}
    assert truth["sigma_x_fl"].max() > 90 and truth["sigma_x_fl"][40] < 0.2
    assert all(np.isfinite(values).all() for values in truth.values())


def test_an_impossible_drive_is_refused_with_a_remedy():
    said = f"(?s)than {STEPS} steps: a car spins.*remedy: reduce the lateral"
    with pytest.raises(UsageError, match=said):
        simulated(**ICE)
