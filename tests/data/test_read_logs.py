"""MDF, MCAP and ROS logs: channels with several clocks become one table."""

import gc
import sqlite3

import numpy as np
import pytest
from test_motion import CAR, KEEP, POSE, pose_log, pose_vehicle, vehicle, write_log

from tirefit.data.read import read, read_table
from tirefit.data.readers.logs import Signal, on_one_clock
from tirefit.data.vehicle.derive import derive
from tirefit.results import DataError

KAPPA = np.array([-0.08, -0.04, -0.01, 0.01, 0.03, 0.06, 0.1])


def said(notes, fragment):
    return any(fragment in note for note in notes)


# --- one clock ----------------------------------------------------------------------


def test_signals_are_resampled_to_the_time_of_the_known_ones():
    clock = np.linspace(10, 12, 21)
    fine = np.linspace(9, 13, 401)
    early = fine[fine < 11.005]
    signals = {
        "noise": Signal(fine, np.zeros(401), "V"),
        "other": Signal(fine, 3 * fine),
        "fx": Signal(clock, np.arange(21.0), "kN"),
        "early": Signal(early, 2 * early),
    }
    columns, units, notes, epoch = on_one_clock(signals, lambda name: name == "fx", "log")
    np.testing.assert_allclose(columns["time"], clock - 10)
    assert epoch == 10.0
    np.testing.assert_array_equal(columns["fx"], np.arange(21.0))
    np.testing.assert_allclose(columns["other"], 3 * clock)
    np.testing.assert_allclose(columns["early"][:11], 2 * clock[:11])
    assert np.isnan(columns["early"][11:]).all()
    assert units == {"time": "s", "noise": "V", "fx": "kN"}
    assert said(notes, "apart: 'noise', 'other', 'early'")


@pytest.mark.parametrize(("missing", "bridged"), [(4, True), (5, False), (30, False)])
def test_a_gap_of_more_than_five_periods_is_not_interpolated(missing, bridged):
    """``missing`` samples between 2 and 2 + missing + 1 periods of a channel at 10 Hz."""
    own = np.delete(np.arange(60), 21 + np.arange(missing)) / 10
    clock = np.arange(0.0, 7.0, 0.04)
    signals = {"fx": Signal(clock, np.sin(clock)), "fz": Signal(own, own**2)}
    moved = on_one_clock(signals, lambda name: name == "fx", "log").columns["fz"]
    gap = (clock > 2.01) & (clock < 2.09 + missing / 10)
    assert np.isfinite(moved[gap]).all() == bridged
    there = ~gap & (clock <= own[-1])
    np.testing.assert_allclose(moved[there], np.interp(clock[there], own, own**2))
    assert np.isnan(moved[clock > own[-1] + 1e-9]).all()


def test_a_log_without_numbers_is_refused():
    with pytest.raises(DataError, match="no channels of numbers"):
        on_one_clock({}, bool, "log")


# --- MDF ----------------------------------------------------------------------------


def save_mdf(path, groups):
    """Groups of name -> (values, unit), each with its clock."""
    asammdf = pytest.importorskip("asammdf")
    with asammdf.MDF(version="4.10") as mdf:
        for time, channels in groups:
            mdf.append(
                [
                    asammdf.Signal(np.asarray(values), time, name=name, unit=unit, encoding="utf-8")
                    for name, (values, unit) in channels.items()
                ]
            )
        mdf.save(path, overwrite=True)


@pytest.mark.parametrize("name", ["log.mf4", "log.csv"])
def test_mdf_channels_keep_their_units(tmp_path, name):
    time = np.arange(7) / 100
    save_mdf(
        tmp_path / "made.mf4",
        [
            (np.arange(9) / 10, {"gps": (np.arange(9.0), "m/s")}),
            (
                time + 5,
                {
                    "kappa": (100 * KAPPA, "%"),
                    "fx": (40 * KAPPA, "kN"),
                    "fz": (np.full(7, 4000, np.int16), "N"),
                    "mode": (np.array([b"a"] * 7), ""),
                },
            ),
        ],
    )
    (tmp_path / "made.mf4").rename(tmp_path / name)
    data = read(tmp_path / name)
    np.testing.assert_allclose(data["sigma_x"], KAPPA / (1 - KAPPA))
    np.testing.assert_allclose(data["fx"], 40000 * KAPPA)
    np.testing.assert_allclose(data["time"], time, atol=1e-12)
    notes = data.source.notes
    assert said(notes, "read as a log of MDF")
    assert said(notes, "apart: 'gps'")
    assert said(notes, "channels not read: 'mode' (no numbers)")
    assert data.runs == ("log",)


