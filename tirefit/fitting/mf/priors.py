"""Weak priors of the coefficients, from published tires.

The table ``priors.csv`` holds the centre and the spread of the prior of every
coefficient. ``fits/magic_formula_priors`` writes it and names its sources. The priors
are weak: a spread is at least twice the scatter among the published tires, and at least
a physical size that does not depend on them.
"""

import csv
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import NamedTuple


class Prior(NamedTuple):
    """Centre and standard deviation of a Gaussian prior, and the published values.

    With ``log`` the logarithm is Gaussian, and ``spread`` is relative to the centre.
    """

    centre: float
    spread: float
    log: bool = False
    published: tuple[float, ...] = ()

    @property
    def std(self) -> float:
        """Standard deviation of the coefficient itself, for small spreads."""
        return self.spread * self.centre if self.log else self.spread


def prior_given(name: str, mean: float, std: float) -> Prior:
    """A user's prior of a coefficient, with this mean and standard deviation."""
    log = name in LOGARITHMIC and mean > 0
    return Prior(mean, std / mean if log else std, log)


LOGARITHMIC = ("RBX1", "RBX2", "RBY1", "RBY2", "RVY4", "QSX5", "QSX6")
"""Coefficients with a prior of their logarithm, as their sign has no effect (that of
RBX1 and RBY1 changes together with RBX3 and RBY4)."""

_EVEN = (*LOGARITHMIC, "QBZ9")
"""Coefficients of which only the size acts (QBZ9: if QBZ10 is zero)."""


def normal_form(values: Mapping[str, float]) -> dict[str, float]:
    """The same tire in the signs of this package, if two sets of signs are equivalent.

    In some published files mu_y and B_y C_y are both negative. A sine is odd in its
    argument, and a weighting function depends on the square of some slopes.
    """
    values = dict(values)
    induced = ("RVY1", "RVY2", "RVY3")
    turning = {
        "PDY1": ("PDY2", *induced), "RVY5": induced, "RVY6": induced,
        "RBX1": ("RBX3",), "RBY1": ("RBY4",), "QSX9": ("QSX8",), "QSX11": ("QSX10",),
        "QSX7": ("QSX4", "QSX8"),
    }  # fmt: skip
    for leader, followers in turning.items():
        if values.get(leader, 0.0) < 0:
            for name in (leader, *followers):
                values[name] = -values.get(name, 0.0)
    for name in _EVEN:
        if name in values:
            values[name] = abs(values[name])
    return values


@cache
def published_priors() -> dict[str, Prior]:
    """The priors of ``priors.csv``."""
    with open(Path(__file__).with_name("priors.csv"), newline="") as file:
        return {
            row["coefficient"]: Prior(
                float(row["centre"]),
                float(row["spread"]),
                row["scale"] == "log",
                tuple(float(value) for value in row["published"].split()),
            )
            for row in csv.DictReader(file)
        }
