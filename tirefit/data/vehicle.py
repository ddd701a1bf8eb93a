"""The vehicle and its log, as ``vehicle.toml`` declares them: :class:`Vehicle`.

::

    mass = 1.580                   # kg
    l_f = 0.0805                   # m, front axle ahead of the centre of gravity
    l_r = 0.0930                   # m, rear axle behind it
    yaw_inertia = 0.004806         # kg m2
    tracked_point = [0.115, -0.01] # m, ahead of the rear axle and to the left

    [columns]                      # pose: time, x, y, yaw
    time = "vicon time"            # or rates: time, v_x, v_y, yaw_rate, a_y
    x = "vicon x"

    [units]                        # of any column that is not in SI units
    yaw = "deg"

    [filter]                       # cutoff Hz, order, sample_rate Hz, max_gap s
    [keep]                         # v_min m/s, a_y_max m/s2, active, margin s
    [steering]                     # command and angle [rad]: the map, point by point

The log's axes are those of ISO 8855: x forward, y left, yaw counter-clockwise.
"""

import math
import tomllib
from pathlib import Path
from typing import Annotated

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    NonNegativeFloat,
    PositiveFloat,
    ValidationError,
    model_validator,
)

from tirefit.results import Problem, UsageError

__all__ = ["UNITS", "Columns", "Filter", "Keep", "Steering", "Vehicle", "load_vehicle"]

_TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
_ANGLE = {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180}
_ANGLE_RATE = {"rad/s": 1.0, "deg/s": math.pi / 180}
_SPEED = {"m/s": 1.0, "mm/s": 1e-3, "km/h": 1 / 3.6}
_ACCELERATION = {"m/s2": 1.0, "m/s^2": 1.0, "g": 9.80665}

UNITS = {
    "time": _TIME,
    "x": _LENGTH,
    "y": _LENGTH,
    "yaw": _ANGLE,
    "v_x": _SPEED,
    "v_y": _SPEED,
    "yaw_rate": _ANGLE_RATE,
    "a_y": _ACCELERATION,
}
"""Quantity of a log -> its units and their factors to SI."""

POSE = ("x", "y", "yaw")
RATES = ("v_x", "v_y", "yaw_rate", "a_y")
_AXLE_TOLERANCE = 0.01
"""Axle masses and CG position are measured apart: they may differ by this, relative."""


class _Section(BaseModel):
    model_config = ConfigDict(
        extra="forbid", frozen=True, strict=True, allow_inf_nan=False
    )


class Columns(_Section):
    """Headers of the log's columns; pose (x, y, yaw) or rates, not both."""

    time: str
    x: str | None = None
    y: str | None = None
    yaw: str | None = None
    v_x: str | None = None
    v_y: str | None = None
    yaw_rate: str | None = None
    a_y: str | None = None
    steering: str | None = None

    @model_validator(mode="after")
    def _one_route(self):
        given = [name for name in POSE + RATES if getattr(self, name) is not None]
        if set(given) not in (set(POSE), set(RATES)):
            raise ValueError(
                f"name the columns {', '.join(POSE)} (a pose log) or"
                f" {', '.join(RATES)} (a log of rates); named are"
                f" {', '.join(given) or 'none of them'}"
            )
        return self

    @property
    def motion(self) -> tuple[str, ...]:
        """The quantities the motion is derived from."""
        return POSE if self.yaw is not None else RATES


class Filter(_Section):
    """Resampling and the zero-phase low-pass.

    Attributes:
        cutoff: Cutoff of one Butterworth pass [Hz]; the filter runs both ways, so the
            gain here is 1/2.
        order: Order of one pass.
        sample_rate: Rate of the uniform grid [Hz].
        max_gap: Longest time between two samples that is interpolated [s]; None takes
            3.5 of the log's own periods.
    """

    cutoff: PositiveFloat = 5.0
    order: Annotated[int, Field(ge=1, le=8)] = 2
    sample_rate: PositiveFloat = 100.0
    max_gap: PositiveFloat | None = None

    @model_validator(mode="after")
    def _resolved(self):
        if self.sample_rate < 5 * self.cutoff:
            raise ValueError(
                f"sample_rate {self.sample_rate:g} Hz is below 5 x cutoff"
                f" ({5 * self.cutoff:g} Hz): central differences would lose the band"
            )
        if self.max_gap is not None and self.max_gap > 1 / self.cutoff:
            raise ValueError(
                f"max_gap {self.max_gap:g} s is above 1/cutoff ({1 / self.cutoff:g} s):"
                " what happened in such a gap would be invented"
            )
        return self

    @property
    def bandwidth(self) -> float:
        """Frequency [Hz] at which both passes together have a gain of -3 dB."""
        return self.cutoff * (math.sqrt(2) - 1) ** (1 / (2 * self.order))

    @property
    def settling(self) -> float:
        """Time [s] after which an edge's transient has died to about 0.2 %."""
        return 1.5 * max(1.0, self.order / 2) / self.cutoff


