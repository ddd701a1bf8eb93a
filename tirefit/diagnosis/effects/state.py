r"""The quantities that an unmodelled effect may change, and the force that follows.

Changes of stiffness by a factor r and of friction by g use the similarity of
friction-limited tires: :math:`F(\sigma) = g F_0(\sigma r / g)`, exact for a brush. For
changes that similarity cannot express (the shape of the pressure, friction that falls
while sliding), the difference of two brushes with the stiffness and friction of the base
model is added, one with the effect and one without.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp

from tirefit.arrays import Numbers
from tirefit.models import Asymmetric, Brush, Quartic, TireInputs
from tirefit.models.base import AbstractTire, largest
from tirefit.models.friction import Friction
from tirefit.models.pressure import AbstractPressure, Parabolic
from tirefit.params import Values


class Covariates(NamedTuple):
    """The quantities on which effects may depend: one value per row, (n,), or (n, k) where noted.

    They are zero if the data lack a column. Columns (n, k) of the past are at the times
    of :class:`rows.slips.Past`; they are zero without sweeps.
    """

    fz: Values  # load over its mean
    v: Values  # speed [m/s]
    time: Values  # -1/2 to 1/2 over the record
    temperature: Values  # about its mean [20 K]
    inflation: Values  # pressure, -1/2 to 1/2 over its range
    gamma: Values  # camber [rad]
    rate: Values  # derivative of the smooth slip [1/s]
    turning: Values  # +1 while the size of the slip grows, -1 while it shrinks
    side: Values  # sign of the slip
    other: Values  # the slip that the base model ignores (sigma_y for F_x)
    force: Values  # force of the base model over its peak, signed
    usage: Values  # its size
    spin: Values  # d(omega)/dt over the rolling radius [rad/(m s^2)]
    load: Values  # mean load [N]
    past: Values  # (n, k) smooth slip before, at and after each row
    pull: Values  # (n, k) force of the base model there [N]
    twist: Values  # (n, k) its moment there [N m]
    burden: Values  # (n, k) load there over the load of the row
    interval: Values  # time between the columns of the past [s]
    step: Values  # distance between them [m]
    pace: Values  # speed [m/s], with a lower limit
    sliding: Values  # sliding speed of the measured slip [m/s]
    brisk: Values  # its typical largest value [m/s]
    cruise: Values  # geometric mean of the speed [m/s]
    rise: Values  # slip at half of the largest force
    peak: Values  # largest force over the load
    work: Values  # (n, 3) work of sliding so far with each cooling, over its range
    across: Values  # measured force in the other direction [N]
    yaw: Values  # yaw rate over speed [1/m]
    ahead: Values  # longitudinal acceleration over its range
    swing: Values  # yaw acceleration [rad/s^2]
    heading: Values  # [rad]
    lean: Values  # lateral acceleration over g; for a derived force, by the base model
    steering: Values  # road wheel angle [rad]
    steered: Values  # (n, k) road wheel angle in the past
    pivot: Values  # slope of a derived force over the road wheel angle [N/rad]
    run_slip: Values  # pattern of the slip offsets of runs, unit rms
    run_force: Values  # the same of force offsets
    run_friction: Values  # the same of log friction
    run_stiffness: Values  # the same of log stiffness
    traction: Values  # force of the base model over the mean load


class State(NamedTuple):
    """A tire and its measurement with all effects applied; arrays (n,) or scalars."""

    shift: Values | float  # added to the slip
    curvature: Values | float  # w: the slip x becomes x / (1 - w x)
    other: Values | float  # the other slip
    stiffness: Values | float  # factor
    friction: Values | float  # factor
    skew: Values | float  # d of S(24)
    flat: Values | float  # share of the quartic law S(25)
    static: Values | float  # excess of static over kinetic friction, 1/m - 1
    kinetic: Values | float  # factor on the kinetic friction only
    force: Values | float  # added to the measured force [N]
    moment: Values | float  # added to the moment [N m]


def null_state() -> State:
    """The state without any effect."""
    factors = {"stiffness", "friction", "kinetic"}
    return State(*(float(name in factors) for name in State._fields))


class _Shaped(AbstractPressure):
    """Asymmetric pressure, partly flattened to the quartic law."""

    skew: Values | float
    flat: Values | float

    def _mix(self, name: str, u: Numbers) -> jax.Array:
        # Users give a number; here it is a traced value of a hypothesis.
        leaning = Asymmetric(self.skew)  # type: ignore[arg-type]
        skewed = getattr(leaning, name)(u)
        return (1 - self.flat) * skewed + self.flat * getattr(Quartic(), name)(u)

    def density(self, u: Numbers) -> jax.Array:
        return self._mix("density", u)

    def cdf(self, u: Numbers) -> jax.Array:
        return self._mix("cdf", u)

    def moment(self, u: Numbers) -> jax.Array:
        return self._mix("moment", u)

    def breakaway(self, rho: Numbers) -> jax.Array:
        return _breakaway(*map(jnp.asarray, (rho, self.skew, self.flat)))


def _holding(u: jax.Array | float, skew: jax.Array, flat: jax.Array) -> jax.Array:
    """Demand ratio (limit over demand) at which a bristle at u begins to slide: the
    pressures S(24) and S(25) integrated from the edge to u, over u."""
    skewed = 0.75 * u * (1 + skew * (u - 1))
    return (1 - flat) * skewed + flat * 0.625 * u * (u * (u - 2) + 2)


def _holding_slope(u: jax.Array, skew: jax.Array, flat: jax.Array) -> jax.Array:
    skewed = 0.75 * (1 + skew * (2 * u - 1))
    quartic = 0.625 * (u * (3 * u - 4) + 2)
    return jnp.maximum((1 - flat) * skewed + flat * quartic, 0.05)


def _breakaway(rho: jax.Array, skew: jax.Array, flat: jax.Array) -> jax.Array:
    """u where limit and demand meet, by Newton's method; 2 beyond full sliding."""

    def step(_: jax.Array, u: jax.Array) -> jax.Array:
        excess = _holding(u, skew, flat) - rho
        return jnp.clip(u - excess / _holding_slope(u, skew, flat), 0.0, 2.0)

    # From 4 / 3 rho, the breakaway of the parabola, seven steps err by at most 3e-5 of the demand
    # for all d and shares of the effects.
    u = jax.lax.fori_loop(0, 7, step, jnp.minimum(4 / 3 * rho, 2.0))
    slides = (_holding(2.0, skew, flat) <= rho) | (u >= 2.0)
    held = jax.lax.stop_gradient
    at = held(jnp.where(slides, 1.0, u))
    # Zero, with the slopes of the implicit function.
    excess = rho - _holding(at, skew, flat)
    moved = (excess - held(excess)) / held(_holding_slope(at, skew, flat))
    return jnp.where(slides, 2.0, at + moved)


