"""Exports of MoTeC i2 and .vbo files of Racelogic: read like a CSV with the same numbers."""

import numpy as np
import pytest

from tirefit.data.bulk import LARGE
from tirefit.data.derive import derive
from tirefit.data.kinds import read_table
from tirefit.data.read import read
from tirefit.data.vehicle import load_vehicle
from tirefit.results import DataError

HEAD = """\
"Format","MoTeC CSV File",,,"Workbook","Circuit"
"Venue","Test track",,,"Worksheet","Speed, time"
"Vehicle","Car 1",,,"Vehicle Desc",""
"Driver","",,,"Engine ID",""
"Device","ADL"
"Comment","kappa, fx",,,"Session","2"
"Log Date","05/12/2018",,,"Origin Time","0.000","s"
"Log Time","17:42:00",,,"Start Time","0.000","s"
"Sample Rate","50.000","Hz",,"End Time","8.000","s"
"Duration","8.000","s",,"Start Distance","0","m"
"Range","Lap 1",,,"End Distance","160","m"
"Beacon Markers","1.5 3.5"


"""
VBO = """\
File created on 07/12/2014 at 09:02:23

[header]
satellites
time
latitude
longitude
{velocity}
heading
Lateral_vel
YawRate
SteeringAngle

[channel units]
{units}

[comments]
(c) 2001 2014 Racelogic
Log Rate (Hz) : 50.00

[column names]
sats time lat long velocity heading Lateral_vel YawRate SteeringAngle

[data]
"""
CAR = """\
mass = 1500
l_f = 1.2
l_r = 1.4
yaw_inertia = 2500
[columns]
"""


def motion(n=400):
    """Time, forward and lateral speed, yaw rate and road wheel angle of a slalom, in SI."""
    t = np.arange(n) / 50
    steering = 0.05 * np.sin(1.1 * t)
    v = 20 + np.sin(0.3 * t)
    rate = v * steering / 2.6
    return t, v, 1.4 * rate - 0.1 * rate * v, rate, steering


def motec(columns, units, mark="\r\n"):
    rows = ('"' + '","'.join(f"{x:.9g}" for x in row) + '"' for row in zip(*columns, strict=True))
    names = ('"' + '","'.join(cells) + '"' for cells in (units, units.values()))
    return mark.join([*HEAD.splitlines(), *names, "", "", *rows]) + mark


def clock(seconds):
    hours, rest = divmod(seconds, 3600)
    minutes, rest = divmod(rest, 60)
    return f"{int(hours) % 24:02d}{int(minutes):02d}{rest:05.2f}"


def vbo(velocity="velocity kmh", units="km/h\ndeg/s\ndeg", start=86396.0):
    """The slalom over midnight; speeds are km/h, angles in degrees."""
    t, v, v_y, rate, steering = motion()
    rows = [
        f"012 {clock((start + at) % 86400)} +3119.09973 -00058.49277 {3.6 * a:09.5f} 090.00"
        f" {3.6 * b:+.8E} {np.degrees(c):+.8E} {np.degrees(d):+.8E}"
        for at, a, b, c, d in zip(t, v, v_y, rate, steering, strict=True)
    ]
    text = VBO.format(velocity=velocity, units=units) + "\n".join(rows) + "\n"
    return text.replace("\n", "\r\n")


def test_a_motec_export_is_read(tmp_path):
    slip = np.linspace(-5, 20, 50)
    units = {"Time": "s", "Slip Ratio": "%", "Long Force": "kN", "Load": "N", "Fuel": "l"}
    columns = [np.arange(50) / 20, slip, np.tanh(slip / 8), np.full(50, 4000), np.full(50, 1.5)]
    path = tmp_path / "run.csv"
    path.write_text(motec(columns, units), newline="")
    data = read(path, slip="kappa")
    np.testing.assert_allclose(data["fx"], 1e3 * columns[2], rtol=1e-8)
    np.testing.assert_allclose(data["sigma_x"], slip / (100 - slip), rtol=1e-8)
    assert any("export of MoTeC i2" in note for note in data.source.notes)
    assert data.source.line[0] == len(HEAD.splitlines()) + 5


