"""Simulate sweeps of a test rig: forces of a model over slip, load and speed, with noise."""

from collections.abc import Mapping, Sequence

import numpy as np

from tirefit.models import MODELS, TireInputs, forces
from tirefit.params import with_values
from tirefit.sim.braking import SimulatedLog


def simulate_rig(
    model: str = "brush",
    values: Mapping[str, float] | None = None,
    *,
    load: Sequence[float] = (4000.0,),
    speed: Sequence[float] = (20.0,),
    largest: float = 0.2,
    points: int = 100,
    lateral: bool = False,
    rate: float = 100.0,
    slip_std: float = 0.0,
    force_std: float = 0.01,
    seed: int = 0,
) -> SimulatedLog:
    """Sweep the slip upward in even steps, once at every load and speed.

    Args:
        model: a key of ``tirefit.MODELS``; ``values``: of its parameters.
        load: F_z [N]; ``speed``: v [m/s].
        largest: last slip sigma_x [-], or slip angle [rad] where ``lateral``.
        points: rows of one sweep; the first row is one step above zero slip.
        rate: rows per second.
        slip_std: noise of the slip [- or rad]; ``force_std``: of the forces over F_z,
            and of the moment over F_z 0.1 m.
        seed: of the noise.

    Returns:
        Measured and true time, sigma_x, alpha, fz, v, and the fx, fy, mz of the model.
    """
    tire = with_values(MODELS[model], values or {})
    slip = largest * np.arange(1, points + 1) / points
    fz, v, slip = (part.ravel() for part in np.meshgrid(load, speed, slip, indexing="ij"))
    n = len(slip)
    name, force_names = ("alpha", ("fy", "mz")) if lateral else ("sigma_x", ("fx",))
    time = np.arange(n) / rate
    inputs = TireInputs(**{name: slip}, fz=fz, v=v, time=time)
    run = np.arange(n) // points
    made = forces(tire, inputs, run)._asdict()
    felt = {k: np.asarray(made[k]) for k in force_names if made[k] is not None}
    truth = {"time": time, name: slip, **felt, "fz": fz, "v": v}
    random = np.random.default_rng(seed)
    seen = {name: slip + slip_std * random.standard_normal(n)}
    for key, force in felt.items():
        size = force_std * fz * (0.1 if key == "mz" else 1.0)
        seen[key] = force + size * random.standard_normal(n)
    return SimulatedLog(truth | seen, truth)
