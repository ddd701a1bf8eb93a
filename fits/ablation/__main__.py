"""Writes the table of the ablation from records.

    python -m fits.ablation out/records/421 out/records/422 --out out/ablation.md

The calibration is fitted to the first folder, the table scores the second.
``--measured`` adds the measured cases, ``--before`` the answers of another version
to the second folder's trials (a folder of ``tirefit diagnose``).
"""

import argparse
from pathlib import Path

from fits.ablation.records import loaded
from fits.ablation.table import table
from fits.ablation.variants import reproduced


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folders", type=Path, nargs=2)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--measured", type=Path, help="records of the measured cases")
    parser.add_argument("--before", type=Path, help="answers of another version")
    given = parser.parse_args(arguments)
    first, second = (loaded(folder) for folder in given.folders)
    there = given.measured and given.measured.exists()
    measured = loaded(given.measured) if there else []
    again = [reproduced(record) for record in (*first, *second, *measured)]
    text = table(first, second, measured, given.before)
    text += f"\nRecords that reproduce the verdict: {sum(again)} of {len(again)}."
    given.out.write_text(text + "\n")
    print(text)


if __name__ == "__main__":
    main()
