"""Logs and sweeps with a known truth: :func:`simulate`."""

from dataclasses import fields
from typing import Any

import numpy as np

from tirefit.fitting.problem.build import find_model
from tirefit.models import MODELS, TireInputs, forces
from tirefit.params import check_names, check_values, with_values
from tirefit.precision import require_x64
from tirefit.results import UsageError
from tirefit.sim.braking import SimulatedLog, simulate_braking
from tirefit.sim.drive import simulate_drive
from tirefit.sim.settings import KINDS, Sweeps


def simulate_rig(how: Sweeps) -> SimulatedLog:
    """Sweep the slip upward in even steps, once at every load and speed.

    Returns:
        Measured and true time, sigma_x or alpha, fz, v, and the fx, or fy and mz, of the model.
        The noise of the moment is that of the forces at a lever of 0.1 m.
    """
    slip = how.largest * np.arange(1, how.points + 1) / how.points
    grid = np.meshgrid(how.load, how.speed, slip, indexing="ij")
    fz, v, slip = (part.ravel() for part in grid)
    n = len(slip)
    name, force_names = ("alpha", ("fy", "mz")) if how.lateral else ("sigma_x", ("fx",))
    time = np.arange(n) / how.rate
    inputs = TireInputs(**{name: slip}, fz=fz, v=v, time=time)
    tire = with_values(MODELS[how.model], how.values)
    made = forces(tire, inputs, np.arange(n) // how.points)._asdict()
    felt = {k: np.asarray(made[k]) for k in force_names if made[k] is not None}
    truth = {"time": time, name: slip, **felt, "fz": fz, "v": v}
    random = np.random.default_rng(how.seed)
    seen = {name: slip + how.slip_std * random.standard_normal(n)}
    for key, force in felt.items():
        size = how.force_std * fz * (0.1 if key == "mz" else 1.0)
        seen[key] = force + size * random.standard_normal(n)
    return SimulatedLog(truth | seen, truth)


def simulate(kind: str = "braking", **settings: Any) -> SimulatedLog:
    """Simulate a log or sweeps that ``fit`` and ``estimate`` read.

    Args:
        kind: ``braking``: a wheel with saw-tooth brake torque, S section 5.1; ``drive``:
            a car on a winding road; ``rig``: slip sweeps of any model.
        settings: fields of :class:`~tirefit.sim.settings.Braking`,
            :class:`~tirefit.sim.settings.Drive` or
            :class:`~tirefit.sim.settings.Sweeps`, the options of the command.

    Returns:
        The measured and the true columns, braking positive, in SI units.

    Raises:
        UsageError: unknown kinds or settings, or numbers out of their limits; it lists all of them.

    Example:
        >>> log = simulate("rig", model="brush", values={"mu": 0.8}, points=50)
        >>> len(log.columns["fx"])
        50
    """
    require_x64("simulate")
    check_names("simulation", [kind], KINDS)
    if settings:
        names = [field.name for field in fields(KINDS[kind])]
        check_names(f"{kind} setting", list(settings), names)
    how = KINDS[kind](**settings)
    UsageError.raise_for(how.problems())
    if kind == "rig":
        check_values(find_model(how.model), how.model, how.values)
        return simulate_rig(how)
    return simulate_braking(how) if kind == "braking" else simulate_drive(how)