def test_a_large_motec_export_is_read_exactly(tmp_path):
    rows = np.arange(60_000)
    units = {"Time": "s", "Slip Ratio": "%", "Long Force": "kN", "Load": "N"}
    columns = [rows / 20, 5 * np.sin(rows), np.cos(rows), np.full(len(rows), 4000)]
    path = tmp_path / "run.csv"
    path.write_text(motec(columns, units), newline="")
    assert path.stat().st_size > LARGE
    np.testing.assert_allclose(read(path, slip="kappa")["fx"], 1e3 * columns[2], atol=1e-5)


@pytest.mark.parametrize("kind", ["motec", "vbo"])
def test_logs_of_cars_are_derived_and_name_the_missing_channel(tmp_path, kind):
    t, v, v_y, rate, steering = motion()
    names = ["time", "velocity", "Lateral_vel", "YawRate", "SteeringAngle"]
    if kind == "vbo":
        text = vbo()
    else:
        names = ["Time", "Ground Speed", "Lateral Vel", "Gyro Yaw Velocity", "Steered Angle"]
        columns = [t, 3.6 * v, 3.6 * v_y, np.degrees(rate), np.degrees(steering)]
        text = motec(columns, dict(zip(names, ["s", "km/h", "km/h", "deg/s", "deg"], strict=True)))
    path, plain = tmp_path / f"log.{kind}", tmp_path / "plain.csv"
    path.write_text(text, newline="")
    np.savetxt(plain, np.stack([t, v, v_y, rate, steering], 1), "%.12g", ",", header="t,vx,vy,r,d",
               comments="")  # fmt: skip
    found = []
    for file, headers, degree in ((path, names, 180 / np.pi), (plain, "t vx vy r d".split(), 1)):
        toml = tmp_path / "car.toml"
        keys = zip(("time", "v_x", "v_y", "yaw_rate", "steering"), headers, strict=True)
        lines = [f'{key} = "{header}"' for key, header in keys]
        steer = f"[steering]\ncommand = [{-degree}, {degree}]\nangle = [-1.0, 1.0]\n"
        toml.write_text(CAR + "\n".join(lines) + "\n" + steer)
        found.append(derive(file, load_vehicle(toml)))
    for name, least in (("alpha", 1e-6), ("fy", 1.0), ("fz", 1e-9)):
        one, other = (log.columns[name] for log in found)
        size = len(one)
        assert abs(size - len(other)) <= 1  # the clock of a .vbo has two decimals
        np.testing.assert_allclose(one[: size - 1], other[: size - 1], rtol=1e-4, atol=least)
    with pytest.raises(DataError) as caught:
        read(path)
    (problem,) = caught.value.problems
    assert "log of a vehicle" in problem.reason and "tirefit derive" in problem.remedy
    path.write_text(text.replace(names[2], "Other"), newline="")
    with pytest.raises(DataError) as caught:
        read(path)
    (problem,) = caught.value.problems
    assert "log of a vehicle" in problem.reason and "no v_y" in problem.remedy


def test_the_clock_and_units_of_a_vbo_file(tmp_path):
    path = tmp_path / "run.vbo"
    path.write_text(vbo(), newline="")
    table = read_table(path, ())
    time = np.array(table.cells[table.headers.index("time")], float)
    np.testing.assert_allclose(time - time[0], motion()[0], atol=1e-9)  # over midnight
    assert table.units_row == ["", "s", "", "", "km/h", "deg", "km/h", "deg/s", "deg"]
    path.write_text(vbo("velocity knots", "\ndeg/s\ndeg"), newline="")
    assert read_table(path, ()).units_row[4:7] == ["knot", "deg", ""]
    path.write_text(vbo(units="deg/s"), newline="")
    table = read_table(path, ())
    assert table.units_row[6:] == ["", "", ""]
    assert any("1 lines for 3 columns" in note for note in table.notes)
    path.write_text(vbo().partition("[data]")[0] + "[data]\r\n", newline="")
    with pytest.raises(DataError, match="without columns or data"):
        read_table(path, ())
