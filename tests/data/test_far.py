"""Absurd values are reported; settings and noise are not."""

import numpy as np
import pytest

from tirefit.data.far import far_values
from tirefit.data.read import read_frame

ROWS = 80


def sweep(seed=0, n=ROWS, **changes):
    """A force over a slip, with loads constant to half a percent."""
    generator = np.random.default_rng(seed)
    slip = generator.uniform(-0.1, 0.25, n)
    columns = {
        "sigma_x": slip,
        "fx": 4000 * np.tanh(25 * slip) + 60 * generator.standard_normal(n),
        "fz": 4000 * (1 + 0.005 * generator.standard_normal(n)),
    }
    for column, values in changes.items():
        for row, value in values.items():
            columns[column][row] = value
    return columns


def named(columns, **how):
    return {(far.row, far.column) for far in far_values(read_frame(columns, **how))}


@pytest.mark.parametrize(
    ("column", "value"), [("fx", 4e5), ("fx", -4e6), ("fz", 9e9), ("fz", 4.0), ("fz", 4000 * 4.448)]
)
def test_a_value_far_from_the_others_is_reported(column, value):
    assert named(sweep(**{column: {17: value}})) == {(17, column)}


def test_a_slip_far_from_all_others_is_reported():
    columns = sweep()
    columns["sigma_x"] *= 0.1
    columns["sigma_x"][17] = 3.0
    assert named(columns) == {(17, "sigma_x")}


def test_several_outliers_are_all_found():
    found = named(sweep(n=400, fz=dict.fromkeys(range(30, 42), 4e6), fx={7: 1e7}))
    assert found == {*((row, "fz") for row in range(30, 42)), (7, "fx")}


@pytest.mark.parametrize("seed", range(20))
def test_noise_and_the_ends_of_a_range_are_no_outliers(seed):
    assert not named(sweep(seed))
    assert not named(sweep(seed, n=1000))


def test_settings_and_a_locked_wheel_are_no_outliers():
    # Two rows in forty at twice the load, and two where the wheel stood.
    held = sweep(n=40, fz={3: 8000.0, 4: 8020.0})
    held["sigma_x"][5:7] = 1e6
    assert not named(held)
    # Where one row in ten is there, it belongs to what was measured.
    assert not named(sweep(fz=dict.fromkeys(range(8), 2e5)))
    assert not named({key: values[:8] for key, values in sweep(fx={2: 4e5}).items()})
