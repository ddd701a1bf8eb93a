"""Contradicting channels of a log, with each error inserted by hand."""

import json
import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from test_motion import CAR as MODEL_CAR
from test_motion import KEEP, write_log
from test_motion import RATES as MODEL_RATES

from tirefit.data.units import units_of
from tirefit.data.vehicle.derive import derive, derive_files
from tirefit.data.vehicle.vehicle import load_vehicle
from tirefit.results import DataError
from tirefit.sim.drive import Drive, simulate_drive

DART = Path(__file__).parents[2] / "fits" / "dart_jetracer"
CAR = "mass = 1500\nyaw_inertia = 2500\nl_f = 1.2\nl_r = 1.4\n"
STEER = "[steering]\ncommand = [-1.5, 1.5]\nangle = [-1.5, 1.5]\n"
RATES = {"v_x": "c1", "v_y": "c2", "yaw_rate": "c3", "a_y": "c4"}
POSE = {"x": "c7", "y": "c8", "yaw": "c9"}
BESIDE = {"v_x": "c1", "yaw_rate": "c3", "a_y": "c4", "a_x": "c5"}
NOISE = {
    "c1": 0.03,
    "c2": 0.03,
    "c3": 0.002,
    "c4": 0.05,
    "c5": 0.05,
    "c6": 0.0,
    "c7": 0.02,
    "c8": 0.02,
    "c9": 0.002,
}
"""Column -> noise: v_x, v_y, yaw rate, a_y, a_x, steering, x, y, heading. The headers
say nothing: what is not named is not read."""

DRIVES = {
    "turns and brakes": {"bend": 0.35, "brake": 0.25},
    "turns": {"bend": 0.6},
    "hardly turns": {"bend": 0.05},
    "straight": {"bend": 1e-6},
    "gently": {"bend": 0.15, "bend_period": 8.0},
    "slow": {"bend": 0.5, "speed": 10.0, "bend_period": 8.0},
}


@cache
def driven(name="turns and brakes"):
    """Columns of the car's true motion."""
    truth = simulate_drive(Drive(duration=40.0, **DRIVES[name])).truth
    order = ("v", "v_y", "yaw_rate", "a_y", "a_x", "steering", "x", "y", "heading")
    return {"time": truth["time"]} | {
        f"c{k + 1}": np.array(truth[quantity]) for k, quantity in enumerate(order)
    }


def log_of(seed=0, name="turns and brakes"):
    rng = np.random.default_rng(seed)
    true = driven(name)
    noisy = {c: true[c] + s * rng.standard_normal(len(true[c])) for c, s in NOISE.items()}
    return {"time": true["time"]} | noisy


def vehicle_text(columns, extra=""):
    names = "".join(f'{name} = "{header}"\n' for name, header in columns.items())
    cutoff = "" if "v_y" in columns else "[filter]\ncutoff = 2.0\n"
    return f'{CAR}[columns]\ntime = "time"\n{names}{cutoff}{extra}'


def vehicle(tmp_path, columns, extra=""):
    path = tmp_path / "vehicle.toml"
    path.write_text(vehicle_text(columns, extra))
    return load_vehicle(path)


def derived(tmp_path, log, columns, extra="", **how):
    path = tmp_path / "log.csv"
    rows = np.column_stack(list(log.values()))
    np.savetxt(path, rows, "%.9g", ",", header=",".join(log), comments="")
    return derive(path, vehicle(tmp_path, columns, extra), **how)


def refused(tmp_path, log, columns, extra="") -> str:
    with pytest.raises(DataError) as caught:
        derived(tmp_path, log, columns, extra)
    (problem,) = caught.value.problems
    assert problem.reason.startswith("channels contradict each other: ")
    assert problem.file.endswith("log.csv") and problem.column in log
    return f"{problem.reason} | {problem.remedy}"


def times(**factors):
    return lambda log: {c: log[c] * f for c, f in factors.items()}


def exchange(one, other):
    return lambda log: {one: log[other], other: log[one]}


