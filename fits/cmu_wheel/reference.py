"""Numbers of expected.toml: the brush by SciPy, weighted by the same deviations.

``python -m fits.cmu_wheel.reference``
"""

import csv
from pathlib import Path

import numpy as np

from fits.formulas import brush, fit_scipy

HERE = Path(__file__).parent
LOCKED = 1e6
"""Physical slip of a locked wheel."""


def reference() -> dict[str, float]:
    found = {}
    for path in sorted(HERE.glob("*.csv")):
        with path.open() as file:
            rows = list(csv.DictReader(file))
        angle, ratio, fx, std, fz = (
            np.array([float(row[name]) for row in rows])
            for name in ("slip_angle_deg", "slip_ratio", "Fx_N", "Fx_std_N", "Fz_N")
        )
        slip = np.minimum(-ratio, 1 - 1e-12)
        # Braking slip is kappa, driving slip is sigma already (S Table 1).
        sigma = np.where(slip > 0, slip / (1 - slip), slip)
        sigma = np.minimum(sigma, LOCKED)
        # Combined slip (S 2.3): the force of the resultant slip, in its direction.
        sideways = np.minimum(np.tan(np.radians(angle)), LOCKED) * (1 + sigma)
        resultant = np.hypot(sigma, sideways)
        along = sigma / np.where(resultant > 0, resultant, 1.0)

        def force(c, mu, along=along, resultant=resultant, fz=fz):
            return along * brush(resultant, fz, 0.0, c, mu)

        def weighted(c, mu, force=force, std=std):
            return force(c, mu) / std

        starts = [np.array([c, mu]) for c in (5, 20, 100) for mu in (0.3, 0.8, 1.3)]
        values, _, rms = fit_scipy(weighted, -fx / std, starts, [0.01, 0.01], [1e9, 5])
        found[f"{path.stem} cpa2"], found[f"{path.stem} mu"] = map(float, values)
        found[f"{path.stem} rmse"] = float(np.sqrt(np.mean((force(*values) + fx) ** 2)))
        found[f"{path.stem} chi2/dof"] = rms**2 * len(fx) / (len(fx) - 2)
    return found


if __name__ == "__main__":
    for key, value in reference().items():
        print(f"{key:28s} {value:.7g}")
