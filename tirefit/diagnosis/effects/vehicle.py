"""Effects of the vehicle: radii that change, speeds with a zero, what is not measured
where the tire is."""

import jax.numpy as jnp
import numpy as np

from tirefit.diagnosis.effects.free_forms import (
    BOTH_WAYS,
    ONE_WAY,
    SHIFT_BY_SPEED,
    over,
    rise,
    weight,
)
from tirefit.diagnosis.effects.known import (
    of_a_known_force,
    of_a_known_height,
    of_a_known_position,
)
from tirefit.diagnosis.effects.record import (
    PER_MILLE,
    Effect,
    adds,
    blend,
    multiplies,
    seldom,
)

_ALL_BUT = 0.95
"""Share of the friction that a force across takes at most."""
_DOUBLED = -3.0
"""The same of what it adds: the friction is doubled at most."""
_ALIKE = 0.9
"""Correlation of speed and slip from which one is hardly told from the other."""
_ONE_LOAD = 0.1
"""Standard deviation of log F_z below which a zero that follows the load is hardly told
from a constant one."""


def _slip_speed(share, constants, rows):
    """A radius that grows with the speed, or with its square; zero at rest, or at the
    usual speed."""
    even, square, about = constants
    grown = blend((even, square), rows.v, rows.v**2 / rows.cruise)
    return share * (grown - about * rows.cruise)


def _drag(share, constants, rows):
    ratio = rows.v / rows.cruise
    drag = share * blend(constants, ratio, ratio**2)
    return PER_MILLE * rows.load * drag


def _ellipse(state, share, constants, rows):
    """Of the friction, or of the whole force, as a vehicle model's last line has it."""
    (whole,) = constants
    used = rows.across / (rows.peak * rows.fz * rows.load)
    left = jnp.sqrt(1 - jnp.clip(share * used**2, _DOUBLED, _ALL_BUT))
    stiffness = state.stiffness * (1 - whole * (1 - left))
    return state._replace(friction=state.friction * left, stiffness=stiffness)


def _one_speed_of_the_slip(prepared) -> float:
    """A slip that follows the speed is hardly told from one of the force."""
    speed, slip = prepared.covariates.v, np.abs(prepared.slip)
    alike = abs(np.corrcoef(speed, slip)[0, 1]) if np.ptp(speed) > 0 else 0.0
    return seldom(prepared) - 2 * float(alike > _ALIKE)


def _one_load(prepared) -> float:
    """Where the load hardly varies, a zero that follows it is one more claim than a
    constant one, and no better seen."""
    varies = float(np.std(np.log(prepared.inputs.fz)))
    return seldom(prepared) - 2 * float(varies < _ONE_LOAD)