DEG = 180 / np.pi
IN_RATES = {
    "speeds in km/h": (times(c1=3.6, c2=3.6), "v_x and v_y are in km/h, but read in"),
    "v_x in km/h": (times(c1=3.6), "v_x is in km/h, but read in m/s"),
    "speeds in mph": (times(c1=2.2369, c2=2.2369), "v_x and v_y are in mph"),
    "v_y in mm/s": (times(c2=1e3), "v_y is in mm/s"),
    "v_y to the right": (times(c2=-1), "v_y has the wrong sign"),
    "a_y in g": (times(c4=1 / 9.80665), "a_y is in g, but read in m/s2"),
    "a_y to the right": (times(c4=-1), "a_y has the wrong sign"),
    "yaw rate in deg/s": (times(c3=DEG), "yaw_rate is in deg/s, but read in rad/s"),
    "yaw rate clockwise": (times(c3=-1), "yaw_rate has the wrong sign"),
    "both": (times(c3=-DEG), "read in rad/s and yaw_rate has the wrong"),
    "km/h and g": (
        times(c1=3.6, c2=3.6, c4=1 / 9.80665),
        "a_y is in g, but read in m/s2 and v_x and v_y are in km/h",
    ),
    "speeds exchanged": (exchange("c1", "c2"), "v_x and v_y are exchanged"),
    "a_y for the yaw rate": (exchange("c3", "c4"), "a_y and yaw_rate are exchanged"),
    "dead a_y": (times(c4=0), "a_y does not follow v_x r + dv_y/dt"),
    "odd scale": (times(c4=6), "times v_x r, which no unit explains"),
}
REMEDIES = {
    "speeds in km/h": "--unit v_x=km/h --unit v_y=km/h",
    "a_y in g": 'set a_y = "g" in [units] of vehicle.toml, or --unit a_y=g',
    "both": 'yaw_rate = "-deg/s"',
    "yaw rate clockwise": 'yaw_rate = "-rad/s"',
    "speeds exchanged": 'v_x = "c2", v_y = "c1"',
    "dead a_y": "derive with --believe",
}


IN_POSES = {
    "yaw in deg": (times(c9=DEG), "yaw is in deg, but read in rad"),
    "yaw clockwise": (times(c9=-1), 'yaw has the wrong sign | set yaw = "-rad"'),
    "y to the right": (times(c8=-1), 'y has the wrong sign | set y = "-m"'),
    "x and y exchanged": (exchange("c7", "c8"), "x and y are exchanged | ex"),
    "compass": (
        lambda log: {"c9": np.pi / 2 - log["c9"]},
        'the y axis | set yaw = "-rad" in [units] and yaw_offset = 1.57',
    ),
    "yaw from the y axis": (
        lambda log: {"c9": log["c9"] + np.pi / 2},
        "90 deg sideways: yaw is measured from another axis | set yaw_offset = -1.57",
    ),
    "positions in mm": (times(c7=1e3, c8=1e3), "x and y are in mm, but read in m"),
    "positions in ft": (times(c7=3.28084, c8=3.28084), "x and y are in ft"),
    "speed in km/h": (times(c1=3.6), "v_x is in km/h"),
    "accelerations in g": (times(c4=0.10197, c5=0.10197), "a_x and a_y are in g"),
    "yaw rate clockwise": (times(c3=-1), "yaw_rate has the wrong sign"),
    "accelerations exchanged": (exchange("c4", "c5"), "a_x and a_y are exchanged"),
}


ERRORS = [(fault, RATES) for fault in IN_RATES] + [(fault, POSE | BESIDE) for fault in IN_POSES]


@pytest.mark.parametrize(("fault", "columns"), ERRORS)
def test_an_error_in_a_log_is_reported_with_its_remedy(tmp_path, fault, columns):
    put_in, said = (IN_RATES if columns == RATES else IN_POSES)[fault]
    log = log_of()
    text = refused(tmp_path, log | put_in(log), columns)
    assert said in text
    assert columns != RATES or REMEDIES.get(fault, "") in text


def test_a_pose_alone_does_not_identify_the_mirrored_axis(tmp_path):
    log = log_of()
    log["c9"] = -log["c9"]
    text = refused(tmp_path, log, POSE)
    assert "y has the wrong sign, or yaw has the wrong sign" in text
    log["c9"] = np.pi / 2 + log["c9"]
    text = refused(tmp_path, log, POSE)
    assert "x and y are exchanged, or yaw is measured clockwise" in text


@pytest.mark.parametrize(
    ("factor", "said"),
    [(DEG, "steering is in deg, but read in rad by the map"), (-1, "steering has the wrong sign")],
)
@pytest.mark.parametrize("columns", [RATES, POSE])
def test_steering_against_the_curvature_of_the_path_is_refused(tmp_path, columns, factor, said):
    log = log_of(name="gently")
    right = derived(tmp_path, log, columns | {"steering": "c6"}, STEER)
    assert right.compared.problems == () and right.compared.warnings == ()
    log["c6"] = log["c6"] * factor
    text = refused(tmp_path, log, columns | {"steering": "c6"}, STEER)
    assert said in text and "correct [steering]" in text
    assert ("reverse the signs of angle" in text) == (factor == -1)


