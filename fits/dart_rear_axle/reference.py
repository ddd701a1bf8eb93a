"""Numbers of expected.toml by SciPy's least squares and a jackknife over the six logs.

``python -m fits.dart_rear_axle.reference``
"""

import csv
import tempfile
from pathlib import Path

import numpy as np

from fits.formulas import brush, fit_scipy, magic_formula
from tirefit import derive_files

HERE = Path(__file__).parent
LOGS = HERE.parent / "dart_jetracer"


def brush_fit(alpha, fy, fz):
    """((c_p a^2, mu), standard errors as if rows were independent, RMSE)."""
    slip, side = np.tan(np.abs(alpha)), np.sign(alpha)
    return fit_scipy(
        lambda c, mu: side * brush(slip, fz, 0.0, c, mu),
        fy,
        [np.array([30.0, 0.7])],
        [1.0, 0.01],
        [1e4, 5.0],
    )


def magic_rmse(alpha, fy, fz, shape: float) -> float:
    """RMSE [N] of the Magic Formula with C held."""
    return fit_scipy(
        lambda b, d, e: magic_formula(alpha, fz, b, shape, d, e),
        fy,
        [np.array([10 / shape, d, e]) for d in (0.7, 1.2) for e in (-1.0, 0.5)],
        [0.1, 0.01, -20.0],
        [200.0, 5.0, 1.0],
    )[2]


def six_logs(vehicle: Path) -> dict[str, np.ndarray]:
    """Run -> (alpha, fy, fz), each (n,), of every log."""
    with tempfile.TemporaryDirectory() as folder:
        logs = sorted(LOGS.glob("*/*.csv.gz"))
        written = derive_files(logs, vehicle, Path(folder, "all.csv"))
        with written.data.open() as file:
            next(file)  # it states the convention
            rows = list(csv.DictReader(file))
    table = np.array([[float(row[k]) for k in ("alpha", "fy", "fz")] for row in rows])
    run = np.array([row["run"] for row in rows])
    return {name: table[run == name].T for name in dict.fromkeys(run)}


def jackknife(logs: dict[str, np.ndarray]) -> np.ndarray:
    """Jackknife standard errors (2,) of c_p a^2 and mu: fits without each log."""
    left_out = np.array(
        [
            brush_fit(*np.hstack([log for name, log in logs.items() if name != out]))[0]
            for out in logs
        ]
    )
    count = len(logs)
    spread = np.sum((left_out - left_out.mean(0)) ** 2, axis=0)
    return np.sqrt((count - 1) / count * spread)


def reference() -> dict[str, float]:
    found = {}
    vehicles = {"all": HERE / "vehicle.toml", "no_offset": LOGS / "vehicle.toml"}
    for name, vehicle in vehicles.items():
        logs = six_logs(vehicle)
        values, naive, rmse = brush_fit(*np.hstack(list(logs.values())))
        spread = jackknife(logs)
        for i, parameter in enumerate(("cpa2", "mu")):
            found[f"{name} {parameter}"] = float(values[i])
            found[f"{name} {parameter} naive std"] = float(naive[i])
            found[f"{name} {parameter} jackknife std"] = float(spread[i])
        found[f"{name} rmse"] = rmse
    demo = np.loadtxt(HERE / "free_driving.csv", delimiter=",", skiprows=1, usecols=(1, 2, 3))
    values, naive, rmse = brush_fit(*demo.T)
    found |= {"demo cpa2": float(values[0]), "demo mu": float(values[1])}
    found |= {"demo rmse": rmse}
    for shape in (0.6, 1.3, 2.4):
        name = f"demo magic formula rmse, C = {shape}"
        found[name] = magic_rmse(*demo.T, shape)
    return found


if __name__ == "__main__":
    for key, value in reference().items():
        print(f"{key:28s} {value:.7g}")
