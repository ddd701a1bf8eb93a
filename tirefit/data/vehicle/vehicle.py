"""The vehicle and its log, as ``vehicle.toml`` declares them: :class:`Vehicle`.

VEHICLE.md lists its keys, units and defaults, with an example.

The axes of the log are those of ISO 8855: x forward, y left, yaw counter-clockwise.
"""

import json
import math
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, NonNegativeFloat, PositiveFloat, model_validator

from tirefit.data.units import Unit, known_unit, units_of
from tirefit.door import read_toml
from tirefit.results import InputProblem, UsageError
from tirefit.settings import Section, parse_settings
from tirefit.slip import GRAVITY

QUANTITIES = {
    "time": "time",
    "x": "length",
    "y": "length",
    "yaw": "angle",
    "v_x": "speed",
    "v_y": "speed",
    "yaw_rate": "angular speed",
    "a_y": "acceleration",
    "a_x": "acceleration",
}
"""Quantity of a log -> its dimension, whose units :mod:`tirefit.data.units` lists."""

POSE = ("x", "y", "yaw")
RATES = ("v_x", "v_y", "yaw_rate")
CHECKS = (*POSE, *RATES, "a_y", "a_x")
"""Quantities that are compared with the motion if they are not needed for it."""

_FROUDE = 0.5
"""Default of the lowest speed that is kept, over sqrt(g L): 0.65 m/s for a model car with
a wheelbase of 0.17 m, 2.6 m/s for a car with 2.7 m. Below, noise dominates alpha."""


class Columns(Section):
    """Headers of the columns of the log: all of a pose (x, y, yaw) or of the rates (v_x,
    v_y, yaw_rate). A log of rates uses a_y and a_x if they are named. All other named
    columns are compared with these. If both are named, the pose is used.

    Attributes:
        yaw: a heading, or a component of a quaternion.
        run: names or numbers of runs, which are treated separately.
    """

    time: str
    x: str | None = None
    y: str | None = None
    yaw: str | None = None
    v_x: str | None = None
    v_y: str | None = None
    yaw_rate: str | None = None
    a_y: str | None = None
    a_x: str | None = None
    steering: str | None = None
    run: str | None = None

    def contradictions(self) -> Iterator[InputProblem]:
        given = [name for name in CHECKS if getattr(self, name) is not None]
        names: dict[str, list[str]] = {}
        for name in ("time", *given, "run"):
            if header := getattr(self, name):
                names.setdefault(header, []).append(f"columns.{name}")
        for header, keys in names.items():
            if len(keys) > 1:
                reason = f"{' and '.join(keys)} are the same column {header!r}"
                yield InputProblem(reason, "name the column of each quantity")
        if not (set(POSE) <= set(given) or set(RATES) <= set(given)):
            reason = "neither a pose log nor a log of rates: named are"
            remedy = f"name {', '.join(POSE)} (a pose log) or {', '.join(RATES)} (rates;"
            remedy += " a_y as well where it is measured)"
            yield InputProblem(f"{reason} {', '.join(given) or 'none of their columns'}", remedy)

    @property
    def motion(self) -> tuple[str, ...]:
        """The quantities the motion is derived from."""
        if all(getattr(self, name) is not None for name in POSE):
            return POSE
        measured = (name for name in ("a_y", "a_x") if getattr(self, name) is not None)
        return (*RATES, *measured)

    @property
    def a_y_follows(self) -> bool:
        """Whether the lateral acceleration is that of the speeds."""
        return not {*POSE, "a_y"} & {*self.motion}

    @property
    def notes(self) -> tuple[str, ...]:
        """Assumptions that follow from the columns, as sentences."""
        follows = (
            "a_y follows from the speeds (dv_y/dt + v_x r at the centre of gravity, of the"
            " filtered channels): it is not an independent measurement and checks none of them; a"
            " channel that a filter or a model computed is not a measurement"
        )
        return (follows,) if self.a_y_follows else ()

    @property
    def beyond(self) -> tuple[str, ...]:
        """The named quantities that are not needed for the motion."""
        rest = (name for name in CHECKS if name not in self.motion)
        return tuple(name for name in rest if getattr(self, name) is not None)


