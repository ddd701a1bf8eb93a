r"""Combined slip beyond one brush: S(21), scaled pure-slip curves, and O(12)-(22).

The isotropic and the anisotropic brush are in ``tirefit.models.brush``.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from tirefit.arrays import Numbers, Scalar
from tirefit.models.base import AbstractTire, TireForces, TireInputs
from tirefit.models.brush import Brush, bristle_stiffness, friction_coefficient, polar, resultant
from tirefit.models.magic_formula import MagicFormula
from tirefit.params import par, specs
from tirefit.slip import kappa_from_sigma, lateral_slip


def mu_rate(slip: Numbers, stiffness: Numbers, mu_fz: Numbers) -> Array:
    r"""Friction in use :math:`\gamma = F / (\mu F_z)` of O(12)-(20), from 0 to 1.

    Args:
        slip: resultant :math:`\kappa = \sqrt{\kappa_x^2 + \kappa_y^2} \ge 0` [-], with
            :math:`\kappa_y = (K_\beta / K_s) \sigma_y`.
        stiffness: :math:`K_s = 2 c_p a^2` [N].
        mu_fz: friction times load [N], > 0.
    """
    sliding = jnp.minimum(stiffness * slip / (3 * mu_fz), 1.0)
    # 1 - (1 - sliding)^3 without its cancellation at small slip.
    return sliding * (3 - sliding * (3 - sliding))


def braking_slope(rate: Numbers, stiffness: Numbers, direction: Numbers = 0.0) -> Array:
    r""":math:`\partial F_x / \partial \kappa_x` at fixed :math:`\kappa_y` [N], O(22).

    .. math::
       v_w k = K_s \left[\Xi^2 \cos^2\theta
               + \frac{\gamma}{3 (1 - \Xi)} \sin^2\theta\right],
       \quad \Xi = (1 - \gamma)^{1/3}

    k [N s/m] is the extended braking stiffness at the wheel speed :math:`v_w` [m/s]. Along the
    force, :math:`\theta = 0`, it is O(21), :math:`K_s (1-\gamma)^{2/3}`. It depends only on
    stiffness and friction in use, not on the friction.

    Args:
        rate: friction in use :math:`\gamma` [-], 0 to 1.
        stiffness: :math:`K_s` [N].
        direction: :math:`\theta` of the force [rad], tan = kappa_y / kappa_x.
    """
    # Share of the patch that sticks.
    partly = rate < 1
    sticking = jnp.where(partly, jnp.cbrt(jnp.where(partly, 1 - rate, 1.0)), 0.0)
    # gamma / (1 - Xi) = 1 + Xi + Xi^2, which is defined at gamma = 0.
    across = (1 + sticking + sticking**2) / 3
    cos, sin = jnp.cos(direction), jnp.sin(direction)
    return (sticking**2 * cos**2 + across * sin**2) * stiffness


class LiuPeng(AbstractTire):
    r"""The brush of Liu and Peng for two slips, S(21) with its last term corrected.

    .. math::
       F_{x,y} = \frac{k_{x,y} \sigma_{x,y}}{\sqrt{(k_x\sigma_x)^2 + (k_y\sigma_y)^2}}
           \left(3c\sigma - 3 \frac{(c\sigma)^2}{\mu F_z}
                 + \frac{(c\sigma)^3}{(\mu F_z)^2}\right),
       \quad \sigma = \sqrt{\sigma_x^2 + \sigma_y^2}

    with :math:`3c = 2 c_p a^2`; :math:`\mu F_z` in full sliding. Only the ratio
    :math:`k_y/k_x` matters, and only to the direction: c is one constant, so both pure
    slips have the same curve, and between them the force at small slip is not linear in
    the slips unless the ratio is one. A tire of two stiffnesses is an
    ``AnisotropicBrush``. S gives no aligning moment.
    """

    cpa2: float = bristle_stiffness()
    mu: float = friction_coefficient()
    k_ratio: float = par(
        0.7, (0.05, 20.0), "-", "turn of the force, k_y / k_x", "S(21)", "k_y / k_x", scale="log"
    )

    def __call__(self, inputs: TireInputs) -> TireForces:
        slip_x = inputs.sigma_x
        slip_y = lateral_slip(jnp.tan(inputs.alpha), slip_x)
        slip = resultant(slip_x, slip_y)
        force, _ = Brush(self.cpa2, self.mu).pure(slip, inputs.fz, 0.0)
        # Each length is that of its own slip at rest: both pure slopes are 2 c_p a^2.
        along = polar(slip_x, self.k_ratio * slip_y)[1]
        across = polar(slip_x / self.k_ratio, slip_y)[2]
        return TireForces(along * force, across * force, None)


_FASTEST_SPIN = 1 - 1e-6
"""Largest driving slip -sigma at which a curve is evaluated; 1 is a spinning wheel at
standstill."""


def scaled_to_combined(
    along: Callable[[Array], Array],
    across: Callable[[Array], Array],
    inputs: TireInputs,
    sliding: tuple[Scalar, Scalar],
) -> TireForces:
    r"""Combined slip of any two pure-slip curves (Gäfvert & Svendenius 2005).

    In a brush with parabolic pressure a share :math:`\psi` of the patch slides,

    .. math:: \psi = \sqrt{(\sigma_x / \sigma^\circ_x)^2
                           + (\sigma_y / \sigma^\circ_y)^2},

    and the part :math:`A = 3 (1-\psi)^2 / (3 - 3\psi + \psi^2)` of the pure-slip force at the same
    :math:`\psi` comes from sticking bristles, the remainder from sliding ones. The first has the
    direction of the elastic deflection, the second is opposite to the sliding velocity:

    .. math::
       F_x = \hat F_x(\sigma^\circ_x \psi) \left[A \frac{\sigma_x}{\sigma^\circ_x \psi}
             + (1 - A) \frac{\sigma_x}{\sqrt{\sigma_x^2 + \sigma_y^2}}\right]

    and similarly :math:`F_y`. In full sliding the force is on the ellipse of both
    pure-slip forces. The curves of both directions are blended by the cosine of the direction of
    slip, and must pass through zero at zero slip.

    Args:
        along, across: pure-slip fx and fy [N] of one physical slip of either sign.
        inputs: one sample; its slips are used.
        sliding: physical slips of full sliding :math:`\sigma^\circ_x, \sigma^\circ_y`:
            :math:`3 F_{max} / C` with C the slope at rest, which is the slip from which every
            bristle slides of a brush with parabolic pressure and constant friction.
    """
    limit_x, limit_y = sliding
    slip_x = inputs.sigma_x
    slip_y = lateral_slip(jnp.tan(inputs.alpha), slip_x)
    psi, stuck_x, stuck_y = polar(jnp.asarray(slip_x / limit_x), jnp.asarray(slip_y / limit_y))
    _, slid_x, slid_y = polar(jnp.asarray(slip_x), jnp.asarray(slip_y))
    forward = psi * limit_x
    # Forces (2,) of both sides.
    x_slips = jnp.stack([forward, -jnp.minimum(forward, _FASTEST_SPIN)])
    braking = jax.vmap(along)(x_slips)
    aside = jax.vmap(across)(jnp.stack([psi * limit_y, -psi * limit_y]))
    turn = turned(psi, stuck_y, slid_y)
    return TireForces(
        turned(psi, stuck_x, slid_x) * blend(slid_x, braking), turn * blend(slid_y, aside), None
    )


def turned(psi: Numbers, stuck: Numbers, slid: Numbers) -> Array:
    r"""Direction cosine of the force of a partly sliding patch.

    Args:
        psi: share of the patch that slides, :math:`\psi`; values above 1 count as 1.
        stuck, slid: cosines of the elastic deflection and of the sliding velocity.
    """
    share = jnp.minimum(psi, 1.0)
    sticks = 3 * (1 - share) ** 2 / (3 - share * (3 - share))
    return sticks * stuck + (1 - sticks) * slid


def blend(cosine: Array, force: Array | tuple[Scalar, Scalar]) -> Array:
    """Magnitude of a force (2,) between those of the two sides."""
    return ((1 + cosine) * force[0] - (1 - cosine) * force[1]) / 2


def _of_axis(name: str, axis: str, words: str) -> Any:
    """The parameter of the pure-slip Magic Formula, for one axis."""
    spec = specs(MagicFormula())[name]
    return par(
        spec.default, spec.bounds, spec.unit, f"{spec.meaning}, {words}", spec.source,
        f"{spec.symbol}_{axis}", free=spec.free, scale=spec.scale,
    )  # fmt: skip


def _sliding(axis: str, words: str) -> Any:
    return par(
        1.0, (0.2, 5.0), "-", f"slip of full sliding over its nominal 3/(BC), {words}", "S §2.3",
        rf"\lambda_{axis}", free=False, scale="log",
    )  # fmt: skip


class CombinedMagicFormula(AbstractTire):
    r"""Two pure-slip Magic Formulas scaled to combined slip, without coefficients for it.

    The slip of full sliding is :math:`3 F_{max} / C = 3 / (B C)` of each formula, times
    ``sliding_x`` and ``sliding_y``. It has no aligning moment.
    """

    Bx: float = _of_axis("B", "x", "longitudinal")
    Cx: float = _of_axis("C", "x", "longitudinal")
    Dx: float = _of_axis("D", "x", "longitudinal")
    Ex: float = _of_axis("E", "x", "longitudinal")
    By: float = _of_axis("B", "y", "lateral")
    Cy: float = _of_axis("C", "y", "lateral")
    Dy: float = _of_axis("D", "y", "lateral")
    Ey: float = _of_axis("E", "y", "lateral")
    sliding_x: float = _sliding("x", "longitudinal")
    sliding_y: float = _sliding("y", "lateral")

    def __call__(self, inputs: TireInputs) -> TireForces:
        fz = jnp.maximum(inputs.fz, 0.0)
        along = MagicFormula(self.Bx, self.Cx, self.Dx, self.Ex)
        across = MagicFormula(self.By, self.Cy, self.Dy, self.Ey)
        return scaled_to_combined(
            lambda slip: along.pure(kappa_from_sigma(slip), fz),
            lambda slip: across.pure(jnp.arctan(slip), fz),
            inputs,
            (self.sliding_x * 3 / (self.Bx * self.Cx), self.sliding_y * 3 / (self.By * self.Cy)),
        )
