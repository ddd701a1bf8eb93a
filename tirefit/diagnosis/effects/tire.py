"""Effects of the tire: contact patch and carcass, and friction or stiffness that varies
with speed, load, temperature, inflation, time, work, direction, side or other slip."""

from functools import partial
from typing import Any

import numpy as np

from tirefit.diagnosis.effects.record import (
    LEAST_FACTOR,
    SHARE,
    SYMBOLS,
    Effect,
    adds,
    blend,
    choices,
    multiplies,
    scaled,
    seldom,
    xp,
)
from tirefit.diagnosis.engine import FLAT

_SKEWS = (-0.32, 0.95)
"""Range of d of S(24) in which the pressure and its slope at the edge keep their signs."""

_FLATNESSES = (-0.6, 1.0)
"""Range of the share of the quartic law S(25): from a pressure with a middle a tenth
higher than that of the parabola, to the law itself."""

_FALLS = ((0.15, 1.0), (0.6, 1.0), (0.6, 0.5), (2.0, 1.0), (4.0, 0.5), (0.1, 0.0))
"""(v_st over the largest sliding speed of the file, exponent) of the falls of friction
that are tried: exponential, S(37), and with exponent 0 by log(1 + v_s / v_st)."""

STEPS = tuple(float(t) for t in np.linspace(-0.45, 0.45, 25))
"""Times of a sudden change that are tried, as shares of the record about its middle."""

_NO_END = 1.0  # end, outside the record, of a change that lasts

_STRETCHES = tuple(
    (begin / 20, (begin + length) / 20)
    for length, begins in ((3, range(-8, 8, 2)), (7, range(-8, 4, 2)))
    for begin in begins
)
"""Begin and end of a stretch of another road, in the same unit: 1/7 and 1/3 of the record."""

_DRIFTS = ((1.0, 1.0), (0.0, 0.12), (0.0, 0.35))
"""(1 for a linear drift, else 0; time constant of a drift that is fast at first, as a
share of the record)."""

_POWERS = (-3.0, 3.0)
"""Bounds of the power of the load for stiffness and friction; tires have -0.3 to 1."""

_OF_FRICTION = 0.62
"""Stiffness times slip over friction at the slip of half the largest force; a brush has
3 (1 - 2^(-1/3))."""

_LEAST_KINETIC = 1e-3  # smallest kinetic friction over its usual value


def _skewed(state, change):
    return state._replace(skew=xp.clip(state.skew + change, *_SKEWS))


def _skew_with(state, d, constants, rows):
    moving = blend(constants, rows.force, rows.usage, xp.log(rows.fz))
    return _skewed(state, d * moving)


def _kinetic_times(state, factor):
    return state._replace(kinetic=state.kinetic * xp.maximum(factor, _LEAST_KINETIC))


def _linear_loss(state, loss, constants, rows):
    kinetic, sliding, rolling = constants
    state = _kinetic_times(state, 1 - kinetic * loss * rows.sliding)
    falls = sliding * rows.sliding + rolling * rows.v
    return scaled(state, "friction", 1 - loss * falls)


def _fall(state, share, constants, rows):
    """Factor 1 - share (1 - exp(-(v_s / v_st)^exponent)), S(37), or with the logarithm,
    on the kinetic friction or on both. A negative share is a rise."""
    v_st, exponent, both = constants
    # The power is not differentiable at rest, where the patch does not slide.
    speed = xp.maximum(rows.sliding / rows.brisk, FLAT) / v_st
    # The share is the loss at the largest sliding speed of the file.
    if exponent:
        fall = -share * xp.expm1(-(speed**exponent))
    else:
        fall = share * xp.log1p(speed) / xp.log1p(1 / v_st)
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
    begin, end = constants
    share = np.asarray(rows.time)[: len(time)]
    inside = (share > begin) & (share < end)
    order = np.argsort(time, kind="stable")
    turns = np.flatnonzero(np.diff(inside[order]))
    at = [f"{t:.4g}" for t in (time[order][turns] + time[order][turns + 1]) / 2]
    if len(at) == 1:
        return f"from {at[0]} s on"
    return f"from {at[0]} to {at[1]} s" if at else ""


