"""Effects of the measurement: offsets, drifting zeros, the definition of the slip, the
inertia of the wheel, crosstalk of channels, camber and conicity."""

from tirefit.diagnosis.effects.arrays import xp
from tirefit.diagnosis.effects.record import (
    PER_MILLE,
    Effect,
    adds,
    blend,
    choices,
    multiplies,
    seldom,
)
from tirefit.diagnosis.rows.rig import AGAINST, BESIDE, FOR

_FINE = 5e-4
"""Standard error of a slip offset below which an offset of zero is evidence against it."""

_INERTIA_STATED = 0.3
"""Relative standard deviation of a stated inertia, as hub, disc and shaft turn too."""

_CORNERING = 10.0
"""Usual cornering stiffness over load [1/rad], so that both camber forms share a scale."""

_WARMING = 0.2
"""Time constant of a zero that settles while its amplifier warms up, over the record."""


def _as_it_was_read(prior, prepared, rig):
    """The prior, with the sign of the conversion that the reading of the slip requires."""
    return prior._replace(center=prior.center * prepared.definition)


def _of_this_wheel(prior, prepared, rig):
    """The prior: a force computed from the torque lacks the inertia that the rig states."""
    known = rig.wheel_inertia
    if not known:
        return prior
    return prior._replace(
        scale=_INERTIA_STATED * known, center=known, high=max(prior.high, 2 * known)
    )


def _definition_odds(prepared) -> float:
    """Log odds from the slip of the wheel speed, whose errors are linear."""
    check = prepared.slip_check
    if check is None:
        return 0.0
    if check.fits != check.read_as:
        return FOR
    return AGAINST if check.told_apart else 0.0


def _seen_between_slips(prior, prepared, rig):
    """The prior, wide enough for the offset from the slip of the wheel speed."""
    check = prepared.slip_check
    if check is None or not check.shifted:
        return prior
    size = max(prior.scale, abs(check.offset))
    return prior._replace(scale=size, low=min(prior.low, -2 * size), high=max(prior.high, 2 * size))


def _offset_odds(prepared) -> float:
    """Log odds from the slip of the wheel speed; the radius may be wrong as well."""
    check = prepared.slip_check
    if check is None or check.fits != check.read_as:
        return 0.0
    if check.shifted:
        return BESIDE
    return AGAINST if check.agrees and check.offset_std < _FINE else 0.0


def _camber(state, share, constants, rows):
    shift, force = constants
    thrust = force * _CORNERING * share * rows.gamma * rows.fz * rows.load
    return state._replace(
        shift=state.shift + shift * share * rows.gamma, force=state.force + thrust
    )


def _settled(rows, constants):
    """A drift that is linear over the record, or faster at first; zero at the middle."""
    late = 0.5 - xp.exp(-(rows.time + 0.5) / _WARMING)
    return blend(constants, rows.time, late)


def _force_drift(drift, constants, rows):
    return PER_MILLE * drift * rows.load * _settled(rows, constants)


def _force_hysteresis(size, constants, rows):
    plain, grown = constants
    way = rows.turning * rows.side * (plain + grown * rows.usage)
    return PER_MILLE * size * rows.load * way


def _in_proportion(id: str, family: str, formula: str, remedy: str, **given) -> Effect:
    """A force in proportion to the load."""
    return Effect(
        id=id, family=family, formula=formula, remedy=remedy, scale=25.0,
        change=adds("force", lambda a, _, rows: PER_MILLE * a * rows.load * rows.fz),
        unit="1e-3 F_z", means="a force in proportion to load acts at zero slip",
        parameter="share", bounds=((-500.0, 500.0),), needs=("loads",),
        looks_like=("force_offset", "slip_offset"), **given,
    )  # fmt: skip


