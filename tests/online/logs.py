"""Logs of a brush tire braked in saw-teeth, computed by NumPy alone."""

import numpy as np

from tirefit.online.methods import METHODS

OF_A_WHEEL = [
    name
    for name, kind in METHODS.items()
    if set(kind.method.inputs)
    <= {"sigma_x", "fx", "fz", "fy", "mz", "v", "omega", "brake_pressure"}
    and "xbs" not in kind.method.parameters
]
"""Methods that these logs suit: no road shakes these wheels."""

LOAD = 27e3
CPA2 = 2.4e5


def brush(slip, cpa2, mu, fz=LOAD):
    """S(12), factored."""
    stuck = np.maximum(1 - 2 * cpa2 * slip / (3 * mu * fz), 0.0)
    return mu * fz * (1 - stuck**3)


def log(n=3000, mu=0.9, largest=0.06, force_noise=0.03, slip_noise=0.0, seed=0, drop=None):
    """Columns of 100 Hz; ``mu`` becomes drop[1] at the time drop[0]."""
    random = np.random.default_rng(seed)
    time = np.arange(n) / 100
    slip = largest * ((time % 2) / 2)
    friction = np.full(n, mu)
    if drop is not None:
        friction[time >= drop[0]] = drop[1]
    force = brush(slip, CPA2, friction) + force_noise * LOAD * random.normal(size=n)
    seen = slip + slip_noise * random.normal(size=n)
    return {
        "time": time,
        "sigma_x": seen,
        "fx": force,
        "fz": np.full(n, LOAD),
        "v": np.full(n, 20.0),
        "omega": 40 / (1 + seen),
        **side(slip, friction, random),
        "brake_pressure": brush(slip, CPA2, friction) / 0.04,
    }


def side(slip, mu, random):
    """Lateral force and moment at tan(alpha) = slip, S section 3.6 as printed."""
    theta = np.minimum(2 * CPA2 * slip / (3 * LOAD), mu)
    force = LOAD * theta / mu**2 * (3 * mu**2 - 3 * mu * theta + theta**2)
    moment = -LOAD * 0.1 * theta / mu**3 * (mu - theta) ** 3
    noise = random.normal(size=(2, len(slip)))
    return {"fy": force + 0.01 * LOAD * noise[0], "mz": moment + 5e-5 * LOAD * noise[1]}
