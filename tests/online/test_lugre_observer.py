"""The LuGre observer, S section 3.4: its stability, and a simulated wheel as truth."""

from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tirefit.models import LuGre, TireInputs
from tirefit.online.base import FLAGS, Flag, code
from tirefit.online.lugre_observer import LuGreObserver, peak_share
from tirefit.online.methods import estimator_of
from tirefit.online.run import run
from tirefit.params import with_values
from tirefit.sim.braking import Braking, braked_wheel, simulate_braking
from tirefit.sim.lugre import Bristles

LOAD, RADIUS, INERTIA, V = 27e3, 0.5, 15.0, 20.0

MEAN = Bristles(np.ones(1), np.ones(1), np.full((1, 1), 2.0))
"""One bristle for the mean of the patch, carried out at the rate kappa = 2: as stiff at
small slip as the patch under an even pressure."""


@cache
def wheel(theta, rate=2000):
    """Columns of one noise-free tooth on the tire of the observer, and z [m]."""
    time = np.arange(2 * rate) / rate
    tire = LuGre(mu_s=1.2 * theta, mu_c=0.6 * theta)
    full = 0.7 * RADIUS * float(peak_share(LuGre(), theta, V)) * LOAD
    numbers = full, 2.0, RADIUS, INERTIA, V, LOAD, np.inf, 1 / rate
    omega, _, z = braked_wheel(numbers, (tire, tire), MEAN, time, 1)
    one = np.ones(len(time))
    columns = {
        "time": time,
        "omega": omega,
        "v": V * one,
        "fz": LOAD * one,
        "torque": full * time / 2,
    }
    return columns, z


@cache
def log(mu, seed=0, **how):
    """A noisy log of 8 teeth of the wheel on bristles over the whole patch."""
    return simulate_braking(Braking(tire="lugre", friction=mu, teeth=8, seed=seed, **dict(how)))


def path_of(observer, columns, start, dt):
    """Wheel speed, deflection and p of the observer at the samples, from a start."""
    names = observer.method.inputs
    inputs = jnp.asarray(np.stack([columns[name] for name in names], 1))
    path = _moved(jax.tree.map(jnp.asarray, observer), inputs, jnp.asarray(start), dt)
    return np.vstack([start, path]).T


@eqx.filter_jit
def _moved(observer, inputs, start, dt):
    def step(x, u):
        x = observer.moved(x, u, dt)[0]
        return x, x[:3]

    return jax.lax.scan(step, jnp.concatenate([start, inputs[0]]), inputs[1:])[1]


def v_along(observer, theta, path, columns, z, rho):
    """V of the module's docstring along a path, computed independently."""
    z_hat, omega, p = path
    b = RADIUS * LOAD / INERTIA
    e_omega, e_z, e_p = columns["omega"] - omega, z - z_hat, 1 / theta - p
    eta = e_omega - b * 0.1 * e_z
    gamma = observer.adaptation / b**2
    return (e_omega**2 + rho * eta**2 + e_p**2 / gamma) / 2


def least_weight():
    """rho of the module's docstring above which V falls, with a tenth to spare."""
    v, slip = np.meshgrid(np.linspace(2, 60, 30), np.linspace(0, 1, 30))
    c, worst = 2.0 * v * (1 - slip) / 0.2, 0.0
    for p in (0.25, 1.0, 20.0):
        pa = p * 100 * v * slip / np.asarray(LuGre().level(v * slip))
        worst = max(worst, np.max((1000 - pa) ** 2 / (4 * (c + pa) * (1000 + c))))
    return 1.1 * worst


@pytest.mark.parametrize("theta", [1.0, 0.4])
@pytest.mark.parametrize("wrong", [0.5, 2.0])
def test_the_lyapunov_function_falls_without_noise(theta, wrong):
    columns, z = wheel(theta)
    # Low friction is less observable: a faster gain avoids ten teeth.
    settings = {"kappa": 2.0, "adaptation": 1e6 / theta**4}
    observer = with_values(LuGreObserver(), settings)
    start = np.array([2e-4, columns["omega"][0] + 0.3, 1 / (wrong * theta)])
    path = path_of(observer, columns, start, 1 / 2000)
    v = v_along(observer, theta, path, columns, z, least_weight())
    # What the steps of 1/16000 s are off by may raise it a little where it is small.
    assert np.all(np.diff(v) <= 1e-5 * v[0])
    assert v[-1] < 1e-3 * v[0]
    assert abs(1 / path[2][-1] / theta - 1) < 0.02


