"""Compiled programs are stored in a folder of the user's own, and nothing else is run from it."""

import os
import subprocess
import sys
from functools import partial

import jax
import numpy as np
import pytest

from tirefit.compiled import BRIEF, release_programs, remove_oldest, why_unsafe

ONLY_POSIX = pytest.mark.skipif(not hasattr(os, "getuid"), reason="owners of files are POSIX")

COMMAND = """
import sys
from tirefit.cli.options import start_jax
start_jax()
import jax, numpy as np
twice, thrice = (jax.jit(lambda x, k=k: (k * x, x.sum())[: k - 1]) for k in (2, 3))
print(float(twice(np.ones(3))[0][0]), float(thrice(np.ones(3))[0][0]))
"""
"""Two programs of the same arguments and other results, as a command compiles them."""


@pytest.fixture
def run(tmp_path):
    """Runs the programs in another process that stores them in ``tmp_path``; its errors."""

    def runs():
        environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path)}
        environment.pop("JAX_COMPILATION_CACHE_DIR", None)
        line = [sys.executable, "-c", COMMAND]
        done = subprocess.run(line, env=environment, capture_output=True, text=True)
        assert (done.returncode, done.stdout) == (0, "2.0 3.0\n"), done.stderr
        return done.stderr

    return runs


def entries(folder):
    return sorted(folder.glob("*-cache"))


def test_a_program_is_stored_for_the_next_process_in_a_folder_of_the_user_alone(run, tmp_path):
    assert run() == ""
    folder = tmp_path / "tirefit"
    assert os.name == "nt" or folder.stat().st_mode & 0o777 == 0o700
    before = {path: path.stat().st_mtime_ns for path in entries(folder)}
    assert len(before) >= 2 and run() == ""
    assert {path: path.stat().st_mtime_ns for path in entries(folder)} == before


def test_a_damaged_program_is_compiled_again(run, tmp_path):
    run()
    one, other = (path for path in entries(tmp_path / "tirefit") if "lambda" in path.name)
    one.write_bytes(one.read_bytes()[:50])
    other.write_bytes(b"")
    assert run() == ""  # and the numbers are right


@ONLY_POSIX
@pytest.mark.parametrize("mode", [0o777, 0o775, 0o722])
def test_a_folder_that_others_can_write_to_is_not_used(mode, run, tmp_path):
    folder = tmp_path / "tirefit"
    folder.mkdir()
    folder.chmod(mode)
    said = run()
    assert said.count("\n") == 1 and "other users can write to it" in said
    assert str(folder) in said and "XDG_CACHE_HOME" in said
    assert list(folder.iterdir()) == []


@ONLY_POSIX
def test_a_folder_of_another_user_is_unsafe(tmp_path, monkeypatch):
    tmp_path.chmod(0o755)
    assert why_unsafe(tmp_path) is None
    monkeypatch.setattr(os, "getuid", lambda: tmp_path.stat().st_uid + 1)
    assert why_unsafe(tmp_path) == "it belongs to another user"


def test_only_entries_are_removed_and_the_oldest_first(tmp_path, monkeypatch):
    names = [f"jit_f-{k:064x}-cache" for k in range(4)]
    for k, name in enumerate(names):
        (tmp_path / name).write_bytes(b"x")
        os.utime(tmp_path / name, (k, k))
    (tmp_path / "mine").write_text("of the user")
    monkeypatch.setattr("tirefit.compiled._MOST_ENTRIES", 2)
    remove_oldest(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {*names[2:], "mine"}


def test_a_brief_program_gets_options_that_the_compiler_knows():
    def doubled(x):
        return 2 * x

    x = np.arange(3.0)
    brief = jax.jit(doubled, compiler_options=BRIEF)
    np.testing.assert_array_equal(brief(x), 2 * x)
    unknown = jax.jit(doubled, compiler_options={"xla_no_such_option": True})
    with pytest.raises(RuntimeError, match="xla_no_such_option"):
        unknown(x)


@pytest.mark.long
@pytest.mark.skipif(not os.path.exists("/proc/self/maps"), reason="no /proc here")
def test_programs_are_released_above_the_memory_limit():
    def mappings():
        with open("/proc/self/maps", "rb") as file:
            return sum(1 for _ in file)

    def scaled(x, factor, power):
        return factor * x**power

    x = np.linspace(0, 1, 5)
    kept = [jax.jit(partial(scaled, power=k)) for k in range(20)]
    before = [scaled(x, 2.0) for scaled in kept]
    held = mappings()
    assert not release_programs(most=held + 1000)
    assert release_programs(most=100)
    # Each program held at least a mapping for its code.
    assert mappings() <= held - len(kept)
    for scaled, value in zip(kept, before, strict=True):
        np.testing.assert_array_equal(scaled(x, 2.0), value)
