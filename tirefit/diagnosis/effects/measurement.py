"""Effects of the measurement: offsets, the definition of the slip, a force that was
worked out without the wheel's inertia; camber and conicity beside them."""

from tirefit.diagnosis.effects.free_forms import (
    FORCE_BY_LOAD,
    ONE_WAY,
    SHIFT_BY_CAMBER,
    over,
    rise,
    weight,
)
from tirefit.diagnosis.effects.record import PER_MILLE, Effect, adds
from tirefit.diagnosis.rows.slip_check import AGAINST, BESIDE, FOR

_FINE = 5e-4
"""Standard error of an offset of the slip below which its absence says something."""

_INERTIA_STATED = 0.3
"""Standard deviation of a stated inertia over it: hub, disc and shaft turn too."""

_CORNERING = 10.0
"""Cornering stiffness over load [1/rad] that is usual: the same amplitude for both
forms of camber thrust."""


def _as_it_was_read(prior, prepared, rig):
    """Which way a slip would have to be converted depends on what it was read as."""
    return prior._replace(center=prior.center * prepared.definition)


def _of_this_wheel(prior, prepared, rig):
    """A force taken from the torque lacks all of the inertia that is known."""
    known = rig.wheel_inertia
    if not known:
        return prior
    return prior._replace(
        scale=_INERTIA_STATED * known, center=known, high=max(prior.high, 2 * known)
    )


def _definition_odds(prepared) -> float:
    """Log odds by the slip of the wheel speed, which no error of it can bend."""
    check = prepared.slip_check
    if check is None:
        return 0.0
    if check.fits != check.read_as:
        return FOR
    return AGAINST if check.told_apart else 0.0


def _seen_between_slips(prior, prepared, rig):
    """An offset from the slip of the wheel speed is one that may have to be taken off,
    whatever its size."""
    check = prepared.slip_check
    if check is None or not check.shifted:
        return prior
    size = max(prior.scale, abs(check.offset))
    return prior._replace(
        scale=size, low=min(prior.low, -2 * size), high=max(prior.high, 2 * size)
    )


def _offset_odds(prepared) -> float:
    """Log odds by the slip of the wheel speed; the radius may be wrong as well."""
    check = prepared.slip_check
    if check is None or check.fits != check.read_as:
        return 0.0
    if check.shifted:
        return BESIDE
    return AGAINST if check.agrees and check.offset_std < _FINE else 0.0


def _camber(state, share, constants, rows):
    shift, force = constants
    return state._replace(
        shift=state.shift + shift * share * rows.gamma,
        force=state.force
        + force * _CORNERING * share * rows.gamma * rows.fz * rows.load,
    )


SLIP_OFFSET = Effect(
    id="slip_offset", family="measurement", change=adds("shift", lambda a, _, rows: a),
    scale=0.2, per=("slip",), unit="- of slip", formula="slip + amplitude",
    means="the slip is off by a constant",
    remedy=(
        "add it to the slip; check the rolling radius, or the zero of heading or"
        " steering"
    ),
    bounds=((-4.0, 4.0),), prior=_seen_between_slips, odds=_offset_odds,
    forms=over("shift", 0.03, "time", ONE_WAY, rise), looks_like=("force_offset",),
    told_apart_by="both signs",
)  # fmt: skip
FORCE_OFFSET = Effect(
    id="force_offset", family="measurement",
    change=adds("force", lambda a, _, rows: PER_MILLE * a * rows.load), scale=25.0,
    unit="1e-3 mean F_z", formula="force + amplitude",
    means="the force is off by a constant",
    remedy="subtract it; check the zero of the force sensor", bounds=((-500.0, 500.0),),
    forms=over("force", 0.004, "time", ONE_WAY, weight), looks_like=("slip_offset",),
    told_apart_by="loads",
)  # fmt: skip
SLIP_DEFINITION = Effect(
    id="slip_definition", family="measurement",
    change=adds("curvature", lambda a, constants, _: constants[0] * a), scale=0.3,
    formula="slip / (1 - amplitude slip)",
    means="the slip follows another definition than it was read by",
    remedy="read its column by the other one: --column kappa=HEADER or sigma_x=HEADER",
    parameter="1: kappa logged as sigma, or the reverse", bounds=((-6.0, 6.0),),
    center=1.0, prior=_as_it_was_read, odds=_definition_odds, channels=("fx",),
    variants=((1.0,), (-1.0,)), looks_like=("pressure_asymmetry",),
    told_apart_by="both signs",
)  # fmt: skip
WHEEL_INERTIA = Effect(
    id="wheel_inertia", family="measurement",
    change=adds("force", lambda a, _, rows: -a * rows.spin), scale=0.03,
    per=("inertia",), unit="kg m^2", formula="force - amplitude (d omega / dt) / r",
    means="the force lacks the torque that spins the wheel up",
    remedy="add J (d omega / dt) / r to the force", parameter="inertia",
    # A log lacks up to the inertia of the wheel and of all that turns with it: some
    # 0.03 of the carried mass at its radius on a car, up to ten times that with a
    # geared drive or a model car's motor. A negative one was taken off twice or with
    # the wrong sign: that of one or two wheels at most.
    bounds=((-0.06, 0.3),), prior=_of_this_wheel,
    needs=("omega", "rolling_radius", "sweeps"),
    looks_like=("channel_delay", "relaxation_length", "friction_hysteresis"),
    told_apart_by="speeds",
)  # fmt: skip
CAMBER_THRUST = Effect(
    id="camber_thrust", family="lateral inputs", change=_camber, scale=0.15,
    formula="slip angle + amplitude gamma", means="camber adds to the lateral force",
    remedy="measure without camber, or correct for it",
    parameter="camber stiffness / cornering stiffness", bounds=((-3.0, 3.0),),
    needs=("gamma",), channels=("fy", "mz"), variants=((1.0, 0.0), (0.0, 1.0)),
    forms=SHIFT_BY_CAMBER, told_apart_by="opposite camber",
)  # fmt: skip
CONICITY = Effect(
    id="conicity", family="lateral inputs",
    change=adds("force", lambda a, _, rows: PER_MILLE * a * rows.load * rows.fz),
    scale=25.0, unit="1e-3 F_z", formula="F_y + amplitude F_z",
    means="a lateral force in proportion to load stands at zero slip",
    remedy="measure again with the tire turned round, and take the mean",
    parameter="share", bounds=((-500.0, 500.0),), needs=("loads",),
    channels=("fy", "mz"), forms=(*SHIFT_BY_CAMBER, *FORCE_BY_LOAD),
    looks_like=("force_offset", "slip_offset"), told_apart_by="loads",
)  # fmt: skip

EFFECTS = (
    SLIP_OFFSET,
    FORCE_OFFSET,
    SLIP_DEFINITION,
    WHEEL_INERTIA,
    CAMBER_THRUST,
    CONICITY,
)