# asammdf's destructor fails on a file that it could not open.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_damaged_mdf_file_is_reported_once(tmp_path, capfd):
    path = tmp_path / "log.mf4"
    save_mdf(path, [(np.arange(9.0), {"fx": (np.arange(9.0), "N")})])
    content = path.read_bytes()
    for damaged in (content[:80], content.replace(b"##FH", b"##XX")):
        path.write_bytes(damaged)
        with pytest.raises(DataError, match="the MDF file cannot be read"):
            read(path)
    gc.collect()
    assert capfd.readouterr() == ("", "")


def test_an_mdf_log_gives_the_result_of_its_text_file(tmp_path):
    columns = pose_log()
    settings = pose_vehicle(tmp_path)
    from_text = derive(write_log(tmp_path / "log.csv", columns), settings)
    time = columns.pop("t")
    pose = {name: (values, "m") for name, values in columns.items()}
    pose["psi"] = (columns["psi"], "rad")
    save_mdf(tmp_path / "log.mf4", [(time, {"t": (time, "s")} | pose)])
    from_mdf = derive(tmp_path / "log.mf4", settings)
    for name, values in from_text.columns.items():
        np.testing.assert_allclose(from_mdf.columns[name], values, rtol=1e-7, atol=1e-9)


# --- ROS ----------------------------------------------------------------------------


def save_bag(path, storage, columns, stamped=True):
    """A ROS 2 bag of poses at 100 Hz, and of speeds at 50 Hz."""
    pytest.importorskip("rosbags")
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    stamp = types["builtin_interfaces/msg/Time"]
    header = types["std_msgs/msg/Header"]
    point = types["geometry_msgs/msg/Point"]
    quaternion = types["geometry_msgs/msg/Quaternion"]
    pose = types["geometry_msgs/msg/Pose"]
    posed = types["geometry_msgs/msg/PoseStamped"]
    number = types["std_msgs/msg/Float64"]
    text = types["std_msgs/msg/String"]
    with Writer(path, version=9, storage_plugin=StoragePlugin[storage]) as writer:
        tracked = writer.add_connection("/car", posed.__msgtype__, typestore=store)
        speed = writer.add_connection("/speed", number.__msgtype__, typestore=store)
        said = writer.add_connection("/said", text.__msgtype__, typestore=store)
        rows = zip(*columns.values(), strict=True)
        for at, (t, x, y, psi) in enumerate(rows):
            nanoseconds = round(1e9 * (1000 + t)) if stamped else 0
            seconds, rest = divmod(nanoseconds, 10**9)
            turned = quaternion(x=0.0, y=0.0, z=np.sin(psi / 2), w=np.cos(psi / 2))
            message = posed(header(stamp(seconds, rest), "world"), pose(point(x, y, 0.0), turned))
            recorded = round(1e9 * (1000 + t + (0.02 if stamped else 0)))
            raw = store.serialize_cdr(message, posed.__msgtype__)
            writer.write(tracked, recorded, raw)
            if at % 2 == 0:
                raw = store.serialize_cdr(number(float(at)), number.__msgtype__)
                writer.write(speed, recorded, raw)
        raw = store.serialize_cdr(text("started"), text.__msgtype__)
        writer.write(said, round(1e12), raw)


POSE_OF_ROS = """
[columns]
time = "time"
x = "/car.pose.position.x"
y = "/car.pose.position.y"
yaw = "/car.pose.orientation.yaw"
"""


@pytest.mark.parametrize("stamped", [True, False])
@pytest.mark.parametrize("storage", ["MCAP", "SQLITE3"])
def test_a_ros_bag_gives_the_result_of_its_text_file(tmp_path, storage, stamped):
    columns = pose_log()
    first = columns["t"][0]
    columns["t"] = columns["t"] - first
    save_bag(tmp_path / "bag", storage, columns, stamped)
    settings = vehicle(tmp_path, CAR + POSE + KEEP)
    from_text = derive(write_log(tmp_path / "log.csv", columns), settings)
    settings = vehicle(tmp_path, CAR + POSE_OF_ROS + KEEP)
    inside = next((tmp_path / "bag").glob("*.[md]*[pb3]"))
    renamed = tmp_path / "log.txt"
    renamed.write_bytes(inside.read_bytes())
    for place in (tmp_path / "bag", renamed):
        log = derive(place, settings)
        assert said(log.assumptions, "topics not read: '/said' (no numbers)")
        assert said(log.assumptions, "apart: '/speed.data'")
        for name in ("alpha", "fy", "v"):
            np.testing.assert_allclose(
                log.columns[name], from_text.columns[name], rtol=1e-4, atol=1e-4
            )


