r"""The four-coefficient Magic Formula, S(16)."""

import jax.numpy as jnp
from jaxtyping import Array

from tirefit.arrays import Numbers, Scalar
from tirefit.models.base import AbstractTire, TireForces, TireInputs
from tirefit.params import par
from tirefit.slip import kappa_from_sigma


def bent(x: Numbers, curvature: Numbers) -> Array:
    r""":math:`\arctan\{x - E (x - \arctan x)\}`, the argument over C of all formulas.

    Args:
        x: B times the slip, any shape.
        curvature: E, limited to one, above which the curve would turn back.
    """
    return jnp.arctan(x - jnp.minimum(curvature, 1.0) * (x - jnp.arctan(x)))


class MagicFormula(AbstractTire):
    r""":math:`F = D F_z \sin(C \arctan(B x - E (B x - \arctan B x)))`, S(16).

    x is the practical slip kappa for the longitudinal force and the slip angle alpha
    [rad] for the lateral one. The aligning moment is not modelled.
    """

    B: float = par(10.0, (0.1, 200.0), "-", "stiffness factor", "S(16)", "B", scale="log")
    C: float = par(1.5, (0.5, 3.0), "-", "shape factor", "S(16)", "C")
    D: float = par(1.0, (0.01, 5.0), "-", "peak force over load", "S(16)", "D")
    E: float = par(0.0, (-20.0, 1.0), "-", "curvature factor", "S(16)", "E")

    def pure(self, x: Scalar, fz: Scalar) -> Array:
        """Force [N] at slip x (kappa [-] or alpha [rad]) and load fz [N]."""
        return jnp.sin(self.C * bent(self.B * x, self.E)) * (self.D * fz)

    def __call__(self, inputs: TireInputs) -> TireForces:
        fx = self.pure(kappa_from_sigma(inputs.sigma_x), inputs.fz)
        fy = self.pure(inputs.alpha, inputs.fz)
        return TireForces(fx, fy, None)
