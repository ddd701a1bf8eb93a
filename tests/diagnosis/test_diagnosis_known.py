"""Stated and estimated properties of a derived file: vehicle, steering, drive force."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from conftest_diagnosis import brush
from scipy.interpolate import CubicSpline

from fits.withheld.car import Car, drive, steer
from tirefit.data.read import read, read_frame
from tirefit.data.write import csv_text
from tirefit.diagnosis.diagnose import diagnose
from tirefit.diagnosis.effects import EFFECTS, atoms_of, effects_by_id
from tirefit.diagnosis.effects.state import null_state
from tirefit.diagnosis.rows.covariates import derived_from
from tirefit.diagnosis.rows.prepared import prepare
from tirefit.diagnosis.rows.rig import Rig
from tirefit.diagnosis.rows.slips import AHEAD
from tirefit.report.diagnosis.report import diagnosis_text
from tirefit.report.diagnosis.words import needs_text

KNOWN = effects_by_id(EFFECTS)
LIBRARY = tuple(
    KNOWN[name]
    for name in (
        "tracked_point", "slip_offset", "steering_delay", "steering_lag",
        "steering_gain", "relaxation_length", "channel_delay", "friction_ellipse",
        "friction_run", "stiffness_run", "slip_offset_run", "friction_drift",
        "stiffness_drift", "friction_step",
    )
)  # fmt: skip
"""One for all tests: each library is a program of its own."""
RIG = Rig(noise={"fy_relative": 0.005, "alpha": 5e-4})
STATED = {"tracked_point": 0.0, "clock": 0.005, "yaw_inertia": 2300.0}


def stating(frame, **constants):
    """The data of a file with these constants in its first line."""
    data = read_frame(frame)
    return replace(data, source=replace(data.source, constants=constants))


@pytest.fixture(scope="module")
def driven():
    return drive(Car(), rows=240)


@pytest.fixture(scope="module")
def plain(driven):
    """The diagnosis of the rear axle of a car without any error."""
    return diagnose(stating(driven, **STATED), rig=RIG, effects=LIBRARY)


# --- what nobody stated is not known ----------------------------------------------


def prior(effect, data, rig=RIG):
    prepared = prepare(data, rig, ("fy",))
    return atoms_of([KNOWN[effect]])[0].prior(prepared, rig)


@pytest.mark.parametrize(
    ("effect", "key", "wide"),
    [
        ("tracked_point", "tracked_point", 0.1 * 2.6),
        ("channel_delay", "clock", 0.1),
        ("yaw_inertia", "yaw_inertia", 2300 / 2.6),
    ],
)
def test_unknown_properties_have_a_wide_prior(driven, effect, key, wide):
    stated = prior(effect, stating(driven, wheelbase=2.6, **STATED))
    rest = {name: value for name, value in STATED.items() if name != key}
    found = prior(effect, stating(driven, wheelbase=2.6, **rest))
    assert found.scale == pytest.approx(wide)
    assert found.scale > 3 * stated.scale
    # A stated standard error counts before that.
    errors = {"position": 0.01, "clock": 0.01, "yaw_inertia": 0.1}
    told = prior(effect, stating(driven, wheelbase=2.6, **rest), Rig(vehicle=errors))
    assert told.scale < 0.5 * found.scale


def test_the_stated_clock_error_is_the_prior_of_a_delay(driven):
    data = stating(driven, **STATED | {"clock": 0.02})
    assert prior("channel_delay", data).scale == pytest.approx(0.02)


def test_an_undeclared_reference_point_is_found():
    """30 cm on a wheelbase of 2.6 m: more than the error of a ruler."""
    data = stating(drive(Car(ahead=0.3), rows=240), wheelbase=2.6)
    found = diagnose(data, rig=RIG, effects=LIBRARY)
    assert found.effects == ("tracked_point",)
    (size,) = found.candidates[0].parameters.values()
    assert abs(size.value + 0.3) < 4 * size.std < 0.1
    assert "vehicle.toml does not state tracked_point" in " ".join(found.data.motion)
    assert KNOWN["tracked_point"].remedy.startswith("measure")


def test_estimates_of_derive_are_reported_with_the_verdict(driven, plain, tmp_path):
    shown = "alpha_zero=-0.0098 tracked_point=0 found_point=0.11 found_point_std=0.002"
    shown += " late_steering=-0.127 late_steering_std=0.015"
    path = tmp_path / "axle.csv"
    path.write_text(f"# tirefit: convention braking, constants {shown}\n{csv_text(driven)}")
    found = diagnose(read(path), rig=RIG, effects=LIBRARY[:2])
    (said,) = (text for text in found.data.assumptions if "found by tirefit derive" in text)
    assert "alpha is -0.0098 rad where fy = 0" in said
    assert "by force against slip 0.11 ± 0.002 m ahead of the stated one: correct it" in said
    assert "the steering changes 0.13 ± 0.01 s before the path's curvature" in said
    assert said in " ".join(diagnosis_text(found).split())  # once, in the short report
    assert "found by tirefit derive" not in " ".join(plain.data.assumptions)


# --- the steering -----------------------------------------------------------------

DELAY = 0.12


@cache
def front_axle():
    return drive(Car(), "front", rows=240)


def front(logged):
    """The front axle, its road wheel angle logged as ``logged(time)``."""
    frame = dict(front_axle())
    time, true = frame["time"], frame["steering"]
    other = logged(time)
    frame["alpha"] = frame["alpha"] + true - other
    frame["fy"] = frame["fy"] * np.cos(true) / np.cos(other)
    frame["steering"] = other
    step = 1e-4
    frame["alpha_rate"] = CubicSpline(time, frame["alpha"])(time, 1)
    frame["steering_rate"] = (logged(time + step) - logged(time - step)) / (2 * step)
    return frame


def lagging(time, constant=0.15):
    """The command whose first-order lag is :func:`steer`."""
    step = 1e-4
    return steer(time) + constant * (steer(time + step) - steer(time - step)) / (2 * step)


def shifted(effect, frame, amplitude):
    prepared = prepare(read_frame(frame), RIG, ("fy",))
    (atom,) = atoms_of([KNOWN[effect]])
    moved = atom.change(null_state(), amplitude, prepared.covariates)
    return prepared, np.asarray(moved.shift), np.asarray(moved.force)


@pytest.mark.parametrize(
    ("effect", "logged", "amplitude"),
    [("steering_delay", lambda time: steer(time + DELAY), DELAY), ("steering_lag", lagging, 0.15)],
)
def test_a_steering_delay_changes_the_slip_by_the_angle(effect, logged, amplitude):
    """Rows 0.1 s apart: the rate gives the angle in between."""
    frame = front(logged)
    prepared, shift, force = shifted(effect, frame, amplitude)
    slip = prepared.past[:, AHEAD]
    turned = frame["steering"] - steer(frame["time"])
    right = np.tan(np.arctan(slip) + turned) - slip
    inside = frame["time"] > 1.5
    assert np.sqrt(np.mean(right**2)) > 5e-3
    missed = np.sqrt(np.mean((shift - right)[inside] ** 2))
    assert missed < 0.03 * np.sqrt(np.mean(right**2))
    # A force derived across the logged wheels: the law is of first order in an error that is
    # not small beside the angle.
    more = frame["fy"] - front_axle()["fy"]
    assert np.std((force - more)[inside]) < 0.25 * np.std(more)


@pytest.mark.parametrize(
    ("effect", "logged", "amplitude"),
    [
        ("steering_delay", lambda time: steer(time + DELAY), DELAY),
        pytest.param("steering_lag", lagging, 0.15, marks=pytest.mark.long),
    ],
)
def test_a_steering_delay_is_named(effect, logged, amplitude):
    found = diagnose(read_frame(front(logged)), rig=RIG, effects=LIBRARY)
    assert found.effects == (effect,)
    (size,) = found.candidates[0].parameters.values()
    assert size.value == pytest.approx(amplitude, rel=0.1)


def test_the_rear_axle_has_no_steering_effect(plain):
    assert "steering_delay" in {one.effect for one in plain.untestable}


# --- the drive force --------------------------------------------------------------


def test_the_drive_force_of_the_front_axle_is_derived():
    frame = drive(Car(), "front")
    pull = 300 * np.sin(np.arange(700))
    steered = frame | {"fx": pull, "fy": frame["fy"] - pull * np.tan(frame["steering"])}
    found = derived_from(read_frame(steered), "fy")
    assert found is not None and found.steered
    assert found.mass == pytest.approx(1400 * 1.4 / 2.6)


def test_the_error_of_a_drive_force_follows_from_its_share(driven):
    fx = 2000 * np.sin(0.3 * np.arange(240))
    sure = read_frame(driven | {"fx": fx})
    assert prior("friction_ellipse", sure).scale == pytest.approx(0.3)
    unsure = read_frame(driven | {"fx": fx, "fx_std": 0.25 * np.abs(fx) + 1e-9})
    assert prior("friction_ellipse", unsure).scale == pytest.approx(np.hypot(0.3, 0.5))


def test_columns_that_derive_can_add_are_reported(plain):
    assert needs_text(("other force",)) == "the force of the other slip"
    said = needs_text(("other force",), derived=True)
    assert said.endswith("(tirefit derive writes it: driven of vehicle.toml)")
    assert "driven of vehicle.toml" in " ".join(str(plain).split())


# --- runs -------------------------------------------------------------------------


ROWS = 120  # of each run


def two_tires(frictions, stiffnesses, seed=0):
    """Free driving on both sides, with another tire in every run."""
    generator, blocks = np.random.default_rng(seed), []
    for number, (mu, stiffness) in enumerate(zip(frictions, stiffnesses, strict=True)):
        time = np.arange(ROWS) * 0.1
        slip = 0.18 * np.sin(0.9 * time + number)
        force = brush(slip, stiffness, mu, 4000.0)
        force = force + 20 * generator.standard_normal(ROWS)
        blocks.append([time, np.arctan(slip), force, 0 * time + number])
    time, alpha, fy, run = np.concatenate(blocks, axis=1)
    run = np.array([f"r{k:.0f}" for k in run])
    return {"time": time, "alpha": alpha, "fy": fy, "fz": 0 * time + 4000, "run": run}


@pytest.mark.parametrize(
    ("frictions", "stiffnesses", "named"),
    [
        ((0.9, 0.6), (5e4, 5e4), {"friction_run"}),
        ((0.9, 0.6), (5e4, 3.5e4), {"friction_run", "stiffness_run"}),
        pytest.param((0.9, 0.7, 0.8, 1.0), (5e4,) * 4, {"friction_run"}, marks=pytest.mark.long),
        pytest.param((0.9, 0.9), (5e4, 5e4), set(), marks=pytest.mark.long),
    ],
)
def test_tires_that_differ_from_run_to_run_are_named(frictions, stiffnesses, named):
    rig = Rig(noise={"fy": 20.0, "alpha": 1e-4})
    data = read_frame(two_tires(frictions, stiffnesses))
    found = diagnose(data, rig=rig, effects=LIBRARY)
    assert set(found.effects) == named
    if named == {"friction_run"}:
        told = found.runs["friction"]
        own = np.log(frictions) - np.mean(np.log(frictions))
        shown = np.array([told.values[f"r{k}"] for k in range(len(own))])
        np.testing.assert_allclose(shown[:, 0], own, atol=0.02)
        assert np.all(shown[:, 1] < 0.02) and told.p_value < 1e-9


def test_a_step_between_two_runs_is_a_run_effect():
    """Consecutive runs: a change between them is an effect of the runs."""
    frame = two_tires((0.9, 0.6), (5e4, 5e4))
    frame["time"] = frame["time"] + 30.0 * (frame["run"] == "r1")
    rig = Rig(noise={"fy": 20.0, "alpha": 1e-4})
    assert diagnose(read_frame(frame), rig=rig, effects=LIBRARY).effects == ("friction_run",)