def test_the_suggested_remedy_works(tmp_path):
    """Declared as the message suggests, the log gives the result of the correct one."""
    sound = derived(tmp_path, log_of(), RATES)
    log = log_of()
    log |= times(c1=3.6, c2=3.6, c3=-DEG, c4=1 / 9.80665)(log)
    units = '[units]\nv_x = "km/h"\nv_y = "km/h"\nyaw_rate = "-deg/s"\na_y = "g"\n'
    again = derived(tmp_path, log, RATES, units)
    for name in ("alpha", "fy", "v"):
        np.testing.assert_allclose(again.columns[name], sound.columns[name], rtol=1e-5, atol=1e-6)
    compass = log_of()
    compass["c9"] = np.pi / 2 - compass["c9"]
    how = '[units]\nyaw = "-rad"\n'
    path = tmp_path / "log.csv"
    with pytest.raises(DataError, match="yaw_offset = 1.57"):
        derived(tmp_path, compass, POSE | {"a_y": "c4"})
    text = f"yaw_offset = {np.pi / 2}\n" + vehicle_text(POSE, how)
    (tmp_path / "vehicle.toml").write_text(text)
    turned = derive(path, load_vehicle(tmp_path / "vehicle.toml"))
    sound = derived(tmp_path, log_of(), POSE)
    np.testing.assert_allclose(turned.columns["alpha"], sound.columns["alpha"], atol=1e-6)


def test_a_contradiction_is_accepted_on_request(tmp_path):
    log = log_of()
    log["c4"] = log["c4"] / 9.80665
    result = derived(tmp_path, log, RATES, believe=True)
    (said,) = result.warnings
    assert "a_y is in g" in said and '"g"' in said
    assert "warning: channels contradict" in result.summary()


@pytest.mark.parametrize("name", DRIVES)
@pytest.mark.parametrize(
    ("columns", "extra"),
    [
        (RATES, ""),
        (RATES | {"a_x": "c5", "steering": "c6"}, STEER),
        (POSE, ""),
        (POSE | BESIDE, ""),
    ],
    ids=["rates", "all rates", "pose", "pose and rates"],
)
def test_a_consistent_log_gives_only_one_line(tmp_path, name, columns, extra):
    many = name == "turns and brakes" and "a_x" in columns
    for seed in range(6 if many else 1):
        result = derived(tmp_path, log_of(seed, name), columns, extra)
        assert result.compared.problems == () and result.compared.warnings == ()
    lines = [line for line in result.summary().splitlines() if "channels" in line]
    assert len(lines) == 1


def pair(result, channel, against):
    each = [agreement.as_dict() for agreement in result.compared.pairs]
    (found,) = [p for p in each if (p["channel"], p["against"]) == (channel, against)]
    return found


def test_gain_delay_and_offset_are_recovered_within_their_errors(tmp_path):
    """Over 9 logs, in standard errors: unbiased, and with the stated size."""
    off = []
    for seed in range(9):
        log = log_of(seed)
        # A tenth too large, 60 ms (3 rows) late, 0.3 m/s2 too high.
        log["c4"] = 1.1 * np.r_[np.repeat(log["c4"][0], 3), log["c4"][:-3]] + 0.3
        found = pair(derived(tmp_path, log, RATES), "a_y", "v_x r + dv_y/dt")
        (gain, _), delay, offset = found["gains"], found["delay"], found["offset"]
        off.append(
            [
                (gain["value"] - 1.1) / gain["std"],
                (delay - 0.06) / found["delay_std"],
                (offset - 0.3) / found["offset_std"],
            ]
        )
        assert gain["std"] < 0.02 and found["delay_std"] < 0.03
    off = np.array(off)
    # The mean of 9 has a standard deviation of 0.33; what is stated is conservative.
    assert np.all(np.abs(off.mean(axis=0)) < 0.8)
    assert np.all((off.std(axis=0) < 1.5) & (off.std(axis=0) > 0.2))


