"""Slip definitions and sign conventions.

Inside tirefit all values are in SI units, and a positive slip causes a positive force
along both axes. Seen from above, wheel travelling to the right::

              v_sx = v_x - Omega R_e  (contact patch slides forward: braking)
             ------->
        .-----------------.                 ^ v_sy = v_y  (patch slides to the left)
        |      wheel      |  ---> v_x       |
        '-----------------'
             <-------                       |
               F_x  (road on tire)          v F_y  (road on tire)

    sigma_x = v_sx / (Omega R_e)   physical slip, positive when braking
    kappa   = v_sx / v_x           practical slip, positive when braking
    s       = v_sx / |v|
    sigma_y = v_sy / (Omega R_e) = tan(alpha) (1 + sigma_x)
    F_x > 0 when braking, F_y > 0 for alpha > 0, F_z > 0 load,
    M_z < 0 for small alpha > 0 (the force acts behind the centre),
    M_y > 0 resists rolling, M_x < 0 where the load acts to the left of the centre.

These are the definitions of S Table 1. Files have their own convention; readers and
writers convert it by the signs of :data:`CONVENTIONS`.
"""

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:  # JAX takes half a second to import
    from tirefit.arrays import Kept, Numbers

GRAVITY = 9.80665  # standard acceleration of free fall [m/s2]

LOCKED = 1e6
"""Physical slip used for a locked wheel (kappa = 1, where sigma would be infinite)."""


class Convention(NamedTuple):
    """Signs (+-1) that convert the values of a file to canonical ones and back."""

    description: str
    slip: int
    alpha: int
    gamma: int
    fx: int
    fy: int
    fz: int
    mz: int
    mx: int
    my: int

    def turned(self, other: "Convention") -> frozenset[str]:
        """Fields whose sign differs in the other convention."""
        named = zip(self._fields[1:], self[1:], other[1:], strict=True)
        return frozenset(name for name, sign, other_sign in named if sign != other_sign)


CONVENTIONS = {
    "braking": Convention(
        "braking slip and force positive, F_y > 0 for alpha > 0, F_z > 0 (canonical)",
        slip=1, alpha=1, gamma=1, fx=1, fy=1, fz=1, mz=1, mx=1, my=1,
    ),
    "iso-w": Convention(
        "ISO 8855 / TYDEX W: driving positive, alpha > 0 gives F_y < 0 and M_z > 0",
        slip=-1, alpha=1, gamma=1, fx=-1, fy=-1, fz=1, mz=-1, mx=-1, my=-1,
    ),
    "sae": Convention(
        "SAE J670: z down, F_z < 0, driving positive, alpha > 0 gives F_y < 0, M_z > 0",
        slip=-1, alpha=-1, gamma=1, fx=-1, fy=1, fz=-1, mz=1, mx=-1, my=1,
    ),
    "adapted-sae": Convention(
        "Pacejka's adapted SAE: driving positive, F_z > 0, alpha > 0 gives F_y > 0",
        slip=-1, alpha=1, gamma=1, fx=-1, fy=1, fz=1, mz=1, mx=-1, my=1,
    ),
}  # fmt: skip


def sigma_from_kappa(kappa: "Kept") -> "Kept":
    """Physical slip sigma = kappa / (1 - kappa), S Table 1; kappa < 1, shape kept."""
    return kappa / (1 - kappa)


def kappa_from_sigma(sigma: "Kept") -> "Kept":
    """Practical slip kappa = sigma / (1 + sigma), S Table 1; sigma > -1, shape kept."""
    return sigma / (1 + sigma)


def sigma_from_slip_ratio(ratio: "Kept") -> "Kept":
    """Physical slip from v_sx / max(v_x, Omega R_e): kappa braking, sigma driving."""
    braking = (ratio + ratio.__abs__()) / 2
    driving = (ratio - ratio.__abs__()) / 2
    return sigma_from_kappa(braking) + driving


def slip_ratio_from_sigma(sigma: "Kept") -> "Kept":
    """Inverse of :func:`sigma_from_slip_ratio`."""
    braking = (sigma + sigma.__abs__()) / 2
    driving = (sigma - sigma.__abs__()) / 2
    return kappa_from_sigma(braking) + driving


def lateral_slip(tan_alpha: "Numbers", sigma_x: "Numbers" = 0.0) -> "Numbers":
    """Lateral physical slip sigma_y = tan(alpha) (1 + sigma_x), S Table 1."""
    return tan_alpha * (1 + sigma_x)


def _identity(value: "Kept") -> "Kept":
    return value


SLIP_DEFINITIONS = {
    "sigma_x": (_identity, _identity),
    "kappa": (sigma_from_kappa, kappa_from_sigma),
    "s": (sigma_from_kappa, kappa_from_sigma),
    "slip_ratio": (sigma_from_slip_ratio, slip_ratio_from_sigma),
}
"""Name of a longitudinal slip column -> (to sigma_x, from sigma_x), canonical signs.

``s`` = v_sx/|v| equals kappa without lateral slip; with a slip angle, kappa =
s / cos(alpha), which the reader applies first.
"""
