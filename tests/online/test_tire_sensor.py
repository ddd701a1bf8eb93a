"""``tire-sensor`` compared with the brush solved for slip and friction directly."""

import jax
import numpy as np
import pytest
from scipy.optimize import brentq

from fits.formulas import brush
from tirefit.online.base import FLAGS, Flag
from tirefit.online.methods import estimator_of
from tirefit.online.run import run
from tirefit.online.tire_sensor import TireSensor, gough, seen

LOAD, CPA2, LENGTH = 4e3, 4e4, 0.08
SETTINGS = {"cpa2": CPA2, "half_length": LENGTH, "average": 1}
SETTINGS |= {"force_noise": 1e-5, "moment_noise": 1e-6}


def patch(alpha, mu, bristles=20_000):
    """Lateral force and moment, bristle by bristle over the contact patch."""
    x = (np.arange(bristles) + 0.5) / bristles * 2 - 1
    demand = CPA2 * np.tan(alpha) * (1 - x)
    limit = mu * LOAD * 0.75 * (1 - x**2)
    stress = np.minimum(demand, limit)
    return 2 * stress.mean(), LENGTH * 2 * (x * stress).mean()


def samples(alphas, mus):
    forces = np.array([patch(a, m) for a, m in zip(alphas, mus, strict=True)])
    n = len(forces)
    return {
        "time": np.arange(n) / 100,
        "fy": forces[:, 0],
        "fz": np.full(n, LOAD),
        "mz": forces[:, 1],
    }


@pytest.mark.parametrize("side", [1, -1])
def test_slip_angle_and_friction_of_a_numeric_patch_are_found(side):
    mus = np.repeat([0.3, 0.6, 1.0], 6)
    full = np.arctan(3 * mus * LOAD / (2 * CPA2))
    alphas = full * np.tile([0.2, 0.35, 0.5, 0.65, 0.8, 0.95], 3)
    data = samples(alphas, mus)
    data |= {"fy": side * data["fy"], "mz": side * data["mz"]}
    _, estimate = run(estimator_of("tire-sensor", LOAD, SETTINGS), data)
    mu, alpha, used = estimate.value.T
    # The network's own error, three of its root mean square of 0.0066.
    truth = 1 - (1 - alphas / full) ** 3  # near: tan is alpha here to 0.3 %
    np.testing.assert_allclose(used, truth, atol=0.02)
    np.testing.assert_allclose(mu, mus, rtol=0.03)
    # Of theta over the force, which is what it was trained on.
    assert np.all(abs(alpha - side * alphas) < 0.03 * 3 * abs(data["fy"]) / (2 * CPA2))
    assert not np.any(estimate.flag)


def test_the_gough_plot_agrees_with_the_patch():
    alpha, mu = 0.06, 0.7
    sliding = 2 * CPA2 * np.tan(alpha) / (3 * LOAD) / mu
    y, m = gough(sliding, mu)
    force, moment = patch(alpha, mu)
    np.testing.assert_allclose([y * LOAD, -m * LOAD * LENGTH], [force, moment], rtol=1e-4)
    np.testing.assert_allclose(force, brush(np.tan(alpha), LOAD, 0.0, CPA2, mu), rtol=1e-4)


def test_implausible_inputs_are_flagged():
    points = {
        (0.5, 0.02): True,
        (1.3, 0.0): False,  # more force than friction of 1.2 gives
        (0.5, 0.16): False,  # more moment than a tire that does not slide has
        (0.5, -0.01): False,
        (0.01, 0.001): False,  # hardly any force
        (0.05, 0.001): False,  # below friction of 0.1
        (0.05, 0.014): True,
        (0.69, 0.126): True,
    }
    for (y, m), inside in points.items():
        assert bool(seen(y, m)) is inside, (y, m)
    assert bool(seen(0.5, -0.01, 0.0, 0.005))  # noise could have done that
    random = np.random.default_rng(0)
    mu, sliding = random.uniform(0.1, 1.2, 500), random.uniform(0.2, 1.0, 500)
    assert np.all(jax.vmap(lambda a, b: seen(*gough(a, b), 1e-9, 1e-9))(sliding, mu))


def test_a_flagged_row_keeps_the_last_estimate():
    data = samples([0.05, 0.05, 0.05], [0.7, 0.7, 0.7])
    data["mz"][1] = -0.2 * LOAD * LENGTH
    _, estimate = run(estimator_of("tire-sensor", LOAD, SETTINGS), data)
    assert FLAGS[estimate.flag[1]] is Flag.OUT_OF_RANGE
    assert np.all(estimate.value[1] == estimate.value[0])
    assert FLAGS[estimate.flag[2]] is Flag.OK


def test_the_stated_spread_agrees_with_many_samples():
    n, noise = 3000, {"force_noise": 0.01, "moment_noise": 0.002, "own_error": 0.0}
    data = samples([0.06], [0.7])
    random = np.random.default_rng(1)
    data = {k: np.repeat(v, n) for k, v in data.items()} | {"time": np.arange(n) / 100}
    data["fy"] += 0.01 * LOAD * random.normal(size=n)
    data["mz"] += 0.002 * LOAD * LENGTH * random.normal(size=n)
    _, estimate = run(estimator_of("tire-sensor", LOAD, SETTINGS | noise), data)
    for k in range(3):
        assert abs(np.std(estimate.value[:, k]) / np.median(estimate.own_std[:, k]) - 1) < 0.1


def test_the_network_inverts_the_brush():
    # Used friction by a root of the trail, which depends on nothing else.
    for mu, sliding in ((0.4, 0.3), (0.9, 0.6), (1.1, 0.15)):
        y, m = gough(sliding, mu)
        root = brentq(lambda r, t=m / y: gough(r, 1.0)[1] / gough(r, 1.0)[0] - t, 1e-6, 0.999)
        assert abs(root - sliding) < 1e-9
        theta_over_used = TireSensor()._outputs(np.array([y, m]), 1.0)
        np.testing.assert_allclose(theta_over_used[2], 1 - (1 - root) ** 3, atol=0.015)
