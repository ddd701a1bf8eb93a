"""Effects that the model of a car may lack: of steering, masses, ground, air, drive, tires
and of the log, as records of :class:`tirefit.diagnosis.effects.Effect`.

An effect changes a :class:`Setting` and may depend on :class:`Samples`.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from tirefit.diagnosis.effects.record import LEAST_FACTOR, Code, Constants, adds, library
from tirefit.vehicle.car import Changes


class Steering(NamedTuple):
    """Changes between the logged steering and the wheels."""

    ratio: Any = 1.0  # wheel angle over that of the map
    offset: Any = 0.0  # added to the wheel angle [rad]
    delay: Any = 0.0  # [s]
    lag: Any = 0.0  # time constant [s]
    play: Any = 0.0  # half of the gap [rad]
    yields: Any = 0.0  # wheel angle lost per g of lateral acceleration [rad]


class Reading(NamedTuple):
    """Errors of the log."""

    sideslip: Any = 0.0  # logged less true [rad]
    yaw_rate: Any = 0.0  # logged less true [rad/s]
    ahead: Any = 0.0  # of the point that the log describes, before the stated one [m]


class Setting(NamedTuple):
    """All quantities that an effect may change; the default has no change."""

    car: Changes = Changes()
    steering: Steering = Steering()
    reading: Reading = Reading()


class Samples(NamedTuple):
    """The quantities on which effects may depend: a number for each sample of a window,
    or one for all."""

    speed: Any  # over its mean
    along: Any  # forward acceleration over g
    across: Any  # acceleration to the left over g
    turn: Any  # yaw rate over speed [1/m]
    time: Any  # -1/2 to 1/2 over all logs
    heading: Any  # [rad], 0 without a pose
    weight: Any  # [N]
    wheelbase: Any  # [m]
    sliding: Any  # (2,) slip above which the front and the rear tire slide


_EACH = ((1.0, 1.0), (1.0, 0.0), (0.0, 1.0))  # both axles, the front axle, the rear axle
_WORDS = ("of both axles", "of the front axle", "of the rear axle")


def _which(constants: Constants, rows: Samples, time: np.ndarray) -> str:
    return _WORDS[_EACH.index(tuple(constants))]


def scaled_axles(setting: Setting, name: str, factors: jax.Array | Sequence[jax.Array]) -> Setting:
    """The setting with a field of front and rear axle multiplied by factors."""
    axles = {}
    for axle, factor in zip(("front", "rear"), factors, strict=True):
        held = getattr(setting.car, axle)
        factor = getattr(held, name) * jnp.maximum(factor, LEAST_FACTOR)
        axles[axle] = held._replace(**{name: factor})
    return setting._replace(car=setting.car._replace(**axles))


def _scales(name: str, term: Callable[..., Any]) -> dict[str, Any]:
    """The code of an effect that scales a number of its axles by 1 + term."""

    def change(setting: Setting, amplitude: Any, constants: Constants, rows: Samples) -> Setting:
        added = term(amplitude, rows)
        return scaled_axles(setting, name, [1 + c * added for c in constants])

    return dict(change=change, which=_which)


def _falls(setting: Setting, amplitude: jax.Array, constants: Constants, rows: Samples) -> Setting:
    axles = {}
    for k, axle in enumerate(("front", "rear")):
        held = getattr(setting.car, axle)
        fall = held.fall + constants[k] * amplitude
        axles[axle] = held._replace(fall=fall, sliding=rows.sliding[k])
    return setting._replace(car=setting.car._replace(**axles))


def _tilt(slope: jax.Array, constants: Constants, rows: Samples) -> jax.Array:
    """Force to the left of a slope of the ground."""
    along, across = constants
    towards = across * jnp.cos(rows.heading) - along * jnp.sin(rows.heading)
    return slope * rows.weight * towards


def _longer(setting: Setting, name: str, by: Any) -> Setting:
    """The setting with a distance of the car longer by a number of metres."""
    return setting._replace(car=setting.car._replace(**{name: getattr(setting.car, name) + by}))


CODE: Code = {
    "steering_ratio": adds("steering.ratio", lambda a, c, rows: a),
    "steering_offset": adds("steering.offset", lambda a, c, rows: a),
    "steering_delay": adds("steering.delay", lambda a, c, rows: a),
    "steering_lag": adds("steering.lag", lambda a, c, rows: a),
    "steering_play": adds("steering.play", lambda a, c, rows: a),
    "compliance_steer": adds("steering.yields", lambda a, c, rows: a),
    "yaw_inertia": adds("car.inertia", lambda a, c, rows: jnp.expm1(a)),
    "centre_of_gravity": lambda setting, a, c, rows: _longer(
        _longer(setting, "l_f", -a * rows.wheelbase), "l_r", a * rows.wheelbase
    ),
    "front_axle": lambda setting, a, c, rows: _longer(setting, "l_f", a * rows.wheelbase),
    "rear_axle": lambda setting, a, c, rows: _longer(setting, "l_r", a * rows.wheelbase),
    "lateral_load_transfer": _scales("friction", lambda a, rows: -a * rows.across**2),
    # The load that moves, over that at rest: height over wheelbase times the acceleration.
    "longitudinal_load_transfer": lambda setting, height, c, rows: scaled_axles(
        setting, "load", (1 - 2 * (height * rows.along), 1 + 2 * (height * rows.along))
    ),
    "aerodynamic_load": _scales("load", lambda a, rows: a * (rows.speed**2 - 1)),
    "friction_speed": _scales("friction", lambda a, rows: -a * (rows.speed - 1)),
    "sliding_friction": dict(change=_falls, which=_which),
    "friction_drift": _scales("friction", lambda a, rows: a * rows.time),
    "relaxation_length": adds("car.relaxation", lambda a, c, rows: a * rows.wheelbase),
    "drive_force": _scales("friction", lambda a, rows: -a * rows.along**2),
    "yaw_resistance": adds(
        "car.moment", lambda a, c, rows: -a * rows.turn * rows.weight * rows.wheelbase**2
    ),
    "bank": adds("car.force", lambda a, c, rows: a * rows.weight),
    "floor_slope": adds("car.force", _tilt),
    "sideslip_zero": adds("reading.sideslip", lambda a, c, rows: a),
    "yaw_rate_zero": adds("reading.yaw_rate", lambda a, c, rows: a),
    "tracked_point": adds("reading.ahead", lambda a, c, rows: a * rows.wheelbase),
}

SIMULATOR_EFFECTS = library("tirefit.vehicle", CODE)
"""The effects that ``tirefit diagnose --vehicle --sim-log`` searches."""

CAR_EFFECTS = tuple(x for x in SIMULATOR_EFFECTS if x.id not in ("front_axle", "rear_axle"))
"""The effects that ``tirefit diagnose --vehicle`` searches: the wheelbase of a car is measured."""
