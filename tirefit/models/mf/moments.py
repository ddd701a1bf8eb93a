"""The overturning moment M_x and the rolling resistance moment M_y.

Both follow the equation manual of MF-Tyre 6.1; MF 5.2 has fewer of the coefficients.
M_y has the form of Besselink et al. (2010), (A48). P(4.E70) differs: it has the load in
place of FNOMIN, and the opposite sign. FNOMIN, not LFZO FNOMIN, normalises loads.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from tirefit.arrays import Scalar
from tirefit.models.mf.fields import Nominal, Point, Scaling, coefficient


class Overturning(eqx.Module):
    """Coefficients of M_x / (F_z R_0).

    In MF-Tyre QSX12 to QSX14 are an alternative to QSX1 to QSX11.
    """

    QSX1: float = coefficient("q_{sx1}", "shift of M_x", "4.E69")
    QSX2: float = coefficient("q_{sx2}", "M_x with camber", "4.E69")
    QSX3: float = coefficient("q_{sx3}", "M_x with F_y", "4.E69")
    QSX4: float = coefficient("q_{sx4}", "M_x with load, F_y and camber", "4.E69")
    QSX5: float = coefficient("q_{sx5}", "shape of QSX4 with load", "4.E69")
    QSX6: float = coefficient("q_{sx6}", "slope of QSX4 with load", "4.E69")
    QSX7: float = coefficient("q_{sx7}", "slope of QSX4 with camber", "4.E69")
    QSX8: float = coefficient("q_{sx8}", "shape of QSX4 with F_y", "4.E69")
    QSX9: float = coefficient("q_{sx9}", "slope of QSX4 with F_y", "4.E69")
    QSX10: float = coefficient("q_{sx10}", "M_x with load and camber", "4.E69")
    QSX11: float = coefficient("q_{sx11}", "slope of QSX10 with load", "4.E69")
    QSX12: float = coefficient("q_{sx12}", "M_x with camber squared", "4.E69")
    QSX13: float = coefficient("q_{sx13}", "M_x with F_y over load", "4.E69")
    QSX14: float = coefficient("q_{sx14}", "the same, with |camber|", "4.E69")
    PPMX1: float = coefficient("p_{pMx1}", "QSX2 with pressure", "4.E69")

    def moment(self, at: Point, scale: Scaling, nominal: Nominal, load: Array, fy: Array) -> Array:
        """M_x [N m] for a load [N] and the F_y [N] of the model, (4.E69)."""
        gamma, side, share = at.camber, fy / nominal.FNOMIN, at.fz / nominal.FNOMIN
        mixed = jnp.cos(self.QSX5 * jnp.arctan((self.QSX6 * share) ** 2)) * jnp.sin(
            self.QSX7 * gamma + self.QSX8 * jnp.arctan(self.QSX9 * side)
        )
        relative = (
            self.QSX1 * scale.LVMX
            - self.QSX2 * gamma * (1 + self.PPMX1 * at.dpi)
            + self.QSX3 * side
            + self.QSX4 * mixed
            + self.QSX10 * jnp.arctan(self.QSX11 * share) * gamma
            - self.QSX12 * gamma * abs(gamma)
        )
        moment = load * relative + fy * (self.QSX13 + self.QSX14 * abs(gamma))
        return nominal.UNLOADED_RADIUS * scale.LMX * moment


class Rolling(eqx.Module):
    """Coefficients of M_y / (F_z R_0)."""

    QSY1: float = coefficient("q_{sy1}", "rolling resistance", "4.E70")
    QSY2: float = coefficient("q_{sy2}", "the same, with F_x", "4.E70")
    QSY3: float = coefficient("q_{sy3}", "the same, with speed", "4.E70")
    QSY4: float = coefficient("q_{sy4}", "the same, with speed to the 4th", "4.E70")
    QSY5: float = coefficient("q_{sy5}", "the same, with camber squared", "4.E70")
    QSY6: float = coefficient("q_{sy6}", "the same, and load", "4.E70")
    QSY7: float = coefficient("q_{sy7}", "exponent of the load", "4.E70", 1.0)
    QSY8: float = coefficient("q_{sy8}", "exponent of the pressure", "4.E70")

    def moment(
        self, at: Point, scale: Scaling, nominal: Nominal, load: Array, fx: Array, v: Scalar
    ) -> Array:
        """M_y [N m] of a wheel that rolls forward at v [m/s], for a load [N] and the
        F_x [N] of the model. Where v is 0, the speed is the nominal one."""
        share = at.fz / nominal.FNOMIN
        speed = jnp.where(v > 0, v / nominal.LONGVL, 1.0)
        relative = (
            self.QSY1
            + self.QSY2 * fx / nominal.FNOMIN
            + self.QSY3 * speed
            + self.QSY4 * speed**4
            + (self.QSY5 + self.QSY6 * share) * at.camber**2
        )
        # ``load`` is one factor F_z of (4.E70); M_y is zero where it is.
        power = share ** (self.QSY7 - 1) * (1 + at.dpi) ** self.QSY8
        return -nominal.UNLOADED_RADIUS * scale.LMY * load * relative * power
