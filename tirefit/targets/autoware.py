"""Parameters of Autoware from what tirefit found of a car's steering: :data:`AUTOWARE`.

Its simulator (simple_planning_simulator, models DELAY_STEER_*) turns the wheels by

    steer' = -(steer + steer_bias - debug_steer_scaling_factor * command) / steer_time_constant

with the command ``steer_time_delay`` ago and no motion within ``steer_dead_band``, and the
car by speed * tan(steer) / wheel_base. Its controller (MPC) compensates ``input_delay`` and
``vehicle_model_steer_tau``. Angles are in rad, left positive, as here.
"""

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import BaseModel, ConfigDict, NonNegativeFloat, PositiveFloat

from tirefit.diagnosis.extended import AnyDocument, read_checked
from tirefit.diagnosis.summary.result import Diagnosis
from tirefit.display import Record
from tirefit.door import RECORD, content_of
from tirefit.fitting.result import TRAJECTORY
from tirefit.results import DataError, InputProblem, UsageError
from tirefit.targets.code import comments
from tirefit.targets.parameters import number, one_line, vehicle_of
from tirefit.vehicle.trajectory import TrajectoryFit


class CarFile(NamedTuple):
    """A target for what was found of a car, without its tires."""

    ending: str  # of the file
    what: str  # description of the file
    holds: str  # what it holds
    write: Any  # (source, vehicle.toml or None, first line) -> text of the file, and notes


class _Key(NamedTuple):
    """The keys of Autoware for a quantity, and when it is written."""

    names: tuple[str, ...]  # keys of Autoware
    most: float  # largest standard error of a value that is written, in the unit of the quantity
    why: str  # reason of this limit
    sign: float = 1.0  # of Autoware's value
    at_least_zero: bool = False  # whether Autoware's value cannot be negative


_STEP = 0.0125, "half a step of Autoware's simulator, 0.025 s"
_LIMIT = 0.005, "a quarter of the MPC's steering_offset_limit, 0.02 rad"
_KEYS = {
    "steering_delay": _Key(("steer_time_delay", "input_delay"), *_STEP, 1.0, True),
    "steering_lag": _Key(("steer_time_constant", "vehicle_model_steer_tau"), *_STEP, 1.0, True),
    "steering_offset": _Key(("steer_bias",), *_LIMIT, -1.0),
    "steering_play": _Key(("steer_dead_band",), *_LIMIT, 1.0, True),
    "steering_ratio": _Key(("debug_steer_scaling_factor",), 0.025, "95 % within 5 %"),
}
"""Quantity -> its keys. The names are those of the parameters that the nodes declare, in
``simulator_model.param.yaml`` and ``mpc.param.yaml``."""
_SURE = 2.0  # a negative value within as many standard errors of zero is written as zero


class _Size(BaseModel):
    model_config = ConfigDict(allow_inf_nan=False)
    value: float
    std: NonNegativeFloat
    unit: str
    identified: bool = True


class _Car(BaseModel):
    wheelbase: PositiveFloat
    wheel_radius: PositiveFloat | None = None


class _Trajectory(BaseModel):
    """The parts of ``trajectory.json`` that are read."""

    logs: list[str]
    converged: bool = True
    parameters: dict[str, _Size]
    vehicle: _Car


_STOPPED = "the fit stopped before it converged: do not rely on these values and their errors"
_SOURCES = "trajectory.json of `tirefit fit --vehicle`, or vehicle_diagnosis.json"


