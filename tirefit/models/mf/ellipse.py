r"""Combined slip by the friction ellipse: FE_METHOD = 'YES' of MF 5.0 and PAC2002.

With the slips :math:`\kappa_c` and :math:`\alpha^* = \sin\alpha_c` counted from where the
pure forces are zero, and without the vertical shifts,

.. math::
   F_x = F_{x0} \Big/ \sqrt{1 + \Big(\frac{F_{x0} - S_{Vx}}{\kappa_c}
         \frac{\alpha^*}{\mu_y F_z}\Big)^2}, \quad
   F_y = F_{y0} \Big/ \sqrt{1 + \Big(\frac{F_{y0} - S_{Vy}}{\alpha^*}
         \frac{\kappa_c}{\mu_x F_z}\Big)^2}

This is :math:`\mu_i F_{i0} / \mu_{i,act}` of Adams/Tire (PAC2002, "friction ellipse") and of
Chrono's ``ChPac02Tire``, without their angle :math:`\beta`, which has no derivative in pure
slip. The aligning moment follows from these forces as with weighting functions.
"""

import jax.numpy as jnp
from jaxtyping import Array

from tirefit.arrays import Scalar
from tirefit.models.mf.fields import Point, Scaling, ratio
from tirefit.models.mf.lateral import Lateral
from tirefit.models.mf.longitudinal import Longitudinal

_REST = 1e-9
"""Slip [-] below which the force over the slip is the stiffness: the difference of force and
shift is rounding there."""


def elliptic_forces(
    along: Longitudinal, across: Lateral, at: Point, scale: Scaling, fz0: Scalar
) -> tuple[Scalar, ...]:
    """F_x / F_z and F_y / F_z in combined slip, from the two pure curves.

    Args:
        at: operating point with both slips.
        fz0: scaled nominal load [N].
    """
    fx, stiffness = along.pure(at, scale)
    shift, side = along.shift(at, scale), across.pure(at, scale, fz0)
    kappa = at.kappa + along.offset(at, scale) + ratio(shift, stiffness)
    alpha = jnp.sin(at.alpha + side.offset + ratio(side.shift, side.stiffness))
    secant_x = _secant(fx - shift, kappa, stiffness)
    secant_y = _secant(side.force - side.shift, alpha, side.stiffness)
    return (
        fx / _length(ratio(secant_x * alpha, side.mu)),
        side.force / _length(ratio(secant_y * kappa, along.friction(at, scale))),
    )


def _secant(force: Scalar, slip: Scalar, stiffness: Scalar) -> Array:
    """The force over the slip; the stiffness at rest."""
    return jnp.where(jnp.abs(slip) < _REST, stiffness, ratio(force, slip))


def _length(x: Scalar) -> Array:
    """The hypotenuse of 1 and x."""
    return jnp.sqrt(1 + x * x)
