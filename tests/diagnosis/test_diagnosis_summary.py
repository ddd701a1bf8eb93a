"""Conditions that rise and fall together are reported, crossed ones are not."""

import numpy as np
import pytest
from conftest_diagnosis import RIG
from scipy.stats import false_discovery_control, spearmanr

from tirefit.data.read import read_frame
from tirefit.diagnosis.rows.prepared import prepare
from tirefit.diagnosis.summary.where import adjusted, moving_together, rank_correlation
from tirefit.fitting.problem import find_model
from tirefit.models import modelled

ROWS = 300


def said_of(fz, v):
    time = np.arange(ROWS) * 0.1
    slip = 0.1 * np.sin(time)
    frame = {"time": time, "sigma_x": slip, "fx": fz * np.tanh(8 * slip), "fz": fz}
    data = read_frame(frame | {"v": v}, convention="braking")
    return moving_together(prepare(data, RIG, modelled(find_model("brush"))))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_correlated_speed_and_time_are_reported(sign):
    generator = np.random.default_rng(0)
    v = 20 + sign * np.linspace(-8, 8, ROWS) + 0.1 * generator.standard_normal(ROWS)
    (said,) = said_of(generator.uniform(3e3, 5e3, ROWS), v)
    how = "rises" if sign > 0 else "falls"
    assert said.startswith(f"v {how} with time in this file (rank correlation")
    assert f"{sign:.2f}"[:-2] in said


def test_a_crossed_design_reports_no_correlation():
    fz, v = np.meshgrid([2e3, 4e3, 6e3], np.tile([5.0, 15.0], ROWS // 6))
    assert said_of(fz.ravel(), v.ravel()) == ()


def test_rising_load_in_time_is_reported():
    fz = np.repeat([2e3, 4e3, 6e3], ROWS // 3)
    (said,) = said_of(fz, np.tile([5.0, 15.0], ROWS // 2))
    assert said.startswith("fz rises with time")


@pytest.mark.parametrize("count", [1, 2, 7, 50])
def test_p_values_are_adjusted_as_by_scipy(count):
    chances = np.random.default_rng(count).uniform(0, 0.2, count)
    for dependent, method in ((False, "bh"), (True, "by")):
        expected = false_discovery_control(chances, method=method)
        np.testing.assert_allclose(adjusted(chances, dependent), expected, rtol=1e-12)


def test_the_rank_correlation_of_values_with_ties_is_that_of_scipy():
    generator = np.random.default_rng(0)
    one = generator.integers(0, 5, 100)
    other = one + generator.integers(0, 3, 100)
    expected = spearmanr(one, other).statistic
    np.testing.assert_allclose(rank_correlation(one, other), expected, rtol=1e-12)
