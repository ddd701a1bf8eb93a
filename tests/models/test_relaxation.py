"""A slip that lags by a relaxation length."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tirefit.models import MODELS, Brush, Relaxed, TireInputs, forces

LENGTH, FZ = 0.4, 4000.0


def manoeuvre(n=60, seed=0):
    """Unevenly sampled slips in two runs, with a standstill in the second."""
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.005, 0.03, n))
    run = np.repeat([3, 1], [n // 2, n - n // 2])
    time[n // 2 :] -= time[n // 2] - 0.02  # each run has its own clock
    v = np.full(n, 8.0)
    v[n // 2 + 10 : n // 2 + 15] = 0.0
    v[:8] = -5.0
    slip = 0.1 * np.sin(20 * time) + 0.02 * rng.standard_normal(n)
    alpha = 0.3 * np.cos(15 * time)
    zero = np.zeros(n)
    return TireInputs(slip, alpha, zero + FZ, v, zero, zero, time), run


def integrated(slip, travel, first):
    """Lagged slip at the end of each step, by a solver, from steady state at ``first``.

    The slip is linear in the distance travelled; standing still, nothing is felt.
    """
    felt = slip.copy()
    for i in range(1, len(slip)):
        if i in first:
            continue
        ends = slip[i - 1], slip[i]
        if travel[i] == 0:
            felt[i] = felt[i - 1]
            continue

        def rate(x, y, i=i, ends=ends):
            return (ends[0] + (ends[1] - ends[0]) * x / travel[i] - y) / LENGTH

        span = (0.0, travel[i])
        felt[i] = solve_ivp(rate, span, [felt[i - 1]], rtol=1e-11, atol=1e-14).y[0, -1]
    return felt


felt_of = jax.jit(Relaxed.felt)


@pytest.fixture(scope="module")
def felt():
    inputs, run = manoeuvre()
    arrays = jax.tree.map(jnp.asarray, inputs)
    return inputs, run, felt_of(Relaxed(Brush(), LENGTH), arrays, run)


def test_the_lag_solves_its_equation(felt):
    inputs, _, result = felt
    speed = np.abs(inputs.v)
    travel = np.append(0, (speed[1:] + speed[:-1]) / 2 * np.diff(inputs.time))
    slip = integrated(inputs.sigma_x, travel, {0, 30})
    np.testing.assert_allclose(result.sigma_x, slip, atol=1e-11)
    tangent = integrated(np.tan(inputs.alpha), travel, {0, 30})
    np.testing.assert_allclose(np.tan(result.alpha), tangent, atol=1e-11)
    assert np.abs(result.sigma_x - inputs.sigma_x).max() > 0.05
    for name in ("fz", "v", "gamma", "pressure", "time"):
        np.testing.assert_array_equal(getattr(result, name), getattr(inputs, name))


def test_each_run_starts_in_steady_state_in_any_order(felt):
    inputs, run, result = felt
    starts = np.array([0, 30])
    np.testing.assert_array_equal(np.asarray(result.sigma_x)[starts], inputs.sigma_x[starts])
    other = np.concatenate([np.arange(30, 60), np.arange(30)])
    swapped = TireInputs(*(part[other] for part in inputs))
    again = felt_of(Relaxed(Brush(), LENGTH), swapped, run[other])
    np.testing.assert_allclose(again.sigma_x, np.asarray(result.sigma_x)[other], atol=1e-14)


def test_padding_has_no_effect(felt):
    """Copies of the first row, with which a fit pads its arrays."""
    inputs, run, result = felt
    padded = [np.concatenate([part, np.repeat(part[:1], 4)]) for part in inputs]
    codes = np.concatenate([run, np.repeat(run[:1], 4)])
    longer = felt_of(Relaxed(Brush(), LENGTH), TireInputs(*padded), codes)
    longer = np.asarray(longer.sigma_x)
    np.testing.assert_allclose(longer[:60], result.sigma_x, atol=1e-15)
    np.testing.assert_array_equal(longer[60:], inputs.sigma_x[0])


def test_rows_without_time_are_steady():
    for name in ("brush", "magic-formula"):
        inputs = TireInputs(np.linspace(-0.1, 0.2, 42), 0.05, FZ, 10.0)
        lagging, steady = MODELS[f"{name}-relaxation"], MODELS[name]
        for mine, same in zip(forces(lagging, inputs), forces(steady, inputs), strict=True):
            assert (mine is None) == (same is None)
            if mine is not None:
                np.testing.assert_allclose(mine, same, rtol=1e-13)
        assert lagging.transient and not steady.transient
        assert lagging.needs == ("v", "time")


def test_the_lag_of_each_run_acts_on_the_forces():
    inputs, run = manoeuvre()
    tire = Relaxed(Brush(), LENGTH)
    # The second run alone, twice: as many rows.
    second = TireInputs(*(np.tile(part[30:], 2) for part in inputs))
    apart, joined, alone = (
        np.asarray(forces(tire, *given).fx)
        for given in (
            (inputs, run),
            (inputs._replace(time=np.arange(60) * 0.02),),
            (second, np.repeat([0, 1], 30)),
        )
    )
    np.testing.assert_allclose(apart[30:], alone[:30], rtol=1e-9)
    assert abs(joined[30] - apart[30]) > 1.0


def test_gradients_are_finite_and_agree_with_differences():
    inputs, run = manoeuvre()
    arrays = jax.tree.map(jnp.asarray, inputs)

    def total(length, inputs):
        tire = Relaxed(Brush(), length)
        slips = tire.felt(inputs, jnp.asarray(run))
        return jnp.sum(slips.sigma_x**2) + jnp.sum(slips.alpha**2)

    @jax.jit
    def everything(length, inputs):
        value, slopes = jax.value_and_grad(total, (0, 1))(length, inputs)
        return value, slopes, jax.jacfwd(total)(length, inputs)

    value, (slope, others), forward = everything(LENGTH, arrays)
    assert all(np.isfinite(leaf).all() for leaf in others)
    ahead, behind = (float(everything(LENGTH + h, arrays)[0]) for h in (1e-5, -1e-5))
    np.testing.assert_allclose(slope, (ahead - behind) / 2e-5, rtol=1e-7)
    np.testing.assert_allclose(forward, slope, rtol=1e-12)
    per_row = np.full(60, LENGTH)  # a length per run reaches felt as one per row
    np.testing.assert_allclose(jax.jit(total)(per_row, arrays), value)
