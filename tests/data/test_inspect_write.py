"""The report of inspect, and files that are read back as they were written."""

import json
import os

import numpy as np
import pytest

from tirefit import slip
from tirefit.data.inspect import inspect
from tirefit.data.read import read, read_frame
from tirefit.data.vehicle.derive import derive
from tirefit.data.vehicle.vehicle import load_vehicle
from tirefit.data.vehicle.vehicle_log import vehicle_log
from tirefit.data.write import (
    csv_text,
    output_problems,
    prediction_table,
    simulated_table,
    to_convention,
)
from tirefit.results import DataError

RNG = np.random.default_rng(11)


def write_csv(path, columns):
    path.write_bytes(csv_text(columns).encode())


def sweep(repeats=1, loads=(2000.0, 4000.0), **others):
    kappa = np.tile(np.linspace(-0.1, 0.1, 11), repeats * len(loads))
    fz = np.repeat(loads, 11 * repeats)
    columns = {"kappa": kappa, "fx": 10 * fz * kappa, "fz": fz}
    return columns | {name: np.full(len(fz), value) for name, value in others.items()}


def test_inspect_counts_loads_runs_and_slips():
    frame = sweep(repeats=2, v=20.0) | {"run": ["a"] * 22 + ["b"] * 22}
    report = inspect(read_frame(frame))
    assert [run.n for run in report.runs] == [22, 22]
    assert [level.median for run in report.runs for level in run.loads] == [2e3, 4e3]
    low, high = report.runs[0].slip["sigma_x"]
    assert (low, high) == pytest.approx((-0.1 / 1.1, 0.1 / 0.9))
    text = report.summary()
    assert "loads: 2000 N (n=22)" in text and "sigma_x -0.0909 to 0.111" in text


def test_a_continuous_sweep_has_a_rate_and_a_range():
    kappa = np.sort(RNG.uniform(0, 0.2, 2000))
    frame = {"kappa": kappa, "fx": kappa, "fz": np.full(2000, 4e3), "time": np.arange(2000) / 50}
    run = inspect(read_frame(frame)).runs[0]
    assert run.sampling_rate == pytest.approx(50)


def test_the_report_fits_the_page_and_json(tmp_path):
    path = tmp_path / ("a long name " * 8 + ".csv")
    write_csv(path, sweep(fx_std=10.0) | {"a very long header " * 6: np.ones(22)})
    with path.open("a") as file:
        file.write("0.1,x,4000,1,1\n")
    report = inspect(read(path, mask_bad_rows=True))
    assert max(map(len, report.summary().splitlines())) <= 80
    assert "row 24, column 'fx': 'x' is text" in report.summary()
    assert "22 used, 1 masked" in report.summary()
    loaded = json.loads(json.dumps(report.to_dict(), allow_nan=False))
    assert loaded["rows"] == 23 and loaded["columns"][0]["name"] == "sigma_x"


@pytest.mark.parametrize("convention", list(slip.CONVENTIONS))
@pytest.mark.parametrize("definition", list(slip.SLIP_DEFINITIONS))
def test_to_convention_restores_the_file(tmp_path, convention, definition):
    signs = slip.CONVENTIONS[convention]
    kappa = RNG.uniform(-0.3, 0.5, 50)
    own = slip.SLIP_DEFINITIONS[definition][1](slip.sigma_from_kappa(kappa))
    alpha = RNG.uniform(-0.2, 0.2, 50)
    own = own * np.cos(alpha) if definition == "s" else own
    file = {
        "Schlupf [%]": signs.slip * 100 * own,
        "SA [deg]": signs.alpha * np.degrees(alpha),
        "Fx [kN]": signs.fx * 20 * kappa,
        "Fy [kN]": signs.fy * 15 * alpha,
        "Mz [Nm]": -signs.mz * 200 * alpha,
        "Fz [kN]": signs.fz * np.full(50, 4.0),
        "Fx_std [N]": RNG.uniform(1, 2, 50),
        "slip_std [%]": RNG.uniform(1, 2, 50),
    }
    options = {
        "columns": {definition: "Schlupf [%]", f"{definition}_std": "slip_std [%]"},
        "convention": convention,
    }
    data = read_frame(file, **options)
    back = to_convention(data, dict(data.columns))
    assert set(back) == set(file)
    for header, values in file.items():
        np.testing.assert_allclose(back[header], values, rtol=1e-10, err_msg=header)
    write_csv(tmp_path / "back.csv", back)
    again = read(tmp_path / "back.csv", **options)
    for name in data.columns:
        np.testing.assert_allclose(again[name], data[name], rtol=1e-10, err_msg=name)


