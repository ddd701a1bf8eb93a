"""Least squares over windows, the start states eliminated, compared with SciPy."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import optimize

from tirefit.vehicle.shooting import (
    Data,
    End,
    Squares,
    linearised,
    minimised,
    profile_ends,
    sandwich,
)

TIME = np.linspace(0.0, 1.0, 21)
NOISE, PULL = np.array([0.02, 0.05]), np.array([0.0, 4.0, 0.0])
WINDOWS = 6
STD = np.full((WINDOWS, 2), [0.1, 0.3])  # of start states


def missed(z, start, window, parts):
    """A decaying state that saturates, seen through two channels."""
    fall = start[0] * jnp.exp(-jnp.exp(z[0]) * TIME) + start[1]
    seen = [jnp.tanh(z[1] + fall), z[2] * fall + window.v_x]
    return jnp.stack(seen, axis=1) - window.logged


def problem():
    generator = np.random.default_rng(0)
    truth, starts = np.array([0.7, 0.2, 1.5]), generator.normal(0.0, 1.0, (WINDOWS, 2))
    speed = np.sin(3 * TIME) + generator.normal(0.0, 0.1, (WINDOWS, len(TIME)))
    empty = np.zeros((WINDOWS, len(TIME), 2))
    clean = linearised(missed, 1)(truth, starts, Data(speed, speed, empty, starts, STD))[0]
    logged = np.asarray(clean) + NOISE * generator.standard_normal(empty.shape)
    return Data(speed, speed, logged, starts + generator.normal(0.0, 0.4, starts.shape), STD)


@pytest.mark.parametrize(("highest", "std"), [(np.inf, np.inf), (1.3, np.inf), (np.inf, STD)])
def test_windows_have_the_minimum_of_scipy_in_all_unknowns(highest, std):
    data, run = problem(), linearised(missed, 1)
    z, bounds = np.array([0.0, 0.0, 1.0]), (-np.inf, np.array([np.inf, np.inf, highest]))

    def residual(x):
        found = run(x[:3], x[3:].reshape(WINDOWS, 2), data)[0]
        off = (x[3:].reshape(WINDOWS, 2) - np.asarray(data.start)) / std
        each = np.ravel(np.asarray(found) / NOISE), np.sqrt(PULL) * x[:3], off.ravel()
        return np.concatenate(each)

    high = np.concatenate([bounds[1], np.full(2 * WINDOWS, np.inf)])
    peer = optimize.least_squares(
        residual, np.concatenate([z, data.start.ravel()]), "3-point",
        bounds=(-np.inf, high), xtol=1e-14, ftol=1e-14, gtol=1e-12,
    )  # fmt: skip
    squares = Squares(lambda z, starts: run(z, starts, data), NOISE, PULL, data.start, std)
    began = squares.begun(jnp.asarray(z), data.start)
    found, starts, now, converged = minimised(squares, began, bounds)
    assert converged
    # A billionth of the cost: 1e-5 standard errors.
    here = residual(np.concatenate([found, np.ravel(starts)]))
    np.testing.assert_allclose(here @ here, 2 * peer.cost, rtol=1e-8)
    np.testing.assert_allclose(found, peer.x[:3], rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(np.ravel(starts), peer.x[3:], rtol=1e-3, atol=1e-4)
    np.testing.assert_array_equal(now[0], run(found, starts, data)[0])


def test_start_states_alone_are_found():
    """At z of the minimum its own slope is zero, whatever the start states are."""
    data, run = problem(), linearised(missed, 1)
    z, starts = np.array([0.0, 0.0, 1.0]), data.start
    squares = Squares(lambda z, starts: run(z, starts, data), NOISE, PULL)
    z, starts, *_ = minimised(squares, squares.begun(z, starts))
    away = starts + 1e-3
    _, again, *_ = minimised(squares, squares.begun(z, away), tolerance=1e-5)
    np.testing.assert_allclose(again, starts, atol=3e-5)


def test_a_profile_of_linear_windows_ends_at_the_standard_errors_of_the_sandwich():
    """A line through windows whose residuals have a common part."""
    generator = np.random.default_rng(2)
    common = generator.normal(0.0, 1.0, (WINDOWS, 1, 1))
    values = common + generator.normal(0.0, 0.5, (WINDOWS, len(TIME), 1))
    by_z = np.stack([np.ones_like(values), np.tile(TIME[:, None], (WINDOWS, 1, 1))], axis=3)
    by_start = np.tile(np.cos(9 * TIME)[:, None, None], (WINDOWS, 1, 1, 1))

    def run(z, starts):
        made = by_z @ jnp.asarray(z) + (by_start @ starts[:, None, :, None])[..., 0]
        return made - values, by_z, by_start

    squares = Squares(run, np.array([0.5]), np.zeros(2))
    end = minimised(squares, squares.begun(jnp.zeros(2), jnp.zeros((WINDOWS, 1))))
    covariance, _, widened = sandwich(squares, end)
    std, reach = np.sqrt(np.diag(covariance)), 2.5
    assert widened[0] > 10.0 and 0.1 < widened[1] < 4.0  # the slope has no common part
    for k in (0, 1):
        ends = profile_ends(squares, end, k, std[k], reach, widened[k])
        np.testing.assert_allclose(ends - end.z[k], reach * std[k] * np.array([-1, 1]), rtol=0.02)


@pytest.mark.parametrize("pull", [0.0, 3.0])
def test_the_sandwich_of_a_mean_is_its_standard_error_between_windows(pull):
    """A mean of windows that differ by more than their noise of 0.5, whose start state takes
    off the second sample less the first."""
    values = np.random.default_rng(1).normal(0.0, 2.0, (WINDOWS, 2))
    middle, one = values.mean(axis=1), np.ones((WINDOWS, 2, 1, 1))
    information = 2 * WINDOWS / 0.5**2 + pull
    best = 2 * values.sum() / 2 / 0.5**2 / information
    missed = best - values[..., None]
    apart = one * np.array([-1.0, 1.0])[:, None, None]
    squares = Squares(None, np.array([0.5]), np.array([pull]))
    end = End(np.array([best]), np.zeros((WINDOWS, 1)), (missed, one, apart))
    found, count, widened = sandwich(squares, end)
    sums = 2 * (best - middle) / 0.5**2
    between = WINDOWS / (WINDOWS - 1) * np.sum(sums**2)
    assert count == WINDOWS
    np.testing.assert_allclose(found, [[(between + pull) / information**2]], rtol=1e-6)
    np.testing.assert_allclose(widened, [(between + pull) / information], rtol=1e-6)
    # An element at its bound has no slope: the error of the other one is the same.
    both = np.concatenate([one, 0 * one], axis=3)
    end = End(np.array([best, 0.0]), end.starts, (missed, both, apart))
    more, *_ = sandwich(squares._replace(pull=np.array([pull, 0.0])), end)
    np.testing.assert_allclose(more[0, 0], found[0, 0], rtol=1e-6)
    assert more[1, 1] > 100.0**2
    if not pull:
        error = middle.std(ddof=1) / np.sqrt(WINDOWS)
        np.testing.assert_allclose(np.sqrt(found), [[error]], rtol=1e-6)
