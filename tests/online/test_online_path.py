"""Path prediction, S section 3.8: its parts checked independently, and the whole."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from drives import STIFFNESS, drive, estimated
from scipy.integrate import solve_ivp

from tirefit.online.base import FLAGS, Flag, code
from tirefit.online.methods import estimator_of
from tirefit.online.path import Observer, WheelRls, bicycle, lane_crossing, observer_std

C_F, C_R, MASS, INERTIA, L_F, L_R, U = 9e4, 8e4, 1500.0, 2500.0, 1.2, 1.4, 25.0
MATRICES = bicycle(C_F, C_R, MASS, INERTIA, L_F, L_R, jnp.asarray(U))


def test_the_bicycle_satisfies_the_force_balance_unlike_the_printed_one():
    _, dy, aside, r = x = np.array([0.1, 0.7, 0.03, 0.2])
    delta, bend = 0.02, 0.15
    v_y = dy - U * aside
    front = C_F * (delta - (v_y + L_F * r) / U)
    rear = -C_R * (v_y - L_R * r) / U
    turned = (L_F * front - L_R * rear) / INERTIA
    rates = [dy, (front + rear) / MASS - U * bend, r - bend, turned]
    a, steered, bent = map(np.array, MATRICES)
    np.testing.assert_allclose(a @ x + steered * delta + bent * bend, rates, rtol=1e-9)
    # S(22) as printed, C negative and of one tire: u under the heading, m for I_z.
    c_f, c_r = -C_F / 2, -C_R / 2
    printed = a.copy()
    printed[1, 2] = -2 * (c_f + c_r) / (MASS * U)
    printed[1, 3] = 2 * (c_f * L_F + c_r * L_R) / (MASS * U)
    wrong = printed @ x + steered * delta + bent * bend
    assert abs(wrong[1] - rates[1]) > 1.0
    np.testing.assert_allclose(a[1, 1], 2 * (c_f + c_r) / (MASS * U))


def test_the_lane_departure_time_agrees_with_scipy():
    a, steered, bent = map(np.asarray, MATRICES)
    state, push = np.array([0.0, 0.1, 0.0, 0.0]), steered * 0.004 + bent * 0.01

    def edge(t, x):
        return abs(x[0]) - 0.9

    edge.terminal = True
    peer = solve_ivp(lambda t, x: a @ x + push, (0, 4), state, events=edge, rtol=1e-9, atol=1e-9)
    crossing = jax.jit(lane_crossing)
    time = crossing(state, a, push, 0.9, 4.0)
    # Between steps of 0.1 s the path is taken to be straight.
    assert abs(float(time) - peer.t_events[0][0]) < 5e-3
    assert np.isnan(crossing(np.zeros(4), a, 0 * push, 0.9, 4.0))


def wheel_log(n, force=2500.0, noise=0.0, seed=0, dt=0.01):
    random = np.random.default_rng(seed)
    torque = 700.0 + 100.0 * random.standard_normal(n)
    omega = 80 + np.cumsum(dt * (0.3 * force - torque) / 1.2)
    return omega + noise * random.standard_normal(n), torque


def test_the_observer_finds_the_force_and_its_errors_shrink_as_stated():
    omega, torque = wheel_log(100)
    state, errors = Observer(omega[0], 0.0), []
    for k in range(1, 100):
        state = state.after(omega[k], torque[k], 0.01, 0.3, 1.2, 20.0)
        errors.append(float(state.force) - 2500.0)
    assert abs(errors[-1]) < 1e-3
    # Both poles at exp(-p dt): from one step to the next the ratio comes there.
    assert abs(errors[60] / errors[59] - np.exp(-0.2)) < 0.02
    logs = [wheel_log(60, noise=0.05, seed=seed) for seed in range(200)]
    omega, torque = np.moveaxis(np.array(logs), 0, 2)
    state = Observer(omega[0], np.full(200, 2500.0))
    for k in range(1, 60):
        state = state.after(omega[k], torque[k], 0.01, 0.3, 1.2, 8.0)
    stated = float(observer_std(0.05, 0.0, 0.01, 0.3, 1.2, 8.0))
    assert abs(np.std(state.force) / stated - 1) < 0.2  # 200 runs: 5 %, and p dt = 0.08


def test_the_force_of_the_axle_has_the_noise_of_two_wheels():
    random, true = np.random.default_rng(4), wheel_log(60, dt=0.02)
    wheels = true[0] + 0.05 * random.standard_normal((2, 400, 60))
    seen = wheels.mean(axis=0).T  # the observer follows the mean of both
    state = Observer(seen[0], np.full(400, 2500.0))
    for k in range(1, 60):
        state = state.after(seen[k], true[1][k], 0.02, 0.3, 1.2, 8.0)
    path = estimator_of("path", 1.0, {"pole": 8.0, "torque_std": 0.0})
    stated = path.estimate(path.init()).std[path.method.parameters.index("F_xf")]
    assert abs(np.std(2 * state.force) / stated - 1) < 0.2


def test_rls_of_the_wheel_without_forgetting_agrees_with_least_squares():
    omega, torque = wheel_log(80, noise=0.05, seed=3)
    state = WheelRls(omega[0], 1000.0, 1e12)
    for k in range(1, 80):
        state = state.after(omega[k], torque[k], 0.01, 0.3, 1.2, 1e9, 0.05)
    seen = (np.diff(omega) + torque[1:] * 0.01 / 1.2) / (0.3 * 0.01 / 1.2)
    np.testing.assert_allclose(state.force, seen.mean(), rtol=1e-6)
    lever = 0.3 * 0.01 / 1.2
    np.testing.assert_allclose(state.spread, 2 * 0.05**2 / lever**2 / 79, rtol=1e-4)


def test_a_correction_by_the_path_agrees_with_gaussian_conditioning():
    estimator = estimator_of("path", 1.0)
    random = np.random.default_rng(0)
    root = random.standard_normal((6, 6))
    mean, covariance = 0.01 * random.standard_normal(6), 1e-4 * root @ root.T
    state = estimator.init()._replace(z=jnp.array(mean), covariance=jnp.array(covariance))
    seen = np.array([0.05, 0.01, -0.02])
    sample = dict(zip(("offset", "heading", "yaw_rate"), seen, strict=True))
    after = jax.jit(estimator._corrected)(state, sample | {"road_heading": 0.0})
    rows = np.eye(6)[[0, 2, 3]]
    joint = rows @ covariance @ rows.T + np.diag([0.02, 0.002, 0.002]) ** 2
    gain = covariance @ rows.T @ np.linalg.inv(joint)
    np.testing.assert_allclose(after.z, mean + gain @ (seen - rows @ mean), rtol=1e-8)
    np.testing.assert_allclose(
        after.covariance, covariance - gain @ rows @ covariance, rtol=1e-6, atol=1e-12
    )


@pytest.mark.long
def test_the_truth_lies_within_the_stated_spread():
    log = drive(bend=0.5, brake=0.3, duration=25.0)
    truth, end = log.truth, estimated("path", log.columns)
    late = slice(500, None)
    mu, mu_std = end.value[late, 0], end.own_std[late, 0]
    assert np.mean(abs(mu - 0.9) < 2.5 * mu_std) > 0.9 and mu_std[-1] < 0.3
    force = truth["fx_fl"] + truth["fx_fr"]
    for k in (3, 4):  # the fall of a saw-tooth takes them some samples
        assert np.mean(abs(end.value[late, k] - force[late]) < 4 * end.std[late, k]) > 0.85
    gentle = estimated("path", drive(bend=0.15, duration=25.0).columns)
    for k, name in ((1, "C_f"), (2, "C_r")):
        pull = (gentle.value[-1, k] - STIFFNESS[name]) / gentle.std[-1, k]
        assert abs(pull) < 3 and gentle.std[-1, k] < 0.1 * STIFFNESS[name]


def test_a_force_near_the_limit_gives_a_warning():
    log = drive(bend=0.7, duration=25.0)
    end = estimated("path", log.columns, {"warn": 0.75})
    truth = abs(log.truth["fy_f"]) / (log.truth["fz_fl"] + log.truth["fz_fr"]) / 0.9
    warned = end.flag == code(Flag.NEAR_LIMIT)
    assert np.count_nonzero(warned) > 5
    assert np.all(truth[warned] > 0.6) and np.all(warned[truth < 0.5] == 0)


def test_missing_rows_are_flagged_and_bridged():
    log = drive(bend=0.5, brake=0.3, duration=25.0)
    columns = {k: v.copy() for k, v in log.columns.items()}
    columns["torque_fl"][400:410] = np.nan
    kept = np.r_[:600, 700:1250]
    columns = {k: v[kept] for k, v in columns.items()}
    end, whole = estimated("path", columns), estimated("path", log.columns)
    assert np.all(end.flag[400:410] == code(Flag.MISSING))
    assert FLAGS[end.flag[600]] is Flag.GAP
    assert np.all(np.isfinite(end.value[1:, :6]))
    close = abs(end.value[-1, :3] - whole.value[-1, :3]) < 2 * whole.std[-1, :3]
    assert np.all(close)
