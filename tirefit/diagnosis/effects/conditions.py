"""Effects of the conditions: friction or stiffness that varies with speed, load,
temperature, time, direction, side or the other slip."""

import jax.numpy as jnp
import numpy as np

from tirefit.diagnosis.effects.free_forms import (
    BOTH_WAYS,
    BY_OTHER_SLIP,
    BY_SIDE,
    FRICTION_BY_DIRECTION,
    FRICTION_BY_LOAD,
    FRICTION_BY_SPEED,
    ONE_WAY,
    over,
)
from tirefit.diagnosis.effects.record import (
    LEAST_FACTOR,
    SHARE,
    SYMBOLS,
    Effect,
    blend,
    multiplies,
    scaled,
)
from tirefit.diagnosis.negligible import FLAT

_FALLS = ((0.15, 1.0), (0.6, 1.0), (0.6, 0.5), (2.0, 1.0), (4.0, 0.5))
"""(v_st over the largest sliding speed of the file, exponent) of the exponential falls
of friction that are tried, S(37)."""

_LOGARITHM = (0.1, 0.0)
"""The same for a fall by the logarithm of 1 + v_s / v_st; no exponent says so."""

STEPS = tuple(float(t) for t in np.linspace(-0.42, 0.42, 15))
"""Times of a sudden change that are tried, as shares of the record about its middle."""

_NO_END = 1.0
"""A change that lasts: its end lies outside the record."""

_STRETCHES = tuple(
    (begin / 20, (begin + length) / 20)
    for length, begins in ((3, range(-8, 8, 2)), (7, range(-8, 4, 2)))
    for begin in begins
)
"""Begin and end of a stretch of another road, in the same unit: a seventh and a third
of the record."""

_WEAR = (0.12, 0.35)
"""Ways of a change that is quick at first, as shares of the record."""


_POWERS = (-3.0, 3.0)
"""Powers of the load that stiffness or friction may follow: tires have -0.3 to 1."""

_OF_FRICTION = 0.62
"""Force by the stiffness alone over the friction, at the slip of half the largest
force: 3 (1 - 2^(-1/3)) of a brush."""

_LEAST_KINETIC = 1e-3
"""Kinetic friction over its usual value, at least: it may fall to nearly nothing."""


def _kinetic_times(state, factor):
    return state._replace(kinetic=state.kinetic * jnp.maximum(factor, _LEAST_KINETIC))


def _linear_loss(state, loss, constants, rows):
    kinetic, sliding, rolling = constants
    state = _kinetic_times(state, 1 - kinetic * loss * rows.sliding)
    falls = sliding * rows.sliding + rolling * rows.v
    return scaled(state, "friction", 1 - loss * falls)


def _fall(state, share, constants, rows):
    """Factor 1 - share (1 - exp(-(v_s / v_st)^exponent)), S(37), or by the logarithm,
    on the kinetic friction alone, or on both. A share below zero is a rise."""
    v_st, exponent, both = constants
    # The power has no slope at rest, where the patch slides nowhere.
    speed = jnp.maximum(rows.sliding / rows.brisk, FLAT) / v_st
    decay = -jnp.expm1(-(speed ** jnp.where(exponent > 0, exponent, 1.0)))
    # As much at the largest sliding speed of the file as the share says.
    slow = jnp.log1p(speed) / jnp.log1p(1 / v_st)
    fall = share * jnp.where(exponent > 0, decay, slow)
    state = _kinetic_times(state, 1 - (1 - both) * fall)
    return scaled(state, "friction", 1 - both * fall)


_ALONE, _ALL = "of the kinetic friction alone", "of static and kinetic friction alike"


def _which_speed(constants, rows, time) -> str:
    kinetic, sliding, _ = constants
    how = "with the sliding speed" if kinetic or sliding else "with the speed of travel"
    return f"{_ALONE if kinetic else _ALL}, {how}"


def _which_fall(constants, rows, time) -> str:
    v_st, exponent, both = constants
    law = f"with exponent e = {exponent:g}" if exponent else "by log(1 + v_s / v_st)"
    v_st = v_st * float(np.max(rows.brisk))
    return f"{_ALL if both else _ALONE}, {law}, v_st = {v_st:.3g} m/s"


def _which_power(constants, rows, time) -> str:
    laws = "a power of the load", "in proportion to F_z / F_z0 - 1"
    return (*laws, "in proportion to log(F_z / F_z0)")[int(np.argmax(constants))]


def _which_drift(constants, rows, time) -> str:
    even, way = constants
    lasts = way * float(np.ptp(time))
    return "evenly" if even else f"quick at first, as exp(-t / {lasts:.3g} s)"


