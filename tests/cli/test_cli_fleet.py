"""``fit`` by the workers of a cluster gives the results of the plain loop, also if a file
kills workers, and after ``--resume``; order, losses and end of the work that a cluster
shares."""

import json
import os
import pickle
import time
from contextlib import closing, nullcontext
from functools import partial
from itertools import islice
from pathlib import Path

import pandas as pd
import pytest
from pieces import doubled, fatal, held, received
from test_cli_fit import FAST, write

from tirefit.cli import fleet
from tirefit.cli.fleet import cluster, shared
from tirefit.results import UsageError

NAMES = tuple("abc")


def test_every_piece_runs_once_in_the_requested_number_of_processes(two):
    results = list(shared(doubled, range(40), two))
    assert [value for value, _ in results] == [2 * n for n in range(40)]
    processes = {process for _, process in results}
    assert os.getpid() not in processes and len(processes) <= 2


@pytest.mark.long
def test_a_piece_that_kills_workers_fails_alone(two, tmp_path):
    """Piece 5, which killed a worker once, is repeated; those beside a death return."""
    results = list(shared(partial(fatal, tmp_path), range(8), two))
    assert results == [None if n == 3 else n for n in range(8)]
    assert (tmp_path / "5").exists()


def test_an_early_end_cancels_pending_pieces(two, tmp_path):
    """No more begin than the piece that ends, and one that each worker holds."""
    two.wait_for_workers(2)
    with closing(shared(partial(held, tmp_path), range(30), two)) as results:
        assert next(results) == 0
    # Messages to a worker arrive in order: a worker that has received this task has
    # received the cancellation before.
    later = [two.submit(doubled, 1, workers=[place], pure=False) for place in two.nthreads()]
    while not all(two.run(received, [task.key for task in later]).values()):
        time.sleep(0.01)
    (tmp_path / "go").touch()
    assert [value for value, _ in two.gather(later)] == [2, 2]
    begun = {path.name for path in tmp_path.glob("begun*")}
    assert "begun0" in begun and len(begun) <= 3


def test_a_missing_scheduler_is_a_usage_error(monkeypatch):
    monkeypatch.setattr("tirefit.cli.fleet._CONNECT", 0.2)
    with pytest.raises(UsageError, match="no scheduler with a worker answers at 127"):
        with cluster(None, "127.0.0.1:1"):
            pass


@pytest.fixture
def files(tmp_path):
    (tmp_path / "fit.toml").write_text(FAST)
    (tmp_path / "bad.csv").write_text("sigma_x,fx,fz\n0.1,oops,4000\n")
    good = [
        write(tmp_path / f"{name}.csv", mu=0.9 + 0.01 * seed, seed=seed)
        for seed, name in enumerate(NAMES)
    ]
    return [Path(path.name) for path in (*good, tmp_path / "bad.csv")]


HOW = ("--config", "fit.toml", "--no-posterior")


def results(folder):
    """Every file of the results, except the table and the page of all."""
    return {
        path.relative_to(folder): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.parent != folder
    }


def same_results(run, files, tmp_path, *workers):
    """Asserts that these workers give the results of the plain loop, of a bad file too."""
    files = [files[3], files[0]]
    alone = run("fit", *files, *HOW, "--out", "one", exit_code=3)
    shared = run("fit", *files, *HOW, "--out", "two", *workers, exit_code=3)
    expected = results(tmp_path / "one")
    assert {path.parts[0] for path in expected} == {"a"}
    assert results(tmp_path / "two") == expected
    said = [line for line in shared.stdout.splitlines() if not line.startswith("all res")]
    assert said == alone.stdout.replace("one/", "two/").splitlines()
    assert "bad.csv" in shared.stderr and "remedy" in shared.stderr
    table = pd.read_parquet(tmp_path / "two" / "results.parquet")
    friction = table[table["name"] == "mu"]
    stored = json.loads((tmp_path / "one" / "a" / "fit.json").read_text())["parameters"]
    assert friction[["number", "value"]].values.tolist() == [[2, stored["mu"]["value"]]]
    assert table["status"].tolist()[:2] == ["failed", "ok"]


def test_jobs_of_one_file_write_the_table_beside_its_result(
    run, files, workers_here, no_figures, tmp_path
):
    run("fit", files[0], *HOW, "--out", "one", "--jobs", "2")
    table = pd.read_parquet(tmp_path / "one" / "results.parquet")
    assert set(table["status"]) == {"ok"} and (tmp_path / "one" / "fit.json").exists()


def test_jobs_and_a_bad_file_change_no_other_result(run, files, workers_here, no_figures, tmp_path):
    same_results(run, files, tmp_path, "--jobs", "2")


@pytest.mark.long
def test_workers_and_a_bad_file_change_no_other_result(run, files, two, tmp_path):
    same_results(run, files, tmp_path, "--scheduler", two.scheduler.address)