def _drift(share, constants, rows):
    """A drift that is linear over the record, or fast at first as 1 - exp(-t / tau); zero
    at the middle."""
    even, way = constants
    late = 0.5 - xp.exp(-(rows.time + 0.5) / way)
    return 1 + share * blend((even, 1 - even), rows.time, late)


def _step(share, constants, rows):
    """A change at one time, or between two times."""
    begin, end = constants
    return 1 + share * xp.where((rows.time > begin) & (rows.time < end), 0.5, -0.5)


def _other(state, share, constants, rows):
    """Both slips share the friction in the patch, or the force is multiplied by a weight
    that falls with the other slip, cos(arctan B alpha), Pacejka 4.3.2."""
    shared, weighted = constants
    taken = share * _OF_FRICTION * rows.other / (rows.rise * rows.fz)
    factor = 1 - weighted * (1 - 1 / xp.sqrt(1 + taken**2))
    state = state._replace(other=state.other + shared * share * rows.other)
    return scaled(scaled(state, "friction", factor), "stiffness", factor)


def _with_load(name, state, amplitude, constants, rows):
    """A dependence on the load: a power, linear, or linear in its logarithm."""
    linear = xp.maximum(1 + amplitude * (rows.fz - 1), LEAST_FACTOR)
    slow = xp.maximum(1 + amplitude * xp.log(rows.fz), LEAST_FACTOR)
    factor = blend(constants, rows.fz**amplitude, linear, slow)
    return state._replace(**{name: getattr(state, name) * factor})


def _by_condition(name: str, fitted: str, scales, like_load, like_time) -> tuple[Effect, ...]:
    """Effects of friction or stiffness with load, temperature, time, pressure, work."""
    symbol, range_of_file = SYMBOLS[name], "over its range in the file"

    def effect(id, covariate, scale, change, bounds=SHARE, **given: Any) -> Effect:
        return Effect(
            id=id,
            family=f"{name} x {covariate}",
            scale=scale,
            change=change,
            bounds=(bounds,),
            told_apart_by="random order",
            **given,
        )

    drift, temperature = f"{name}_drift", f"{name}_temperature"
    return (
        effect(
            f"load_{name}", "load", scales[0], partial(_with_load, name),
            formula=f"{symbol} (F_z / F_z0)^amplitude, S 2.1", remedy="fit brush-load",
            means=f"{name} is a power of the load", parameter="power", needs=("loads",),
            bounds=_POWERS, which=_which_power, variants=choices(3),
            looks_like=(drift, *like_load),
        ),
        effect(
            temperature, "temperature", scales[1],
            multiplies(name, lambda a, _, rows: 1 + a * rows.temperature),
            unit="per 20 K", formula=f"{symbol} (1 + amplitude (T - T0) / 20 K)",
            per=("temperature",), means=f"{name} changes with temperature",
            needs=("temperature",), looks_like=(drift,),
            remedy=f"fit {fitted} for each range of temperature",
        ),
        effect(
            drift, "time", scales[2], multiplies(name, _drift), unit="per record",
            which=_which_drift, formula=f"{symbol} (1 + amplitude t)", needs=("time",),
            variants=_DRIFTS, means=f"{name} changes slowly over the record",
            remedy=f"cut the record into runs and fit {fitted} per run",
            looks_like=(f"load_{name}", temperature, *like_time),
        ),
        effect(
            f"{name}_pressure", "inflation", scales[3],
            multiplies(name, lambda a, _, rows: 1 + a * rows.inflation),
            unit=range_of_file, means=f"{name} changes with the inflation pressure",
            formula=f"{symbol} (1 + amplitude (p - p0) / range), Besselink 2010",
            needs=("pressure",), remedy=f"fit {fitted} for each pressure",
            looks_like=(drift, temperature),
        ),
        effect(
            f"{name}_warming", "work", scales[4],
            multiplies(name, lambda a, c, rows: 1 + (a * rows.work) @ xp.asarray(c)),
            unit=range_of_file, odds=seldom, needs=("work", "v"), variants=choices(3),
            formula=f"{symbol} (1 + amplitude W), dW/dt = |F| v_s - W / cooling",
            means=f"{name} follows the work of sliding: the tire warms up or wears",
            remedy="measure the temperature; warm up first and pause between runs",
            looks_like=(drift, temperature),
        ),
    )  # fmt: skip


