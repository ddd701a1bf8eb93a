"""The tracked point from the force and the slip: found, refused, doubted."""

import re

import numpy as np
import pytest
from test_contradictions import BESIDE, DART, DART_LOGS, POSE, RATES, derived, log_of, vehicle_text

from tirefit.data.vehicle.derive import derive
from tirefit.data.vehicle.vehicle import load_vehicle
from tirefit.results import DataError

L_F, L_R = 1.2, 1.4


def dart(tmp_path, point):
    """The DART car with its tracked point declared elsewhere."""
    text = (DART / "vehicle.toml").read_text()
    path = tmp_path / "vehicle.toml"
    path.write_text(text.replace("[0.115,", f"[{point},"))
    return load_vehicle(path)


@pytest.mark.parametrize("path", DART_LOGS)
def test_a_measured_log_is_accepted_only_at_its_reference_point(path, tmp_path):
    right = derive(path, dart(tmp_path, 0.115))
    at, std = right.point.estimate
    assert right.warnings == () and std < 0.03
    assert at == pytest.approx(0.115, abs=3 * std)
    assert f"± {std:.1g} m" in right.summary()
    number = [one.id for one in DART_LOGS].index(path.name)
    wrong = 0.115 + (-0.13, 0.13)[number % 2]
    result = derive(path, dart(tmp_path, wrong), believe=True)
    (said,) = (text for text in result.warnings if "tracked_point" in text)
    # What is stated does not move the estimate.
    assert result.point.estimate == pytest.approx((at, std), rel=0.05, abs=1e-4)
    assert f"set tracked_point = [{at:.3g}, -0.01] in vehicle.toml" in said


def test_a_reference_point_too_far_behind_is_refused(tmp_path):
    (path,) = DART.glob("free_driving*/*10_02_28.csv.gz")
    with pytest.raises(DataError) as caught:
        derive(path, dart(tmp_path, -0.015))
    (problem,) = caught.value.problems
    assert "the lateral force acts in the direction of the" in problem.reason
    assert problem.file.endswith("10_02_28.csv.gz")
    assert "tracked_point = [0.113, -0.01]" in problem.remedy


def moved(log, ahead):
    """Rates of a point this far ahead of the centre of gravity [m]."""
    turning = np.gradient(log["c3"], log["time"])
    return log | {"c2": log["c2"] + ahead * log["c3"], "c4": log["c4"] + ahead * turning}


@pytest.mark.parametrize(
    ("name", "ahead"),
    [
        ("turns", 1.2),
        ("slow", -0.5),
        *(
            pytest.param(name, ahead, marks=pytest.mark.long)
            for name, ahead in (
                ("turns", -0.5), ("slow", 1.2),
                ("turns and brakes", -0.5), ("turns and brakes", 1.2),
            )
        ),
    ],
)  # fmt: skip
def test_the_reference_point_is_recovered_within_its_error(tmp_path, name, ahead):
    off = []
    for seed in range(5):
        log = moved(log_of(seed, name), ahead)
        at, std = derived(tmp_path, log, RATES, believe=True).point.estimate
        off.append((at - L_R - ahead) / std)
        assert std < 0.05
    assert abs(np.mean(off)) < 1.2 and np.std(off) < 2


def test_gps_at_the_front_axle_is_refused_with_a_working_remedy(tmp_path):
    log = moved(log_of(name="slow"), L_F)
    with pytest.raises(DataError) as caught:
        derived(tmp_path, log, RATES)
    (problem,) = caught.value.problems
    assert "acts in the direction of the axle's slip" in problem.reason
    line = re.search(r"tracked_point = \[([\d.]+), 0\]", problem.remedy)
    assert float(line[1]) == pytest.approx(L_R + L_F, abs=0.06)
    path = tmp_path / "vehicle.toml"
    path.write_text(f"{line[0]}\n{vehicle_text(RATES)}")
    again = derive(tmp_path / "log.csv", load_vehicle(path))
    sound = derived(tmp_path, log_of(name="slow"), RATES)
    assert again.warnings == ()
    np.testing.assert_allclose(again.columns["alpha"], sound.columns["alpha"], atol=2e-3)


