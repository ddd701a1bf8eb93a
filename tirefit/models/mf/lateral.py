"""The lateral force."""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from tirefit.arrays import Scalar
from tirefit.models.magic_formula import bent
from tirefit.models.mf.fields import Curve, Point, Scaling, Weight, coefficient, cos_arctan, ratio


class PureLateral(NamedTuple):
    """F_y at zero kappa, and its parts that the aligning moment uses."""

    force: Any  # per unit of load
    stiffness: Any  # K_ya, per unit of load
    slope: Any  # B_y C_y
    offset: Any  # S_Hy
    shift: Any  # S_Vy, per unit of load
    mu: Any  # friction
    curve: Curve  # B_y alpha_y with E_y


class Lateral(eqx.Module):
    """Coefficients of F_y; forces and stiffnesses are per unit of load."""

    PCY1: float = coefficient("p_{Cy1}", "shape factor of F_y", "4.E21", 1.3)
    PDY1: float = coefficient("p_{Dy1}", "friction mu_y", "4.E23", 1.0)
    PDY2: float = coefficient("p_{Dy2}", "mu_y with load", "4.E23")
    PDY3: float = coefficient("p_{Dy3}", "mu_y with camber squared", "4.E23")
    PEY1: float = coefficient("p_{Ey1}", "curvature of F_y", "4.E24")
    PEY2: float = coefficient("p_{Ey2}", "curvature with load", "4.E24")
    PEY3: float = coefficient("p_{Ey3}", "curvature with the sign of alpha", "4.E24")
    PEY4: float = coefficient("p_{Ey4}", "the same, with camber", "4.E24")
    PEY5: float = coefficient("p_{Ey5}", "curvature with camber squared", "4.E24")
    PKY1: float = coefficient("p_{Ky1}", "largest cornering stiffness over F_z0", "4.E25", -20.0)
    PKY2: float = coefficient("p_{Ky2}", "load of the largest stiffness over F_z0", "4.E25", 2.0)
    PKY3: float = coefficient("p_{Ky3}", "stiffness with camber", "4.E25")
    PKY4: float = coefficient("p_{Ky4}", "curvature of the stiffness", "4.E25", 2.0)
    PKY5: float = coefficient("p_{Ky5}", "PKY2 with camber squared", "4.E25")
    PKY6: float = coefficient("p_{Ky6}", "camber stiffness over load", "4.E30")
    PKY7: float = coefficient("p_{Ky7}", "camber stiffness with load", "4.E30")
    PHY1: float = coefficient("p_{Hy1}", "horizontal shift of F_y", "4.E27")
    PHY2: float = coefficient("p_{Hy2}", "horizontal shift with load", "4.E27")
    PHY3: float = coefficient("p_{Hy3}", "the same with camber (5.2)", "4.E27")
    PVY1: float = coefficient("p_{Vy1}", "vertical shift of F_y over load", "4.E29")
    PVY2: float = coefficient("p_{Vy2}", "vertical shift with load", "4.E29")
    PVY3: float = coefficient("p_{Vy3}", "vertical shift with camber", "4.E28")
    PVY4: float = coefficient("p_{Vy4}", "the same, with load", "4.E28")
    PPY1: float = coefficient("p_{py1}", "stiffness with pressure", "4.E25")
    PPY2: float = coefficient("p_{py2}", "PKY2 with pressure", "4.E25")
    PPY3: float = coefficient("p_{py3}", "mu_y with pressure", "4.E23")
    PPY4: float = coefficient("p_{py4}", "the same, quadratic", "4.E23")
    PPY5: float = coefficient("p_{py5}", "camber stiffness with pressure", "4.E30")
    RBY1: float = coefficient("r_{By1}", "slope of the weighting of F_y", "4.E62")
    RBY2: float = coefficient("r_{By2}", "the slope with alpha", "4.E62")
    RBY3: float = coefficient("r_{By3}", "shift of alpha in the slope", "4.E62")
    RBY4: float = coefficient("r_{By4}", "the slope with camber squared", "4.E62")
    RCY1: float = coefficient("r_{Cy1}", "shape of the weighting of F_y", "4.E63")
    REY1: float = coefficient("r_{Ey1}", "curvature of the weighting", "4.E64")
    REY2: float = coefficient("r_{Ey2}", "the curvature with load", "4.E64")
    RHY1: float = coefficient("r_{Hy1}", "shift of the weighting of F_y", "4.E65")
    RHY2: float = coefficient("r_{Hy2}", "the shift with load", "4.E65")
    RVY1: float = coefficient("r_{Vy1}", "F_y that kappa induces, over mu F_z", "4.E67")
    RVY2: float = coefficient("r_{Vy2}", "the same, with load", "4.E67")
    RVY3: float = coefficient("r_{Vy3}", "the same, with camber", "4.E67")
    RVY4: float = coefficient("r_{Vy4}", "the same, with alpha", "4.E67")
    RVY5: float = coefficient("r_{Vy5}", "the same, with kappa", "4.E66")
    RVY6: float = coefficient("r_{Vy6}", "the same, with arctan kappa", "4.E66")

    def pure(self, at: Point, scale: Scaling, fz0: Scalar) -> PureLateral:
        """F_y at zero kappa and nominal load fz0 [N], (4.E19) to (4.E30)."""
        gamma = at.gamma * scale.LGAY
        shape = self.PCY1 * scale.LCY
        mu = (
            (self.PDY1 + self.PDY2 * at.dfz)
            * (1 + at.dpi * (self.PPY3 + self.PPY4 * at.dpi))
            * (1 - self.PDY3 * gamma**2)
            * at.friction_y
        )
        stiffness = self._stiffness(at, gamma, fz0) * scale.LKY
        camber_shift = (self.PVY3 + self.PVY4 * at.dfz) * gamma * scale.LKYC * at.friction_y
        if at.camber_stiffness:
            thrust = (
                (self.PKY6 + self.PKY7 * at.dfz) * (1 + self.PPY5 * at.dpi) * (gamma * scale.LKYC)
            )
            camber_offset = ratio(thrust - camber_shift, stiffness)
        else:
            camber_offset = self.PHY3 * gamma
        offset = (self.PHY1 + self.PHY2 * at.dfz) * scale.LHY + camber_offset
        shift = (self.PVY1 + self.PVY2 * at.dfz) * scale.LVY * at.friction_y
        shift = shift + camber_shift
        alpha = at.alpha + offset
        curvature = (
            (self.PEY1 + self.PEY2 * at.dfz)
            * (1 + self.PEY5 * gamma**2 - (self.PEY3 + self.PEY4 * gamma) * jnp.sign(alpha))
            * scale.LEY
        )
        slope = ratio(stiffness, shape * mu)
        curve = Curve(slope * alpha, curvature)
        force = mu * jnp.sin(shape * bent(*curve)) + shift
        return PureLateral(force, stiffness, slope * shape, offset, shift, mu, curve)

    def _stiffness(self, at: Point, gamma: Scalar, fz0: Scalar) -> Scalar:
        """K_ya / F_z, (4.E25)."""
        peak = (self.PKY2 + self.PKY5 * gamma**2) * (1 + self.PPY2 * at.dpi)
        return (
            self.PKY1
            * (fz0 / at.fz)
            * (1 + self.PPY1 * at.dpi)
            * (1 - self.PKY3 * jnp.abs(gamma))
            * jnp.sin(self.PKY4 * jnp.arctan(ratio(at.fz / fz0, peak)))
        )

    def weight(self, at: Point, scale: Scaling) -> Weight:
        """G_yk of combined slip, (4.E59) to (4.E65)."""
        slope = (self.RBY1 + self.RBY4 * at.gamma**2) * scale.LYKA
        slope = slope * cos_arctan(self.RBY2 * (at.alpha - self.RBY3))
        shift = self.RHY1 + self.RHY2 * at.dfz
        curve = Curve(slope * (at.kappa + shift), self.REY1 + self.REY2 * at.dfz)
        return Weight(curve, slope * shift, self.RCY1)

    def induced(self, at: Point, scale: Scaling, mu: Scalar) -> Scalar:
        """S_Vyk / F_z: the lateral force that kappa induces, (4.E66) and (4.E67)."""
        largest = mu * (self.RVY1 + self.RVY2 * at.dfz + self.RVY3 * at.gamma)
        turning = jnp.sin(self.RVY5 * jnp.arctan(self.RVY6 * at.kappa))
        return largest * cos_arctan(self.RVY4 * at.alpha) * turning * scale.LVYKA