def test_noise_on_both_sides_does_not_lower_the_gain(tmp_path):
    gains, lowered = [], []
    for seed in range(10):
        log = log_of(seed)
        rng = np.random.default_rng(seed + 100)
        # Of a time constant of 0.1 s, so that the filter leaves much of it.
        white = rng.standard_normal(len(log["c3"]))
        slow = np.convolve(white, np.exp(-np.arange(20) / 5), "same")
        log["c3"] = log["c3"] + 0.5 * np.std(log["c3"]) * slow / np.std(slow)
        result = derived(tmp_path, log, RATES)
        found = pair(result, "a_y", "v_x r + dv_y/dt")
        gains.append(found["gains"][0]["value"])
        turning = result.columns["v"] * result.columns["yaw_rate"]
        lowered.append(np.polyfit(turning, result.columns["a_y"], 1)[0])
    assert np.mean(lowered) < 0.9
    assert np.mean(gains) == pytest.approx(1.0, abs=0.06)


def test_a_delayed_or_tilted_accelerometer_gives_a_warning(tmp_path):
    log = log_of()
    late = log | {"c4": np.r_[np.repeat(log["c4"][0], 10), log["c4"][:-10]]}
    said, _ = derived(tmp_path, late, RATES).warnings
    assert re.match(r"a_y is 0\.(19|2|21) ± 0.0\d+ s late", said)
    assert derived(tmp_path, log | {"c4": log["c4"] + 0.2}, RATES).warnings == ()
    (said,) = derived(tmp_path, log | {"c4": log["c4"] + 0.4}, RATES).warnings
    assert said.startswith("a_y is +0.4 ± 0.00")
    (said,) = derived(tmp_path, log | {"c4": log["c4"] + 0.8}, RATES).warnings
    assert said.startswith("a_y is +0.8 ± 0.00") and "1.2e+03 N" in said


DART_LOGS = [
    pytest.param(path, marks=[] if k < 2 else pytest.mark.long, id=path.name)
    for k, path in enumerate(sorted(DART.glob("*/*.csv.gz")))
]
"""The first two run in ``make test``."""


@pytest.mark.parametrize("path", DART_LOGS)
def test_the_measured_logs_are_consistent(path, tmp_path):
    """Yaw against the path to 1 %; of the car's own sensors, which are not used
    otherwise, the gyro is 2 to 4 % high and 0.1 s late."""
    text = (DART / "vehicle.toml").read_text()
    result = derive(path, load_vehicle(DART / "vehicle.toml"))
    assert result.compared.problems == () and result.compared.warnings == ()
    turning = pair(result, "yaw", "the direction of travel")
    assert turning["judged"]
    assert turning["gains"][0]["value"] == pytest.approx(1, abs=0.01)
    more = tmp_path / "vehicle.toml"
    more.write_text(text.replace("[columns]", '[columns]\nyaw_rate = "W (IMU)"'))
    gyro = pair(derive(path, load_vehicle(more)), "yaw_rate", "the rate of the heading")
    assert 1.01 < gyro["gains"][0]["value"] < 1.05
    assert gyro["delay"] == pytest.approx(0.09, abs=0.01 + 3 * gyro["delay_std"])


def test_units_are_read_from_header_units_row_or_user(tmp_path):
    names = ("time", "v [km/h]", "v_y [km/h]", "r", "lateral [g]")
    log = log_of()
    values = [log["time"], 3.6 * log["c1"], 3.6 * log["c2"], log["c3"], log["c4"]]
    values[4] = values[4] / 9.80665
    columns = dict(zip(RATES, names[1:], strict=True))
    result = derived(tmp_path, dict(zip(names, values, strict=True)), columns)
    sound = derived(tmp_path, log, RATES)
    np.testing.assert_allclose(result.columns["fy"], sound.columns["fy"], atol=0.1)
    assert "column 'v [km/h]' read as v_x in km/h" in result.assumptions
    assert "column 'r' read as yaw_rate in rad/s (no unit stated)" in result.assumptions
    # A row of units, and what the user says over it.
    path = tmp_path / "rows.csv"
    rows = np.column_stack(values)
    head = "time,c1,c2,c3,c4\ns,km/h,km/h,deg/s,g"
    np.savetxt(path, rows, "%.9g", ",", header=head, comments="")
    vehicle(tmp_path, RATES)
    how = load_vehicle(tmp_path / "vehicle.toml", {"yaw_rate": "rad/s"})
    again = derive(path, how)
    np.testing.assert_allclose(again.columns["fy"], sound.columns["fy"], atol=0.1)
    assert "column 'c1' read as v_x in km/h (units row)" in again.assumptions
    wrong = dict(zip(("time", "v [rad/s]", *names[2:]), values, strict=True))
    with pytest.raises(DataError, match="'rad/s' is not a unit of speed"):
        derived(tmp_path, wrong, columns | {"v_x": "v [rad/s]"})


