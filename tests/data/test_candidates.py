"""The tracked point of logs of simulated cars, at several speeds, noises and cutoffs."""

import re
from itertools import product

import numpy as np
import pytest

from tirefit.data.read import read
from tirefit.data.vehicle.derive import derive, derive_files
from tirefit.data.vehicle.vehicle import load_vehicle
from tirefit.data.write import csv_text
from tirefit.results import DataError
from tirefit.sim.drive import Car, simulate_drive
from tirefit.sim.settings import Drive

CAR = Car(l_r=1.5)
BASE = CAR.l_f + CAR.l_r
POSE = 'x = "x"\ny = "y"\nyaw = "heading"'
RATES = 'v_x = "vx"\nv_y = "vy"\nyaw_rate = "r"'
SLOW = {
    "bends of 5 s": {"speed": 8.0, "bend": 0.4, "gps_std": 0.005},
    "bends of 10 s": {"speed": 8.0, "bend": 0.4, "bend_period": 10.0, "gps_std": 0.005},
    "noise of 2 cm": {"speed": 8.0, "bend": 0.4, "bend_period": 6.0},
    "faster": {"speed": 12.0, "bend": 0.4, "gps_std": 0.005},
}
FAST = {"fast": {}, "gentle": {"bend": 0.2, "speed": 15.0}, "brakes": {"brake": 0.3, "bend": 0.4}}


def log_at(tmp_path, ahead, how, seed=0, columns=POSE):
    """Path of the log of a point this far ahead of the centre of gravity [m]."""
    log = simulate_drive(Drive(seed=seed, **how), CAR)
    seen, true = log.columns, log.truth
    heading = true["heading"]
    out = {
        "time": seen["time"],
        "x": seen["x"] + ahead * np.cos(heading),
        "y": seen["y"] + ahead * np.sin(heading),
        "heading": seen["heading"],
    }
    if columns == RATES:
        noise = 0.02 * np.random.default_rng(seed).standard_normal((3, len(heading)))
        out = {
            "time": seen["time"],
            "vx": true["v"] + noise[0],
            "vy": true["v_y"] + ahead * true["yaw_rate"] + noise[1],
            "r": true["yaw_rate"] + 0.1 * noise[2],
        }
    path = tmp_path / "log.csv"
    path.write_text(csv_text(out))
    return path


def vehicle(tmp_path, point=None, columns=POSE, cutoff=2.0):
    stated = "" if point is None else f"tracked_point = [{point}, 0.0]"
    path = tmp_path / "vehicle.toml"
    path.write_text(
        f"mass = {CAR.mass}\nl_f = {CAR.l_f}\nl_r = {CAR.l_r}\nyaw_inertia = {CAR.yaw_inertia}\n"
        f'{stated}\n[columns]\ntime = "time"\n{columns}\n[filter]\ncutoff = {cutoff}\n'
        "sample_rate = 50.0\n"
    )
    return load_vehicle(path)


def of_the_point(log, car):
    """The sentences on the tracked point: warnings, or the reason and remedy of a refusal."""
    try:
        found = derive(log, car)
    except DataError as error:
        return " ".join(f"{p.reason}; {p.remedy}" for p in error.problems)
    return " ".join(found.point.warnings)


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.long)])
@pytest.mark.parametrize("name", SLOW)
def test_a_log_of_the_front_axle_names_it(tmp_path, name, seed):
    log = log_at(tmp_path, CAR.l_f, SLOW[name], seed)
    said = of_the_point(log, vehicle(tmp_path))
    assert "set tracked_point = [2." in said and "--" not in said
    right = derive(log, vehicle(tmp_path, BASE))
    assert right.point.warnings == () and right.point.problems == ()


@pytest.mark.parametrize("columns", [POSE, RATES])
def test_the_correlations_and_what_was_assumed_are_named(tmp_path, columns):
    log = log_at(tmp_path, CAR.l_f, SLOW["bends of 10 s"], columns=columns)
    said = of_the_point(log, vehicle(tmp_path, columns=columns, cutoff=1.0))
    at = re.search(r"the tracked point is ([\d.]+) ± ([\d.]+) m ahead of the rear axle", said)
    assert float(at[1]) == pytest.approx(BASE, abs=2 * float(at[2]))
    assert "not 1.5 m (the centre of gravity, which is assumed, as tracked_point" in said
    assert f"set tracked_point = [{at[1]}, 0] in vehicle.toml" in said
    # The oracle is the simulator: its own force and slip of the rear axle.
    truth = simulate_drive(Drive(**SLOW["bends of 10 s"]), CAR).truth
    slip = np.arctan2(truth["v_y"] - CAR.l_r * truth["yaw_rate"], truth["v"])
    force = CAR.l_f * truth["a_y"]
    assert np.corrcoef(slip, -force)[0, 1] > 0.99


RIGHT = [
    pytest.param(name, seed, marks=[pytest.mark.long] * seed)
    for name, seed in product(SLOW | FAST, (0, 1))
]


@pytest.mark.parametrize(("name", "seed"), RIGHT)
def test_the_right_point_is_not_doubted(tmp_path, name, seed):
    log = log_at(tmp_path, 0.0, (SLOW | FAST)[name], seed)
    for cutoff in (2.0, 5.0):
        assert of_the_point(log, vehicle(tmp_path, cutoff=cutoff)) == ""


def test_a_fit_of_the_derived_file_names_the_vehicle_file(tmp_path):
    log = log_at(tmp_path, CAR.l_f, SLOW["bends of 10 s"])
    vehicle(tmp_path, cutoff=1.0)
    out = derive_files([log], tmp_path / "vehicle.toml", tmp_path / "axle.csv", believe=True).data
    with pytest.raises(DataError) as caught:
        read(out)
    (problem,) = caught.value.problems
    assert "correct tracked_point" in problem.remedy and "vehicle.toml" in problem.remedy
    assert "--convention" not in f"{problem}"


def test_the_point_of_a_pose_does_not_depend_on_the_cutoff(tmp_path):
    """At 5 Hz the noise of the pose would hide the force; both are 1.5 m, the truth."""
    log = log_at(tmp_path, 0.0, SLOW["noise of 2 cm"])
    (low, std), (high, _) = (
        derive(log, vehicle(tmp_path, cutoff=cutoff)).point.estimate for cutoff in (2.0, 5.0)
    )
    assert low == pytest.approx(high, abs=0.2 * std)
    assert low == pytest.approx(CAR.l_r, abs=3 * std) and std < 0.08


def test_instruments_that_hardly_explain_the_slip_determine_no_point(tmp_path):
    """Their bias is that of least squares, 0.8 m here, which the standard error does not have."""
    how = {"bend": 0.2, "speed": 15.0, "gps_std": 0.04}
    log = log_at(tmp_path, 0.0, how, seed=1)
    assert derive(log, vehicle(tmp_path), believe=True).point.estimate is None
