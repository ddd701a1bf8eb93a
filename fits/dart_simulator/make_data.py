"""Writes two days of one car: ``python -m fits.dart_simulator.make_data``.

``circles.csv``, for the fit of the simulator: the four logs of circles of 9 September
2024 by ``derive`` at 100 Hz, with the corrected heading of ``dart_rear_axle``.
``free_driving.csv``: the two logs of 16 September without the correction. Every
twentieth row is written, rounded to 0.01 mrad and 0.1 mN. A part of these rows are the
samples of ``tirefit demo``.
"""

import csv
import tempfile
from pathlib import Path

from fits.diagnosis_measured.make_data import thinned
from tirefit import derive_files

HERE = Path(__file__).parent
LOGS = HERE.parent / "dart_jetracer"
DAYS = {
    "circles": ("circles_rubbery_floor", HERE.parent / "dart_rear_axle"),
    "free_driving": ("free_driving_16_sept_2024", LOGS),
}
"""Table -> folder of its logs, and folder of the vehicle file."""
EVERY = 20
"""Step between written rows, in rows of 0.01 s."""
SAMPLED = {"circles": 4, "free_driving": 2}
"""Step between rows of a sample, in written rows."""
SAMPLES = HERE.parents[1] / "tirefit" / "samples"


def main() -> None:
    for name, (folder, vehicle) in DAYS.items():
        with tempfile.TemporaryDirectory() as scratch:
            logs = sorted((LOGS / folder).glob("*.csv.gz"))
            whole = Path(scratch, "all.csv")
            derive_files(logs, vehicle / "vehicle.toml", whole)
            with whole.open() as file:
                next(file)  # it states the convention
                rows = list(csv.DictReader(file))
        header, *lines = thinned(rows, EVERY)
        (HERE / f"{name}.csv").write_text("\n".join([header, *lines]) + "\n")
        few = ["# convention: braking", header, *lines[:: SAMPLED[name]]]
        (SAMPLES / f"{name}.csv").write_text("\n".join(few) + "\n")


if __name__ == "__main__":
    main()
