"""Names of the models as text: completion must not wait for JAX to be imported."""

__all__ = ["MODEL_NAMES"]

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
    "brush-m-peak",
    "brush-stribeck",
    "brush-stribeck-s",
    "magic-formula",
)
"""Every key of ``tirefit.MODELS``."""
