"""Full disks, folders that are read-only or vanish, two processes in one folder.

The system does the damage: a largest size of files (a quota), permissions, a file
system of its own, locks; nothing is replaced in the package.
"""

import ctypes
import json
import os
import resource
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path

import pytest
from test_cli_brake import QUICK
from test_cli_diagnose import LOADS, READ, WITHOUT
from test_cli_diagnose import write as write_sweeps
from test_cli_fit import FAST, write

from fits.fuzz.kinds import log_toml, short_log
from tirefit.cli import output
from tirefit.cli.options import complain, say
from tirefit.cli.output import staged
from tirefit.diagnosis import diagnose as engine

LOG = ("sigma_x,fx,fz,v,time", *(f"{0.0005 * k},{50 * k},4000,20,{k / 100}" for k in range(60)))

INTO_FOLDERS = {
    "fit": ("fit", "rig.csv", "--config", "fit.toml", "--no-posterior"),
    "convert": ("convert", "--magic-formula", "10,1.9,1,0.97", "--loads", "4000"),
    "diagnose": ("diagnose", "one.csv", *READ, *WITHOUT),
    "estimate": ("estimate", "log.csv", "--method", "slip-slope"),
    "brake": ("brake", "--tire", "brush", "--controller", "abs", *QUICK),
}
"""Commands that write folders, their modules, and a word of their reports."""
MODULES = {
    name: import_module(f"tirefit.cli.commands.{'fit_one' if name in ('fit', 'convert') else name}")
    for name in INTO_FOLDERS
}
REPORTS = {
    "fit": "VERDICT",
    "convert": "VERDICT",
    "diagnose": "HOW FAR THE GAP SHRINKS",
    "estimate": "ESTIMATES",
    "brake": "BRAKING",
}

INTO_FILES = {
    "predict": ("predict", "brush", "rig.csv"),
    "simulate": ("simulate", "rig", "--truth", "truth.csv"),
    "derive": ("derive", "drive.csv", "--vehicle", "car.toml"),
}


@pytest.fixture
def inputs(run, tmp_path):
    (tmp_path / "fit.toml").write_text(FAST)
    (tmp_path / "log.csv").write_text("\n".join(LOG) + "\n")
    (tmp_path / "drive.csv").write_bytes(short_log())
    (tmp_path / "car.toml").write_bytes(log_toml())
    write(tmp_path / "rig.csv")
    write_sweeps(tmp_path / "one.csv", low=0.002, loads=LOADS[1:2])
    return sorted(path.name for path in tmp_path.iterdir())


@contextmanager
def files_of_at_most(size):
    """A quota: writing more into a file fails, as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    # Python would store the first part of a module's code and fail to load it later.
    stores, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    try:
        yield
    finally:
        sys.dont_write_bytecode = stores
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def cache_of_one(function):
    """The function, which returns its first result at every further call."""
    made = []

    def first(*given, **settings):
        made.extend([] if made else [function(*given, **settings)])
        return made[0]

    return first


def there(folder):
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("name", INTO_FOLDERS)
def test_a_full_folder_is_named_and_the_report_printed(
    run, unrendered, inputs, tmp_path, monkeypatch, name
):
    @contextmanager
    def with_quota(directory, *rest):
        with files_of_at_most(64), staged(directory, *rest) as folder:
            yield folder

    monkeypatch.setattr(engine, "diagnose", cache_of_one(engine.diagnose))
    (tmp_path / "o").mkdir()
    (tmp_path / "o" / "notes.txt").write_text("mine")
    with monkeypatch.context() as patch:
        for module in (MODULES[name], output):
            patch.setattr(module, "staged", with_quota, raising=False)
        full = run(*INTO_FOLDERS[name], "--out", "o", exit_code=2)
    assert REPORTS[name] in full.stdout and "wrote" not in full.stdout
    assert full.stderr.startswith("error:\n  o/")
    cause = ": cannot be written: File too large; o is as it was before"
    assert cause in full.stderr
    assert "make room" in full.stderr and there(tmp_path / "o") == ["notes.txt"]


def test_one_full_folder_does_not_stop_the_other_files(run, unrendered, inputs, tmp_path):
    write(tmp_path / "wet.csv", mu=0.7, seed=2)
    (tmp_path / "o" / "rig" / "fit.png").mkdir(parents=True)
    files = ("fit", "rig.csv", "wet.csv", "--config", "fit.toml", "--no-posterior")
    result = run(*files, "--out", "o", exit_code=2)
    assert "o/rig/fit.png: cannot be written: there is a folder" in result.stderr
    assert result.stdout.count("VERDICT") == 2
    assert there(tmp_path / "o" / "rig") == ["fit.png"]
    assert "fit.json" in there(tmp_path / "o" / "wet")


@pytest.mark.parametrize("name", INTO_FILES)
def test_a_failed_write_leaves_the_file_unchanged(run, inputs, tmp_path, name):
    with files_of_at_most(64):
        result = run(*INTO_FILES[name], "--out", "o.csv", exit_code=2)
        assert "File too large; nothing was written\n" in result.stderr
        assert ("samples kept" in result.stdout) == (name == "derive")  # its report
        assert there(tmp_path) == inputs
    run(*INTO_FILES[name], "--out", "o.csv")  # a command replaces only files of its own
    before = {path: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()}
    with files_of_at_most(64):
        result = run(*INTO_FILES[name], "--out", "o.csv", exit_code=2)
    assert "File too large; it is as it was before\n" in result.stderr
    assert before == {path: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()}
    assert {*there(tmp_path)} >= {*inputs, "o.csv"}


# --- permissions ----------------------------------------------------------------


class _Header(ctypes.Structure):
    _fields_ = [("version", ctypes.c_uint32), ("pid", ctypes.c_int)]


def _give_up_privileges():
    """Removes from this thread the privileges of root over permissions."""
    header, none = _Header(0x20080522, 0), (ctypes.c_uint32 * 6)()
    if ctypes.CDLL(None, use_errno=True).capset(ctypes.byref(header), none):
        raise OSError(ctypes.get_errno(), "capset")


def as_anyone(action):
    """The result of the action in a thread that must respect permissions."""
    with ThreadPoolExecutor(1) as thread:
        if os.geteuid() == 0:
            thread.submit(_give_up_privileges).result()
        return thread.submit(action).result()


@pytest.fixture
def read_only(tmp_path):
    if not sys.platform.startswith("linux"):
        pytest.skip("root keeps to permissions only where its privileges can be taken")
    folder = tmp_path / "sealed"
    folder.mkdir()
    folder.chmod(0o555)
    yield folder
    folder.chmod(0o755)


@pytest.mark.parametrize("name", [*INTO_FOLDERS, "file " + "predict"])
def test_a_read_only_folder_is_reported_before_the_work(run, inputs, read_only, name):
    words = INTO_FOLDERS.get(name) or INTO_FILES[name.removeprefix("file ")]
    said = as_anyone(lambda: run(*words, "--out", "sealed/o", exit_code=2))
    assert "sealed/o" in said.stderr and "permission" in said.stderr.lower()
    assert said.stdout == "" and there(read_only) == []


# --- a tiny file system -----------------------------------------------------------

FULL = """
import json, os, subprocess, sys
from pathlib import Path

