"""The small derived table of the demo: ``python -m fits.dart_rear_axle.make_data``.

Both logs of free driving through ``derive`` at 100 Hz; every fifth row is written,
which is 20 Hz for a bandwidth of 4 Hz, rounded to 0.01 mrad and 0.1 mN.
"""

import csv
import tempfile
from pathlib import Path

from tirefit import derive_files

HERE = Path(__file__).parent
LOGS = HERE.parent / "dart_jetracer" / "free_driving_16_sept_2024"


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        logs = sorted(LOGS.glob("*.csv.gz"))
        full = derive_files(logs, HERE / "vehicle.toml", Path(folder, "all.csv")).data
        with full.open() as file:
            rows = list(csv.DictReader(file))
    lines = [",".join(rows[0])]
    for run in dict.fromkeys(row["run"] for row in rows):
        for row in [row for row in rows if row["run"] == run][::5]:
            numbers = [
                f"{float(row['time']):.2f}", f"{float(row['alpha']):.5f}",
                f"{float(row['fy']):.4f}", f"{float(row['fz']):.4f}",
                f"{float(row['v']):.4f}",
            ]  # fmt: skip
            lines.append(",".join([*numbers, run.removeprefix("car_1_Datarecording_")]))
    (HERE / "free_driving.csv").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
