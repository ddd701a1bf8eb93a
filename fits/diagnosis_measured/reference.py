"""The offset, and its gain on the held-out logs, without tirefit's diagnosis.

``python -m fits.diagnosis_measured.reference``: SciPy's least squares on S(12) in
NumPy, with equal weights.
"""

import csv
from pathlib import Path

import numpy as np

from fits.formulas import brush, fit_scipy

HERE = Path(__file__).parent


def logs_of(name: str) -> dict[str, np.ndarray]:
    """Log -> (alpha, fy, fz), each (n,)."""
    with (HERE / f"{name}.csv").open() as file:
        rows = list(csv.DictReader(file))
    table = np.array([[float(row[k]) for k in ("alpha", "fy", "fz")] for row in rows])
    run = np.array([row["run"] for row in rows])
    return {log: table[run == log].T for log in dict.fromkeys(run)}


def force(rows, c: float, mu: float, shift: float = 0.0):
    """S(12) at tan(alpha) + shift, odd in slip."""
    slip = np.tan(rows[0]) + shift
    return np.sign(slip) * brush(np.abs(slip), rows[2], 0.0, c, mu)


def fitted(rows, shifted: bool):
    """c_p a^2, mu and optionally the shift, with equal weights."""
    start, low, high = [30.0, 0.7], [1.0, 0.01], [1e4, 5.0]
    if shifted:
        start, low, high = [*start, 0.0], [*low, -0.1], [*high, 0.1]
    found = fit_scipy(lambda *p: force(rows, *p), rows[1], [np.array(start)], low, high)
    return found[0]


def rmse(rows, *parameters: float) -> float:
    return float(np.sqrt(np.mean((rows[1] - force(rows, *parameters)) ** 2)))


def reference() -> dict[str, float]:
    seen, held = logs_of("diagnosed"), logs_of("held_out")
    rows, others = (np.hstack(list(logs.values())) for logs in (seen, held))
    plain, shifted = fitted(rows, False), fitted(rows, True)
    found = {
        "cpa2": plain[0],
        "mu": plain[1],
        "shift": shifted[2],
        "cpa2 with shift": shifted[0],
        "mu with shift": shifted[1],
        "rmse": rmse(rows, *plain),
        "rmse with shift": rmse(rows, *shifted),
        "held-out rmse": rmse(others, *plain),
        "held-out rmse with shift": rmse(others, *shifted),
        "held-out rmse of a brush fitted there": rmse(others, *fitted(others, False)),
        "held-out rmse of a shifted brush fitted there": rmse(others, *fitted(others, True)),
        "shift of the held-out logs": fitted(others, True)[2],
    }
    lifted = fit_scipy(
        lambda c, mu, lift: force(rows, c, mu) + lift,
        rows[1],
        [np.array([30.0, 0.7, 0.0])],
        [1.0, 0.01, -2.0],
        [1e4, 5.0, 2.0],
    )[0]
    missed = others[1] - force(others, *lifted[:2]) - lifted[2]
    found["held-out rmse with force offset"] = np.sqrt(np.mean(missed**2))
    left_out = [
        fitted(np.hstack([log for name, log in seen.items() if name != out]), True)[2]
        for out in seen
    ]
    spread = np.sum((np.array(left_out) - np.mean(left_out)) ** 2)
    found["shift jackknife std"] = np.sqrt((len(seen) - 1) / len(seen) * spread)
    for number, log in enumerate(seen.values()):
        found[f"log {number + 1} shift"] = fitted(log, True)[2]
        found[f"log {number + 1} rmse"] = rmse(log, *plain)
        found[f"log {number + 1} rmse with shift"] = rmse(log, *shifted)
    for number, log in enumerate(held.values()):
        found[f"log {number + 4} shift"] = fitted(log, True)[2]
        found[f"log {number + 4} rmse"] = rmse(log, *plain)
        found[f"log {number + 4} rmse with shift"] = rmse(log, *shifted)
    return {key: float(value) for key, value in found.items()}


if __name__ == "__main__":
    for key, value in reference().items():
        print(f"{key:46s} {value:.7g}")
