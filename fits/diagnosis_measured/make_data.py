"""Two small tables from six logs: ``python -m fits.diagnosis_measured.make_data``.

The logs of ``dart_jetracer`` in the order they were recorded: the first three are
diagnosed, the last three are held out. The split was fixed before anything was
diagnosed; both halves turn to both sides. Each goes through ``derive`` at 100 Hz with
the vehicle file that corrects nothing; every twentieth row of each log is written,
rounded to 0.01 mrad and 0.1 mN.
"""

import csv
import tempfile
from pathlib import Path

from tirefit import derive_files

HERE = Path(__file__).parent
LOGS = HERE.parent / "dart_jetracer"
EVERY = 20
"""Rows of 0.01 s from one written row to the next."""


def thinned(rows: list[dict], every: int) -> list[str]:
    """Lines of a CSV file: the header, then every so many rows of each run."""
    lines = ["time,alpha,fy,fz,v,run"]
    for run in dict.fromkeys(row["run"] for row in rows):
        for row in [row for row in rows if row["run"] == run][::every]:
            numbers = [
                f"{float(row['time']):.2f}",
                f"{float(row['alpha']):.5f}",
                f"{float(row['fy']):.4f}",
                f"{float(row['fz']):.4f}",
                f"{float(row['v']):.4f}",
            ]
            short = run.removeprefix("car_1_Datarecording_")
            lines.append(",".join([*numbers, short]))
    return lines


def main() -> None:
    logs = sorted(LOGS.glob("*/*.csv.gz"), key=lambda log: log.name)
    for name, some in (("diagnosed", logs[:3]), ("held_out", logs[3:])):
        with tempfile.TemporaryDirectory() as folder:
            whole = Path(folder, "all.csv")
            derive_files(some, LOGS / "vehicle.toml", whole)
            with whole.open() as file:
                next(file)  # it states the convention
                rows = list(csv.DictReader(file))
        (HERE / f"{name}.csv").write_text("\n".join(thinned(rows, EVERY)) + "\n")


if __name__ == "__main__":
    main()
