"""Names of models and effects as text, so that completion need not import JAX."""

import tomllib
from itertools import product
from pathlib import Path

_LETTERS = product(
    ("brush", "brush-d", "uniform", "quartic"), ("", "m"), ("", "n", "ns", "h", "hs")
)
BRUSHES = {
    "-".join(filter(None, (shape, level + speed))).replace("-d-", "-d"): (shape, level, speed)
    for shape, level, speed in _LETTERS
}
"""Name of a brush model -> its pressure, and the letters of its kinetic friction."""

MODEL_NAMES = (
    *BRUSHES,
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
