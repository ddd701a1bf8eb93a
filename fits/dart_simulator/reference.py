"""The simulator, its error on another day and the parts of it, without tirefit.

``python -m fits.dart_simulator.reference``: SciPy's least squares on S(12) in NumPy,
with equal weights, without priors of effects; shares by the Shapley formula for two
players.
"""

import csv
from pathlib import Path

import numpy as np

from fits.diagnosis_measured.reference import fitted, force, rmse
from fits.formulas import fit_scipy

HERE = Path(__file__).parent


def rows_of(name: str) -> np.ndarray:
    """alpha, fy, fz of all logs of a table: (3, n)."""
    with (HERE / f"{name}.csv").open() as file:
        rows = list(csv.DictReader(file))
    return np.array([[float(row[k]) for k in ("alpha", "fy", "fz")] for row in rows]).T


def shift_alone(rows, c: float, mu: float) -> float:
    """The shift of tan(alpha) that fits a given tire best."""
    found = fit_scipy(
        lambda shift: force(rows, c, mu, shift), rows[1], [np.zeros(1)], [-0.1], [0.1]
    )
    return float(found[0][0])


def reference() -> dict[str, float]:
    rows = rows_of("free_driving")
    given = fitted(rows_of("circles"), False)
    plain, both = fitted(rows, False), fitted(rows, True)
    shift = shift_alone(rows, *given)
    whole, tuned, shifted, left = (
        rmse(rows, *parameters) ** 2 for parameters in (given, plain, (*given, shift), both)
    )
    parameters = (whole - tuned + shifted - left) / 2
    offset = (whole - shifted + tuned - left) / 2
    found = {
        "simulated cpa2": given[0],
        "simulated mu": given[1],
        "measured cpa2": both[0],
        "measured mu": both[1],
        "shift": both[2],
        "error": whole**0.5,
        "tuned": tuned**0.5,
        "left": left**0.5,
        "share of the parameters": parameters / whole,
        "share of the shift": offset / whole,
    }
    return {key: float(value) for key, value in found.items()}


if __name__ == "__main__":
    for key, value in reference().items():
        print(f"{key:46s} {value:.7g}")
