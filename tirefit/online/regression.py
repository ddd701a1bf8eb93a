r"""The brush as a regression for online estimation, S(41)-(49) with their errata.

With :math:`q = 1/(1-d)` and the expected :math:`C_{x0} = 2 c_{p0} a^2, \mu_0` the force
over the load is :math:`y = \theta_0 u_0 + \theta_1 u_1 + (\theta_1^2 / \theta_0) u_2`,

.. math::
   u_0 = \frac{C_{x0} \sigma}{F_z}, \quad u_1 = -\frac{u_0^2}{3 \mu_0} q, \quad
   u_2 = \frac{u_0^3}{27 \mu_0^2} (1 + 3 d) q^3, \quad
   C_x = \theta_0 C_{x0}, \quad \mu = \frac{\theta_0^2}{\theta_1} \mu_0

All of them are dimensionless, while S(44)-(46) as printed are forces: the gains of S
section 5.3 for those must be multiplied by F_z^2.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from tirefit.arrays import Number, Scalar
from tirefit.online import base
from tirefit.online.base import AbstractEstimator, Estimate, Flag, Sample, flag_of
from tirefit.params import par

SLIDING = 0.37
"""Force over that without sliding, with nine tenths of the patch sliding; the polynomial
S(49) is not valid below."""


class Regressors(NamedTuple):
    """Output y and regressors of one sample [-], braking or driving alike."""

    y: Number
    u0: Number
    u1: Number
    u2: Number

    @property
    def u(self) -> Float[Array, "2"]:
        """u_0 and u_1."""
        return jnp.stack([self.u0, self.u1])


def regressors(sample: Sample, cpa2: float, mu: float, d: float, third: float = 1.0) -> Regressors:
    """S(43)-(46), corrected, for a sample; slip and force are odd, so both become positive.

    Args:
        sample: with ``sigma_x`` [-], ``fx``, ``fz`` [N].
        cpa2: expected bristle stiffness [N].
        mu: expected friction [-].
        d: asymmetry of the pressure, in [-1/3, 1).
        third: factor on the third term; 0 keeps only two terms, S section 5.4.
    """
    sigma, fx = base.braking(sample)
    q = 1 / (1 - d)
    u0 = 2 * cpa2 * sigma / sample["fz"]
    u1 = -q / (3 * mu) * u0 * u0
    u2 = third * (1 + 3 * d) * q * q * q / (27 * mu * mu) * u0 * u0 * u0
    return Regressors(fx / sample["fz"], u0, u1, u2)


def limited(theta: Float[Array, "2"]) -> Float[Array, "2"]:
    """theta (2,) with theta_0, by which S(50) divides, at least a thousandth of the expected."""
    return theta.at[0].max(1e-3)


def corrected(
    p: Float[Array, "2 2"], gain: Float[Array, "2"], slope: Float[Array, "2"], noise: Scalar
) -> Float[Array, "2 2"]:
    """(I - gain slope^T) P (I - gain slope^T)^T + noise gain gain^T.

    Sums of products, not matrix products, which take longer for so few elements.
    """
    by_slope = jnp.sum(p * slope[None], axis=1)
    crossed = jnp.outer(gain, by_slope)
    spread = jnp.sum(slope * by_slope) + noise
    return p - crossed - crossed.T + spread * jnp.outer(gain, gain)


class AbstractRegression(AbstractEstimator):
    """Settings and derived parameters that estimators on theta share."""

    cpa2: float = base.nominal_stiffness()
    mu: float = base.nominal_friction(0.98)
    d: float = par(0.0, (-1 / 3, 0.99), "-", "asymmetry of the pressure")
    start0: float = par(0.8, (0.01, 100.0), "-", "first theta_0")
    start1: float = par(0.8, (0.0, 100.0), "-", "first theta_1")
    prior0: float = par(0.4, (1e-6, 100.0), "-", "std of the first theta_0")
    prior1: float = par(0.8, (1e-6, 100.0), "-", "std of the first theta_1")
    third: float = par(1.0, (0.0, 1.0), "-", "share of the cubic term that is kept; 0: two terms")
    force_noise: float = base.force_noise(0.0447)
    least_use: float = base.excitation()

    def prior(self) -> Float[Array, "2 2"]:
        """Covariance of the first theta."""
        return jnp.diag(base.floats(self.prior0, self.prior1) ** 2)

    def regressors(self, sample: Sample) -> Regressors:
        return regressors(sample, self.cpa2, self.mu, self.d, self.third)

    def beyond(
        self, x: Regressors, theta0: Number, count: Number
    ) -> tuple[Bool[Array, ""], Int[Array, ""]]:
        """Whether a sample is too close to zero slip or slides, and the flag of the reason.

        Full sliding begins where the force is a third of that of a tire without sliding,
        S(13), for any friction; the polynomial is not valid beyond. A margin of three
        standard deviations prevents that noise selects the samples.
        """
        noise = 3 * self.force_noise / jnp.sqrt(count)
        slides = x.y < SLIDING * theta0 * x.u0 - noise
        idle = x.u0 < self.least_use
        flag = flag_of((slides, Flag.OUT_OF_RANGE), (idle, Flag.LITTLE_EXCITATION))
        return idle | slides, flag

    def of_theta(self, theta: Float[Array, "2"], covariance: Float[Array, "2 2"]) -> Estimate:
        """mu and c_p a^2 by S(47)-(48), their stds by the delta method.

        Args:
            theta: estimates (2,) [-]; mu needs a positive theta_1.
            covariance: (2, 2) of them.
        """
        curved = theta[1] > 0
        safe = jnp.where(curved, theta[1], 1.0)
        mu = jnp.where(curved, theta[0] ** 2 / safe * self.mu, jnp.nan)
        slope = jnp.stack([2 / theta[0], -1 / safe])  # of ln mu
        mu_std = mu * jnp.sqrt(jnp.sum(covariance * jnp.outer(slope, slope)))
        value = jnp.stack([mu, self.cpa2 * theta[0]])
        return Estimate(value, jnp.stack([mu_std, self.cpa2 * jnp.sqrt(covariance[0, 0])]))
