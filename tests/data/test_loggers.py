"""Exports of MoTeC i2 and .vbo files of Racelogic: read like a CSV with the same numbers."""

import numpy as np
import pytest

from tirefit.data.read import read
from tirefit.data.readers.kinds import read_table
from tirefit.data.vehicle.derive import derive
from tirefit.data.vehicle.vehicle import load_vehicle
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
    assert table.units_row == ["", "s", *["minutes of arc"] * 2, *"km/h deg km/h deg/s deg".split()]
    path.write_text(vbo("velocity knots", "\ndeg/s\ndeg"), newline="")
    assert read_table(path, ()).units_row[4:7] == ["knot", "deg", ""]
    path.write_text(vbo(units="deg/s"), newline="")
    table = read_table(path, ())
    assert table.units_row[6:] == ["not stated"] * 3
    (doubt,) = table.doubts
    assert "1 lines for 3 columns" in doubt and "'Lateral_vel', 'YawRate'" in doubt
    path.write_text(vbo().partition("[data]")[0] + "[data]\r\n", newline="")
    with pytest.raises(DataError, match="without columns or data"):
        read_table(path, ())


def refused(function, *given):
    with pytest.raises(DataError) as caught:
        function(*given)
    return caught.value.problems


def car(tmp_path, **columns):
    """A vehicle.toml for the columns of a .vbo file."""
    named = {"time": "time", "v_x": "velocity", "v_y": "Lateral_vel", "yaw_rate": "YawRate"}
    units = columns.pop("units", "")
    lines = [f'{key} = "{header}"' for key, header in (named | columns).items() if header]
    toml = tmp_path / "car.toml"
    toml.write_text("\n".join([CAR, *lines, units]) + "\n")
    return load_vehicle(toml)


@pytest.mark.parametrize("how", ["CR", "LF", "UTF-16", "UTF-8", "late", "gap"])
def test_a_vbo_file_is_recognised_however_it_is_written(tmp_path, how):
    text = vbo()
    if how in ("CR", "LF"):
        text = text.replace("\r\n", {"CR": "\r", "LF": "\n"}[how])
    if how == "late":
        text = "a line of the program\r\n" * 8000 + text
    if how == "gap":
        text = text.replace("[comments]", "[comments]" + "\r\nremark" * 20_000)
    path, plain = tmp_path / "run.vbo", tmp_path / "plain.vbo"
    path.write_bytes(text.encode({"UTF-16": "utf-16", "UTF-8": "utf-8-sig"}.get(how, "ascii")))
    plain.write_text(vbo(), newline="")
    one, other = read_table(path, ()), read_table(plain, ())
    assert one.headers == other.headers and one.units_row == other.units_row
    assert [*map(list, one.cells)] == [*map(list, other.cells)]


def test_a_vbo_file_without_names_is_refused(tmp_path):
    path = tmp_path / "run.vbo"
    path.write_text(vbo().replace("[column names]", ""), newline="")
    (problem,) = refused(read_table, path, ())
    assert "[column names]" in problem.reason


def with_acceleration(units):
    """The .vbo file with a lateral acceleration and an event beside the other channels."""
    text = vbo(units=units).replace("SteeringAngle\r\n\r\n[data]", "SteeringAngle LatAcc Event-1"
                                    "\r\n\r\n[data]")  # fmt: skip
    head, data = text.split("[data]\r\n")
    rows = (f"{line} 0.01 0" for line in data.splitlines())
    return head + "[data]\r\n" + "\r\n".join(rows) + "\r\n"


@pytest.mark.parametrize(
    ("units", "found"),
    [
        ("km/h\ndeg/s\ndeg", "km/h deg/s deg g -"),
        ("km/h\ndeg/s\ndeg\nm/s2\nx", "km/h deg/s deg m/s2 x"),
        ("km/h\ndeg/s\ndeg\nm/s2\n", "km/h deg/s deg m/s2 -"),
    ],
)
def test_units_are_of_all_channels_or_of_those_beyond_the_standard(tmp_path, units, found):
    path = tmp_path / "run.vbo"
    path.write_text(with_acceleration(units), newline="")
    table = read_table(path, ())
    assert [unit or "-" for unit in table.units_row[6:]] == found.split() and not table.doubts