class Filter(Section):
    """Resampling and the zero-phase low-pass.

    Attributes:
        cutoff: Cutoff of one Butterworth pass [Hz]; the filter runs both ways, so the
            gain here is 1/2.
        sample_rate: Rate of the uniform grid [Hz].
        max_gap: Longest time between two samples that is interpolated [s]; None takes
            3.5 of the log's own periods.
    """

    cutoff: Annotated[float, Field(ge=1e-3, le=1e4)] = 5.0
    order: Annotated[int, Field(ge=1, le=8)] = 2  # of one pass
    sample_rate: Annotated[float, Field(gt=0, le=1e5)] = 100.0
    max_gap: PositiveFloat | None = None

    def contradictions(self) -> Iterator[InputProblem]:
        if self.sample_rate < 5 * self.cutoff:
            reason = f"sample_rate {self.sample_rate:g} Hz is below 5 x cutoff"
            reason += f" ({5 * self.cutoff:g} Hz): central differences would lose the band"
            yield InputProblem(reason, "raise sample_rate or lower cutoff")
        if self.max_gap is not None and self.max_gap > 1 / self.cutoff:
            reason = f"max_gap {self.max_gap:g} s is above 1/cutoff ({1 / self.cutoff:g} s):"
            reason += " the motion in such a gap is unknown"
            yield InputProblem(reason, "lower max_gap or cutoff")

    @property
    def bandwidth(self) -> float:
        """Frequency [Hz] at which both passes together have a gain of -3 dB."""
        return self.cutoff * (math.sqrt(2) - 1) ** (1 / (2 * self.order))

    @property
    def settling(self) -> float:
        """Time [s] after which the transient of an edge has fallen to about 0.2 %."""
        return 1.5 * max(1.0, self.order / 2) / self.cutoff


class Keep(Section):
    """Which derived samples are kept.

    Attributes:
        v_min: Lowest forward speed of the centre of gravity [m/s]; None takes
            sqrt(g L) / 2, with L the wheelbase.
        a_y_max: Largest lateral acceleration [m/s2]; a larger one is a glitch.
        margin: Time dropped next to every edge, gap and glitch [s]; None takes the
            settling time of the filter.
    """

    v_min: PositiveFloat | None = None
    a_y_max: PositiveFloat | None = None
    active: str | None = None  # header of a column that must equal ``active_value``
    active_value: float = 1.0  # while the vehicle is driven
    margin: NonNegativeFloat | None = None


class Steering(Section):
    """Road wheel angle [rad], left positive, at increasing steering commands.

    Attributes:
        delay: Time [s] by which the road wheels follow the logged command.
    """

    command: Annotated[list[float], Field(min_length=2)]
    angle: Annotated[list[float], Field(min_length=2)]
    delay: Annotated[float, Field(ge=-1, le=1)] = 0.0

    def contradictions(self) -> Iterator[InputProblem]:
        if len(self.command) != len(self.angle):
            reason = f"command has {len(self.command)} points, angle {len(self.angle)}"
            yield InputProblem(reason, "give one angle for each command")
        pairs = zip(self.command, self.command[1:], strict=False)
        if any(right <= left for left, right in pairs):
            yield InputProblem("command does not increase", "list the points in order")
        if max(abs(angle) for angle in self.angle) >= math.pi / 2:
            yield InputProblem("an angle is 90 deg or more", "give the angles in rad")


_SHORTEST, _LONGEST = 0.005, 50.0
"""Lengths [m] that a vehicle can have: below those of scale models, above those of lorries."""

_Arm = Annotated[
    float,
    Field(
        ge=_SHORTEST,
        le=_LONGEST,
        description="give l_f and l_r, or mass_front, mass_rear and wheelbase",
    ),
]
_Coordinate = Annotated[float, Field(ge=-_LONGEST, le=_LONGEST)]


