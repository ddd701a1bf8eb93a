"""The request for a braking manoeuvre: its checks, and the plant made from it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from tirefit.arrays import Tree
from tirefit.models import AbstractTire, TireInputs, modelled
from tirefit.online.vehicle import GRAVITY
from tirefit.params import check_names, parameter_values
from tirefit.results import InputProblem, UsageError
from tirefit.sim.brake import Plant, Sensors
from tirefit.sim.brake_vehicle import (
    Hydraulics,
    Vehicle,
    four_wheels,
    on_road,
    quarter_car,
    road_of,
    wheel_slips,
)

VEHICLES = {"car": four_wheels, "quarter": quarter_car}
"""Name of a vehicle -> its constructor."""

_LEAST_SHARE = 0.4  # share of the smallest friction that the default time limit assumes
_GRACE = 3.0
_FASTEST, _SHARPEST = 100.0, 0.6


@dataclass(frozen=True)
class Request:
    """A manoeuvre: tire, road, speed, vehicle."""

    tire: AbstractTire  # with its parameter values
    tire_name: str  # for messages
    road: str = "mu=0.3"  # as in :data:`tirefit.sim.brake_vehicle.ROADS`
    speed: float = 15.0  # [m/s] at which the braking begins
    vehicle: str = "car"  # a key of :data:`VEHICLES`
    steer: float = 0.0  # angle [rad] of the front wheels, to the left; constant
    hydraulics: Hydraulics = field(default_factory=Hydraulics)  # with the driver's demand
    sensors: Sensors = field(default_factory=Sensors)  # with the unevenness of the road
    time_limit: float | None = None  # [s]; None: from speed and friction

    @property
    def limit(self) -> float:
        """Time limit [s]."""
        if self.time_limit is not None:
            return self.time_limit
        road = road_of(self.road)
        least = min(*road.before.tolist(), *road.after.tolist())
        return round(self.speed / (GRAVITY * _LEAST_SHARE * least) + _GRACE, 2)

    def samples(self, rate: float) -> int:
        """Number of samples until the time limit at a rate [1/s]."""
        return math.ceil(self.limit * rate)

    def about(self) -> dict[str, Any]:
        """The settings of the request, for the summary."""
        return {
            "tire": self.tire_name,
            "parameters": {key: float(value) for key, value in parameter_values(self.tire).items()},
            "road": self.road,
            "speed": self.speed,
            "vehicle": self.vehicle,
            "steer": self.steer,
            "time_limit": self.limit,
            "hydraulics": self.hydraulics._asdict(),
            "sensors": self.sensors._asdict(),
        }


def arrays(tree: Tree) -> Tree:
    """The same record with arrays of floats as leaves."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, float), tree)


def plant_of(request: Request) -> Plant:
    """The plant of a checked request; its leaves are arrays."""
    vehicle: Vehicle = arrays(VEHICLES[request.vehicle]())
    road = arrays(road_of(request.road))
    tire = on_road(
        arrays(request.tire),
        jnp.asarray(request.speed, float),
        jnp.mean(vehicle.fz),
        jnp.concatenate([road.before, road.after]),
    )
    hydraulics = arrays(request.hydraulics)
    return Plant(vehicle, tire, road, hydraulics, jnp.asarray(request.steer, float))


_USUAL_SLOPE = (3.0, 150.0)
"""Slope of the braking force at zero slip, over the load; 10 to 40 for car tires."""

_LONGEST = 300.0  # longest manoeuvre [s]

_NUMBERS = {
    "demand": (1e3, 5e7, "Pa"),
    "ramp": (1e3, 1e10, "Pa/s"),
    "rise": (1e3, 1e10, "Pa/s"),
    "fall": (1e3, 1e10, "Pa/s"),
    "lag": (1e-3, 1.0, "s"),
    "delay": (0.0, 0.5, "s"),
    "speed_std": (0.0, 10.0, "m/s"),
    "speed_step": (0.0, 10.0, "m/s"),
    "deceleration_std": (0.0, 100.0, "m/s2"),
    "pressure_std": (0.0, 1e7, "Pa"),
    "road_std": (0.0, 10.0, "of the load"),
    "road_corner": (1e-2, 1e3, "Hz"),
}
"""Smallest and largest value of each number of hydraulics, sensors and road; unit."""


def known_to_controllers(request: Request) -> dict[str, Any]:
    """The data of the car that a controller may use, by name: radius [m], inertia
    [kg m2], brake_gain [N m/Pa], fz [N], arrays (w,); rise, fall [Pa/s] and delay [s] of
    the hydraulics; stiffness [N]: slope of F_x over kappa at zero slip, (w,)."""
    car = VEHICLES[request.vehicle]()
    tire, speed = request.tire, request.speed

    def force(sigma: Array, fz: Array) -> Array:
        return jnp.asarray(tire(TireInputs(sigma, 0.0, fz, speed)).fx)

    slope = jax.vmap(jax.grad(force), (None, 0))(1e-6, jnp.asarray(car.fz))
    wheels = ("radius", "inertia", "brake_gain", "fz", "steered")
    valves = ("rise", "fall", "delay", "lag")
    known = {name: getattr(car, name) for name in wheels}
    known |= {name: getattr(request.hydraulics, name) for name in valves}
    return known | {"stiffness": np.asarray(slope), "ahead": car.x}


