"""The common runner, for any method and any defect of the samples."""

import equinox as eqx
import jax
import numpy as np
import pytest
from logs import CPA2, LOAD, OF_A_WHEEL, log

from tirefit.online.base import FLAGS, Flag, code
from tirefit.online.methods import METHODS, estimator_of
from tirefit.online.run import Stream, guarded_step, run, start
from tirefit.params import with_values

every_method = pytest.mark.parametrize("name", OF_A_WHEEL)
TRUTH = {"mu": 0.9, "cpa2": CPA2}
WITHOUT_MEMORY = ("cubic", "tire-sensor")


def near_the_truth(name, estimate):
    """Whether the last estimates of known parameters lie within five stds."""
    known = [(k, p) for k, p in enumerate(METHODS[name].method.parameters)]
    return all(
        abs(estimate.value[-1, k] - TRUTH[p]) < 5 * estimate.std[-1, k]
        for k, p in known
        if p in TRUTH
    )


def estimates_of(name, data):
    return run(estimator_of(name, LOAD), data)[1]


def rows_flagged(estimate, flag):
    return list(np.flatnonzero(estimate.flag == code(flag)))


@every_method
def test_scan_equals_single_steps(name):
    data = log(n=250, slip_noise=0.001)
    data["fx"][100:110] = np.nan
    data["time"][180:] -= 0.5
    estimator = estimator_of(name, LOAD)
    state, scanned = run(estimator, data)
    stream = Stream(estimator)
    streamed = [stream.push({k: v[i] for k, v in data.items()}) for i in range(250)]
    for part in ("value", "std", "flag", "surprise"):
        each = np.stack([getattr(one, part) for one in streamed])
        np.testing.assert_allclose(getattr(scanned, part), each, rtol=1e-9)
    for one, other in zip(jax.tree.leaves(state), jax.tree.leaves(stream.state), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9)


def test_a_run_continues_where_it_stopped():
    data = log(n=600)
    estimator = estimator_of("rls", LOAD)
    halves = [{k: v[part] for k, v in data.items()} for part in np.s_[:333, 333:]]
    state, first = run(estimator, halves[0])
    _, second = run(estimator, halves[1], state)
    whole = run(estimator, data)[1]
    np.testing.assert_allclose(np.r_[first.value, second.value], whole.value)


def test_a_stream_is_compiled_once():
    traced = []

    class Counted(METHODS["rls"]):
        def step(self, state, sample):
            traced.append(1)
            return super().step(state, sample)

    stream = Stream(Counted())
    data = log(n=30)
    for i in range(30):
        stream.push({k: v[i] for k, v in data.items()})
    assert len(traced) == 1


@every_method
@pytest.mark.parametrize("column", ["input", "fz", "time"])
def test_missing_samples_are_flagged_and_bridged(name, column):
    inputs = METHODS[name].method.inputs
    column = inputs[0] if column == "input" else column
    data = log(n=1020)
    whole = estimates_of(name, data)
    data[column][700:750] = np.nan
    estimate = estimates_of(name, data)
    flagged = rows_flagged(estimate, Flag.MISSING)
    assert flagged == list(range(700, 750))
    assert np.all(estimate.value[705:750] == estimate.value[705])  # held
    assert np.all(np.diff(estimate.std[700:750], axis=0) >= 0)  # and no surer
    if name not in WITHOUT_MEMORY:
        spread = np.hypot(whole.std[-1], estimate.std[-1])
        assert np.all(abs(estimate.value[-1] - whole.value[-1]) < spread)


@pytest.mark.parametrize("name", ["rls", "ekf"])
def test_time_without_samples_raises_the_std(name):
    data = log(n=1020)
    data["fx"][500:800] = np.nan
    std = estimates_of(name, data).own_std
    assert np.all(std[799] > 1.05 * std[499])
    # Rows that are not even there count as those that are empty.
    kept = np.r_[:500, 800:1020]
    short = estimates_of(name, {k: v[kept] for k, v in data.items()})
    np.testing.assert_allclose(short.own_std[500], std[800], rtol=1e-3)
    assert FLAGS[short.flag[500]] is Flag.GAP


