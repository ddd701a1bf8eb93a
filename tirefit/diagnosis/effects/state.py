r"""What an unmodelled effect may change, and the force that follows: one formula.

A base model is taken through the similarity of every friction-limited tire: stiffness
times r and friction times g give :math:`F(\sigma) = g F_0(\sigma r / g)`, exact for a
brush. What similarity cannot express (the shape of the pressure, friction that falls
while sliding) is the difference of two brushes of the base model's own stiffness and
friction, one with the effect and one without.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from tirefit.models import Asymmetric, Brush, Quartic, TireInputs
from tirefit.models.friction import Friction
from tirefit.models.pressure import AbstractPressure, Parabolic
from tirefit.params import Values


class Covariates(NamedTuple):
    """What effects may depend on, one value per row (n,).

    Zeros where the data lack a column. ``fz`` is the load over its geometric mean,
    ``time`` runs from -1/2 to 1/2 over the record, ``temperature`` is in units of 20 K
    about its mean, ``inflation`` the pressure from -1/2 to 1/2 over its range.
    ``rate`` is the derivative of the smooth slip [1/s], ``lag`` its change with the way
    over the usual one, times the spread of the slip [-]; ``turning`` is +1 while the
    slip grows in size and -1 while it shrinks; ``side`` is the sign of the slip.
    ``other`` is the slip that the base model leaves out (lateral sigma_y for F_x),
    ``force`` the base model's force over its peak, with its sign, ``usage`` its size,
    and ``spin`` d(omega)/dt over the rolling radius [rad/(m s^2)]. ``load`` is the mean
    load [N].

    ``past`` (n, k) is the smooth slip before, at and after each row, see
    :class:`rows.rates.Past`, ``pull`` (n, k) [N] the force of the base
    model there, ``twist`` (n, k) [N m] its moment; all are zero without sweeps.
    ``burden`` (n, k) is the load there over that of the row. From column to column it
    is ``interval`` [s] and ``step`` [m] back. ``pace`` [m/s] is the speed, a share of
    the usual one at least, ``cruise`` [m/s] its geometric mean; ``sliding`` [m/s] is
    the sliding speed of the measured slip, ``brisk`` [m/s] its typical largest value.
    ``rise`` is the slip at half of the largest force, ``peak`` that force over the
    load. ``work`` (n, 3) is the work of sliding so far, over its range about its mean:
    all of it, and what is left of it after a cooling of a fifth and of a twentieth of
    the record. ``across`` [N] is the measured force across, ``yaw`` [1/m] yaw rate over
    speed, ``ahead`` the acceleration ahead over its range, ``swing`` [rad/s^2] the yaw
    acceleration, ``heading`` and ``steering`` [rad] as measured, ``steered`` (n, k) the
    latter where ``past`` has the slip, ``pivot`` [N/rad] what the road wheel angle does
    to a force that was derived across it, ``lean`` the lateral acceleration over that
    of gravity; of a force that was derived from it, what the base model's force would
    make of it. ``run_slip``, ``run_force``, ``run_friction`` and ``run_stiffness`` are
    how the runs differ in one or the other, of unit rms.
    ``change`` is the shape of a change in time, from -1/2 to 1/2, that
    :func:`evidence.forms.shape_of_change` has found, ``traction`` the force
    of the base model over the mean load.
    """

    fz: Values
    v: Values
    time: Values
    temperature: Values
    inflation: Values
    gamma: Values
    rate: Values
    lag: Values
    turning: Values
    side: Values
    other: Values
    force: Values
    usage: Values
    spin: Values
    load: Values
    past: Values
    pull: Values
    twist: Values
    burden: Values
    interval: Values
    step: Values
    pace: Values
    sliding: Values
    brisk: Values
    cruise: Values
    rise: Values
    peak: Values
    work: Values
    across: Values
    yaw: Values
    ahead: Values
    swing: Values
    heading: Values
    lean: Values
    steering: Values
    steered: Values
    pivot: Values
    run_slip: Values
    run_force: Values
    run_friction: Values
    run_stiffness: Values
    change: Values
    traction: Values


class State(NamedTuple):
    """A tire and its measurement with all effects applied; arrays (n,) or scalars.

    ``shift`` [-] is added to the slip, ``curvature`` w turns it into x / (1 - w x),
    ``other`` is the slip across. ``stiffness`` and ``friction`` multiply; ``skew`` is d
    of S(24) and ``flat`` the share of the quartic law S(25); ``static`` is the excess
    of static over kinetic friction, 1/m - 1, and ``kinetic`` multiplies the kinetic
    one alone. ``force`` [N] is added to the measured force, ``moment`` [N m] to the
    moment.
    """

    shift: Array
    curvature: Array
    other: Array
    stiffness: Array
    friction: Array
    skew: Array
    flat: Array
    static: Array
    kinetic: Array
    force: Array
    moment: Array


def null_state() -> State:
    """No effect at all."""
    zero, one = jnp.zeros(()), jnp.ones(())
    return State(
        shift=zero, curvature=zero, other=zero, stiffness=one, friction=one, skew=zero,
        flat=zero, static=zero, kinetic=one, force=zero, moment=zero,
    )  # fmt: skip


class _Shaped(AbstractPressure):
    """Asymmetric pressure, partly flattened to the quartic law."""

    skew: Array
    flat: Array

    def _mix(self, name: str, u):
        # A number to its users; here of a hypothesis, within a program.
        leaning = Asymmetric(self.skew)  # type: ignore[arg-type]
        skewed = getattr(leaning, name)(u)
        return (1 - self.flat) * skewed + self.flat * getattr(Quartic(), name)(u)

    def density(self, u):
        return self._mix("density", u)

    def cdf(self, u):
        return self._mix("cdf", u)

    def moment(self, u):
        return self._mix("moment", u)

    def breakaway(self, rho):
        return _breakaway(rho, self.skew, self.flat)


_NEWTON, _LEAST_SLOPE = 7, 0.05
"""Newton's steps from the breakaway of the parabola, and the least slope that one
divides by: they leave 3e-5 of the demand at the most, over all d and shares that the
effects allow."""

_PEAKS = (1e-3, 2.0, 60)
"""Slips at which the largest force is looked for: from, to and how many, 14 % apart."""

_AT_REST = 1e-60
"""Square of a slip that keeps its size differentiable at zero."""


def _holding(u, skew, flat):
    """Demand ratio at which a bristle at u lets go, limit over demand: the pressures
    S(24) and S(25) from the edge to u, over u."""
    skewed = 0.75 * u * (1 + skew * (u - 1))
    return (1 - flat) * skewed + flat * 0.625 * u * (u * (u - 2) + 2)


def _holding_slope(u, skew, flat):
    skewed = 0.75 * (1 + skew * (2 * u - 1))
    quartic = 0.625 * (u * (3 * u - 4) + 2)
    return jnp.maximum((1 - flat) * skewed + flat * quartic, _LEAST_SLOPE)


@jax.custom_jvp
def _breakaway(rho, skew, flat):
    """u where limit and demand meet, by Newton's method; 2 beyond full sliding."""

    def step(_, u):
        excess = _holding(u, skew, flat) - rho
        return jnp.clip(u - excess / _holding_slope(u, skew, flat), 0.0, 2.0)

    # 4 / 3 rho is the breakaway of the parabola.
    u = jax.lax.fori_loop(0, _NEWTON, step, jnp.minimum(4 / 3 * rho, 2.0))
    return jnp.where(_holding(2.0, skew, flat) <= rho, 2.0, u)


