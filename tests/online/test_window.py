"""The window of surprises against closed forms, and the coverage on a measured log."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fits.measured_changes.logs import Logs, table
from tirefit.online.base import Estimate, Flag, code
from tirefit.online.methods import estimator_of
from tirefit.online.run import run
from tirefit.online.window import first_window, judged


def window_of(surprises, mu=0.8, dt=0.0):
    """The window after surprises (n,), in steps of ``dt`` [s]."""

    def step(window, z):
        return window.waiting(dt).after(z, jnp.asarray(mu, float)), None

    return jax.lax.scan(step, first_window(), jnp.asarray(surprises))[0]


@pytest.mark.parametrize(("size", "rho"), [(1.0, 0.0), (2.5, 0.0), (1.0, 0.6), (2.0, 0.6)])
def test_the_widening_is_that_of_a_correlated_process(size, rho):
    # z_k = rho z_(k-1) + e: the sum of many has size^2 (1 + rho) / (1 - rho) each.
    random, (runs, n) = np.random.default_rng(0), (200, 300)
    pushes = random.standard_normal((runs, n)) * np.sqrt(1 - rho**2)
    z = np.zeros((runs, n))
    for k in range(1, n):
        z[:, k] = rho * z[:, k - 1] + pushes[:, k]
    windows = jax.vmap(window_of)(size * z)
    wider = np.median(windows.rms * np.sqrt(windows.dependence))
    # Without time between the steps nothing is forgotten: 300 surprises know rho to 0.06.
    # Negative estimates of it count as none.
    assert abs(wider / (size * np.sqrt((1 + rho) / (1 - rho))) - 1) < 0.12


def test_the_window_is_ten_seconds_long_if_that_is_more_than_fifty_steps():
    for dt, memory in ((0.01, 1000.0), (0.1, 100.0), (1.0, 50.0)):
        weight = float(window_of(np.ones(6000), dt=dt).weight)
        assert abs(weight / memory - 1) < 0.01  # the sum of a geometric series, to dt / 20 s


def flag_of(window, std=0.01):
    """The flag and the standard deviation of mu = 0.8 stated as ``std``."""
    estimator = estimator_of("ekf", 1.0)
    stated = Estimate(jnp.array([0.8, 5.0]), jnp.array([std, 0.1]), jnp.zeros((), int), jnp.nan)
    found = judged(estimator, window, stated)
    return Flag(list(Flag)[int(found.flag)]), np.asarray(found.std)


def test_surprises_as_stated_leave_the_standard_deviation_as_it_is():
    flag, std = flag_of(window_of(np.tile([1.0, -1.0], 100)))
    assert flag is Flag.OK
    np.testing.assert_allclose(std, [np.hypot(0.01, 0.05 * 0.8), 0.1], rtol=1e-6)


@pytest.mark.parametrize(
    ("surprises", "std", "expected"),
    [
        (np.tile([1.0, -1.0], 4), 0.01, Flag.SETTLING),  # fewer than ten
        (np.ones(200), 0.001, Flag.SETTLING),  # many, but all the same
        (np.tile([1.0, -1.0], 100), 0.2, Flag.LOW_USE),  # stated: not known
        (np.tile([9.0, -9.0], 100), 0.02, Flag.LOW_USE),  # nine times the stated
    ],
)
def test_a_friction_that_is_not_determined_is_flagged(surprises, std, expected):
    assert flag_of(window_of(surprises), std)[0] is expected


def test_a_moving_friction_is_flagged():
    surprises = np.tile([1.0, -1.0], 100)

    def step(window, given):
        return window.after(*given), None

    moving = jnp.asarray(np.linspace(0.4, 1.2, 200)), jnp.asarray(surprises)
    window = jax.lax.scan(step, first_window(), moving[::-1])[0]
    assert flag_of(window)[0] is Flag.SETTLING


@pytest.mark.long
@pytest.mark.parametrize("tires", ["d", "others"])
def test_ekf_is_within_two_standard_deviations_on_a_measured_log(tires):
    # The numbers of the window were chosen on the tires "a". Friction of the rear axle by
    # least squares of all rows: fits/friction_benchmark.
    mu = {"d": 0.511, "others": 0.483}[tires]
    made = table(Logs((tires,), every=1))
    log = {key: made.columns[key] for key in ("time", "fz", "v")}
    log |= {"sigma_x": np.tan(made.columns["alpha"]), "fx": made.columns["fy"]}
    log["run"] = np.unique(made.run, return_inverse=True)[1].astype(float)
    _, found = run(estimator_of("ekf", float(log["fz"][0])), log)
    kept = found.flag == code(Flag.OK)
    inside = np.abs(found.value[:, 0] - mu) <= 2 * found.std[:, 0]
    assert kept.mean() > 0.2 and inside[kept].mean() > 0.9
