"""`derive` against a simulated vehicle whose slip angles and forces are known."""

import gzip
import json
import re
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tirefit.data.derive import derive, derive_files
from tirefit.data.vehicle import load_vehicle
from tirefit.results import DataError, UsageError

DART = Path(__file__).parents[2] / "fits" / "dart_jetracer"

MASS, L_F, L_R, INERTIA, HEIGHT = 1.58, 0.0805, 0.0930, 0.0048, 0.03
WHEELBASE = L_F + L_R
TRACKED = (0.115, -0.01)
STIFFNESS, FRICTION = 70.0, 0.8
POSITION_NOISE, YAW_NOISE = 2e-4, 5e-4

CAR = f"""
mass = {MASS}
l_f = {L_F}
l_r = {L_R}
yaw_inertia = {INERTIA}
tracked_point = [{TRACKED[0]}, {TRACKED[1]}]
"""
POSE = '[columns]\ntime = "t"\nx = "x"\ny = "y"\nyaw = "psi"\n'
RATES = '[columns]\ntime = "t"\nv_x = "vx"\nv_y = "vy"\nyaw_rate = "r"\na_y = "ay"\n'
KEEP = "[keep]\nv_min = 0.8\n"


class Truth(NamedTuple):
    """The simulated motion at given times; (n,) each, left positive."""

    x: np.ndarray
    y: np.ndarray
    yaw: np.ndarray
    v_x: np.ndarray
    v_y: np.ndarray
    yaw_rate: np.ndarray
    a_x: np.ndarray
    a_y: np.ndarray
    yaw_acceleration: np.ndarray
    alpha_rear: np.ndarray
    force_rear: np.ndarray
    alpha_front: np.ndarray
    force_front: np.ndarray


def steer(time):
    return 0.10 * np.sin(2 * np.pi * 0.3 * time) + 0.06 * np.sin(
        2 * np.pi * 0.11 * time
    )


def speed(time):
    return 2.0 + 0.5 * np.sin(0.6 * time)


def speed_rate(time):
    return 0.5 * 0.6 * np.cos(0.6 * time)


def brush(alpha, load):
    """The parabolic brush, full sliding beyond tan(alpha) = 3 mu F_z / C."""
    part = np.minimum(STIFFNESS * np.abs(np.tan(alpha)) / (3 * FRICTION * load), 1.0)
    return np.sign(alpha) * FRICTION * load * (1 - (1 - part) ** 3)


def slip_and_force(time, v_y, yaw_rate):
    load = MASS * 9.80665 / WHEELBASE
    alpha_rear = -np.arctan2(v_y - L_R * yaw_rate, speed(time))
    alpha_front = steer(time) - np.arctan2(v_y + L_F * yaw_rate, speed(time))
    rear, front = brush(alpha_rear, load * L_F), brush(alpha_front, load * L_R)
    return alpha_rear, rear, alpha_front, front


def accelerations(time, v_y, yaw_rate):
    """Lateral and yaw acceleration by the forces' balance, derived apart from ours."""
    _, rear, _, front = slip_and_force(time, v_y, yaw_rate)
    front_lateral = front * np.cos(steer(time))
    return (rear + front_lateral) / MASS, (L_F * front_lateral - L_R * rear) / INERTIA


@cache
def solution():
    def rates(time, state):
        _, _, yaw, v_y, yaw_rate = state
        a_y, yaw_acceleration = accelerations(time, v_y, yaw_rate)
        v_x = speed(time)
        return [
            v_x * np.cos(yaw) - v_y * np.sin(yaw),
            v_x * np.sin(yaw) + v_y * np.cos(yaw),
            yaw_rate,
            a_y - v_x * yaw_rate,
            yaw_acceleration,
        ]

    start = [1.0, -2.0, 3.0, 0.0, 0.0]
    return solve_ivp(
        rates, (0, 30), start, "LSODA", rtol=1e-9, atol=1e-10, dense_output=True
    ).sol


def truth(time) -> Truth:
    x, y, yaw, v_y, yaw_rate = solution()(time)
    a_y, yaw_acceleration = accelerations(time, v_y, yaw_rate)
    a_x = speed_rate(time) - v_y * yaw_rate
    return Truth(
        x, y, yaw, speed(time), v_y, yaw_rate, a_x, a_y, yaw_acceleration,
        *slip_and_force(time, v_y, yaw_rate),
    )  # fmt: skip


