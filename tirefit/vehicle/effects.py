"""Effects that the model of a car may lack: of steering, masses, ground, air, drive, tires
and of the log, as records of :class:`tirefit.diagnosis.effects.Effect`.

An effect changes a :class:`Setting` and may depend on :class:`Samples`.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from tirefit.diagnosis.effects.record import LEAST_FACTOR, Code, library
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


def _which(constants: tuple[float, ...], rows: Samples, time: np.ndarray) -> str:
    return _WORDS[_EACH.index(tuple(constants))]


def _adds(part: str, name: str, value: Callable[..., Any]) -> Callable[..., Any]:
    """The change of an effect that adds to a number of a part."""

    def change(
        setting: Setting, amplitude: jax.Array, constants: tuple[float, ...], rows: Samples
    ) -> Setting:
        held = getattr(setting, part)
        new = getattr(held, name) + value(amplitude, constants, rows)
        return setting._replace(**{part: held._replace(**{name: new})})

    return change


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

    def change(
        setting: Setting, amplitude: jax.Array, constants: tuple[float, ...], rows: Samples
    ) -> Setting:
        added = term(amplitude, rows)
        factors = [1 + c * added for c in constants]
        return scaled_axles(setting, name, factors)

    return dict(change=change, which=_which)


def _falls(
    setting: Setting, amplitude: jax.Array, constants: tuple[float, ...], rows: Samples
) -> Setting:
    axles = {}
    for k, axle in enumerate(("front", "rear")):
        held = getattr(setting.car, axle)
        axles[axle] = held._replace(
            fall=held.fall + constants[k] * amplitude, sliding=rows.sliding[k]
        )
    return setting._replace(car=setting.car._replace(**axles))


def _transfer(
    setting: Setting, height: jax.Array, constants: tuple[Any, ...], rows: Samples
) -> Setting:
    """Load transfer of height over wheelbase times the forward acceleration."""
    moved = height * rows.along
    return scaled_axles(setting, "load", (1 - 2 * moved, 1 + 2 * moved))


def _tilt(slope: jax.Array, constants: tuple[float, ...], rows: Samples) -> jax.Array:
    """Force to the left of a slope of the ground."""
    along, across = constants
    towards = across * jnp.cos(rows.heading) - along * jnp.sin(rows.heading)
    return slope * rows.weight * towards


CODE: Code = {
    "steering_ratio": _adds("steering", "ratio", lambda a, c, rows: a),
    "steering_offset": _adds("steering", "offset", lambda a, c, rows: a),
    "steering_delay": _adds("steering", "delay", lambda a, c, rows: a),
    "steering_lag": _adds("steering", "lag", lambda a, c, rows: a),
    "steering_play": _adds("steering", "play", lambda a, c, rows: a),
    "compliance_steer": _adds("steering", "yields", lambda a, c, rows: a),
    "yaw_inertia": _adds("car", "inertia", lambda a, c, rows: jnp.expm1(a)),
    "centre_of_gravity": _adds("car", "ahead", lambda a, c, rows: a * rows.wheelbase),
    "lateral_load_transfer": _scales("friction", lambda a, rows: -a * rows.across**2),
    "longitudinal_load_transfer": _transfer,
    "aerodynamic_load": _scales("load", lambda a, rows: a * (rows.speed**2 - 1)),
    "friction_speed": _scales("friction", lambda a, rows: -a * (rows.speed - 1)),
    "sliding_friction": dict(change=_falls, which=_which),
    "friction_drift": _scales("friction", lambda a, rows: a * rows.time),
    "relaxation_length": _adds("car", "relaxation", lambda a, c, rows: a * rows.wheelbase),
    "drive_force": _scales("friction", lambda a, rows: -a * rows.along**2),
    "yaw_resistance": _adds(
        "car", "moment", lambda a, c, rows: -a * rows.turn * rows.weight * rows.wheelbase**2
    ),
    "bank": _adds("car", "force", lambda a, c, rows: a * rows.weight),
    "floor_slope": _adds("car", "force", _tilt),
    "sideslip_zero": _adds("reading", "sideslip", lambda a, c, rows: a),
    "yaw_rate_zero": _adds("reading", "yaw_rate", lambda a, c, rows: a),
    "tracked_point": _adds("reading", "ahead", lambda a, c, rows: a * rows.wheelbase),
}

CAR_EFFECTS = library("tirefit.vehicle", CODE)
"""The effects that ``tirefit diagnose --vehicle`` searches."""
