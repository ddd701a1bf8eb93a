"""Two days of one car: ``python -m fits.dart_simulator.make_data``.

``circles.csv``: the four logs of circles of 9 September 2024 through ``derive`` at 100
Hz, with the vehicle file of ``dart_rear_axle`` that corrects the heading: what the
simulator was fitted to. ``free_driving.csv``: the two logs of 16 September as they
were logged, heading and all. Every twentieth row is written, rounded to 0.01 mrad and
0.1 mN.
"""

import csv
import tempfile
from pathlib import Path

from tirefit import derive_files

HERE = Path(__file__).parent
LOGS = HERE.parent / "dart_jetracer"
DAYS = {
    "circles": ("circles_rubbery_floor", HERE.parent / "dart_rear_axle"),
    "free_driving": ("free_driving_16_sept_2024", LOGS),
}
"""Table -> folder of its logs, and folder of the vehicle file."""
EVERY = 20
"""Rows of 0.01 s from one written row to the next."""


def main() -> None:
    for name, (folder, vehicle) in DAYS.items():
        with tempfile.TemporaryDirectory() as scratch:
            logs = sorted((LOGS / folder).glob("*.csv.gz"))
            whole = Path(scratch, "all.csv")
            derive_files(logs, vehicle / "vehicle.toml", whole)
            with whole.open() as file:
                rows = list(csv.DictReader(file))
        (HERE / f"{name}.csv").write_text("\n".join(_lines(rows)) + "\n")


def _lines(rows: list[dict]) -> list[str]:
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
    return lines


if __name__ == "__main__":
    main()
