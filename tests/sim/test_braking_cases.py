"""The tables of ``fits/braking``: the meaning of their rows, and their cases."""

import numpy as np
import pytest
from scipy import stats

from fits.braking.__main__ import BRUSH, CASES, CONTROLLERS, SEEDS, STEER, made, numbers
from tirefit.online.braking.controllers import CONTROLLERS as KNOWN


def test_differences_are_computed_per_seed():
    """Two controllers on the same noise of the road: the interval is of a paired t."""
    random = np.random.default_rng(0)
    shared = random.normal(50.0, 5.0, 60)
    first, second = shared + random.normal(-1.0, 0.1, 60), shared
    row = numbers("xbs-servo", "stopping_distance", first, second)
    test = stats.ttest_rel(first, second).confidence_interval()
    assert float(row["less_abs_low"]) == pytest.approx(test.low, rel=1e-3)
    assert float(row["less_abs_high"]) == pytest.approx(test.high, rel=1e-3)
    alone = stats.ttest_1samp(first, 0.0).confidence_interval()
    assert float(row["low"]) == pytest.approx(alone.low, rel=1e-3)
    assert row["seeds"] == 60 and SEEDS >= 50


@pytest.mark.parametrize("case", ["low", "jump", pytest.param("tires", marks=pytest.mark.long)])
def test_every_case_can_be_selected(case):
    """Requests pass their checks, controllers are made: four of them, on each road."""
    assert {*CONTROLLERS} == {*KNOWN, "slip"} and set(CASES) == {"low", "jump", "tires"}
    for road, speed, tire, limit in CASES[case]:
        request, controllers = made(road, speed, tire, limit)
        assert request.limit == limit and {*controllers} == {*CONTROLLERS}
    request, _ = made("mu=0.3", 15.0, BRUSH, 8.0, STEER)
    assert request.steer == STEER
