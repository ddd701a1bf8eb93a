r"""Pressure laws: distribution of the load over the contact patch.

The patch coordinate is :math:`\xi = x/a \in [-1, 1]`, +1 the leading edge; a law gives
the density :math:`p(\xi)` with :math:`\int p = 1`. All formulas are written in
:math:`u = 1 + \xi \in [0, 2]`, the distance from the trailing edge in half-lengths,
because u of the breakaway point is small at small slip and would lose digits as xi.

For demand ratio :math:`\rho = c_p a^2 \sigma / (\mu_s F_z)` a bristle sticks where
:math:`\rho (2 - u) \le p(u)`; the breakaway point solves it with equality.
"""

import abc
from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from tirefit.arrays import Numbers, Scalar
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

    def under(self, rho: Numbers, braking: Scalar, fz: Scalar) -> "AbstractPressure":
        """The law at demand ratio rho, share of braking in the slip, and load [N].

        Only some subclasses depend on these.
        """
        return self


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


@jax.custom_jvp
def _elliptic_cdf(u: Numbers) -> Array:
    # With xi = -cos(phi), P = (2 phi - sin 2 phi) / (2 pi).
    x = 4 * jnp.arctan2(jnp.sqrt(u), jnp.sqrt(2 - u))
    square = x**2
    terms = 1 - square / 110 * (1 - square / 156 * (1 - square / 210))
    small = x**3 / 6 * (1 - square / 20 * (1 - square / 42 * (1 - square / 72 * terms)))
    # The difference loses precision at small u.
    return jnp.where(x < 1, small, x - jnp.sin(x)) / (2 * jnp.pi)


@_elliptic_cdf.defjvp
def _elliptic_cdf_slope(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    # By the angle, the slope at both ends would be zero times infinity.
    (u,), (du,) = primals, tangents
    return _elliptic_cdf(u), _elliptic_density(u) * du


def _half_chord(u: Numbers) -> Array:
    """sqrt(1 - xi^2), with slope zero instead of infinity at both ends."""
    square = jnp.asarray(u * (2 - u))
    inside = square > 0
    return jnp.where(inside, jnp.sqrt(jnp.where(inside, square, 1.0)), 0.0)


def _elliptic_density(u: Numbers) -> Array:
    return 2 / jnp.pi * _half_chord(u)


class Elliptic(AbstractPressure):
    r""":math:`p = \tfrac{2}{\pi} \sqrt{1 - \xi^2}`, S §4.1: a circular patch.

    Some bristles slide at any slip, and the last one never slides.
    """

    def density(self, u: Numbers) -> Array:
        return _elliptic_density(u)

    def cdf(self, u: Numbers) -> Array:
        return _elliptic_cdf(u)

    def moment(self, u: Numbers) -> Array:
        return -2 / (3 * jnp.pi) * _half_chord(u) * u * (2 - u)

    def breakaway(self, rho: Numbers) -> Array:
        # u = 2 rho^2 / (rho^2 + k^2): p^2 = (k^2 u (2 - u)) at rho (2 - u).
        # The smaller of the two over the larger: neither square overflows.
        k = 2 / jnp.pi
        mostly = rho > k
        square = (jnp.where(mostly, k, rho) / jnp.where(mostly, rho, k)) ** 2
        return jnp.where(mostly, 2.0, 2 * square) / (1 + square)


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


def reference_load() -> Any:
    """The field of the load at which load-dependent parameters have their value."""
    return par(
        4000.0, (1e-3, 1e6), "N", "reference load of the load-dependent parameters", "S §2.1",
        "F_{z0}", free=False, scale="log",
    )  # fmt: skip


def _within(d: Scalar) -> float:
    """d limited to the range in which one breakaway point describes the patch."""
    return cast(float, jnp.clip(d, -1 / 3, 1.0))


class ForceAsymmetric(Asymmetric):
    r""":math:`d + d_F F_x / (\mu_s F_z)`: the pressure moves with the brake force.

    S §4.1 expects it to move back when braking, :math:`d_F < 0`. The force is computed
    with static friction of the sliding bristles, so that d depends only on the demand
    ratio and the direction of slip; a lateral force does not move it. The result is
    limited to the range of S(24).
    """

    d_force: float = par(
        -0.2, (-1.0, 1.0), "-", "change of d per brake force over friction, F_x / (mu_s F_z)",
        "S §4.1", "d_F",
    )  # fmt: skip

    def under(self, rho: Scalar, braking: Scalar, fz: Scalar) -> Asymmetric:
        share = self.d_force * braking

        def newton(_: Array | int, d: float) -> float:
            law = Asymmetric(d)
            u = law.breakaway(rho)
            force = law.cdf(u) + rho * (2 - u) ** 2 / 2
            miss = d - self.d - share * force
            return _within(d - miss / (1 + share * 3 / 16 * (u * (2 - u)) ** 2))

        # The force falls by 3/16 u^2 (2-u)^2 <= 3/16 per d, so the equation has one
        # solution, to which these steps converge within rounding.
        start = _within(self.d + 0 * share * rho)
        return Asymmetric(jax.lax.fori_loop(0, 5, newton, start))


class LoadAsymmetric(Asymmetric):
    r""":math:`d + d_z (F_z - F_{z0}) / F_{z0}`, limited to the range of S(24).

    The load changes the flattening of the tread, and so the asymmetry (S §2.1, §4.1).
    """

    d_load: float = par(
        0.2, (-2.0, 2.0), "-", "change of d per relative change of the load", "S §4.1", "d_z"
    )
    fz0: float = reference_load()

    def under(self, rho: Scalar, braking: Scalar, fz: Scalar) -> Asymmetric:
        return Asymmetric(_within(self.d + self.d_load * (fz / self.fz0 - 1)))
