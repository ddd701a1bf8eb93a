r"""The LuGre tire in steady state: distributed over the patch, S(18), and lumped,
S(17).

A bristle that has rolled a distance :math:`\zeta` from the leading edge is deflected by
:math:`z = \frac{g}{\sigma_0} (1 - e^{-\sigma_0 |\lambda| \zeta / g})` along the sliding
velocity :math:`v_s`. The mean over the patch of length 2a of
:math:`\sigma_0 z + \sigma_1 \dot z + \sigma_2 v_s` is S(18), written here without its
cancellation at small slip:

.. math:: F = F_z \lambda \, [\sigma_0 2a \, \varphi_2(x)
              + (\sigma_1 \varphi_1(x) + \sigma_2) |\Omega R_e|],
          \quad x = \sigma_0 2a |\lambda| / g(|v_s|)

with :math:`\varphi_1 = (1 - e^{-x})/x` and :math:`\varphi_2 = (1 - \varphi_1)/x`. The
bristle equation is isotropic, so in combined slip :math:`\lambda` is the vector of
physical slips and :math:`v_s = \lambda |\Omega R_e|`. ``tirefit.sim.lugre`` has the
dynamic forms.
"""

import math
from dataclasses import replace

import jax.numpy as jnp
from jaxtyping import Array

from tirefit.arrays import Numbers, Scalar
from tirefit.models.base import AbstractTire, TireForces, TireInputs
from tirefit.models.brush import polar, resultant
from tirefit.models.friction import Stribeck, falling_exponent, falling_speed
from tirefit.params import par
from tirefit.slip import lateral_slip

# phi_2 = sum of (-x)^k / (k + 2)!, to the last digit for x < 1; highest power first.
_SERIES = [(-1.0) ** k / math.factorial(k + 2) for k in reversed(range(18))]


def patch_means(x: Numbers) -> tuple[Array, Array]:
    r"""The functions :math:`\varphi_1, \varphi_2` of -x that average over the patch.

    Args:
        x: length of the patch over the distance in which a bristle yields, >= 0.

    Returns:
        (1 - e^-x)/x, which is 1 at x = 0, and (e^-x - 1 + x)/x^2, which is 1/2; both and
        their derivatives are exact to rounding for every x.
    """
    near = x < 1
    small = jnp.where(near, x, 0.0)
    large = jnp.where(near, 1.0, x)
    second_near = jnp.zeros_like(small)
    for factor in _SERIES:
        second_near = second_near * small + factor
    first_far = -jnp.expm1(-large) / large
    first = jnp.where(near, 1 - small * second_near, first_far)
    return first, jnp.where(near, second_near, (1 - first_far) / large)


class AbstractLuGre(AbstractTire):
    """Sliding friction of both forms: the friction level g of S(17c) and sigma_2."""

    mu_s: float = par(
        1.2, (0.01, 5.0), "-", "level of g at rest (static friction)", "S(17c)", r"\mu_s"
    )
    mu_c: float = par(0.6, (0.01, 5.0), "-", "level of g at high sliding speed", "S(17c)", r"\mu_c")
    v_st: float = falling_speed(10.0, source="S(17c)")
    exponent: float = falling_exponent(free=False, source="S(17c)")
    sigma2: float = par(
        0.001, (0.0, 1.0), "s/m", "viscous friction over load", "S(17b)", r"\sigma_2"
    )

    @property
    def needs(self) -> tuple[str, ...]:
        return ("v",)

    def level(self, v_s: Numbers) -> Numbers:
        """g [-] at sliding speed v_s [m/s] >= 0, S(17c)."""
        law = Stribeck(self.mu_c, self.v_st, self.exponent)
        return law.apply(self.mu_s, v_s)

    def scaled(self, theta: float) -> "AbstractLuGre":
        """The tire with theta g in the place of g, S section 3.4; theta [-]."""
        return replace(self, mu_s=theta * self.mu_s, mu_c=theta * self.mu_c)


def _motion(inputs: TireInputs) -> tuple[Scalar, Scalar, Array, Scalar]:
    """Physical slips [-], their length, the speed |Omega R_e| of the tread [m/s]."""
    slip_x = inputs.sigma_x
    slip_y = lateral_slip(jnp.tan(inputs.alpha), slip_x)
    return slip_x, slip_y, resultant(slip_x, slip_y), inputs.v / (1 + slip_x)


class LuGreLumped(AbstractLuGre):
    r"""Steady state of the lumped LuGre S(17): :math:`F = F_z (g + \sigma_2 |v_s|)`.

    It is opposite to the sliding velocity, and has its full size at the smallest slip, as
    the lumped form ignores that bristles leave the patch. Without slip the force is set
    to zero (the lumped form would keep its previous force).
    """

    def __call__(self, inputs: TireInputs) -> TireForces:
        slip_x, slip_y, _, v_r = _motion(inputs)
        slip, along, across = polar(jnp.asarray(slip_x), jnp.asarray(slip_y))
        v_s = slip * v_r
        force = inputs.fz * (inputs.fz > 0) * (self.level(v_s) + self.sigma2 * v_s)
        sliding = (slip_x != 0) | (slip_y != 0)
        along = jnp.where(sliding, along, 0.0)
        across = jnp.where(sliding, across, 0.0)
        return TireForces(along * force, across * force, None)


class LuGre(AbstractLuGre):
    """Steady state of the distributed LuGre, S(18), pure or combined slip.

    S(18) depends only on the product of sigma_0 and 2a, so the length is held. The other
    six parameters need data at several speeds: at one speed sigma_1 has the effect of
    sigma_0 on the rise, and sigma_2 that of mu_c and v_st on the tail.
    """

    sigma0: float = par(
        100.0, (0.1, 1e6), "1/m", "bristle stiffness over load", "S(17b)", r"\sigma_0", scale="log"
    )
    sigma1: float = par(0.1, (0.0, 10.0), "s/m", "bristle damping over load", "S(17b)", r"\sigma_1")
    length: float = par(
        0.2, (1e-3, 2.0), "m", "length 2a of the contact patch", "S(18)", "2a", free=False,
        scale="log",
    )  # fmt: skip

    def __call__(self, inputs: TireInputs) -> TireForces:
        slip_x, slip_y, slip, v_r = _motion(inputs)
        stiffness = self.sigma0 * self.length
        first, second = patch_means(stiffness * slip / self.level(slip * v_r))
        damping = (self.sigma1 * first + self.sigma2) * v_r
        per_slip = (stiffness * second + damping) * (inputs.fz * (inputs.fz > 0))
        return TireForces(per_slip * slip_x, per_slip * slip_y, None)
