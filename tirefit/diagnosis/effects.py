"""The library of unmodelled effects: one record each.

An effect is a name and a change of :class:`tirefit.diagnosis.state.State`; one engine
fits, tests and ranks them all. A user's own effect is one more record::

    from tirefit.diagnosis.effects import EFFECTS, Effect

    def change(state, amplitude, rows):
        ripple = jnp.sin(12 * rows.time)
        return state._replace(friction=state.friction * (1 + amplitude * ripple))

    mine = Effect("road_ripple", "friction x time", change, scale=0.1, unit="-",
                  formula="mu (1 + A sin 12 t)", needs=("time",))
    tirefit.diagnose(data, effects=EFFECTS + (mine,))
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from tirefit.diagnosis.rates import AHEAD
from tirefit.diagnosis.state import Covariates, State

__all__ = ["EFFECTS", "NOISE_EFFECTS", "Atom", "Effect", "STEPS", "atoms_of"]

Change = Callable[[State, float, Covariates], State]

FALLS = ((1.0, 1.0), (4.0, 1.0), (4.0, 0.5), (15.0, 1.0), (30.0, 0.5))
"""(v_st [m/s], exponent) of the exponential falls of friction that are tried, S(37)."""

STEPS = tuple(float(t) for t in np.linspace(-0.42, 0.42, 15))
"""Times of a sudden change that are tried, as shares of the record about its middle."""


@dataclass(frozen=True)
class Effect:
    """One effect that a model may lack.

    Attributes:
        id: its name in every output.
        family: which parameter varies with which quantity.
        change: (state, amplitude, covariates) -> state; amplitude 0 changes nothing.
        scale: standard deviation of the amplitude that is expected beforehand.
        unit: unit of the amplitude.
        formula: what it does, for the report.
        parameter: what the amplitude is called.
        sign: +1 or -1 where only that sign is physical, 0 otherwise.
        center: expected amplitude; not zero for mistakes of a known size.
        needs: columns or properties of the data without which it cannot be seen.
        channels: forces that it can change; empty is all.
        variants: further changes of the same kind (other times, other speeds).
        singular: its tangent at zero vanishes; it is always refitted.
        looks_like: ids that it is easily taken for.
        told_apart_by: what measurement separates it from them.
    """

    id: str
    family: str
    change: Change
    scale: float
    unit: str
    formula: str
    parameter: str = "amplitude"
    sign: int = 0
    center: float = 0.0
    needs: tuple[str, ...] = ()
    channels: tuple[str, ...] = ()
    variants: tuple[Change, ...] = ()
    singular: bool = False
    looks_like: tuple[str, ...] = ()
    told_apart_by: str = ""


@dataclass(frozen=True)
class Atom:
    """One variant of one effect: what the engine gives an amplitude."""

    effect: Effect
    change: Change
    variant: int = 0


def atoms_of(effects) -> tuple[Atom, ...]:
    """Every variant of every effect, in order."""
    return tuple(
        Atom(effect, change, k)
        for effect in effects
        for k, change in enumerate((effect.change, *effect.variants))
    )


def _skew(state, d, rows):
    del rows
    return state._replace(skew=jnp.clip(state.skew + d, -0.32, 0.95))


def _flatness(state, share, rows):
    del rows
    return state._replace(flat=jnp.clip(state.flat + share, -0.6, 1.0))


def _kinetic(state, excess, rows):
    del rows
    return state._replace(static=state.static + excess)


def _kinetic_times(state, factor):
    return state._replace(kinetic=state.kinetic * jnp.maximum(factor, 1e-3))


def _linear_loss(state, loss, rows):
    return _kinetic_times(state, 1 - loss * rows.sliding)


def _fallen(v_st, exponent, share, rows):
    """1 - share (1 - exp(-(v_s / v_st)^exponent)), S(37)."""
    # The power has no slope at rest, where the patch slides nowhere.
    speed = jnp.maximum(rows.sliding, 1e-9)
    return 1 + share * jnp.expm1(-((speed / v_st) ** exponent))


def _fall(v_st, exponent, state, share, rows):
    return _kinetic_times(state, _fallen(v_st, exponent, share, rows))


def _load_stiffness(state, power, rows):
    return state._replace(stiffness=state.stiffness * rows.fz**power)


def _load_friction(state, power, rows):
    return state._replace(friction=state.friction * rows.fz**power)


def _scaled(state, name, factor):
    """Stiffness or friction times a factor, which stays positive."""
    return state._replace(**{name: getattr(state, name) * jnp.maximum(factor, 0.05)})


def _times(name, covariate, state, share, rows):
    return _scaled(state, name, 1 + share * getattr(rows, covariate))


def _step(at, state, share, rows):
    return _scaled(state, "friction", 1 + share * jnp.where(rows.time > at, 0.5, -0.5))


def _half(name, state, share, rows):
    return _scaled(state, "friction", 1 + 0.5 * share * getattr(rows, name))


def _shift(state, offset, rows):
    del rows
    return state._replace(shift=state.shift + offset)


def _shift_by(covariate, state, amount, rows):
    return state._replace(shift=state.shift + amount * getattr(rows, covariate))


def _late(past, delay, rows):
    """Values of a delay [s] ago, less the values: (n,) of (n, k).

    Exact for values that move in straight lines from column to column.
    """
    at = jnp.clip(AHEAD + delay / rows.interval, 0.0, past.shape[1] - 1.0)
    low = jnp.clip(jnp.floor(at), 0, past.shape[1] - 2).astype(int)[:, None]
    before = jnp.take_along_axis(past, low, axis=1)[:, 0]
    after = jnp.take_along_axis(past, low + 1, axis=1)[:, 0]
    return before + (at - low[:, 0]) * (after - before) - past[:, AHEAD]


def _slip_late(state, delay, rows):
    return state._replace(shift=state.shift + _late(rows.past, delay, rows))


def _force_late(state, delay, rows):
    return state._replace(force=state.force + _late(rows.pull, delay, rows))


def _lagged(past, length, step):
    """Values that follow over a length, less the values: (n,) of (n, k).

    Exact for values that rest before their past and then move in straight lines from
    column to column.

    Args:
        length: of the response, in the unit of ``step``.
        step: (n,) from column to column.
    """
    length = length + 1e-12  # the slope at no length is one-sided, not zero
    ways = step / length
    decay = jnp.exp(-ways)
    # Response to values that rise over the step.
    share = jnp.where(ways < 1e-4, ways / 2, 1 - (1 - decay) / ways)

    def follow(carry, value):
        behind, before = carry
        behind = decay * behind + share * value + (1 - share - decay) * before
        return (behind, value), None

    path = past[:, AHEAD:].T[::-1]
    behind = jax.lax.scan(follow, (path[0], path[0]), path[1:])[0][0]
    return behind - past[:, AHEAD]


def _force_filtered(state, constant, rows):
    """A low-pass filter of first order: its delay is its time constant [s]."""
    behind = _lagged(rows.pull, constant, rows.interval)
    return state._replace(force=state.force + behind)


def _relaxed(state, length, rows):
    behind = _lagged(rows.past, length, rows.step)
    return state._replace(shift=state.shift + behind)


def _force_relaxed(state, length, rows):
    behind = _lagged(rows.pull, length, rows.step)
    return state._replace(force=state.force + behind)


def _wears_in(name, way, state, share, rows):
    """Change that is quick at first: 1 - exp(-t / way), about its middle."""
    late = 1 - jnp.exp(-(rows.time + 0.5) / way)
    return _scaled(state, name, 1 + share * (late - 0.5))


def _linear_load(name, state, slope, rows):
    return _scaled(state, name, 1 + slope * (rows.fz - 1))


def _falls_with(covariate, state, loss, rows):
    """Static and kinetic friction alike fall with a speed."""
    return _scaled(state, "friction", 1 - loss * getattr(rows, covariate))


def _fall_of_both(v_st, exponent, state, share, rows):
    return _scaled(state, "friction", _fallen(v_st, exponent, share, rows))


def _force(state, offset, rows):
    # In thousandths of the typical load: the same prior for every tire.
    return state._replace(force=state.force + 1e-3 * offset * rows.load)


def _camber_force(state, share, rows):
    # Cornering stiffness of ten loads per radian: the same amplitude for both forms.
    return state._replace(
        force=state.force + 10 * share * rows.gamma * rows.fz * rows.load
    )


def _conicity(state, share, rows):
    return state._replace(force=state.force + 1e-3 * share * rows.load * rows.fz)


def _definition(way, state, weight, rows):
    del rows
    return state._replace(curvature=state.curvature + way * weight)


def _other(state, share, rows):
    return state._replace(other=state.other + share * rows.other)


def _inertia(state, inertia, rows):
    return state._replace(force=state.force - inertia * rows.spin)


def _skew_with(covariate, state, d, rows):
    moved = state.skew + d * getattr(rows, covariate)
    return state._replace(skew=jnp.clip(moved, -0.32, 0.95))


def _log_load(state, d, rows):
    moved = state.skew + d * jnp.log(rows.fz)
    return state._replace(skew=jnp.clip(moved, -0.32, 0.95))


def _compliance(state, share, rows):
    # With the base model's force: the slip that it takes up is small.
    return state._replace(shift=state.shift - share * rows.traction)


EFFECTS: tuple[Effect, ...] = (
    Effect(
        "pressure_asymmetry", "pressure", _skew, 0.24, "-",
        "p = 3/4 (1 - xi^2)(1 + d xi), S(24)", "d",
        looks_like=("carcass_flexibility", "pressure_flatness", "slip_definition"),
        told_apart_by="mz",
    ),
    Effect(
        "pressure_flatness", "pressure", _flatness, 0.6, "-",
        "p from the parabola towards 5/8 (1 - xi^4), S(25)", "share",
        looks_like=("pressure_asymmetry", "carcass_flexibility"), told_apart_by="mz",
    ),
    Effect(
        "kinetic_friction", "friction", _kinetic, 0.25, "-",
        "mu_k = mu_s / (1 + amplitude), S(31)", "mu_s / mu_k - 1", sign=1,
        singular=True, told_apart_by="speeds",
    ),
    Effect(
        "friction_speed_linear", "friction x speed", _linear_loss, 0.012, "s/m",
        "mu_k = mu (1 - amplitude v_s), S(35)", "n / mu", needs=("v",),
        variants=(partial(_falls_with, "sliding"), partial(_falls_with, "v")),
        looks_like=("friction_speed_exponential",), told_apart_by="speeds",
    ),
    Effect(
        "friction_speed_exponential", "friction x speed", partial(_fall, *FALLS[0]),
        0.2, "-", "mu_k = mu (h + (1 - h) exp(-(v_s / v_st)^e)), S(37)", "1 - h",
        sign=1, needs=("v",),
        variants=(
            *(partial(_fall, *fall) for fall in FALLS[1:]),
            *(partial(_fall_of_both, *fall) for fall in FALLS),
        ),
        looks_like=("friction_speed_linear",), told_apart_by="speeds",
    ),
    Effect(
        "load_stiffness", "stiffness x load", _load_stiffness, 0.5, "-",
        "c_p a^2 (F_z / F_z0)^amplitude, S 2.1", "power", needs=("loads",),
        variants=(partial(_linear_load, "stiffness"),),
        looks_like=("stiffness_drift",), told_apart_by="random order",
    ),
    Effect(
        "load_friction", "friction x load", _load_friction, 0.12, "-",
        "mu (F_z / F_z0)^amplitude, S 2.1", "power", needs=("loads",),
        variants=(partial(_linear_load, "friction"),),
        looks_like=("friction_drift", "force_offset"), told_apart_by="random order",
    ),
    Effect(
        "friction_temperature", "friction x temperature",
        partial(_times, "friction", "temperature"), 0.12, "per 20 K",
        "mu (1 + amplitude (T - T0) / 20 K)", needs=("temperature",),
        looks_like=("friction_drift",), told_apart_by="random order",
    ),
    Effect(
        "stiffness_temperature", "stiffness x temperature",
        partial(_times, "stiffness", "temperature"), 0.15, "per 20 K",
        "c_p a^2 (1 + amplitude (T - T0) / 20 K)", needs=("temperature",),
        looks_like=("stiffness_drift",), told_apart_by="random order",
    ),
    Effect(
        "friction_drift", "friction x time", partial(_times, "friction", "time"),
        0.12, "per record", "mu (1 + amplitude t)", needs=("time",),
        variants=tuple(partial(_wears_in, "friction", way) for way in (0.12, 0.35)),
        looks_like=("load_friction", "friction_temperature", "friction_step"),
        told_apart_by="random order",
    ),
    Effect(
        "stiffness_drift", "stiffness x time", partial(_times, "stiffness", "time"),
        0.18, "per record", "c_p a^2 (1 + amplitude t)", needs=("time",),
        variants=tuple(partial(_wears_in, "stiffness", way) for way in (0.12, 0.35)),
        looks_like=("load_stiffness", "stiffness_temperature"),
        told_apart_by="random order",
    ),
    Effect(
        "friction_step", "friction x time", partial(_step, STEPS[0]), 0.15, "-",
        "mu changes by amplitude at one time", needs=("time",),
        variants=(
            *(partial(_step, at) for at in STEPS[1:]),
            partial(_times, "friction", "change"),
        ),
        looks_like=("friction_drift",), told_apart_by="random order",
    ),
    Effect(
        "friction_hysteresis", "friction x direction", partial(_half, "turning"),
        0.06, "-", "mu differs by amplitude between growing and shrinking slip",
        needs=("sweeps",), looks_like=("channel_delay", "relaxation_length"),
        told_apart_by="two ramp rates",
    ),
    Effect(
        "drive_brake_asymmetry", "friction x sign", partial(_half, "side"), 0.12, "-",
        "mu differs by amplitude between the two signs of slip", needs=("signs",),
        looks_like=("force_offset",), told_apart_by="loads",
    ),
    Effect(
        "slip_offset", "measurement", _shift, 0.004, "-", "slip + amplitude",
        looks_like=("force_offset",), told_apart_by="both signs",
    ),
    Effect(
        "force_offset", "measurement", _force, 25.0, "1e-3 mean F_z",
        "force + amplitude", looks_like=("slip_offset",), told_apart_by="loads",
    ),
    Effect(
        "slip_definition", "measurement", partial(_definition, 1.0), 0.3, "-",
        "slip / (1 - amplitude slip)", "1: kappa logged as sigma, or the reverse",
        center=1.0, variants=(partial(_definition, -1.0),), channels=("fx",),
        looks_like=("pressure_asymmetry",), told_apart_by="both signs",
    ),
    Effect(
        "channel_delay", "measurement", _slip_late, 0.025, "s",
        "force(t) belongs to slip(t - amplitude)", "delay", needs=("sweeps",),
        variants=(_force_late, _force_filtered),
        looks_like=("relaxation_length", "friction_hysteresis"),
        told_apart_by="speeds",
    ),
    Effect(
        "relaxation_length", "transient", _relaxed, 0.4, "m",
        "d slip'/dt = v / amplitude (slip - slip')", "length", sign=1,
        variants=(_force_relaxed,),
        needs=("sweeps", "v"), looks_like=("channel_delay", "friction_hysteresis"),
        told_apart_by="speeds",
    ),
    Effect(
        "wheel_inertia", "measurement", _inertia, 1.0, "kg m^2",
        "force - amplitude (d omega / dt) / r", "inertia", needs=("omega", "sweeps"),
        looks_like=("channel_delay", "relaxation_length", "friction_hysteresis"),
        told_apart_by="speeds",
    ),
    Effect(
        "combined_slip", "inputs", _other, 0.15, "-",
        "the other slip shares the friction", "share", center=1.0,
        needs=("other slip",), singular=True, told_apart_by="pure slip",
    ),
    Effect(
        "camber_thrust", "lateral inputs", partial(_shift_by, "gamma"), 0.15, "-",
        "slip angle + amplitude gamma", "camber stiffness / cornering stiffness",
        needs=("gamma",), channels=("fy", "mz"),
        variants=(_camber_force,), told_apart_by="opposite camber",
    ),
    Effect(
        "conicity", "lateral inputs", _conicity, 25.0, "1e-3 F_z",
        "F_y + amplitude F_z", "share", needs=("loads",), channels=("fy", "mz"),
        looks_like=("force_offset", "slip_offset"), told_apart_by="loads",
    ),
    Effect(
        "pressure_shift_load", "pressure x force", partial(_skew_with, "force"), 0.24,
        "-", "d moves by amplitude F / (mu F_z), or with the load, S 4.1", "d",
        variants=(partial(_skew_with, "usage"), _log_load),
        looks_like=("pressure_asymmetry",), told_apart_by="loads",
    ),
    Effect(
        "carcass_flexibility", "structure", _compliance, 0.012, "-",
        "slip - amplitude F / F_z, S(15)", "compliance", sign=1,
        looks_like=("pressure_asymmetry", "pressure_flatness"), told_apart_by="mz",
    ),
)  # fmt: skip

NOISE_EFFECTS = (
    "outliers", "noise_heteroscedastic", "noise_autocorrelated", "slip_noise",
)  # fmt: skip
"""Ids that change the error law and not the mean."""
