"""The logs of the other days: ``python -m fits.dart_simulator.make_data``.

The four logs of circles through ``derive`` at 100 Hz, with the vehicle file of
``dart_rear_axle``; every twentieth row is written, rounded to 0.01 mrad and 0.1 mN.
"""

import csv
import tempfile
from pathlib import Path

from tirefit import derive_files

HERE = Path(__file__).parent
LOGS = HERE.parent / "dart_jetracer" / "circles_rubbery_floor"
VEHICLE = HERE.parent / "dart_rear_axle" / "vehicle.toml"
EVERY = 20
"""Rows of 0.01 s from one written row to the next."""


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        logs = sorted(LOGS.glob("*.csv.gz"))
        whole = derive_files(logs, VEHICLE, Path(folder, "all.csv")).data
        with whole.open() as file:
            rows = list(csv.DictReader(file))
    lines = [",".join(rows[0])]
    for run in dict.fromkeys(row["run"] for row in rows):
        for row in [row for row in rows if row["run"] == run][::EVERY]:
            numbers = [
                f"{float(row['time']):.2f}", f"{float(row['alpha']):.5f}",
                f"{float(row['fy']):.4f}", f"{float(row['fz']):.4f}",
                f"{float(row['v']):.4f}",
            ]  # fmt: skip
            short = run.removeprefix("car_1_Datarecording_")
            lines.append(",".join([*numbers, short]))
    (HERE / "circles.csv").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
