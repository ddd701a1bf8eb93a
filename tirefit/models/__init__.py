"""Tire models by name: one visible dict.

Brush models are spelled by the letters of their calibration factors, in this order:
``d`` pressure asymmetry, ``m`` kinetic friction, ``n`` or ``h`` friction falling
linearly or exponentially with sliding speed, ``s`` static friction falling too.
"""

from tirefit.models.base import AbstractTire, TireForces, TireInputs, forces
from tirefit.models.brush import (
    Brush,
    BrushAtPeak,
    mu_from_peak,
    needs_speed,
    peak_from_mu,
)
from tirefit.models.friction import (
    Exponential,
    Friction,
    Kinetic,
    LinearInSpeed,
    Stribeck,
)
from tirefit.models.magic_formula import MagicFormula
from tirefit.models.pressure import Asymmetric, Parabolic, Quartic, Uniform

__all__ = [
    "MODELS",
    "AbstractTire",
    "Asymmetric",
    "Brush",
    "BrushAtPeak",
    "Exponential",
    "Friction",
    "Kinetic",
    "LinearInSpeed",
    "MagicFormula",
    "Parabolic",
    "Quartic",
    "Stribeck",
    "TireForces",
    "TireInputs",
    "Uniform",
    "forces",
    "mu_from_peak",
    "needs_speed",
    "peak_from_mu",
]

_PRESSURE = {
    ("brush", ""): Parabolic(),
    ("brush", "d"): Asymmetric(),
    ("uniform", ""): Uniform(),
    ("quartic", ""): Quartic(),
}
_LEVEL = {"": (), "m": (Kinetic(),)}
_SPEED = {
    "": (),
    "n": (LinearInSpeed(),),
    "ns": (LinearInSpeed(static_too=True),),
    "h": (Exponential(),),
    "hs": (Exponential(static_too=True),),
}


def _spelled(family: str, letters: str) -> str:
    return f"{family}-{letters}" if letters else family


MODELS: dict[str, AbstractTire] = {
    **{
        _spelled(family, shape + level + speed): Brush(
            pressure=pressure, friction=Friction(_LEVEL[level] + _SPEED[speed])
        )
        for (family, shape), pressure in _PRESSURE.items()
        for level in _LEVEL
        for speed in _SPEED
    },
    "brush-m-peak": BrushAtPeak(),
    "brush-stribeck": Brush(friction=Friction((Stribeck(),))),
    "brush-stribeck-s": Brush(friction=Friction((Stribeck(static_too=True),))),
    "magic-formula": MagicFormula(),
}
"""Model name -> model with default parameter values."""