class Vehicle(Section):
    """A single-track vehicle and how its log is read; SI units, ISO 8855 axes.

    Attributes:
        tracked_point: The point the log describes: ahead of the rear axle and to the
            left of the centre line [m]; None for the centre of gravity.
        yaw_offset: Heading of the car minus the logged yaw [rad]: it is added to the
            logged yaw, which lowers alpha by as much; pose logs only.
        sideslip_offset: Sideslip of the car minus the logged one [rad], if a sensor is
            mounted at an angle: the logged speeds are rotated by it, which raises
            alpha by as much; logs of rates only.
        driven: Axles that drive and brake; with it, derived files have fx of the axle.
        rear_share: Share of the longitudinal force on the rear axle of an all-wheel
            drive vehicle [-]; None assumes half, with a large uncertainty.
        clock: Standard error of the time between channels of the log [s]; those of a
            pose are from one instrument.
    """

    mass: PositiveFloat  # total [kg]
    l_f: _Arm  # of the front axle ahead of the centre of gravity [m]
    l_r: _Arm  # of the rear axle behind the centre of gravity [m]
    mass_front: PositiveFloat | None = None  # [kg]; a check, or instead of l_f, l_r
    mass_rear: PositiveFloat | None = None  # likewise
    wheelbase: _Arm  # l_f + l_r [m]; needed if axle masses replace l_f and l_r
    yaw_inertia: PositiveFloat  # about the centre of gravity [kg m2]
    tracked_point: Annotated[list[_Coordinate], Field(min_length=2, max_length=2)] | None = None
    yaw_offset: float = 0.0
    sideslip_offset: float = 0.0
    h_cg: Annotated[float, Field(ge=0, le=_LONGEST)] | None = (
        None  # [m]; None keeps the load static
    )
    gravity: PositiveFloat = GRAVITY  # [m/s2]
    driven: Literal["rear", "front", "all"] | None = None
    rear_share: Annotated[float, Field(ge=0, le=1)] | None = None
    drag: NonNegativeFloat | None = None  # over v^2 [kg/m]; None: 0, with a large uncertainty
    wheel_radius: PositiveFloat | None = None  # [m]; wavelengths are compared with it
    clock: PositiveFloat | None = None
    columns: Columns = Field(
        description="add the headers of the log: `tirefit inspect LOG` prints this table"
    )
    units: dict[str, str] = {}
    filter: Filter = Filter()
    keep: Keep = Keep()
    steering: Steering | None = None

    @model_validator(mode="before")
    @classmethod
    def _complete_geometry(cls, given: Any) -> dict[str, Any]:
        """Compute values that follow from others; missing ones are reported later."""
        given = dict(given)

        def positive(*names: str) -> bool:
            values = map(given.get, names)
            return all(type(value) in (int, float) and value > 0 for value in values)

        if positive("mass_front", "mass_rear"):
            front, rear = given["mass_front"], given["mass_rear"]
            given.setdefault("mass", front + rear)
            if positive("wheelbase"):
                given.setdefault("l_f", given["wheelbase"] * rear / (front + rear))
                given.setdefault("l_r", given["wheelbase"] * front / (front + rear))
        if positive("l_f", "l_r"):
            given.setdefault("wheelbase", given["l_f"] + given["l_r"])
        return given

    def contradictions(self) -> Iterator[InputProblem]:
        def differ(value: float, other: float) -> bool:
            # Largest relative difference of axle masses and the position of the centre of gravity,
            # which are measured separately.
            return abs(value - other) > 0.01 * abs(other)

        arms = self.l_f + self.l_r
        if differ(self.wheelbase, arms):
            reason = f"wheelbase {self.wheelbase:g} m is not l_f + l_r = {arms:g} m"
            yield InputProblem(reason, "correct one of them, or leave wheelbase out")
        for name, arm in (("mass_front", self.l_r), ("mass_rear", self.l_f)):
            stated, implied = getattr(self, name), self.mass * arm / self.wheelbase
            if stated is not None and differ(stated, implied):
                reason = f"{name} {stated:g} kg contradicts mass, l_f and l_r, which give"
                remedy = f"correct one of them, or leave {name} out"
                yield InputProblem(f"{reason} {implied:.4g} kg", remedy)
        yield from _unit_problems(self.units, "units.{} = {!r}")
        pose = self.columns.motion == POSE
        if (self.steering is None) != (self.columns.steering is None):
            reason = "[steering] and columns.steering need each other"
            yield InputProblem(reason, "give both, or leave both out")
        if self.rear_share is not None and self.driven != "all":
            reason = 'rear_share applies to driven = "all" only'
            yield InputProblem(reason, "leave it out, or state which axles drive")
        if self.yaw_offset and not pose:
            reason = "yaw_offset applies to a pose log only"
            yield InputProblem(reason, "leave it out: a log of rates has no yaw")
        if self.sideslip_offset and pose:
            reason = "sideslip_offset applies to a log of rates only"
            yield InputProblem(reason, "leave it out; for a pose log, correct yaw_offset")

    def doubts(self) -> tuple[str, ...]:
        """Warnings on numbers that vehicles do not have, usually because of a wrong unit.

        Lengths are compared with the wheelbase, masses with its third power, so that the
        limits apply to cars and to scale models.
        """
        # Ranges of road vehicles, including racing cars (17 kg/m3) and scale models (300).
        compared = (
            ("mass / wheelbase^3", self.mass / self.wheelbase**3, 5.0, 3000.0, " kg/m3"),
            ("yaw_inertia / (mass l_f l_r)", self.inertia_ratio, 0.15, 4.0, ""),
            ("l_f / l_r", self.l_f / self.l_r, 0.2, 5.0, ""),
            ("h_cg / wheelbase", (self.h_cg or 0.0) / self.wheelbase, 0.0, 1.0, ""),
            ("gravity", self.gravity, 9.7, 9.9, " m/s2"),
        )
        return tuple(
            f"{what} = {value:.3g}{unit}, where vehicles have {low:g} to"
            f" {high:g}: check the units of vehicle.toml (kg, m, kg m2)"
            for what, value, low, high, unit in compared
            if not low <= value <= high
        )

    @property
    def inertia_ratio(self) -> float:
        """Yaw inertia over that of the two axle masses at their axles; about 1 for cars."""
        return self.yaw_inertia / (self.mass * self.l_f * self.l_r)

    @property
    def cg_from_tracked(self) -> tuple[float, float]:
        """The centre of gravity seen from the tracked point [m]: ahead, left."""
        if self.tracked_point is None:
            return 0.0, 0.0
        return self.l_r - self.tracked_point[0], -self.tracked_point[1]

    @property
    def margin(self) -> float:
        """Time dropped next to every edge, gap and glitch [s]."""
        return self.filter.settling if self.keep.margin is None else self.keep.margin

    @property
    def v_min(self) -> float:
        """Lowest forward speed that is kept [m/s]."""
        return self.keep.v_min or _FROUDE * math.sqrt(self.gravity * self.wheelbase)