def test_columns_that_are_not_equally_long_are_refused():
    with pytest.raises(ValueError, match="shorter"):
        csv_text({"a": [1.0, 2.0], "b": [1.0]})


def test_predicted_std_has_the_unit_of_its_force():
    data = read_frame({**sweep(), "fx": sweep()["fx"] / 1000}, units={"fx": "kN"})
    out = to_convention(data, {"fx": np.array([2000.0]), "fx_std": np.array([500.0])})
    assert {name: values.tolist() for name, values in out.items()} == {"fx": [2.0], "fx_std": [0.5]}


def test_csv_has_all_digits_and_empty_cells_for_nan(tmp_path):
    path = tmp_path / "a.csv"
    values = np.array([0.1 + 0.2, np.nan, 1e-300])
    write_csv(path, {"x, [N]": values, "run": ["a", 'b "c"', "d"], "n": [1, 2, 3]})
    expected = '"x, [N]",run,n\n0.30000000000000004,a,1\n,"b ""c""",2\n1e-300,d,3\n'
    assert path.read_bytes().decode() == expected


def test_unwritable_outputs_are_refused_before_the_work(tmp_path, monkeypatch):
    path = tmp_path / "a.csv"
    assert output_problems(path) == []
    assert output_problems(tmp_path / "a.CSV", ".csv") == []
    (problem,) = output_problems(tmp_path / "a.parquet", ".csv")
    assert (problem.reason, problem.remedy) == ("the output is a CSV", "end it in .csv")
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may write everywhere
    (problem,) = output_problems(path)
    assert f"no permission to write into the folder {tmp_path}" in problem.reason


def test_a_unit_from_a_units_row_is_written_into_the_header(tmp_path):
    """Without it kilonewtons would be read back as newtons."""
    path = tmp_path / "rig.csv"
    rows = "".join(f"{t},{0.01 * t},{0.5 * t},4000\n" for t in range(1, 9))
    path.write_text("time,sigma_x,fx,fz\ns,-,kN,N\n" + rows)
    data = read(path, convention="braking")
    table = simulated_table(data, {"fx": 1.1 * data["fx"]})
    assert list(table) == ["time", "sigma_x", "fx [kN]", "fz", "fx_sim"]
    write_csv(tmp_path / "beside.csv", table)
    again = read(tmp_path / "beside.csv", convention="braking")
    np.testing.assert_allclose(again["fx"], data["fx"])
    np.testing.assert_allclose(again["fx_sim"], 1.1 * data["fx"])


def test_a_prediction_table_keeps_a_locked_wheel_and_all_digits():
    kappa = np.array([0.1, 0.3, 1.0, -0.7])
    frame = {"kappa": kappa, "fz": np.full(4, 4.1), "alpha": kappa / 7}
    data = read_frame(frame, units={"fz": "kN", "alpha": "deg"}, forces=False)
    assert data["sigma_x"][2] == slip.LOCKED
    table = prediction_table(data, {"fx": np.full(4, 1e3)})
    assert list(table) == ["kappa", "alpha", "fz", "fx"]
    assert table["kappa"] == kappa.tolist() and table["fz"] == [4.1] * 4
    np.testing.assert_allclose(table["alpha"], kappa / 7, rtol=1e-11)


