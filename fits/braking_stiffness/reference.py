"""Independent numbers: ``python -m fits.braking_stiffness.reference``.

NumPy and SciPy alone: a front wheel on snow under constant pressure, force from the
balance of the wheel that decelerates with its car, slip by inverting the brush S(12),
stiffness by differences of that curve at a given speed of the car, O(2).
"""

import numpy as np
from scipy.optimize import brentq

from fits.formulas import brush

PRESSURES = (1e6, 2e6, 3e6)
LOAD = 1500 * 9.81 * 1.4 / 2.6 / 2
RADIUS, INERTIA, GAIN = 0.3, 1.2, 1.35e-4
STIFFNESS = 2e4
"""c_p a^2 [N] on snow, a third of that of a car's tire on asphalt."""
FRICTION = 0.37
SPEED = 20.0
FROM, UNTIL = 1.0, 3.0
"""Time [s] over which all is averaged."""


def stiffness(pressure: float, time, friction: float = FRICTION):
    """(k [N s/m], kappa, speed of the car [m/s]) at times (n,) [s] after the start of
    braking at :data:`SPEED`, without the rise of the pressure."""
    mass = LOAD / 9.81
    # The wheel decelerates with the car: approximately F (1 + J / (r^2 m)) = T / r.
    force = GAIN * pressure / RADIUS / (1 + INERTIA / (RADIUS**2 * mass))

    def gap(sigma):
        return float(brush(sigma, LOAD, 0.0, STIFFNESS, friction)) - force

    sigma = brentq(gap, 0.0, 1.5 * friction * LOAD / STIFFNESS)
    v = SPEED - force / mass * np.asarray(time, float)
    wheel, step = v / (1 + sigma), 1e-4
    ahead, behind = (
        brush(v / (wheel - move) - 1, LOAD, 0.0, STIFFNESS, friction) for move in (step, -step)
    )
    return (ahead - behind) / (2 * step), sigma / (1 + sigma), v


def reference() -> dict[str, float]:
    """Mean stiffness, its break frequency k r^2 / (2 pi J), and slip, by pressure."""
    time, numbers = np.linspace(FROM, UNTIL, 401), {}
    for pressure in PRESSURES:
        name = f"{pressure / 1e6:.0f} MPa"
        k, kappa, _ = stiffness(pressure, time)
        numbers[f"{name}: k"] = float(np.mean(k))
        numbers[f"{name}: break frequency"] = float(np.mean(k) * RADIUS**2 / (2 * np.pi * INERTIA))
        numbers[f"{name}: slip"] = float(kappa)
    return numbers


if __name__ == "__main__":
    for name, value in reference().items():
        print(f"{name:25s} {value:.7g}")
