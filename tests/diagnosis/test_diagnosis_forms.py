"""Free forms of effects: which forms are allowed, and what they may not name."""

from dataclasses import replace

import numpy as np
import pytest
from conftest_diagnosis import RIG, brush, record
from scipy.signal import lfilter

from tirefit.data.read import read_frame
from tirefit.diagnosis.effects import EFFECTS
from tirefit.diagnosis.engine import diagnose
from tirefit.diagnosis.evidence.forms import follows, form_columns
from tirefit.diagnosis.rows.prepared import prepare
from tirefit.diagnosis.rows.rig import Rig

BY_ID = {effect.id: effect for effect in EFFECTS}


def shapes_of(effect, frame):
    """The columns of the free forms of an effect: (n, k) each."""
    rows = prepare(read_frame(frame), RIG, ("fx",)).covariates
    u = frame["sigma_x"] / 0.1
    return [np.asarray(form.shapes(rows, u)) for form in BY_ID[effect].forms]


@pytest.mark.parametrize(
    "effect", ["force_zero_drift", "slip_zero_drift", "slip_offset_load", "slip_offset_speed"]
)
def test_constants_are_no_form_of_varying_effects(effect):
    """Otherwise a constant offset would be called a drift."""
    frame, _ = record(None)
    for shapes in shapes_of(effect, frame):
        assert shapes.std(axis=0).min() > 0
        np.testing.assert_allclose(shapes.mean(axis=0), 0.0, atol=1e-9 * shapes.max())


def test_an_offset_that_varies_by_a_fifth_is_named_offset():
    def truth(slip, time, fz, v):
        wander = 1 + 0.2 * np.cos(np.pi * time / 22.0)
        return brush(slip, 5e4, 0.9, fz) + 80.0 * wander

    frame, _ = record(truth, seed=6)
    assert diagnose(read_frame(frame), rig=RIG).effects == ("force_offset",)


# One row in 20 lies at a turn; of seeds 6 and 11, one more may.
@pytest.mark.parametrize("seed", [1, *(pytest.param(k, marks=pytest.mark.long) for k in (6, 11))])
def test_hysteresis_that_grows_with_the_force_is_named(seed):
    def truth(slip, time, fz, v):
        force, way = brush(slip, 5e4, 0.9, fz), np.sign(np.gradient(slip))
        return force + 60.0 * (0.5 + np.abs(force) / 3600.0) * way

    frame, _ = record(truth, seed=seed, rows=80)
    assert diagnose(read_frame(frame), rig=RIG).effects == ("force_hysteresis",)


def test_combined_slip_by_an_ellipse_is_named():
    frame, _ = record(None, seed=6)
    wave = np.sin(2 * np.pi * frame["time"] / 3.7)
    frame["alpha"] = 0.05 * wave
    used = 2 * 5e4 * np.abs(np.tan(frame["alpha"])) / (3 * 0.9 * frame["fz"])
    frame["fx"] = frame["fx"] * np.sqrt(1 - 0.7 * np.minimum(used, 0.95) ** 2)
    assert diagnose(read_frame(frame), rig=RIG).effects == ("combined_slip",)


def late(values, rows):
    """The value some rows earlier; at rest before."""
    return np.interp(np.arange(len(values)) - rows, np.arange(len(values)), values)


def slalom(rows=450):
    """A lateral slalom at 100 Hz and one speed, whose load moves with the cornering:
    time, slip, load, force and moment at constant friction."""
    time = 0.01 * np.arange(rows)
    wave = np.sin(np.pi * time) * (0.3 + 0.7 * time / time.max())
    slip, fz = 0.15 * wave, 4000.0 * (1 + 0.2 * wave)
    force = brush(slip, 5e4, 0.9, fz)
    u = np.minimum(2 * 5e4 * np.abs(slip) / (3 * 0.9 * fz), 1.0)
    moment = -0.06 * np.sign(slip) * 0.9 * fz * u * (1 - u) ** 3
    return time, slip, fz, force, moment


LATERAL = Rig(noise={"fy_relative": 0.01, "mz_relative": 0.001, "alpha": 0.001})


def measured(time, slip, fz, force, moment, seed=0):
    noise = np.random.default_rng(seed).standard_normal((3, len(time)))
    return read_frame(
        {
            "time": time,
            "alpha": np.arctan(slip) + 0.001 * noise[0],
            "fy": force + 0.01 * fz * noise[1],
            "mz": moment + 0.001 * fz * noise[2],
            "fz": fz,
            "v": np.full(len(time), 20.0),
        }
    )


def test_a_delayed_force_and_moment_are_named_a_delay():
    """The load differed as well: a lag of only the slip, as by a carcass, fails."""
    time, slip, fz, force, moment = slalom()
    data = measured(time, slip, fz, late(force, 4.3), late(moment, 4.3))
    verdict = diagnose(data, rig=LATERAL).verdict
    assert (verdict.status, verdict.effects) == ("named", ("channel_delay",))


@pytest.mark.long
def test_one_speed_does_not_separate_a_filter_from_relaxation():
    """The same equation over time and over distance: neither is named alone, whatever
    its prior."""
    time, slip, fz, force, moment = slalom()
    share = 1 - np.exp(-0.01 / 0.03)
    force, moment = (lfilter([share], [1, share - 1], values) for values in (force, moment))
    verdict = diagnose(measured(time, slip, fz, force, moment), rig=LATERAL).verdict
    said = {*verdict.effects, *verdict.also_possible}
    assert verdict.status == "cannot_tell"
    assert {"channel_delay", "relaxation_length"} <= said


def test_a_load_that_follows_the_slip_has_no_forms():
    """Any function of it is one of the slip, and would explain anything."""
    frame, _ = record(None)
    prepared = prepare(read_frame(frame), RIG, ("fx",))
    fraction = frame["sigma_x"] / 0.1
    effects, fields = [BY_ID["load_crosstalk"]], np.ones((prepared.n, 11))
    own = form_columns(effects, fields, prepared, fraction)
    assert own.shape == (prepared.n, 3)
    noise = np.random.default_rng(0).standard_normal(prepared.n)
    load = 1 + 0.2 * np.tanh(fraction) + 0.01 * noise
    rows = prepared.covariates._replace(fz=load)
    moved = replace(prepared, covariates=rows)
    assert form_columns(effects, fields, moved, fraction).shape == (prepared.n, 0)
    assert follows(load, fraction) and not follows(frame["fz"], fraction)
    assert not follows(np.ones(prepared.n), fraction)