@pytest.mark.parametrize("units", ["km/h\ndeg/s", "", "a\nb\nc\nd\ne\nf"])
def test_a_column_whose_unit_is_lost_is_not_read_as_si(tmp_path, units):
    path = tmp_path / "run.vbo"
    path.write_text(with_acceleration(units), newline="")
    problems = refused(derive, path, car(tmp_path))
    assert {problem.column for problem in problems} == {"Lateral_vel", "YawRate"}
    assert "not stated" in problems[0].reason and "--unit v_y=..." in problems[0].remedy
    log = derive(path, car(tmp_path, units='[units]\nv_y = "km/h"\nyaw_rate = "deg/s"'))
    assert any("'Lateral_vel', 'YawRate'" in warning for warning in log.warnings)
    assert read_table(path, ()).units_row[-2] == ("not stated" if units else "g")
    path.write_text(with_acceleration("km/h\ndeg/s\ndeg"), newline="")
    np.testing.assert_array_equal(log.columns["fy"], derive(path, car(tmp_path)).columns["fy"])
    path.write_text(with_acceleration(units), newline="")
    problems = refused(read, path)
    assert any(p.column == "YawRate" and "--unit yaw_rate=" in p.remedy for p in problems)


def times(path):
    table = read_table(path, ())
    return np.array(table.cells[table.headers.index("time")], float)


@pytest.mark.parametrize("bad", ["246000.00", "236000.00", "235961.00", "93000.00"])
def test_a_clock_that_is_no_time_of_day_is_a_fault_of_its_row(tmp_path, bad):
    path = tmp_path / "run.vbo"
    text = vbo(start=70_000.0)
    path.write_text(text.replace(clock(70_002.0), bad), newline="")
    (problem,) = refused(derive, path, car(tmp_path))
    assert problem.column == "time" and bad in problem.reason
    line = text[: text.index(clock(70_002.0))].count("\n") + 1
    assert problem.row == line


@pytest.mark.parametrize(
    ("start", "at", "stray"),
    [(70_000.0, 2.0, 0.0), (70_000.0, 2.0, 30_000.0), (86_396.0, 2.0, 100.0),
     (86_396.0, 4.02, 86_399.0), (86_396.0, 6.0, 86_399.0), (70_000.0, 7.98, 0.0)],
)  # fmt: skip
def test_one_wrong_row_does_not_shift_the_day(tmp_path, start, at, stray):
    path = tmp_path / "run.vbo"
    text = vbo(start=start)
    path.write_text(text.replace(clock((start + at) % 86400), clock(stray)), newline="")
    exact = start + motion()[0]
    k = int(np.argmin(abs(exact - start - at)))
    found = times(path)
    np.testing.assert_allclose(np.delete(found, k), np.delete(exact, k), atol=1e-6)
    assert found[k] % 86_400 == stray


