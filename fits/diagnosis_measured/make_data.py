"""Writes two tables from six logs: ``python -m fits.diagnosis_measured.make_data``.

Of the logs of ``dart_jetracer`` in the order of recording, the first three are
diagnosed, the last three are held out. The split was fixed before any diagnosis; both
halves turn to both sides. ``derive`` processes each log at 100 Hz without a heading
correction; every twentieth row is written, rounded to 0.01 mrad and 0.1 mN.
"""

import csv
import tempfile
from pathlib import Path

from tirefit import derive_files

HERE = Path(__file__).parent
LOGS = HERE.parent / "dart_jetracer"
EVERY = 20
"""Step between written rows, in rows of 0.01 s."""


def thinned(rows: list[dict], every: int) -> list[str]:
    """Lines of a CSV file: the header, then every n-th row of each run."""
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
