"""The 95 % intervals contain the truth as often as stated.

60 data sets of one model in the suite, 200 of others in ``make test-long``, within binomial
limits that a right interval breaks once in a thousand, or 100 where they leave no doubt;
1,600 of every model and setting on request (``make statistics``), within 93-97 %.
"""

import numpy as np
import pytest
from coverage import SETTINGS, coverage, holds_or_says, synthetic
from scipy.stats import binom

MODELS = ["brush", "brush-d", "brush-m", "brush-n", "brush-h"]
FEW, MANY = 200, 1600

ROWS = 64
"""Of a data set in the suite: a third of the time of 400, and further from the many rows at
which every interval is right."""


SURE = 0.94, 0.98
"""Shares of the first half of the data sets with which the second is not asked for. All
of them fail an interval that holds the truth 88 times in 100 with 0.70, and one that
always holds it surely; of the first kind 1 in 27 comes through here, of the second
none."""


def half_or_all(model, setting):
    """Share of data sets whose profile intervals contain the truth, by parameter."""
    half = FEW // 2
    first, _ = coverage(model, setting, half, rows=ROWS)
    if all(SURE[0] <= share <= SURE[1] for share in first.values()):
        return first
    second, _ = coverage(model, setting, half, first=half, rows=ROWS)
    return {label: (first[label] + second[label]) / 2 for label in first}


@pytest.mark.long
@pytest.mark.parametrize(
    ("setting", "model"), [("rig", "brush-d"), ("rig", "brush-m"), ("seed", "brush-h")]
)
def test_profile_intervals_cover(setting, model):
    inside = half_or_all(model, setting)
    low, high = binom.ppf([0.0005, 0.9995], FEW, 0.95) / FEW
    assert all(low <= share <= high for share in inside.values()), inside


def test_intervals_cover_with_estimated_noise():
    # So few rows that a normal in place of Student's t would show: 88 %.
    inside, _ = coverage("brush", "plain", 100, rows=6, estimated=True)
    low, high = binom.ppf([0.0005, 0.9995], 100, 0.95) / 100
    assert all(low <= share <= high for share in inside.values()), inside


@pytest.mark.long
@pytest.mark.parametrize("setting", ["rig", "seed"])
def test_intervals_at_low_friction_use_cover_or_are_reported(setting):
    # 60 % of the friction: 1 - (1 - u)^3 = 0.6 at u = 0.263 of full sliding.
    outcomes = [
        holds_or_says(
            "brush", SETTINGS[setting], synthetic("brush", SETTINGS[setting], 400, 0.26, seed)
        )
        for seed in range(60)
    ]
    low = binom.ppf(0.0005, 60, 0.95) / 60
    assert np.mean(outcomes) >= low


@pytest.mark.statistics
@pytest.mark.parametrize("setting", ["rig", "seed"])
@pytest.mark.parametrize("model", MODELS)
def test_profile_intervals_cover_in_1600(model, setting):
    inside, _ = coverage(model, setting, MANY)
    assert all(0.93 <= share <= 0.97 for share in inside.values()), inside


@pytest.mark.statistics
@pytest.mark.parametrize("model", MODELS)
def test_posterior_intervals_cover_in_1600(model):
    _, inside = coverage(model, "plain", MANY, posterior=True)
    assert all(0.93 <= share <= 0.97 for share in inside.values()), inside


@pytest.mark.statistics
@pytest.mark.parametrize("model", MODELS)
def test_posterior_intervals_cover_with_slip_noise(model):
    _, inside = coverage(model, "seed", FEW, posterior=True)
    low, high = binom.ppf([0.0005, 0.9995], FEW, 0.95) / FEW
    assert all(low <= share <= high for share in inside.values()), inside