def stamps(rng, length=24.0):
    """Jittered 100 Hz stamps that stay in order."""
    return np.arange(0.5, length, 0.01) + rng.uniform(
        -3e-4, 3e-4, int(length * 100) - 50
    )


def pose_log(seed=1, noise=1.0) -> dict[str, np.ndarray]:
    """The pose of the tracked point, wrapped yaw, with measurement noise."""
    rng = np.random.default_rng(seed)
    time = stamps(rng)
    true = truth(time)
    ahead, left = TRACKED[0] - L_R, TRACKED[1]
    cos, sin = np.cos(true.yaw), np.sin(true.yaw)
    x = (
        true.x
        + ahead * cos
        - left * sin
        + rng.normal(0, noise * POSITION_NOISE, len(time))
    )
    y = (
        true.y
        + ahead * sin
        + left * cos
        + rng.normal(0, noise * POSITION_NOISE, len(time))
    )
    yaw = true.yaw + rng.normal(0, noise * YAW_NOISE, len(time))
    return {"t": time, "x": x, "y": y, "psi": (yaw + np.pi) % (2 * np.pi) - np.pi}


def write_log(path, columns):
    rows = np.column_stack(list(columns.values())).tolist()
    cells = [",".join("" if np.isnan(x) else repr(x) for x in row) for row in rows]
    path.write_text("\n".join([",".join(columns), *cells]) + "\n")
    return path


def vehicle(tmp_path, text):
    path = tmp_path / "vehicle.toml"
    path.write_text(text)
    return load_vehicle(path)


def pose_vehicle(tmp_path, before="", after=""):
    return vehicle(tmp_path, before + CAR + POSE + KEEP + after)


def noise_gain(settings, derivatives) -> float:
    """Standard deviation that unit white noise keeps through filter and differences."""
    rate = settings.sample_rate
    frequency = np.linspace(0, rate / 2, 20001)
    low_pass = 1 / (1 + (frequency / settings.cutoff) ** (2 * settings.order))
    difference = np.sin(2 * np.pi * frequency / rate) * rate
    return np.sqrt(np.mean((low_pass * difference**derivatives) ** 2))


def noise_std(settings, axle) -> tuple[float, float]:
    """Standard deviations of alpha [rad] and fy [N] that the pose noise implies."""
    levels = [noise_gain(settings, derivatives) for derivatives in range(3)]
    place, other = (0.0, L_F) if axle == "rear" else (WHEELBASE, L_R)
    sideways = np.hypot(POSITION_NOISE, (TRACKED[0] - place) * YAW_NOISE) * levels[1]
    slowness = np.sqrt(np.mean(speed(np.arange(0.5, 24, 0.01)) ** -2))
    alpha = np.hypot(sideways * slowness, YAW_NOISE * levels[0])
    force = MASS * other / WHEELBASE * POSITION_NOISE * levels[2]
    moment = INERTIA / WHEELBASE * YAW_NOISE * levels[2]
    return alpha, np.hypot(force, moment)


def assert_true(log, start, settings, axle="rear"):
    """The errors of alpha and fy are those that noise and bandwidth explain."""
    true = truth(log.columns["time"] + start)
    alpha = log.columns["alpha"] - getattr(true, f"alpha_{axle}")
    force = log.columns["fy"] - getattr(true, f"force_{axle}")
    expected = noise_std(settings.filter, axle)
    for error, std in zip((alpha, force), expected, strict=True):
        # 2 x 4 Hz x 24 s = 190 independent values: 5 % in the standard deviation
        assert np.sqrt(np.mean(error**2)) == pytest.approx(std, rel=0.2)
        assert np.max(np.abs(error)) < 5 * std
        assert abs(np.mean(error)) < 0.2 * std


