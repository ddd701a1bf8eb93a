"""Lateral friction from positions, S section 3.3, checked independently."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from drives import STIFFNESS, drive, estimated
from scipy.optimize import least_squares
from scipy.signal import lsim

from tirefit.online.base import Flag, code
from tirefit.online.methods import estimator_of
from tirefit.online.position import Filtered, filtered_step
from tirefit.online.regression import Regressors


def test_filtered_signals_and_derivatives_agree_with_scipy():
    a, dt = 4.0, 0.005
    time = np.arange(0, 4, dt)
    u = np.sin(2 * time) ** 3
    state, rows, step = Filtered(*[jnp.zeros(1)] * 3), [], jax.jit(filtered_step)
    for value in u:
        state = step(state, jnp.array([value]), dt, a)
        rows.append([state.value(a)[0], state.rate(a)[0], state.acceleration(a)[0]])
    bottom = [1, 2 * a, a * a]
    for k, top in enumerate(([a * a], [a * a, 0], [a * a, 0, 0])):
        _, peer, _ = lsim((top, bottom), u, time)
        np.testing.assert_allclose(np.array(rows)[:, k], peer, atol=1e-3)


def test_force_and_slip_follow_the_corrected_equations_not_the_printed():
    truth = drive(bend=0.5, duration=25.0).truth
    time, mass, inertia, l_f, l_r = truth["time"], 1500, 2500, 1.2, 1.4

    def slope(x):
        return np.gradient(x, time)

    swerve, bend = slope(slope(truth["offset"])), slope(truth["road_heading"])
    yaw = inertia / (mass * l_r) * slope(truth["yaw_rate"])
    lever = mass * l_r / (l_f + l_r)
    inner = slice(20, -20)
    right = lever * (swerve + truth["v"] * bend + yaw)
    printed = lever * (swerve + bend * yaw)
    largest = np.max(abs(truth["fy_f"]))
    # The small-angle equations leave out 1 % of the force.
    assert np.max(abs(right - truth["fy_f"])[inner]) < 0.02 * largest
    assert np.max(abs(printed - truth["fy_f"])[inner]) > 0.5 * largest


def test_the_estimate_agrees_with_least_squares_with_forgetting():
    estimator = estimator_of("position", 1.0, {"forgetting": 0.99})
    random = np.random.default_rng(0)
    u0 = random.uniform(0.2, 1.2, 300)
    rows = np.c_[u0, -(u0**2) / 2.7, u0**3 / (27 * 0.81)]
    theta = np.exp(0.1) * np.array([1, 1.8 * np.exp(0.1), (1.8 * np.exp(0.1)) ** 2])
    y = rows @ theta + 0.01 * random.standard_normal(300)
    law, adapted = estimator.init().law, jax.jit(estimator._adapted)
    for row, value in zip(rows, y, strict=True):
        law, flag, _ = adapted(law, Regressors(value, *row))
    weights = 0.99 ** (0.5 * np.arange(299, -1, -1))
    _, noise = estimator.uncertainty(law)

    def residuals(x):
        theta0 = np.exp(x[0])
        theta = np.array([theta0, theta0**2 * x[1], theta0**3 * x[1] ** 2])
        of_prior = np.array([x[0] / 0.3, (x[1] - 1) / 1.0])
        return np.r_[weights * (y - rows @ theta) / float(noise), of_prior]

    batch = least_squares(residuals, [0.0, 1.0], xtol=1e-14, ftol=1e-14)
    np.testing.assert_allclose(law.x, batch.x, rtol=1e-5)
    covariance = np.linalg.inv(batch.jac.T @ batch.jac)
    np.testing.assert_allclose(estimator.uncertainty(law)[0], covariance, rtol=1e-3)
    assert int(flag) == 0


@pytest.mark.parametrize(("friction", "bend"), [(0.9, 0.6), (0.3, 0.55)])
def test_the_truth_lies_within_the_stated_spread(friction, bend):
    pulls = []
    for seed in range(3):
        log = drive(friction=friction, bend=bend, seed=seed, duration=25.0)
        end = estimated("position", log.columns)
        truth = np.array([friction, STIFFNESS["C_f"]])
        pulls.append((end.value[-1] - truth) / end.own_std[-1])
        assert end.own_std[-1, 0] < 0.2 * friction
        assert np.count_nonzero(end.flag == code(Flag.CHANGED)) == 0
    assert np.sqrt(np.mean(np.square(pulls))) < 2


def test_a_straight_road_is_flagged_as_uninformative():
    log = drive(bend=0.02, duration=25.0)
    end = estimated("position", log.columns)
    said = {code(Flag.SETTLING), code(Flag.LITTLE_EXCITATION)}
    assert set(end.flag) <= said and end.flag[-1] == code(Flag.LITTLE_EXCITATION)
    assert end.std[-1, 0] > 0.5


def test_missing_rows_are_flagged_and_restart_the_filter():
    log = drive(bend=0.5, duration=25.0)
    columns = {k: v.copy() for k, v in log.columns.items()}
    columns["offset"][400:410] = np.nan
    columns["heading"][1000:] += 2 * np.pi  # as a compass that wraps
    columns["road_heading"][1100:] -= 2 * np.pi
    kept = np.r_[:600, 700:1250]  # two seconds that are not there
    columns = {k: v[kept] for k, v in columns.items()}
    end, whole = estimated("position", columns), estimated("position", log.columns)
    assert np.all(end.flag[400:410] == code(Flag.MISSING))
    assert end.flag[600] == code(Flag.GAP)
    assert np.all(end.flag[601:720] == code(Flag.SETTLING))
    assert np.all(np.isfinite(end.value)) and np.all(end.std[-1] > 0)
    assert np.all(abs(end.value[-1] - whole.value[-1]) < 2 * whole.std[-1])
