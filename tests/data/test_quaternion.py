"""Headings from the quaternions of a table."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_motion import CAR, KEEP, POSE, pose_log, vehicle, write_log

from tirefit.data.read import read
from tirefit.data.vehicle.derive import derive
from tirefit.results import DataError

SPELLINGS = {
    "q{}": "yaw",
    "Q_{} [-]": "Q_yaw",
    "quat_{}": "quat_w",
    "quaternion.{}": "quaternion",
    "orientation.{}": "orientation.yaw",
    "orientation_{}": "orientation_yaw",
    "pose.orientation.{}": "pose.orientation",
    "field.pose.pose.orientation.{}": "field.pose.pose.orientation.yaw",
    "/odom/pose/pose/orientation/{}": "/odom/pose/pose/orientation/yaw",
    "/tf.transforms[0].transform.rotation.{}": "/tf.transforms[0].transform.rotation",
    "poseOrientation{}": "poseOrientationyaw",
}


def quaternion_log(header, norm=1.0):
    """The pose of a car that rolls and pitches; the columns in the order w, x, y, z."""
    log = pose_log()
    yaw = log.pop("psi")
    angles = np.column_stack([yaw, 0 * yaw - 0.03, 0 * yaw + 0.02])
    x, y, z, w = norm * Rotation.from_euler("ZYX", angles).as_quat().T
    names = (header.format(part) for part in "wxyz")
    return log | dict(zip(names, (w, x, y, z), strict=True))


def settings(tmp_path, yaw):
    return vehicle(tmp_path, CAR + POSE.replace('"psi"', f'"{yaw}"') + KEEP)


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """The result of the heading itself."""
    folder = tmp_path_factory.mktemp("heading")
    return derive(write_log(folder / "a.csv", pose_log()), settings(folder, "psi"))


@pytest.mark.parametrize("header", SPELLINGS)
def test_a_quaternion_gives_the_result_of_its_heading(tmp_path, sound, header):
    path = write_log(tmp_path / "b.csv", quaternion_log(header, norm=1.02))
    log = derive(path, settings(tmp_path, SPELLINGS[header]))
    for name in ("alpha", "fy"):
        np.testing.assert_allclose(log.columns[name], sound.columns[name], atol=1e-6)
    assert any("computed from the quaternion" in said for said in log.assumptions)


def test_an_invalid_quaternion_is_masked_and_counted(tmp_path):
    columns = quaternion_log("q{}")
    for name in ("qw", "qx", "qy", "qz"):
        columns[name][700:703] = 0.0
        columns[name][900] *= 2
    columns["qz"][1200] = np.nan
    path = write_log(tmp_path / "a.csv", columns)
    log = derive(path, settings(tmp_path, "yaw"))
    assert log.dropped_rows["a value is missing"] == 5
    (said,) = (text for text in log.assumptions if "quaternion" in text)
    assert "1 rows lack it; 4 rows masked" in said
    data = read(path, curve=False, mask_bad_rows=True)
    assert len(data.source.masked) > 0 and np.isfinite(data["heading"][700]) == 0


def test_the_only_quaternion_of_a_table_gives_the_heading(tmp_path):
    columns = quaternion_log("pose.orientation.{}")
    data = read(write_log(tmp_path / "a.csv", columns), curve=False)
    yaw = np.unwrap(pose_log()["psi"])
    np.testing.assert_allclose(np.unwrap(data["heading"]), yaw, atol=1e-9)
    # A heading of the file's own goes before it.
    own = columns | {"heading": 0 * columns["t"] + 0.5}
    data = read(write_log(tmp_path / "b.csv", own), curve=False)
    assert np.all(data["heading"] == 0.5)


def test_three_components_are_no_quaternion(tmp_path):
    columns = quaternion_log("q{}")
    del columns["qx"]
    path = write_log(tmp_path / "a.csv", columns)
    with pytest.raises(DataError, match="'yaw': the column is missing"):
        derive(path, settings(tmp_path, "yaw"))
