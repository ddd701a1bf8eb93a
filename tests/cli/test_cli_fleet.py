"""``fit`` and ``diagnose`` by the workers of a cluster: what the plain loop gives, also
when a worker dies in the middle, when a file kills workers, and when it goes on later.
"""

import json
import os
import signal
import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest
from test_cli_fit import FAST, write

from tirefit.cli.cluster import cluster
from tirefit.data.records import ResultsTable

NAMES = tuple("abcdef")


@pytest.fixture(scope="module")
def scheduler():
    """Address of a cluster of two workers."""
    with cluster(2) as client:
        yield client.scheduler.address


@pytest.fixture
def files(tmp_path):
    (tmp_path / "fit.toml").write_text(FAST)
    (tmp_path / "bad.csv").write_text("sigma_x,fx,fz\n0.1,oops,4000\n")
    good = [
        write(tmp_path / f"{name}.csv", mu=0.9 + 0.01 * seed, n=40, seed=seed)
        for seed, name in enumerate(NAMES)
    ]
    return [Path(path.name) for path in (*good[:3], tmp_path / "bad.csv", *good[3:])]


HOW = ("--config", "fit.toml", "--no-posterior")


def results(folder):
    """Every file of the results, but the table and the page on all."""
    return {
        path.relative_to(folder): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.parent != folder
    }


class Killer(threading.Thread):
    """Makes a file a pipe, and kills so many of the workers that read it; the next one
    gets the content."""

    def __init__(self, file: Path, times: int):
        super().__init__(daemon=True)
        self.file, self.times, self.killed = file, times, 0
        self.content = file.read_bytes()
        file.unlink()
        os.mkfifo(file)

    def run(self):
        for _ in range(self.times):
            with self.file.open("wb"):  # until a worker reads
                self._kill_the_reader()
        with self.file.open("wb") as pipe:
            pipe.write(self.content)

    def _kill_the_reader(self):
        readers = []
        while not readers:  # its side opens a moment later
            readers = [one for one in processes() if str(self.file) in opened_by(one)]
        for process in readers:
            os.kill(process, signal.SIGKILL)
            self.killed += 1
        while any(opened_by(process) for process in readers):
            time.sleep(0.01)  # what is written before it is gone is lost with it


def processes():
    numbers = (int(path.name) for path in Path("/proc").glob("[0-9]*"))
    return [number for number in numbers if number != os.getpid()]


def opened_by(process):
    """Files that another process has opened; none where it is gone."""
    folder, names = Path(f"/proc/{process}/fd"), set()
    with suppress(OSError):
        for one in folder.iterdir():
            names.add(os.readlink(one))
    return names


def test_a_dead_worker_and_a_bad_file_change_no_result(run, files, scheduler, tmp_path):
    alone = run("fit", *files, *HOW, "--out", "one", exit_code=3)
    killer = Killer(tmp_path / "d.csv", times=1)
    killer.start()
    shared = run(
        "fit", *files, *HOW, "--out", "two", "--scheduler", scheduler, exit_code=3
    )
    killer.join(10)
    assert killer.killed == 1
    expected = results(tmp_path / "one")
    assert {path.parts[0] for path in expected} == set(NAMES)
    assert results(tmp_path / "two") == expected
    said = [
        line for line in shared.stdout.splitlines() if not line.startswith("all res")
    ]
    assert said == alone.stdout.replace("one/", "two/").splitlines()
    assert "bad.csv" in shared.stderr and "remedy" in shared.stderr
    table = ResultsTable(tmp_path / "two" / "results.parquet")
    friction = table.of("parameter", "mu")
    assert friction["number"].tolist() == [1, 2, 3, 5, 6, 7]
    stored = [
        json.loads((tmp_path / "one" / name / "fit.json").read_text())["parameters"]
        for name in NAMES
    ]
    assert friction["value"].tolist() == [one["mu"]["value"] for one in stored]
    assert table.files()["status"] == ["ok", "ok", "ok", "failed", "ok", "ok", "ok"]


def test_a_file_that_kills_workers_is_told_once(run, files, scheduler, tmp_path):
    """And with --resume it alone is done."""
    content = (tmp_path / "b.csv").read_bytes()
    Killer(tmp_path / "b.csv", times=100).start()
    command = ["fit", *files[:3], *HOW, "--out", "out", "--scheduler", scheduler]
    said = run(*command, exit_code=3)
    assert said.stderr.count("b.csv") == 1 and "died" in said.stderr
    folders = {path.name for path in (tmp_path / "out").iterdir() if path.is_dir()}
    assert folders == {"a", "c"}
    before = results(tmp_path / "out")
    times = {path: (tmp_path / "out" / path).stat().st_mtime_ns for path in before}
    (tmp_path / "b.csv").unlink()
    (tmp_path / "b.csv").write_bytes(content)
    said = run(*command, "--resume")
    assert said.stdout.count("done before, kept") == 2
    there = results(tmp_path / "out")
    assert {path.parts[0] for path in there} == {"a", "b", "c"}
    assert all(there[path] == before[path] for path in before)
    kept = {path: (tmp_path / "out" / path).stat().st_mtime_ns for path in before}
    assert kept == times
    table = ResultsTable(tmp_path / "out" / "results.parquet")
    assert table.of("parameter", "mu")["number"].tolist() == [1, 2, 3]


def test_resume_does_what_is_asked_otherwise_again(run, files, tmp_path):
    """The plain loop: other data, other settings, another seed, a figure gone."""
    command = ["fit", files[0], *HOW, "--out", "out", "--resume"]
    document = tmp_path / "out" / "fit.json"

    def is_kept(*more):
        return "done before, kept" in run(*command, *more).stdout

    assert not is_kept() and is_kept()
    assert not is_kept("--seed", "4")
    assert is_kept("--seed", "4") and not is_kept()
    (tmp_path / "out" / "fit.png").unlink()
    assert not is_kept() and is_kept()
    text = document.read_text()
    document.write_text(text.replace('"seed": 0', '"seed": 1'))
    assert not is_kept() and document.read_text() == text
    write(files[0], n=40, seed=9)
    assert not is_kept()


def test_jobs_and_scheduler_are_two_ways(run, files):
    said = run("fit", files[0], "--jobs", "2", "--scheduler", "x:1", exit_code=2)
    assert "--jobs beside --scheduler" in said.stderr