def vehicle_toml(vehicle: Vehicle, note: str) -> str:
    """The text of ``vehicle.toml`` for a vehicle, with a comment above."""
    content = vehicle.model_dump(exclude_defaults=True)
    sections = {k: v for k, v in content.items() if isinstance(v, dict)}
    lines = [f"# {note}"]
    for name, values in {"": content, **sections}.items():
        lines += ["", f"[{name}]"] if name else []
        for key, value in values.items():
            if not isinstance(value, dict):
                lines.append(f"{key} = {json.dumps(value)}")
    return "\n".join(lines) + "\n"


def unit_of(text: str, quantity: str) -> Unit | None:
    """The unit of a quantity of a log, or None if it is not a common one.

    A leading minus (``-rad/s``) declares a channel of opposite sign.
    """
    if text.startswith("-") and len(text) > 1 and quantity != "time":
        unit = unit_of(text[1:], quantity)
        return unit and unit._replace(scale=-unit.scale)
    unit = known_unit(text) if text else None
    return unit if unit and unit.dimension == QUANTITIES[quantity] else None


def _unit_problems(units: Mapping[str, str], how: str) -> Iterator[InputProblem]:
    """Units of unknown quantities, and those that are no unit of their quantity.

    Args:
        how: format of quantity and unit as they are declared.
    """
    for name, text in units.items():
        known: Iterable[str] = QUANTITIES
        stated = how.format(name, text)
        if name in QUANTITIES:
            known = units_of(QUANTITIES[name])
            if unit_of(text, name) is not None:
                continue
        else:
            stated += f", but {name}"
        yield InputProblem(f"{stated} is not one of {', '.join(known)}", "choose one of them")


def load_vehicle(path: str | Path, units: Mapping[str, str] | None = None) -> Vehicle:
    """Read ``vehicle.toml``.

    Args:
        units: Quantity -> unit; overrides units that the file declares.

    Raises:
        UsageError: The file is missing, is not TOML or does not describe a vehicle; it
            lists all problems. Or one of the ``units`` is not known.
    """
    UsageError.raise_for([*_unit_problems(units or {}, "--unit {}={}")])
    content = read_toml(path)
    declared = content.get("units", {})
    if units and isinstance(declared, dict):
        content["units"] = declared | dict(units)
    return parse_settings(Vehicle, content, str(path))
