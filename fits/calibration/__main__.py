"""Fits ``tirefit/diagnosis/calibration.json`` to records of known cause.

    python -m fits.calibration out/records/421 out/records/422

The records are those of :mod:`fits.ablation.collect`: development seeds, never the
designs and forms of the sealed ones. Two probabilities are calibrated: that of an
unlisted effect, and by status that of a right verdict. The printed scores are those of
each folder with the calibration of the other.
"""

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from fits.ablation.records import loaded
from fits.ablation.variants import Rules, decided, stated_unlisted
from fits.calibration import logistic
from fits.withheld.judge import judge

PLACE = Path(__file__).parents[2] / "tirefit/diagnosis/calibration.json"


def verdicts_of(records: Sequence[Mapping], lines, rules) -> list[logistic.Stated]:
    """Status, probability and whether right, of each trial; measured files, whose effects
    are unknown, are omitted."""
    found = []
    for record in records:
        if record["label"]["set"] in ("raw", "measured"):
            continue
        answer = decided(record, rules, lines)
        right = judge(record["name"], record["label"], answer.document).right
        found.append((answer.kind, answer.probability, right))
    return found


def lines_by(records: Sequence[Mapping], rules: Rules = Rules()) -> dict:
    """The calibration, as ``tirefit/diagnosis/decide/findings.py`` reads it."""
    lines = logistic.lines_of(stated_unlisted(records, rules))
    return lines | logistic.lines_of(verdicts_of(records, lines, rules))


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folders", type=Path, nargs=2)
    parser.add_argument("--out", type=Path, default=PLACE)
    given = parser.parse_args(arguments)
    halves = [loaded(folder) for folder in given.folders]
    lines = lines_by([record for half in halves for record in half])
    given.out.write_text(json.dumps(lines, indent=1) + "\n")
    of = [k for k, half in enumerate(halves) for _ in stated_unlisted(half, Rules())]
    unlisted = [case for half in halves for case in stated_unlisted(half, Rules())]
    print(json.dumps(logistic.checked(unlisted, of), indent=1))
    verdicts, of = [], []
    for k, half in enumerate(halves):
        found = verdicts_of(half, lines_by(halves[1 - k]), Rules())
        verdicts += found
        of += [k] * len(found)
    print(json.dumps(logistic.checked(verdicts, of), indent=1))


if __name__ == "__main__":
    main()