_FRICTION = _by_condition(
    "friction", "mu", (0.12, 0.15, 0.12, 0.12, 0.15), ("force_offset",), ("friction_step",)
)
_STIFFNESS = _by_condition("stiffness", "cpa2", (0.5, 0.2, 0.18, 0.2, 0.2), (), ())

PATCH = (
    Effect(
        id="pressure_asymmetry", family="pressure", scale=0.24, remedy="fit brush-d",
        change=lambda state, d, constants, rows: _skewed(state, d), parameter="d",
        formula="p = 3/4 (1 - xi^2)(1 + d xi), S(24)", bounds=(_SKEWS,),
        means="the contact pressure is skewed",
        looks_like=("carcass_flexibility", "pressure_flatness", "slip_definition"),
        told_apart_by="mz",
    ),
    Effect(
        id="pressure_flatness", family="pressure", scale=0.6,
        change=lambda state, share, constants, rows: state._replace(
            flat=xp.clip(state.flat + share, *_FLATNESSES)
        ),
        formula="p from the parabola towards 5/8 (1 - xi^4), S(25)", parameter="share",
        means="the contact pressure is flatter or sharper than a parabola",
        remedy="fit quartic or elliptic", bounds=(_FLATNESSES,), told_apart_by="mz",
        looks_like=("pressure_asymmetry", "carcass_flexibility"),
    ),
    Effect(
        id="kinetic_friction", family="friction",
        change=adds("static", lambda a, constants, rows: a), scale=0.25,
        formula="mu_k = mu_s / (1 + amplitude), S(31)",
        means="friction falls when the bristles begin to slide", remedy="fit brush-m",
        parameter="mu_s / mu_k - 1", bounds=((0.0, 4.0),),  # a fifth of the grip stays
        singular=True, told_apart_by="speeds",
    ),
    Effect(
        id="pressure_shift_load", family="pressure x force", change=_skew_with,
        scale=0.24, means="the contact pressure shifts with force or load",
        formula="d moves by amplitude F / (mu F_z), or with the load, S 4.1",
        remedy="fit brush-d-force or brush-d-load", parameter="d", variants=choices(3),
        told_apart_by="loads", bounds=((-2.0, 2.0),),
        looks_like=("pressure_asymmetry",),
    ),
    Effect(
        id="carcass_flexibility", family="structure",
        # With the force of the base model, as the slip that the carcass takes is small.
        change=adds("shift", lambda a, _, rows: -a * rows.traction), scale=0.5,
        per=("slip",), formula="slip - amplitude F / F_z, S(15)",
        means="the carcass yields under the force",
        remedy="fit a model of tirefit.models.carcass; M_z separates it from pressure",
        parameter="compliance", bounds=((0.0, 10.0),),
        looks_like=("pressure_asymmetry", "pressure_flatness"), told_apart_by="mz",
    ),
)  # fmt: skip

