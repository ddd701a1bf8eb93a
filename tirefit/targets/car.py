"""The car that a parameter file describes: its axles, their tires and static loads."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from tirefit.data.vehicle import Vehicle
from tirefit.door import read_toml
from tirefit.results import InputProblem, UsageError
from tirefit.settings import parse_settings
from tirefit.targets.tire import Tire

_NO_LOG = {"time": "t", "x": "x", "y": "y", "yaw": "yaw"}
"""Columns of a vehicle.toml that describes a car and no log."""

_MEANING = {
    "h_cg": "height of the centre of gravity [m]", "wheel_radius": "tire radius [m]",
}  # fmt: skip


class Axle(NamedTuple):
    """A tire in its place.

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

    def named(self, line: str) -> str:
        """A sentence with the name of the axle before it."""
        return f"{self.name}: {line}" if self.name else line


def vehicle_of(path: str | Path, target: str, needs: Sequence[str]) -> Vehicle:
    """The car of a ``vehicle.toml``; it needs no ``[columns]`` here.

    Raises:
        UsageError: the file is wrong, or lacks a key of ``needs``; all of them.
    """
    content = read_toml(path)
    content.setdefault("columns", _NO_LOG)
    vehicle = parse_settings(Vehicle, content, str(path))
    missing = [key for key in needs if getattr(vehicle, key) is None]
    if missing:
        raise UsageError([
            InputProblem(
                f"missing key {key!r}, which {target} needs",
                f"add {key} = ..., {_MEANING[key]}", str(path),
            )
            for key in missing
        ])  # fmt: skip
    return vehicle


def axles_of(
    target: str, count: int, tires: Mapping[str, Tire], vehicle: Vehicle | None
) -> tuple[Axle, ...]:
    """The axles that a target has parameters for.

    Args:
        count: tires of the target, 1 or 2.
        tires: by axle; under the empty name for all wheels.

    Raises:
        UsageError: two tires for a target with one; one axle for a target with two.
    """
    if count == 1:
        if len(tires) > 1:
            reason = f"{target} has one tire for all wheels in a file"
            remedy = "give one of --front and --rear; export the other to its own file"
            raise UsageError(InputProblem(reason, remedy))
        return tuple(_placed(name, tire, vehicle) for name, tire in tires.items())
    if "" in tires:
        tires = {"front": tires[""], "rear": tires[""]}
        note = "one tire was given: front and rear are alike"
        both = [_placed(name, tire, vehicle) for name, tire in tires.items()]
        return tuple(one._replace(notes=(*one.notes, note)) for one in both)
    if len(tires) < 2:
        given = next(iter(tires))
        other = "rear" if given == "front" else "front"
        reason = f"{target} has a tire for each axle, and only the {given} one is given"
        remedy = f"give --{other} as well, or one tire without --{given} for both axles"
        raise UsageError(InputProblem(reason, remedy))
    return tuple(_placed(name, tires[name], vehicle) for name in ("front", "rear"))


def _placed(name: str, tire: Tire, vehicle: Vehicle | None) -> Axle:
    """The tire with the static load of its place."""
    if vehicle is None:
        return Axle(name, tire)
    arms = {"front": vehicle.l_r, "rear": vehicle.l_f}
    share = arms[name] / vehicle.wheelbase if name else 0.5
    static = vehicle.mass * vehicle.gravity * share
    # Fits of logs have the load of an axle, those of rigs that of one tire.
    wheels = 2 if "fz" in tire.measured and tire.load**2 > static**2 / 2 else 1
    load = static * wheels / 2
    what = "one tire" if wheels == 1 else "an axle of two tires"
    note = f"taken as a fit of {what}, whose static load is {load:.4g} N"
    return Axle(name, replace(tire, load=load), wheels, True, (note,))