def doubts(request: Request) -> list[str]:
    """A warning if the tire seems to be of another size than the car."""
    known = known_to_controllers(request)
    slope = float(np.max(known["stiffness"] / known["fz"]))
    low, high = _USUAL_SLOPE
    if low <= slope <= high:
        return []
    load = float(np.max(known["fz"]))
    return [
        f"the slope of the braking force of {request.tire_name} over the slip is {slope:.3g}"
        f" times the load of {load:.0f} N; car tires have {low:g} to {high:g}: the tire is"
        " probably for another load; use one for this car, or change it with --set"
    ]


def check(request: Request) -> None:
    """Raises UsageError with all problems of a request."""
    problems = _tire_problems(request)
    limits = [
        ("--speed", request.speed, 0.5, _FASTEST, "m/s"),
        ("--steer", request.steer, -_SHARPEST, _SHARPEST, "rad"),
    ]
    if request.time_limit is not None:
        limits.append(("--time-limit", request.time_limit, 0.1, _LONGEST, "s"))
    for record in (request.hydraulics, request.sensors):
        for name, value in record._asdict().items():
            limits.append((f"--plant {name}", value, *_NUMBERS[name]))
    for option, value, low, high, unit in limits:
        if not low <= value <= high:
            reason = f"{option} {value:g} is out of range"
            problems.append(InputProblem(reason, f"{low:g} to {high:g} {unit}"))
    road = road_of(request.road)
    if request.vehicle not in VEHICLES:
        reason = f"there is no vehicle {request.vehicle!r}"
        problems.append(InputProblem(reason, f"choose one of {', '.join(VEHICLES)}"))
    elif request.vehicle == "quarter" and (request.steer or road.split):
        what = "steer" if request.steer else "have a left and a right"
        reason = f"a quarter car cannot {what}"
        problems.append(InputProblem(reason, "use the whole car: --vehicle car"))
    UsageError.raise_for(problems)


def _tire_problems(request: Request) -> list[InputProblem]:
    tire, name = request.tire, request.tire_name
    if "fx" not in modelled(tire):
        remedy = "choose a model with F_x, such as brush-m"
        return [InputProblem(f"{name} has no braking force", remedy)]
    if tire.transient or "time" in tire.needs:
        remedy = "choose its steady-state model, such as brush for brush-relaxation"
        return [InputProblem(f"{name} is transient: its force lags behind the slip", remedy)]
    turns = request.steer or road_of(request.road).split
    if turns and not _combines(tire, request.speed):
        reason = f"{name} has no combined slip, which a turning car needs"
        remedy = "choose a model that has it: brush-m, lugre or magic-formula-combined"
        return [InputProblem(reason, remedy)]
    return []


def _combines(tire: AbstractTire, speed: float) -> bool:
    """Whether a slip angle reduces the braking force and causes a lateral force."""
    inputs = [TireInputs(0.2, alpha, 4e3, speed) for alpha in (0.0, 0.3)]
    straight, aside = (tire(each) for each in inputs)
    if straight.fx is None or aside.fx is None or aside.fy is None:
        return False
    return float(aside.fx) < 0.99 * float(straight.fx)


def with_numbers(request: Request, values: Mapping[str, float]) -> Request:
    """The request with changed numbers of its hydraulics and sensors, by name.

    Raises:
        UsageError: a name that neither of them has.
    """
    if values:
        check_names("--plant quantity", list(values), (*Hydraulics._fields, *Sensors._fields))
    hydraulics = {k: v for k, v in values.items() if k in Hydraulics._fields}
    sensors = {k: v for k, v in values.items() if k in Sensors._fields}
    return replace(
        request,
        hydraulics=request.hydraulics._replace(**hydraulics),
        sensors=request.sensors._replace(**sensors),
    )


def tire_curve(
    request: Request, most: float, points: int = 200
) -> dict[float, tuple[np.ndarray, np.ndarray]]:
    """Friction of the road -> (kappa, F_x / F_z), each (points,).

    Args:
        request: its tire and roads are used, at the static load of the first wheel and
            half the initial speed.
        most: largest kappa.
    """
    plant = plant_of(request)
    kappa = jnp.linspace(0.0, min(most, 0.99), points)
    speed = 0.5 * jnp.asarray(request.speed, float)
    fz = plant.vehicle.fz[0]
    curves = {}
    for mu in np.unique(np.r_[plant.road.before, plant.road.after]):

        def one(k: Array, mu: float = mu) -> Array:
            slips = wheel_slips(speed[None], jnp.zeros(1), speed * (1 - k)[None])
            fx, _ = plant.tire.forces(jnp.full(1, mu), slips, fz[None])
            return fx[0] / fz

        curves[float(mu)] = (np.asarray(kappa), np.asarray(jax.vmap(one)(kappa)))
    return curves
