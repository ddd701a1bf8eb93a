"""Effects of sensors and rigs: zeros that move, channels that leak into one another."""

import jax.numpy as jnp

from tirefit.diagnosis.effects.free_forms import (
    FORCE_BY_DIRECTION,
    FORCE_BY_LOAD,
    FRICTION_BY_LOAD,
    ONE_WAY,
    over,
    rise,
    weight,
)
from tirefit.diagnosis.effects.record import (
    PER_MILLE,
    Effect,
    adds,
    blend,
    multiplies,
    seldom,
)

_WARMING = 0.2
"""Way of a zero that settles as its amplifier warms up, as a share of the record."""


def _settled(rows, constants):
    """Even over the record, or quick at first; about its middle."""
    late = 0.5 - jnp.exp(-(rows.time + 0.5) / _WARMING)
    return blend(constants, rows.time, late)


def _force_drift(drift, constants, rows):
    return PER_MILLE * drift * rows.load * _settled(rows, constants)


def _force_hysteresis(size, constants, rows):
    plain, grown = constants
    way = rows.turning * rows.side * (plain + grown * rows.usage)
    return PER_MILLE * size * rows.load * way


SLIP_ZERO_DRIFT = Effect(
    id="slip_zero_drift", family="slip x time",
    change=adds("shift", lambda a, which, rows: a * _settled(rows, which)), scale=0.3,
    per=("slip",), unit="- of slip per record", formula="slip + amplitude t",
    means="the zero of the slip moves over the record",
    remedy="zero heading, steering or wheel speed between runs, and cut runs shorter",
    parameter="drift", bounds=((-6.0, 6.0),), odds=seldom, needs=("time",),
    variants=((1.0, 0.0), (0.0, 1.0)), forms=over("shift", 0.1, "time", ONE_WAY, rise),
    looks_like=("force_zero_drift", "stiffness_drift", "friction_drift"),
    told_apart_by="both signs",
)  # fmt: skip
FORCE_ZERO_DRIFT = Effect(
    id="force_zero_drift", family="force x time", change=adds("force", _force_drift),
    scale=35.0, unit="1e-3 mean F_z per record",
    formula="force + amplitude t; zero drift of strain gauges, Hoffmann 1989",
    means="the zero of the force sensor moves over the record",
    remedy="tare between runs; subtract the zeros before and after, shared by time",
    parameter="drift", bounds=((-700.0, 700.0),), odds=seldom, needs=("time",),
    variants=((1.0, 0.0), (0.0, 1.0)),
    forms=over("force", 0.01, "time", ONE_WAY, weight),
    looks_like=("slip_zero_drift", "friction_drift"), told_apart_by="both signs",
)  # fmt: skip
LOAD_CROSSTALK = Effect(
    id="load_crosstalk", family="force x load",
    change=adds("force", lambda a, _, rows: PER_MILLE * a * rows.load * rows.fz),
    scale=25.0, unit="1e-3 F_z",
    formula="F_x + amplitude F_z; crosstalk of a balance, or rolling resistance",
    means="a force in proportion to load stands at zero slip",
    remedy="calibrate the crosstalk of F_z; subtract the rolling resistance",
    parameter="share", bounds=((-500.0, 500.0),), odds=seldom, needs=("loads",),
    channels=("fx",), forms=FORCE_BY_LOAD, looks_like=("force_offset", "slip_offset"),
    told_apart_by="both signs",
)  # fmt: skip
LOAD_OFFSET = Effect(
    id="load_offset", family="friction x load",
    # A brush under another load is one of another friction: exact where the stiffness
    # does not follow the load.
    change=multiplies(
        "friction", lambda a, _, rows: 1 + PER_MILLE * a * (1 / rows.fz - 1)
    ),
    scale=60.0, unit="1e-3 mean F_z", formula="F_z + amplitude",
    means="the load is off by a constant",
    remedy="check the zero of the load cell, and the mass of rim and hub",
    bounds=((-400.0, 400.0),), odds=seldom, needs=("loads",), forms=FRICTION_BY_LOAD,
    looks_like=("load_friction", "load_stiffness"), told_apart_by="loads",
)  # fmt: skip
FORCE_CROSSTALK = Effect(
    id="force_crosstalk", family="force x force",
    change=adds("force", lambda a, _, rows: a * rows.across), scale=0.04,
    formula="force + amplitude (force across); crosstalk of a balance",
    means="the force across leaks into the force",
    remedy="calibrate the balance with pure forces, and check that it stands square",
    parameter="share", bounds=((-0.8, 0.8),), odds=seldom, needs=("other force",),
    looks_like=("combined_slip", "friction_ellipse"), told_apart_by="pure slip",
)  # fmt: skip
FORCE_HYSTERESIS = Effect(
    id="force_hysteresis", family="force x direction",
    change=adds("force", _force_hysteresis), scale=20.0, unit="1e-3 mean F_z",
    formula="force + amplitude sign(d slip / dt): dry friction in the rig",
    means="the force sensor reads otherwise on the way up than on the way down",
    remedy="grease or unload the guides of the sensor; take the mean of both ways",
    bounds=((-400.0, 400.0),), odds=seldom, needs=("sweeps",),
    variants=((1.0, 0.0), (0.0, 1.0)), forms=FORCE_BY_DIRECTION,
    looks_like=("friction_hysteresis", "channel_delay", "relaxation_length"),
    told_apart_by="two ramp rates",
)  # fmt: skip

EFFECTS = (
    SLIP_ZERO_DRIFT,
    FORCE_ZERO_DRIFT,
    LOAD_CROSSTALK,
    LOAD_OFFSET,
    FORCE_CROSSTALK,
    FORCE_HYSTERESIS,
)
