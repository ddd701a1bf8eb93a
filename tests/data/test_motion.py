"""A simulated vehicle and its logs; gaps, units and noise in `derive`."""

import gzip
import re
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tirefit.data.vehicle.derive import derive
from tirefit.data.vehicle.vehicle import load_vehicle
from tirefit.results import DataError

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
    """The simulated motion at given times; (n,) each, left positive.

    Slip angles and forces as drawn in ``tirefit.slip``: alpha > 0 slides to the left,
    force > 0 acts to the right.
    """

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
    return 0.10 * np.sin(2 * np.pi * 0.3 * time) + 0.06 * np.sin(2 * np.pi * 0.11 * time)


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
    alpha_rear = np.arctan2(v_y - L_R * yaw_rate, speed(time))
    alpha_front = np.arctan2(v_y + L_F * yaw_rate, speed(time)) - steer(time)
    rear, front = brush(alpha_rear, load * L_F), brush(alpha_front, load * L_R)
    return alpha_rear, rear, alpha_front, front


def accelerations(time, v_y, yaw_rate):
    """Lateral and yaw acceleration by the balance of forces, derived separately."""
    _, rear, _, front = slip_and_force(time, v_y, yaw_rate)
    rear_left, front_left = -rear, -front * np.cos(steer(time))
    return (rear_left + front_left) / MASS, (L_F * front_left - L_R * rear_left) / INERTIA


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

    start = [1.0, -2.0, 0.0, 0.0, 0.0]
    return solve_ivp(rates, (0, 30), start, "LSODA", rtol=1e-9, atol=1e-10, dense_output=True).sol


def truth(time) -> Truth:
    x, y, yaw, v_y, yaw_rate = solution()(time)
    a_y, yaw_acceleration = accelerations(time, v_y, yaw_rate)
    a_x = speed_rate(time) - v_y * yaw_rate
    return Truth(
        x, y, yaw, speed(time), v_y, yaw_rate, a_x, a_y, yaw_acceleration,
        *slip_and_force(time, v_y, yaw_rate),
    )  # fmt: skip


def stamps(rng, length=24.0):
    """Jittered 100 Hz time stamps in rising order."""
    return np.arange(0.5, length, 0.01) + rng.uniform(-3e-4, 3e-4, int(length * 100) - 50)


def pose_log(seed=1, noise=1.0) -> dict[str, np.ndarray]:
    """The pose of the tracked point, wrapped yaw, with measurement noise."""
    rng = np.random.default_rng(seed)
    time = stamps(rng)
    true = truth(time)
    ahead, left = TRACKED[0] - L_R, TRACKED[1]
    cos, sin = np.cos(true.yaw), np.sin(true.yaw)
    x = true.x + ahead * cos - left * sin + rng.normal(0, noise * POSITION_NOISE, len(time))
    y = true.y + ahead * sin + left * cos + rng.normal(0, noise * POSITION_NOISE, len(time))
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
    """Standard deviation of unit white noise after filter and differences."""
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
    """The errors of alpha and fy agree with noise and bandwidth."""
    true = truth(log.columns["time"] + start)
    alpha = log.columns["alpha"] - getattr(true, f"alpha_{axle}")
    force = log.columns["fy"] - getattr(true, f"force_{axle}")
    expected = noise_std(settings.filter, axle)
    for error, std in zip((alpha, force), expected, strict=True):
        # 2 x 4 Hz x 24 s = 190 independent values: 5 % in the standard deviation
        assert np.sqrt(np.mean(error**2)) == pytest.approx(std, rel=0.2)
        assert np.max(np.abs(error)) < 5 * std
        assert abs(np.mean(error)) < 0.2 * std


def test_gaps_repeats_and_missing_cells_are_not_interpolated(tmp_path):
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
    packed.write_bytes(gzip.compress(write_log(tmp_path / "b.csv", scaled).read_bytes()))
    units = '[units]\ntime = "ms"\nx = "mm"\ny = "mm"\nyaw = "deg"\n'
    log = derive(packed, pose_vehicle(tmp_path, after=units))
    assert log.name == "b"
    np.testing.assert_allclose(log.columns["alpha"], plain.columns["alpha"], atol=1e-9)
    np.testing.assert_allclose(log.columns["fy"], plain.columns["fy"], atol=1e-6)


