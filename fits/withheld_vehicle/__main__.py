"""Counts the withheld effects of simulated cars that the diagnosis names.

    python -m fits.withheld_vehicle --first 3000 --trials 100 --out out/withheld_vehicle

``--out`` receives ``trials.jsonl``, one line per trial.
"""

import argparse
import json
from collections import Counter
from functools import partial
from multiprocessing import get_context
from pathlib import Path

from fits.withheld_vehicle.drives import KINDS, judged


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--first", type=int, default=3000)
    parser.add_argument("--trials", type=int, default=40)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True)
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    numbers = range(asked.first, asked.first + asked.trials)
    counts: Counter = Counter()
    with (
        get_context("spawn").Pool(asked.jobs) as pool,
        (asked.out / "trials.jsonl").open("a") as file,
    ):
        for found in pool.imap_unordered(partial(judged, folder=asked.out), numbers):
            file.write(json.dumps(found) + "\n")
            file.flush()
            counts[found["kind"], found["outcome"]] += 1
    for kind in KINDS:
        print(kind, {o: n for (k, o), n in sorted(counts.items()) if k == kind})


if __name__ == "__main__":
    main()