def test_a_wrong_reference_point_is_doubted_if_forces_still_oppose_the_slip(tmp_path):
    (said,) = derived(tmp_path, moved(log_of(name="turns"), L_F), RATES).warnings
    assert "the tracked point is 2.6 ± 0.03 m ahead of the rear axle" in said


def test_a_force_above_any_friction_is_doubted(tmp_path):
    text = vehicle_text(RATES).replace("yaw_inertia = 2500", "yaw_inertia = 20000")
    (tmp_path / "heavy.toml").write_text(text)
    log = log_of(name="turns")
    log = log | {"c4": 2.2 * log["c4"]}
    derived(tmp_path, log, RATES, believe=True)
    result = derive(tmp_path / "log.csv", load_vehicle(tmp_path / "heavy.toml"), believe=True)
    (said,) = (text for text in result.warnings if "friction" in text)
    share = float(said.split("reaches ")[1].split()[0])
    force = np.abs(result.columns["fy"] / result.columns["fz"])
    assert share == pytest.approx(np.percentile(force, 99), rel=0.05) and share > 1.5


@pytest.mark.parametrize("fault", ["yaw_inertia", "the time of a channel", "the place of the a_y"])
def test_an_error_that_acts_like_another_point_is_named_with_it(tmp_path, fault):
    log = log_of(name="turns")
    text = vehicle_text(RATES)
    if fault == "yaw_inertia":
        text = text.replace("yaw_inertia = 2500", "yaw_inertia = 10000")
    elif fault == "the time of a channel":
        log = late(log, ("c2",), 0.1)
    else:
        log = log | {"c4": moved(log, 1.2)["c4"]}
    derived(tmp_path, log, RATES)
    path = tmp_path / "vehicle.toml"
    path.write_text(text)
    (said,) = derive(tmp_path / "log.csv", load_vehicle(path)).warnings
    assert re.search(r"set tracked_point = \[-?[\d.]+, 0\] in vehicle.toml", said)
    assert "unless one of these is wrong, which acts alike" in said and fault in said


@pytest.mark.parametrize("columns", [RATES, POSE])
def test_a_nearly_straight_log_does_not_determine_the_point(tmp_path, columns):
    for name in ("straight", "hardly turns"):
        result = derived(tmp_path, log_of(name=name), columns)
        assert not any("tracked_point" in said for said in result.warnings)
    result = derived(tmp_path, log_of(name="straight"), columns)
    assert result.point.estimate is None
    assert "does not determine it" in result.summary()


def late(log, channels, seconds):
    time = log["time"]
    return log | {c: np.interp(time - seconds, time, log[c]) for c in channels}


@pytest.mark.parametrize("name", ["turns", "slow", "gently"])
def test_a_pose_with_another_clock_is_refused(tmp_path, name):
    log = log_of(name=name)
    with pytest.raises(DataError) as caught:
        derived(tmp_path, late(log, ("c7", "c8", "c9"), 0.34), POSE | BESIDE)
    (problem,) = caught.value.problems
    assert re.search(r"the pose is 0\.34 ± 0\.00\d+ s late", problem.reason)
    assert "shift the pose in the log" in problem.remedy
    assert ("leave a_y out" in problem.remedy) == ("late against a_y" in problem.reason)
    result = derived(tmp_path, late(log, ("c7", "c8", "c9"), 0.1), POSE | BESIDE)
    assert "delays up to 0.1" in result.summary()


@pytest.mark.parametrize("name", ["slow", "gently"])
def test_a_wrong_sign_of_v_y_is_found_without_a_contradicting_pair(tmp_path, name):
    log = log_of(name=name)
    (said,) = derived(tmp_path, log | {"c2": -log["c2"]}, RATES).warnings
    assert "v_y or a_y has the wrong sign" in said and 'v_y = "-m/s"' in said