def test_stated_bandwidth_holds(tmp_path):
    """A yaw oscillation at the bandwidth is reduced by 3 dB, and by the differences."""
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
def test_the_filter_has_settled_after_the_stated_time(tmp_path, order):
    """The response to a step of the yaw rate at time 0, away from the edges."""
    settings = pose_vehicle(tmp_path, after=f"[filter]\norder = {order}\n")
    time = np.arange(-10, 10, 0.01)
    columns = {"t": time, "x": 2 * time, "y": 1e-9 * time, "psi": np.maximum(time, 0)}
    log = derive(write_log(tmp_path / "a.csv", columns), settings)
    after = log.columns["time"] - 10
    error = np.abs(log.columns["yaw_rate"] - (after > 0))
    assert np.max(error[np.abs(after) > settings.filter.settling]) < 2e-3
    assert np.max(error[np.abs(after) > settings.filter.settling / 8]) > 2e-2


def test_all_missing_columns_are_named(tmp_path):
    columns = pose_log()
    del columns["y"], columns["psi"]
    with pytest.raises(DataError) as caught:
        derive(write_log(tmp_path / "a.csv", columns), pose_vehicle(tmp_path))
    assert {problem.column for problem in caught.value.problems} == {"y", "psi"}
    assert "t, x" in caught.value.problems[0].remedy


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,x,y,psi\n0,0,0,0\n", "fewer than two samples"),
        ("t,x,y,psi\n1,0,0,0\n1,0,0,0\n0,1,0,0\n", "time does not rise"),
        ("t,x,y,psi\ns,mm,mm,kg\n0,0,0,0\n0.01,1,0,0\n", "unit 'kg' is not a unit of angle"),
        ("t,x,y,psi\n0,0,0,0\n0.01,oops,0,0\n", "'oops' is text where a number"),
        ("t,x,y,psi\n0,0,0,0\n1,1,0,0\n2,2,0,0\n", "1 Hz only"),
    ],
)
def test_unusable_log_is_refused(tmp_path, text, message):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(DataError, match=message) as caught:
        derive(path, pose_vehicle(tmp_path))
    assert str(path) in str(caught.value)


def test_a_header_that_says_none_has_no_unit(tmp_path):
    columns = pose_log()
    columns = {"(None) x" if name == "x" else name: values for name, values in columns.items()}
    settings = vehicle(tmp_path, CAR + POSE.replace('x = "x"', 'x = "(None) x"') + KEEP)
    log = derive(write_log(tmp_path / "a.csv", columns), settings)
    assert "column '(None) x' read as x in m (no unit stated)" in log.assumptions


def test_a_text_cell_is_reported_with_row_and_column(tmp_path):
    path = write_log(tmp_path / "a.csv", pose_log())
    lines = path.read_text().splitlines()
    lines[41] = re.sub(r"^([^,]*),[^,]*", r"\1,lost", lines[41])
    path.write_text("\n".join(lines))
    with pytest.raises(DataError) as caught:
        derive(path, pose_vehicle(tmp_path))
    (problem,) = caught.value.problems
    assert (problem.row, problem.column) == (42, "x")


def test_title_semicolons_and_a_torn_last_row_change_nothing_else(tmp_path):
    path = write_log(tmp_path / "a.csv", pose_log())
    plain = derive(path, pose_vehicle(tmp_path))
    text = path.read_text().replace(",", ";")
    path.write_text("lap 3; wet\n" + text + "24.0;1.2")
    log = derive(path, pose_vehicle(tmp_path))
    np.testing.assert_array_equal(log.columns["alpha"], plain.columns["alpha"])
    assert log.rows == plain.rows + 1 and log.dropped_rows["a value is missing"] == 1
    assert any("before the header" in said for said in log.assumptions)
