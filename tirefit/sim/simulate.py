"""Logs and sweeps with a known truth: :func:`simulate`."""

from dataclasses import fields
from typing import Any

from tirefit.fitting.problem import find_model
from tirefit.params import check_names, check_values
from tirefit.precision import require_x64
from tirefit.results import InputProblem, UsageError, did_you_mean
from tirefit.sim.braking import SimulatedLog, simulate_braking
from tirefit.sim.drive import simulate_drive
from tirefit.sim.rig import simulate_rig
from tirefit.sim.settings import KINDS

_MADE: dict[str, Any] = {
    "braking": simulate_braking,
    "drive": simulate_drive,
    "rig": lambda how: simulate_rig(**vars(how)),
}


def simulate(kind: str = "braking", **settings) -> SimulatedLog:
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
    known = [one.name for one in fields(KINDS[kind])]
    unknown = [
        InputProblem(
            f"{kind} has no setting {name!r}",
            f"{did_you_mean(name, known)}it has {', '.join(known)}",
        )
        for name in settings
        if name not in known
    ]
    UsageError.raise_for(unknown)
    how = KINDS[kind](**settings)
    UsageError.raise_for(how.problems())
    if kind == "rig":
        check_values(find_model(how.model), how.model, how.values)
    return _MADE[kind](how)