@every_method
def test_decreasing_time_is_flagged_and_ignored(name):
    data = log(n=1020)
    data["time"][500:] -= 4.0
    data["time"][[700, 701]] = data["time"][[701, 700]]  # two rows swapped
    estimate = estimates_of(name, data)
    assert rows_flagged(estimate, Flag.TIME_BACK) == [500, 701]
    assert np.isfinite(estimate.value[-1]).all()


@every_method
def test_a_locked_wheel_and_a_standstill_are_flagged(name):
    data = log(n=1020)
    data["sigma_x"][600:650] = 1e6
    data["omega"][650 if "sigma_x" in METHODS[name].method.inputs else 600 : 680] = 0.0
    data["v"][900:950] = 0.0
    data["sigma_x"][900:950] = np.nan
    data["fz"][1000] = -10.0
    estimate = estimates_of(name, data)
    assert rows_flagged(estimate, Flag.LOCKED) == list(range(600, 680))
    assert rows_flagged(estimate, Flag.STANDSTILL) == list(range(900, 950))
    assert rows_flagged(estimate, Flag.NO_LOAD) == [1000]
    assert near_the_truth(name, estimate)


@every_method
def test_divergence_is_always_flagged(name):
    data = log(n=1020)
    data["fx"][[700, 720]] = data["fy"][[700, 720]] = 1e200, -1e6
    data["sigma_x"][800] = -1e150
    data["mz"][800] = data["brake_pressure"][800] = 1e150
    estimate = estimates_of(name, data)
    assert np.isfinite(estimate.value[-1]).all()
    if {"fx", "fy"} & set(METHODS[name].method.inputs):
        assert rows_flagged(estimate, Flag.IMPLAUSIBLE) == [700, 720]
    assert near_the_truth(name, estimate)


def test_a_state_that_is_not_finite_is_reset():
    class Broken(METHODS["mit"]):
        def step(self, state, sample):
            after, estimate = super().step(state, sample)
            bad = jax.numpy.where(sample["fz"] < LOAD, jax.numpy.inf, after.theta)
            return after._replace(theta=bad), estimate

    data = log(n=300)
    data["fz"][200] = 0.9 * LOAD
    _, estimate = run(with_values(Broken(), {"average": 1.0}), data)
    assert rows_flagged(estimate, Flag.RESET) == [200]
    np.testing.assert_allclose(estimate.value[201], estimate.value[0], rtol=1e-3)


@every_method
def test_a_new_run_resets_the_state(name):
    data = log(n=510)
    twice = {k: np.r_[v, v] for k, v in data.items()}
    twice["run"] = np.repeat([0.0, 1.0], 510)
    estimate = estimates_of(name, twice)
    np.testing.assert_allclose(estimate.value[:510], estimate.value[510:])
    assert not rows_flagged(estimate, Flag.TIME_BACK)


@pytest.mark.parametrize("name", ["rls", "ekf"])
def test_ten_minutes_give_no_false_alarm_and_a_symmetric_covariance(name):
    # One alarm in 14 hours of steps by the approximation.
    state, estimate = run(estimator_of(name, LOAD), log(n=60_000, slip_noise=0.001))
    assert rows_flagged(estimate, Flag.CHANGED) == []
    p = state.inner.p if name == "rls" else state.inner.covariance
    np.testing.assert_allclose(p, p.T, rtol=1e-9)


@every_method
def test_a_step_returns_the_declared_shapes(name):
    estimator = estimator_of(name, LOAD)
    sample = {k: v[5] for k, v in log(n=10).items()}
    before = start(estimator)
    after, estimate = eqx.filter_eval_shape(guarded_step, estimator, before, sample)
    p = len(estimator.method.parameters)
    assert estimate.value.shape == estimate.std.shape == (p,)
    assert estimate.flag.shape == estimate.surprise.shape == ()
    assert jax.tree.structure(before) == jax.tree.structure(after)
