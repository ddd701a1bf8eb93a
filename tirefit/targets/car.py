"""The car that a parameter file describes: its axles, their tires and static loads."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

from tirefit.data.vehicle import Vehicle
from tirefit.door import read_toml
from tirefit.results import InputProblem, UsageError
from tirefit.settings import parse_settings
from tirefit.targets.tire import Tire

_NO_LOG = {"time": "t", "x": "x", "y": "y", "yaw": "yaw"}
"""Columns of a vehicle.toml that describes a car and no log."""

_MEANING = {"h_cg": "height of the centre of gravity [m]", "wheel_radius": "tire radius [m]"}


class Axle(NamedTuple):
    """A tire at its place in the vehicle.

    Attributes:
        name: ``front``, ``rear``, or empty for all wheels.
        tire: the fitted tire; its load is that of its place in the vehicle.
        wheels: wheels whose force and load the fit describes together, 1 or 2.
        static: whether the load of the tire is the static one of a vehicle.
        notes: sentences on what was assumed.
    """

    name: str
    tire: Tire
    wheels: int = 1
    static: bool = False
    notes: tuple[str, ...] = ()

    def named(self, lines: Sequence[str]) -> list[str]:
        """Sentences with the name of the axle in front."""
        return [f"{self.name}: {line}" if self.name else line for line in lines]


def vehicle_of(path, target: str, needs: Sequence[str]) -> Vehicle:
    """The car of a ``vehicle.toml``; it needs no ``[columns]`` here.

    Raises:
        UsageError: the file is wrong, or lacks keys of ``needs``; it lists all of them.
    """
    content = read_toml(path)
    content.setdefault("columns", _NO_LOG)
    vehicle = parse_settings(Vehicle, content, str(path))
    problems = []
    for key in [key for key in needs if getattr(vehicle, key) is None]:
        reason = f"missing key {key!r}, which {target} needs"
        remedy = f"add {key} = ..., {_MEANING[key]}"
        problems.append(InputProblem(reason, remedy, str(path)))
    UsageError.raise_for(problems)
    return vehicle


def axles_of(
    target: str, count: int, tires: Mapping[str, Tire], vehicle: Vehicle | None
) -> tuple[Axle, ...]:
    """The axles for which a target has parameters.

    Args:
        count: tires of the target, 1 or 2.
        tires: by axle; under the empty name for all wheels.

    Raises:
        UsageError: two tires for a target with one; one axle for a target with two.
    """
    alike: tuple[str, ...] = ()
    if count < len(tires):
        reason = f"{target} has one tire for all wheels in a file"
        remedy = "give one of --front and --rear; export the other to its own file"
        raise UsageError(InputProblem(reason, remedy))
    if count == 2 and "" in tires:
        tires = {"front": tires[""], "rear": tires[""]}
        alike = ("one tire was given: front and rear are alike",)
    if len(tires) < count:
        (given,) = tires
        other = "rear" if given == "front" else "front"
        reason = f"{target} has a tire for each axle, and only the {given} one is given"
        remedy = f"give --{other} as well, or one tire without --{given} for both axles"
        raise UsageError(InputProblem(reason, remedy))
    return tuple(_placed(*item, vehicle, alike) for item in tires.items())


def _placed(name: str, tire: Tire, vehicle: Vehicle | None, notes) -> Axle:
    """The tire with the static load at its place."""
    if vehicle is None:
        return Axle(name, tire, notes=notes)
    arms = {"front": vehicle.l_r, "rear": vehicle.l_f}
    share = arms[name] / vehicle.wheelbase if name else 0.5
    static = vehicle.mass * vehicle.gravity * share
    # Fits of logs are at the load of an axle, those of rigs at that of one tire.
    wheels = 2 if "fz" in tire.measured and tire.load**2 > static**2 / 2 else 1
    load = static * wheels / 2
    what = "one tire" if wheels == 1 else "an axle of two tires"
    note = f"assumed to be a fit of {what}, whose static load is {load:.4g} N"
    return Axle(name, replace(tire, load=load), wheels, True, (note, *notes))
