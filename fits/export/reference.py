"""The independent numbers of the case: brush fits and the drive around the obstacle by
SciPy, with the closed formula of the brush, without tirefit and CasADi."""

import csv
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from fits.formulas import brush

HERE = Path(__file__).parent
MASS, INERTIA, AHEAD, SPEED, ASIDE = 5.1, 0.12, 0.165, 4.0, 0.5
LOAD = MASS * 9.81 / 2
FAR = 4.7  # standard deviations


def fitted(name: str) -> np.ndarray:
    """c_p a^2 [N] and mu of the brush S(12), with equal weights."""
    with (HERE / f"{name}.csv").open() as file:
        next(file)  # it states the convention
        rows = list(csv.DictReader(file))
    alpha, fy, fz = (np.array([float(row[name]) for row in rows]) for name in ("alpha", "fy", "fz"))

    def missed(z):
        return np.sign(alpha) * brush(np.tan(np.abs(alpha)), fz, 0.0, *z) - fy

    # A few rows are outliers: the car was lifted or hit something.
    rows, z = np.ones(len(alpha), bool), [50.0, 0.7]
    for _ in range(5):
        z = least_squares(lambda z, rows=rows: missed(z)[rows], z).x
        left = missed(z)
        rows = np.abs(left) < FAR * np.std(left[rows])
    return z


def driven(front, rear, time, steering) -> np.ndarray:
    """Final position (x, y) [m] for a steering angle over time, on two brushes: c_p
    a^2 [N] and mu of each axle."""

    def force(alpha, z):
        return -np.sign(alpha) * brush(np.tan(abs(alpha)), LOAD, SPEED, *z)

    def slope(now, state):
        _, _, heading, sideways, turn = state
        delta = np.interp(now, time, steering)
        f = force(np.arctan2(sideways + AHEAD * turn, SPEED) - delta, front)
        r = force(np.arctan2(sideways - AHEAD * turn, SPEED), rear)
        return [
            SPEED * np.cos(heading) - sideways * np.sin(heading),
            SPEED * np.sin(heading) + sideways * np.cos(heading),
            turn,
            (f + r) / MASS - SPEED * turn,
            AHEAD * (f - r) / INERTIA,
        ]

    found = solve_ivp(slope, (0, time[-1]), np.zeros(5), rtol=1e-9, atol=1e-10, max_step=0.01)
    return found.y[:2, -1]


def reference() -> dict[str, float]:
    found = {}
    for tires in ("a", "d"):
        axles = {axle: fitted(f"{tires}_{axle}") for axle in ("front", "rear")}
        for axle, (stiffness, grip) in axles.items():
            found[f"{tires}_{axle} cpa2"], found[f"{tires}_{axle} mu"] = stiffness, grip
        grip = min(grip for _, grip in axles.values())
        # A point mass that friction moves aside: y = mu g t^2 / 2.
        found[f"{tires}: at least"] = SPEED * np.sqrt(2 * ASIDE / (grip * 9.81))
    return found
