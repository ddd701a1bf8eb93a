"""Copies the logs of the cases: ``python -m fits.measured_changes.make_data SRC``.

``SRC`` holds ``f1tenth_tires/`` (three tables of GitHub
TeoIlie/Learning-dynamics-models-for-velocity-estimation, commit c40ad24,
``code/opti_test``, gzipped) and ``dart_jetracer/`` (GitHub Lorenzo-Lyons/DART, commit
4b525232, ``ROS_packages/racecar_pkg/src/Data``). Every row is kept, of these columns:
time [s], v_x, v_y [m/s], r [rad/s], delta [rad], run_id; time, x, y [m], yaw [rad],
active; rounded to 0.1 mm/s, 0.1 mrad/s, 0.1 mrad and 0.01 mm.
"""

import csv
import gzip
import sys
from pathlib import Path

HERE = Path(__file__).parent
CARS = {"a": "iros_hoons_1_with_friction", "d": "xray_duck_all_test", "others": "different_tires"}
"""Name of a set of tires -> table of the source."""
FAST_RAMP = "circles_27_sept_2024_fast_ramp/car_1_Datarecording_09_27_2024_18_18_37"


def copied(source: Path, target: Path, columns: dict[str, tuple[str, str]]) -> None:
    """Write columns (name -> (header of the source, format)) of one gzipped CSV file."""
    with gzip.open(source, "rt") as file:
        rows = list(csv.DictReader(file))
    lines = [",".join(columns)]
    for row in rows:
        lines.append(",".join(f"{float(row[k]):{how}}" for k, how in columns.values()))
    target.write_bytes(gzip.compress(("\n".join(lines) + "\n").encode(), mtime=0))


def main(source: Path) -> None:
    rates = {"time": ("", ".2f"), "v_x": ("v_x", ".4f"), "v_y": ("v_y", ".4f")}
    rates |= {"r": ("r", ".4f"), "delta": ("delta", ".4f"), "run_id": ("run_id", ".0f")}
    for name, table in CARS.items():
        there = source / "f1tenth_tires" / f"{table}.csv.gz"
        copied(there, HERE / "f1tenth" / f"{name}.csv.gz", rates)
    pose = {"vicon time": ("vicon time", ".4f"), "vicon x": ("vicon x", ".5f")}
    pose |= {"vicon y": ("vicon y", ".5f"), "vicon yaw": ("vicon yaw", ".5f")}
    pose["safety_value"] = ("safety_value", ".0f")
    there = source / "dart_jetracer" / f"{FAST_RAMP}.csv.gz"
    copied(there, HERE / "dart_later" / f"{Path(FAST_RAMP).name}.csv.gz", pose)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
