"""Commands start whatever the environment says, or name the variable that is wrong."""

import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import jax
import pytest

from tirefit.cli.start import _store_programs

ROOT = Path(__file__).parents[2]


def test_compiled_programs_are_stored_if_possible(tmp_path, monkeypatch):
    stored = {}
    config = SimpleNamespace(update=stored.__setitem__)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "new"))
    assert _store_programs(config) is None
    assert stored["jax_compilation_cache_dir"] == str(tmp_path / "new" / "tirefit")
    stored.clear()
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert _store_programs(config) is None and stored == {}


@pytest.mark.parametrize(
    "given",
    [
        "JAX_PLATFORMS=nonsense",
        pytest.param("JAX_PLATFORMS=cuda", marks=pytest.mark.long),
        pytest.param("JAX_ENABLE_X64=nonsense", marks=pytest.mark.long),
        pytest.param("JAX_NUMPY_RANK_PROMOTION=nonsense", marks=pytest.mark.long),
        pytest.param("EQX_ON_ERROR=nonsense", marks=pytest.mark.long),
    ],
)
def test_a_variable_that_jax_does_not_accept_is_named(given, tmp_path):
    name, _, value = given.partition("=")
    line = [sys.executable, "-m", "tirefit", "simulate", "rig", "--out", str(tmp_path / "out.csv")]
    environment = os.environ | {name: value}
    if "cuda" in given and any(device.platform == "gpu" for device in jax.devices()):
        pytest.skip("there is a GPU")
    done = subprocess.run(line, env=environment, capture_output=True, text=True)
    assert done.returncode == 2 and done.stderr.startswith("error:\n  "), done.stderr
    assert "Traceback" not in done.stderr
    assert name in done.stderr.partition("remedy: correct or unset ")[2]


@pytest.mark.long
def test_a_variable_without_a_meaning_here_changes_nothing(tmp_path):
    """Figures are written to files, and NaN is no fault of a fit."""
    shipped = ROOT / "tirefit" / "samples" / "circles.csv"
    line = [sys.executable, "-m", "tirefit", "fit", str(shipped), "--no-posterior", "--out"]
    others = {
        "MPLBACKEND": "nonsense",
        "MPLCONFIGDIR": str(tmp_path / "absent"),
        "TMPDIR": str(tmp_path / "absent"),
        "TERM": "nonsense",
        "COLUMNS": "abc",
        "LC_ALL": "C",
        "PYTHONIOENCODING": "ascii:backslashreplace",
        "OMP_NUM_THREADS": "nonsense",
    }
    texts = []
    for given in ({}, others):
        out = tmp_path / str(len(texts))
        environment = os.environ | given
        done = subprocess.run([*line, str(out)], env=environment, capture_output=True, text=True)
        assert done.returncode in (0, 4, 5) and "Traceback" not in done.stderr, done.stderr
        texts.append(json.loads((out / "fit.json").read_text(encoding="utf-8"))["parameters"])
    assert texts[0] == texts[1]
