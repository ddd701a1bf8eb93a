"""The simulator, its error on another day and the parts of it, without tirefit.

``python -m fits.dart_simulator.reference``: SciPy's least squares on S(12) in NumPy,
with equal weights, without priors of effects; shares of the mean square error on blocks of time
left out in turn, of the parameters, then of the shift beside them.
"""

import csv
from pathlib import Path

import numpy as np

from fits.diagnosis_measured.reference import fitted, rmse

HERE = Path(__file__).parent


def rows_of(name: str) -> np.ndarray:
    """alpha, fy, fz of all logs of a table: (3, n)."""
    with (HERE / f"{name}.csv").open() as file:
        rows = list(csv.DictReader(file))
    return np.array([[float(row[k]) for k in ("alpha", "fy", "fz")] for row in rows]).T


PARTS = 8  # blocks of time that are left out in turn


def left_out(rows: np.ndarray, shifted: bool) -> float:
    """Mean square error on each block of rows, which are in the order of time, of a fit to the
    others."""
    code = np.arange(rows.shape[1]) * PARTS // rows.shape[1]
    squares = [
        np.sum(code == k) * rmse(rows[:, code == k], *fitted(rows[:, code != k], shifted)) ** 2
        for k in range(PARTS)
    ]
    return sum(squares) / rows.shape[1]


def reference() -> dict[str, float]:
    rows = rows_of("free_driving")
    given = fitted(rows_of("circles"), False)
    plain, both = fitted(rows, False), fitted(rows, True)
    whole, tuned, left = (rmse(rows, *parameters) ** 2 for parameters in (given, plain, both))
    tuned_out, left_there = (left_out(rows, shifted) for shifted in (False, True))
    found = {
        "simulated cpa2": given[0],
        "simulated mu": given[1],
        "measured cpa2": both[0],
        "measured mu": both[1],
        "shift": both[2],
        "error": whole**0.5,
        "tuned": tuned**0.5,
        "left": left**0.5,
        "left out": left_there**0.5,
        "share of the parameters": (whole - tuned_out) / whole,
        "share of the shift": (tuned_out - left_there) / whole,
    }
    return {key: float(value) for key, value in found.items()}


if __name__ == "__main__":
    for key, value in reference().items():
        print(f"{key:46s} {value:.7g}")
