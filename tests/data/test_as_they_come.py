"""Imperfect vehicle logs: no a_y, several runs, slow or coarse channels."""

import re
from pathlib import Path

import numpy as np
import pytest
from test_derive import rates_log
from test_motion import CAR, KEEP, RATES, pose_log, pose_vehicle, steer, truth, vehicle
from test_motion import write_log as write

from tirefit.data.read import read
from tirefit.data.vehicle.derive import derive, derive_files
from tirefit.data.vehicle.motion import not_ahead, read_motion
from tirefit.data.vehicle.track import read_track
from tirefit.results import DataError, UsageError
from tirefit.vehicle.replay import replay
from tirefit.vehicle.windows import left_out

NO_A_Y = RATES.replace('a_y = "ay"\n', "")
F1TENTH = Path(__file__).parents[2] / "fits" / "measured_changes" / "f1tenth"

# --- a_y that follows ---------------------------------------------------------------


@pytest.mark.parametrize("reach", [0.0, 0.04])
def test_missing_a_y_is_computed_from_the_speeds(tmp_path, reach):
    """Compared with the true force, and with the same log with a_y."""
    columns = rates_log()
    tilt = np.cos(reach), np.sin(reach)
    v_x, v_y = columns["vx"], columns["vy"]
    columns |= {"vx": tilt[0] * v_x + tilt[1] * v_y, "vy": tilt[0] * v_y - tilt[1] * v_x}
    path = write(tmp_path / "a.csv", columns)
    settings = vehicle(tmp_path, f"sideslip_offset = {reach}\n" + CAR + NO_A_Y + KEEP)
    log = derive(path, settings)
    true = truth(log.columns["time"] + columns["t"][0])
    np.testing.assert_allclose(log.columns["alpha"], true.alpha_rear, atol=1e-4)
    np.testing.assert_allclose(log.columns["a_y"], true.a_y, atol=5e-3)
    np.testing.assert_allclose(log.columns["fy"], true.force_rear, atol=1e-2)
    assert "a_y is computed from the speeds" in " ".join(log.summary().split())
    assert any("not an independent measurement" in said for said in log.assumptions)
    measured = derive(path, vehicle(tmp_path, CAR + RATES + KEEP))
    assert not any("independent measurement" in said for said in measured.assumptions)


def test_without_a_y_a_wrong_sign_of_v_y_is_found_from_the_yaw_rate(tmp_path):
    columns = rates_log()
    columns["vy"] = -columns["vy"]
    del columns["ay"]  # its header says what it is: it would be compared
    path = write(tmp_path / "a.csv", columns)
    log = derive(path, vehicle(tmp_path, CAR + NO_A_Y + KEEP), believe=True)
    assert any("v_y or yaw_rate has the wrong sign" in said for said in log.warnings)


# --- runs ---------------------------------------------------------------------------


def in_three(columns, anew):
    """The log in three runs of the same car, each with time from zero if ``anew``."""
    n = len(columns["t"])
    rows = np.split(np.arange(n), [800, 1600])
    time = [columns["t"][r] - anew * columns["t"][r[0]] for r in rows]
    return columns | {"t": np.concatenate(time)}, rows


@pytest.mark.parametrize(
    ("header", "anew"),
    [
        ("run_id", False),
        ("tire set", True),
        pytest.param("run_id", True, marks=pytest.mark.long),
        pytest.param("tire set", False, marks=pytest.mark.long),
    ],
)
def test_a_column_of_runs_splits_and_names_the_log(tmp_path, anew, header):
    columns, rows = in_three(pose_log(), anew)
    ids = np.concatenate([np.full(len(r), k + 3) for k, r in enumerate(rows)])
    path = write(tmp_path / "log.csv", columns | {header: ids})
    named = "" if header == "run_id" else f'[columns]\nrun = "{header}"\n'
    settings = pose_vehicle(tmp_path)
    text = (tmp_path / "vehicle.toml").read_text().replace("[columns]\n", named, 1)
    settings = vehicle(tmp_path, text) if named else settings
    log = derive(path, settings)
    assert log.gaps == 2 and "runs: 3, gaps: 2" in log.summary()
    assert list(dict.fromkeys(log.run)) == ["log_3.0", "log_4.0", "log_5.0"]
    for k, part in enumerate(rows):
        alone = {name: values[part] for name, values in columns.items()}
        alone[header] = ids[part]
        own = derive(write(tmp_path / f"{k}.csv", alone), settings)
        both = log.run == f"log_{k + 3}.0"
        assert np.count_nonzero(both) == pytest.approx(len(own), abs=2)
        for name in ("alpha", "fy"):
            middle = log.columns[name][both][200], own.columns[name][200]
            assert middle[0] == pytest.approx(middle[1], rel=0.1)
    done = derive_files([path], tmp_path / "vehicle.toml", tmp_path / "out.csv")
    assert read(done.data).runs == ("log_3.0", "log_4.0", "log_5.0")


