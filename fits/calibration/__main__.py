"""Teaches the probabilities of ``tirefit/diagnosis/decide/calibrated.py``.

    python -m fits.calibration --out out/calibration --jobs 2

Draws trials of known cause with the generator of ``fits/withheld`` (development seeds,
never the designs and forms of the sealed ones), examines each, keeps the clues in
``OUT/clues-*.jsonl`` (a second run goes on where the first was stopped), and writes
``tirefit/diagnosis/calibration.json``: centre, spread and weight of every clue, and how
well both probabilities do on families and strangers that they were not taught. Then
more trials are diagnosed, and how often the verdicts of each status were right is kept.

    python -m fits.calibration --said --out out/calibration --jobs 2

teaches that alone, as must be done where the verdicts changed and the clues did not.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path

from fits.calibration.said import lines_of, verdicts_of
from fits.calibration.train import taught
from fits.withheld import generate, run
from fits.withheld.generate import write_all
from fits.withheld.trials import draw

SEEDS = {
    401: ("singles", "null", "unlisted", "singles", "null", "procedural", "pairs",
          "foreign", "leave_out"),
    402: ("singles", "pairs", "leave_out", "procedural", "beside", "unlisted",
          "singles", "injected", "beside", "foreign", "procedural"),
    403: ("leave_out", "beside", "singles", "procedural", "injected", "leave_out",
          "pairs", "beside", "foreign", "unlisted", "singles", "procedural"),
}  # fmt: skip
"""Development seed -> sets of trials in turn."""

LAST = 404
"""Development seed of the trials by which the verdict as a whole is judged, of all sets
as the checks draw them."""

PLACE = Path(__file__).parents[2] / "tirefit/diagnosis/calibration.json"


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--trials", type=int, default=400, help="of each seed")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument(
        "--said",
        action="store_true",
        help="teach the last question alone, of the verdicts by the numbers that are"
        " there",
    )
    given = parser.parse_args(arguments)
    before = PLACE.read_text()
    numbers = json.loads(before) if given.said else _both(given)
    try:
        numbers["said"] = _said(given, numbers)
    except BaseException:
        # Stopped, it leaves no numbers of which the last question is missing.
        PLACE.write_text(before)
        raise
    PLACE.write_text(json.dumps(numbers, indent=1) + "\n")
    print(json.dumps({k: numbers[k]["checked"] for k in ("more", "beside")}, indent=1))


def _said(given, numbers: dict) -> dict:
    """How sure each status is, of the verdicts by these numbers without any line of
    their own."""
    PLACE.write_text(json.dumps(numbers | {"said": {}}, indent=1) + "\n")
    folder = given.out / "verdicts" / str(LAST)
    if not (folder / "labels.json").exists():
        trials = str(2 * given.trials)
        rows = ["--rows", "200,900", "--trials", trials]
        generate.main(["--seed", str(LAST), *rows, "--out", str(folder)])
    run.main([str(folder), "--jobs", str(given.jobs), "--resume"])
    return lines_of(verdicts_of(folder))


def _both(given) -> dict:
    """The regressions of what is unlisted and of what is there beside it."""
    for seed, sets in SEEDS.items():
        folder = given.out / str(seed)
        if not (folder / "labels.json").exists():
            trials = draw(
                seed, given.trials, sets, [], ("rig", "seed"), (200, 900), False
            )
            write_all(trials, folder)
    shards = [
        subprocess.Popen(
            [
                sys.executable,
                "-m",
                "fits.calibration.collect",
                str(given.out),
                f"{number}/{given.jobs}",
            ]
        )  # fmt: skip
        for number in range(given.jobs)
    ]
    if any(shard.wait() for shard in shards):
        sys.exit("not all trials could be examined: see above, and start again")
    records = [
        json.loads(line)
        for path in sorted(given.out.glob("clues-*.jsonl"))
        for line in path.read_text().splitlines()
    ]
    numbers = taught(sorted(records, key=lambda record: record["trial"]))
    numbers["made by"] = f"python -m fits.calibration --trials {given.trials}"
    return numbers


if __name__ == "__main__":
    main()