OWN = """std_msgs/Header header
float64 x
float64 y
team_msgs/Turn turn
================================================================================
MSG: team_msgs/Turn
geometry_msgs/Quaternion orientation
================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
"""


def save_own(path, columns, with_definition=True):
    """A ROS 2 bag with a user-defined message type and a standard one."""
    pytest.importorskip("rosbags")
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store, name = get_typestore(Stores.ROS2_HUMBLE), "team_msgs/msg/State"
    store.register(get_types_from_msg(OWN, name))
    types, number = store.types, "std_msgs/msg/Float64"
    with Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        own = writer.add_connection("/car", name, typestore=store)
        other = writer.add_connection("/speed", number, typestore=store)
        for t, x, y, psi in zip(*columns.values(), strict=True):
            stamp = divmod(round(1e9 * (1000 + t)), 10**9)
            header = types["std_msgs/msg/Header"](
                types["builtin_interfaces/msg/Time"](*stamp), "world"
            )
            turned = types["geometry_msgs/msg/Quaternion"](
                0.0, 0.0, np.sin(psi / 2), np.cos(psi / 2)
            )
            turn = types["team_msgs/msg/Turn"](turned)
            raw = store.serialize_cdr(types[name](header, x, y, turn), name)
            late = round(1e9 * (1000.02 + t))
            writer.write(own, late, raw)
            raw = store.serialize_cdr(types[number](2 * t), number)
            writer.write(other, late, raw)
    if not with_definition:  # as of releases of ROS 2 before 2023, all or some
        with sqlite3.connect(next(path.glob("*.db3"))) as base:
            base.execute("delete from message_definitions where topic_type = ?", (name,))


OWN_OF_ROS = """
[columns]
time = "/car.header.stamp"
x = "/car.x"
y = "/car.y"
yaw = "/car.turn.orientation"
"""


def test_a_message_type_is_read_from_its_definition_in_the_bag(tmp_path):
    columns = pose_log()
    save_own(tmp_path / "bag", columns)
    log = derive(tmp_path / "bag", vehicle(tmp_path, CAR + OWN_OF_ROS + KEEP))
    path = write_log(tmp_path / "log.csv", columns)
    from_text = derive(path, pose_vehicle(tmp_path))
    for name in ("time", "alpha", "fy"):
        np.testing.assert_allclose(log.columns[name], from_text.columns[name], rtol=1e-4, atol=1e-4)
    assert log.source["epoch"] == pytest.approx(1000 + columns["t"][0])


def test_a_topic_of_unknown_type_is_skipped_and_reported(tmp_path):
    save_own(tmp_path / "bag", pose_log(), with_definition=False)
    table = read_table(tmp_path / "bag", [])
    assert "/speed.data" in table.headers and "/car.x" not in table.headers
    assert said(table.notes, "topics not read: '/car' (no team_msgs/msg/State by its")
    with pytest.raises(DataError, match="'/car.x': .*\n.*topics not read: '/car'"):
        derive(tmp_path / "bag", vehicle(tmp_path, CAR + OWN_OF_ROS + KEEP))


def test_a_bag_without_messages_is_said_to_be_so(tmp_path):
    pytest.importorskip("rosbags")
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    with Writer(tmp_path / "bag", version=9) as writer:
        store = get_typestore(Stores.ROS2_HUMBLE)
        writer.add_connection("/odom", "nav_msgs/msg/Odometry", typestore=store)
    with pytest.raises(DataError, match=r"topics not read: '/odom' \(no messages\)"):
        read(tmp_path / "bag")


def test_a_damaged_bag_is_reported(tmp_path):
    pytest.importorskip("rosbags")
    path = tmp_path / "log.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + bytes(50))
    with pytest.raises(DataError, match="the bag cannot be read"):
        read(path)