def test_the_course_of_a_vbo_file_is_no_yaw_and_minutes_are_no_metres(tmp_path):
    path = tmp_path / "run.vbo"
    path.write_text(vbo(), newline="")
    table = read_table(path, ())
    assert "heading" not in table.headers and "course" in table.headers
    log = derive(path, car(tmp_path))
    assert "course" not in str(log.warnings) and "yaw has" not in str(log.warnings)
    (problem,) = refused(derive, path, car(tmp_path, yaw="heading"))
    assert "'course'" in problem.remedy
    pose = {"x": "long", "y": "lat", "yaw": "YawRate", "v_x": "", "v_y": "", "yaw_rate": ""}
    for units in ("", '[units]\nx = "m"\ny = "m"\nyaw = "deg"'):
        problems = refused(derive, path, car(tmp_path, **pose, units=units))
        arcs = [p for p in problems if p.column in ("lat", "long")]
        assert len(arcs) == 2 and all("minutes of arc" in p.reason for p in arcs)


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("blanks", [(0, 2), (0, 0), (2, 0), (1, 1), "inside"])
def test_a_motec_export_is_read_with_any_blank_lines(tmp_path, blanks, known):
    slip = np.linspace(-5, 20, 50)
    names = ["Time", "Slip Ratio", "Long Force", "Load"]
    if not known:
        names = ["Time", "A", "B", "C", "D", "E", "F"]  # as wide as some lines of keys
    units = dict(zip(names, ["s", "%", "kN", "N", "", "", ""], strict=False))
    columns = [np.arange(50) / 20, slip, np.tanh(slip / 8), np.full(50, 4000), *[slip] * 3]
    above, rest = motec(columns[: len(names)], units).split("\r\n\r\n\r\n", 1)
    below, rows = rest.split("\r\n\r\n\r\n", 1)
    if blanks == "inside":
        above, blanks = above.replace('"Device"', '\r\n"Device"'), (0, 0)
    path = tmp_path / "run.csv"
    ends = ["\r\n" * (1 + count) for count in blanks]
    path.write_text(above + ends[0] + below + ends[1] + rows, newline="")
    declared = {} if known else dict(kappa="A", fx="B", fz="C")
    data = read(path, columns=declared, slip="kappa")
    np.testing.assert_allclose(data["fx"], 1e3 * columns[2], rtol=1e-8)
    np.testing.assert_allclose(data["time"], columns[0], rtol=1e-8)
    assert any("export of MoTeC" in note for note in data.source.notes)


NAMES = ("Time", "Ground Speed", "Lat Vel", "Gyro Yaw Velocity", "Steered Angle")


def motec_log(unit="deg", names=NAMES):
    """The slalom as an export of MoTeC, with a steering column in ``unit``."""
    t, v, v_y, rate, steering = motion()
    steered = np.degrees(steering) if unit == "deg" else steering
    columns = [t, 3.6 * v, 3.6 * v_y, np.degrees(rate), steered]
    return motec(columns, dict(zip(names, ["s", "km/h", "km/h", "deg/s", unit], strict=True)))


@pytest.mark.parametrize(("unit", "lateral"), [("deg", "Lat Vel"), ("rad", "Lateral Speed")])
def test_the_shown_vehicle_file_derives_the_front_axle_of_a_log(tmp_path, unit, lateral):
    path, toml = tmp_path / "log.csv", tmp_path / "car.toml"
    path.write_text(motec_log(unit, (*NAMES[:2], lateral, *NAMES[3:])), newline="")
    (problem,) = refused(read, path)
    toml.write_text(problem.remedy.partition("\n")[2])
    assert "steering ratio" in toml.read_text()
    vehicle = load_vehicle(toml)
    assert vehicle.columns.v_y == lateral
    found = derive(path, vehicle, "front").columns
    steering = np.interp(found["time"], motion()[0], motion()[-1])
    np.testing.assert_allclose(found["steering"], steering, atol=5e-4)  # 5 Hz low-pass


def test_the_vehicle_file_of_a_log_without_a_lateral_speed_shows_what_it_lacks(tmp_path):
    path, toml = tmp_path / "log.csv", tmp_path / "car.toml"
    path.write_text(motec_log(names=[*NAMES[:2], "Other", *NAMES[3:]]), newline="")
    (problem,) = refused(read, path)
    text, _, listed = problem.remedy.partition("\n")[2].partition("The columns of this log: ")
    assert listed == ", ".join(map(repr, [*NAMES[:2], "Other", *NAMES[3:]]))
    assert '# v_y = "..."  # not in this log' in text
    toml.write_text(text.replace('# v_y = "..."', 'v_y = "Other"'))
    assert len(derive(path, load_vehicle(toml), "front")) > 100
