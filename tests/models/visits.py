"""Which registered models a test visits in the suite, and which in ``make test-long``."""

import pytest

from tirefit.models import MODELS

PRESSURES = ["brush", "brush-d", "uniform", "quartic"]
FRICTIONS = [level + speed for level in ("", "m") for speed in ("", "n", "ns", "h", "hs")]


def spelled(pressure, letters):
    """Name of the brush of a pressure law with a friction law."""
    return f"{pressure}{'-' * (bool(letters) and pressure != 'brush-d')}{letters}"


# A brush is a pressure law with a friction law: parabolic pressure visits every friction law,
# the other pressure laws the simplest one and one of most terms.
REPEATS = {
    spelled(pressure, letters)
    for pressure in PRESSURES[1:]
    for letters in set(FRICTIONS) - {"", "mhs"}
} | {"brush-mn", "brush-mh"}  # of whose terms brush-mns and brush-mhs have one more
REPEATS |= {"brush-anisotropic-d", "brush-anisotropic-m", "brush-load-m", "brush-load-n"}


def visiting(names=MODELS, later=frozenset(REPEATS)):
    """A test of each of these models, of which some run with the long ones."""
    each = [pytest.param(k, marks=pytest.mark.long) if k in later else k for k in sorted(names)]
    return pytest.mark.parametrize("name", each)
