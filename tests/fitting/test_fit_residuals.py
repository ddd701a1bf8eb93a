"""Residuals by groups and in order, and densities of draws, checked independently."""

from dataclasses import replace

import numpy as np
import pytest
from recipes import FZ
from scipy.stats import norm

from tirefit.fitting.problem.noise import autocorrelation
from tirefit.fitting.uncertainty.bands import force_band
from tirefit.models import TireInputs
from tirefit.report.fit.posterior import (
    bin_edges,
    dense_profile,
    enclosing,
    joint_density,
    marginal_density,
    near_level,
)
from tirefit.report.fit.residuals import means_by, means_over


def test_autocorrelation_of_a_known_series_is_right():
    np.testing.assert_allclose(
        autocorrelation([np.array([1.0, -1.0] * 8)])[:3], [1.0, -15 / 16, 14 / 16]
    )


def test_autocorrelation_pools_the_runs():
    """Compared with the sums of products."""
    rng = np.random.default_rng(0)
    parts = [rng.normal(size=n) for n in (50, 31, 1)]
    power = sum(part @ part for part in parts)
    expected = [
        sum(part[lag:] @ part[: len(part) - lag] for part in parts) / power for lag in range(10)
    ]
    np.testing.assert_allclose(autocorrelation(parts)[:10], expected, atol=1e-14)
    assert autocorrelation([np.zeros(9)]).tolist() == [1.0]
    assert autocorrelation([]).tolist() == [1.0]


def test_means_at_settings_cover_the_truth():
    """95 % intervals of the means, of rows that count half each."""
    rng, loads = np.random.default_rng(1), np.repeat([2e3, 4e3, 6e3], 50)
    truth, inside = np.array([-1.0, 0.0, 2.0]), []
    for _ in range(300):
        pairs = np.repeat(rng.normal(size=75), 2)
        means = means_over(loads, np.repeat(truth, 50) + pairs, 2.0)
        np.testing.assert_allclose(means.center, [2e3, 4e3, 6e3])
        inside.append(np.abs(means.mean - truth) < means.half)
    assert np.mean(inside) == pytest.approx(0.95, abs=0.03)


def test_a_swept_input_has_means_over_bins():
    rng = np.random.default_rng(2)
    x = rng.uniform(0, 1, 600)
    means = means_over(x, x**2, 1.0)
    assert len(means.center) == 12
    np.testing.assert_allclose(means.mean, means.center**2, atol=0.01)
    few = means_over(x[:2], x[:2], 1.0)
    assert [len(part) for part in few] == [0, 0, 0]


def test_means_by_groups_are_right():
    codes, values = np.array([0, 2, 2, 0, 2]), np.array([1.0, 5, 7, 3, 9])
    means = means_by(codes, codes, values, 1.0)
    np.testing.assert_allclose(means.mean[[0, 2]], [2, 7])
    np.testing.assert_allclose(means.half[2], 1.96 * np.std([5, 7, 9], ddof=1) / 3**0.5)


def test_density_of_gaussian_draws_is_gaussian():
    draws = norm.ppf((np.arange(200_000) + 0.5) / 200_000)
    edges = bin_edges(draws)
    middle = (edges[1:] + edges[:-1]) / 2
    expected = np.exp(-0.5 * middle**2)
    # The kernel widens it by one bin's standard deviation in square.
    np.testing.assert_allclose(marginal_density(draws, edges), expected, atol=0.03)
    assert np.mean((draws > edges[0]) & (draws < edges[-1])) >= 0.998


def test_bin_edges_have_a_width_and_ignore_a_far_mode():
    assert np.all(np.diff(bin_edges(np.full(100, 3.0))) > 0)
    assert np.all(np.diff(bin_edges(np.zeros(100))) > 0)
    far = np.append(np.random.default_rng(4).normal(size=9900), np.full(100, 1e4))
    assert bin_edges(far)[-1] < 8


def test_joint_regions_contain_their_shares():
    rng = np.random.default_rng(5)
    first, second = rng.normal(size=(2, 100_000))
    pair = bin_edges(first), bin_edges(second)
    outer, inner = enclosing(joint_density(first, second, pair), (0.95, 0.5))
    # Of two Gaussians the region is a circle: its density is exp(-r^2 / 2) of the top.
    top = joint_density(first, second, pair).max()
    assert outer / top == pytest.approx(0.05, abs=0.02)
    assert inner / top == pytest.approx(0.5, abs=0.07)


def test_profile_is_dense_and_ends_above_its_level():
    value = np.linspace(1.0, 9.0, 9)
    deviance = (value - 4.0) ** 2
    rows = near_level(deviance, 1.0)
    assert value[rows].tolist() == [2, 3, 4, 5, 6]
    grid, dense = dense_profile(value[rows], deviance[rows], 4.0, True)
    np.testing.assert_allclose(dense, (grid - 4.0) ** 2, atol=1e-12)
    assert (grid[0], grid[-1]) == (2, 6)
    assert not near_level(np.array([0.0, 0.5, np.inf]), 1.0)[-1]


def test_the_band_of_a_measurement_holds_the_noise_of_its_slip(given):
    """As the slope of the curve times it: 0.003 at slips of 0 and of full sliding."""
    std = np.full(len(given.problem.rows.weight), 0.003)
    noisy = replace(given, problem=given.problem.with_rows(slip_std={"sigma_x": std}))
    inputs = TireInputs(*np.zeros((7, 2)))._replace(sigma_x=np.array([0.0, 0.5]), fz=np.full(2, FZ))
    band = force_band(noisy, "fx", inputs, np.zeros(2, int), np.zeros(2))
    slope = np.array([given.derived["C_x"].value, 0.0])
    half = np.hypot(band.high - band.force, 1.96 * 0.003 * slope)
    np.testing.assert_allclose(band.noise_high - band.force, half, rtol=1e-3)
    np.testing.assert_allclose(band.force - band.noise_low, half, rtol=1e-3)
    assert half[0] > 100