def test_a_restart_of_time_begins_a_new_run(tmp_path):
    columns, rows = in_three(pose_log(), True)
    path = write(tmp_path / "log.csv", columns)
    log = derive(path, pose_vehicle(tmp_path))
    assert set(log.run) == {"log_1", "log_2", "log_3"} and log.gaps == 2
    assert sum(log.dropped_rows.values()) == 0 and log.rows == sum(map(len, rows))
    assert any("time restarts 2 times" in said for said in log.assumptions)
    track = read_track(path, pose_vehicle(tmp_path))
    assert np.all(np.diff(track.time) > 0)


def test_late_rows_do_not_begin_a_new_run(tmp_path):
    columns = pose_log()
    columns["t"][1200:1220] -= 0.5
    log = derive(write(tmp_path / "log.csv", columns), pose_vehicle(tmp_path))
    assert set(log.run) == {"log"}
    assert log.dropped_rows["repeated or backward time"] == 20


def test_measured_sets_in_one_file_become_runs(tmp_path):
    """One file of a 1:10 car: seven runs, speeds and yaw rate, no a_y."""
    text = (F1TENTH / "vehicle.toml").read_text().replace('a_y = "a_y"\n', "")
    text = "tracked_point = [0.17, 0.0]\n" + text
    log = derive(F1TENTH / "a.csv.gz", vehicle(tmp_path, text))
    assert len(set(log.run)) == 7 and log.gaps == 6 and log.warnings == ()
    at, std = log.point.estimate
    assert at == pytest.approx(0.17, abs=2 * std) and std < 0.01


# --- slow and coarse channels -------------------------------------------------------

STEPS = {"vx": 0.02, "vy": 0.005, "r": 0.01, "ay": 0.05}


def coarse_log(rate, steps=STEPS):
    """The rates at an integer sample rate, rounded to steps."""
    fine = rates_log()
    time = np.arange(fine["t"][0], fine["t"][-1], 1 / rate)
    slow = {name: np.interp(time, fine["t"], values) for name, values in fine.items()}
    return slow | {k: step * np.round(slow[k] / step) for k, step in steps.items()}


def test_quantised_channels_at_20_hz_work_by_default(tmp_path):
    settings = vehicle(tmp_path, CAR + RATES + KEEP)
    log = derive(write(tmp_path / "can.csv", coarse_log(20)), settings)
    true = truth(log.columns["time"] + rates_log()["t"][0])
    # Half a step of v_y and of r at the rear axle, over the speed, is the most; what
    # varies as noise does is filtered to less.
    half = 0.5 * (STEPS["vy"] + 0.115 * STEPS["r"]) / true.v_x
    assert np.all(np.abs(log.columns["alpha"] - true.alpha_rear) < half)
    assert log.warnings == ()


def test_too_slow_a_log_is_refused_with_a_working_cutoff(tmp_path):
    path = write(tmp_path / "slow.csv", coarse_log(10, {}))
    with pytest.raises(DataError, match=r"10 Hz only\n.*cutoff = 2\.5 in \[filter\]"):
        derive(path, vehicle(tmp_path, CAR + RATES + KEEP))
    settings = vehicle(tmp_path, CAR + RATES + KEEP + "[filter]\ncutoff = 2.5\n")
    log = derive(path, settings)
    true = truth(log.columns["time"] + rates_log()["t"][0])
    np.testing.assert_allclose(log.columns["alpha"], true.alpha_rear, atol=1e-3)


# --- outside of what a single track describes ---------------------------------------


def changed(name, rows=slice(None)):
    """The log with rates and a manoeuvre that no single-track model describes."""
    log = rates_log()
    if name == "stands":
        log |= {k: 0 * log[k] for k in ("vx", "vy", "r", "ay")}
    if name == "reverses":
        log["vx"][rows] *= -1
    if name == "spins":
        turned = np.linspace(0, 2 * np.pi, len(log["t"][rows]))
        log["vx"][rows], log["vy"][rows] = 2 * np.cos(turned), -2 * np.sin(turned)
    return log


@pytest.mark.parametrize(
    ("log", "said"),
    [
        (changed("stands"), r"slower than 0.8 m/s 2\d+ \(at most 0 m/s ahead\)"),
        (changed("reverses"), r"drives backwards\n.*set v_x = \"-m/s\""),
        (
            {name: values[:40] for name, values in rates_log().items()},
            r"longest stretch is 0.3\d s\n.*record more than 0.6 s",
        ),
    ],
)
def test_a_log_without_usable_samples_is_refused_with_reason_and_remedy(tmp_path, log, said):
    path = write(tmp_path / "a.csv", log)
    with pytest.raises(DataError, match=said):
        derive(path, vehicle(tmp_path, CAR + RATES + KEEP))