def test_pose_log_gives_the_true_slip_angle_and_force(tmp_path):
    columns = pose_log()
    settings = pose_vehicle(tmp_path)
    log = derive(write_log(tmp_path / "a.csv", columns), settings)
    assert_true(log, columns["t"][0], settings)
    assert np.ptp(log.columns["fy"]) > 5
    np.testing.assert_allclose(log.columns["fz"], MASS * 9.80665 * L_F / WHEELBASE)
    time = log.columns["time"] + columns["t"][0]
    np.testing.assert_allclose(log.columns["v"], speed(time), atol=0.01)


def test_left_and_right_turns_have_opposite_signs_and_force_opposes_slip(tmp_path):
    log = derive(write_log(tmp_path / "a.csv", pose_log()), pose_vehicle(tmp_path))
    alpha, force, turn = (log.columns[name] for name in ("alpha", "fy", "yaw_rate"))
    left, right = turn > 1.0, turn < -1.0
    assert left.sum() > 100 and right.sum() > 100
    assert np.all(force[left] > 0) and np.all(alpha[left] > 0)
    assert np.all(force[right] < 0) and np.all(alpha[right] < 0)


def test_gap_repeats_and_missing_cells_are_left_out_not_interpolated(tmp_path):
    columns = pose_log()
    rng = np.random.default_rng(2)
    start = columns["t"][0]
    gap = (columns["t"] > 8.0) & (columns["t"] < 8.6)
    columns = {name: values[~gap] for name, values in columns.items()}
    order = np.sort(np.r_[np.arange(len(columns["t"])), 300, 301, 301, 900])
    columns = {name: values[order] for name, values in columns.items()}
    columns["t"][1200] = columns["t"][1198] - 0.004
    missing = rng.choice(np.arange(1400, 1800, 5), 6, replace=False)
    columns["y"][missing] = np.nan
    settings = pose_vehicle(tmp_path)
    log = derive(write_log(tmp_path / "a.csv", columns), settings)
    assert_true(log, start, settings)
    time = log.columns["time"] + start
    settling = settings.filter.settling
    assert not np.any((time > 8.0 - settling + 0.02) & (time < 8.6 + settling - 0.02))
    assert np.any((time > 7.5) & (time < 8.0)) and np.any((time > 8.9) & (time < 9.2))
    assert log.gaps == 1
    assert log.dropped_rows["a value is missing"] == 6
    assert log.dropped_rows["repeated or backward time"] == 5
    assert sum(log.dropped_samples.values()) + len(log) == log.samples


def test_frozen_pose_is_a_gap(tmp_path):
    columns = pose_log()
    lost = slice(1000, 1040)
    for name in ("x", "y", "psi"):
        columns[name][lost] = columns[name][lost.start - 1]
    settings = pose_vehicle(tmp_path)
    log = derive(write_log(tmp_path / "a.csv", columns), settings)
    assert log.gaps == 1 and log.dropped_rows["repeated pose"] == 40
    assert_true(log, columns["t"][0], settings)


def test_segment_too_short_for_the_filter_is_dropped(tmp_path):
    columns = pose_log()
    time = columns["t"]
    rows = (time < 10) | ((time > 10.5) & (time < 10.8)) | (time > 11.3)
    columns = {name: values[rows] for name, values in columns.items()}
    log = derive(write_log(tmp_path / "a.csv", columns), pose_vehicle(tmp_path))
    kept = log.columns["time"] + columns["t"][0]
    assert log.gaps == 2
    assert not np.any((kept > 9.8) & (kept < 11.5))
    assert all(np.isfinite(values).all() for values in log.columns.values())


def test_units_gzip_and_backward_column_order_change_nothing(tmp_path):
    columns = pose_log()
    plain = derive(write_log(tmp_path / "a.csv", columns), pose_vehicle(tmp_path))
    scaled = {
        "note": np.zeros(len(columns["t"])),
        "psi": np.rad2deg(columns["psi"]),
        "y": columns["y"] * 1e3,
        "x": columns["x"] * 1e3,
        "t": columns["t"] * 1e3,
    }
    packed = tmp_path / "b.csv.gz"
    packed.write_bytes(
        gzip.compress(write_log(tmp_path / "b.csv", scaled).read_bytes())
    )
    units = '[units]\ntime = "ms"\nx = "mm"\ny = "mm"\nyaw = "deg"\n'
    log = derive(packed, pose_vehicle(tmp_path, after=units))
    assert log.name == "b"
    np.testing.assert_allclose(log.columns["alpha"], plain.columns["alpha"], atol=1e-9)
    np.testing.assert_allclose(log.columns["fy"], plain.columns["fy"], atol=1e-6)