from typer.testing import CliRunner
from tirefit.cli.commands import app

disk = Path("disk")
disk.mkdir()
made = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1m", "none", disk])
if made.returncode:
    sys.exit(77)

def size(of):
    subprocess.run(["mount", "-o", f"remount,size={of}", disk], check=True)

def run(*words):
    result = CliRunner().invoke(app, words)
    if not isinstance(result.exception, SystemExit | None):
        raise result.exception
    there = {p.name: p.stat().st_size for p in disk.rglob("*") if p.is_file()}
    said.append([result.exit_code, result.stdout, result.stderr, there])

said = []
fit = ("fit", "rig.csv", "--config", "fit.toml", "--out", "disk/o")
for of in ("300k", "20m"):
    size(of)
    run(*fit)
Path("said.json").write_text(json.dumps(said))
"""


@pytest.mark.long
def test_a_fit_on_a_full_disk_keeps_the_files_written_before(inputs, tmp_path):
    """Disk too small for the posterior; then large enough."""
    if shutil.which("unshare") is None:
        pytest.skip("no unshare: no file system of our own")
    short = "walkers = 8\nmax_steps = 200\n"
    (tmp_path / "fit.toml").write_text(FAST.replace("walkers = 16\n", short))
    program = ["unshare", "-rm", sys.executable, "-c", FULL]
    done = subprocess.run(program, capture_output=True, text=True)
    if done.returncode == 77 or "unshare failed" in done.stderr:
        pytest.skip(f"no file system of our own: {done.stderr.strip()}")
    assert done.returncode == 0, done.stderr
    least, whole = json.loads((tmp_path / "said.json").read_text())
    code, report, error, kept = least
    assert code == 2 and "VERDICT" in report and "remedy: make room" in error
    assert ": cannot be written: No space left on device; " in error
    assert "fit.json" in kept and "posterior.nc" not in kept  # the least squares
    assert whole[0] == 4 and {"posterior.nc", "corner.png"} <= set(whole[3])
    result = report.rpartition("PARAMETERS")[2].strip()
    assert result in whole[1]


# --- outputs that take nothing ----------------------------------------------------

needs_full = pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")


@needs_full
@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_full_standard_output_is_reported(inputs, unbuffered):
    """Also for output before any command runs; a full stderr keeps the exit code. Python
    writes buffered output again at its end, which must not change the exit code."""
    program = [sys.executable, "-m", "tirefit"]
    env = {**os.environ, "PYTHONUNBUFFERED": unbuffered}
    with open("/dev/full", "w") as full:
        said = {"stdout": full, "stderr": subprocess.PIPE, "text": True, "env": env}
        helped = subprocess.run([*program, "--help"], **said)
        looked = subprocess.run([*program, "inspect", "rig.csv", "--no-gate"], **said)
        silent = subprocess.run([*program, "inspect", "none.csv"], stderr=full, env=env)
    assert (helped.returncode, looked.returncode, silent.returncode) == (2, 2, 3)
    assert helped.stderr == "error: output: No space left on device\n"
    assert "standard output: cannot be written: No space left" in looked.stderr
    assert "Traceback" not in looked.stderr


def test_terminal_control_characters_are_not_printed(capsys):
    say("red \x1b[31m and\tno\r\nmore\x07")
    complain("\x9b2J")
    said = capsys.readouterr()
    assert said.out == "red \ufffd[31m and\tno\ufffd\nmore\ufffd\n"
    assert said.err == "\ufffd2J\n"
