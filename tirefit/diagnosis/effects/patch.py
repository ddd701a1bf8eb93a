"""Effects of the contact patch and the carcass: pressure, two frictions, compliance."""

import jax.numpy as jnp

from tirefit.diagnosis.effects.free_forms import SHAPE_OF_THE_CURVE, SKEW_BY_LOAD
from tirefit.diagnosis.effects.record import Effect, adds, blend

_SKEWS = (-0.32, 0.95)
"""d of S(24) between which the pressure and its slope at the edge keep their signs."""

_FLATNESSES = (-0.6, 1.0)
"""Share of the quartic law S(25): from a pressure whose middle is a tenth higher than
that of the parabola, to the law itself."""


def _skewed(state, change):
    return state._replace(skew=jnp.clip(state.skew + change, *_SKEWS))


def _skew_with(state, d, constants, rows):
    moving = blend(constants, rows.force, rows.usage, jnp.log(rows.fz))
    return _skewed(state, d * moving)


def _flatness(state, share, constants, rows):
    return state._replace(flat=jnp.clip(state.flat + share, *_FLATNESSES))


PRESSURE_ASYMMETRY = Effect(
    id="pressure_asymmetry", family="pressure",
    change=lambda state, d, constants, rows: _skewed(state, d), scale=0.24,
    formula="p = 3/4 (1 - xi^2)(1 + d xi), S(24)",
    means="the contact pressure is skewed", remedy="fit brush-d", parameter="d",
    bounds=(_SKEWS,), forms=SHAPE_OF_THE_CURVE,
    looks_like=("carcass_flexibility", "pressure_flatness", "slip_definition"),
    told_apart_by="mz",
)  # fmt: skip
PRESSURE_FLATNESS = Effect(
    id="pressure_flatness", family="pressure", change=_flatness, scale=0.6,
    formula="p from the parabola towards 5/8 (1 - xi^4), S(25)",
    means="the contact pressure is flatter or sharper than a parabola",
    remedy="fit quartic or elliptic", parameter="share", bounds=(_FLATNESSES,),
    forms=SHAPE_OF_THE_CURVE, looks_like=("pressure_asymmetry", "carcass_flexibility"),
    told_apart_by="mz",
)  # fmt: skip
KINETIC_FRICTION = Effect(
    id="kinetic_friction", family="friction",
    change=adds("static", lambda a, constants, rows: a), scale=0.25,
    formula="mu_k = mu_s / (1 + amplitude), S(31)",
    means="friction falls once the bristles slide", remedy="fit brush-m",
    parameter="mu_s / mu_k - 1",
    bounds=((0.0, 4.0),),  # rubber that slides keeps a fifth of its grip and more
    forms=SHAPE_OF_THE_CURVE, singular=True, told_apart_by="speeds",
)  # fmt: skip
PRESSURE_SHIFT = Effect(
    id="pressure_shift_load", family="pressure x force", change=_skew_with, scale=0.24,
    formula="d moves by amplitude F / (mu F_z), or with the load, S 4.1",
    means="the contact pressure shifts with force or load",
    remedy="fit brush-d-force or brush-d-load", parameter="d",
    bounds=((-2.0, 2.0),),  # of d over the whole range, which d itself cannot exceed
    variants=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), forms=SKEW_BY_LOAD,
    looks_like=("pressure_asymmetry",), told_apart_by="loads",
)  # fmt: skip
CARCASS = Effect(
    id="carcass_flexibility", family="structure",
    # With the base model's force: the slip that it takes up is small.
    change=adds("shift", lambda a, _, rows: -a * rows.traction), scale=0.5,
    per=("slip",), formula="slip - amplitude F / F_z, S(15)",
    means="the carcass gives way with the force",
    remedy="use a carcass of tirefit.models.carcass; M_z tells it from skewed pressure",
    parameter="compliance", bounds=((0.0, 10.0),), forms=SHAPE_OF_THE_CURVE,
    looks_like=("pressure_asymmetry", "pressure_flatness"), told_apart_by="mz",
)  # fmt: skip

EFFECTS = (
    PRESSURE_ASYMMETRY,
    PRESSURE_FLATNESS,
    KINETIC_FRICTION,
    PRESSURE_SHIFT,
    CARCASS,
)
