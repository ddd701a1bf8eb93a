"""Fields of the coefficients, and the operating point at which they are evaluated."""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from tirefit.arrays import Scalar
from tirefit.models.magic_formula import bent
from tirefit.params import par

_TINY = 1e-12


class Point(NamedTuple):
    """The operating point at which formulas are evaluated, in ISO-W axes."""

    kappa: Any  # > 0 driving
    alpha: Any  # alpha*: the angle or its tangent
    cos_alpha: Scalar
    gamma: Any  # gamma*: the angle or its sine
    camber: Any  # the angle gamma
    fz: Any  # > 0
    dfz: Any  # normalised change of load (4.E2)
    dpi: Any  # normalised change of pressure (4.E2)
    friction_x: Any  # scales friction and vertical shift, lambda*_mu (4.E7) and (4.E8)
    friction_y: Scalar
    camber_stiffness: bool  # camber acts as in MF 6 (PKY6), or as in 5.2 (PHY3)
    starred: bool  # alpha* is tan alpha

    @property
    def tan_alpha(self) -> Scalar:
        """Tangent of the slip angle."""
        return self.alpha if self.starred else jnp.tan(self.alpha)

    def turned(self, tan_alpha: Scalar) -> "Point":
        """The same point at another slip angle."""
        alpha = tan_alpha if self.starred else jnp.arctan(tan_alpha)
        return self._replace(alpha=alpha, cos_alpha=cos_arctan(tan_alpha))


class Curve(NamedTuple):
    """Arguments of :func:`~tirefit.models.magic_formula.bent` of one curve."""

    x: Any  # B (slip + shift)
    curvature: Any  # E


class Weight(NamedTuple):
    """Weighting curve at a slip; ``x`` of it at zero slip; ``shape`` C."""

    curve: Curve
    x_at_rest: Scalar
    shape: Scalar


def coefficient(symbol: str, meaning: str, equation: str, default: float = 0.0) -> Any:
    """The field of a dimensionless coefficient, zero (no effect) unless given."""
    return par(default, (-1e6, 1e6), "-", meaning, f"P({equation})", symbol)


def _scale(symbol: str, of: str, equation: str, default: float = 1.0) -> Any:
    """The field of a scaling factor, which is never estimated, as the coefficients are."""
    return par(
        default, (0.0, 1e3), "-", f"scales {of}", f"P({equation})", rf"\lambda_{{{symbol}}}",
        free=False,
    )  # fmt: skip


def _stated(
    default: float, bounds: tuple[float, float], unit: str, meaning: str, equation: str, symbol: str
) -> Any:
    """The field of a positive number of the tire or its measurement, which is never estimated."""
    return par(default, bounds, unit, meaning, f"P({equation})", symbol, free=False, scale="log")


class Nominal(eqx.Module):
    """The tire and the state in which it was measured."""

    FNOMIN: float = _stated(4000.0, (1.0, 1e6), "N", "nominal wheel load", "4.E1", "F_{z0}")
    UNLOADED_RADIUS: float = _stated(
        0.3, (1e-3, 1e2), "m", "radius of the free tire", "4.E42", "R_0"
    )
    LONGVL: float = _stated(16.7, (1e-3, 1e3), "m/s", "speed of the measurement", "4.E7", "V_0")
    NOMPRES: float = _stated(
        2.2e5, (1e3, 1e8), "Pa", "nominal inflation pressure", "4.E2b", "p_{i0}"
    )
    INFLPRES: float = _stated(
        2.2e5, (1e3, 1e8), "Pa", "inflation pressure unless a sample has its own", "4.E2b", "p_i"
    )


class Scaling(eqx.Module):
    """Scaling factors of 5.2 and 6.x; those that a version lacks stay neutral."""

    LFZO: float = _scale("Fz0", "the nominal load", "4.E1")
    LMUV: float = _scale(r"\mu V", "the fall of friction with slip speed", "4.E7", 0.0)
    LCX: float = _scale("Cx", "the shape factor of F_x", "4.E11")
    LMUX: float = _scale(r"\mu x", "the friction of F_x", "4.E7")
    LEX: float = _scale("Ex", "the curvature of F_x", "4.E14")
    LKX: float = _scale(r"Kx\kappa", "the slip stiffness", "4.E15")
    LHX: float = _scale("Hx", "the horizontal shift of F_x", "4.E17")
    LVX: float = _scale("Vx", "the vertical shift of F_x", "4.E18")
    LGAX: float = _scale(r"\gamma x", "the camber in F_x (5.2)", "4.E13")
    LXAL: float = _scale(r"x\alpha", "the influence of alpha on F_x", "4.E54")
    LCY: float = _scale("Cy", "the shape factor of F_y", "4.E21")
    LMUY: float = _scale(r"\mu y", "the friction of F_y", "4.E7")
    LEY: float = _scale("Ey", "the curvature of F_y", "4.E24")
    LKY: float = _scale(r"Ky\alpha", "the cornering stiffness", "4.E25")
    LHY: float = _scale("Hy", "the horizontal shift of F_y", "4.E27")
    LVY: float = _scale("Vy", "the vertical shift of F_y", "4.E29")
    LGAY: float = _scale(r"\gamma y", "the camber in F_y (5.2)", "4.E23")
    LKYC: float = _scale(r"Ky\gamma", "the camber stiffness (6.x)", "4.E30")
    LYKA: float = _scale(r"y\kappa", "the influence of kappa on F_y", "4.E62")
    LVYKA: float = _scale(r"Vy\kappa", "the F_y that kappa induces", "4.E66")
    LTR: float = _scale("t", "the pneumatic trail", "4.E42")
    LRES: float = _scale("Mr", "the residual moment", "4.E47")
    LGAZ: float = _scale(r"\gamma z", "the camber in M_z (5.2)", "4.E43")
    LKZC: float = _scale(r"Kz\gamma", "the camber moment (6.x)", "4.E47")
    LS: float = _scale("s", "the moment arm of F_x", "4.E76")
    LMX: float = _scale("Mx", "the overturning moment", "4.E69")
    LVMX: float = _scale("VMx", "the shift of the overturning moment", "4.E69")
    LMY: float = _scale("My", "the rolling resistance moment", "4.E70")


def ratio(numerator: Scalar, denominator: Scalar) -> Array:
    """Quotient that is finite, with its gradient, also at a zero denominator."""
    small = jnp.where(denominator < 0, -_TINY, _TINY)
    return jnp.asarray(numerator) / jnp.where(jnp.abs(denominator) < _TINY, small, denominator)


def cos_arctan(x: Scalar) -> Array:
    """cos(arctan x), computed without either function."""
    return 1 / jnp.sqrt(1 + x * x)


def weighting(weight: Weight) -> Array:
    r"""How one slip weakens the force of the other, (4.E51) and (4.E59).

    .. math::
       G = \frac{\cos[C \arctan\{B s - E (B s - \arctan B s)\}]}
                {\cos[C \arctan\{B S_H - E (B S_H - \arctan B S_H)\}]},
       \quad s = slip + S_H
    """
    slipping, resting = (
        jnp.cos(weight.shape * bent(x, weight.curve.curvature))
        for x in (weight.curve.x, weight.x_at_rest)
    )
    return ratio(slipping, resting)
