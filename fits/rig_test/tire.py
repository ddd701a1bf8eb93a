"""The true tire of the rig test: its coefficients, and its forces without noise."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tirefit.data.tir.tir import new_tir
from tirefit.files import write_texts
from tirefit.models import TireInputs, forces
from tirefit.models.mf import MFTire, mf_tire

__all__ = [
    "MOMENT_STIFFNESS",
    "NOMINAL",
    "RACING",
    "TRUE",
    "RigTire",
    "true_forces",
    "write_true_tire",
]

NOMINAL = {
    "FNOMIN": 1100.0,
    "UNLOADED_RADIUS": 0.228,
    "NOMPRES": 82.7e3,
    "INFLPRES": 82.7e3,
    "LONGVL": 11.18,
}
"""A 16 x 7.5-10 racing tire at 250 lbf, 12 psi and 25 mph, in SI units."""

_COEFFICIENTS = """
    PCX1 1.55, PDX1 1.62, PDX2 -0.16, PDX3 4.0, PEX1 0.1, PEX2 -0.3, PEX3 0.1,
    PEX4 0.05, PKX1 42.0, PKX2 -3.0, PKX3 0.12, PHX1 -0.001, PHX2 0.0005, PVX1 0.01,
    PVX2 0.002, PPX1 -0.3, PPX2 0.2, PPX3 -0.08, PPX4 0.1,
    RBX1 14.0, RBX2 -11.0, RBX3 20.0, RCX1 1.06, REX1 -0.3, REX2 -0.1, RHX1 0.003,
    PCY1 1.40, PDY1 1.53, PDY2 -0.19, PDY3 2.5, PEY1 -0.5, PEY2 -0.4, PEY3 0.1,
    PEY4 -1.0, PEY5 4.0, PKY1 -38.0, PKY2 1.6, PKY3 0.5, PKY4 2.0, PKY5 -2.0,
    PKY6 -0.9, PKY7 -0.2, PHY1 0.002, PHY2 0.0008, PVY1 0.02, PVY2 0.006, PVY3 -0.25,
    PVY4 -0.1, PPY1 0.35, PPY2 0.9, PPY3 -0.1, PPY4 0.1, PPY5 -0.6,
    RBY1 15.0, RBY2 11.0, RBY3 0.004, RBY4 30.0, RCY1 1.05, REY1 -0.2, REY2 0.05,
    RHY1 0.004, RHY2 0.001, RVY1 0.03, RVY2 0.01, RVY3 -0.3, RVY4 30.0, RVY5 1.9,
    RVY6 -10.0,
    QBZ1 10.0, QBZ2 -1.5, QBZ3 -0.2, QBZ4 0.3, QBZ5 -0.5, QBZ9 12.0, QBZ10 0.3,
    QCZ1 1.15, QDZ1 0.095, QDZ2 -0.008, QDZ3 -0.3, QDZ4 2.0, QDZ6 0.002, QDZ7 0.001,
    QDZ8 -0.15, QDZ9 0.05, QDZ10 0.2, QDZ11 0.0, QEZ1 -2.0, QEZ2 0.4, QEZ3 -0.3,
    QEZ4 0.2, QEZ5 -1.0, QHZ1 0.003, QHZ2 0.001, QHZ3 0.1, QHZ4 0.02, PPZ1 0.4,
    PPZ2 -0.2, SSZ1 0.01, SSZ2 0.015, SSZ3 0.3, SSZ4 0.1
"""

TRUE = NOMINAL | {
    name: float(value) for name, value in (pair.split() for pair in _COEFFICIENTS.split(","))
}
"""Coefficients of MF 6.1, in ISO-W axes."""

OVERTURNING = {"QSX1": -0.004, "QSX2": 0.9, "QSX3": 0.05}
"""Coefficients of M_x, (4.E69) with these three terms alone."""

MOMENT_STIFFNESS = 1.6
"""Ratio of the slip stiffnesses of M_z to those of the forces. One set of coefficients
of a Magic Formula cannot describe all three, as with a measured tire."""


def _as_the_formula(fz):
    return 1.0, 1.0


class RigTire(NamedTuple):
    """A true tire: its coefficients, and how it departs from the formula."""

    values: Mapping[str, float] = TRUE
    version: str = "6.1"
    of_load: Callable = _as_the_formula
    """Load [N] (n,) -> factors of friction and slip stiffness that no formula has."""

    def tire(self, moment: bool = False) -> MFTire:
        """The tire of the forces, or that of M_z with its larger slip stiffnesses."""
        factor = MOMENT_STIFFNESS if moment else 1.0
        stiffer = {name: factor * self.values[name] for name in ("PKX1", "PKX2", "PKY1")}
        return mf_tire(self.version, {**self.values, **stiffer})


RACING = RigTire()
"""The tire of :data:`TRUE`."""


def true_forces(
    inputs: TireInputs,
    friction: float | np.ndarray = 1.0,
    stiffness: float | np.ndarray = 1.0,
    tire: RigTire = RACING,
) -> dict[str, np.ndarray]:
    """Forces without noise at any inputs, in the signs of ``tirefit.slip``.

    A tire whose friction and slip stiffness have changed by factors m and k gives
    m F(k slip / m), by the method of normalised slips (Pacejka, 4.E78 and before).

    Args:
        inputs: arrays (n,) in canonical units and signs.
        friction: m of each row (n,), 1 for the tire itself.
        stiffness: k of each row (n,).
        tire: the tire.

    Returns:
        ``fx``, ``fy`` [N], ``mz`` [N m], and ``mx`` [N m] in the axes of ISO-W, where
        it has the same sign as in those of SAE; arrays (n,).
    """
    of_friction, of_stiffness = tire.of_load(np.asarray(inputs.fz))
    friction, stiffness = friction * of_friction, stiffness * of_stiffness
    share = np.asarray(stiffness / friction)
    kappa = share * np.asarray(inputs.sigma_x) / (1 + np.asarray(inputs.sigma_x))
    scaled = inputs._replace(sigma_x=kappa / (1 - kappa), alpha=share * np.asarray(inputs.alpha))
    of_forces = forces(tire.tire(), scaled)
    of_moment = forces(tire.tire(moment=True), scaled)
    fx, fy = friction * np.asarray(of_forces.fx), friction * np.asarray(of_forces.fy)
    radius, nominal = NOMINAL["UNLOADED_RADIUS"], NOMINAL["FNOMIN"]
    arm = OVERTURNING["QSX1"] - OVERTURNING["QSX2"] * np.asarray(inputs.gamma)
    mx = radius * np.asarray(inputs.fz) * (arm - OVERTURNING["QSX3"] * fy / nominal)
    return {"fx": fx, "fy": fy, "mz": friction * np.asarray(of_moment.mz), "mx": mx}


def write_true_tire(path: Path) -> None:
    """Write the tire of the forces as a ``.tir`` file."""
    comment = [
        "The true tire of the simulated rig test",
        f"M_z of the test: slip stiffnesses {MOMENT_STIFFNESS:g} times as large",
    ]
    ranges = {"fz": (200.0, 1500.0), "kappa": (-0.22, 0.22), "alpha": (-0.22, 0.22)}
    write_texts({path: new_tir("6.1", TRUE, ranges, {}, comment).text})
