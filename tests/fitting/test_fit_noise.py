"""Autocorrelation of residuals and the distribution of true slips."""

import numpy as np
import pytest

from tirefit.fitting.problem.latent_slip import OFFSETS, slips_of_nodes
from tirefit.fitting.problem.noise import autocorrelation_time, effective_inflation
from tirefit.fitting.problem.slip_noise import (
    slip_density,
    slip_distribution,
    slip_knots,
    std_with_speed,
)


def autoregressive(rho, n, seed):
    steps = np.random.default_rng(seed).standard_normal(n)
    out = np.empty(n)
    out[0] = steps[0] / np.sqrt(1 - rho**2)
    for i in range(1, n):
        out[i] = rho * out[i - 1] + steps[i]
    return out


def test_autocorrelation_time_of_an_autoregression_is_right():
    # (1 + rho)/(1 - rho) = 19. Its relative error in one series of n is about
    # sqrt(2 (2M + 1)/n) with M ~ 5 tau lags summed: 6 % at n = 100,000.
    times = [autocorrelation_time([autoregressive(0.9, 100_000, s)]) for s in range(4)]
    assert abs(np.mean(times) - 19) < 3 * 0.06 * 19 / 2
    assert max(abs(t - 19) for t in times) < 4 * 0.06 * 19


def test_runs_are_pooled_without_joining_their_ends():
    parts = [autoregressive(0.8, 20_000, s) for s in range(4)]
    np.testing.assert_allclose(autocorrelation_time(parts), 9.0, rtol=0.15)


def test_white_noise_seems_correlated_once_in_a_thousand_series():
    """The level of the test of the lag-one autocorrelation, 0.1 %, within its scatter."""
    series = np.random.default_rng(6).standard_normal((1500, 200))
    assert sum(autocorrelation_time([one]) > 1 for one in series) <= 5
    # A correlation of one standard error is ignored, one of eight is used.
    times = [autocorrelation_time([autoregressive(k / 50, 2500, 3)]) for k in (1, 8)]
    assert times[0] == 1.0 < times[1]


@pytest.mark.parametrize("parts", [[], [np.zeros(50)], [np.array([1.0, 2.0])]])
def test_series_without_variation_have_autocorrelation_time_one(parts):
    assert autocorrelation_time(parts) == 1.0


def test_inflation_uses_the_scores_not_the_residuals():
    residual = autoregressive(0.95, 4000, 5)
    run = np.zeros(4000, int)
    constant, flipping = np.ones(4000), np.tile([1.0, -1.0], 2000)
    slow = effective_inflation((residual * constant)[:, None], run, None)
    np.testing.assert_allclose(slow, 39, rtol=0.35)
    assert effective_inflation((residual * flipping)[:, None], run, None) == 1.0
    both = np.stack([3 * residual, residual * flipping], axis=1)
    np.testing.assert_allclose(effective_inflation(both, run, None), slow, rtol=0.1)


def test_inflation_takes_rows_in_order_of_time():
    scores = autoregressive(0.9, 4000, 6)[:, None]
    run, order = np.zeros(4000, int), np.random.default_rng(1).permutation(4000)
    expected = effective_inflation(scores, run, None)
    shuffled = effective_inflation(scores[order], run, np.arange(4000.0)[order])
    np.testing.assert_allclose(shuffled, expected, rtol=1e-9)
    assert effective_inflation(scores[order], run, None) < 2 < expected


def test_a_direction_without_information_is_ignored():
    scores = np.zeros((100, 2))
    scores[:, 0] = np.random.default_rng(2).standard_normal(100)
    assert effective_inflation(scores, np.zeros(100, int), None) == 1.0
    assert effective_inflation(np.zeros((100, 2)), np.zeros(100, int), None) == 1.0
    runs = np.repeat(np.arange(10), 10)  # enough of them to compare their sums
    assert effective_inflation(scores, runs, None) == effective_inflation(scores[:, :1], runs, None)
    assert effective_inflation(np.zeros((100, 2)), runs, None) == 1.0


def test_noise_of_a_speed_adds_to_that_of_the_slip():
    """3, 4 and 5; that of a standing wheel is of 3 % of the median speed."""
    std = std_with_speed(0.003, 0.04, np.array([10.0, -10.0, 0.0]))
    np.testing.assert_allclose(std, [0.005, 0.005, np.hypot(0.003, 0.04 / 0.3)])


def triangle(s):
    return np.interp(s, [0.0, 0.05, 0.2], [0.0, 10.0, 0.0])


def noisy_slips(n=4000, std=0.03, seed=4):
    generator = np.random.default_rng(seed)
    true = generator.triangular(0.0, 0.05, 0.2, n)
    return true, true + std * generator.standard_normal(n), np.full(n, std)


