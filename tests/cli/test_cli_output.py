"""Complete results or none, one process per directory, Ctrl-C, and progress bars."""

import os
import pty
import shutil
import subprocess
import sys
import threading
from contextlib import suppress

import pytest
from test_cli_fit import FAST, content, write

from tests.killed import steps_of
from tirefit.cli import options
from tirefit.cli.commands import app
from tirefit.cli.output import check_results, is_page, staged
from tirefit.files import remove_left, replacing
from tirefit.fitting.result import SCHEMA
from tirefit.results import UsageError

ARGUMENTS = ("fit", "rig.csv", "--config", "fit.toml", "--no-posterior", "--out", "o")


@pytest.fixture
def rig(tmp_path):
    (tmp_path / "fit.toml").write_text(FAST)
    return write(tmp_path / "rig.csv")


def files_of(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_a_foreign_page_is_not_overwritten(tmp_path):
    page = tmp_path / "fit.html"
    assert not is_page(page)
    page.write_text("my own notes")
    assert not is_page(page)
    page.write_bytes(b"\xff" + f"<p>tirefit 0.1.0, {SCHEMA}</p>".encode())
    assert is_page(page)


def test_an_unused_folder_is_removed(tmp_path):
    with pytest.raises(ZeroDivisionError), staged(tmp_path / "a" / "b", [], ""):
        assert (tmp_path / "a" / "b").is_dir()
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError(28, "disk full", "x")])
def test_a_failed_write_keeps_the_earlier_result(
    run, no_figures, rig, tmp_path, monkeypatch, error
):
    run(*ARGUMENTS)
    before = files_of(tmp_path / "o")

    def stopped(result, directory):
        (directory / "fit.png").write_bytes(b"half")
        raise error

    with monkeypatch.context() as patch:
        patch.setattr("tirefit.report.fit.figures.save_figures", stopped)
        code = 130 if error is KeyboardInterrupt else 2
        result = run(*ARGUMENTS, "--seed", "7", exit_code=code)
    said = "" if code == 130 else "error:\n  x: cannot be written: disk full; o is as"
    assert result.stderr.startswith(said) and bool(result.stderr) == bool(said)
    assert files_of(tmp_path / "o") == before


def test_a_new_result_replaces_only_the_earlier_result(tmp_path):
    for name in ("fit.json", "corner.png", "notes.txt"):
        (tmp_path / name).write_text("old")
    (tmp_path / ".tirefit-writing").mkdir()  # of a process that was killed
    (tmp_path / ".tirefit-writing" / "trace.png").write_text("torn")
    torn = tmp_path / ".notes.txt.abc.tirefit-part"
    torn.write_text("torn")
    for left in (torn, tmp_path / ".tirefit-writing"):
        os.utime(left, (0, 0))  # not of a living process
    known = ["fit.json", "corner.png", "trace.png"]
    with staged(tmp_path, known, "") as folder:
        assert not torn.exists()
        (folder / "fit.json").write_text("new")
        assert (tmp_path / "fit.json").read_text() == "old"
    kept = {"fit.json": b"new", "notes.txt": b"old"}
    assert files_of(tmp_path) == kept


def test_a_killed_command_leaves_no_figure_beside_another_document(tmp_path):
    """The next command finds the earlier result or the new one, with its figures only."""
    old = ["fit.json", "fit.png", "corner.png", "posterior.nc"]
    new = ["fit.json", "fit.png", "trace.png"]
    known = ["fit.png", "corner.png", "trace.png", "posterior.nc"]

    def restore():
        shutil.rmtree(tmp_path)
        tmp_path.mkdir()
        for name in old:
            (tmp_path / name).write_text("old")

    def work():
        with staged(tmp_path, known, "") as folder:
            for name in new:
                (folder / name).write_text("new")

    states = set()
    for _ in steps_of(work, restore):
        remove_left(tmp_path)
        there = {path.name: path.read_bytes() for path in tmp_path.glob("[!.]*")}
        state = there["fit.json"]
        assert there == dict.fromkeys(old if state == b"old" else new, state)
        states.add(state)
    assert states == {b"old", b"new"}


def test_a_result_that_a_kill_left_in_parts_is_restored_before_it_is_judged(tmp_path):
    """Killed while files were set aside: a figure has no document that shows whose it is."""
    aside = tmp_path / ".fit.json.earlier.tirefit-part"
    aside.mkdir()
    (aside / "fit.json").write_text('{"schema": "tirefit.fit/1"}')
    os.utime(aside, (0, 0))  # not of a living process
    (tmp_path / "fit.png").write_bytes(b"figure")
    check_results([tmp_path / "fit.png", tmp_path / "fit.json"])
    assert set(files_of(tmp_path)) == {"fit.png", "fit.json"}


def test_an_interrupt_while_files_are_moved_keeps_the_earlier_result(tmp_path, monkeypatch):
    """At each step: the earlier files, or after the last the new ones."""
    old, new = ["fit.json", "fit.png"], ["fit.json", "trace.png"]
    replace, states = os.replace, []
    for last in range(1, 6):
        for path in tmp_path.iterdir():
            path.unlink()
        for name in old:
            (tmp_path / name).write_text("old")
        calls = []

        def interrupted(*given, calls=calls, last=last):
            calls.append(given)
            if len(calls) == last:
                raise KeyboardInterrupt
            replace(*given)

        with monkeypatch.context() as patch, suppress(KeyboardInterrupt):
            patch.setattr(os, "replace", interrupted)
            with staged(tmp_path, ["fit.png", "trace.png"], "") as folder:
                for name in new:
                    (folder / name).write_text("new")
        states.append(files_of(tmp_path))
    assert states == [dict.fromkeys(old, b"old")] * 4 + [dict.fromkeys(new, b"new")]


