"""Writes the derived tables of the axle: ``python -m fits.dart_rear_axle.make_data``.

``free_driving.csv``, for the demo: both logs of free driving by ``derive`` at 100 Hz;
every fifth row (20 Hz for a bandwidth of 4 Hz), rounded to 0.01 mrad and 0.1 mN.
``six_logs.csv``: all six logs without a heading correction, with the motion of the car;
every hundredth row, which includes the rate of the slip angle.
"""

import csv
import tempfile
from pathlib import Path

from tirefit import derive_files

HERE = Path(__file__).parent
ALL = HERE.parent / "dart_jetracer"
LOGS = ALL / "free_driving_16_sept_2024"
DIGITS = {"time": 2, "run": None}
"""Decimals of these columns; six for the others, so that the force can be recomputed."""


def six_logs() -> None:
    """Every hundredth row of every log, with all columns."""
    with tempfile.TemporaryDirectory() as folder:
        logs = sorted(ALL.glob("*/*.csv.gz"), key=lambda log: log.name)
        full = derive_files(logs, ALL / "vehicle.toml", Path(folder, "all.csv")).data
        with full.open() as file:
            next(file)  # it states the convention
            rows = list(csv.DictReader(file))
    lines = [",".join(rows[0])]
    for run in dict.fromkeys(row["run"] for row in rows):
        for row in [row for row in rows if row["run"] == run][::100]:
            row["run"] = run.removeprefix("car_1_Datarecording_")
            cells = (
                text if DIGITS.get(name, 6) is None else f"{float(text):.{DIGITS.get(name, 6)}f}"
                for name, text in row.items()
            )
            lines.append(",".join(cells))
    (HERE / "six_logs.csv").write_text("\n".join(lines) + "\n")


def main() -> None:
    six_logs()
    with tempfile.TemporaryDirectory() as folder:
        logs = sorted(LOGS.glob("*.csv.gz"))
        full = derive_files(logs, HERE / "vehicle.toml", Path(folder, "all.csv")).data
        with full.open() as file:
            next(file)  # it states the convention
            rows = list(csv.DictReader(file))
    lines = ["time,alpha,fy,fz,v,run"]
    for run in dict.fromkeys(row["run"] for row in rows):
        for row in [row for row in rows if row["run"] == run][::5]:
            numbers = [
                f"{float(row['time']):.2f}",
                f"{float(row['alpha']):.5f}",
                f"{float(row['fy']):.4f}",
                f"{float(row['fz']):.4f}",
                f"{float(row['v']):.4f}",
            ]
            lines.append(",".join([*numbers, run.removeprefix("car_1_Datarecording_")]))
    (HERE / "free_driving.csv").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
