"""The reported standard deviation against closed forms, and on a measured log."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from logs import CPA2, LOAD, log

from tirefit.online.base import Estimate, Flag, code
from tirefit.online.methods import estimator_of
from tirefit.online.run import Scatter, reported, run

RLS = estimator_of("rls", LOAD)


def stated(mu, std=0.02):
    """An estimate of rls: mu and c_p a^2."""
    value, spread = jnp.array([mu, 2e5]), jnp.array([std, 1e3])
    return Estimate(value, spread, jnp.zeros((), int), jnp.nan)


def test_the_scatter_is_the_weighted_variance_within_each_level():
    random, dt = np.random.default_rng(0), 0.5
    mu = np.r_[0.9 + 0.1 * random.standard_normal(60), 0.5 + 0.05 * random.standard_normal(40)]
    std = random.uniform(0.01, 0.5, 100)
    scatter = Scatter()
    step = jax.jit(lambda *given: reported(RLS, *given)[0])
    for k in range(100):
        scatter = step(scatter, stated(mu[k], std[k]), dt, k == 60)
    weight = np.exp(-dt * np.arange(99, -1, -1) / 20) / (1 + (std / (0.15 * mu)) ** 2)
    levels = np.repeat([0, 1], [60, 40])
    mean = np.array([np.average(mu[levels == k], weights=weight[levels == k]) for k in (0, 1)])
    expected = np.average((mu - mean[levels]) ** 2, weights=weight)
    np.testing.assert_allclose(scatter.variance, expected, rtol=1e-10)
    # An estimate that is not finite changes nothing.
    after = step(scatter, stated(np.nan), dt, False)
    np.testing.assert_allclose(after.variance, scatter.variance, rtol=1e-10)


@pytest.mark.parametrize(("std", "flag"), [(0.11, Flag.OK), (0.13, Flag.LOW_USE)])
def test_the_scatter_widens_mu_but_sets_no_flag(std, flag):
    scatter = Scatter(square=jnp.array(0.5), weight=jnp.array(2.0))
    _, told = reported(RLS, scatter, stated(0.8, std), 0.0, False)
    expected = np.sqrt(std**2 + 0.5 / 2 + (0.05 * 0.8) ** 2)
    np.testing.assert_allclose(told.std, [expected, 1e3])
    np.testing.assert_allclose(told.own_std, [std, 1e3])
    assert int(told.flag) == code(flag)


def test_a_detected_change_does_not_count_as_scatter():
    settings = {"cpa2": CPA2, "force_noise": 0.03}
    _, found = run(estimator_of("rls", LOAD, settings), log(n=4000, drop=(20.0, 0.5)))
    alarms = np.flatnonzero(found.flag == code(Flag.CHANGED))
    assert 2000 < alarms[0] < 2200
    # The drop is 0.4: as scatter, it would be 0.19 for 20 s.
    assert found.std[-1, 0] < 0.08 and found.std[-1, 0] > found.own_std[-1, 0]


@pytest.mark.long
@pytest.mark.parametrize("name", ["ekf", "rls"])
def test_rows_are_within_two_standard_deviations_on_a_measured_log(name):
    from fits.measured_changes.logs import Logs, table

    # Tires "d", rear axle; mu by least squares of all rows: fits/friction_benchmark.
    made = table(Logs(("d",), every=1))
    columns = {key: made.columns[key] for key in ("time", "fz", "v")}
    columns |= {"sigma_x": np.tan(made.columns["alpha"]), "fx": made.columns["fy"]}
    columns["run"] = np.unique(made.run, return_inverse=True)[1].astype(float)
    _, found = run(estimator_of(name, float(columns["fz"][0])), columns)
    kept = found.flag == code(Flag.OK)
    off = np.abs(found.value[:, 0] - 0.513)[kept]
    assert np.mean(off <= 2 * found.std[kept, 0]) > 0.9
    assert np.mean(off <= 2 * found.own_std[kept, 0]) < 0.85
    assert np.median(found.std[kept, 0]) < 0.2 * 0.513  # and it says something