def test_a_result_leaves_the_files_of_living_processes(tmp_path):
    """A worker writes into the folder in which the command writes the table of all results."""
    with replacing(tmp_path / "results.parquet") as temporary:
        with staged(tmp_path, [], ""):
            assert temporary.exists()
        temporary.write_text("new")
    assert files_of(tmp_path) == {"results.parquet": b"new"}


def test_all_unwritable_directories_are_named(tmp_path, monkeypatch):
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(UsageError) as caught:
        check_results([file / "a", file / "below" / "a", tmp_path / "new" / "one" / "a"])
    first, second = (str(problem) for problem in caught.value.problems)
    assert "file: no folder for the results: it is a file" in first
    assert f"{file} is a file" in second and "--out" in second
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may write everywhere
    with pytest.raises(UsageError, match=f"write into the folder {tmp_path}"):
        check_results([tmp_path / "new" / "one" / "a"])


PROGRAM = """
import os, signal, sys

class Finder:
    def find_spec(self, name, *rest):
        if name == {name!r}:
            os.kill(os.getpid(), signal.{signal})

sys.meta_path.insert(0, Finder())
# In the background of a shell interrupts are ignored, by the children too.
handler = signal.SIG_IGN if {ignored} else signal.default_int_handler
signal.signal(signal.SIGINT, handler)
sys.argv = ["tirefit", *{arguments!r}]
from tirefit.cli import main
main()
"""


def ended(name, *arguments, ignored=False, by="SIGINT"):
    """Runs the command in a process that is interrupted when it imports ``name``."""
    program = PROGRAM.format(name=name, arguments=arguments, ignored=ignored, signal=by)
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)


@pytest.mark.parametrize("name", ["typer", "numpy.linalg", "jax._src.core"])
def test_ctrl_c_during_the_imports_exits_cleanly(rig, name):
    done = ended(name, "fit", str(rig))
    said = "interrupted: files written before are complete\n"
    assert (done.returncode, done.stdout, done.stderr) == (130, "", said)


def test_sigterm_acts_as_ctrl_c(rig):
    """A scheduler, for example, sends SIGTERM; also in the background of a shell."""
    done = ended("jax._src.core", "fit", str(rig), by="SIGTERM", ignored=True)
    assert done.returncode == 130 and done.stderr.startswith("interrupted: ")
    assert "Traceback" not in done.stderr


def test_ctrl_c_stays_ignored_in_the_background():
    done = ended("typer", "--version", ignored=True)
    assert (done.returncode, done.stderr) == (0, "")


def on_terminal(monkeypatch, *arguments):
    """Exit code of a command whose stderr is a terminal, and the text shown there."""
    master, slave = pty.openpty()
    shown = []

    def listen():
        try:
            while chunk := os.read(master, 4096):
                shown.append(chunk)
        except OSError:  # the other end was closed
            pass

    listener = threading.Thread(target=listen)
    listener.start()
    with os.fdopen(slave, "w") as terminal, monkeypatch.context() as patch:
        patch.setattr(sys, "stderr", terminal)
        patch.setenv("TERM", "xterm")
        code = app([str(item) for item in arguments], standalone_mode=False)
    listener.join()
    os.close(master)
    return code, b"".join(shown).decode()


def test_a_terminal_shows_files_and_bars(rig, no_figures, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.csv").write_text("sigma_x,fx,fz\n")
    (tmp_path / "fit.toml").write_text(FAST + "max_steps = 200\n")
    arguments = ("fit", "rig.csv", "bad.csv", "--config", "fit.toml")
    code, shown = on_terminal(monkeypatch, *arguments)
    assert code == 3
    first, second = shown.index("file 1 of 2: rig.csv"), shown.index("file 2 of 2: bad")
    assert first < shown.index("posterior") < shown.index("steps, R-hat") < second
    assert "━" in shown and "bad.csv: there are no data rows" in shown
    assert shown.rindex("\x1b[?25h") > shown.rindex("\x1b[?25l")  # the cursor is back
    printed = capsys.readouterr().out
    assert "file 1 of 2" not in printed and "SUMMARY" in printed
    assert content(tmp_path / "rig")["posterior"]["steps"] == 200


def test_no_bars_are_shown_without_a_terminal(run, no_figures, rig, tmp_path):
    write(tmp_path / "wet.csv", mu=0.7, seed=2)
    result = run("fit", rig, "wet.csv", "--config", "fit.toml", "--no-posterior")
    assert result.stderr == ""


def test_progress_without_a_terminal_is_printed_as_lines(monkeypatch, capsys):
    """One line soon, then rarely; none at the start."""
    now = [100.0]
    monkeypatch.setattr(options.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(options, "has_terminal", lambda: False)
    with options.progress_bar("posterior") as progress:
        progress(0.0, "nothing yet")
        for second in range(1, 25):
            now[0] = 100.0 + second
            progress(second / 40, f"step {second}")
    assert capsys.readouterr().err.splitlines() == [
        "posterior: 12 %, step 5",
        "posterior: 38 %, step 15",
    ]
