r"""Pressure laws: distribution of the load over the contact patch.

The patch coordinate is :math:`\xi = x/a \in [-1, 1]`, +1 the leading edge; a law gives
the density :math:`p(\xi)` with :math:`\int p = 1`. All formulas are written in
:math:`u = 1 + \xi \in [0, 2]`, the distance from the trailing edge in half-lengths,
because u of the breakaway point is small at small slip and would lose digits as xi.

For demand ratio :math:`\rho = c_p a^2 \sigma / (\mu_s F_z)` a bristle sticks where
:math:`\rho (2 - u) \le p(u)`; the breakaway point solves it with equality.
"""

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from tirefit.arrays import Numbers
from tirefit.params import par


class AbstractPressure(eqx.Module):
    """Density, its integrals from the trailing edge, and the breakaway point."""

    @abc.abstractmethod
    def density(self, u: Numbers) -> Numbers:
        """p at u [-], any shape."""

    @abc.abstractmethod
    def cdf(self, u: Numbers) -> Numbers:
        r"""Share of the load behind u: :math:`P = \int_{0}^{u} p`."""

    @abc.abstractmethod
    def moment(self, u: Numbers) -> Numbers:
        r"""First moment behind u: :math:`Q = \int_{0}^{u} (u' - 1)\,p\,du'`."""

    @abc.abstractmethod
    def breakaway(self, rho: Numbers) -> Array:
        """u of the breakaway point for demand ratio rho >= 0; 0 sticking, 2 sliding."""


class Parabolic(AbstractPressure):
    r""":math:`p = \tfrac34 (1 - \xi^2)`, S(10), S(23); full sliding above rho = 3/2."""

    def density(self, u: Numbers) -> Numbers:
        return 0.75 * u * (2 - u)

    def cdf(self, u: Numbers) -> Numbers:
        return u**2 * (3 - u) / 4

    def moment(self, u: Numbers) -> Numbers:
        return -3 / 16 * u**2 * (2 - u) ** 2

    def breakaway(self, rho: Numbers) -> Array:
        return jnp.minimum(4 / 3 * rho, 2.0)


class Uniform(AbstractPressure):
    r""":math:`p = \tfrac12`; sticks everywhere to rho = 1/4, never slides entirely."""

    def density(self, u: Numbers) -> Numbers:
        return 0.5 * jnp.ones_like(u)

    def cdf(self, u: Numbers) -> Numbers:
        return u / 2

    def moment(self, u: Numbers) -> Numbers:
        return u * (u - 2) / 4

    def breakaway(self, rho: Numbers) -> Array:
        sliding = rho > 0.25
        return jnp.where(sliding, 2 - 0.5 / jnp.where(sliding, rho, 1.0), 0.0)


class Asymmetric(AbstractPressure):
    r""":math:`p = \tfrac34 (1 - \xi^2)(1 + d \xi)`, S(24); d > 0 leans forward.

    Full sliding above :math:`\rho = \tfrac32 (1 + d)`, S(30). Below d = -1/3 bristles
    slide at the leading edge first, and one breakaway point does not describe the patch.
    """

    d: float = par(
        0.0, (-1 / 3, 1.0), "-",
        "asymmetry of the pressure distribution, > 0 towards the leading edge", "S(24)", "d",
    )  # fmt: skip

    def density(self, u: Numbers) -> Numbers:
        return 0.75 * u * (2 - u) * (1 + self.d * (u - 1))

    def cdf(self, u: Numbers) -> Numbers:
        symmetric = u**2 * (1 - u / 3)
        skew = u**3 * (2 / 3 - u / 4)
        return 0.75 * ((1 - self.d) * symmetric + self.d * skew)

    def moment(self, u: Numbers) -> Numbers:
        skew = u**2 * (3 / 4 + u * (-5 / 4 + u * (3 / 4 - 3 / 20 * u)))
        return -3 / 16 * u**2 * (2 - u) ** 2 + self.d * skew

    def breakaway(self, rho: Numbers) -> Array:
        full = 1.5 * (1 + self.d)
        sliding = rho >= full
        # Limit rho first: for d < 0 the root below turns negative beyond full sliding.
        rho = jnp.where(sliding, 0.0, rho)
        square = (1 - self.d) ** 2 + 16 / 3 * self.d * rho
        # At d = 1 and zero slip the root is zero and its slope infinite.
        root = jnp.sqrt(jnp.maximum(square, 1e-30))
        # S(27) with numerator and denominator multiplied out: no division by d.
        return jnp.where(sliding, 2.0, 8 / 3 * rho / (1 - self.d + root))


class Quartic(AbstractPressure):
    r""":math:`p = \tfrac58 (1 - \xi^4)`, S(25); full sliding above rho = 5/2."""

    def density(self, u: Numbers) -> Numbers:
        return 0.625 * u * (2 - u) * (u**2 - 2 * u + 2)

    def cdf(self, u: Numbers) -> Numbers:
        return 0.625 * u**2 * (2 + u * (-2 + u * (1 - u / 5)))

    def moment(self, u: Numbers) -> Numbers:
        polynomial = -2 + u * (10 / 3 + u * (-5 / 2 + u * (1 - u / 6)))
        return 0.625 * u**2 * polynomial

    def breakaway(self, rho: Numbers) -> Array:
        sliding = rho >= 2.5
        demand = 1.6 * jnp.where(sliding, 0.0, rho)
        # u^3 - 2u^2 + 2u = demand has one real root (hyperbolic form); one Newton step
        # restores the digits that adding 2/3 loses at small slip.
        q = 20 / 27 - demand
        root_third = jnp.sqrt(2.0) / 3
        w = -2 * root_third * jnp.sinh(jnp.arcsinh(q * 2.25 / root_third) / 3)
        u = w + 2 / 3
        u = u - (u * (u * (u - 2) + 2) - demand) / (u * (3 * u - 4) + 2)
        return jnp.where(sliding, 2.0, u)
