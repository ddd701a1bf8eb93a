"""The parts of a Magic Formula: which coefficients, from which rows of which force."""

from typing import NamedTuple

import numpy as np

from tirefit.data.table import TireData
from tirefit.data.tir_keys import ONLY_IN
from tirefit.fitting.likelihood import CHANNEL_SLIP
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
"""Force or moment -> slips one of which the rows need; the other may be left out."""

_BEGINNINGS = {"P": "pure", "Q": "pure", "R": "combined", "S": "combined"}

NEARLY_PURE = 0.01
"""Largest other slip (kappa, or slip angle [rad]) of a row of pure slip. It covers the
zero error of a rig (half a degree) and the slip of a free-rolling tire; weighting
functions are within 1 % of one there."""


class Part(NamedTuple):
    """What one stage estimates.

    ``forces``: whose rows it takes; ``pure``: only those in which the other slip is
    next to nothing; ``meaning`` for people.
    """

    name: str
    forces: tuple[str, ...]
    pure: bool
    meaning: str


PARTS = {
    "fx": Part("fx", ("fx",), True, "longitudinal force in pure slip"),
    "fy": Part("fy", ("fy",), True, "lateral force in pure slip"),
    "mz": Part("mz", ("mz",), True, "aligning moment in pure slip"),
    "combined": Part("combined", ("fx", "fy", "mz"), False, "combined slip"),
    "mx": Part("mx", ("mx",), False, "overturning moment"),
    "my": Part("my", ("my",), False, "rolling resistance moment"),
}
"""Stage -> what it is, in the order in which they are taken."""

MOMENTS = ("mx", "my")
"""Forces without coefficients of combined slip: they take F_x and F_y of the model."""

HELD = ("QSX5",)
"""At its prior's centre unless asked for: QSX4 and QSX5 trade off against each other
where QSX2 and QSX3 take up what of QSX4 does not change with load."""

NEVER_FITTED = ("QSX12", "QSX13", "QSX14")
"""Zero in a fit: MF-Tyre asks for these or QSX1 to QSX11, which say the same."""

_OWN = {
    "fx": MFTire().longitudinal,
    "fy": MFTire().lateral,
    "mz": MFTire().aligning,
    "mx": Overturning(),
    "my": Rolling(),
}
"""Force -> the coefficients that no other force has told before."""


def coefficients_of(version: str) -> dict[str, str]:
    """Coefficient of this version -> the part that estimates it, in their order.

    Scaling factors and the nominal state are not among them: they are given.
    """
    return {
        name: part if _BEGINNINGS[name[0]] == "pure" else "combined"
        for part, group in _OWN.items()
        for name in specs(group)
        if ONLY_IN.get(name, version[0]) == version[0] and name not in NEVER_FITTED
    }


def influences(version: str, force: str) -> tuple[str, ...]:
    """The coefficients that a force depends on, in their order."""
    of = {"mz": ("fx", "fy", "mz"), "mx": ("fy", "mx"), "my": ("fx", "my")}
    names = {name for own in of.get(force, (force,)) for name in specs(_OWN[own])}
    return tuple(name for name in coefficients_of(version) if name in names)


def own_coefficients(version: str, force: str) -> tuple[str, ...]:
    """The coefficients that the rows of a force move, of pure and combined slip."""
    names = specs(_OWN[force])
    return tuple(name for name in coefficients_of(version) if name in names)


def is_pure(data: TireData, force: str) -> np.ndarray:
    """Which of the used rows (n,) of this force have next to nothing of the other
    slip; all of a moment without coefficients of combined slip."""
    other = "alpha" if SLIPS_OF[force][0] == "sigma_x" else "sigma_x"
    if other not in data or force in MOMENTS:
        return np.full(data.n, True)
    size = np.abs(data.usable(other))
    if other == "sigma_x":
        size = np.abs(kappa_from_sigma(size))
    return size <= NEARLY_PURE