def _found(source: Any, vehicle: Any) -> tuple[str, dict[str, _Size], Any, list[str]]:
    """Where the numbers come from, the quantities with their errors, the car, and notes."""
    if not isinstance(source, str | os.PathLike | TrajectoryFit | Diagnosis):
        reason = "--to autoware describes a car's steering, not a tire"
        raise UsageError(InputProblem(reason, f"give {_SOURCES}"))
    if isinstance(source, Record):
        is_trajectory = isinstance(source, TrajectoryFit)
    else:
        text = content_of(Path(source), RECORD, DataError, f"give {_SOURCES}")
        is_trajectory = TRAJECTORY.encode() in text
    if is_trajectory:
        name, command = "trajectory.json", "tirefit fit --vehicle"
        fit = read_checked(source, _Trajectory, name, command, TRAJECTORY)
        if vehicle is not None:
            reason = "--vehicle together with trajectory.json, which contains the car"
            raise UsageError(InputProblem(reason, "leave it out"))
        where = f"fitted to trajectories of {', '.join(fit.logs)}"
        return where, fit.parameters, fit.vehicle, [] if fit.converged else [_STOPPED]
    document = read_checked(source, AnyDocument, _SOURCES, "tirefit diagnose --vehicle")
    if not document.model.startswith("car on "):
        reason = "a diagnosis of a tire, which shows no steering of a car"
        raise UsageError(InputProblem(reason, f"give {_SOURCES}"))
    if vehicle is None:
        remedy = "give the vehicle.toml that was diagnosed: --vehicle"
        raise UsageError(InputProblem("a diagnosis does not contain the car", remedy))
    car = vehicle_of(vehicle, "autoware", ())
    sizes = {
        whole.partition(": ")[0]: _Size(**size.model_dump())
        for whole, size in document.amplitudes.items()
    }
    # The amplitudes are changes of what vehicle.toml states.
    stated = {"steering_delay": car.steering.delay if car.steering else 0.0, "steering_ratio": 1.0}
    for key, value in stated.items():
        if key in sizes:
            sizes[key].value += value
    return f"named by the diagnosis of {document.data.name}", sizes, car, []


def _real(value: float) -> str:
    """A number that ROS reads as a double: with a decimal point."""
    text = number(value)
    return text if "." in text else f"{text}.0"


def _lines(sizes: Mapping[str, _Size], notes: list[str]) -> Iterator[str]:
    """Lines of the parameters; what is not written is added to the notes."""
    for name, key in _KEYS.items():
        names = f"{', '.join(key.names)}: not written"
        if name not in sizes:
            notes.append(f"{names}, as no {name} was estimated")
            continue
        size = sizes[name]
        value = key.sign * size.value
        stated = f"{value:.4g} +- {size.std:.2g} {size.unit.removeprefix('-')}".strip()
        if not size.identified:
            notes.append(f"{names}: {stated}: the logs do not determine it")
        elif not size.std <= key.most:
            limit = f"its standard error is above {key.most:g} ({key.why})"
            notes.append(f"{names}: {stated}: {limit}")
        elif key.at_least_zero and value < -_SURE * size.std:
            notes.append(f"{names}: {stated}: less than zero, which Autoware does not have")
        else:
            if key.at_least_zero and value < 0:
                value, stated = 0.0, f"{stated}; zero, as Autoware has no negative one"
            yield from (f"    {written}: {_real(value)}  # {stated}" for written in key.names)


def _autoware(source: Any, vehicle: Any, first: str) -> tuple[str, tuple[str, ...]]:
    """The text of the parameter file, and notes."""
    where, sizes, car, notes = _found(source, vehicle)
    lines = [f"    wheel_base: {_real(car.wheelbase)}  # m, stated in vehicle.toml, not estimated"]
    if car.wheel_radius:
        lines.append(f"    wheel_radius: {_real(car.wheel_radius)}  # m, likewise")
    lines += _lines(sizes, notes)
    if "steering_lag" not in sizes and "steering_delay" in sizes:
        notes.append(
            "the delay includes that of a lag: set steer_time_constant to the least of the"
            " simulator, 0.03, or the lag counts twice"
        )
    notes.append("the simulator's car has no tire slip: it turns by speed tan(steer) / wheel_base")
    above = one_line([first, f"car: {where}; value +- standard error", *notes])
    text = "\n".join([comments(above), "/**:", "  ros__parameters:", *lines, ""])
    return text, tuple(notes)


AUTOWARE = CarFile(
    ".yaml",
    "ROS parameters of Autoware's planning simulator, vehicle_info and MPC, from"
    " trajectory.json of `fit --vehicle`, or vehicle_diagnosis.json with --vehicle",
    "steering delay, lag, offset, ratio and play whose standard errors allow it; wheelbase",
    _autoware,
)
