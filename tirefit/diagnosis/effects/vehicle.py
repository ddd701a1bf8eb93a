"""Effects of the vehicle: changing radii, speed offsets, the other force, load transfer,
inertia, the ground, the two wheels of an axle, steering."""

from typing import Any

import numpy as np

from tirefit.diagnosis.effects.motion import (
    odds_of_derive,
    of_a_known_force,
    of_a_known_height,
    of_a_known_inertia,
    of_a_known_position,
)
from tirefit.diagnosis.effects.record import (
    LEAST_FACTOR,
    PER_MILLE,
    adds,
    blend,
    code,
    multiplies,
    seldom,
    xp,
)

_ALL_BUT, _DOUBLED = 0.95, -3.0
"""Largest share of the friction that the other force uses, and largest share that it
adds (the friction is then doubled)."""

_ALIKE, _ONE_LOAD = 0.9, 0.1
"""Limits of an effect of speed or load: with a larger correlation of speed and slip, or a
smaller standard deviation of log F_z, it is hardly separable from a constant one."""

_DIRECTIONS = tuple(np.radians([0.0, 45.0, 90.0, 135.0]))
"""Directions of a slope of the ground; opposite ones have the opposite sign."""


def _slip_speed(share, constants, rows):
    """Slip due to a radius that grows with v or v^2; zero at rest or at usual speed."""
    even, square, about = constants
    grown = blend((even, square), rows.v, rows.v**2 / rows.cruise)
    return share * (grown - about * rows.cruise)


def _drag(share, constants, rows):
    ratio = rows.v / rows.cruise
    drag = share * blend(constants, ratio, ratio**2)
    return PER_MILLE * rows.load * drag


def _ellipse(state, share, constants, rows):
    """Factor on the friction, or on the whole force."""
    (whole,) = constants
    used = rows.across / (rows.peak * rows.fz * rows.load)
    left = xp.sqrt(1 - xp.clip(share * used**2, _DOUBLED, _ALL_BUT))
    stiffness = state.stiffness * (1 - whole * (1 - left))
    return state._replace(friction=state.friction * left, stiffness=stiffness)


def _one_speed_of_the_slip(prepared) -> float:
    """Log odds, smaller if the speed follows the slip, as slip then explains the same."""
    speed, slip = prepared.covariates.v, np.abs(prepared.slip)
    alike = abs(np.corrcoef(speed, slip)[0, 1]) if np.ptp(speed) > 0 else 0.0
    return seldom(prepared) - 2 * float(alike > _ALIKE)


def _one_load(prepared) -> float:
    """Log odds, smaller if the load hardly varies, as a constant offset fits as well."""
    varies = float(np.std(np.log(prepared.inputs.fz)))
    return seldom(prepared) - 2 * float(varies < _ONE_LOAD)


def _slope(slope, constants, rows):
    along, across = constants
    towards = along * xp.cos(rows.heading) + across * xp.sin(rows.heading)
    return slope * rows.load * rows.fz * towards


def _of_the_axle(factor) -> dict[str, Any]:
    """A factor that depends on the lateral acceleration, on friction, stiffness or both."""

    def change(state, amplitude, constants, rows):
        friction, stiffness = constants
        times = xp.maximum(factor(amplitude, rows.lean), LEAST_FACTOR)
        return state._replace(
            friction=state.friction * times**friction, stiffness=state.stiffness * times**stiffness
        )

    return code(change)


CODE = {
    "slip_offset_load": code(
        adds("shift", lambda a, about, rows: a * (rows.fz - about[0])), odds=_one_load
    ),
    "slip_offset_speed": code(adds("shift", _slip_speed), odds=_one_speed_of_the_slip),
    "speed_zero": code(
        adds("shift", lambda a, _, rows: a / rows.pace), odds=_one_speed_of_the_slip
    ),
    "speed_drag": code(adds("force", _drag), odds=_one_speed_of_the_slip),
    "friction_ellipse": code(_ellipse, prior=of_a_known_force),
    "tracked_point": code(
        adds("shift", lambda a, _, rows: a * rows.yaw),
        odds=odds_of_derive,
        prior=of_a_known_position,
    ),
    "load_transfer": code(
        multiplies("friction", lambda a, _, rows: 1 + a * rows.ahead / rows.fz),
        prior=of_a_known_height,
    ),
    "yaw_inertia": code(adds("force", lambda a, _, rows: a * rows.swing), prior=of_a_known_inertia),
    "floor_slope": code(
        adds("force", _slope),
        variants=tuple((float(np.cos(d)), float(np.sin(d))) for d in _DIRECTIONS),
    ),
    "toe": code(adds("shift", lambda a, _, rows: a * rows.lean)),
    "lateral_load_transfer": _of_the_axle(lambda a, lean: 1 - a * lean**2),
    "unlike_tires": _of_the_axle(lambda a, lean: 1 + a * lean),
    "steering_gain": code(adds("shift", lambda a, _, rows: a * rows.steering)),
}
