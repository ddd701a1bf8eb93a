"""Effects of the tire: contact patch and carcass, and friction or stiffness that varies
with speed, load, temperature, inflation, time, work, direction, side or other slip."""

from functools import partial

import numpy as np

from tirefit.diagnosis.effects.record import (
    LEAST_FACTOR,
    Code,
    Constants,
    adds,
    blend,
    multiplies,
    scaled,
    xp,
)
from tirefit.diagnosis.effects.state import Covariates, State
from tirefit.diagnosis.engine import FLAT
from tirefit.params import Values

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

_STRETCHES = tuple(
    (begin / 20, (begin + length) / 20)
    for length, begins in ((3, range(-8, 8, 2)), (7, range(-8, 4, 2)))
    for begin in begins
)
"""Begin and end of a stretch of another road, in the same unit: 1/7 and 1/3 of the record."""


def _skewed(state: State, change: Values | float) -> State:
    return state._replace(skew=xp.clip(state.skew + change, *_SKEWS))


def _kinetic_times(state: State, factor: Values | float) -> State:
    return state._replace(kinetic=state.kinetic * xp.maximum(factor, 1e-3))


def _linear_loss(state: State, loss: float, constants: Constants, rows: Covariates) -> State:
    kinetic, sliding, rolling = constants
    state = _kinetic_times(state, 1 - kinetic * loss * rows.sliding)
    return scaled(state, "friction", 1 - loss * (sliding * rows.sliding + rolling * rows.v))


def _fall(state: State, share: float, constants: Constants, rows: Covariates) -> State:
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


def _which_speed(constants: Constants, rows: Covariates, time: np.ndarray) -> str:
    kinetic, sliding, _ = constants
    how = "with the sliding speed" if kinetic or sliding else "with the speed of travel"
    return f"{_ALONE if kinetic else _ALL}, {how}"


def _which_fall(constants: Constants, rows: Covariates, time: np.ndarray) -> str:
    v_st, exponent, both = constants
    law = f"with exponent e = {exponent:g}" if exponent else "by log(1 + v_s / v_st)"
    v_st = v_st * float(np.max(rows.brisk))
    return f"{_ALL if both else _ALONE}, {law}, v_st = {v_st:.3g} m/s"


def _which_power(constants: Constants, rows: Covariates, time: np.ndarray) -> str:
    laws = "a power of the load", "in proportion to F_z / F_z0 - 1"
    return (*laws, "in proportion to log(F_z / F_z0)")[int(np.argmax(constants))]


def _which_drift(constants: Constants, rows: Covariates, time: np.ndarray) -> str:
    even, way = constants
    return "evenly" if even else f"quick at first, as exp(-t / {way * float(np.ptp(time)):.3g} s)"


def _which_step(constants: Constants, rows: Covariates, time: np.ndarray) -> str:
    share, order = np.asarray(rows.time)[: len(time)], np.argsort(time, kind="stable")
    inside = (share > constants[0]) & (share < constants[1])
    turns = np.flatnonzero(np.diff(inside[order]))
    at = [f"{t:.4g}" for t in (time[order][turns] + time[order][turns + 1]) / 2]
    if len(at) == 1:
        return f"from {at[0]} s on"
    return f"from {at[0]} to {at[1]} s" if at else ""


def _drift(share: float, constants: Constants, rows: Covariates) -> Values | float:
    """A drift that is linear over the record, or fast at first as 1 - exp(-t / tau); zero
    at the middle."""
    even, way = constants
    late = 0.5 - xp.exp(-(rows.time + 0.5) / way)
    return 1 + share * blend((even, 1 - even), rows.time, late)


def _step(share: float, constants: Constants, rows: Covariates) -> np.ndarray:
    """A change at one time, or between two times."""
    begin, end = constants
    return 1 + share * xp.where((rows.time > begin) & (rows.time < end), 0.5, -0.5)


def _other(state: State, share: float, constants: Constants, rows: Covariates) -> State:
    """Both slips share the friction in the patch, or the force is multiplied by a weight
    that falls with the other slip, cos(arctan B alpha), Pacejka 4.3.2."""
    shared, weighted = constants
    # Stiffness times slip is 3 (1 - 2^(-1/3)) of the friction at half the force of a brush.
    taken = share * 0.62 * rows.other / (rows.rise * rows.fz)
    factor = 1 - weighted * (1 - 1 / xp.sqrt(1 + taken**2))
    state = state._replace(other=state.other + shared * share * rows.other)
    return scaled(scaled(state, "friction", factor), "stiffness", factor)


def _with_load(
    name: str, state: State, amplitude: float, constants: Constants, rows: Covariates
) -> State:
    """A dependence on the load: a power, linear, or linear in its logarithm."""
    linear = xp.maximum(1 + amplitude * (rows.fz - 1), LEAST_FACTOR)
    slow = xp.maximum(1 + amplitude * xp.log(rows.fz), LEAST_FACTOR)
    factor = blend(constants, rows.fz**amplitude, linear, slow)
    return state._replace(**{name: getattr(state, name) * factor})


def _by_condition(name: str) -> Code:
    """Friction or stiffness with load, temperature, time, pressure, work."""
    return {
        f"load_{name}": dict(change=partial(_with_load, name), which=_which_power),
        f"{name}_temperature": multiplies(name, lambda a, _, rows: 1 + a * rows.temperature),
        f"{name}_drift": dict(change=multiplies(name, _drift), which=_which_drift),
        f"{name}_pressure": multiplies(name, lambda a, _, rows: 1 + a * rows.inflation),
        f"{name}_warming": multiplies(name, lambda a, c, rows: 1 + (a * rows.work) @ xp.asarray(c)),
    }


CODE: Code = {
    "pressure_asymmetry": dict(change=lambda state, d, *_: _skewed(state, d), bounds=(_SKEWS,)),
    "pressure_flatness": dict(
        change=lambda state, a, *_: state._replace(flat=xp.clip(state.flat + a, *_FLATNESSES)),
        bounds=(_FLATNESSES,),
    ),
    "kinetic_friction": adds("static", lambda a, constants, rows: a),
    "pressure_shift_load": lambda state, d, c, rows: _skewed(
        state, d * blend(c, rows.force, rows.usage, xp.log(rows.fz))
    ),
    # With the force of the base model, as the slip that the carcass takes is small.
    "carcass_flexibility": adds("shift", lambda a, _, rows: -a * rows.traction),
    "friction_speed_linear": dict(change=_linear_loss, which=_which_speed),
    "friction_speed_exponential": dict(
        change=_fall,
        which=_which_fall,
        variants=tuple((*fall, both) for both in (0.0, 1.0) for fall in _FALLS),
    ),
    **_by_condition("friction"),
    **_by_condition("stiffness"),
    "friction_step": dict(
        change=multiplies("friction", _step),
        which=_which_step,
        # A change that lasts ends outside the record.
        variants=(*((at, 1.0) for at in STEPS), *_STRETCHES),
    ),
    "friction_hysteresis": multiplies("friction", lambda a, _, rows: 1 + 0.5 * a * rows.turning),
    "drive_brake_asymmetry": multiplies("friction", lambda a, _, rows: 1 + 0.5 * a * rows.side),
    "combined_slip": _other,
    "stiffness_speed": multiplies("stiffness", lambda a, _, rows: (rows.pace / rows.cruise) ** a),
}