OFFSETS = (
    Effect(
        id="slip_offset", of="measurement",
        family="measurement", scale=0.2, per=("slip",),
        change=adds("shift", lambda a, _, rows: a), unit="- of slip", odds=_offset_odds,
        formula="slip + amplitude", means="the slip is off by a constant",
        remedy="add it to the slip; check the rolling radius, or the zero of heading or"
        " steering", bounds=((-4.0, 4.0),), prior=_seen_between_slips,
        looks_like=("force_offset",),
        told_apart_by="both signs",
    ),
    Effect(
        id="force_offset", of="measurement",
        family="measurement", scale=25.0, unit="1e-3 mean F_z",
        change=adds("force", lambda a, _, rows: PER_MILLE * a * rows.load),
        formula="force + amplitude", means="the force is off by a constant",
        remedy="subtract it; check the zero of the force sensor", told_apart_by="loads",
        bounds=((-500.0, 500.0),),
        looks_like=("slip_offset",),
    ),
    Effect(
        id="slip_definition", of="measurement",
        family="measurement", scale=0.3, bounds=((-6.0, 6.0),),
        change=adds("curvature", lambda a, constants, _: constants[0] * a), center=1.0,
        formula="slip / (1 - amplitude slip)", prior=_as_it_was_read, channels=("fx",),
        means="the slip has another definition than the one by which it was read",
        remedy="read its column by the other one: --column kappa=HEADER or"
        " sigma_x=HEADER", parameter="1: kappa logged as sigma, or the reverse",
        odds=_definition_odds, variants=((1.0,), (-1.0,)), told_apart_by="both signs",
        looks_like=("pressure_asymmetry",),
    ),
    Effect(
        id="wheel_inertia", of="measurement",
        family="measurement", scale=0.03, per=("inertia",),
        change=adds("force", lambda a, _, rows: -a * rows.spin), unit="kg m^2",
        formula="force - amplitude (d omega / dt) / r",
        means="the force lacks the torque that spins the wheel up",
        remedy="add J (d omega / dt) / r to the force", parameter="inertia",
        # The missing inertia is at most that of the wheel and all parts that turn with it:
        # 0.03 of the carried mass at its radius on a car, up to ten times that with a
        # geared drive or the motor of a model car. It is negative if it was subtracted
        # twice or with the wrong sign: then at most that of two wheels.
        bounds=((-0.06, 0.3),), prior=_of_this_wheel,
        needs=("omega", "rolling_radius", "sweeps"), told_apart_by="speeds",
        looks_like=("channel_delay", "relaxation_length", "friction_hysteresis"),
    ),
    Effect(
        id="camber_thrust", family="lateral inputs", change=_camber, scale=0.15,
        formula="slip angle + amplitude gamma", bounds=((-3.0, 3.0),), needs=("gamma",),
        means="camber adds to the lateral force", channels=("fy", "mz"),
        remedy="measure without camber, or correct for it", variants=choices(2),
        parameter="camber stiffness / cornering stiffness",
        told_apart_by="opposite camber",
    ),
    _in_proportion(
        "conicity", "lateral inputs", "F_y + amplitude F_z",
        "measure again with the tire mounted in reverse, and take the mean",
        channels=("fy", "mz"),
        told_apart_by="loads",
    ),
)  # fmt: skip

SENSORS = (
    Effect(
        id="slip_zero_drift", of="measurement",
        family="slip x time", scale=0.3, per=("slip",),
        change=adds("shift", lambda a, which, rows: a * _settled(rows, which)),
        unit="- of slip per record", formula="slip + amplitude t", parameter="drift",
        means="the zero of the slip moves over the record", bounds=((-6.0, 6.0),),
        remedy="zero heading, steering or wheel speed between runs, and cut runs"
        " shorter", odds=seldom, needs=("time",), variants=choices(2),
        told_apart_by="both signs",
        looks_like=("force_zero_drift", "stiffness_drift", "friction_drift"),
    ),
    Effect(
        id="force_zero_drift", of="measurement",
        family="force x time", scale=35.0, parameter="drift",
        change=adds("force", _force_drift), unit="1e-3 mean F_z per record",
        formula="force + amplitude t; zero drift of strain gauges, Hoffmann 1989",
        means="the zero of the force sensor moves over the record", odds=seldom,
        remedy="tare between runs; subtract the zeros before and after, shared by time",
        bounds=((-700.0, 700.0),), needs=("time",), variants=choices(2),
        told_apart_by="both signs",
        looks_like=("slip_zero_drift", "friction_drift"),
    ),
    _in_proportion(
        "load_crosstalk", "force x load",
        "F_x + amplitude F_z; crosstalk of a balance, or rolling resistance",
        "calibrate the crosstalk of F_z; subtract the rolling resistance", odds=seldom,
        of="measurement",
        channels=("fx",), told_apart_by="both signs",
    ),
    Effect(
        id="load_offset", of="measurement",
        family="friction x load", scale=60.0, unit="1e-3 mean F_z",
        # A brush with another load equals one with another friction; this is exact if the
        # stiffness does not depend on the load.
        change=multiplies(
            "friction",
            lambda a, _, rows: (1 + PER_MILLE * a / rows.fz) / (1 + PER_MILLE * a),
        ),
        formula="F_z + amplitude", means="the load is off by a constant",
        remedy="check the zero of the load cell, and the mass of rim and hub",
        bounds=((-400.0, 400.0),), odds=seldom, needs=("loads",),
        looks_like=("load_friction", "load_stiffness"),
        told_apart_by="loads",
    ),
    Effect(
        id="force_crosstalk", of="measurement",
        family="force x force", scale=0.04, parameter="share",
        change=adds("force", lambda a, _, rows: a * rows.across), bounds=((-0.8, 0.8),),
        formula="force + amplitude (force across); crosstalk of a balance", odds=seldom,
        means="crosstalk from the other force into this one", needs=("other force",),
        remedy="calibrate the balance with pure forces, and check its alignment",
        looks_like=("combined_slip", "friction_ellipse"), told_apart_by="pure slip",
    ),
    Effect(
        id="force_hysteresis", of="measurement",
        family="force x direction", scale=20.0, odds=seldom,
        change=adds("force", _force_hysteresis), unit="1e-3 mean F_z",
        formula="force + amplitude sign(d slip / dt): dry friction in the rig",
        means="the force sensor reads differently for rising and for falling slip",
        remedy="grease or unload the guides of the sensor; take the mean of both",
        bounds=((-400.0, 400.0),), needs=("sweeps",), variants=choices(2),
        told_apart_by="two ramp rates",
        looks_like=("friction_hysteresis", "channel_delay", "relaxation_length"),
    ),
)  # fmt: skip