def test_yaw_offset_turns_the_heading_and_is_stated(tmp_path):
    columns = pose_log()
    columns["psi"] = columns["psi"] - 0.01
    path = write_log(tmp_path / "a.csv", columns)
    raw = derive(path, pose_vehicle(tmp_path))
    settings = pose_vehicle(tmp_path, before="yaw_offset = 0.01\n")
    turned = derive(path, settings)
    assert_true(turned, columns["t"][0], settings)
    shift = turned.columns["alpha"].mean() - raw.columns["alpha"].mean()
    assert shift == pytest.approx(0.01, rel=0.05)
    assert any("0.01 rad were added" in said for said in turned.assumptions)


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


def test_log_of_rates_gives_the_true_slip_angle_and_force(tmp_path):
    columns = rates_log()
    settings = vehicle(tmp_path, CAR + RATES + KEEP)
    log = derive(write_log(tmp_path / "a.csv", columns), settings)
    true = truth(log.columns["time"] + columns["t"][0])
    np.testing.assert_allclose(log.columns["alpha"], true.alpha_rear, atol=1e-4)
    np.testing.assert_allclose(log.columns["fy"], true.force_rear, atol=5e-3)
    np.testing.assert_allclose(log.columns["v"], true.v_x, atol=1e-3)


def test_front_axle_with_a_steering_map(tmp_path):
    columns = pose_log()
    columns["command"] = steer(columns["t"]) / -0.4
    path = write_log(tmp_path / "a.csv", columns)
    text = CAR + POSE + 'steering = "command"\n' + KEEP
    text += "[steering]\ncommand = [-1, 0, 1]\nangle = [0.4, 0, -0.4]\n"
    settings = vehicle(tmp_path, text)
    log = derive(path, settings, "front")
    assert_true(log, columns["t"][0], settings, "front")
    narrow = text.replace("[-1, 0, 1]", "[-0.1, 0, 0.1]")
    log = derive(path, vehicle(tmp_path, narrow), "front")
    assert log.dropped_samples["steering command outside the map"] > 100


def test_load_transfer_needs_the_height_of_the_centre_of_gravity(tmp_path):
    columns = rates_log()
    settings = vehicle(tmp_path, f"h_cg = {HEIGHT}\n" + CAR + RATES + KEEP)
    log = derive(write_log(tmp_path / "a.csv", columns), settings)
    true = truth(log.columns["time"] + columns["t"][0])
    static = MASS * 9.80665 * L_F / WHEELBASE
    expected = static + MASS * true.a_x * HEIGHT / WHEELBASE
    np.testing.assert_allclose(log.columns["fz"], expected, atol=0.01)
    assert np.ptp(log.columns["fz"]) > 0.1


def test_stated_bandwidth_holds(tmp_path):
    """A yaw oscillation at the bandwidth comes out at -3 dB, less the differences."""
    settings = pose_vehicle(tmp_path, after="a_y_max = 1000.0\n")
    bandwidth = settings.filter.bandwidth
    time = np.arange(0, 12, 0.01)
    yaw = 1e-3 * np.sin(2 * np.pi * bandwidth * time)
    columns = {"t": time, "x": 2 * time, "y": 0 * time, "psi": yaw}
    log = derive(write_log(tmp_path / "a.csv", columns), settings)
    turn = 2 * np.pi * bandwidth
    difference = np.sin(turn / 100) / (turn / 100)
    gain = np.sqrt(2) * log.columns["yaw_rate"].std() / (1e-3 * turn * difference)
    assert gain == pytest.approx(np.sqrt(0.5), rel=0.01)


@pytest.mark.parametrize("order", [1, 2, 4, 8])
def test_transient_has_died_after_the_stated_settling_time(tmp_path, order):
    """The filter's answer to a step of the yaw rate at time 0, away from the edges."""
    settings = pose_vehicle(tmp_path, after=f"[filter]\norder = {order}\n")
    time = np.arange(-10, 10, 0.01)
    columns = {"t": time, "x": 2 * time, "y": 0 * time, "psi": np.maximum(time, 0)}
    log = derive(write_log(tmp_path / "a.csv", columns), settings)
    after = log.columns["time"] - 10
    error = np.abs(log.columns["yaw_rate"] - (after > 0))
    assert np.max(error[np.abs(after) > settings.filter.settling]) < 2e-3
    assert np.max(error[np.abs(after) > settings.filter.settling / 8]) > 2e-2


