r"""Friction from one sample by Yamazaki's cubic, S(19)-(20), with known stiffness.

With the demand :math:`D = C_s \sigma` (C_s = 2 c_p a^2), :math:`f = F/D` and the share
of the patch that slides, :math:`q = D / (3 \mu F_z)`, S(19) is

.. math:: q^2 / 3 - q + (1 - f) = 0

The smaller root, from no sliding (f = 1) to full sliding (f = 1/3), is that of the tire;
below f = 1/3 the tire slides and S(20) holds, :math:`\mu = F / F_z`. S prints kappa; here
the physical slip is used, with which S(19) equals S(12) exactly.
"""

from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from tirefit.arrays import Number
from tirefit.online import base
from tirefit.online.base import AbstractSingleSample, Flag, Method, Sample, Single, flag_of
from tirefit.params import par

_LEAST_SLIDING = 1e-3


def friction_by_cubic(fx: Number, sigma: Number, cpa2: Number, fz: Number) -> Number:
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


class Cubic(AbstractSingleSample):
    """Friction from every single sample; the stiffness must be known."""

    method: ClassVar[Method] = Method(
        "cubic", "root of the brush force for mu, one sample at a time", ("sigma_x", "fx", "fz"),
        ("mu",), "50 to 100 % of the friction, S(20) in full sliding; below, flagged",
        "S(19)-(20)",
    )  # fmt: skip

    cpa2: float = base.nominal_stiffness()
    cpa2_std: float = par(0.05, (0.0, 0.99), "-", "relative std of c_p a^2; 0.7 without cpa2")
    force_noise: float = base.force_noise(0.0447)
    slip_noise: float = base.slip_noise()
    least_use: float = base.excitation()

    def from_sample(self, sample: Sample) -> tuple[Single, Bool[Array, ""], Int[Array, ""]]:
        (sigma, fx), fz = base.braking(sample), sample["fz"]
        cpa2 = jnp.asarray(self.cpa2, float)
        mu, slope = jax.value_and_grad(friction_by_cubic, argnums=(0, 1))(fx, sigma, cpa2, fz)
        share = 1 / jnp.sqrt(sample["count"])
        # A difference, as a tire that slides at the expected stiffness, where the slope is
        # zero, does not slide at a smaller one. If no friction explains the force there, mu is
        # not known.
        softer = friction_by_cubic(fx, sigma, (1 - self.cpa2_std) * cpa2, fz)
        parts = (
            slope[0] * share * self.force_noise * fz,
            slope[1] * share * self.slip_noise,
            jnp.where(jnp.isfinite(softer), softer - mu, mu),
        )
        std = jnp.sqrt(sum(part**2 for part in parts))
        idle = 2 * cpa2 * sigma < self.least_use * fz
        usable = jnp.isfinite(mu) & jnp.isfinite(std) & (mu > 0) & ~idle
        flag = flag_of((~usable, Flag.LOW_USE), (idle, Flag.LITTLE_EXCITATION))
        return Single(mu[None], std[None]), usable, flag
