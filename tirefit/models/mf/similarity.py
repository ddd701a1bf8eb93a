r"""Combined slip without coefficients of combined slip: similarity, or the friction ellipse.

**Similarity.** Each slip is normalised by :math:`\mu_i F_z / K_i`, the slip at which its linear
force reaches the friction limit; P(4.E78) normalises the slips of the trail by their
stiffnesses in the same way. The pure forces are evaluated at the resultant s of the
normalised slips and resolved by the direction of the slips (Pacejka 2012, section 4.2):

.. math::
   F_i = c_i F_i^-(s) + c_i^2 F_i^+(s) + (1 - c_i^2) \frac{F_i^+(0)}{1 + s^2}

:math:`F^-` and :math:`F^+` are the odd and the even part of a pure force over its
normalised slip, so the force changes smoothly from driving to braking and from left to
right. The direction cosine :math:`c_i` changes with s from that of the elastic
deflection (normalised slips) to that of the sliding velocity, as in
:func:`~tirefit.models.combined.scaled_to_combined`; a brush slides wholly at s = 3. In
pure slip the force of that slip is the pure force, and the other force is its value at
rest, which decreases with s. Without shifts the force lies within the ellipse of the
two largest pure forces.

**Friction ellipse**, FE_METHOD = 'YES' of MF 5.0 and PAC2002. With the slips
:math:`\kappa_c` and :math:`\alpha^* = \sin\alpha_c` counted from where the pure forces are zero,
and without the vertical shifts,

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
import numpy as np
from jaxtyping import Array

from tirefit.arrays import Scalar
from tirefit.models.combined import blend, turned
from tirefit.models.mf.fields import Point, Scaling, ratio
from tirefit.models.mf.lateral import Lateral
from tirefit.models.mf.longitudinal import Longitudinal


def similar_forces(
    along: Longitudinal, across: Lateral, at: Point, scale: Scaling, fz0: Scalar
) -> tuple[Scalar, ...]:
    """F_x / F_z and F_y / F_z in combined slip, from the two pure curves.

    Args:
        at: operating point with both slips.
        fz0: scaled nominal load [N].
    """
    side = across.pure(at, scale, fz0)
    limit_x = abs(ratio(along.friction(at, scale), along.stiffness(at, scale)))
    limit_y = abs(ratio(side.mu, side.stiffness))
    slips = at.kappa, at.tan_alpha
    stuck = ratio(slips[0], limit_x), ratio(slips[1], limit_y)
    resultant, sliding = _length(*stuck), _length(*slips)
    cosines = [
        turned(resultant / 3, stick / resultant, other / sliding)
        for stick, other in zip(stuck, slips, strict=True)
    ]

    def fx(slip: Array) -> Scalar:
        return along.pure(at._replace(kappa=slip * limit_x), scale)[0]

    def fy(slip: Array) -> Scalar:
        return across.pure(at.turned(slip * limit_y), scale, fz0).force

    return tuple(
        cosine * blend(cosine, (pure(resultant), pure(-resultant)))
        + (1 - cosine**2) * pure(0 * resultant) / (1 + resultant**2)
        for pure, cosine in zip((fx, fy), cosines, strict=True)
    )


def _length(x: Scalar, y: Scalar) -> Array:
    """Resultant; positive at rest, where its derivative must exist."""
    square = jnp.asarray(x**2 + y**2)
    return jnp.sqrt(square + np.finfo(square.dtype).eps)


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
        fx / jnp.hypot(1.0, ratio(secant_x * alpha, side.mu)),
        side.force / jnp.hypot(1.0, ratio(secant_y * kappa, along.friction(at, scale))),
    )


def _secant(force: Scalar, slip: Scalar, stiffness: Scalar) -> Array:
    """The force over the slip; the stiffness at rest."""
    return jnp.where(jnp.abs(slip) < _REST, stiffness, ratio(force, slip))
