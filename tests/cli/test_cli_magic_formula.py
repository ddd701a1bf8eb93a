"""``tirefit fit --model mf61`` writes ``fit.tir`` and ``fit.json``."""

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest
from test_cli_damage import cache_of_one
from test_cli_tutorials import undocumented

from tirefit.data.tir.tir import read_tir
from tirefit.fitting.mf import fit as mf_fit
from tirefit.models import TireInputs, forces
from tirefit.models.mf import mf_tire

FOLDER = Path(__file__).parents[1] / "data" / "tir"
MF61 = FOLDER / "mfeval_julia/MagicFormula61_Parameters.tir"
LOADS = (2500.0, 5000.0, 7500.0)


@pytest.fixture(scope="module")
def sweeps(tmp_path_factory):
    """CSV of braking and driving sweeps at three loads, noise of 1 % of the load."""
    tir = read_tir(MF61)
    slip = np.tile(np.linspace(-0.2, 0.3, 60), len(LOADS))
    fz = np.repeat(LOADS, 60)
    fx = np.asarray(forces(mf_tire("6.1", tir.numbers), TireInputs(slip, fz=fz)).fx)
    fx = fx + 0.01 * fz * np.random.default_rng(0).standard_normal(len(fz))
    path = tmp_path_factory.mktemp("rig") / "fx.csv"
    table = np.c_[slip, fz, fx, np.repeat(np.arange(3), 60)]
    np.savetxt(path, table, delimiter=",", header="sigma_x,fz,fx,run", comments="")
    return path


def test_a_fit_writes_a_tir_that_predicts(run, unrendered, sweeps, monkeypatch):
    monkeypatch.setattr(mf_fit, "fit_magic_formula", cache_of_one(mf_fit.fit_magic_formula))
    command = ("fit", sweeps, "--model", "mf61", "--part", "fx", "--out", "out")
    said = run(*command).stdout
    assert "VERDICT: converged" in said and "GUARDS" in said
    assert "camber squared" not in said and len(said.splitlines()) <= 45
    made = sorted(path.name for path in Path("out").iterdir())
    assert {"fit.png", "residuals.png"} <= {*made}
    assert sorted(re.search(r"^wrote to out: (.*)$", said, re.M)[1].split(", ")) == made
    said = run(*command, "--full").stdout
    assert "camber squared" in said and "held" in said
    written = read_tir("out/fit.tir")
    assert written.version == "6.1" and written.numbers["FNOMIN"] == 5000.0
    assert "shape factor of F_x; fitted +- " in written.text
    assert written.numbers["FZMIN"] == 2500.0 and written.numbers["FZMAX"] == 7500.0
    content = json.loads(Path("out/fit.json").read_text())
    assert undocumented(Path("out/fit.json")) == []
    friction = content["coefficients"]["PDX1"]
    assert friction["origin"] == "fitted" and friction["std"] < 0.02
    assert friction["value"] == pytest.approx(written.numbers["PDX1"], rel=1e-12)
    assert content["coefficients"]["PPX1"]["origin"] == "held"
    assert {guard["name"] for guard in content["guards"]} >= {"stiffness", "peak"}
    run("predict", "out/fit.json", sweeps, "--out", "p.csv")
    with open("p.csv") as file:
        rows = list(csv.DictReader(file))
    with open(sweeps) as file:
        measured = np.array([float(row["fx"]) for row in csv.DictReader(file)])
    predicted, std = (np.array([float(row[name]) for row in rows]) for name in ("fx", "fx_std"))
    assert 0.9 < np.mean(np.abs(measured - predicted) < 1.96 * std) <= 1.0
    # The band of a measurement: noise of 1 % of the load, and the coefficients'.
    share = std / np.repeat(LOADS, 60)
    assert 0.008 < share.min() and share.max() < 0.02


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--model", "brush", "--part", "fx"), "--part without --model"),
        (("--like", "other.tir"), "--like without --model mf52, mf61, mf62"),
        (("--model", "mf61", "--part", "fz"), "known: fx, fy, mz, all"),
        (("--model", "mf61", "--solver", "jaxopt"), "--solver with --model mf61"),
        (("--model", "mf61", "--jobs", "2"), "--jobs with --model mf61"),
        (("--model", "mf61", "--resume", "--force", "fx"), "--force, --resume"),
    ],
)
def test_options_of_other_models_are_refused(run, sweeps, options, said):
    assert said in run("fit", sweeps, *options, exit_code=2).stderr


def test_other_commands_refuse_a_whole_magic_formula(run, sweeps):
    ended = run("predict", "mf61", sweeps, "--out", "p.csv", exit_code=2)
    assert "tirefit fit --model mf61" in ended.stderr
