"""The Magic Formula of ``.tir`` files: MF 5.2, 6.1 and 6.2.

Equation numbers (4.E1 ...) are those of Pacejka, *Tire and Vehicle Dynamics*, 3rd ed.
(2012), section 4.3.2, cited as P(4.E...); 5.2 follows the equation manual of MF-Tyre
5.2. M_z of 6.1 follows Besselink, Schmeitz and Pacejka, *Vehicle System Dynamics* 48,
supplement (2010) 337-352, where it differs from the book.
"""

from tirefit.models.mf.moments import Overturning, Rolling
from tirefit.models.mf.tire import (
    OTHER_SIDE,
    WEIGHTS,
    MFTire,
    Mirrored,
    Pair,
    curvatures,
    frictions,
    mf_tire,
)

__all__ = [
    "MAGIC_FORMULAS", "OTHER_SIDE", "WEIGHTS", "MFTire", "Mirrored", "Pair", "curvatures",
    "frictions", "mf_tire",
]  # fmt: skip

MAGIC_FORMULAS = {
    f"mf{version.replace('.', '')}": MFTire(
        version=version, overturning=Overturning(), rolling=Rolling()
    )
    for version in ("5.2", "6.1", "6.2")
}
"""Name of a whole Magic Formula -> it, without coefficients of a tire.

They are not in ``MODELS``, as their hundred coefficients are fitted in stages with
priors."""
