"""Runs ``tirefit diagnose`` over a folder of trials, one process for each rig.toml.

    python -m fits.withheld.run out/withheld --jobs 2

It opens the files and rig.toml of ``FOLDER/trials``, ``FOLDER/leave_out.json`` (which
effects a group is diagnosed without) and ``FOLDER/simulators.json`` (which groups hold
a simulator's forces, and are diagnosed with ``--sim``), nothing else. The answers go
to ``FOLDER/answers/GROUP``.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

__all__ = ["command", "main", "simulated"]


def command(group: Path, without: list[str], out: Path, *more: str) -> list[str]:
    """The command line for all files of a group, which share their rig.toml."""
    program = Path(sys.executable).with_name("tirefit")
    files = sorted(str(path) for path in group.glob("*.csv"))
    left_out = [word for effect in without for word in ("--without", effect)]
    rig = str(group / "rig.toml")
    return [
        str(program), "diagnose", *files, "--model", "brush", "--rig", rig, *left_out,
        "--out", str(out), *more,
    ]  # fmt: skip


def simulated(folder: Path) -> dict[str, bool]:
    """Whether a group's files hold a simulator's forces; folders of old say nothing."""
    told = folder / "simulators.json"
    return json.loads(told.read_text()) if told.exists() else {}


def run_group(group: Path, without: list[str], out: Path, *more: str) -> float:
    """Seconds that one group took. Without ``--resume`` old answers are removed."""
    if "--resume" not in more:
        shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True, exist_ok=True)
    begun = time.perf_counter()
    # What one process compiled serves the others.
    shared = {
        "JAX_COMPILATION_CACHE_DIR": str(out.parent.absolute() / "compiled"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.3",
    }
    with (out / "run.log").open("w") as log:
        line = command(group, without, out, *more)
        done = subprocess.run(line, stdout=log, stderr=log, check=False,
                              env=shared | os.environ)  # fmt: skip
    spent = time.perf_counter() - begun
    files = len(list(group.glob("*.csv")))
    answered = len(list(out.glob("*.rows.csv")))
    print(f"{group.name}: {answered} of {files} files, {spent:.0f} s, "
          f"exit {done.returncode}", flush=True)  # fmt: skip
    return spent


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description="Diagnose a folder of trials")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--jobs", type=int, default=1, help="groups at a time")
    parser.add_argument("--resume", action="store_true", help="keep answers given")
    given = parser.parse_args(arguments)
    told = json.loads((given.folder / "leave_out.json").read_text())
    beside = simulated(given.folder)
    keep = ["--resume"] if given.resume else []
    groups = sorted((given.folder / "trials").iterdir())
    answers = given.folder / "answers"
    with ThreadPoolExecutor(given.jobs) as pool:
        spent = sum(
            pool.map(
                lambda group: run_group(
                    group,
                    told[group.name],
                    answers / group.name,
                    *keep,
                    *(["--sim"] if beside.get(group.name) else []),
                ),  # fmt: skip
                groups,
            )
        )
    files = sum(len(list(group.glob("*.csv"))) for group in groups)
    ran = {"files": files, "jobs": given.jobs, "seconds_per_case": spent / files}
    (answers / "run.json").write_text(json.dumps(ran))


if __name__ == "__main__":
    main()
