"""Runs ``tirefit diagnose`` over a folder of trials, one command for each rig.toml.

    python -m fits.withheld.run out/withheld --jobs 2

It opens only the files and rig.toml of ``FOLDER/trials``, ``FOLDER/leave_out.json`` (the
effects without which a group is diagnosed) and ``FOLDER/simulators.json`` (the groups
with a simulator's forces, which are diagnosed with ``--sim``). The answers go to
``FOLDER/answers/GROUP``.

The commands run in ``--jobs`` processes, each for several groups in turn, so that compiled
programs are reused, by the other processes through JAX's cache. Each process has one
thread of OpenBLAS, because waiting threads would use the cores of other processes.
"""

import argparse
import json
import os
import shutil
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from contextlib import redirect_stderr, redirect_stdout
from importlib.metadata import entry_points
from multiprocessing import get_context, parent_process
from pathlib import Path
from threading import Thread

__all__ = ["command", "end_with_parent", "largest_first", "main", "more_words", "simulated"]


def command(group: Path, without: list[str], out: Path, *more: str) -> list[str]:
    """The command line for all files of a group, which have the same rig.toml."""
    program = Path(sys.executable).with_name("tirefit")
    files = sorted(str(path) for path in group.glob("*.csv"))
    left_out = [word for effect in without for word in ("--without", effect)]
    rig = str(group / "rig.toml")
    return [
        str(program), "diagnose", *files, "--model", "brush", "--rig", rig, *left_out,
        "--out", str(out), *more,
    ]  # fmt: skip


def _in_this_process(words: list[str]) -> int:
    """Exit code of a command line, run as its console script does."""
    (script,) = entry_points(group="console_scripts", name=Path(words[0]).name)
    before, sys.argv = sys.argv, words
    try:
        script.load()()
    except SystemExit as end:
        return int(end.code or 0)
    finally:
        sys.argv = before
    return 0


def end_with_parent() -> None:
    """Ends this process when its parent ends; workers of a pool would otherwise continue
    with waiting tasks."""

    def wait() -> None:
        if parent := parent_process():
            parent.join()
            os._exit(1)

    Thread(target=wait, daemon=True).start()


def _begin(compiled: str) -> None:
    """Sets the environment of a process before it imports JAX and NumPy."""
    end_with_parent()
    values = {
        "JAX_COMPILATION_CACHE_DIR": compiled,
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.3",
        "OPENBLAS_NUM_THREADS": "1",
    }
    for name, value in values.items():
        os.environ.setdefault(name, value)


def simulated(folder: Path) -> dict[str, bool]:
    """Whether each group has a simulator's forces; empty for old folders."""
    path = folder / "simulators.json"
    return json.loads(path.read_text()) if path.exists() else {}


def more_words(folder: Path, resume: bool) -> dict[str, list[str]]:
    """Options of the command for each group."""
    with_sim, keep = simulated(folder), ["--resume"] if resume else []
    return {
        group.name: [*keep, *(["--sim"] if with_sim.get(group.name) else [])]
        for group in (folder / "trials").iterdir()
    }


def largest_first(folder: Path) -> list[Path]:
    """The groups, largest first, so that the processes end at about the same time."""
    groups = list((folder / "trials").iterdir())
    return sorted(groups, key=lambda group: (-len(list(group.iterdir())), group))


def run_group(group: Path, without: list[str], out: Path, *more: str) -> float:
    """Runs one group; returns its time [s]. Without ``--resume`` old answers are removed."""
    if "--resume" not in more:
        shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True, exist_ok=True)
    begun = time.perf_counter()
    line = command(group, without, out, *more)
    with (out / "run.log").open("w") as log, redirect_stdout(log), redirect_stderr(log):
        code = _in_this_process(line)
    spent = time.perf_counter() - begun
    files = len(list(group.glob("*.csv")))
    answered = len(list(out.glob("*.rows.csv")))
    print(f"{group.name}: {answered} of {files} files, {spent:.0f} s, exit {code}", flush=True)
    return spent


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description="Diagnose a folder of trials")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--jobs", type=int, default=1, help="groups at a time")
    parser.add_argument("--resume", action="store_true", help="keep existing answers")
    given = parser.parse_args(arguments)
    if given.jobs < 1:
        parser.error("--jobs must be at least 1")
    if not (given.folder / "leave_out.json").is_file():
        parser.error(f"{given.folder}: no trials; run fits.withheld.generate first")
    left_out = json.loads((given.folder / "leave_out.json").read_text())
    more = more_words(given.folder, given.resume)
    groups = largest_first(given.folder)
    answers = given.folder / "answers"
    compiled = str(answers.absolute() / "compiled")
    apart = get_context("spawn")
    with ProcessPoolExecutor(given.jobs, apart, _begin, (compiled,)) as pool:
        waiting = [
            pool.submit(
                run_group, group, left_out[group.name], answers / group.name, *more[group.name]
            )
            for group in groups
        ]
        spent = sum(one.result() for one in waiting)
    files = sum(len(list(group.glob("*.csv"))) for group in groups)
    ran = {"files": files, "jobs": given.jobs, "seconds_per_case": spent / files}
    (answers / "run.json").write_text(json.dumps(ran))


if __name__ == "__main__":
    main()