SLIP_LOAD = Effect(
    id="slip_offset_load", family="slip x load",
    # About the usual load, or from none on.
    change=adds("shift", lambda a, about, rows: a * (rows.fz - about[0])), scale=0.2,
    per=("slip",), unit="- of slip",
    formula="slip + amplitude (F_z / F_z0 - 1); effective rolling radius, Pacejka 1.2",
    means="the zero of the slip moves with load",
    remedy="take the rolling radius (steering zero) as a function of load",
    bounds=((-4.0, 4.0),), odds=_one_load, needs=("loads",),
    forms=over("shift", 0.1, "fz", ONE_WAY, rise), variants=((1.0,), (0.0,)),
    looks_like=("load_crosstalk", "conicity", "load_stiffness"),
    told_apart_by="both signs",
)  # fmt: skip
SLIP_SPEED = Effect(
    id="slip_offset_speed", family="slip x speed", change=adds("shift", _slip_speed),
    scale=0.3, per=("growth",), unit="s/m",
    formula="slip + amplitude v: a tire that grows with its speed",
    means="the zero of the slip moves with speed",
    remedy="take the rolling radius as a function of speed; laterally look for what"
    " turns the wheel, or the heading's zero, with speed",
    bounds=((-6.0, 6.0),), odds=_one_speed_of_the_slip, needs=("speeds",),
    variants=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (1.0, 0.0, 1.0), (0.0, 1.0, 1.0)),
    forms=SHIFT_BY_SPEED, looks_like=("speed_zero", "speed_drag"),
    told_apart_by="both signs",
)  # fmt: skip
SPEED_ZERO = Effect(
    id="speed_zero", family="slip x speed",
    change=adds("shift", lambda a, _, rows: a / rows.pace), scale=0.3,
    per=("inverse_speed",), unit="m/s", formula="slip + amplitude / v",
    means="a speed is off by a constant, so that the slip is at low speed",
    remedy="check the zeros of the speed sensors at rest (ahead, across, of the wheel)",
    parameter="zero", bounds=((-6.0, 6.0),), odds=_one_speed_of_the_slip,
    needs=("speeds",), forms=SHIFT_BY_SPEED,
    looks_like=("slip_offset_speed", "speed_drag"), told_apart_by="both signs",
)  # fmt: skip
SPEED_DRAG = Effect(
    id="speed_drag", family="force x speed", change=adds("force", _drag), scale=25.0,
    unit="1e-3 mean F_z", formula="force + amplitude v / v0, or amplitude (v / v0)^2",
    means="a force that follows the speed is taken for one of the tire: drag, bearings",
    remedy="coast down and subtract what is measured then", bounds=((-500.0, 500.0),),
    odds=_one_speed_of_the_slip, needs=("speeds",), channels=("fx",),
    variants=((1.0, 0.0), (0.0, 1.0)), forms=over("force", 0.01, "v", 4, weight),
    looks_like=("slip_offset_speed", "speed_zero"), told_apart_by="both signs",
)  # fmt: skip
ELLIPSE = Effect(
    id="friction_ellipse", family="friction x force", change=_ellipse, scale=0.3,
    formula="mu, or the whole force, times sqrt(1 - amplitude (F_across / (mu F_z))^2)",
    means="the force across (drive, brake or cornering) takes its part of the friction",
    remedy="fit a combined model to both forces, or leave rows with a force across out",
    parameter="share", bounds=((0.0, 6.0),), center=1.0, prior=of_a_known_force,
    needs=("other force",), variants=((0.0,), (1.0,)),
    forms=(
        *over("friction", 0.03, "across", BOTH_WAYS),
        *over("stiffness", 0.03, "across", BOTH_WAYS),
    ),
    looks_like=("combined_slip", "force_crosstalk"), told_apart_by="pure slip",
)  # fmt: skip
TRACKED_POINT = Effect(
    id="tracked_point", family="slip x yaw",
    change=adds("shift", lambda a, _, rows: a * rows.yaw), scale=0.3, per=("lever",),
    unit="m", formula="slip angle + amplitude (yaw rate) / v",
    means="the slip angle is that of another point than the axle",
    remedy=(
        "measure tracked_point of vehicle.toml: it is off by the amplitude along the"
        " vehicle"
    ),
    parameter="distance", bounds=((-6.0, 6.0),), prior=of_a_known_position,
    needs=("yaw_rate", "v"), channels=("fy", "mz"),
    looks_like=("slip_offset", "carcass_flexibility"), told_apart_by="speeds",
)  # fmt: skip
LOAD_TRANSFER = Effect(
    id="load_transfer", family="friction x acceleration",
    change=multiplies("friction", lambda a, _, rows: 1 + a * rows.ahead / rows.fz),
    scale=0.15, unit="over the range of the file",
    formula="F_z + amplitude (geometric mean F_z) a_x: m h a_x / wheelbase",
    means="the load moves between the axles with the acceleration, and fz does not",
    remedy="add m h a_x / wheelbase to fz", parameter="share", bounds=((-1.9, 1.9),),
    prior=of_a_known_height, needs=("a_x",), forms=over("friction", 0.03, "ahead", 4),
    looks_like=("drive_brake_asymmetry", "friction_ellipse"), told_apart_by="loads",
)  # fmt: skip

EFFECTS = (
    SLIP_LOAD,
    SLIP_SPEED,
    SPEED_ZERO,
    SPEED_DRAG,
    ELLIPSE,
    TRACKED_POINT,
    LOAD_TRANSFER,
)