def _which_step(constants, rows, time) -> str:
    begin, end, shaped = constants
    change, share = (np.asarray(v)[: len(time)] for v in (rows.change, rows.time))
    inside = change > 0 if shaped else (share > begin) & (share < end)
    order = np.argsort(time, kind="stable")
    turns = np.flatnonzero(np.diff(inside[order]))
    at = [f"{t:.4g}" for t in (time[order][turns] + time[order][turns + 1]) / 2]
    if len(at) == 1:
        return f"from {at[0]} s on"
    return f"from {at[0]} to {at[1]} s" if at else ""


def _with_load(name):
    """A power of the load, linear in it or in its logarithm."""

    def change(state, amplitude, constants, rows):
        linear = jnp.maximum(1 + amplitude * (rows.fz - 1), LEAST_FACTOR)
        slow = jnp.maximum(1 + amplitude * jnp.log(rows.fz), LEAST_FACTOR)
        factor = blend(constants, rows.fz**amplitude, linear, slow)
        return state._replace(**{name: getattr(state, name) * factor})

    return change


def _drift(share, constants, rows):
    """Even over the record, or quick at first: 1 - exp(-t / way), about its middle."""
    even, way = constants
    late = 0.5 - jnp.exp(-(rows.time + 0.5) / way)
    return 1 + share * blend((even, 1 - even), rows.time, late)


def _step(share, constants, rows):
    """At one time, between two, or in the shape that was found."""
    begin, end, shaped = constants
    sudden = jnp.where((rows.time > begin) & (rows.time < end), 0.5, -0.5)
    shape = blend((1 - shaped, shaped), sudden, rows.change)
    return 1 + share * shape


def _other(state, share, constants, rows):
    """The slips share the friction as in the patch, or the force falls with the other
    slip by a weight of its own, cos(arctan B alpha), Pacejka 4.3.2."""
    shared, weighted = constants
    taken = share * _OF_FRICTION * rows.other / (rows.rise * rows.fz)
    factor = 1 - weighted * (1 - 1 / jnp.sqrt(1 + taken**2))
    state = state._replace(other=state.other + shared * share * rows.other)
    return scaled(scaled(state, "friction", factor), "stiffness", factor)


_SPLIT = "fit the two parts as runs of their own"
_PER_RUN = "cut the record into runs and fit {} per run"
_DRIFTS = ((1.0, 1.0), *((0.0, way) for way in _WEAR))


def _drifting(name: str, parameter: str, scale: float, forms, *looks_like: str):
    return Effect(
        id=f"{name}_drift", family=f"{name} x time", change=multiplies(name, _drift),
        scale=scale, unit="per record", formula=f"{SYMBOLS[name]} (1 + amplitude t)",
        means=f"{name} changes slowly over the record",
        remedy=_PER_RUN.format(parameter), bounds=(SHARE,), needs=("time",),
        variants=_DRIFTS, which=_which_drift, forms=forms,
        looks_like=(f"load_{name}", f"{name}_temperature", *looks_like),
        told_apart_by="random order",
    )  # fmt: skip


def _heated(name: str, parameter: str, scale: float, size: float):
    return Effect(
        id=f"{name}_temperature", family=f"{name} x temperature",
        change=multiplies(name, lambda a, _, rows: 1 + a * rows.temperature),
        scale=scale, unit="per 20 K",
        formula=f"{SYMBOLS[name]} (1 + amplitude (T - T0) / 20 K)",
        means=f"{name} changes with temperature",
        remedy=f"fit {parameter} for each range of temperature", bounds=(SHARE,),
        per=("temperature",), needs=("temperature",),
        forms=over(name, size, "temperature", BOTH_WAYS), looks_like=(f"{name}_drift",),
        told_apart_by="random order",
    )  # fmt: skip


def _loaded(name: str, scale: float, forms, looks_like):
    return Effect(
        id=f"load_{name}", family=f"{name} x load", change=_with_load(name),
        scale=scale, formula=f"{SYMBOLS[name]} (F_z / F_z0)^amplitude, S 2.1",
        means=f"{name} is a power of the load", remedy="fit brush-load",
        parameter="power", bounds=(_POWERS,), needs=("loads",),
        variants=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        which=_which_power, forms=forms, looks_like=looks_like,
        told_apart_by="random order",
    )  # fmt: skip


_BY_TIME = over("friction", 0.02, "time", ONE_WAY)