class Keep(_Section):
    """Which derived samples are kept.

    Attributes:
        v_min: Lowest forward speed of the centre of gravity [m/s].
        a_y_max: Largest lateral acceleration [m/s2]; beyond it the track has glitched.
        active: Header of a column that must equal ``active_value``, if any.
        active_value: Its value while the vehicle is driven.
        margin: Time dropped beside every edge, gap and glitch [s]; None takes the
            settling time of the filter.
    """

    v_min: PositiveFloat
    a_y_max: PositiveFloat | None = None
    active: str | None = None
    active_value: float = 1.0
    margin: NonNegativeFloat | None = None


class Steering(_Section):
    """Road wheel angle [rad], left positive, at increasing steering commands."""

    command: Annotated[list[float], Field(min_length=2)]
    angle: Annotated[list[float], Field(min_length=2)]

    @model_validator(mode="after")
    def _is_map(self):
        if len(self.command) != len(self.angle):
            raise ValueError("command and angle have different lengths")
        pairs = zip(self.command, self.command[1:], strict=False)
        if any(right <= left for left, right in pairs):
            raise ValueError("command does not increase")
        if max(abs(angle) for angle in self.angle) >= math.pi / 2:
            raise ValueError("an angle is 90 deg or more: angles are in rad")
        return self


