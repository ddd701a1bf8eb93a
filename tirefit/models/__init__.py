"""Tire models by name, in one dict.

Names of brush models contain the letters of their calibration factors, in this order:
``d`` pressure asymmetry, ``m`` kinetic friction, ``n`` or ``h`` friction falling
linearly or exponentially with sliding speed, ``s`` also falling static friction. All
friction of ``brush-ln`` changes with the logarithm of the sliding speed.
"""

from tirefit.models.base import AbstractTire, TireForces, TireInputs, forces, modelled
from tirefit.models.brush import AnisotropicBrush, Brush, BrushAtPeak, LoadDependent, mu_from_peak
from tirefit.models.carcass import BeamCarcass, ParabolicCarcass, ThreadCarcass
from tirefit.models.combined import CombinedMagicFormula, LiuPeng
from tirefit.models.friction import (
    Exponential,
    Friction,
    Kinetic,
    LinearInSpeed,
    Logarithmic,
    Stribeck,
)
from tirefit.models.lugre import LuGre, LuGreLumped
from tirefit.models.magic_formula import MagicFormula
from tirefit.models.pressure import Asymmetric, Parabolic, Quartic, Uniform
from tirefit.models.relaxation import Relaxed
from tirefit.names import BRUSHES

__all__ = [
    "MODELS", "AbstractTire", "AnisotropicBrush", "Asymmetric", "BeamCarcass", "Brush",
    "BrushAtPeak", "CombinedMagicFormula", "Exponential", "Friction", "Kinetic",
    "LinearInSpeed", "LiuPeng", "LoadDependent", "Logarithmic", "LuGre", "LuGreLumped",
    "MagicFormula", "Parabolic", "ParabolicCarcass", "Quartic", "Relaxed", "Stribeck",
    "ThreadCarcass", "TireForces", "TireInputs", "Uniform", "forces", "modelled",
    "mu_from_peak",
]  # fmt: skip

_PRESSURE = {
    "brush": Parabolic(),
    "brush-d": Asymmetric(),
    "uniform": Uniform(),
    "quartic": Quartic(),
}
_LEVEL = {"": (), "m": (Kinetic(),)}
_SPEED = {
    "": (),
    "n": (LinearInSpeed(),),
    "ns": (LinearInSpeed(static_too=True),),
    "h": (Exponential(),),
    "hs": (Exponential(static_too=True),),
}


MODELS: dict[str, AbstractTire] = {
    **{
        name: Brush(pressure=_PRESSURE[shape], friction=Friction(_LEVEL[level] + _SPEED[speed]))
        for name, (shape, level, speed) in BRUSHES.items()
    },
    "brush-anisotropic": AnisotropicBrush(),
    "brush-anisotropic-m": AnisotropicBrush(friction=Friction(_LEVEL["m"])),
    "brush-anisotropic-d": AnisotropicBrush(pressure=Asymmetric()),
    "brush-anisotropic-dm": AnisotropicBrush(pressure=Asymmetric(), friction=Friction(_LEVEL["m"])),
    "brush-m-peak": BrushAtPeak(),
    "brush-stribeck": Brush(friction=Friction((Stribeck(),))),
    "brush-stribeck-s": Brush(friction=Friction((Stribeck(static_too=True),))),
    "brush-ln": Brush(friction=Friction((Logarithmic(static_too=True),))),
    "brush-load": LoadDependent(),
    "brush-load-d": LoadDependent(Brush(pressure=Asymmetric())),
    "brush-load-m": LoadDependent(Brush(friction=Friction(_LEVEL["m"]))),
    "brush-load-n": LoadDependent(Brush(friction=Friction(_SPEED["n"]))),
    "brush-load-h": LoadDependent(Brush(friction=Friction(_SPEED["h"]))),
    "brush-relaxation": Relaxed(),
    "carcass-beam": BeamCarcass(),
    "carcass-parabola": ParabolicCarcass(),
    "carcass-thread": ThreadCarcass(),
    "liu-peng": LiuPeng(),
    "lugre": LuGre(),
    "lugre-lumped": LuGreLumped(),
    "magic-formula": MagicFormula(),
    "magic-formula-combined": CombinedMagicFormula(),
    "magic-formula-relaxation": Relaxed(MagicFormula()),
}
"""Model name -> model with default parameter values."""
