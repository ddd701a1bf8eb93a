"""Effects of the vehicle: changing radii, speed offsets, the other force, load transfer,
inertia, the ground, the two wheels of an axle, steering."""

import numpy as np

from tirefit.diagnosis.effects.arrays import xp
from tirefit.diagnosis.effects.motion import (
    against_derive,
    odds_of_derive,
    of_a_known_force,
    of_a_known_height,
    of_a_known_inertia,
    of_a_known_position,
)
from tirefit.diagnosis.effects.record import (
    LEAST_FACTOR,
    PER_MILLE,
    SHARE,
    Effect,
    adds,
    blend,
    choices,
    multiplies,
    seldom,
)

_ALL_BUT, _DOUBLED = 0.95, -3.0
"""Largest share of the friction that the other force uses, and largest share that it
adds (the friction is then doubled)."""

_ALIKE, _ONE_LOAD = 0.9, 0.1
"""Limits of an effect of speed or load: with a larger correlation of speed and slip, or a
smaller standard deviation of log F_z, it is hardly separable from a constant one."""

_DIRECTIONS = tuple(np.radians([0.0, 45.0, 90.0, 135.0]))
"""Directions of a slope of the ground; opposite ones have the opposite sign."""

_OF_BOTH = ((1.0, 0.0), (0.0, 1.0), (1.0, 1.0))
"""Exponents of a factor on friction and stiffness: on one of them, or on both."""


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


def _of_the_axle(id: str, factor, **given) -> Effect:
    """A factor that depends on the lateral acceleration, on friction, stiffness or both."""

    def change(state, amplitude, constants, rows):
        friction, stiffness = constants
        times = xp.maximum(factor(amplitude, rows.lean), LEAST_FACTOR)
        return state._replace(
            friction=state.friction * times**friction, stiffness=state.stiffness * times**stiffness
        )

    return Effect(
        id=id,
        of="vehicle",
        family="friction x lateral acceleration",
        change=change,
        odds=seldom,
        needs=("a_y",),
        channels=("fy", "mz"),
        variants=_OF_BOTH,
        **given,
    )


SPEEDS = (
    Effect(
        id="slip_offset_load", of="measurement",
        family="slip x load", scale=0.2, per=("slip",),
        # Zero at the usual load, or at zero load.
        change=adds("shift", lambda a, about, rows: a * (rows.fz - about[0])),
        unit="- of slip",
        formula="slip + amplitude (F_z / F_z0 - 1); effective rolling radius,"
        " Pacejka 1.2",
        means="the zero of the slip moves with load",
        remedy="use a rolling radius (steering zero) that depends on the load",
        bounds=((-4.0, 4.0),), odds=_one_load, needs=("loads",),
        variants=((1.0,), (0.0,)),
        looks_like=("load_crosstalk", "conicity", "load_stiffness"),
        told_apart_by="both signs",
    ),
    Effect(
        id="slip_offset_speed", of="measurement",
        family="slip x speed", scale=0.3, per=("growth",),
        change=adds("shift", _slip_speed), unit="s/m", bounds=((-6.0, 6.0),),
        formula="slip + amplitude v: a tire that grows with its speed",
        means="the zero of the slip moves with speed", odds=_one_speed_of_the_slip,
        remedy="use a rolling radius that depends on the speed; for lateral slip, check"
        " what steers the wheel or shifts the heading with speed", needs=("speeds",),
        variants=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (1.0, 0.0, 1.0), (0.0, 1.0, 1.0)),
        looks_like=("speed_zero", "speed_drag"),
        told_apart_by="both signs",
    ),
    Effect(
        id="speed_zero", of="measurement",
        family="slip x speed", scale=0.3, per=("inverse_speed",),
        change=adds("shift", lambda a, _, rows: a / rows.pace), unit="m/s",
        formula="slip + amplitude / v", parameter="zero", bounds=((-6.0, 6.0),),
        means="a speed has a constant error, so the slip is wrong at low speed",
        remedy="check the zeros of the speed sensors at rest (ahead, across, of the"
        " wheel)", odds=_one_speed_of_the_slip, needs=("speeds",),
        looks_like=("slip_offset_speed", "speed_drag"),
        told_apart_by="both signs",
    ),
    Effect(
        id="speed_drag", of="vehicle",
        family="force x speed", change=adds("force", _drag),
        scale=25.0, unit="1e-3 mean F_z", bounds=((-500.0, 500.0),), needs=("speeds",),
        formula="force + amplitude v / v0, or amplitude (v / v0)^2", channels=("fx",),
        means="the tire force contains a force that follows the speed: drag, bearings",
        remedy="coast down and subtract the force measured then", variants=choices(2),
        odds=_one_speed_of_the_slip,
        looks_like=("slip_offset_speed", "speed_zero"), told_apart_by="both signs",
    ),
    Effect(
        id="friction_ellipse", family="friction x force", change=_ellipse, scale=0.3,
        formula="mu, or the whole force, times sqrt(1 - amplitude (F_across / (mu"
        " F_z))^2)", parameter="share", bounds=((0.0, 6.0),), center=1.0,
        means="the other force (drive, brake, cornering) uses a part of the friction",
        remedy="fit a combined model to both forces, or exclude rows with other force",
        prior=of_a_known_force, needs=("other force",), variants=((0.0,), (1.0,)),
        looks_like=("combined_slip", "force_crosstalk"), told_apart_by="pure slip",
    ),
    Effect(
        id="tracked_point", of="measurement",
        family="slip x yaw", scale=0.3, per=("lever",), unit="m",
        change=adds("shift", lambda a, _, rows: a * rows.yaw), parameter="distance",
        formula="slip angle + amplitude (yaw rate) / v", bounds=((-6.0, 6.0),),
        means="the slip angle is that of another point than the axle",
        remedy="measure tracked_point of vehicle.toml: its error along the vehicle is"
        " the amplitude", prior=of_a_known_position, doubts=against_derive,
        odds=odds_of_derive,
        needs=("yaw_rate", "v", "doubted point"), channels=("fy", "mz"),
        told_apart_by="speeds",
        looks_like=("slip_offset", "carcass_flexibility"),
    ),
    Effect(
        id="load_transfer", of="measurement",
        family="friction x acceleration", scale=0.15,
        change=multiplies("friction", lambda a, _, rows: 1 + a * rows.ahead / rows.fz),
        unit="over its range in the file", remedy="add m h a_x / wheelbase to fz",
        formula="F_z + amplitude (mean F_z) a_x: m h a_x / wheelbase",
        means="acceleration moves load between the axles, which fz does not include",
        parameter="share", bounds=(SHARE,), prior=of_a_known_height, needs=("a_x",),
        told_apart_by="loads",
        looks_like=("drive_brake_asymmetry", "friction_ellipse"),
    ),
)  # fmt: skip