class Vehicle(_Section):
    """A single-track vehicle and how its log is read; SI units, ISO 8855 axes.

    Attributes:
        mass: Total mass [kg].
        l_f: Distance of the front axle ahead of the centre of gravity [m].
        l_r: Distance of the rear axle behind the centre of gravity [m].
        mass_front: Mass on the front axle [kg]; a check, or instead of l_f and l_r.
        mass_rear: Mass on the rear axle [kg]; likewise.
        wheelbase: l_f + l_r [m]; needed where the axle masses replace l_f and l_r.
        yaw_inertia: Yaw moment of inertia about the centre of gravity [kg m2].
        tracked_point: The point the log describes: ahead of the rear axle and to the
            left of the centre line [m]; None for the centre of gravity.
        yaw_offset: Heading of the car minus the logged yaw [rad]: it is added to the
            logged yaw, which lowers alpha by as much; pose logs only.
        h_cg: Height of the centre of gravity [m]; None keeps the load static.
        gravity: [m/s2].
    """

    mass: PositiveFloat
    l_f: PositiveFloat
    l_r: PositiveFloat
    mass_front: PositiveFloat | None = None
    mass_rear: PositiveFloat | None = None
    wheelbase: PositiveFloat
    yaw_inertia: PositiveFloat
    tracked_point: Annotated[list[float], Field(min_length=2, max_length=2)] | None = (
        None
    )
    yaw_offset: float = 0.0
    h_cg: NonNegativeFloat | None = None
    gravity: PositiveFloat = 9.80665
    columns: Columns
    units: dict[str, str] = {}
    filter: Filter = Filter()
    keep: Keep
    steering: Steering | None = None

    @model_validator(mode="before")
    @classmethod
    def _complete_geometry(cls, given):
        """Fill in what follows from the rest; what is missing is reported later."""
        given = dict(given)
        try:
            front, rear = given.get("mass_front"), given.get("mass_rear")
            if front and rear:
                given.setdefault("mass", front + rear)
                if "wheelbase" in given:
                    given.setdefault("l_f", given["wheelbase"] * rear / (front + rear))
                    given.setdefault("l_r", given["wheelbase"] * front / (front + rear))
            if "l_f" in given and "l_r" in given:
                given.setdefault("wheelbase", given["l_f"] + given["l_r"])
        except TypeError:
            pass  # a wrong type is reported by its own field
        return given

    @model_validator(mode="after")
    def _consistent(self):
        problems = [
            *self._geometry_problems(),
            *self._unit_problems(),
            *self._column_problems(),
        ]
        if problems:
            raise ValueError("; ".join(problems))
        return self

    def _geometry_problems(self) -> list[str]:
        def differ(one, other):
            return abs(one - other) > _AXLE_TOLERANCE * abs(other)

        problems = []
        if differ(self.wheelbase, self.l_f + self.l_r):
            problems.append(
                f"wheelbase {self.wheelbase:g} m is not l_f + l_r ="
                f" {self.l_f + self.l_r:g} m"
            )
        for name, arm in (("mass_front", self.l_r), ("mass_rear", self.l_f)):
            stated = getattr(self, name)
            implied = self.mass * arm / self.wheelbase
            if stated is not None and differ(stated, implied):
                problems.append(
                    f"{name} {stated:g} kg contradicts mass, l_f and l_r, which give"
                    f" {implied:.4g} kg"
                )
        return problems

    def _unit_problems(self) -> list[str]:
        problems = []
        for name, unit in self.units.items():
            if name not in UNITS:
                problems.append(f"[units] {name} is not one of {', '.join(UNITS)}")
            elif unit not in UNITS[name]:
                problems.append(
                    f"[units] {name} = {unit!r} is not one of {', '.join(UNITS[name])}"
                )
        return problems

    def _column_problems(self) -> list[str]:
        problems = []
        if (self.steering is None) != (self.columns.steering is None):
            problems.append("[steering] and columns.steering need each other")
        if self.yaw_offset and self.columns.motion == RATES:
            problems.append("yaw_offset applies to a pose log only")
        return problems

    @property
    def cg_from_tracked(self) -> tuple[float, float]:
        """The centre of gravity seen from the tracked point [m]: ahead, left."""
        if self.tracked_point is None:
            return 0.0, 0.0
        return self.l_r - self.tracked_point[0], -self.tracked_point[1]

    @property
    def margin(self) -> float:
        """Time dropped beside every edge, gap and glitch [s]."""
        given = self.keep.margin
        return self.filter.settling if given is None else given

    def factor(self, quantity: str) -> float:
        """Factor from the log's unit of ``quantity`` to SI."""
        return UNITS[quantity][self.units[quantity]] if quantity in self.units else 1.0


def load_vehicle(path: str | Path) -> Vehicle:
    """Read ``vehicle.toml``.

    Raises:
        UsageError: If the file is missing, is not TOML or does not describe a
            vehicle; holds every problem found.
    """
    path = Path(path)
    try:
        given = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(
            Problem(
                f"cannot be read: {error.strerror}",
                "give the path of a vehicle.toml",
                str(path),
            )
        ) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UsageError(
            Problem(f"is not TOML: {error}", "correct the syntax", str(path))
        ) from error
    try:
        return Vehicle.model_validate(given)
    except ValidationError as error:
        problems = [_problem(detail, str(path)) for detail in error.errors()]
        raise UsageError(problems) from error


def _problem(detail, file: str) -> Problem:
    """One of pydantic's errors in our words."""
    key = ".".join(str(part) for part in detail["loc"])
    name = key.rpartition(".")[2]
    if detail["type"] == "extra_forbidden":
        section = Vehicle
        for part in detail["loc"][:-1]:
            section = section.model_fields[part].annotation
            section = getattr(section, "__args__", (section,))[0]
        known = ", ".join(section.model_fields)
        return Problem(f"unknown key {key!r}", f"known keys: {known}", file)
    if detail["type"] == "missing":
        remedy = (
            "give l_f and l_r, or mass_front, mass_rear and wheelbase"
            if name in ("l_f", "l_r", "wheelbase")
            else f"add {name!r}"
        )
        return Problem(f"missing key {key!r}", remedy, file)
    reason = detail["msg"].removeprefix("Value error, ")
    if detail["type"] != "value_error":
        reason = f"{reason}, not {detail['input']!r}"
    return Problem(f"{key}: {reason}" if key else reason, "correct it", file)
