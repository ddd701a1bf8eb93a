"""Effects that the model of a car may lack: of steering, masses, ground, air, drive, tires
and of the log, as records of :class:`tirefit.diagnosis.effects.Effect`.

An effect changes a :class:`Setting` and may depend on :class:`Samples`.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp

from tirefit.diagnosis.effects import Effect
from tirefit.diagnosis.effects.record import LEAST_FACTOR
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


_EACH = ((1.0, 1.0), (1.0, 0.0), (0.0, 1.0))
"""Both axles, the front axle, the rear axle."""
_WORDS = ("of both axles", "of the front axle", "of the rear axle")


def _which(constants, rows, time) -> str:
    return _WORDS[_EACH.index(tuple(constants))]


def _sets(part: str, name: str, value):
    """The change of an effect that sets a number of a part."""

    def change(setting, amplitude, constants, rows):
        new = value(amplitude, rows)
        return setting._replace(**{part: getattr(setting, part)._replace(**{name: new})})

    return change


def _adds(part: str, name: str, value):
    """The change of an effect that adds to a number of a part."""

    def change(setting, amplitude, constants, rows):
        held = getattr(setting, part)
        new = getattr(held, name) + value(amplitude, constants, rows)
        return setting._replace(**{part: held._replace(**{name: new})})

    return change


def scaled_axles(setting: Setting, name: str, factors) -> Setting:
    """The setting with a field of front and rear axle multiplied by factors."""
    axles = {}
    for axle, factor in zip(("front", "rear"), factors, strict=True):
        held = getattr(setting.car, axle)
        factor = getattr(held, name) * jnp.maximum(factor, LEAST_FACTOR)
        axles[axle] = held._replace(**{name: factor})
    return setting._replace(car=setting.car._replace(**axles))


def _scales(name: str, term):
    """The change of an effect that scales a number of its axles by 1 + term."""

    def change(setting, amplitude, constants, rows):
        added = term(amplitude, rows)
        factors = [1 + c * added for c in constants]
        return scaled_axles(setting, name, factors)

    return change


def _falls(setting, amplitude, constants, rows):
    axles = {}
    for k, axle in enumerate(("front", "rear")):
        held = getattr(setting.car, axle)
        axles[axle] = held._replace(
            fall=held.fall + constants[k] * amplitude, sliding=rows.sliding[k]
        )
    return setting._replace(car=setting.car._replace(**axles))


def _transfer(setting, height, constants, rows):
    """Load transfer of height over wheelbase times the forward acceleration."""
    moved = height * rows.along
    return scaled_axles(setting, "load", (1 - 2 * moved, 1 + 2 * moved))


def _tilt(setting, slope, constants, rows):
    along, across = constants
    towards = across * jnp.cos(rows.heading) - along * jnp.sin(rows.heading)
    force = setting.car.force + slope * rows.weight * towards
    return setting._replace(car=setting.car._replace(force=force))


STEERING = (
    Effect(
        id="steering_ratio", of="vehicle", family="steering ratio", scale=0.15,
        change=_adds("steering", "ratio", lambda a, c, rows: a),
        formula="wheel angle (1 + amplitude)", bounds=((-0.8, 2.0),),
        means="the ratio of wheel angle to logged steering is not the stated one",
        remedy="scale steering.angle of vehicle.toml by 1 + amplitude",
        looks_like=("compliance_steer", "centre_of_gravity"),
        told_apart_by="circles at a walking pace, where the tires have no slip: there"
        " only the ratio has an effect",
    ),
    Effect(
        id="steering_offset", of="vehicle", family="steering zero", scale=0.02,
        unit="rad", change=_adds("steering", "offset", lambda a, c, rows: a),
        formula="wheel angle + amplitude", bounds=((-0.3, 0.3),),
        means="the wheels are not straight at the logged zero",
        remedy="add amplitude to steering.angle of vehicle.toml",
        looks_like=("bank", "sideslip_zero", "yaw_rate_zero"),
        told_apart_by="the same straight road in both directions: a bank changes its"
        " side, the steering does not",
    ),
    Effect(
        id="steering_delay", of="vehicle", family="steering in time", scale=0.05,
        unit="s", change=_adds("steering", "delay", lambda a, c, rows: a),
        formula="wheel angle at the time t - amplitude", bounds=((0.0, 0.28),),
        means="the wheels follow the logged steering with a delay",
        remedy="give the delay to the simulator, or shift the channel",
        looks_like=("steering_lag", "relaxation_length"),
        told_apart_by="steering steps: a delay shifts the whole response, a lag rounds it",
    ),
    Effect(
        id="steering_lag", of="vehicle", family="steering in time", scale=0.05,
        unit="s", change=_adds("steering", "lag", lambda a, c, rows: a),
        formula="wheel angle through a first-order lag", bounds=((0.0, 0.5),),
        means="the steering actuator is slow",
        remedy="put a first-order lag before the wheels in the simulator",
        looks_like=("steering_delay", "relaxation_length"),
        told_apart_by="steering steps: a delay shifts the whole response, a lag rounds it",
    ),
    Effect(
        id="steering_play", of="vehicle", family="steering play", scale=0.01,
        unit="rad", change=_adds("steering", "play", lambda a, c, rows: a),
        formula="the wheels do not move until the steering has moved by amplitude",
        bounds=((0.0, 0.2),), means="the steering has play, or sticks",
        remedy="add play (backlash) between steering and wheels to the simulator",
        looks_like=("steering_delay", "steering_lag"),
        told_apart_by="slow steering to and fro: the effect of a delay decreases with"
        " the rate, that of play does not",
    ),
    Effect(
        id="compliance_steer", of="vehicle", family="steering compliance", scale=0.02,
        unit="rad per g", change=_adds("steering", "yields", lambda a, c, rows: a),
        formula="wheel angle - amplitude a_y / g", bounds=((-0.2, 0.2),),
        means="the steering or the suspension yields to the side force",
        remedy="add the compliance to the steering of the simulator",
        looks_like=("steering_ratio", "lateral_load_transfer"),
        told_apart_by="the wheel angle measured at the wheel while cornering",
    ),
)  # fmt: skip

MASSES = (
    Effect(
        id="yaw_inertia", of="vehicle", family="yaw inertia", scale=0.3,
        change=_sets("car", "inertia", lambda a, rows: jnp.exp(a)),
        formula="yaw inertia exp(amplitude)", bounds=((-1.5, 1.5),),
        means="the yaw inertia is not the stated one, or the mass differs by the"
        " reciprocal factor: with fitted tires, both have the same effect",
        remedy="scale yaw_inertia of vehicle.toml by exp(amplitude)",
        looks_like=("steering_lag", "relaxation_length"),
        told_apart_by="the mass on a scale, and quick steering at several speeds",
    ),
    Effect(
        id="centre_of_gravity", of="vehicle", family="centre of gravity", scale=0.05,
        unit="of the wheelbase", bounds=((-0.3, 0.3),),
        change=_sets("car", "ahead", lambda a, rows: a * rows.wheelbase),
        formula="l_f - amplitude L, l_r + amplitude L",
        means="the centre of gravity is not at the stated place",
        remedy="correct l_f and l_r of vehicle.toml",
        looks_like=("tracked_point", "steering_ratio"),
        told_apart_by="the loads of the axles on scales",
    ),
)  # fmt: skip

LOADS = (
    Effect(
        id="lateral_load_transfer", of="vehicle", family="load x lateral acceleration",
        scale=0.3, bounds=((-0.9, 0.9),), variants=_EACH, which=_which,
        change=_scales("friction", lambda a, rows: -a * rows.across**2),
        formula="friction (1 - amplitude (a_y / g)^2)",
        means="the friction of an axle falls as the load moves to the outer tire",
        remedy="model both tires of an axle, with a friction that falls with load",
        looks_like=("sliding_friction", "compliance_steer"),
        told_apart_by="the same bends with another height of the centre of gravity",
    ),
    Effect(
        id="longitudinal_load_transfer", of="vehicle", family="load x acceleration",
        scale=0.2, bounds=((0.0, 0.8),), change=_transfer,
        unit="height over wheelbase",
        formula="axle loads -+ amplitude m a_x",
        means="braking and driving move the load between the axles",
        remedy="give the simulator the height of the centre of gravity",
        needs=("acceleration",), looks_like=("drive_force",),
        told_apart_by="both braking and driving in bends: a drive force reduces the grip"
        " of the same axle in both, load transfer of either axle",
    ),
    Effect(
        id="aerodynamic_load", of="vehicle", family="load x speed", scale=0.1,
        bounds=((-0.5, 1.0),), variants=_EACH, which=_which, needs=("speeds",),
        change=_scales("load", lambda a, rows: a * (rows.speed**2 - 1)),
        formula="axle load (1 + amplitude ((v / v0)^2 - 1))",
        means="the air causes downforce or lift",
        remedy="add the lift of the axles to the simulator",
        looks_like=("friction_speed",), told_apart_by="the ride height over speed",
    ),
)  # fmt: skip

TIRES = (
    Effect(
        id="friction_speed", of="tire", family="friction x speed", scale=0.2,
        bounds=((-0.9, 0.9),), variants=_EACH, which=_which, needs=("speeds",),
        change=_scales("friction", lambda a, rows: -a * (rows.speed - 1)),
        formula="friction (1 - amplitude (v / v0 - 1))",
        means="the friction falls with speed", remedy="let mu fall with speed",
        looks_like=("aerodynamic_load",), told_apart_by="the ride height over speed",
    ),
    Effect(
        id="sliding_friction", of="tire", family="friction x slip", scale=0.2,
        bounds=((-0.5, 0.9),), variants=_EACH, which=_which, change=_falls,
        formula="friction (1 - amplitude s^2 / (1 + s^2)), s = slip over that at which"
        " the tire slides",
        means="the force falls when the tire begins to slide",
        remedy="use a tire whose force falls beyond its peak",
        looks_like=("lateral_load_transfer",),
        told_apart_by="large sideslip at a small speed",
    ),
    Effect(
        id="friction_drift", of="tire", family="friction x time", scale=0.15,
        bounds=((-0.9, 0.9),), variants=_EACH, which=_which,
        change=_scales("friction", lambda a, rows: a * rows.time),
        formula="friction (1 + amplitude t), t from -1/2 to 1/2 over the logs",
        means="the friction changes while driving (temperature, wear or dirt of tires"
        " or road)",
        remedy="take logs of one state, or let mu follow the tire's temperature",
        looks_like=("friction_speed",),
        told_apart_by="the first lap driven again at the end",
    ),
    Effect(
        id="relaxation_length", of="tire", family="tire in space", scale=0.15,
        unit="of the wheelbase", bounds=((0.0, 2.0),),
        change=_sets("car", "relaxation", lambda a, rows: a * rows.wheelbase),
        formula="slip angles lag by a distance",
        means="the side forces build up over a distance",
        remedy="give the tires of the simulator a relaxation length",
        looks_like=("steering_delay", "steering_lag", "yaw_inertia"),
        told_apart_by="steering steps at two speeds: a lag in time stays the same, a"
        " lag over a distance takes less time at the higher speed",
    ),
    Effect(
        id="drive_force", of="vehicle", family="friction x drive force", scale=1.0,
        bounds=((-1.0, 3.0),), variants=_EACH, which=_which, needs=("acceleration",),
        change=_scales("friction", lambda a, rows: -a * rows.along**2),
        formula="friction (1 - amplitude (a_x / g)^2)",
        means="the drive or brake force reduces the lateral force",
        remedy="put drive and brake forces on the friction ellipse",
        looks_like=("longitudinal_load_transfer",),
        told_apart_by="both driving and braking in bends",
    ),
    Effect(
        id="yaw_resistance", of="vehicle", family="yaw moment", scale=0.1,
        bounds=((-1.0, 1.0),),
        change=_adds(
            "car", "moment",
            lambda a, c, rows: -a * rows.turn * rows.weight * rows.wheelbase**2,
        ),
        formula="yaw moment - amplitude m g L^2 r / v",
        means="a locked differential or wide tires resist turning",
        remedy="add the moment of the differential to the simulator",
        looks_like=("steering_ratio", "compliance_steer"),
        told_apart_by="tight circles at a walking pace, coasting and driven",
    ),
)  # fmt: skip

GROUND = (
    Effect(
        id="bank", of="vehicle", family="side force", scale=0.02, unit="rad",
        change=_adds("car", "force", lambda a, c, rows: a * rows.weight),
        formula="force to the left, amplitude m g", bounds=((-0.3, 0.3),),
        means="the road is banked, or a constant force acts to one side",
        remedy="give the bank to the simulator",
        looks_like=("steering_offset", "sideslip_zero"),
        told_apart_by="the same straight road in both directions",
    ),
    Effect(
        id="floor_slope", of="vehicle", family="side force x heading", scale=0.02,
        unit="rad", change=_tilt, bounds=((-0.3, 0.3),),
        variants=((1.0, 0.0), (0.0, 1.0), (0.7, 0.7), (0.7, -0.7)), needs=("heading",),
        formula="force to the left, amplitude m g times a sinusoid of the heading",
        means="the ground slopes: the side force depends on the heading",
        remedy="give the slope to the simulator",
        told_apart_by="the same lap in the other direction",
    ),
)  # fmt: skip

LOG = (
    Effect(
        id="sideslip_zero", of="measurement", family="zero of the sideslip",
        scale=0.02, unit="rad", bounds=((-0.3, 0.3),),
        change=_adds("reading", "sideslip", lambda a, c, rows: a),
        formula="logged sideslip (heading) - amplitude",
        means="the speed sensor (or the zero of the heading) is at an angle to the car",
        remedy="set sideslip_offset (yaw_offset) of vehicle.toml",
        looks_like=("steering_offset", "bank"),
        told_apart_by="a straight road, driven slowly",
    ),
    Effect(
        id="yaw_rate_zero", of="measurement", family="zero of the yaw rate",
        scale=0.02, unit="rad/s", bounds=((-0.5, 0.5),), needs=("rates",),
        change=_adds("reading", "yaw_rate", lambda a, c, rows: a),
        formula="logged yaw rate - amplitude",
        means="the yaw rate sensor has a zero error",
        remedy="take the mean at standstill from the channel",
        looks_like=("steering_offset",), told_apart_by="a record at standstill",
    ),
    Effect(
        id="tracked_point", of="measurement", family="tracked point", scale=0.1,
        unit="of the wheelbase", bounds=((-1.5, 1.5),),
        change=_adds("reading", "ahead", lambda a, c, rows: a * rows.wheelbase),
        formula="logged lateral speed - amplitude L r",
        means="the log describes another point of the car than stated",
        remedy="move tracked_point of vehicle.toml forward by amplitude L",
        looks_like=("centre_of_gravity",),
        told_apart_by="a tape measure; or a slow circle, where the rear axle does not"
        " move sideways",
    ),
)  # fmt: skip

CAR_EFFECTS = STEERING + MASSES + LOADS + TIRES + GROUND + LOG
"""The effects that ``tirefit diagnose --vehicle`` searches."""
