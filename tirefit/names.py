"""Names of models and effects as text, so that completion need not import JAX."""

import tomllib
from pathlib import Path

_PRESSURE = ("brush", "brush-d", "uniform", "quartic")
_SPEED = ("", "n", "ns", "h", "hs")


def _spelled() -> list[str]:
    names = []
    for family in _PRESSURE:
        for letters in (level + speed for level in ("", "m") for speed in _SPEED):
            dash = "-" if letters and "-" not in family else ""
            names.append(f"{family}{dash}{letters}")
    return names


MODEL_NAMES = (
    *_spelled(),
    "brush-anisotropic",
    "brush-anisotropic-m",
    "brush-anisotropic-d",
    "brush-anisotropic-dm",
    "brush-m-peak",
    "brush-stribeck",
    "brush-stribeck-s",
    "brush-ln",
    "brush-load",
    "brush-load-d",
    "brush-load-m",
    "brush-load-n",
    "brush-load-h",
    "brush-relaxation",
    "carcass-beam",
    "carcass-parabola",
    "carcass-thread",
    "liu-peng",
    "lugre",
    "lugre-lumped",
    "magic-formula",
    "magic-formula-combined",
    "magic-formula-relaxation",
)
"""Every key of ``tirefit.MODELS``."""


def effect_names() -> list[str]:
    """The id of every effect of ``tirefit diagnose``, in the order of their table."""
    table = Path(__file__).parent / "diagnosis" / "effects" / "effects.toml"
    return list(tomllib.loads(table.read_text(encoding="utf-8")))