@pytest.fixture
def quick(monkeypatch, no_figures):
    """The work is done in this process without figures, and ``b.csv`` ends whoever
    takes it while ``fatal`` contains a word."""
    fatal = ["b.csv"]

    def here(work, pieces, client):
        for piece in pieces:
            yield None if piece.file.name in fatal else work(piece)

    monkeypatch.setattr(fleet, "shared", here)
    monkeypatch.setattr(fleet, "cluster", lambda *how: nullcontext())
    return fatal


def test_a_file_that_kills_workers_is_reported_once(run, files, quick, tmp_path):
    """--resume repeats only this file."""
    command = ["fit", *files[:3], *HOW, "--out", "out", "--jobs", "2"]
    said = run(*command, exit_code=3)
    assert said.stderr.count("b.csv") == 1 and "worker" in said.stderr
    folders = {path.name for path in (tmp_path / "out").iterdir() if path.is_dir()}
    assert folders == {"a", "c"}
    assert said.stdout.index("of a.csv") < said.stdout.index("of c.csv")

    def times():
        return {path: (tmp_path / "out" / path).stat().st_mtime_ns for path in before}

    before = results(tmp_path / "out")
    earlier = times()
    quick.clear()
    said = run(*command, "--resume")
    assert said.stdout.count("done before, kept") == 2
    assert {path.parts[0] for path in results(tmp_path / "out")} == {"a", "b", "c"}
    assert times() == earlier
    table = pd.read_parquet(tmp_path / "out" / "results.parquet")
    assert table[table["name"] == "mu"]["number"].tolist() == [1, 2, 3]


def test_an_interrupt_keeps_only_complete_results(run, files, quick, tmp_path, monkeypatch):
    def interrupted(*sharing):
        yield from islice(here(*sharing), 1)
        raise KeyboardInterrupt

    here = fleet.shared
    monkeypatch.setattr(fleet, "shared", interrupted)
    run("fit", *files[:3], *HOW, "--out", "out", "--jobs", "2", exit_code=130)
    there = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert there == ["a"] and (tmp_path / "out" / "a" / "fit.json").exists()


def test_an_internal_error_does_not_stop_other_files(run, files, quick, monkeypatch):
    from tirefit.fitting import estimate

    fit = estimate.fit

    def faulty(data, **how):
        if data.name == "a":
            raise ZeroDivisionError("no such luck")
        return fit(data, **how)

    monkeypatch.setattr(estimate, "fit", faulty)
    said = run("fit", *files[:3:2], *HOW, "--jobs", "1", exit_code=3)
    assert "a.csv: a fault of the program: ZeroDivisionError: no such" in said.stderr
    assert "of c.csv" in said.stdout


def test_resume_repeats_fits_with_other_settings(run, files, quick, tmp_path):
    """Another seed, a missing figure, a changed document or other data."""
    command = ["fit", files[0], *HOW, "--out", "out", "--resume", "--seed"]
    document = tmp_path / "out" / "fit.json"

    def is_kept(seed):
        return "done before, kept" in run(*command, seed).stdout

    assert not is_kept(0) and is_kept(0)
    assert not is_kept(4) and is_kept(4)
    (tmp_path / "out" / "fit.png").unlink()
    assert not is_kept(4) and is_kept(4)
    text = document.read_text()
    document.write_text(text.replace("40.", "41.", 1))
    assert not is_kept(4) and document.read_text() == text
    write(files[0], seed=9)
    assert not is_kept(4)


def test_workers_of_another_version_or_place_are_refused(files, tmp_path):
    piece = fleet.Piece(files[0], tmp_path / "a")
    for of_command in (("/", "0.0"), ("/no/such", fleet.__version__)):
        with pytest.raises(
            UsageError, match="it needs {1} and the folder {0}".format(*of_command)
        ) as caught:
            fleet._apart(of_command, b"", piece)
        # As Dask sends it to the command.
        again = pickle.loads(pickle.dumps(caught.value))
        assert type(again) is UsageError and again.problems == caught.value.problems


@pytest.mark.parametrize(
    ("command", "name"),
    [
        (("diagnose", "--force", "fx"), "results.parquet"),
        (("prepare",), "fleet.html"),
        (("fit", *HOW), "results.parquet"),
    ],
)
def test_summary_files_do_not_overwrite_other_files(run, files, tmp_path, command, name):
    out = tmp_path / "out"
    out.mkdir()
    file = out / name
    file.write_bytes(files[0].read_bytes())
    ended = run(*command, file, "--out", out, "--jobs", "1", exit_code=3)
    assert "it is an input file (FILES), which would be replaced" in ended.stderr
    assert list(out.iterdir()) == [file]
    assert file.read_bytes() == files[0].read_bytes()


def test_jobs_and_scheduler_exclude_each_other(run, files):
    said = run("fit", files[0], "--jobs", "2", "--scheduler", "x:1", exit_code=2)
    assert "--jobs together with --scheduler" in said.stderr
