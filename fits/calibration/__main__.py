"""Teaches ``tirefit/diagnosis/calibration.json`` on records of known cause.

    python -m fits.calibration out/records/421 out/records/422

The records are those of :mod:`fits.ablation.collect`: development seeds, never the
designs and forms of the sealed ones. Taught are the probability of something unlisted,
and by status how often verdicts by it are right. How well both do on what they were not
taught is printed: kinds of unlisted effects left out, and each folder by the other.
"""

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from fits.ablation.records import loaded
from fits.ablation.variants import Rules, decided, taught
from fits.calibration import said, train
from fits.withheld.judge import judge

PLACE = Path(__file__).parents[2] / "tirefit/diagnosis/calibration.json"


def verdicts_of(records: Sequence[Mapping], numbers, rules) -> list[said.Said]:
    """Status, probability and whether it is right, of each trial; what a measured file
    lacks is known to nobody."""
    found = []
    for record in records:
        if record["label"]["set"] in ("raw", "measured"):
            continue
        answer = decided(record, rules, numbers)
        right = judge(record["name"], record["label"], answer.document).right
        found.append((answer.kind, answer.probability, right))
    return found


def numbers_of(records: Sequence[Mapping], rules: Rules = Rules()) -> dict:
    """What ``tirefit/diagnosis/decide/findings.py`` reads."""
    numbers = train.taught(taught(records, rules))
    lines = said.lines_of(verdicts_of(records, numbers, rules))
    return {"unlisted": numbers, "said": lines}


def checked_by_halves(halves: Sequence[Sequence[Mapping]]) -> dict:
    """What is said of each half by what the other teaches."""
    rules, verdicts, of = Rules(), [], []
    for own, other in ((0, 1), (1, 0)):
        numbers = train.taught(taught(halves[other], rules))
        found = verdicts_of(halves[own], numbers, rules)
        verdicts += found
        of += [own] * len(found)
    return said.checked(verdicts, of)


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folders", type=Path, nargs=2)
    parser.add_argument("--out", type=Path, default=PLACE)
    given = parser.parse_args(arguments)
    halves = [loaded(folder) for folder in given.folders]
    both = [record for half in halves for record in half]
    numbers = numbers_of(both)
    given.out.write_text(json.dumps(numbers, indent=1) + "\n")
    found = {
        "unlisted": train.checked(taught(both, Rules())),
        "said": checked_by_halves(halves),
    }
    print(json.dumps(found, indent=1, default=lambda x: np.round(x, 4)))


if __name__ == "__main__":
    main()
