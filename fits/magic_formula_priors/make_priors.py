"""Writes ``tirefit/fitting/mf/priors.csv``: python make_priors.py"""

import csv
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from tirefit.data.tir.tir import read_tir
from tirefit.fitting.mf.parts import coefficients_of
from tirefit.fitting.mf.priors import LOGARITHMIC, Prior, normal_form

ROOT = Path(__file__).parents[2]
TIRES = ROOT / "tests" / "data" / "tir"
TABLE = ROOT / "tirefit" / "fitting" / "mf" / "priors.csv"

FAMILIES = {
    "truck": [f"chrono/335_65R22_5_G275MSA_{psi}psi.tir" for psi in (40, 60, 70, 95)],
    "mf52": ["mfeval_julia/MagicFormula52_Parameters.tir"],
    "mf6": [f"mfeval_julia/MagicFormula{n}_Parameters.tir" for n in (61, 62)],
}
"""Tire -> its files, for different pressures or versions of the format."""


CENTRED = {
    "PCX1": (1.5, 0.3), "PDX1": (1.0, 0.3), "PKX1": (20.0, 10.0),
    "PCY1": (1.4, 0.4), "PDY1": (1.0, 0.3), "PKY1": (-20.0, 10.0), "PKY2": (2.5, 1.5),
    "PKY4": (2.0, 0.7), "QBZ1": (10.0, 4.0), "QCZ1": (1.2, 0.2), "QDZ1": (0.1, 0.05),
    "RBX1": (12.0, 1.0), "RBX2": (10.0, 0.8), "RCX1": (1.0, 0.1), "RBY1": (12.0, 1.5),
    "RBY2": (8.0, 0.8), "RCY1": (1.0, 0.1), "QBZ9": (10.0, 50.0),
    "RVY4": (40.0, 1.0), "RVY5": (1.9, 0.5), "RVY6": (20.0, 10.0),
    "QSX5": (0.5, 0.5), "QSX6": (1.0, 0.5), "QSX7": (1.0, 1.0), "QSX8": (1.0, 1.0),
    "QSX9": (0.5, 0.5), "QSX11": (1.0, 1.0), "QSY1": (0.01, 0.01), "QSY7": (1.0, 0.3),
}  # fmt: skip
"""Coefficient of a shape -> (centre, smallest spread).

RVY4 to RVY6 are shape coefficients of RVY1 to RVY3, QSX5 to QSX9 and QSX11 of QSX4 and
QSX10. At zero they would suppress the effect.
"""

AROUND_ZERO = {
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
"""Smallest spread -> coefficients that are zero in a tire without the effect.

With this value the effect, at twice the nominal load, 0.1 rad of camber or a pressure
off by 50 %, is about as large as the quantity that it changes.
"""

FLOORS = {name: size for size, names in AROUND_ZERO.items() for name in names.split()}

AMONG_TIRES = 2.0
"""Spread over the root mean square of the published values about the centre."""


def published_values(
    families: Mapping[str, Sequence[Mapping[str, float]]],
) -> dict[str, list[float]]:
    """The published values of every coefficient.

    Args:
        families: name -> coefficients of the files of one tire (at other pressures, in
            other versions); their mean is used. A zero is taken as not measured.
    """
    published = {}
    for name in (*CENTRED, *FLOORS):
        means = published[name] = []
        for tires in families.values():
            given = [normal_form(tire).get(name, 0.0) for tire in tires]
            measured = [value for value in given if value]
            if measured:
                means.append(sum(measured) / len(measured))
    return published


def _prior(name: str, published: list[float]) -> Prior:
    centre, least = CENTRED.get(name, (0.0, FLOORS.get(name, 0.0)))
    log = name in LOGARITHMIC
    squares = [
        math.log(value / centre) ** 2 if log else (value - centre) ** 2 for value in published
    ]
    size = math.sqrt(sum(squares) / len(squares)) if squares else 0.0
    spread = max(least, AMONG_TIRES * size)
    return Prior(centre, float(f"{spread:.2g}"), log)


def values_without(*left_out: str) -> dict[str, list[float]]:
    """The published values of all families except these."""
    return published_values(
        {
            family: [read_tir(TIRES / file).numbers for file in files]
            for family, files in FAMILIES.items()
            if family not in left_out
        }
    )


def priors_without(*left_out: str) -> dict[str, Prior]:
    """The prior of every coefficient from all families except these."""
    return {name: _prior(name, values) for name, values in values_without(*left_out).items()}


def main(path: Path = TABLE) -> None:
    """Writes the table."""
    order = dict.fromkeys(n for v in ("5.2", "6.1") for n in coefficients_of(v))
    priors, published = priors_without(), values_without()
    if missing := [name for name in order if name not in priors]:
        raise SystemExit(f"no floor of {', '.join(missing)}")
    with open(path, "w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["coefficient", "centre", "spread", "scale", "published"])
        for name in order:
            prior = priors[name]
            scale = "log" if prior.log else "linear"
            values = " ".join(f"{value:.6g}" for value in published[name])
            table.writerow([name, f"{prior.centre:g}", f"{prior.spread:g}", scale, values])


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
