"""The aligning moment."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from tirefit.arrays import Scalar
from tirefit.models.brush import resultant
from tirefit.models.magic_formula import bent
from tirefit.models.mf.fields import Curve, Nominal, Point, Scaling, coefficient, cos_arctan, ratio
from tirefit.models.mf.lateral import PureLateral


class Aligning(eqx.Module):
    """Coefficients of M_z: trail, residual moment, and the arm of F_x."""

    QBZ1: float = coefficient("q_{Bz1}", "slope of the trail", "4.E40", 10.0)
    QBZ2: float = coefficient("q_{Bz2}", "the slope with load", "4.E40")
    QBZ3: float = coefficient("q_{Bz3}", "the slope with load squared", "4.E40")
    QBZ4: float = coefficient("q_{Bz4}", "the slope with camber", "4.E40")
    QBZ5: float = coefficient("q_{Bz5}", "the slope with |camber|", "4.E40")
    QBZ9: float = coefficient("q_{Bz9}", "slope of the residual moment", "4.E45")
    QBZ10: float = coefficient("q_{Bz10}", "the same, with B_y C_y", "4.E45")
    QCZ1: float = coefficient("q_{Cz1}", "shape factor of the trail", "4.E41", 1.1)
    QDZ1: float = coefficient("q_{Dz1}", "trail over R_0", "4.E42")
    QDZ2: float = coefficient("q_{Dz2}", "the trail with load", "4.E42")
    QDZ3: float = coefficient("q_{Dz3}", "the trail with camber", "4.E43")
    QDZ4: float = coefficient("q_{Dz4}", "the trail with camber squared", "4.E43")
    QDZ6: float = coefficient("q_{Dz6}", "residual moment over F_z R_0", "4.E47")
    QDZ7: float = coefficient("q_{Dz7}", "the same, with load", "4.E47")
    QDZ8: float = coefficient("q_{Dz8}", "the same, with camber", "4.E47")
    QDZ9: float = coefficient("q_{Dz9}", "the same, with camber and load", "4.E47")
    QDZ10: float = coefficient("q_{Dz10}", "the same, with camber squared", "4.E47")
    QDZ11: float = coefficient("q_{Dz11}", "the same, and load", "4.E47")
    QEZ1: float = coefficient("q_{Ez1}", "curvature of the trail", "4.E44")
    QEZ2: float = coefficient("q_{Ez2}", "curvature with load", "4.E44")
    QEZ3: float = coefficient("q_{Ez3}", "curvature with load squared", "4.E44")
    QEZ4: float = coefficient("q_{Ez4}", "curvature with alpha", "4.E44")
    QEZ5: float = coefficient("q_{Ez5}", "the same, with camber", "4.E44")
    QHZ1: float = coefficient("q_{Hz1}", "shift of the trail", "4.E35")
    QHZ2: float = coefficient("q_{Hz2}", "the shift with load", "4.E35")
    QHZ3: float = coefficient("q_{Hz3}", "the shift with camber", "4.E35")
    QHZ4: float = coefficient("q_{Hz4}", "the same, with load", "4.E35")
    PPZ1: float = coefficient("p_{pz1}", "the trail with pressure", "4.E42")
    PPZ2: float = coefficient("p_{pz2}", "the residual moment with pressure", "4.E47")
    SSZ1: float = coefficient("s_{sz1}", "arm of F_x over R_0", "4.E76")
    SSZ2: float = coefficient("s_{sz2}", "the arm with F_y", "4.E76")
    SSZ3: float = coefficient("s_{sz3}", "the arm with camber", "4.E76")
    SSZ4: float = coefficient("s_{sz4}", "the same, with load", "4.E76")

    def trail(self, at: Point, scale: Scaling, nominal: Nominal, slip: Scalar) -> Scalar:
        r"""Pneumatic trail [m], (4.E33) and (4.E40) to (4.E44).

        ``slip`` is :math:`(K_{x\kappa} / K_{y\alpha}) \kappa`. The peak is over FNOMIN
        without LFZO, as in MF-Tyre; the book scales it.
        """
        gamma = at.gamma * scale.LGAZ
        peak = (
            (nominal.UNLOADED_RADIUS / nominal.FNOMIN * at.fz)
            * (self.QDZ1 + self.QDZ2 * at.dfz)
            * (1 - self.PPZ1 * at.dpi)
            * (1 + gamma * (self.QDZ3 + self.QDZ4 * gamma))
            * scale.LTR
        )
        angle = self.QCZ1 * bent(*self.curve(at, scale, slip))
        return peak * jnp.cos(angle) * at.cos_alpha

    def curve(self, at: Point, scale: Scaling, slip: Scalar) -> Curve:
        """B_t alpha_t of both slips and E_t, (4.E35), (4.E40) and (4.E44)."""
        gamma = at.gamma * scale.LGAZ
        alpha = (
            at.alpha + (self.QHZ1 + self.QHZ2 * at.dfz) + (self.QHZ3 + self.QHZ4 * at.dfz) * gamma
        )
        slope = (
            (self.QBZ1 + at.dfz * (self.QBZ2 + self.QBZ3 * at.dfz))
            * (1 + self.QBZ4 * gamma + self.QBZ5 * abs(gamma))
            * ratio(scale.LKY, at.friction_y)
        )
        side = jnp.arctan(slope * self.QCZ1 * alpha) * (2 / jnp.pi)
        curvature = (self.QEZ1 + at.dfz * (self.QEZ2 + self.QEZ3 * at.dfz)) * (
            1 + (self.QEZ4 + self.QEZ5 * gamma) * side
        )
        return Curve(slope * _equivalent(alpha, slip), curvature)

    def residual(
        self, at: Point, scale: Scaling, nominal: Nominal, side: PureLateral, slip: Scalar
    ) -> Scalar:
        """M_zr / F_z [m], (4.E36) to (4.E38) and (4.E45) to (4.E47)."""
        gamma = at.gamma * scale.LGAZ
        alpha = at.alpha + side.offset + ratio(side.shift, side.stiffness)
        slope = self.QBZ9 * ratio(scale.LKY, at.friction_y) + self.QBZ10 * side.slope
        camber = (self.QDZ8 + self.QDZ9 * at.dfz) * (1 + self.PPZ2 * at.dpi)
        camber = camber + (self.QDZ10 + self.QDZ11 * at.dfz) * abs(gamma)
        peak = (self.QDZ6 + self.QDZ7 * at.dfz) * scale.LRES
        peak = (peak + camber * gamma * scale.LKZC) * at.friction_y
        peak = peak * nominal.UNLOADED_RADIUS
        return peak * cos_arctan(slope * _equivalent(alpha, slip)) * at.cos_alpha

    def arm(self, at: Point, scale: Scaling, nominal: Nominal, fy: Scalar) -> Scalar:
        """Lever s [m] of F_x about the vertical axis, (4.E76), also over FNOMIN."""
        relative = (
            self.SSZ1
            + self.SSZ2 * (fy / nominal.FNOMIN)
            + (self.SSZ3 + self.SSZ4 * at.dfz) * at.gamma
        )
        return nominal.UNLOADED_RADIUS * relative * scale.LS


def _equivalent(alpha: Scalar, slip: Scalar) -> Array:
    """Slip angle equivalent to both slips, without its sign, (4.E77) and (4.E78).

    The tangent and its inverse are those of Besselink et al. (2010). The curves that use
    it are even, and written without a division by it.
    """
    return jnp.arctan(resultant(jnp.tan(alpha), slip))