def test_inactive_slow_and_glitched_samples_are_counted_apart(tmp_path):
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


def test_absent_columns_are_all_named(tmp_path):
    columns = pose_log()
    del columns["y"], columns["psi"]
    with pytest.raises(DataError) as caught:
        derive(write_log(tmp_path / "a.csv", columns), pose_vehicle(tmp_path))
    assert {problem.column for problem in caught.value.problems} == {"y", "psi"}
    assert "t, x" in caught.value.problems[0].remedy


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "missing"),
        ("t,x,y,psi\n", "fewer than two samples"),
        ("t,x,y,psi\n0,0,0,0\n0.01,oops,0,0\n", "'oops' is not a number"),
        ("t,x,y,psi\n0,0,0,0\n1,1,0,0\n2,2,0,0\n", "1 Hz only"),
    ],
)
def test_unusable_log_is_refused(tmp_path, text, message):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(DataError, match=message) as caught:
        derive(path, pose_vehicle(tmp_path))
    assert str(path) in str(caught.value)


def test_text_cell_is_placed_by_row_and_column(tmp_path):
    path = write_log(tmp_path / "a.csv", pose_log())
    lines = path.read_text().splitlines()
    lines[41] = re.sub(r"^([^,]*),[^,]*", r"\1,lost", lines[41])
    path.write_text("\n".join(lines))
    with pytest.raises(DataError) as caught:
        derive(path, pose_vehicle(tmp_path))
    (problem,) = caught.value.problems
    assert (problem.row, problem.column) == (42, "x")


def test_missing_and_damaged_files_are_refused(tmp_path):
    settings = pose_vehicle(tmp_path)
    with pytest.raises(DataError, match="No such file"):
        derive(tmp_path / "none.csv", settings)
    damaged = tmp_path / "a.csv.gz"
    damaged.write_bytes(gzip.compress(b"t,x,y,psi\n" * 50)[:30])
    with pytest.raises(DataError, match="cannot be read"):
        derive(damaged, settings)


def test_no_sample_left_says_why(tmp_path):
    path = write_log(tmp_path / "a.csv", pose_log())
    settings = vehicle(tmp_path, CAR + POSE + "[keep]\nv_min = 50.0\n")
    with pytest.raises(DataError, match="slower than 50 m/s"):
        derive(path, settings)


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
        + "yow = 1\n[keep]\n"
    )
    with pytest.raises(UsageError) as caught:
        vehicle(tmp_path, text)
    said = str(caught.value)
    for part in ("'mas'", "l_f", "yaw_inertia", "'columns.yow'", "'keep.v_min'"):
        assert part in said
    assert "'mass'" in said and "steering" in said
    assert all(problem.file and problem.remedy for problem in caught.value.problems)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("mass = = 1", "is not TOML"),
        ("mass_rear = 0.9\n" + CAR + POSE + KEEP, "mass_rear 0.9 kg contradicts"),
        ("wheelbase = 0.2\n" + CAR + POSE + KEEP, "is not l_f"),
        (CAR + POSE.replace('yaw = "psi"\n', "") + KEEP, "named are x, y"),
        (CAR + POSE + 'a_y = "ay"\n' + KEEP, "a pose log"),
        (CAR + POSE + KEEP + '[units]\nyaw = "grad"\n', "is not one of rad"),
        (CAR + POSE + KEEP + '[units]\nroll = "rad"\n', "roll is not one of"),
        (CAR + POSE + KEEP + "[filter]\ncutoff = 40.0\n", "below 5 x cutoff"),
        (CAR + POSE + KEEP + "[filter]\nmax_gap = 0.5\n", "above 1/cutoff"),
        (CAR + POSE + 'steering = "s"\n' + KEEP, "need each other"),
        ("yaw_offset = 0.1\n" + CAR + RATES + KEEP, "pose log only"),
        (
            CAR + POSE + KEEP + "[steering]\ncommand = [0, 0]\nangle = [0, 1]\n",
            "does not increase",
        ),
    ],
)
def test_inconsistent_vehicle_is_refused(tmp_path, text, message):
    with pytest.raises(UsageError, match=message):
        vehicle(tmp_path, text)


