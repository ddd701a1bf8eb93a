"""Writes ``tirefit/fitting/mf/priors.csv``: python make_priors.py"""

import csv
import sys
from pathlib import Path

from tirefit.data.tir import read_tir
from tirefit.fitting.mf.parts import coefficients_of
from tirefit.fitting.mf.priors import Prior, priors_of

ROOT = Path(__file__).parents[2]
TIRES = ROOT / "tests" / "data" / "tir"
TABLE = ROOT / "tirefit" / "fitting" / "mf" / "priors.csv"

FAMILIES = {
    "truck": [f"chrono/335_65R22_5_G275MSA_{psi}psi.tir" for psi in (40, 60, 70, 95)],
    "mf52": ["mfeval_julia/MagicFormula52_Parameters.tir"],
    "mf6": [f"mfeval_julia/MagicFormula{n}_Parameters.tir" for n in (61, 62)],
}
"""Tires by name; the files of one are the same tire at other pressures or versions."""


def priors_without(*left_out: str) -> dict[str, Prior]:
    """The table from all families but these."""
    return priors_of(
        {
            family: [read_tir(TIRES / file).numbers for file in files]
            for family, files in FAMILIES.items()
            if family not in left_out
        }
    )


def main(path: Path = TABLE) -> None:
    """Writes the table."""
    order = dict.fromkeys(n for v in ("5.2", "6.1") for n in coefficients_of(v))
    priors = priors_without()
    if missing := [name for name in order if name not in priors]:
        raise SystemExit(f"no floor of {', '.join(missing)}")
    with open(path, "w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["coefficient", "centre", "spread", "scale", "published"])
        for name in order:
            prior = priors[name]
            scale = "log" if prior.log else "linear"
            values = " ".join(f"{value:.6g}" for value in prior.published)
            table.writerow(
                [name, f"{prior.centre:g}", f"{prior.spread:g}", scale, values]
            )


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
