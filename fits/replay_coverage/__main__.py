"""Counts on simulated drives how often intervals of a fit by trajectory contain the truth.

    python -m fits.replay_coverage --drives 400 --jobs 2 --out out/coverage

Each drive of a single-track car on brushes (``--wheels``: of the four-wheeled car with
roll of ``tirefit.sim.drive``) is logged at 100, 50 and 20 Hz with noise, the yaw rate
and the steering in steps, the steering early by a delay and reduced by an offset.
``fit_trajectory`` gets the log and the vehicle without delay and offset; ``derive`` and
``fit`` get the same. ``--out`` receives ``logs.jsonl``, one line per log, which a later
run continues, and ``table.md``.
"""

import argparse
import json
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from fits.replay_coverage.drives import table, trial


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--drives", type=int, default=10)
    parser.add_argument("--first", type=int, default=0, help="seed of the first drive")
    parser.add_argument("--wheels", action="store_true", help="the four-wheeled car")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True)
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    path = asked.out / "logs.jsonl"
    lines = path.read_text().splitlines() if path.exists() else []
    trials = [json.loads(line) for line in lines]
    done = {one["seed"] for one in trials}
    seeds = [k for k in range(asked.first, asked.first + asked.drives) if k not in done]
    with get_context("spawn").Pool(asked.jobs) as pool, path.open("a") as file:
        for found in pool.imap_unordered(partial(trial, wheels=asked.wheels), seeds):
            trials += found
            file.writelines(json.dumps(one) + "\n" for one in found)
            file.flush()
            (asked.out / "table.md").write_text(table(trials))
    cost = np.mean([one["seconds"] for one in trials])
    print(table(trials), f"{len(trials)} logs, {cost:.1f} s of a core each", sep="\n")


if __name__ == "__main__":
    main()
