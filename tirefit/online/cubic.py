r"""Friction from one sample by Yamazaki's cubic, S(19)-(20), with known stiffness.

With the demand :math:`D = C_s \sigma` (C_s = 2 c_p a^2), :math:`f = F/D` and the share
of the patch that slides, :math:`q = D / (3 \mu F_z)`, S(19) is

.. math:: q^2 / 3 - q + (1 - f) = 0

The smaller root, from no sliding (f = 1) to full sliding (f = 1/3), is that of the tire;
below f = 1/3 the tire slides and S(20) holds, :math:`\mu = F / F_z`. S prints kappa; here
the physical slip is used, with which S(19) equals S(12) exactly.
"""

from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from tirefit.online.base import (
    AbstractEstimator,
    Estimate,
    Flag,
    Method,
    Sample,
    choose,
    excitation,
    flag_of,
    force_noise,
    nominal_friction,
    nominal_stiffness,
    slip_noise,
)
from tirefit.online.regression import RESOLVED
from tirefit.params import par

_LEAST_SLIDING = 1e-3


def friction_by_cubic(fx, sigma, cpa2, fz):
    """Friction [-] of a brush with parabolic pressure from one sample, S(19)-(20).

    Args:
        fx: force [N] along the slip.
        sigma: physical slip [-] > 0.
        cpa2: bristle stiffness c_p a^2 [N].
        fz: load [N].

    Returns:
        mu, NaN if the force is at least that of a tire without sliding.
    """
    demand = 2 * cpa2 * sigma
    short = 1 - fx / demand
    # Limit the arguments first, as slopes out of the range would be NaN.
    inside = jnp.clip(short, _LEAST_SLIDING, 2 / 3)
    sliding = 1.5 * (1 - jnp.sqrt(1 - 4 / 3 * inside))
    mu = jnp.where(short < 2 / 3, demand / (3 * sliding * fz), fx / fz)
    return jnp.where(short < _LEAST_SLIDING, jnp.nan, mu)


class CubicState(NamedTuple):
    """The last friction [-] from a sample, and its standard deviation."""

    mu: Float[Array, ""]
    std: Float[Array, ""]


class Cubic(AbstractEstimator):
    """Friction from every single sample; the stiffness must be known."""

    method: ClassVar[Method] = Method(
        "cubic",
        "root of the brush force for mu, one sample at a time",
        ("sigma_x", "fx", "fz"),
        ("mu",),
        "50 to 100 % of the friction, S(20) in full sliding; below, flagged",
        "S(19)-(20)",
    )

    cpa2: float = nominal_stiffness()
    mu: float = nominal_friction()
    cpa2_std: float = par(0.05, (0.0, 1.0), "-", "relative std of c_p a^2", "S(19)", r"\sigma_c")
    force_noise: float = force_noise()
    slip_noise: float = slip_noise()
    least_use: float = excitation()

    def init(self) -> CubicState:
        return CubicState(jnp.full((), jnp.nan), jnp.full((), jnp.nan))

    def step(self, state: CubicState, sample: Sample) -> tuple[CubicState, Estimate]:
        sigma, fz = jnp.abs(sample["sigma_x"]), sample["fz"]
        fx = jnp.where(sample["sigma_x"] < 0, -1.0, 1.0) * sample["fx"]
        cpa2 = jnp.asarray(self.cpa2, float)
        mu, slope = jax.value_and_grad(friction_by_cubic, argnums=(0, 1, 2))(fx, sigma, cpa2, fz)
        share = 1 / jnp.sqrt(sample["count"])
        noises = (share * self.force_noise * fz, share * self.slip_noise)
        stds = (*noises, self.cpa2_std * cpa2)
        std = jnp.sqrt(sum((g * s) ** 2 for g, s in zip(slope, stds, strict=True)))
        idle = 2 * cpa2 * sigma < self.least_use * fz
        usable = jnp.isfinite(mu) & jnp.isfinite(std) & (mu > 0) & ~idle
        after = choose(usable, CubicState(mu, std), state)
        return after, self._estimate(after, idle, usable)

    def hold(self, state: CubicState, dt, steps) -> tuple[CubicState, Estimate]:
        return state, self._estimate(state, False, True)

    def _estimate(self, state: CubicState, idle, usable) -> Estimate:
        flag = flag_of(
            (~(state.std < RESOLVED * state.mu) | ~usable, Flag.LOW_USE),
            (idle, Flag.LITTLE_EXCITATION),
        )
        nothing = jnp.full((), jnp.nan)
        return Estimate(state.mu[None], state.std[None], flag, nothing)
