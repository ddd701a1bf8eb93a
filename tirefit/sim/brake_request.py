"""The request for a braking manoeuvre: its checks, and the plant made from it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
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
from tirefit.sim import brake_vehicle
from tirefit.sim.brake import Plant, Sensors

VEHICLES = {"car": brake_vehicle.four_wheels, "quarter": brake_vehicle.quarter_car}
"""Name of a vehicle -> its constructor."""


@dataclass(frozen=True)
class Request:
    """A manoeuvre: tire, road, speed, vehicle."""

    tire: AbstractTire  # with its parameter values
    tire_name: str  # for messages
    road: str = "mu=0.3"  # as in :data:`tirefit.sim.brake_vehicle.ROADS`
    speed: float = 15.0  # [m/s] at which the braking begins
    vehicle: str = "car"  # a key of :data:`VEHICLES`
    steer: float = 0.0  # angle [rad] of the front wheels, to the left; constant
    hydraulics: brake_vehicle.Hydraulics = brake_vehicle.Hydraulics()  # with the driver's demand
    sensors: Sensors = Sensors()  # with the unevenness of the road
    time_limit: float | None = None  # [s]; None: from speed and friction

    @property
    def limit(self) -> float:
        """Time limit [s]."""
        if self.time_limit is not None:
            return self.time_limit
        road = brake_vehicle.road_of(self.road)
        least = min(*road.before.tolist(), *road.after.tolist())
        # 40 % of the smallest friction is used, and 3 s more.
        return round(self.speed / (GRAVITY * 0.4 * least) + 3.0, 2)

    def samples(self, rate: float) -> int:
        """Number of samples until the time limit at a rate [1/s]."""
        return math.ceil(self.limit * rate)

    def about(self) -> dict[str, Any]:
        """The settings of the request, for the summary."""
        stated = {name: getattr(self, name) for name in ("road", "speed", "vehicle", "steer")}
        return {
            "tire": self.tire_name,
            "parameters": {key: float(value) for key, value in parameter_values(self.tire).items()},
            **stated,
            "time_limit": self.limit,
            "hydraulics": self.hydraulics._asdict(),
            "sensors": self.sensors._asdict(),
        }


def arrays(tree: Tree) -> Tree:
    """The same record with arrays of floats as leaves."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, float), tree)


def plant_of(request: Request) -> Plant:
    """The plant of a checked request; its leaves are arrays."""
    vehicle: brake_vehicle.Vehicle = arrays(VEHICLES[request.vehicle]())
    given: Any = brake_vehicle.road_of(request.road), request.speed, request.steer
    road, speed, steer = arrays(given)
    frictions = jnp.concatenate([road.before, road.after])
    tire = brake_vehicle.on_road(arrays(request.tire), speed, jnp.mean(vehicle.fz), frictions)
    return Plant(vehicle, tire, road, arrays(request.hydraulics), steer)


_OF_CAR = ("radius", "inertia", "brake_gain", "fz", "steered")
_OF_VALVES = ("rise", "fall", "delay", "lag")


def known_to_controllers(request: Request) -> dict[str, Any]:
    """The data of the car that a controller may use, by name: radius [m], inertia [kg m2],
    brake_gain [N m/Pa], fz [N], steered, ahead [m], arrays (w,); rise, fall [Pa/s], lag and delay
    [s] of the hydraulics; stiffness [N]: slope of F_x over kappa at zero slip, (w,)."""
    car = VEHICLES[request.vehicle]()

    def force(sigma: Array, fz: Array) -> Array:
        return jnp.asarray(request.tire(TireInputs(sigma, 0.0, fz, request.speed)).fx)

    slope = jax.vmap(jax.grad(force), (None, 0))(1e-6, jnp.asarray(car.fz))
    known = {name: getattr(car, name) for name in _OF_CAR}
    known |= {name: getattr(request.hydraulics, name) for name in _OF_VALVES}
    return known | {"stiffness": np.asarray(slope), "ahead": car.x}


def doubts(request: Request) -> list[str]:
    """A warning if the tire seems to be of another size than the car."""
    known = known_to_controllers(request)
    slope = float(np.max(known["stiffness"] / known["fz"]))
    if 3.0 <= slope <= 150.0:
        return []
    what = f"the slope of the braking force of {request.tire_name} over the slip"
    return [f"{what} is {slope:.3g} times the load, of car tires 10 to 40: use one for this load"]


def check(request: Request) -> None:
    """Raises UsageError with all problems of a request."""
    problems = _tire_problems(request)
    limits = [
        ("--speed", request.speed, 0.5, 100.0, "m/s"),
        ("--steer", request.steer, -0.6, 0.6, "rad"),
    ]
    if request.time_limit is not None:
        limits.append(("--time-limit", request.time_limit, 0.1, 300.0, "s"))
    for name, value in (request.hydraulics._asdict() | request.sensors._asdict()).items():
        # No delay and no noise are possible.
        least = 0.0 if name == "delay" or name.endswith(("_std", "_step")) else 1e-3
        most, unit = (0.5, "s") if name == "delay" else (1e10, "in SI units (Pa, Pa/s, s, m/s)")
        limits.append((f"--plant {name}", value, least, most, unit))
    for option, value, low, high, unit in limits:
        if not low <= value <= high:
            reason = f"{option} {value:g} is out of range"
            problems.append(InputProblem(reason, f"{low:g} to {high:g} {unit}"))
    road = brake_vehicle.road_of(request.road)
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
    if not (request.steer or brake_vehicle.road_of(request.road).split):  # it does not turn
        return []
    # Whether a slip angle reduces the braking force and causes a lateral force.
    straight, aside = (tire(TireInputs(0.2, alpha, 4e3, request.speed)) for alpha in (0.0, 0.3))
    weaker = float(jnp.asarray(aside.fx)) < 0.99 * float(jnp.asarray(straight.fx))
    if aside.fy is not None and weaker:
        return []
    reason = f"{name} has no combined slip, which a turning car needs"
    remedy = "choose a model that has it: brush-m, lugre or magic-formula-combined"
    return [InputProblem(reason, remedy)]


def with_numbers(request: Request, values: Mapping[str, float]) -> Request:
    """The request with changed numbers of its hydraulics and sensors, by name.

    Raises:
        UsageError: a name that neither of them has.
    """
    if values:
        check_names(
            "--plant quantity", list(values), (*brake_vehicle.Hydraulics._fields, *Sensors._fields)
        )
    records: tuple[Any, ...] = request.hydraulics, request.sensors
    hydraulics, sensors = (
        record._replace(**{k: v for k, v in values.items() if k in record._fields})
        for record in records
    )
    return replace(request, hydraulics=hydraulics, sensors=sensors)


def tire_curve(
    request: Request, most: float, points: int = 200
) -> dict[float, tuple[np.ndarray, np.ndarray]]:
    """Friction of the road -> (kappa, F_x / F_z), (points,) each, to the kappa ``most``: of the
    tire at the static load of the first wheel and half the initial speed."""
    plant = plant_of(request)
    kappa = jnp.linspace(0.0, min(most, 0.99), points)
    speed, fz = 0.5 * jnp.full(points, float(request.speed)), jnp.full(points, plant.vehicle.fz[0])
    slips = brake_vehicle.wheel_slips(speed, jnp.zeros(points), speed * (1 - kappa))
    curves = {}
    for mu in np.unique(np.r_[plant.road.before, plant.road.after]):
        fx, _ = plant.tire.forces(jnp.full(points, mu), slips, fz)
        curves[float(mu)] = np.asarray(kappa), np.asarray(fx / fz)
    return curves