def test_missing_vehicle_file_is_refused(tmp_path):
    with pytest.raises(UsageError, match="No such file"):
        load_vehicle(tmp_path / "vehicle.toml")


def test_axle_masses_replace_the_position_of_the_centre_of_gravity(tmp_path):
    car = "mass_front = 0.9\nmass_rear = 0.6\nwheelbase = 0.2\nyaw_inertia = 0.005\n"
    settings = vehicle(tmp_path, car + POSE + KEEP)
    assert settings.mass == pytest.approx(1.5)
    assert (settings.l_f, settings.l_r) == pytest.approx((0.08, 0.12))


def toml_file(tmp_path):
    pose_vehicle(tmp_path)
    return tmp_path / "vehicle.toml"


def test_files_are_written_with_a_run_each_and_a_companion(tmp_path):
    pytest.importorskip("tirefit.data.write")
    from tirefit.data.read import read

    logs = [write_log(tmp_path / f"{name}.csv", pose_log(seed))
            for seed, name in enumerate(("one", "two"))]  # fmt: skip
    done = derive_files(logs, toml_file(tmp_path), tmp_path / "axle.csv")
    data = read(done.data, convention="braking")
    assert data.runs == ("one", "two")
    both = np.concatenate([log.columns["alpha"] for log in done.logs])
    np.testing.assert_allclose(data["alpha"], both, rtol=1e-12)
    companion = json.loads((tmp_path / "axle.derive.json").read_text())
    assert done.metadata == tmp_path / "axle.derive.json"
    assert [run["run"] for run in companion["runs"]] == ["one", "two"]
    assert companion["vehicle"]["mass"] == MASS
    assert any("bandwidth 4.01 Hz" in said
               for said in companion["runs"][0]["assumptions"])  # fmt: skip
    assert "one: " in done.summary() and "axle.csv" in done.summary()


def test_nothing_is_written_when_a_log_fails(tmp_path):
    good = write_log(tmp_path / "good.csv", pose_log())
    out = tmp_path / "axle.csv"
    with pytest.raises(DataError) as caught:
        derive_files([tmp_path / "n1.csv", good, tmp_path / "n2.csv"],
                     toml_file(tmp_path), out)  # fmt: skip
    assert len(caught.value.problems) == 2
    assert not out.exists() and not (tmp_path / "axle.derive.json").exists()


def test_logs_of_one_name_and_other_outputs_are_refused(tmp_path):
    log = write_log(tmp_path / "a.csv", pose_log())
    with pytest.raises(UsageError) as caught:
        derive_files([log, log], toml_file(tmp_path), tmp_path / "axle.nc")
    assert len(caught.value.problems) == 2


def test_dart_log_bends_like_a_brush_with_a_heading_offset(tmp_path):
    """Case 3: the measured car; its logged yaw is about 10 mrad off its heading."""
    from scipy.optimize import curve_fit

    (path,) = DART.glob("free_driving*/*10_02_28.csv.gz")
    log = derive(path, load_vehicle(DART / "vehicle.toml"))
    assert len(log) > 8000
    load = float(log.columns["fz"][0])
    assert load == pytest.approx(0.733 * 9.80665, rel=1e-3)

    def model(alpha, stiffness, friction, offset):
        part = np.abs(np.tan(alpha + offset)) * 2 * stiffness / (3 * friction * load)
        force = 1 - (1 - np.minimum(part, 1.0)) ** 3
        return np.sign(alpha + offset) * friction * load * force

    alpha, force = log.columns["alpha"], log.columns["fy"]
    found, _ = curve_fit(model, alpha, force, [35.0, 0.8, 0.0])
    left_over = force - model(alpha, *found)
    assert 1 - left_over.var() / force.var() > 0.99
    np.testing.assert_allclose(found, [41.0, 0.68, 0.0102], rtol=0.05)