@pytest.mark.parametrize("theta", [0.4, 1.0, 2.5])
def test_the_first_deflection_gives_the_steady_force(theta):
    """S(18) of the tire with theta g, at the slip of the first sample."""
    observer = estimator_of("lugre-observer", LOAD, {"theta": theta})
    first = {"omega": 38.0, "v": V, "fz": LOAD, "torque": 5e3, "dt": jnp.inf}
    x = observer.update(observer.init(), jax.tree.map(jnp.asarray, first))[0].x
    found = observer.share(x[0], x[2], observer.course(x[3:], x[2]))
    at = TireInputs(sigma_x=V / (38.0 * RADIUS) - 1, fz=LOAD, v=V)
    np.testing.assert_allclose(found, LuGre().scaled(theta)(at).fx / LOAD, rtol=1e-9)


@pytest.mark.parametrize("mu", [0.95, 0.6, 0.4])
@pytest.mark.parametrize("theta", [0.5, 2.0])
def test_friction_is_found_from_wrong_starts(mu, theta):
    data = log(mu).columns
    _, estimate = run(estimator_of("lugre-observer", LOAD, {"theta": theta}), data)
    value, std = estimate.value[-1], estimate.own_std[-1]
    assert abs(value[0] - mu) < 3 * std[0] < 0.2 * mu
    np.testing.assert_allclose(value[0], peak_share(LuGre(), value[1], V), rtol=1e-9)


def test_the_truth_lies_within_the_stated_spread():
    estimator = estimator_of("lugre-observer", LOAD)
    ends = [run(estimator, log(0.8, seed=seed).columns)[1] for seed in range(4)]
    pulls = [(end.value[-1, 0] - 0.8) / end.own_std[-1, 0] for end in ends]
    # The random walk allows for changes that do not come; 4 runs leave 0.35 open.
    assert 0.2 < np.sqrt(np.mean(np.square(pulls))) < 1.5
    assert ends[0].own_std[-1, 0] < 0.08


def test_a_drop_of_friction_is_detected_and_tracked():
    data = log(0.95, drop=(8.5, 0.5)).columns  # the wheel locks
    _, estimate = run(estimator_of("lugre-observer", LOAD), data)
    alarms = data["time"][estimate.flag == code(Flag.CHANGED)]
    assert len(alarms) and 8.5 < alarms[0] < 10
    held = estimate.flag == code(Flag.LOCKED)
    assert np.all(data["sigma_x"][held] > 5) and np.count_nonzero(held) > 50
    late = data["time"] > 11
    assert np.all(np.abs(estimate.value[late, 0] - 0.5) < 0.05)


def test_low_force_is_flagged_as_uninformative():
    data = log(0.95, amplitude=0.08).columns
    _, estimate = run(estimator_of("lugre-observer", LOAD), data)
    assert set(estimate.flag) <= {code(Flag.LITTLE_EXCITATION), code(Flag.LOW_USE)}
    six = estimate.value[:1200, 1], estimate.std[1199, 1]  # teeth
    assert np.all(np.abs(six[0] - 1) < 0.05) and six[1] > 0.45  # and does not wander
    braked = run(estimator_of("lugre-observer", LOAD), log(0.95, amplitude=0.3).columns)
    assert FLAGS[braked[1].flag[150]] is Flag.LOW_USE


def test_bad_rows_are_flagged_and_bridged():
    data = {k: v.copy() for k, v in log(0.8).columns.items()}
    data["torque"][50:60] = np.nan
    data["omega"][80:90] = 0.0
    data["v"][110:120] = 0.2
    data["omega"][150] *= 3.0
    data["time"][200:] -= 1.5
    data["fz"][220] = -1.0
    _, found = run(estimator_of("lugre-observer", LOAD), data)
    for rows, flag in (
        (np.r_[50:60], Flag.MISSING),
        (np.r_[80:90], Flag.LOCKED),
        (np.r_[110:120], Flag.STANDSTILL),
        ([200], Flag.TIME_BACK),
        ([220], Flag.NO_LOAD),
    ):
        np.testing.assert_array_equal(np.flatnonzero(found.flag == code(flag)), rows)
    assert abs(found.value[-1, 0] - 0.8) < 3 * found.own_std[-1, 0] < 0.3


def test_it_never_diverges_for_any_time_step():
    # Every 25th row, repeated up to the length of the other logs.
    data = {k: np.resize(v[::25], len(v)) for k, v in log(0.8).columns.items()}
    data["time"] = 0.25 * np.arange(len(data["time"]))
    for settings in ({"sigma1": 1e-3}, {"adaptation": 1e12}, {"sigma0": 1e5}):
        _, estimate = run(estimator_of("lugre-observer", LOAD, settings), data)
        assert np.isfinite(estimate.value).all()
        assert np.all((estimate.value[:, 1] >= 0.05) & (estimate.value[:, 1] <= 4.0))
        assert not np.any(estimate.flag == code(Flag.RESET))
