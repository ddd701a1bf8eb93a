"""Effects of a vehicle between its motion and its tires: inertia, floor, both wheels of
an axle, steering."""

import jax.numpy as jnp
import numpy as np

from tirefit.diagnosis.effects.free_forms import Form, over, rise
from tirefit.diagnosis.effects.known import of_a_known_inertia
from tirefit.diagnosis.effects.record import Effect, adds, seldom

_DIRECTIONS = tuple(np.radians([0.0, 45.0, 90.0, 135.0]))
"""Directions of a slope over the floor; the other half is the other sign."""


def _slope(slope, constants, rows):
    along, across = constants
    towards = along * jnp.cos(rows.heading) + across * jnp.sin(rows.heading)
    return slope * rows.load * rows.fz * towards


def _round_the_floor(rows, u):
    """Of any direction, and of a floor that is bent: (n, 4), in units of the load."""
    turns = [wave(k * rows.heading) for k in (1, 2) for wave in (np.cos, np.sin)]
    return np.stack(turns, axis=1) * (rows.load * rows.fz)[:, None]


def _scaled(state, constants, factor):
    """Friction, stiffness or both times a factor, which stays positive."""
    friction, stiffness = constants
    factor = jnp.maximum(factor, 0.05)
    return state._replace(
        friction=state.friction * factor**friction,
        stiffness=state.stiffness * factor**stiffness,
    )


_OF_BOTH = ((1.0, 0.0), (0.0, 1.0), (1.0, 1.0))

YAW_INERTIA = Effect(
    id="yaw_inertia", family="force x yaw acceleration",
    change=adds("force", lambda a, _, rows: a * rows.swing), scale=0.03, per=("swing",),
    unit="kg m",
    formula="F_y + amplitude r', r' the yaw acceleration; Milliken 1995, 5.3",
    means=(
        "the yaw inertia over the wheelbase is off, or the centre of gravity lies"
        " elsewhere along the vehicle"
    ),
    remedy="measure yaw_inertia of vehicle.toml: swing the vehicle on a pendulum",
    parameter="error of inertia / wheelbase", bounds=((-0.6, 0.6),),
    prior=of_a_known_inertia, needs=("yaw_acceleration", "derived force"),
    channels=("fy",),
    looks_like=("channel_delay", "relaxation_length", "tracked_point"),
    told_apart_by="two ramp rates",
)  # fmt: skip
FLOOR_SLOPE = Effect(
    id="floor_slope", family="force x heading", change=adds("force", _slope),
    scale=0.01, formula="F_y + amplitude F_z cos(heading - direction): m g sin(slope)",
    means="the floor or road is not level: the weight pulls the vehicle one way",
    remedy="level the floor, or drive each test both ways and take the mean",
    parameter="slope", bounds=((-0.1, 0.1),), odds=seldom,
    needs=("heading", "derived force"), channels=("fy",),
    variants=tuple((float(np.cos(d)), float(np.sin(d))) for d in _DIRECTIONS),
    forms=(Form("force", 0.005, _round_the_floor),),
    looks_like=("slip_offset", "force_offset"), told_apart_by="random order",
)  # fmt: skip
TOE = Effect(
    id="toe", family="slip x lateral acceleration",
    change=adds("shift", lambda a, _, rows: a * rows.lean), scale=0.01, unit="rad / g",
    formula="slip angle + amplitude a_y / g; roll steer, Gillespie 1992, 6",
    means=(
        "the wheels steer as the axle leans: toe of the wheel that carries more, roll"
        " steer, soft mounts"
    ),
    remedy="measure toe against roll and side force on the axle, and correct for it",
    parameter="steer", bounds=((-0.06, 0.06),), odds=seldom, needs=("a_y",),
    channels=("fy", "mz"),
    looks_like=("carcass_flexibility", "stiffness_speed", "tracked_point"),
    told_apart_by="loads",
)  # fmt: skip
LATERAL_TRANSFER = Effect(
    id="lateral_load_transfer", family="friction x lateral acceleration",
    change=lambda state, a, of, rows: _scaled(state, of, 1 - a * rows.lean**2),
    scale=0.15, unit="1 / g^2",
    formula="1 - amplitude (a_y / g)^2 on friction or stiffness; Milliken 1995, 7",
    means="the wheels of the axle share the load unevenly, and lose by it",
    remedy="give the load of each wheel, or fit a model whose friction falls with load",
    parameter="loss", bounds=((0.0, 0.9),), odds=seldom, needs=("a_y",),
    channels=("fy", "mz"), variants=_OF_BOTH, forms=over("friction", 0.02, "lean", 4),
    looks_like=("pressure_flatness", "load_friction", "friction_speed_linear"),
    told_apart_by="loads",
)  # fmt: skip
UNLIKE_TIRES = Effect(
    id="unlike_tires", family="friction x lateral acceleration",
    change=lambda state, a, of, rows: _scaled(state, of, 1 + a * rows.lean), scale=0.1,
    unit="1 / g", formula="1 + amplitude a_y / g on friction or stiffness",
    means="the two tires of the axle differ: the one that carries more counts more",
    remedy="change the tires of the axle over, and measure again",
    parameter="difference", bounds=((-0.6, 0.6),), odds=seldom, needs=("a_y",),
    channels=("fy", "mz"), variants=_OF_BOTH, forms=over("friction", 0.02, "lean", 4),
    looks_like=("drive_brake_asymmetry", "slip_offset"), told_apart_by="both signs",
)  # fmt: skip
STEERING_GAIN = Effect(
    id="steering_gain", family="slip x steering",
    change=adds("shift", lambda a, _, rows: a * rows.steering), scale=0.1,
    formula="slip angle + amplitude (road wheel angle)",
    means="the steering ratio is off, or the steering gives way",
    remedy="measure the road wheel angle over the command with the wheels loaded",
    parameter="error of the ratio", bounds=((-0.6, 0.6),), odds=seldom,
    needs=("steering",), channels=("fy", "mz"),
    forms=over("shift", 0.1, "steering", 4, rise),
    looks_like=("tracked_point", "toe", "slip_offset"), told_apart_by="speeds",
)  # fmt: skip

EFFECTS = (YAW_INERTIA, FLOOR_SLOPE, TOE, LATERAL_TRANSFER, UNLIKE_TIRES, STEERING_GAIN)
