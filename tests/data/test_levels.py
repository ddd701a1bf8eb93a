"""The settings of a rig are found despite noise, and none if there are none."""

import numpy as np
import pytest

from tirefit.data.rig.levels import cells, levels

LOADS = [222.0, 445.0, 667.0, 890.0, 1112.0]
ANGLES = [-6.0, -3.0, 0.0, 3.0, 6.0]
UNEVEN = [500.0, 900.0, 1500.0, 3000.0, 8000.0]


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("rows", [4, 40, 400])
@pytest.mark.parametrize("settings", [LOADS, ANGLES, UNEVEN])
def test_settings_are_found_despite_noise(settings, rows, seed):
    rng = np.random.default_rng(seed)
    truth = rng.permutation(np.repeat(np.arange(len(settings)), rows))
    spacing = np.min(np.diff(settings))
    noise = rng.normal(0, spacing / 14, len(truth))
    # As a data logger has them: in whole steps, which repeat exactly.
    step = spacing / 100
    values = step * np.round((np.array(settings)[truth] + noise) / step)
    found = levels(values)
    assert not found.is_swept and len(found.center) == len(settings)
    assert np.array_equal(found.code, truth)
    assert found.center == pytest.approx(settings, abs=spacing / 7)
    for code, (low, high) in enumerate(zip(found.low, found.high, strict=True)):
        assert (low, high) == (values[truth == code].min(), values[truth == code].max())


SWEPT = {
    "normal": lambda rng, n: rng.normal(0, 1, n),
    "uniform": lambda rng, n: rng.uniform(-1, 1, n),
    "skewed": lambda rng, n: rng.beta(2, 5, n),
    "ramp": lambda rng, n: np.linspace(-0.2, 0.2, n),
    "sine": lambda rng, n: np.sin(np.arange(n) * 0.37),
}


@pytest.mark.parametrize("n", [30, 100, 1000])
@pytest.mark.parametrize("kind", SWEPT)
def test_a_sweep_has_no_settings(kind, n):
    for seed in range(50):
        found = levels(SWEPT[kind](np.random.default_rng(seed), n))
        assert found.is_swept and len(found.center) == 1 and not found.few(6)
        assert not found.code.any()


def test_settings_do_not_depend_on_scale_and_order():
    rng = np.random.default_rng(5)
    values = np.repeat(UNEVEN, 7) + rng.normal(0, 10, 35)
    found = levels(values)
    for factor in (1e-6, -1.0, 1e6):
        other = levels(factor * values)
        assert len(other.center) == 5
        assert np.array_equal(other.code, found.code if factor > 0 else 4 - found.code)
    order = rng.permutation(35)
    assert np.array_equal(levels(values[order]).code, found.code[order])


def test_a_constant_is_one_setting():
    assert levels(np.full(9, 4000.0)).few(1)
    assert levels(np.zeros(9)).few(1)
    # What the rig cannot hold closer, in the whole newtons of the file.
    held = levels(4000 + np.resize([-5.0, 0, 5, 3], 60))
    assert held.few(1) and held.center == [4001.5]
    assert levels([3.0]).few(1)
    assert len(levels([]).center) == 0 and len(levels([]).code) == 0


def test_one_wrong_row_is_no_setting():
    values = np.append(np.repeat([2000.0, 4000.0], 30), 9000.0)
    found = levels(values)
    assert len(found.center) == 2 and list(np.bincount(found.code)) == [30, 31]


def test_few_returns_the_number_of_settings():
    found = levels(np.repeat(LOADS, 3))
    assert found.few(5) and not found.few(4)


def test_cells_contain_count_mean_and_deviation():
    codes, values = np.array([3, 0, 3, 3, 1]), np.array([1.0, 5.0, 2.0, 6.0, 7.0])
    count, mean, std = cells(codes, 5, values)
    assert count.tolist() == [1, 1, 0, 3, 0]
    assert mean.tolist() == [5, 7, 0, 3, 0]
    assert std == pytest.approx([0, 0, 0, np.std([1, 2, 6], ddof=1), 0])
