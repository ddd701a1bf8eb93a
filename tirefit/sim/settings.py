"""Settings of the simulations: their meaning, unit and limits, each in one place.

Plain dataclasses, so that the command line has its options without JAX.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

from tirefit.results import InputProblem

PEAK, STIFFNESS, LOAD = 0.98, 5e5, 27e3
"""D [-], C_x [N] and F_z [N] of S section 5; the load is not printed, but follows."""
TIRES = ("magic-formula", "lugre")
"""Tires of the wheel: that of S section 5, and LuGre with its bristles in time."""
_FRICTION = (0.05, 5.0)
_MOST_ROWS = 10_000_000  # what all of them need some GB of memory for
Drop = tuple[float, float] | None


def _of(default, meaning: str, low: float = 0.0, high: float = math.inf) -> Any:
    """A field with its meaning, and the smallest and largest value of a number."""
    about = {"meaning": meaning, "limits": (low, high)}
    if isinstance(default, dict):
        return field(default_factory=dict, metadata=about)
    return field(default=default, metadata=about)


class Settings:
    """What the settings of all simulations can do."""

    @property
    def rows(self) -> float:
        """Number of rows that are simulated."""
        raise NotImplementedError

    def _checked(self) -> Iterator[tuple[str, float, float, float]]:
        """(name, value, least, largest) of every number."""
        for one in fields(self):  # type: ignore[arg-type]
            value, (low, high) = getattr(self, one.name), one.metadata["limits"]
            if one.name == "drop" and value is not None:
                yield "time of the drop", value[0], 0.0, self.rows / self.rate  # type: ignore[attr-defined]
                yield "friction of the drop", value[1], *_FRICTION
            for each in value if isinstance(value, list | tuple) else (value,):
                if one.name != "drop" and isinstance(each, int | float):
                    yield one.name, each, low, high
        yield "number of rows", self.rows, 1.0, _MOST_ROWS

    def problems(self) -> list[InputProblem]:
        """Every number out of its limits, and a tire that there is not."""
        found = [
            InputProblem(f"{name} {value:g} is out of range", f"{low:g} to {high:g}")
            for name, value, low, high in self._checked()
            if not low <= value <= high
        ]
        if getattr(self, "tire", TIRES[0]) not in TIRES:
            reason = f"there is no tire {self.tire!r}"  # type: ignore[attr-defined]
            found.append(InputProblem(reason, " or ".join(TIRES)))
        return found


@dataclass(frozen=True)
class Braking(Settings):
    """How a wheel is braked and measured; the values are those of S section 5.1, and
    where it says nothing those of a truck wheel sampled as a brake controller does."""

    amplitude: float = _of(0.75, "largest torque over that of the peak", 0.01, 2.0)
    teeth: int = _of(5, "saw-teeth of the torque", 1)
    period: float = _of(2.0, "of a saw-tooth [s]", 0.1, 1e4)
    rate: float = _of(100.0, "rows a second", 1.0)
    speed: float = _of(20.0, "of the vehicle, constant [m/s]", 1.0, 1e3)
    load: float = _of(LOAD, "of the wheel, constant [N]", 1.0, 1e9)
    friction: float = _of(PEAK, "largest steady force over the load", *_FRICTION)
    tire: str = _of("magic-formula", "magic-formula or lugre")
    drop: Drop = _of(None, "time [s], and the friction from then on")
    radius: float = _of(0.5, "effective rolling radius [m]", 0.01, 10.0)
    inertia: float = _of(15.0, "of the wheel [kg m2]", 1e-3, 1e5)
    slip_variance: float = _of(0.2e-4, "of the noise on the slip sigma", 0.0, 1.0)
    force_variance: float = _of(0.2e-2, "of the noise on the force / load", 0.0, 1.0)
    seed: int = _of(0, "of the noise", 0, 2**32 - 1)

    @property
    def rows(self) -> float:
        return self.teeth * self.period * self.rate


@dataclass(frozen=True)
class Drive(Settings):
    """How a car is driven and measured. The driver holds a ``bend`` up to some 0.75,
    less with brakes, of the least friction."""

    duration: float = _of(30.0, "of the drive [s]", 0.1, 1e4)
    rate: float = _of(50.0, "rows a second", 1.0)
    speed: float = _of(25.0, "that the driver keeps [m/s]", 1.0, 100.0)
    bend: float = _of(0.6, "largest lateral acceleration over mu g", 0.0, 1.0)
    bend_period: float = _of(5.0, "of the road's curvature [s]", 0.5, 1e3)
    brake: float = _of(0.0, "largest deceleration over mu g, in saw-teeth", 0.0, 2.0)
    brake_period: float = _of(4.0, "of a braking [s]", 0.5, 1e3)
    friction: float = _of(0.9, "of the road", *_FRICTION)
    drop: Drop = _of(None, "time [s], and the friction from then on")
    gps_std: float = _of(0.02, "noise of positions [m]", 0.0, 1e3)
    speed_std: float = _of(0.03, "noise of the speed [m/s]", 0.0, 1e3)
    heading_std: float = _of(0.002, "noise of the heading [rad]", 0.0, 10.0)
    gyro_std: float = _of(0.002, "noise of yaw and roll rate [rad/s]", 0.0, 10.0)
    acceleration_std: float = _of(0.05, "noise of accelerations [m/s2]", 0.0, 1e3)
    omega_std: float = _of(0.05, "noise of wheel speeds [rad/s]", 0.0, 1e3)
    torque_std: float = _of(10.0, "noise of torques [N m]", 0.0, 1e6)
    seed: int = _of(0, "of the noise", 0, 2**32 - 1)

    @property
    def rows(self) -> float:
        return self.duration * self.rate


@dataclass(frozen=True)
class Sweeps(Settings):
    """Slip swept up evenly at every load and speed, one sweep after the other."""

    model: str = _of("brush", "model of `tirefit models`")
    values: Mapping[str, float] = _of({}, "parameters of the model")
    load: Sequence[float] = _of((4000.0,), "[N], one or several", 1e-3, 1e9)
    speed: Sequence[float] = _of((20.0,), "[m/s], one or several", 1e-3, 1e3)
    largest: float = _of(0.2, "last slip sigma, or slip angle [rad]", 1e-4, 1.5)
    points: int = _of(100, "rows of a sweep", 2)
    lateral: bool = _of(False, "sweep the slip angle alpha")
    rate: float = _of(100.0, "rows a second", 1e-3, 1e9)
    slip_std: float = _of(0.0, "noise of the slip [- or rad]", 0.0, 1.0)
    force_std: float = _of(0.01, "noise of the forces over the load", 0.0, 1.0)
    seed: int = _of(0, "of the noise", 0, 2**32 - 1)

    @property
    def rows(self) -> float:
        return self.points * len(self.load) * len(self.speed)


KINDS: dict[str, Any] = {"braking": Braking, "drive": Drive, "rig": Sweeps}
"""Kind of simulation -> its settings."""