def density_of(slip, std):
    """Density at the measured slips, from these alone."""
    nodes = slips_of_nodes(slip, std)
    known = np.exp(-(OFFSETS**2) / 2) * np.convolve(np.diff(OFFSETS), [0.5, 0.5])
    found = slip_density(slip_knots(slip, std), nodes, np.tile(known, (len(slip), 1)))
    return found.at(slip)


def test_slip_density_recovers_a_known_density():
    _, slip, std = noisy_slips()
    density = density_of(slip, std)
    order = np.argsort(slip)
    density = density[order] / np.trapezoid(density[order], slip[order])
    # The corner of the triangle is smoothed: found 0.14, the measured slips 0.3 or more.
    off = np.trapezoid(np.abs(density - triangle(slip[order])), slip[order])
    counts, edges = np.histogram(slip, 60, density=True)
    raw = np.interp(slip[order], (edges[1:] + edges[:-1]) / 2, counts)
    assert off < 0.17
    assert off < 0.8 * np.trapezoid(np.abs(raw - triangle(slip[order])), slip[order])


def test_slip_density_of_narrow_slips_stays_finite():
    density = density_of(np.full(30, 0.1), np.full(30, 0.01))
    assert np.isfinite(density).all() and (density > 0).all()


def test_a_slip_that_many_rows_have_is_found():
    """Free rolling between pulses: a third of the rows at one slip."""
    generator = np.random.default_rng(2)
    true = np.where(generator.random(900) < 0.3, 0.011, generator.uniform(0, 0.15, 900))
    std = np.full(900, 0.002)
    slip = true + std * generator.standard_normal(900)
    found = slip_distribution(slip, std)
    assert len(found.standing) == 1
    assert found.standing[0] == pytest.approx(0.011, abs=0.0004)
    assert found.shares[0] == pytest.approx(0.3, abs=0.04)
    total = np.trapezoid(found.density, found.knots) + found.shares.sum()
    assert total == pytest.approx(1.0, abs=1e-9)
    mean, spread, common = found.moments(slip, std)
    # What is left of the slip does not hang on where it was measured, as it does raw.
    near = np.abs(slip - 0.011) < 0.004
    assert np.abs(np.corrcoef((true - slip)[near], slip[near])[0, 1]) > 0.6
    assert np.abs(np.corrcoef((true - mean)[near], slip[near])[0, 1]) < 0.25
    assert np.mean((true - mean) ** 2) < 0.9 * np.mean((true - slip) ** 2)
    # Rows of one standing slip keep all of their noise: they share its place, and
    # scatter by the rest alone.
    assert np.mean(spread[near] ** 2) == pytest.approx(0.002**2, rel=0.15)
    own = np.mean((1 - common[near]) * spread[near] ** 2)
    assert own < 0.6 * 0.002**2
    assert own == pytest.approx(np.mean((true - mean)[near] ** 2), rel=0.5)


def test_every_set_point_is_found():
    """Many at once; each must be significant alone."""
    generator = np.random.default_rng(3)
    points, std = np.linspace(-0.29, 0.29, 25), np.full(300, 0.001)
    slip = np.repeat(points, 12) + std * generator.standard_normal(300)
    found = slip_distribution(slip, std)
    order = np.argsort(found.standing)
    mean = slip.reshape(25, 12).mean(axis=1)
    # To the standard error of a mean of twelve.
    np.testing.assert_allclose(found.standing[order], mean, atol=3e-4)
    np.testing.assert_allclose(found.shares[order], 1 / 25, atol=0.005)


def test_evenly_spread_slips_have_no_set_point():
    generator = np.random.default_rng(5)
    slip = generator.uniform(0, 0.3, 900) + 0.004 * generator.standard_normal(900)
    std = np.full(900, 0.004)
    found = slip_distribution(slip, std)
    assert found.standing.size == 0
    mean, spread, _ = found.moments(slip, 0 * std)
    np.testing.assert_array_equal(mean, slip)
    np.testing.assert_array_equal(spread, 0.0)


def test_runs_that_differ_as_a_whole_count_by_the_scatter_of_their_sums():
    """By less than the autocorrelation within a run shows."""
    generator = np.random.default_rng(4)
    run = np.repeat(np.arange(10), 100)
    scores = generator.standard_normal(1000) + 0.3 * np.tile([1.0, -1.0], 5)[run]
    sums = np.bincount(run, scores)
    assert autocorrelation_time([scores[run == k] for k in range(10)]) == 1
    expected = np.sum(sums**2) / 9 / np.mean(scores**2) / 100
    found = effective_inflation(scores[:, None], run, None)
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    assert expected > 5
