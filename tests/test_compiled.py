"""Programs cached on disk give the same numbers, and are really used."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tirefit import compiled as module
from tirefit.compiled import compiled, keep_programs_in, release_programs


@pytest.fixture
def directory(tmp_path):
    keep_programs_in(tmp_path)
    yield tmp_path
    keep_programs_in(None)


def counted(traces):
    @compiled(static=("power",))
    def scaled(x, factor, power):
        traces.append(power)
        return {"value": factor * x**power}

    return scaled


def test_a_cached_program_is_not_traced_again(directory):
    traces = []
    x = np.linspace(0, 1, 5)
    first = counted(traces)(x, 2.0, power=3)["value"]
    assert traces == [3] and len(list(directory.iterdir())) == 1
    again = counted(traces)(x, 2.0, power=3)["value"]
    assert traces == [3]
    np.testing.assert_allclose(first, 2 * x**3, rtol=1e-15)
    np.testing.assert_array_equal(first, again)


SOLVED = """
import sys
import jax.numpy as jnp, numpy as np
from tirefit.compiled import compiled, keep_programs_in
keep_programs_in(sys.argv[1])
solved = compiled()(lambda a, b: jnp.linalg.solve(a, b) + jnp.cumsum(b))
print(solved(np.diag(np.float32([2, 4])), np.ones(2, np.float32)))
"""


def test_a_program_of_lapack_runs_in_another_process_whatever_jax_keeps(tmp_path):
    of_jax = {
        "JAX_COMPILATION_CACHE_DIR": str(tmp_path / "jax"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    }
    line = [sys.executable, "-c", SOLVED, str(tmp_path / "kept")]
    for after in ("removed", "kept", "kept"):
        done = subprocess.run(line, env=os.environ | of_jax, capture_output=True, text=True)
        assert (done.returncode, done.stdout) == (0, "[1.5  2.25]\n"), done.stderr
        (program,) = (tmp_path / "kept").iterdir()
        if after == "removed":  # as where the sources changed, but not this program
            program.unlink()


def test_static_arguments_shapes_and_types_give_other_programs(directory):
    traces = []
    function = counted(traces)
    for x, power in [(np.ones(3), 2), (np.ones(4), 2), (np.ones(3), 3), (1.0, 2)]:
        np.testing.assert_allclose(function(x, 1.0, power)["value"], np.ones_like(x))
    assert traces == [2, 2, 3, 2] and len(list(directory.iterdir())) == 4


def test_other_sources_give_other_programs(directory, monkeypatch):
    traces = []
    counted(traces)(np.ones(3), 1.0, 2)
    monkeypatch.setattr(module, "_sources", lambda: b"edited")
    counted(traces)(np.ones(3), 1.0, 2)
    assert traces == [2, 2]


def test_a_program_depends_on_all_sources_below_the_report(monkeypatch):
    from tests.test_layers import LAYERS

    highest = LAYERS["vehicle"]
    assert set(module._ABOVE) == {name for name, layer in LAYERS.items() if layer > highest}


def test_another_device_gives_another_program(directory, monkeypatch):
    traces = []
    counted(traces)(np.ones(3), 1.0, 2)
    monkeypatch.setattr(module, "_device", lambda: "gpu H200")
    counted(traces)(np.ones(3), 1.0, 2)
    assert traces == [2, 2] and len(list(directory.iterdir())) == 2


def test_the_least_recently_used_programs_are_removed(directory, monkeypatch):
    monkeypatch.setattr(module, "_MOST_PROGRAMS", 2)
    traces = []
    for age, size in ((30, 1), (20, 2)):
        counted(traces)(np.ones(size), 1.0, 2)
        newest = max(directory.iterdir(), key=lambda path: path.stat().st_mtime)
        os.utime(newest, (newest.stat().st_mtime - age,) * 2)
    counted(traces)(np.ones(1), 1.0, 2)  # used again: now it is the newer one
    counted(traces)(np.ones(3), 1.0, 2)
    assert len(list(directory.iterdir())) == 2 and len(traces) == 3
    counted(traces)(np.ones(1), 1.0, 2)
    assert len(traces) == 3
    counted(traces)(np.ones(2), 1.0, 2)
    assert len(traces) == 4


def test_a_damaged_file_is_replaced(directory):
    traces = []
    counted(traces)(np.ones(3), 1.0, 2)
    (file,) = directory.iterdir()
    whole = file.read_bytes()
    file.write_bytes(whole[:50])
    assert counted(traces)(np.ones(3), 3.0, 2)["value"][0] == 3.0
    assert traces == [2, 2] and file.read_bytes()[:50] == whole[:50]
    assert len(file.read_bytes()) > 50


def test_a_brief_program_is_compiled_without_options(directory, monkeypatch):
    def doubled(x):
        return 2 * x

    x = np.arange(3.0)
    np.testing.assert_array_equal(compiled(brief=True)(doubled)(x), 2 * x)
    # Only a program that gets the options can refuse them.
    monkeypatch.setattr(module, "_PLAINLY", {"xla_no_such_option": True})
    np.testing.assert_array_equal(compiled()(doubled)(x), 2 * x)
    with pytest.raises(RuntimeError, match="xla_no_such_option"):
        compiled(brief=True)(doubled)(x)


def test_within_a_trace_it_is_an_ordinary_function(directory):
    function = counted([])
    slope = jax.grad(lambda x: jnp.sum(function(x, 1.0, 3)["value"]))(jnp.array([2.0]))
    np.testing.assert_allclose(slope, [12.0])
    assert list(directory.iterdir()) == []


def test_an_unwritable_directory_is_no_error(tmp_path):
    (tmp_path / "file").write_text("in the way")
    keep_programs_in(tmp_path / "file")
    try:
        assert counted([])(np.ones(2), 1.0, 2)["value"].tolist() == [1.0, 1.0]
    finally:
        keep_programs_in(None)


@pytest.mark.long
@pytest.mark.skipif(not os.path.exists("/proc/self/maps"), reason="no /proc here")
def test_programs_are_released_above_the_memory_limit(directory):
    def mappings():
        with open("/proc/self/maps", "rb") as file:
            return sum(1 for _ in file)

    x = np.linspace(0, 1, 5)
    kept = [counted([]) for _ in range(20)]
    before = [scaled(x, 2.0, power=k)["value"] for k, scaled in enumerate(kept)]
    held = mappings()
    assert not release_programs(most=held + 1000)
    assert release_programs(most=100)
    # Each program held at least a mapping for its code.
    assert mappings() <= held - len(kept)
    for k, scaled in enumerate(kept):
        np.testing.assert_array_equal(scaled(x, 2.0, power=k)["value"], before[k])