@_breakaway.defjvp
def _breakaway_slope(primals, tangents):
    rho, skew, flat = primals
    u = _breakaway(rho, skew, flat)
    inside = u < 2.0
    at = jnp.where(inside, u, 1.0)
    skewed = 0.75 * at * (1 + skew * (at - 1))
    d_skew = (1 - flat) * 0.75 * at * (at - 1)
    d_flat = 0.625 * at * (at * (at - 2) + 2) - skewed
    moved = tangents[0] - d_skew * tangents[1] - d_flat * tangents[2]
    return u, jnp.where(inside, moved / _holding_slope(at, skew, flat), 0.0)


class _TwoFrictions(Friction):
    """Static friction above the kinetic one, whatever the speed."""

    excess: Array | float = 0.0
    factor: Array | float = 1.0

    def static(self, mu, v_s):
        return mu * (1 + self.excess)

    def kinetic(self, mu, v_s):
        return mu * self.factor


def peak_ratio(base, fz, v):
    """Largest force over load of the base model at one load and speed."""
    slips = jnp.geomspace(*_PEAKS)

    def force(slip):
        forces = base(TireInputs(sigma_x=slip, fz=fz, v=v))
        if forces.fx is None:
            forces = base(TireInputs(alpha=jnp.arctan(slip), fz=fz, v=v))
            return forces.fy
        return forces.fx

    return jnp.max(jax.vmap(force)(slips)) / fz


def _shape_change(state: State, stiffness, mu, arm, slip, fz, bare: bool):
    """Force and moment of a brush with the effects, less those of one without."""
    pressure = _Shaped(state.skew, state.flat)
    friction = _TwoFrictions(excess=state.static, factor=state.kinetic)
    with_effect = Brush(stiffness, mu, arm, pressure, friction).pure(slip, fz, 0.0)
    if bare:
        return with_effect
    plain = Brush(stiffness, mu, arm, Parabolic()).pure(slip, fz, 0.0)
    return with_effect[0] - plain[0], with_effect[1] - plain[1]


def force_of_state(base, reference, state: State, slip_x, slip_y, inputs: TireInputs):
    """(fx, fy, mz) of one sample [N, N, N m].

    Args:
        base: the base model with its parameter values.
        reference: None where the base is the plain brush; else (c_p a^2 [N], mu,
            half-length [m]) of the brush that carries changes of shape.
        state: the effects at this sample (scalars).
        slip_x, slip_y: true physical slips [-].
        inputs: load, speed and the other inputs of the base model.
    """
    ratio = state.stiffness / state.friction
    along, across = slip_x * ratio, slip_y * ratio
    size = jnp.sqrt(along**2 + across**2 + _AT_REST)
    g = state.friction
    if reference is None:
        bare = base
        change, turn = _shape_change(
            state, bare.cpa2, bare.mu, bare.half_length, size, inputs.fz, True
        )
        return (
            g * along / size * change,
            g * across / size * change,
            g * bare.half_length * across / size * turn,
        )
    stiffness, mu, arm = reference
    alpha = jnp.arctan(across / (1 + along))
    forces = base(inputs._replace(sigma_x=along, alpha=alpha))
    change, turn = _shape_change(state, stiffness, mu, arm, size, inputs.fz, False)
    fx = 0.0 if forces.fx is None else forces.fx
    fy = 0.0 if forces.fy is None else forces.fy
    mz = 0.0 if forces.mz is None else forces.mz
    return (
        g * (fx + along / size * change),
        g * (fy + across / size * change),
        g * (mz + arm * across / size * turn),
    )