class _TwoFrictions(Friction):
    """Static friction above the kinetic one, at any speed."""

    excess: Values | float = 0.0
    factor: Values | float = 1.0

    def static(self, mu: Numbers, v_s: Numbers) -> Numbers:
        return mu * (1 + self.excess)

    def kinetic(self, mu: Numbers, v_s: Numbers) -> Numbers:
        return mu * self.factor


def is_plain(model: AbstractTire) -> bool:
    """Whether a model is the plain brush, to which changes of shape apply directly."""
    plain = type(model) is Brush and type(model.pressure) is Parabolic
    return plain and not cast(Brush, model).friction.laws


def arm_of(model: AbstractTire) -> Values | float:
    """Half-length of the contact patch [m]; that of a car tire for models without one, as
    it only scales the aligning moment."""
    return getattr(model, "half_length", 0.1)


def peak_ratio(base: AbstractTire, fz: jax.Array | float, v: jax.Array | float) -> jax.Array:
    """Largest force over load of the base model at one load and speed."""
    slips = jnp.geomspace(1e-3, 2.0, 60)  # 14 % apart

    def force(slip: jax.Array) -> Any:
        fx = base(TireInputs(sigma_x=slip, fz=fz, v=v)).fx
        if fx is not None:
            return fx
        return base(TireInputs(alpha=jnp.arctan(slip), fz=fz, v=v)).fy

    return largest(jax.vmap(force)(slips)) / fz


def slope_at_rest(base: AbstractTire, inputs: TireInputs, mode: str) -> jax.Array:
    """Slope of the force over the slip of a mode [N]."""
    driven, name = ("alpha", "fy") if mode == "y" else ("sigma_x", "fx")

    def force(slip: jax.Array) -> jax.Array:
        return getattr(base(inputs._replace(**{driven: slip})), name)

    # Not at exactly zero, where some laws have half the slope.
    return jax.jvp(force, (1e-6,), (1.0,))[1]


def slip_of_state(state: State, slip: Values | float) -> Any:
    """The true slip behind a measured one."""
    moved = slip + state.shift
    # x / (1 - w x) has a pole at 1 / w, so limit it to twenty times x.
    return moved / jnp.maximum(1 - state.curvature * moved, 0.05)


def with_offsets(pure: Sequence[Values], state: State, mode: str) -> tuple[Values, Values, Values]:
    """(fx, fy, mz) with what the state adds to the force that the slip drives."""
    fx, fy, mz = pure
    extra = (0.0, state.force) if mode == "y" else (state.force, 0.0)
    return fx + extra[0], fy + extra[1], mz + state.moment


def force_of_state(
    base: AbstractTire,
    reference: tuple[Any, ...] | None,
    state: State,
    slip_x: Values | float,
    slip_y: Values | float,
    inputs: TireInputs,
) -> tuple[Values, ...]:
    """(fx, fy, mz) of one sample [N, N, N m].

    Args:
        base: the base model with its parameter values.
        reference: None if the base is the plain brush; else (c_p a^2 [N], mu,
            half-length [m]) of the brush used for changes of shape.
        state: the effects at this sample (scalars).
        slip_x, slip_y: true physical slips [-].
        inputs: load, speed and the other inputs of the base model.
    """
    ratio = state.stiffness / state.friction
    along, across = slip_x * ratio, slip_y * ratio
    size = jnp.sqrt(along**2 + across**2 + 1e-60)  # differentiable at zero
    bare = reference is None
    if reference is None:
        plain = cast(Brush, base)
        reference = plain.cpa2, plain.mu, plain.half_length
    stiffness, mu, arm = reference
    shape = _Shaped(state.skew, state.flat)
    friction = _TwoFrictions(excess=state.static, factor=state.kinetic)
    change, turn = Brush(stiffness, mu, arm, shape, friction).pure(size, inputs.fz, 0.0)
    if not bare:  # the change of the shape alone
        unchanged = Brush(stiffness, mu, arm, Parabolic()).pure(size, inputs.fz, 0.0)
        change, turn = change - unchanged[0], turn - unchanged[1]
    x, y = along / size, across / size
    added = x * change, y * change, arm * y * turn
    if bare:
        return tuple(state.friction * part for part in added)
    alpha = jnp.arctan(across / (1 + along))
    whole = base(inputs._replace(sigma_x=along, alpha=alpha))
    forces = (0.0 if f is None else f for f in (whole.fx, whole.fy, whole.mz))
    return tuple(state.friction * (o + a) for o, a in zip(forces, added, strict=True))
