"""The parts of the Magic Formula: their coefficients, and the rows that fit them."""

from functools import cache

import numpy as np

from tirefit.data.table import TireData
from tirefit.data.tir.tir_keys import ONLY_IN
from tirefit.fitting.problem.likelihood import CHANNEL_SLIP
from tirefit.models.mf import MFTire
from tirefit.models.mf.moments import Overturning, Rolling
from tirefit.params import specs
from tirefit.slip import kappa_from_sigma

VERSIONS = {"mf52": "5.2", "mf61": "6.1", "mf62": "6.2"}
"""Name of the model -> version of the Magic Formula."""

SLIPS_OF: dict[str, tuple[str, ...]] = {
    **{force: (slip,) for force, slip in CHANNEL_SLIP.items()},
    "mx": ("alpha",),
    "my": ("sigma_x", "alpha"),
}
"""Force or moment -> slips; the rows need at least one of them."""

NEARLY_PURE = 0.01
"""Largest other slip (kappa, or slip angle [rad]) of a row of pure slip. It covers the
zero error of a rig (half a degree) and the slip of a free-rolling tire; weighting
functions are within 1 % of one there."""

PARTS = {
    "fx": "longitudinal force in pure slip",
    "fy": "lateral force in pure slip",
    "mz": "aligning moment in pure slip",
    "combined": "combined slip",
    "mx": "overturning moment",
    "my": "rolling resistance moment",
}
"""Part -> its name in reports, in the order in which they are fitted. Combined slip is
fitted to the rows of F_x, F_y and M_z, another part to those of its force."""

MOMENTS = ("mx", "my")
"""Moments without coefficients of combined slip: they depend on F_x and F_y."""

HELD = ("QSX5",)
"""Coefficients at the centre of their prior unless the settings free them: QSX4 and
QSX5 trade off against each other, as QSX2 and QSX3 explain the rest of QSX4."""

NEVER_FITTED = ("QSX12", "QSX13", "QSX14")
"""Coefficients that are zero in a fit: an alternative to QSX1 to QSX11 in MF-Tyre."""

_OWN = {
    "fx": MFTire().longitudinal,
    "fy": MFTire().lateral,
    "mz": MFTire().aligning,
    "mx": Overturning(),
    "my": Rolling(),
}
"""Force -> the coefficients that its rows move."""

_ALSO = {"mz": ("fx", "fy"), "mx": ("fy",), "my": ("fx",)}
"""Moment -> forces that it depends on."""


def coefficients_of(version: str) -> dict[str, str]:
    """Coefficient of this version -> part that estimates it, in equation order.

    Scaling factors and the nominal state are given, so they are not included.
    """
    return {
        name: part if name[0] in "PQ" else "combined"
        for part, group in _OWN.items()
        for name in specs(group)
        if ONLY_IN.get(name, version[0]) == version[0] and name not in NEVER_FITTED
    }


def own_coefficients(version: str, *forces: str) -> tuple[str, ...]:
    """The coefficients that the rows of some forces move, in pure and combined slip."""
    names = {name for force in forces for name in specs(_OWN[force])}
    return tuple(name for name in coefficients_of(version) if name in names)


@cache
def influences(version: str, force: str) -> tuple[str, ...]:
    """The coefficients that a force depends on, in the order of the equations."""
    return own_coefficients(version, force, *_ALSO.get(force, ()))


def is_pure(data: TireData, force: str) -> np.ndarray:
    """Which of the used rows (n,) have pure slip; all rows of M_x and M_y."""
    other = "alpha" if SLIPS_OF[force][0] == "sigma_x" else "sigma_x"
    if other not in data or force in MOMENTS:
        return np.full(data.n, True)
    size = np.abs(data.usable(other))
    return (kappa_from_sigma(size) if other == "sigma_x" else size) <= NEARLY_PURE