SPEED_LINEAR = Effect(
    id="friction_speed_linear", family="friction x speed", change=_linear_loss,
    scale=0.1, per=("sliding", "sliding", "rolling"), unit="s/m",
    formula="mu_k = mu (1 - amplitude v_s), S(35)",
    means="friction changes in proportion to the speed",
    remedy="fit brush-n; where all friction changes, mu for each speed",
    parameter="n / mu", bounds=((-2.0, 2.0),), needs=("v",),
    variants=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), which=_which_speed,
    forms=FRICTION_BY_SPEED, looks_like=("friction_speed_exponential",),
    told_apart_by="speeds",
)  # fmt: skip
SPEED_EXPONENTIAL = Effect(
    id="friction_speed_exponential", family="friction x speed", change=_fall, scale=0.2,
    formula="mu_k = mu (h + (1 - h) exp(-(v_s / v_st)^e)), S(37)",
    means="friction changes with the sliding speed, most of it at low speeds",
    remedy="fit brush-h with this v_st; where all friction changes, mu for each speed",
    parameter="1 - h",
    bounds=((-1.0, 1.0),),  # rubber that slides slowly grips the more, the faster
    needs=("v",),
    variants=tuple(
        (*fall, both) for both in (0.0, 1.0) for fall in (*_FALLS, _LOGARITHM)
    ),
    which=_which_fall, forms=FRICTION_BY_SPEED, looks_like=("friction_speed_linear",),
    told_apart_by="speeds",
)  # fmt: skip
STEP = Effect(
    id="friction_step", family="friction x time", change=multiplies("friction", _step),
    scale=0.15, formula="mu changes by amplitude at one time, or between two",
    means="friction changes at one time, or for a stretch",
    remedy="cut the record there and fit mu per run", bounds=(SHARE,), needs=("time",),
    variants=(
        *((at, _NO_END, 0.0) for at in STEPS),
        *((*stretch, 0.0) for stretch in _STRETCHES),
        (0.0, _NO_END, 1.0),
    ),
    forms=_BY_TIME, which=_which_step,
    during=lambda constants: (constants[0], constants[1]), scans_time=True,
    looks_like=("friction_drift",), told_apart_by="random order",
)  # fmt: skip
HYSTERESIS = Effect(
    id="friction_hysteresis", family="friction x direction",
    change=multiplies("friction", lambda a, _, rows: 1 + 0.5 * a * rows.turning),
    scale=0.06, formula="mu differs by amplitude between growing and shrinking slip",
    means="friction differs between growing and shrinking slip", remedy=_SPLIT,
    bounds=((-1.2, 1.2),), needs=("sweeps",), forms=FRICTION_BY_DIRECTION,
    looks_like=("channel_delay", "relaxation_length"), told_apart_by="two ramp rates",
)  # fmt: skip
ASYMMETRY = Effect(
    id="drive_brake_asymmetry", family="friction x sign",
    change=multiplies("friction", lambda a, _, rows: 1 + 0.5 * a * rows.side),
    scale=0.12, formula="mu differs by amplitude between the two signs of slip",
    means="friction differs between the two signs of slip", remedy=_SPLIT,
    bounds=(SHARE,), needs=("signs",), forms=BY_SIDE, looks_like=("force_offset",),
    told_apart_by="loads",
)  # fmt: skip
COMBINED = Effect(
    id="combined_slip", family="inputs", change=_other, scale=0.15,
    formula="the other slip shares the friction",
    means="the other slip takes its part of the friction",
    remedy="fit brush-anisotropic or magic-formula-combined to both slips",
    parameter="share", bounds=((-3.0, 3.0),), center=1.0, needs=("other slip",),
    variants=((1.0, 0.0), (0.0, 1.0)), forms=BY_OTHER_SLIP, singular=True,
    told_apart_by="pure slip",
)  # fmt: skip

EFFECTS = (
    SPEED_LINEAR,
    SPEED_EXPONENTIAL,
    _loaded(
        "stiffness", 0.5, over("stiffness", 0.06, "fz", ONE_WAY), ("stiffness_drift",)
    ),
    _loaded("friction", 0.12, FRICTION_BY_LOAD, ("friction_drift", "force_offset")),
    _heated("friction", "mu", 0.15, 0.03),
    _heated("stiffness", "cpa2", 0.2, 0.06),
    _drifting("friction", "mu", 0.12, _BY_TIME, "friction_step"),
    _drifting("stiffness", "cpa2", 0.18, over("stiffness", 0.04, "time", ONE_WAY)),
    STEP,
    HYSTERESIS,
    ASYMMETRY,
    COMBINED,
)
