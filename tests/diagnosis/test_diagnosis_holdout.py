"""Which rows are left out, and what a verdict owes to them."""

import numpy as np
import pytest
from tirefit.diagnosis.left_out.holdout import _quarters, _told

import tirefit
from fits.withheld.injected import CHANGES, half
from tirefit.data.read import read_frame
from tirefit.diagnosis.rows.prepared import prepare
from tirefit.diagnosis.rows.rig import Rig
from tirefit.diagnosis.summary.records import HeldOut


def late(seconds: float):
    """Free driving of a measured axle, its force late."""
    data = half(1)
    change, *_ = CHANGES["channel_delay"]
    return read_frame(data | change(data, seconds, None))


def test_a_log_without_settings_is_cut_into_quarters_in_the_order_of_time():
    data = half(1)
    mixed = np.random.default_rng(3).permutation(len(data["time"]))
    rows = prepare(read_frame({k: v[mixed] for k, v in data.items()}), Rig(), ("fy",))
    quarter = _quarters(rows)
    assert np.ptp(np.bincount(quarter)) <= 1
    last = [rows.covariates.time[quarter == k].max() for k in range(3)]
    first = [rows.covariates.time[quarter == k].min() for k in range(1, 4)]
    assert np.all(np.array(last) < np.array(first))


@pytest.mark.parametrize("seconds, at_limit", [(0.031, False), (0.06, True)])
def test_a_delay_is_named_in_a_log_that_no_model_fits_at_its_limit(seconds, at_limit):
    result = tirefit.diagnose(late(seconds))
    assert result.verdict.status == "incomplete"
    assert "channel_delay" in result.verdict.effects
    held = result.gap.holdout
    assert held.closed > 0
    if at_limit:
        assert held.on == "largest slip, left out of both fits"
    else:  # then the rest of the log decides, and both is said
        in_turn, limit = held.on.removesuffix(")").split(" (")
        assert in_turn == (
            "each of 4 stretches of the record, left out of both fits in turn"
        )
        assert limit in (  # which of the two, the noise decides
            "the largest slips, left out, are predicted no better than without it",
            "fits without the largest slips know too little to tell there",
        )
        low, high = held.closed_ci
        assert 0 < low < held.closed < high < 1
    delay = next(
        p for name, p in result.candidates[0].parameters.items() if "delay" in name
    )
    assert abs(delay.value - seconds) < 0.015


def test_a_log_as_it_was_measured_has_no_delay():
    result = tirefit.diagnose(read_frame(half(1)))
    assert "channel_delay" not in result.verdict.effects


def trailer(power: float, seed: int = 5, rows: int = 800):
    """Braking pulses under a load that bounces; only their tops slide."""
    generator = np.random.default_rng(seed)
    time = 0.02 * np.arange(rows)
    fz = 4000 * (1 + 0.2 * np.sin(10.7 * time) + 0.05 * np.sin(56.5 * time))
    slip = 0.12 * np.maximum(0.0, np.sin(2.4 * time)) ** 2
    mu = 0.9 * (fz / 4000) ** power
    # S(12) of a brush of c_p a^2 = 40 kN.
    x = np.minimum(slip * 8e4 / (3 * mu * fz), 1.0)
    fx = mu * fz * (3 * x - 3 * x**2 + x**3) + 60 * generator.standard_normal(rows)
    speed = np.full(rows, 18.0)
    return read_frame({"time": time, "sigma_x": slip, "fx": fx, "fz": fz, "v": speed})


def test_where_only_the_largest_slips_know_the_friction_quarters_are_left_out():
    result = tirefit.diagnose(trailer(-0.15))
    assert result.verdict.effects == ("load_friction",)
    assert result.verdict.status in ("named", "cannot_tell")
    held = result.gap.holdout
    assert held.on.startswith("each of 4 stretches of the record")
    assert "fits without the largest slips know too little" in held.on
    assert 0.4 < held.closed < 1


@pytest.mark.parametrize(
    ("low", "high", "told"),
    [(-0.15, 0.05, False), (0.1, 0.3, True), (-0.4, -0.1, True)],
)
def test_a_closure_of_either_sign_tells_nothing(low, high, told):
    middle = (low + high) / 2
    held = HeldOut(
        rms=9.0, resolvable=True, closed=middle, closed_ci=(low, high),
        remaining_rms=9.0 * (1 - middle), on="each of 4 stretches",
    )  # fmt: skip
    assert (_told(held) == held) == told
    assert _told(held).closed == (middle if told else None)
    assert _told(held).resolvable == told
