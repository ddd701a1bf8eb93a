"""The axles of a measured 1:10 car on two sets of tires: ``python -m
fits.export.make_data``.

``a_front.csv``, ``a_rear.csv``, ``d_front.csv`` and ``d_rear.csv``: the logs of
``fits/measured_changes/f1tenth`` on tires A and D through ``derive``, the slip angle
and the lateral force of one axle, with its load. Every twentieth row at 100 Hz is
written.
"""

from pathlib import Path

import numpy as np

from fits.measured_changes.logs import Logs, table

HERE = Path(__file__).parent
COLUMNS = ("time", "alpha", "fy", "fz", "v")
SLIDING = 0.6
"""Largest slip angle [rad] of the kept rows; beyond it the car spins."""


def main() -> None:
    for tires in ("a", "d"):
        for axle in ("front", "rear"):
            made = table(Logs((tires,), axle=axle))
            kept = np.abs(made["alpha"]) < SLIDING
            lines = ["# convention: braking", ",".join((*COLUMNS, "run"))]
            cells = np.stack([made[name][kept] for name in COLUMNS], axis=1)
            runs = made.run[made.kept][kept]
            for row, run in zip(cells, runs, strict=True):
                lines.append(",".join((*(f"{x:.5g}" for x in row), run)))
            path = HERE / f"{tires}_{axle}.csv"
            path.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