_BY_SPEED = (
    Effect(
        id="friction_speed_linear", family="friction x speed", change=_linear_loss,
        scale=0.1, per=("sliding", "sliding", "rolling"), unit="s/m", needs=("v",),
        formula="mu_k = mu (1 - amplitude v_s), S(35)", parameter="n / mu",
        means="friction changes in proportion to the speed", bounds=((-2.0, 2.0),),
        remedy="fit brush-n; where all friction changes, mu for each speed",
        variants=choices(3), which=_which_speed,
        looks_like=("friction_speed_exponential",), told_apart_by="speeds",
    ),
    Effect(
        id="friction_speed_exponential", family="friction x speed", change=_fall,
        scale=0.2, formula="mu_k = mu (h + (1 - h) exp(-(v_s / v_st)^e)), S(37)",
        means="friction changes with the sliding speed, most of it at low speeds",
        remedy="fit brush-h with this v_st; where all friction changes, mu for each"
        " speed", parameter="1 - h",
        bounds=((-1.0, 1.0),),  # at low sliding speeds, the friction of rubber may rise
        needs=("v",), which=_which_fall,
        variants=tuple((*fall, both) for both in (0.0, 1.0) for fall in _FALLS),
        looks_like=("friction_speed_linear",), told_apart_by="speeds",
    ),
)  # fmt: skip
_BY_STATE = (
    Effect(
        id="friction_step", family="friction x time", scale=0.15, bounds=(SHARE,),
        change=multiplies("friction", _step), needs=("time",),
        formula="mu changes by amplitude at one time, or between two",
        means="friction changes at one time, or for a stretch", which=_which_step,
        remedy="cut the record there and fit mu per run", told_apart_by="random order",
        variants=(
            *((at, _NO_END) for at in STEPS), *_STRETCHES,
        ), during=lambda constants: (constants[0], constants[1]),
        looks_like=("friction_drift",),
    ),
    Effect(
        id="friction_hysteresis", family="friction x direction", scale=0.06,
        change=multiplies("friction", lambda a, _, rows: 1 + 0.5 * a * rows.turning),
        formula="mu differs by amplitude between growing and shrinking slip",
        means="friction differs between growing and shrinking slip", needs=("sweeps",),
        remedy="fit the two parts as separate runs", bounds=((-1.2, 1.2),),
        told_apart_by="two ramp rates",
        looks_like=("channel_delay", "relaxation_length"),
    ),
    Effect(
        id="drive_brake_asymmetry", family="friction x sign", scale=0.12,
        change=multiplies("friction", lambda a, _, rows: 1 + 0.5 * a * rows.side),
        formula="mu differs by amplitude between the two signs of slip",
        means="friction differs between the two signs of slip", bounds=(SHARE,),
        remedy="fit the two parts as separate runs", needs=("signs",),
        looks_like=("force_offset",), told_apart_by="loads",
    ),
    Effect(
        id="combined_slip", family="inputs", change=_other, scale=0.15, center=1.0,
        formula="the other slip shares the friction", parameter="share", singular=True,
        means="the other slip uses a part of the friction", bounds=((-3.0, 3.0),),
        remedy="fit brush-anisotropic or magic-formula-combined to both slips",
        needs=("other slip",), variants=choices(2),
        told_apart_by="pure slip",
    ),
)  # fmt: skip

CONDITIONS = (
    *_BY_SPEED,
    _STIFFNESS[0],
    _FRICTION[0],
    _FRICTION[1],
    _STIFFNESS[1],
    _FRICTION[2],
    _STIFFNESS[2],
    *_BY_STATE,
)

WARMTH = (
    _FRICTION[3], _STIFFNESS[3], _FRICTION[4], _STIFFNESS[4],
    Effect(
        id="stiffness_speed", family="stiffness x speed", scale=0.12, parameter="power",
        change=multiplies(
            "stiffness", lambda a, _, rows: (rows.pace / rows.cruise) ** a
        ), formula="c_p a^2 (v / v0)^amplitude", remedy="fit cpa2 for each speed",
        means="stiffness is a power of the speed: rubber and belt stiffen", odds=seldom,
        bounds=((-1.5, 1.5),), needs=("speeds",), told_apart_by="speeds",
        looks_like=("relaxation_length", "stiffness_drift"),
    ),
)  # fmt: skip