CHASSIS = (
    Effect(
        id="yaw_inertia", of="measurement",
        family="force x yaw acceleration", scale=0.03, per=("swing",),
        unit="kg m", change=adds("force", lambda a, _, rows: a * rows.swing),
        formula="F_y + amplitude r', r' the yaw acceleration; Milliken 1995, 5.3",
        means="the yaw inertia over the wheelbase or the position of the centre of"
        " gravity is wrong", bounds=((-0.6, 0.6),), prior=of_a_known_inertia,
        remedy="measure yaw_inertia of vehicle.toml: swing the vehicle on a pendulum",
        parameter="error of inertia / wheelbase", channels=("fy",),
        needs=("yaw_acceleration", "derived force"), told_apart_by="two ramp rates",
        looks_like=("channel_delay", "relaxation_length", "tracked_point"),
    ),
    Effect(
        id="floor_slope", of="measurement",
        family="force x heading", change=adds("force", _slope),
        scale=0.01, parameter="slope", bounds=((-0.1, 0.1),), odds=seldom,
        formula="F_y + amplitude F_z cos(heading - direction): m g sin(slope)",
        means="the ground is not level: the weight has a component along it",
        remedy="use level ground, or drive each test in both directions and average",
        needs=("heading", "derived force"), channels=("fy",),
        variants=tuple((float(np.cos(d)), float(np.sin(d))) for d in _DIRECTIONS),
        looks_like=("slip_offset", "force_offset"), told_apart_by="random order",
    ),
    Effect(
        id="toe", of="vehicle",
        family="slip x lateral acceleration", scale=0.01, unit="rad / g",
        change=adds("shift", lambda a, _, rows: a * rows.lean), parameter="steer",
        formula="slip angle + amplitude a_y / g; roll steer, Gillespie 1992, 6",
        means="the wheels steer as the axle rolls: toe of the outer wheel, roll steer,"
        " soft mounts", bounds=((-0.06, 0.06),), odds=seldom, needs=("a_y",),
        remedy="measure toe against roll and side force on the axle and correct for it",
        channels=("fy", "mz"), told_apart_by="loads",
        looks_like=("carcass_flexibility", "stiffness_speed", "tracked_point"),
    ),
    _of_the_axle(
        "lateral_load_transfer", lambda a, lean: 1 - a * lean**2, scale=0.15,
        unit="1 / g^2", parameter="loss", bounds=((0.0, 0.9),), told_apart_by="loads",
        formula="1 - amplitude (a_y / g)^2 on friction or stiffness; Milliken 1995, 7",
        means="the load is uneven on the wheels of the axle, which reduces the friction",
        remedy="give the load of each wheel, or fit a model whose friction falls with"
        " load",
        looks_like=("pressure_flatness", "load_friction", "friction_speed_linear"),
    ),
    _of_the_axle(
        "unlike_tires", lambda a, lean: 1 + a * lean, scale=0.1, unit="1 / g",
        formula="1 + amplitude a_y / g on friction or stiffness", bounds=((-0.6, 0.6),),
        means="the two tires of the axle differ, and the one with more load dominates",
        remedy="swap the tires of the axle, and measure again", parameter="difference",
        told_apart_by="both signs", looks_like=("drive_brake_asymmetry", "slip_offset"),
    ),
    Effect(
        id="steering_gain", of="measurement",
        family="slip x steering", scale=0.1, bounds=((-0.6, 0.6),),
        change=adds("shift", lambda a, _, rows: a * rows.steering), odds=seldom,
        formula="slip angle + amplitude (road wheel angle)", needs=("steering",),
        means="the steering ratio is wrong, or the steering yields under load",
        remedy="measure the road wheel angle over the command with the wheels loaded",
        parameter="error of the ratio", channels=("fy", "mz"), told_apart_by="speeds",
        looks_like=("tracked_point", "toe", "slip_offset"),
    ),
)  # fmt: skip
