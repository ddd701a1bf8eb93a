"""`derive` on a simulated vehicle with known slip angles and forces."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat
from test_motion import (
    CAR,
    HEIGHT,
    KEEP,
    L_F,
    L_R,
    MASS,
    POSE,
    RATES,
    TRACKED,
    WHEELBASE,
    assert_true,
    pose_log,
    pose_vehicle,
    speed,
    stamps,
    steer,
    truth,
    vehicle,
    write_log,
)

from tirefit.data.vehicle.derive import derive, derive_files
from tirefit.data.vehicle.vehicle import load_vehicle
from tirefit.results import DataError, UsageError

DART = Path(__file__).parents[2] / "fits" / "dart_jetracer"


def test_a_log_with_poses_gives_the_true_slip_angle_and_force(tmp_path):
    columns = pose_log()
    settings = pose_vehicle(tmp_path)
    log = derive(write_log(tmp_path / "a.csv", columns), settings)
    assert_true(log, columns["t"][0], settings)
    assert np.ptp(log.columns["fy"]) > 5
    np.testing.assert_allclose(log.columns["fz"], MASS * 9.80665 * L_F / WHEELBASE)
    time = log.columns["time"] + columns["t"][0]
    np.testing.assert_allclose(log.columns["v"], speed(time), atol=0.01)


@pytest.mark.parametrize("axle", ["rear", "front"])
def test_signs_follow_the_drawing_in_slip(tmp_path, axle):
    """A car on a left circle, its body rotated by 0.2 rad from its course."""
    time = np.arange(0, 8, 0.01)
    radius, rate, beta = 4.0, 0.5, 0.2
    course = rate * time
    columns = {
        "t": time,
        "x": radius * np.sin(course),
        "y": -radius * np.cos(course),
        "psi": course - beta,  # nose to the right of the course: it slides to the left
        "command": 0 * time,
    }
    text = CAR.replace("tracked_point", "# tracked_point") + POSE
    text += 'steering = "command"\n' + KEEP
    text += "[steering]\ncommand = [-1, 1]\nangle = [0.1, 0.1]\n"
    settings = vehicle(tmp_path, text)
    log = derive(write_log(tmp_path / "a.csv", columns), settings, axle)
    v_x, v_y = radius * rate * np.cos(beta), radius * rate * np.sin(beta)
    a_y = radius * rate**2 * np.cos(beta)  # to the left, towards the centre
    if axle == "rear":
        alpha, force = np.arctan((v_y - L_R * rate) / v_x), -MASS * L_F * a_y
    else:
        alpha = np.arctan((v_y + L_F * rate) / v_x) - 0.1  # wheels steered to the left
        force = -MASS * L_R * a_y / np.cos(0.1)
    assert alpha > 0
    np.testing.assert_allclose(log.columns["alpha"], alpha, atol=1e-4)
    # 0.2 % of an edge's transient is left after the settling time
    np.testing.assert_allclose(log.columns["fy"], force / WHEELBASE, rtol=2e-3)


def test_yaw_offset_is_added_to_the_logged_yaw_and_stated(tmp_path):
    columns = pose_log()
    columns["psi"] = columns["psi"] - 0.01  # the tracker's zero is left of the heading
    path = write_log(tmp_path / "a.csv", columns)
    raw = derive(path, pose_vehicle(tmp_path))
    settings = pose_vehicle(tmp_path, before="yaw_offset = 0.01\n")
    turned = derive(path, settings)
    assert_true(turned, columns["t"][0], settings)
    shift = turned.columns["alpha"].mean() - raw.columns["alpha"].mean()
    assert shift == pytest.approx(-0.01, rel=0.05)
    assert "0.01 rad were added" in turned.heading
    assert "heading offset: none assumed" in raw.heading


def test_a_heading_offset_is_estimated_and_reported(tmp_path):
    """Case 3 again: 9.6 mrad by a jackknife over its logs (fits/dart_rear_axle)."""
    (path,) = DART.glob("free_driving*/*10_02_28.csv.gz")
    log = derive(path, load_vehicle(DART / "vehicle.toml"))
    estimate = float(log.heading.partition("yaw_offset = ")[2].split()[0])
    assert estimate == pytest.approx(0.0096, abs=0.0008)
    said = " ".join(log.summary().split())
    assert "heading offset: none assumed" in said
    assert f"alpha is +{estimate:.4f} rad where fy = 0" in said
    # Applied, nothing is left and the same offset is advised.
    applied = load_vehicle(DART.parent / "dart_rear_axle" / "vehicle.toml")
    again = derive(path, applied)
    assert f"yaw_offset = {estimate:.4f}" in again.heading
    left = float(again.heading.partition("alpha is ")[2].split()[0])
    assert left == pytest.approx(estimate - applied.yaw_offset, abs=1.01e-4)
    # Circles to one side say nothing of it, and rates have no heading.
    path = next(DART.glob("circles*/*steerneg025*"))
    one_way = derive(path, load_vehicle(DART / "vehicle.toml"))
    assert "none assumed" in one_way.heading and "estimated" not in one_way.heading
    rates = derive(
        write_log(tmp_path / "a.csv", rates_log()), vehicle(tmp_path, CAR + RATES + KEEP)
    )
    assert rates.heading.startswith("sideslip offset: none assumed")


def rates_log():
    """Exact rates at the tracked point, by rigid-body kinematics."""
    time = stamps(np.random.default_rng(3))
    true = truth(time)
    ahead, left = TRACKED[0] - L_R, TRACKED[1]
    return {
        "t": time,
        "vx": true.v_x - left * true.yaw_rate,
        "vy": true.v_y + ahead * true.yaw_rate,
        "r": true.yaw_rate,
        "ay": true.a_y + ahead * true.yaw_acceleration - left * true.yaw_rate**2,
    }


def test_a_log_with_rates_gives_the_true_slip_angle_and_force(tmp_path):
    columns = rates_log()
    settings = vehicle(tmp_path, CAR + RATES + KEEP)
    log = derive(write_log(tmp_path / "a.csv", columns), settings)
    true = truth(log.columns["time"] + columns["t"][0])
    np.testing.assert_allclose(log.columns["alpha"], true.alpha_rear, atol=1e-4)
    np.testing.assert_allclose(log.columns["fy"], true.force_rear, atol=5e-3)
    np.testing.assert_allclose(log.columns["v"], true.v_x, atol=1e-3)


def test_derived_rows_contain_the_motion_for_vehicle_effects(tmp_path):
    columns = pose_log(noise=0.0)
    columns["command"] = steer(columns["t"]) / -0.4
    text = CAR + POSE + 'steering = "command"\n' + KEEP
    text += "[steering]\ncommand = [-1, 1]\nangle = [0.4, -0.4]\n"
    path = write_log(tmp_path / "a.csv", columns)
    log = derive(path, vehicle(tmp_path, text))
    time = log.columns["time"] + columns["t"][0]
    true, late = truth(time), truth(time + 0.005)
    early = truth(time - 0.005)
    right = {
        "alpha_rate": (late.alpha_rear - early.alpha_rear) / 0.01,
        "a_x": true.a_x,
        "a_y": true.a_y,
        "yaw_rate": true.yaw_rate,
        "yaw_acceleration": true.yaw_acceleration,
        "heading": true.yaw,
        "x": true.x,
        "y": true.y,
        "steering": steer(time),
    }
    for name, values in right.items():
        error = np.abs(log.columns[name] - values).max()
        assert error < 0.01 * np.ptp(values), name


def test_rates_are_not_computed_across_a_gap(tmp_path):
    columns = pose_log(noise=0.0)
    columns = {name: np.delete(x, slice(900, 1100)) for name, x in columns.items()}
    path = write_log(tmp_path / "a.csv", columns)
    log = derive(path, pose_vehicle(tmp_path))
    assert log.gaps == 1
    time = log.columns["time"] + columns["t"][0]
    late, early = truth(time + 0.005), truth(time - 0.005)
    right = (late.alpha_rear - early.alpha_rear) / 0.01
    np.testing.assert_allclose(log.columns["alpha_rate"], right, atol=2e-3)


def test_a_steering_map_gives_the_front_slip_angle(tmp_path):
    columns = pose_log()
    columns["command"] = steer(columns["t"]) / -0.4
    path = write_log(tmp_path / "a.csv", columns)
    text = CAR + POSE + 'steering = "command"\n' + KEEP
    text += "[steering]\ncommand = [-1, 0, 1]\nangle = [0.4, 0, -0.4]\n"
    settings = vehicle(tmp_path, text)
    log = derive(path, settings, "front")
    assert_true(log, columns["t"][0], settings, "front")
    for delay in (0.0, 0.15):  # of the wheels behind the logged command
        exact = pose_log(noise=0.0) | {"command": steer(columns["t"] + delay) / -0.4}
        log = derive(write_log(path, exact), vehicle(tmp_path, f"{text}delay = {delay}\n"), "front")
        true = truth(log.columns["time"] + columns["t"][0])
        np.testing.assert_allclose(log.columns["alpha"], true.alpha_front, atol=2e-4)
        np.testing.assert_allclose(log.columns["fy"], true.force_front, atol=6e-3)
    narrow = text.replace("[-1, 0, 1]", "[-0.1, 0, 0.1]")
    log = derive(path, vehicle(tmp_path, narrow), "front")
    assert log.dropped_samples["steering command outside the map"] > 100


def test_load_transfer_needs_the_centre_of_gravity_height(tmp_path):
    columns = rates_log()
    settings = vehicle(tmp_path, f"h_cg = {HEIGHT}\n" + CAR + RATES + KEEP)
    log = derive(write_log(tmp_path / "a.csv", columns), settings)
    true = truth(log.columns["time"] + columns["t"][0])
    static = MASS * 9.80665 * L_F / WHEELBASE
    expected = static + MASS * true.a_x * HEIGHT / WHEELBASE
    np.testing.assert_allclose(log.columns["fz"], expected, atol=0.01)
    assert np.ptp(log.columns["fz"]) > 0.1


def test_inactive_slow_and_faulty_samples_are_counted_separately(tmp_path):
    columns = pose_log()
    columns["on"] = np.where(columns["t"] > 20, 0.0, 1.0)
    columns["x"][500] += 1.0
    columns["y"][500] += 1.0
    text = CAR + POSE + '[keep]\nv_min = 1.6\na_y_max = 12.0\nactive = "on"\n'
    log = derive(write_log(tmp_path / "a.csv", columns), vehicle(tmp_path, text))
    assert log.columns["time"].max() < 20.01 - columns["t"][0]
    assert log.columns["v"].min() > 1.6
    glitch = columns["t"][500] - columns["t"][0]
    assert np.abs(log.columns["time"] - glitch).min() > 0.3
    assert np.abs(log.columns["a_y"]).max() < 8
    for reason in ("not active", "slower than 1.6 m/s", "near |a_y| above 12 m/s2"):
        assert log.dropped_samples[reason] > 0
        assert reason in log.summary()


@pytest.mark.parametrize(("name", "value"), [("x", 3.0), ("y", 0.0)])
def test_a_position_that_never_changes_is_refused(tmp_path, name, value):
    columns = pose_log()
    columns[name] = np.full_like(columns[name], value)
    with pytest.raises(DataError, match=f"{name} is the same in all rows") as caught:
        derive(write_log(tmp_path / "a.csv", columns), pose_vehicle(tmp_path))
    (problem,) = caught.value.problems
    assert problem.column == name and "[columns] of vehicle.toml" in problem.remedy


def test_a_unit_without_a_column_is_reported(tmp_path):
    path = write_log(tmp_path / "a.csv", pose_log())
    settings = vehicle(tmp_path, CAR + POSE + KEEP + '[units]\nx = "m"\na_y = "g"\n')
    (said,) = derive(path, settings).warnings
    assert said.startswith("a_y = 'g' of [units] or --unit is not used: the log has no column of")


def test_a_log_with_few_usable_samples_is_doubted(tmp_path):
    path = write_log(tmp_path / "a.csv", pose_log())
    every = derive(path, vehicle(tmp_path, CAR + POSE))
    assert not any("are kept" in warning for warning in every.warnings)
    least = np.quantile(every.columns["v"], 0.97)
    some = derive(path, vehicle(tmp_path, CAR + POSE + f"[keep]\nv_min = {least}\n"))
    assert len(some) < 0.1 * some.samples
    assert any(
        f"only {len(some)} of {some.samples} samples are kept" in warning
        for warning in some.warnings
    )


def test_front_axle_without_steering_is_refused(tmp_path):
    path = write_log(tmp_path / "a.csv", pose_log())
    with pytest.raises(UsageError, match="road wheel angle"):
        derive(path, pose_vehicle(tmp_path), "front")
    with pytest.raises(UsageError, match="unknown axle"):
        derive(path, pose_vehicle(tmp_path), "middle")


def test_bad_vehicle_reports_every_problem(tmp_path):
    text = (
        "mas = 1.0\nl_f = -1.0\nl_r = 0.09\nyaw_inertia = 'big'\n"
        + POSE
        + "yow = 1\n[keep]\nv_min = 0\n"
    )
    with pytest.raises(UsageError) as caught:
        vehicle(tmp_path, text)
    said = str(caught.value)
    for part in ("'mas'", "l_f", "yaw_inertia", "'columns.yow'", "keep.v_min"):
        assert part in said
    assert "'mass'" in said and "steering" in said
    assert all(problem.file and problem.remedy for problem in caught.value.problems)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("mass = = 1", "not valid TOML"),
        (CAR + POSE.replace('yaw = "psi"\n', "") + KEEP, "named are x, y"),
        (CAR + POSE.replace("yaw", "a_y") + KEEP, "neither a pose log"),
        (CAR + POSE + KEEP + "[steering]\ncommand = [0, 0]\nangle = [0, 1]\n", "does not increase"),
    ],
)
def test_inconsistent_vehicle_is_refused(tmp_path, text, message):
    with pytest.raises(UsageError, match=message):
        vehicle(tmp_path, text)


def test_every_contradiction_in_a_vehicle_file_is_reported_with_its_remedy(tmp_path):
    text = (
        "mass_rear = 9\nwheelbase = 1\nyaw_offset = 0.1\n"
        + CAR
        + RATES
        + KEEP
        + "[units]\nv_x = 'furlong'\nroll = 'rad'\n"
        + "[steering]\ncommand = [0, 1]\nangle = [0, 0.1]\n"
    )
    with pytest.raises(UsageError) as caught:
        vehicle(tmp_path, text)
    problems = caught.value.problems
    said = [problem.reason.split()[0] for problem in problems]
    assert sorted(said) == [
        "[steering]",
        "mass_rear",
        "units.roll",
        "units.v_x",
        "wheelbase",
        "yaw_offset",
    ]
    assert all(problem.file.endswith("vehicle.toml") for problem in problems)
    assert all(problem.remedy for problem in problems)


def test_contradictions_are_reported_together_with_wrong_keys(tmp_path):
    text = CAR + POSE + KEEP + "[filter]\norder = true\ncutoff = 40\nmax_gap = 0.5\n"
    with pytest.raises(UsageError) as caught:
        vehicle(tmp_path, text)
    reasons = [problem.reason for problem in caught.value.problems]
    assert len(reasons) == 3
    assert reasons[0] == "filter.order = true: must be a valid integer"
    assert reasons[1].startswith("filter: sample_rate 100 Hz is below 5 x cutoff")
    assert reasons[2].startswith("filter: max_gap 0.5 s is above 1/cutoff")


@pytest.mark.parametrize("front", ["-1", "true", "'0.9'"])
def test_a_wrong_axle_mass_is_reported_and_not_used(tmp_path, front):
    text = f"mass_front = {front}\nmass_rear = 1\nwheelbase = 0.2\n"
    with pytest.raises(UsageError) as caught:
        vehicle(tmp_path, text + "yaw_inertia = 0.005\n" + POSE + KEEP)
    reasons = {problem.reason for problem in caught.value.problems}
    missing = {f"missing key {key!r}" for key in ("mass", "l_f", "l_r")}
    (wrong,) = reasons - missing
    assert wrong.startswith("mass_front = ") and missing < reasons


def test_axle_masses_replace_the_centre_of_gravity_position(tmp_path):
    car = "mass_front = 0.9\nmass_rear = 0.6\nwheelbase = 0.2\nyaw_inertia = 0.005\n"
    settings = vehicle(tmp_path, car + POSE + KEEP)
    assert settings.mass == pytest.approx(1.5)
    assert (settings.l_f, settings.l_r) == pytest.approx((0.08, 0.12))


def toml_file(tmp_path):
    pose_vehicle(tmp_path)
    return tmp_path / "vehicle.toml"


def test_each_log_is_written_as_a_run_with_a_companion_file(tmp_path):
    pytest.importorskip("tirefit.data.write")
    from tirefit.data.read import read

    logs = [
        write_log(tmp_path / f"{name}.csv", pose_log(seed))
        for seed, name in enumerate(("one", "two"))
    ]
    done = derive_files(logs, toml_file(tmp_path), tmp_path / "axle.csv")
    # Beside a tire of ISO-W the file keeps the signs that it states.
    data = read(done.data, otherwise=("iso-w", ".tir files"))
    assert data.source.convention == "braking"
    assert data.runs == ("one", "two")
    both = np.concatenate([log.columns["alpha"] for log in done.logs])
    np.testing.assert_allclose(data["alpha"], both, rtol=1e-12)
    moved = {"a_x", "a_y", "yaw_rate", "yaw_acceleration", "heading", "x", "y"}
    for name in (*moved, "alpha_rate"):
        both = np.concatenate([log.columns[name] for log in done.logs])
        np.testing.assert_allclose(data[name], both, rtol=1e-12)
    assert "steering" not in data
    rates = toml_file(tmp_path)
    rates.write_text(CAR + RATES + KEEP)
    log = write_log(tmp_path / "rates.csv", rates_log())
    again = read(derive_files([log], rates, tmp_path / "again.csv").data)
    assert moved - set(again.columns) == {"heading", "x", "y"}
    companion = json.loads((tmp_path / "axle.derive.json").read_text())
    assert done.metadata == tmp_path / "axle.derive.json"
    assert [run["run"] for run in companion["runs"]] == ["one", "two"]
    assert companion["vehicle"]["mass"] == MASS
    assert any("bandwidth 4.01 Hz" in said for said in companion["runs"][0]["assumptions"])
    assert companion["runs"][0]["warnings"] == []
    assert "one: " in done.summary() and "axle.csv" in done.summary()


def test_nothing_is_written_when_a_log_fails(tmp_path):
    good = write_log(tmp_path / "good.csv", pose_log())
    out = tmp_path / "axle.csv"
    with pytest.raises(DataError) as caught:
        derive_files([tmp_path / "n1.csv", good, tmp_path / "n2.csv"], toml_file(tmp_path), out)
    assert len(caught.value.problems) == 2
    assert not out.exists() and not (tmp_path / "axle.derive.json").exists()


def test_logs_with_the_same_name_and_wrong_outputs_are_refused(tmp_path):
    log = write_log(tmp_path / "a.csv", pose_log())
    with pytest.raises(UsageError) as caught:
        derive_files([log, log], toml_file(tmp_path), tmp_path / "axle.nc")
    assert len(caught.value.problems) == 2


@pytest.mark.parametrize("replaced", ["log", "vehicle"])
def test_logs_and_vehicle_files_are_not_overwritten(tmp_path, replaced):
    log, vehicle = write_log(tmp_path / "a.csv", pose_log()), toml_file(tmp_path)
    companion = tmp_path / "axle.derive.json"
    (log if replaced == "log" else vehicle).rename(companion)
    log, vehicle = (companion, vehicle) if replaced == "log" else (log, companion)
    before = companion.read_bytes()
    option = "LOG" if replaced == "log" else "--vehicle"
    with pytest.raises(DataError, match=rf"it is an input file \({option}\)") as caught:
        derive_files([log], vehicle, tmp_path / "axle.csv")
    assert caught.value.problems[0].file == str(companion)
    assert companion.read_bytes() == before
    assert not (tmp_path / "axle.csv").exists()


def test_the_dart_log_agrees_with_a_brush_after_its_heading_offset(tmp_path):
    """Case 3: the measured car, whose heading exceeds the logged yaw by 10 mrad."""
    from scipy.optimize import curve_fit

    (path,) = DART.glob("free_driving*/*10_02_28.csv.gz")
    log = derive(path, load_vehicle(DART / "vehicle.toml"))
    assert len(log) > 8000
    load = float(log.columns["fz"][0])
    assert load == pytest.approx(0.733 * 9.80665, rel=1e-3)

    def model(alpha, stiffness, friction, offset):
        part = np.abs(np.tan(alpha - offset)) * 2 * stiffness / (3 * friction * load)
        force = 1 - (1 - np.minimum(part, 1.0)) ** 3
        return np.sign(alpha - offset) * friction * load * force

    alpha, force = log.columns["alpha"], log.columns["fy"]
    found, _ = curve_fit(model, alpha, force, [35.0, 0.8, 0.0])
    left_over = force - model(alpha, *found)
    assert 1 - left_over.var() / force.var() > 0.99
    np.testing.assert_allclose(found, [41.0, 0.68, 0.0102], rtol=0.05)


@pytest.mark.parametrize(
    ("name", "factor", "said"),
    [
        ("mass", 1e3, "mass / wheelbase^3"),
        ("yaw_inertia", 1e3, "yaw_inertia / (m"),
        ("gravity", 0.1, "gravity = 0.981 m/s2"),
    ],
)
def test_an_implausible_vehicle_is_doubted(name, factor, said):
    vehicle = load_vehicle(DART / "vehicle.toml")
    assert vehicle.doubts() == ()
    odd = vehicle.model_copy(update={name: factor * getattr(vehicle, name)})
    assert any(said in text and "check the units" in text for text in odd.doubts())


def test_a_clean_log_raises_no_doubt(tmp_path):
    log = derive(write_log(tmp_path / "a.csv", pose_log()), pose_vehicle(tmp_path))
    assert log.warnings == () and "warning" not in log.summary()


def test_rows_near_an_edge_are_reported(tmp_path):
    path = write_log(tmp_path / "a.csv", pose_log())
    log = derive(path, pose_vehicle(tmp_path, after="margin = 0.05\n"))
    (said,) = log.warnings
    # 0.3 s of settling less the margin, at both ends, at 100 Hz.
    assert said.startswith("50 samples are within 0.3 s of an edge")
    assert "warning: 50 samples" in log.summary()


def test_noise_removed_by_the_filter_is_reported(tmp_path):
    path = write_log(tmp_path / "a.csv", pose_log(noise=30.0))
    said = " ".join(derive(path, pose_vehicle(tmp_path)).warnings)
    assert "of the variance of fy lies above 2.8 Hz" in said


def test_a_matlab_log_gives_the_result_of_its_text_file(tmp_path):
    columns = pose_log()
    settings = pose_vehicle(tmp_path)
    from_text = derive(write_log(tmp_path / "log.csv", columns), settings)
    units = {"t": "s", "x": "m", "y": "m", "psi": "rad"}
    log = {name: np.asarray(values)[:, None] for name, values in columns.items()}
    savemat(tmp_path / "log.mat", {"log": log | {"units": units}})
    from_matlab = derive(tmp_path / "log.mat", settings)
    for name, values in from_text.columns.items():
        np.testing.assert_allclose(from_matlab.columns[name], values, rtol=1e-9)


def test_columns_without_any_value_are_named(tmp_path):
    """Not the time, which has all of its values."""
    columns = pose_log()
    for gone, wrong in ((["x"], ["x"]), (["x", "psi"], ["x", "psi"]), ([], [])):
        log = {k: np.full(len(v), np.nan) if k in gone else v.copy() for k, v in columns.items()}
        if not gone:  # values in turn
            log["x"][::2], log["y"][1::2] = np.nan, np.nan
        path = write_log(tmp_path / "a.csv", log)
        with pytest.raises(DataError) as caught:
            derive(path, pose_vehicle(tmp_path))
        problems = caught.value.problems
        assert [p.column for p in problems] == (wrong or [None])
        reason = "has no value in any row" if gone else "no row has a value in all of"
        assert all(reason in p.reason for p in problems)


def test_two_quantities_in_one_column_are_refused(tmp_path):
    with pytest.raises(UsageError, match="columns.x and columns.y are the same column 'y'"):
        vehicle(tmp_path, CAR + POSE.replace('x = "x"', 'x = "y"') + KEEP)
