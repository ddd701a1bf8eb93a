"""Settings of the simulations with their meaning, unit and limits.

They are plain dataclasses, so the command line can show its options without JAX.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

from tirefit.results import InputProblem

PEAK, STIFFNESS, LOAD = 0.98, 5e5, 27e3
"""D [-], C_x [N] and F_z [N] of S section 5; S does not print the load: it is derived."""
TIRES = ("magic-formula", "lugre")
"""Tires of the wheel: that of S section 5, and the transient LuGre tire."""
_FRICTION = (0.05, 5.0)
_MOST_ROWS = 10_000_000  # these need some GB of memory
Drop = tuple[float, float] | None


def _of(default: Any, meaning: str, low: float = 0.0, high: float = math.inf) -> Any:
    """A field with its meaning, and the smallest and largest value of a number."""
    about = {"meaning": meaning, "limits": (low, high)}
    if isinstance(default, dict):
        return field(default_factory=dict, metadata=about)
    return field(default=default, metadata=about)


class Settings:
    """Base of the settings of all simulations."""

    @property
    def rows(self) -> float:
        """Number of rows that are simulated."""
        raise NotImplementedError

    def problems(self) -> list[InputProblem]:
        """The problems: numbers out of their limits, an unknown tire."""
        numbers: list[tuple[Any, ...]] = []  # (name, value, least, largest)
        for setting in fields(self):  # type: ignore[arg-type]
            value, ends = getattr(self, setting.name), setting.metadata["limits"]
            if setting.name == "drop" and value is not None:
                latest = self.rows / self.rate  # type: ignore[attr-defined]
                numbers.append(("time of the drop", value[0], 0.0, latest))
                numbers.append(("friction of the drop", value[1], *_FRICTION))
            for each in value if isinstance(value, list | tuple) else (value,):
                if setting.name != "drop" and isinstance(each, int | float):
                    numbers.append((setting.name, each, *ends))
        numbers.append(("number of rows", self.rows, 1.0, _MOST_ROWS))
        faults = [
            InputProblem(f"{name} {value:g} is out of range", f"{low:g} to {high:g}")
            for name, value, low, high in numbers
            if not low <= value <= high
        ]
        if getattr(self, "tire", TIRES[0]) not in TIRES:
            reason = f"there is no tire {self.tire!r}"  # type: ignore[attr-defined]
            faults.append(InputProblem(reason, " or ".join(TIRES)))
        return faults


@dataclass(frozen=True)
class Braking(Settings):
    """Simulate the log of a wheel that is braked in saw-teeth. Defaults are those of S
    section 5.1; values that it does not state are those of a truck wheel, at the sample
    rate of a brake controller."""

    amplitude: float = _of(0.75, "largest brake torque over that of the friction peak", 0.01, 2.0)
    teeth: int = _of(5, "number of saw-teeth of the torque", 1)
    period: float = _of(2.0, "period of a saw-tooth [s]", 0.1, 1e4)
    rate: float = _of(100.0, "rows per second", 1.0)
    speed: float = _of(20.0, "vehicle speed, constant [m/s]", 1.0, 1e3)
    load: float = _of(LOAD, "wheel load, constant [N]", 1.0, 1e9)
    friction: float = _of(PEAK, "largest steady force over the load", *_FRICTION)
    tire: str = _of("magic-formula", "tire model: magic-formula or lugre")
    drop: Drop = _of(None, "time [s] of a change of friction, and the new friction")
    radius: float = _of(0.5, "effective rolling radius [m]", 0.01, 10.0)
    inertia: float = _of(15.0, "moment of inertia of the wheel [kg m2]", 1e-3, 1e5)
    slip_variance: float = _of(0.2e-4, "variance of the noise of the slip sigma", 0.0, 1.0)
    force_variance: float = _of(0.2e-2, "variance of the noise of force / load", 0.0, 1.0)
    seed: int = _of(0, "seed of the noise", 0, 2**32 - 1)

    @property
    def rows(self) -> float:
        return self.teeth * self.period * self.rate


@dataclass(frozen=True)
class Drive(Settings):
    """Simulate the log of a car on a winding road. It can follow a bend of up to about
    0.75 of the smallest friction, less while braking."""

    duration: float = _of(30.0, "duration of the drive [s]", 0.1, 1e4)
    rate: float = _of(50.0, "rows per second", 1.0)
    speed: float = _of(25.0, "speed that the driver keeps [m/s]", 1.0, 100.0)
    bend: float = _of(0.6, "largest lateral acceleration over mu g", 0.0, 1.0)
    bend_period: float = _of(5.0, "period of the road's curvature [s]", 0.5, 1e3)
    brake: float = _of(0.0, "largest deceleration over mu g, in saw-teeth", 0.0, 2.0)
    brake_period: float = _of(4.0, "period of the saw-teeth [s]", 0.5, 1e3)
    friction: float = _of(0.9, "friction coefficient of the road", *_FRICTION)
    drop: Drop = _of(None, "time [s] of a change of friction, and the new friction")
    gps_std: float = _of(0.02, "noise of positions [m]", 0.0, 1e3)
    speed_std: float = _of(0.03, "noise of the speed [m/s]", 0.0, 1e3)
    heading_std: float = _of(0.002, "noise of the heading [rad]", 0.0, 10.0)
    gyro_std: float = _of(0.002, "noise of yaw and roll rate [rad/s]", 0.0, 10.0)
    acceleration_std: float = _of(0.05, "noise of accelerations [m/s2]", 0.0, 1e3)
    omega_std: float = _of(0.05, "noise of wheel speeds [rad/s]", 0.0, 1e3)
    torque_std: float = _of(10.0, "noise of torques [N m]", 0.0, 1e6)
    seed: int = _of(0, "seed of the noise", 0, 2**32 - 1)

    @property
    def rows(self) -> float:
        return self.duration * self.rate


@dataclass(frozen=True)
class Sweeps(Settings):
    """Sweep the slip upward in even steps, once at every load and speed."""

    model: str = _of("brush", "a model of `tirefit models`")
    values: Mapping[str, float] = _of({}, "parameter of the model (repeat for several)")
    load: Sequence[float] = _of((4000.0,), "wheel load [N] (repeat for several)", 1e-3, 1e9)
    speed: Sequence[float] = _of((20.0,), "speed [m/s] (repeat for several)", 1e-3, 1e3)
    largest: float = _of(0.2, "largest slip sigma, or slip angle [rad]", 1e-4, 1.5)
    points: int = _of(100, "rows of a sweep", 2)
    lateral: bool = _of(False, "sweep the slip angle alpha instead of sigma")
    rate: float = _of(100.0, "rows per second", 1e-3, 1e9)
    slip_std: float = _of(0.0, "noise of the slip [- or rad]", 0.0, 1.0)
    force_std: float = _of(0.01, "noise of the forces over the load", 0.0, 1.0)
    seed: int = _of(0, "seed of the noise", 0, 2**32 - 1)

    @property
    def rows(self) -> float:
        return self.points * len(self.load) * len(self.speed)


KINDS: dict[str, Any] = {"braking": Braking, "drive": Drive, "rig": Sweeps}
"""Kind of simulation -> its settings."""
