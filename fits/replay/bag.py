"""Writes drives of the measured 1:10 car (tires A) as a ROS 2 bag, as such a car records it:

    python -m fits.replay.bag --out drive.mcap               # two drives
    python -m fits.replay.bag --runs 4,5 --out other.mcap    # two others

`/odom` (nav_msgs/Odometry) has the speeds and the yaw rate at the tracked point, `/drive`
(ackermann_msgs/AckermannDriveStamped) the road wheel angle. It needs the extra `logs`.
"""

import argparse
import csv
import gzip
import shutil
import tempfile
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

SOURCE = Path(__file__).parents[1] / "measured_changes/f1tenth/a.csv.gz"
PAUSE = 5.0
"""Time [s] between two drives in the bag."""
EVERY = 2  # of the rows at 100 Hz
BEGIN = 1_700_000_000.0  # s
ACKERMANN = {
    "ackermann_msgs/msg/AckermannDrive": "float32 steering_angle\nfloat32 steering_angle_velocity\n"
    "float32 speed\nfloat32 acceleration\nfloat32 jerk",
    "ackermann_msgs/msg/AckermannDriveStamped": "std_msgs/Header header\n"
    "ackermann_msgs/AckermannDrive drive",
}


def rows(runs):
    """Time [s], speed ahead and to the left [m/s], yaw rate and wheel angle [rad] of each row."""
    with gzip.open(SOURCE, "rt") as file:
        header, *cells = csv.reader(file)
    column = dict(zip(header, np.array(cells, float).T, strict=True))
    begin = 0.0
    for run in runs:
        own = np.flatnonzero(column["run_id"] == run)[::EVERY]
        time = column["time"][own] - column["time"][own[0]]
        names = ("v_x", "v_y", "r", "delta")
        yield from zip(begin + time, *(column[name][own] for name in names), strict=True)
        begin += time[-1] + PAUSE


def main():
    parser = argparse.ArgumentParser("python -m fits.replay.bag")
    parser.add_argument("--runs", default="0,2")
    parser.add_argument("--out", type=Path, required=True)
    asked = parser.parse_args()
    out, runs = asked.out, [int(run) for run in asked.runs.split(",")]
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in ACKERMANN.items():
        store.register(get_types_from_msg(text, name))
    odometry, ackermann = (
        store.types[name]
        for name in ("nav_msgs/msg/Odometry", "ackermann_msgs/msg/AckermannDriveStamped")
    )

    def of(name, *fields):
        return store.types[f"geometry_msgs/msg/{name}"](*fields)

    with tempfile.TemporaryDirectory() as scratch:
        bag = Path(scratch, "bag")
        with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            topics = {
                kind: writer.add_connection(topic, kind.__msgtype__, typestore=store)
                for topic, kind in (("/odom", odometry), ("/drive", ackermann))
            }
            pose = of("PoseWithCovariance", of("Pose", of("Point", 0.0, 0.0, 0.0),
                      of("Quaternion", 0.0, 0.0, 0.0, 1.0)), np.zeros(36))  # fmt: skip
            for time, v_x, v_y, yaw_rate, angle in rows(runs):
                stamp = BEGIN + time
                whole = store.types["builtin_interfaces/msg/Time"](
                    int(stamp), round(1e9 * (stamp % 1))
                )
                header = store.types["std_msgs/msg/Header"](whole, "base_link")
                twist = of("Twist", of("Vector3", v_x, v_y, 0.0), of("Vector3", 0.0, 0.0, yaw_rate))
                twist = of("TwistWithCovariance", twist, np.zeros(36))
                drive = store.types["ackermann_msgs/msg/AckermannDrive"](angle, 0, v_x, 0, 0)
                for message in (
                    odometry(header, "base_link", pose, twist),
                    ackermann(header, drive),
                ):
                    kind = type(message)
                    raw = store.serialize_cdr(message, kind.__msgtype__)
                    writer.write(topics[kind], round(1e9 * stamp), raw)
        shutil.move(str(next(bag.glob("*.mcap"))), out)
    print(f"wrote {out}")


if __name__ == "__main__":
    main()
