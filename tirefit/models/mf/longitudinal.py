"""The longitudinal force."""

import equinox as eqx
import jax.numpy as jnp

from tirefit.arrays import Scalar
from tirefit.models.magic_formula import bent
from tirefit.models.mf.fields import Curve, Point, Scaling, Weight, coefficient, cos_arctan, ratio


class Longitudinal(eqx.Module):
    """Coefficients of F_x; forces and stiffnesses are per unit of load."""

    PCX1: float = coefficient("p_{Cx1}", "shape factor of F_x", "4.E11", 1.65)
    PDX1: float = coefficient("p_{Dx1}", "friction mu_x", "4.E13", 1.0)
    PDX2: float = coefficient("p_{Dx2}", "mu_x with load", "4.E13")
    PDX3: float = coefficient("p_{Dx3}", "mu_x with camber squared", "4.E13")
    PEX1: float = coefficient("p_{Ex1}", "curvature of F_x", "4.E14")
    PEX2: float = coefficient("p_{Ex2}", "curvature with load", "4.E14")
    PEX3: float = coefficient("p_{Ex3}", "curvature with load squared", "4.E14")
    PEX4: float = coefficient("p_{Ex4}", "curvature in driving", "4.E14")
    PKX1: float = coefficient("p_{Kx1}", "slip stiffness over load", "4.E15", 20.0)
    PKX2: float = coefficient("p_{Kx2}", "slip stiffness with load", "4.E15")
    PKX3: float = coefficient("p_{Kx3}", "exponent of slip stiffness", "4.E15")
    PHX1: float = coefficient("p_{Hx1}", "horizontal shift of F_x", "4.E17")
    PHX2: float = coefficient("p_{Hx2}", "horizontal shift with load", "4.E17")
    PVX1: float = coefficient("p_{Vx1}", "vertical shift of F_x over load", "4.E18")
    PVX2: float = coefficient("p_{Vx2}", "vertical shift with load", "4.E18")
    PPX1: float = coefficient("p_{px1}", "slip stiffness with pressure", "4.E15")
    PPX2: float = coefficient("p_{px2}", "the same, quadratic", "4.E15")
    PPX3: float = coefficient("p_{px3}", "mu_x with pressure", "4.E13")
    PPX4: float = coefficient("p_{px4}", "the same, quadratic", "4.E13")
    RBX1: float = coefficient("r_{Bx1}", "slope of the weighting of F_x", "4.E54")
    RBX2: float = coefficient("r_{Bx2}", "the slope with kappa", "4.E54")
    RBX3: float = coefficient("r_{Bx3}", "the slope with camber squared", "4.E54")
    RCX1: float = coefficient("r_{Cx1}", "shape of the weighting of F_x", "4.E55")
    REX1: float = coefficient("r_{Ex1}", "curvature of the weighting", "4.E56")
    REX2: float = coefficient("r_{Ex2}", "the curvature with load", "4.E56")
    RHX1: float = coefficient("r_{Hx1}", "shift of the weighting of F_x", "4.E57")

    def pure(self, at: Point, scale: Scaling) -> tuple[Scalar, Scalar]:
        """F_x0 / F_z and K_xk / F_z at zero slip angle, (4.E9) to (4.E18)."""
        mu, stiffness = self.friction(at, scale), self.stiffness(at, scale)
        angle = self.PCX1 * scale.LCX * bent(*self.curve(at, scale))
        return mu * jnp.sin(angle) + self.shift(at, scale), stiffness

    def shift(self, at: Point, scale: Scaling) -> Scalar:
        """S_Vx / F_z, (4.E18)."""
        return (self.PVX1 + self.PVX2 * at.dfz) * scale.LVX * at.friction_x

    def offset(self, at: Point, scale: Scaling) -> Scalar:
        """S_Hx, (4.E17)."""
        return (self.PHX1 + self.PHX2 * at.dfz) * scale.LHX

    def friction(self, at: Point, scale: Scaling) -> Scalar:
        """mu_x, (4.E13)."""
        return (
            (self.PDX1 + self.PDX2 * at.dfz)
            * (1 + at.dpi * (self.PPX3 + self.PPX4 * at.dpi))
            * (1 - self.PDX3 * (at.camber * scale.LGAX) ** 2)
            * at.friction_x
        )

    def stiffness(self, at: Point, scale: Scaling) -> Scalar:
        """K_xk / F_z, (4.E15)."""
        return (
            (self.PKX1 + self.PKX2 * at.dfz)
            * jnp.exp(self.PKX3 * at.dfz)
            * (1 + at.dpi * (self.PPX1 + self.PPX2 * at.dpi))
            * scale.LKX
        )

    def curve(self, at: Point, scale: Scaling) -> Curve:
        """B_x kappa_x and E_x, (4.E10) to (4.E17)."""
        kappa = at.kappa + self.offset(at, scale)
        curvature = (
            (self.PEX1 + at.dfz * (self.PEX2 + self.PEX3 * at.dfz))
            * (1 - self.PEX4 * jnp.sign(kappa))
            * scale.LEX
        )
        shape = self.PCX1 * scale.LCX
        slope = ratio(self.stiffness(at, scale), shape * self.friction(at, scale))
        return Curve(slope * kappa, curvature)

    def weight(self, at: Point, scale: Scaling) -> Weight:
        """G_xa of combined slip, (4.E51) to (4.E57)."""
        slope = (self.RBX1 + self.RBX3 * at.gamma**2) * scale.LXAL
        slope = slope * cos_arctan(self.RBX2 * at.kappa)
        curve = Curve(slope * (at.alpha + self.RHX1), self.REX1 + self.REX2 * at.dfz)
        return Weight(curve, slope * self.RHX1, self.RCX1)