def test_an_unnamed_column_is_compared_but_refuses_nothing(tmp_path):
    log = log_of()
    log["a_x"] = log["c5"] / 9.80665
    result = derived(tmp_path, log, RATES)
    (said,) = result.warnings
    assert "a_x is in g" in said and "[columns] does not name it" in said
    # A column without numbers is not a channel.
    log["a_x"] = np.array(["x"] * len(log["time"]))
    path = tmp_path / "text.csv"
    cells = [",".join(map(str, row)) for row in zip(*log.values(), strict=True)]
    path.write_text("\n".join([",".join(log), *cells]))
    assert derive(path, vehicle(tmp_path, RATES)).warnings == ()


def test_a_steady_circle_with_a_mirrored_v_y_is_refused(tmp_path):
    """v_y is constant there, but no tire pulls in the direction of sliding."""
    time = np.arange(0, 40, 0.02)
    rng = np.random.default_rng(1)
    v, r = 10 + 2 * np.sin(0.1 * time), 0.3 + 0 * time
    columns = {"t": time, "vx": v, "vy": 0.05 * v * r - 0.004 * v**2 * r * 3, "r": r, "ay": v * r}
    columns |= {n: columns[n] + 0.002 * rng.standard_normal(2000) for n in ("vx", "vy")}
    columns["vy"] = columns["vy"] + 0.093 * r
    path = tmp_path / "vehicle.toml"
    path.write_text(MODEL_CAR.replace("tracked", "# tracked") + MODEL_RATES + KEEP)
    log = derive(write_log(tmp_path / "a.csv", columns), load_vehicle(path))
    assert np.corrcoef(log.columns["alpha"], log.columns["fy"])[0, 1] > 0.9
    columns["vy"] = -columns["vy"]
    with pytest.raises(DataError, match="v_y or a_y has the wrong sign"):
        derive(write_log(tmp_path / "a.csv", columns), load_vehicle(path))


def test_the_companion_file_contains_the_estimates(tmp_path):
    log = log_of()
    rows = np.column_stack(list(log.values()))
    path = tmp_path / "log.csv"
    np.savetxt(path, rows, "%.9g", ",", header=",".join(log), comments="")
    vehicle(tmp_path, RATES)
    done = derive_files([path], tmp_path / "vehicle.toml", tmp_path / "out.csv")
    (run,) = json.loads(done.metadata.read_text())["runs"]
    (found,) = run["agreement"]
    assert found["channel"] == "a_y" and found["judged"]
    assert [gain["of"] for gain in found["gains"]] == ["v_x r", "dv_y/dt"]
    assert found["effective_samples"] < found["samples"] / 2


def test_every_wrong_unit_of_a_log_is_found(tmp_path):
    """A unit that is read as SI is distinguished from all other units of its kind."""
    log = log_of()
    for text in ("km/h", "mph", "ft/s", "knot", "cm/s", "mm/s"):
        assert text in units_of("speed")
        from tirefit.data.units import known_unit

        scale = known_unit(text).scale
        wrong = log | {"c1": log["c1"] / scale, "c2": log["c2"] / scale}
        assert f"v_x and v_y are in {text}, " in refused(tmp_path, wrong, RATES)


def test_a_delay_of_parts_of_a_sample_is_recovered(tmp_path):
    """25.4 ms on a grid of 10 ms: the sign of the part beyond whole samples counts."""
    true = driven()
    late = np.interp(true["time"] - 0.0254, true["time"], true["c4"])
    found = pair(derived(tmp_path, true | {"c4": late}, RATES), "a_y", "v_x r + dv_y/dt")
    assert found["delay"] == pytest.approx(0.0254, abs=2e-3)


def test_a_steady_circle_determines_the_gain_by_the_zero_error_of_a_good_sensor(tmp_path):
    """Gain and offset act alike there: 0.5 m/s2 of an accelerometer, over 3 m/s2, which the
    noise of the other term lowers somewhat."""
    time = np.arange(0, 40, 0.02)
    noise = 0.002 * np.random.default_rng(5).standard_normal((4, len(time)))
    log = {"time": time, "c1": 10 + noise[0], "c2": noise[1], "c3": 0.3 + 0.1 * noise[2]}
    log["c4"] = 3.0 + noise[3]
    found = pair(derived(tmp_path, log, RATES, believe=True), "a_y", "v_x r + dv_y/dt")
    assert 0.5 * 0.5 / 3 < found["gains"][0]["std"] < 1.2 * 0.5 / 3