@pytest.mark.parametrize("name", ["spins", "reverses"])
def test_spinning_and_reversing_samples_are_excluded_and_counted(tmp_path, name):
    rows = slice(900, 1100)
    log = changed(name, rows)
    path, settings = write(tmp_path / "a.csv", log), CAR + RATES + KEEP
    result = derive(path, vehicle(tmp_path, settings), believe=True)
    ahead = np.count_nonzero(log["vx"][rows] <= 0.8)
    count = result.dropped_samples["spinning or reversing"]
    assert count == pytest.approx(ahead, abs=40)
    assert np.all(np.abs(result.columns["alpha"]) < np.pi / 2)


@pytest.mark.parametrize("horizon", [60.0])
def test_a_replay_longer_than_its_log_reports_the_log_length(tmp_path, horizon):
    log = rates_log()
    log["wheel"] = steer(log["t"])
    text = CAR + RATES.replace("[columns]\n", '[columns]\nsteering = "wheel"\n') + KEEP
    text += "[steering]\ncommand = [-1, 1]\nangle = [-1, 1]\n"
    path = write(tmp_path / "a.csv", log)
    with pytest.raises(DataError, match="shortest horizon, 60 s: the longest is 2[23] s"):
        replay([path], vehicle(tmp_path, text), "brush", "brush", horizons=[horizon])
    with pytest.raises(UsageError, match="--axle rear gives the rear axle's slip"):
        replay([path], vehicle(tmp_path, CAR + RATES + KEEP), "brush", "brush")


def test_a_large_yaw_inertia_is_doubted_with_its_ratio(tmp_path):
    """The 1:10 car on other tires with four times its yaw inertia."""
    text = (F1TENTH / "vehicle.toml").read_text().replace('a_y = "a_y"\n', "")
    text = text.replace("yaw_inertia = 0.12 ", "yaw_inertia = 0.48 ")
    path = F1TENTH / "a.csv.gz"
    log = derive(path, vehicle(tmp_path, "tracked_point = [0.17, 0.0]\n" + text))
    (said,) = (one for one in log.warnings if "friction" in one)
    arms = 5.1 * 0.165**2
    assert f"yaw_inertia {0.48 / arms:.2g} mass l_f l_r" in said
    turning = 0.48 * log.columns["yaw_acceleration"] / 0.33 / log.columns["fz"]
    reaches = np.percentile(np.abs(turning), 99)
    assert f"dr/dt / wheelbase alone is {reaches:.2g} fz" in said


def test_a_wrong_reference_point_is_not_reported_as_a_wrong_sign(tmp_path):
    """The same car on worn tires, at 0.19 m, with its point declared elsewhere."""
    text = (F1TENTH / "vehicle.toml").read_text().replace('a_y = "a_y"\n', "")
    for at in (0.0, 0.33):
        settings = vehicle(tmp_path, f"tracked_point = [{at}, 0.0]\n" + text)
        (said,) = derive(F1TENTH / "d.csv.gz", settings).warnings
        assert "tracked_point = [0.19" in said and "sign" not in said


@pytest.fixture
def interrupted(tmp_path):
    """A log with a second backwards and a second of standstill, and its vehicle."""
    log = rates_log()
    del log["ay"]
    log["wheel"] = steer(log["t"])
    log["vx"][300:400] = -1.0
    log["vx"][900:1000], log["vy"][900:1000] = 0.0, 0.0
    text = CAR + NO_A_Y.replace("[columns]\n", '[columns]\nsteering = "wheel"\n')
    text += KEEP + "[steering]\ncommand = [-1, 1]\nangle = [-1, 1]\n"
    return write(tmp_path / "a.csv", log), vehicle(tmp_path, text)


def test_the_excluded_time_is_stated_by_reason(interrupted):
    path, settings = interrupted
    motion = read_motion(path, settings)[1]
    notes = "\n".join(left_out(motion, not_ahead(motion, settings), settings))
    for why in ("spinning or reversing", "slower than 0.8 m/s"):
        span = float(re.search(rf"([\d.]+) s are left out as {why}", notes)[1])
        assert span == pytest.approx(1.0, abs=0.3)


@pytest.mark.long
def test_a_replay_reports_the_excluded_time(interrupted):
    path, settings = interrupted
    found = replay([path], settings, "brush", "brush", horizons=[0.5])
    assert any("a_y follows from the speeds" in note for note in found.notes)
    motion = read_motion(path, settings)[1]
    assert {*left_out(motion, not_ahead(motion, settings), settings)} <= {*found.notes}
