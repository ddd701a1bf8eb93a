"""One quantity over many files: known scatter, drift and outlying files are found."""

import numpy as np
import pytest

from tirefit.fitting.verdict.across_files import across_files


def made(seed, n=400, scatter=0.02, drift=0.0, wild=(), least=0.005):
    generator = np.random.default_rng(seed)
    std = generator.uniform(least, 4 * least, n)
    when = np.arange(n)
    value = 0.9 + drift * (when / (n - 1) - 0.5) + scatter * generator.normal(size=n)
    value += std * generator.normal(size=n)
    value[list(wild)] += 0.3
    return value, std, when


def test_outlying_files_are_named_and_have_no_influence():
    clean, spoiled = (across_files(*made(0, wild=wild)) for wild in ((), (5, 77, 300)))
    assert np.flatnonzero(spoiled.outlier).tolist() == [5, 77, 300]
    assert not clean.outlier.any()
    assert abs(spoiled.middle - clean.middle) < 0.001
    assert abs(spoiled.scatter / clean.scatter - 1) < 0.05


@pytest.mark.parametrize("scatter", [0.0, 0.02])
def test_scatter_between_files_excludes_their_own_error(scatter):
    all_of_them = [across_files(*made(seed, scatter=scatter)) for seed in range(20)]
    mean = np.mean([one.scatter for one in all_of_them])
    assert mean == pytest.approx(scatter, rel=0.06, abs=0.0025)


@pytest.mark.parametrize(("n", "draws"), [(12, 150), (200, 60)])
def test_drift_is_found_with_its_error(n, draws):
    """Errors of the drift over their standard error are Gaussian."""
    results = [across_files(*made(s, n=n, drift=0.05)) for s in range(draws)]
    pulls = np.array([(one.change - 0.05) / one.change_std for one in results])
    assert abs(np.mean(pulls)) < 4 / np.sqrt(draws)
    assert 0.8 < np.median(np.abs(pulls)) / 0.6745 < 1.25
    still = [across_files(*made(s, n=n)).drifts for s in range(draws)]
    assert np.mean(still) < 0.035  # 1 % asked for
    if n == 200:
        assert np.mean([one.drifts for one in results]) > 0.9


def test_error_of_a_drift_is_that_of_huber():
    """His covariance with the factor 1 + p/n var(psi') / mean(psi')^2, for files without an error
    of their own; and their scatter, by the median, counts the two numbers of the line."""
    value, _, when = made(8, n=12, drift=0.05, wild=(4, 9))
    found = across_files(value, np.zeros(12), when)
    assert np.median(np.abs(found.pulls)) == pytest.approx(0.67449 * np.sqrt(10 / 12), rel=1e-3)
    slope_of_psi = (np.abs(found.pulls) < 1.345).astype(float)
    assert 0.6 < slope_of_psi.mean() < 1
    psi = np.clip(found.pulls, -1.345, 1.345)
    factor = 1 + 2 / 12 * slope_of_psi.var() / slope_of_psi.mean() ** 2
    variance = factor**2 * np.sum(psi**2) / (12 - 2) / slope_of_psi.mean() ** 2
    x = (when - when.mean()) / 11
    std = found.scatter * np.sqrt(variance / np.sum(x**2))
    assert found.change_std == pytest.approx(std, rel=1e-6)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_few_files_have_a_median_but_no_drift(n):
    few = across_files(np.arange(n, dtype=float), np.full(n, 0.1), np.arange(n))
    assert few.middle == pytest.approx((n - 1) / 2) and not few.drifts
    assert np.isfinite(few.pulls).all()


def test_equal_values_have_no_scatter():
    same = across_files(np.full(9, 3.0), np.zeros(9), np.arange(9))
    assert same.middle == pytest.approx(3) and same.scatter < 1e-12
    assert not same.outlier.any()


@pytest.mark.filterwarnings("error")
def test_a_file_with_a_huge_error_has_no_influence():
    value, std, when = made(3, n=60)
    sure = across_files(value, std, when)
    beside = across_files(np.append(value, 7.0), np.append(std, 1e200), np.append(when, 30.0))
    assert beside.middle == pytest.approx(sure.middle, abs=0.002)
    assert not beside.outlier[-1]
