"""Weak priors of the coefficients, from published tires.

The table ``priors.csv`` beside this file holds a centre and a spread of every
coefficient. ``fits/magic_formula_priors`` made it, by :func:`priors_of` here, and names
its sources. A prior is weak: the spread is never below a physical one, which no
published tire decides, and at least twice what the published tires vary by.
"""

import csv
import math
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple


class Prior(NamedTuple):
    """Mean and standard deviation of a Gaussian prior, and the values behind it.

    ``log``: it is that of the logarithm, ``spread`` a share of the centre.
    """

    centre: float
    spread: float
    log: bool = False
    published: tuple[float, ...] = ()

    @property
    def std(self) -> float:
        """Standard deviation in the unit of the coefficient, of small changes."""
        return self.spread * self.centre if self.log else self.spread


def prior_given(name: str, mean: float, std: float) -> Prior:
    """A user's prior of a coefficient, with this mean and standard deviation."""
    log = name in _LOG and mean > 0
    return Prior(mean, std / mean if log else std, log)


_CENTRED = {
    "PCX1": (1.5, 0.3), "PDX1": (1.0, 0.3), "PKX1": (20.0, 10.0),
    "PCY1": (1.4, 0.4), "PDY1": (1.0, 0.3), "PKY1": (-20.0, 10.0), "PKY2": (2.5, 1.5),
    "PKY4": (2.0, 0.7), "QBZ1": (10.0, 4.0), "QCZ1": (1.2, 0.2), "QDZ1": (0.1, 0.05),
    "RBX1": (12.0, 1.0), "RBX2": (10.0, 0.8), "RCX1": (1.0, 0.1), "RBY1": (12.0, 1.5),
    "RBY2": (8.0, 0.8), "RCY1": (1.0, 0.1), "QBZ9": (10.0, 50.0),
    "RVY4": (40.0, 1.0), "RVY5": (1.9, 0.5), "RVY6": (20.0, 10.0),
    "QSX5": (0.5, 0.5), "QSX6": (1.0, 0.5), "QSX7": (1.0, 1.0), "QSX8": (1.0, 1.0),
    "QSX9": (0.5, 0.5), "QSX11": (1.0, 1.0), "QSY1": (0.01, 0.01), "QSY7": (1.0, 0.3),
}  # fmt: skip
"""Coefficient without which there is no shape -> (centre, least spread).

RVY4 to RVY6 shape an effect of the size RVY1 to RVY3, QSX5 to QSX9 and QSX11 those of
the sizes QSX4 and QSX10: at zero they would hide it.
"""

_AROUND_ZERO = {
    1.0: "PEX4 PEX2 PEX3 PEY1 PEY2 PEY3 REX1 REX2 REY1 REY2 PPX1 PPY1 PPY2 PPY5 PPZ1"
    " PPZ2 PKY3 PKY6 PKY7 QEZ1 QEZ2 QEZ3 QEZ4 QBZ4 QBZ5 QDZ3 SSZ3 SSZ4 PEX1 QSX2 QSX10"
    " PPMX1 QSY5 QSY6",
    0.3: "PDX2 PDY2 PKX3 PPX3 PPY3 QDZ8 QDZ9 QHZ3 QHZ4 QSY8",
    5.0: "PKX2 PDX3 PDY3",
    2.0: "PPX2",
    0.5: "PPX4 PPY4 PVY3 PVY4 RVY3",
    50.0: "PEY4 PEY5 PKY5 QEZ5",
    1000.0: "RBX3 RBY4",
    10.0: "QDZ4 QBZ10",
    0.1: "QSX3 QSX4",
    0.003: "PHX1 PHX2 PHY1 PHY2 QDZ6 QDZ7 QSX1 QSY3 QSY4",
    0.03: "PVX1 PVX2 PVY1 PVY2 RBY3 PHY3 RVY1 RVY2 QDZ2 SSZ1 SSZ2",
    0.01: "RHX1 RHY1 RHY2 QHZ1 QHZ2 QSY2",
    3.0: "QDZ10 QDZ11 QBZ2 QBZ3",
}
"""Least spread -> coefficients that are zero where a tire has no such effect.

It makes the effect of the coefficient, at twice the nominal load, 0.1 rad of camber or
a pressure off by half, about as large as what it acts upon.
"""

_FLOORS = {name: size for size, names in _AROUND_ZERO.items() for name in names.split()}

_LOG = ("RBX1", "RBX2", "RBY1", "RBY2", "RVY4", "QSX5", "QSX6")
"""Coefficients whose sign is without effect (that of RBX1 and RBY1 turns with RBX3 and
RBY4): their spread is one of the logarithm."""

_EVEN = (*_LOG, "QBZ9")
"""QBZ9 has none where QBZ10 is zero."""

_AMONG_TIRES = 2.0
"""Spread over the root mean square of the published values about the centre."""


def normal_form(values: Mapping[str, float]) -> dict[str, float]:
    """The same tire with the signs of this package, where two say the same.

    mu_y and B_y C_y may both be negative, as in some published files, and a sine turns
    with its argument; a weighting takes the square of some slopes.
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


def priors_of(
    families: Mapping[str, Sequence[Mapping[str, float]]],
) -> dict[str, Prior]:
    """The prior of every coefficient from published tires.

    Args:
        families: name -> coefficients of tires that are measurements of one (another
            pressure, another version of the file), which count as one tire by their
            mean. A zero counts as an effect that was not measured.
    """
    priors = {}
    for name in (*_CENTRED, *_FLOORS):
        means = []
        for tires in families.values():
            given = [normal_form(tire).get(name, 0.0) for tire in tires]
            measured = [value for value in given if value]
            if measured:
                means.append(sum(measured) / len(measured))
        priors[name] = _prior(name, means)
    return priors


def _prior(name: str, published: list[float]) -> Prior:
    centre, least = _CENTRED.get(name, (0.0, _FLOORS.get(name, 0.0)))
    log = name in _LOG
    squares = [
        math.log(value / centre) ** 2 if log else (value - centre) ** 2
        for value in published
    ]
    size = math.sqrt(sum(squares) / len(squares)) if squares else 0.0
    spread = max(least, _AMONG_TIRES * size)
    return Prior(centre, float(f"{spread:.2g}"), log, tuple(published))


@cache
def published_priors() -> dict[str, Prior]:
    """The table that is shipped."""
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