@pytest.mark.parametrize(
    "columns",
    [
        {"t": "time", "vx [km/h]": "v_x", "vy": "v_y", "gyro_z": "yaw_rate"},
        {"car time": "time", "car x": "x", "car y": "y", "car yaw": "yaw"},
        {"time": "time", "v_x": "v_x", "v_y": "v_y", "r": "yaw_rate", "ay": "a_y"},
    ],
)
def test_inspect_of_a_vehicle_log_suggests_derive(tmp_path, columns):
    """The vehicle file shown in the message derives the log without changes."""
    time = np.arange(0, 20, 0.01)
    turn = 0.3 * np.sin(0.7 * time)
    of = {
        "time": time,
        "v_x": 10 + 0 * time,
        "v_y": 0.1 * turn,
        "yaw_rate": turn,
        "a_y": 10 * turn + np.gradient(0.1 * turn, time),
        "yaw": 0 * time,
        "x": 10 * time,
        "y": 0.01 * np.sin(time),
    }
    path = tmp_path / "log.csv"
    of["v_x"] = of["v_x"] * (3.6 if "vx [km/h]" in columns else 1)
    rows = np.column_stack([of[name] for name in columns.values()])
    np.savetxt(path, rows, "%.6f", ",", header=",".join(columns), comments="")
    with pytest.raises(DataError) as caught:
        read(path)
    (problem,) = caught.value.problems
    assert "this is the log of a vehicle" in problem.reason
    assert problem.remedy.startswith(f"tirefit derive {path} --vehicle vehicle.toml")
    toml = tmp_path / "vehicle.toml"
    toml.write_text(problem.remedy.partition("\n")[2])
    vehicle = load_vehicle(toml)
    given = vehicle.columns.model_dump(exclude_none=True)
    assert given == {name: header for header, name in columns.items()}
    assert len(derive(path, vehicle)) > 1000


def test_the_heading_of_a_bag_is_of_the_message_that_has_the_place():
    place, imu = "/odom.pose.pose", "/imu.orientation.yaw"
    headers = [imu, f"{place}.position.x", f"{place}.position.y", f"{place}.orientation.yaw"]
    remedy = vehicle_log([*headers, "/steering_wheel.data"], "bag").remedy
    assert f'yaw = "{place}.orientation.yaw"' in remedy and imu not in remedy
    assert 'steering = "/steering_wheel.data"' in remedy
    assert f'yaw = "{imu}"' in vehicle_log(headers[:-1], "bag").remedy
    # Speeds in the same message: differentiated once, not twice.
    turning = [f"/imu.angular_velocity.{axis}" for axis in "xyz"]
    twist = [f"/odom.twist.twist.{name}" for name in ("linear.x", "linear.y", "angular.z")]
    remedy = vehicle_log([*turning, *headers, *twist], "bag").remedy
    names = ("v_x", "v_y", "yaw_rate")
    assert all(f'{n} = "{t}"' in remedy for n, t in zip(names, twist, strict=True))
    assert place not in remedy
    # Those of another sensor do not replace the pose.
    other = [name.replace("/odom", "/gps") for name in twist]
    assert f'x = "{place}.position.x"' in vehicle_log([*headers, *other], "bag").remedy


@pytest.mark.parametrize("header", ["LateralAcc", "GPS LatAcc", "G Force Lat", "Lat_Acc [g]"])
def test_the_lateral_acceleration_of_data_loggers_is_recognised(header):
    """Of AiM, its GPS, MoTeC and Racelogic."""
    remedy = vehicle_log(["Time", "GPS Speed", "YawRate", header], "log.csv").remedy
    assert f'a_y = "{header}"' in remedy


def test_rig_data_without_a_force_are_no_vehicle_log(tmp_path):
    path = tmp_path / "rig.csv"
    path.write_text("t,alpha,x,y,yaw\n0,1,2,3,4\n1,1,2,3,4\n")
    with pytest.raises(DataError, match="no force: one of fx, fy, mz is needed"):
        read(path)


def test_a_log_with_rates_and_a_slip_angle_is_a_vehicle_log(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(",v_x,v_y,r,slip_angle\n0,9,0.1,0.2,1.7\n0.01,9,0.2,0.2,0.1\n")
    with pytest.raises(DataError) as caught:
        read(path)
    (problem,) = caught.value.problems
    assert "tirefit derive" in problem.remedy and 'time = ""' in problem.remedy
