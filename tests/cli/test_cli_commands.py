"""``predict``, ``inspect``, ``models``, and what starting up imports."""

import csv
import json
import os
import subprocess
import sys

import numpy as np
import pytest

from tirefit.models import MODELS
from tirefit.names import MODEL_NAMES

FZ = 4000.0
PARABOLIC = {"cpa2": 5e4, "mu": 1.0}


def parabolic(slip):
    x = np.clip(slip * 5e4 / (1.5 * FZ), -1, 1)
    return FZ * (3 * x - 3 * x * abs(x) + x**3)


def rows_of(path):
    with open(path) as file:
        rows = list(csv.DictReader(file))
    return {k: np.array([float(row[k]) for row in rows]) for k in rows[0]}


def write(path, header, *columns):
    lines = [
        header,
        *(",".join(f"{v:.12g}" for v in row) for row in zip(*columns, strict=True)),
    ]
    path.write_text("\n".join(lines) + "\n")


SLIP = np.linspace(-0.15, 0.3, 31)
SETS = ("--set", "cpa2=5e4", "--set", "mu=1.0")


def test_named_model_with_given_parameters(run, tmp_path):
    write(tmp_path / "data.csv", "sigma_x,fz", SLIP, np.full(31, FZ))
    result = run("predict", "brush", "data.csv", *SETS, "--out", "f.csv")
    assert "wrote f.csv: 31 rows" in result.stdout
    np.testing.assert_allclose(rows_of("f.csv")["fx"], parabolic(SLIP), atol=1e-6)


def test_forces_come_in_the_convention_and_unit_of_the_file(run, tmp_path):
    # ISO-W: driving positive, so slip and force both turn around; kappa in per cent.
    kappa = SLIP / (1 + SLIP)
    write(tmp_path / "iso.csv", "kappa,fz", -100 * kappa, np.full(31, FZ / 1000))
    options = ("--convention", "iso-w", "--unit", "kappa=%", "--unit", "fz=kN",
               "--unit", "fx=kN")  # fmt: skip
    run("predict", "brush", "iso.csv", *SETS, *options, "--out", "f.csv")
    np.testing.assert_allclose(
        rows_of("f.csv")["fx"], -parabolic(SLIP) / 1000, atol=1e-9
    )


def test_fit_of_an_iso_file_predicts_it_back(run, tmp_path):
    generator = np.random.default_rng(3)
    slip = generator.uniform(-0.2, 0.2, 400)
    force = parabolic(slip) + 40 * generator.standard_normal(400)
    load = np.full(400, FZ)
    write(tmp_path / "iso.csv", "sigma_x,fx,fz", -slip, -force, load)
    (tmp_path / "fit.toml").write_text(
        "solver = 'gauss-newton'\n[noise]\nfx = 40\n[data]\nconvention = 'iso-w'\n"
    )
    run("fit", "iso.csv", "--config", "fit.toml", "--no-posterior", "--out", "o")
    mu = json.loads((tmp_path / "o/fit.json").read_text())["parameters"]["mu"]
    assert abs(mu["value"] - 1) < 4 * mu["std"]
    run("predict", "o/fit.json", "iso.csv", "--convention", "iso-w", "--out", "f.csv")
    found = rows_of("f.csv")
    assert list(found) == ["fx", "fx_std"]
    np.testing.assert_allclose(found["fx"], -parabolic(slip), atol=25)
    residual = (-force - found["fx"]) / found["fx_std"]
    np.testing.assert_allclose(residual.std(), 1.0, atol=4 / np.sqrt(800))
    assert (found["fx_std"] > 40).all()


WRONG = {
    "unknown model": (["brsh", "d.csv"], 2, "did you mean brush"),
    "unknown parameter": (["brush", "d.csv", "--set", "nu=1"], 2, "no parameter 'nu'"),
    "outside bounds": (["brush", "d.csv", "--set", "mu=9"], 2, "outside its bounds"),
    "not a number": (["brush", "d.csv", "--set", "mu=x"], 2, "not a number"),
    "no value": (["brush", "d.csv", "--set", "mu"], 2, "--set NAME=VALUE"),
    "no data": (["brush", "none.csv"], 3, "none.csv"),
    "no such fit": (["none.json", "d.csv"], 3, "none.json"),
    "set on a fit": (["none.json", "d.csv", "--set", "mu=1"], 2, "--set"),
    "speed needed": (["brush-n", "d.csv"], 3, "v (speed, m/s)"),
}


@pytest.mark.parametrize(("arguments", "code", "said"), WRONG.values(), ids=WRONG)
def test_wrong_predictions(run, tmp_path, arguments, code, said):
    write(tmp_path / "d.csv", "sigma_x,fz", SLIP, np.full(31, FZ))
    result = run("predict", *arguments, "--out", "f.csv", exit_code=code)
    assert said in result.stderr and "Traceback" not in result.stderr
    assert not (tmp_path / "f.csv").exists()


def test_inspect_as_json(run, tmp_path):
    write(tmp_path / "d.csv", "sigma_x,fx,fz", SLIP, parabolic(SLIP), np.full(31, FZ))
    content = json.loads(run("inspect", "d.csv", "--json").stdout)
    assert "31" in json.dumps(content)
    text = run("inspect", "d.csv").stdout
    assert "sigma_x" in text and "braking" in text


def test_inspect_goes_on_after_a_bad_file(run, tmp_path):
    write(tmp_path / "d.csv", "sigma_x,fx,fz", SLIP, parabolic(SLIP), np.full(31, FZ))
    result = run("inspect", "none.csv", "d.csv", exit_code=3)
    assert "none.csv" in result.stderr and "d.csv" in result.stdout


def test_models_as_json(run):
    content = json.loads(run("models", "--json").stdout)
    text = json.dumps(content)
    assert all(f'"{name}"' in text for name in MODELS)
    listed = run("models").stdout
    assert all(name in listed for name in MODELS)


def test_version(run):
    from tirefit import __version__

    assert run("version").stdout.strip() == __version__


def test_no_command_shows_the_help(run):
    result = run("--help")
    for word in ("fit", "inspect", "predict", "derive", "models", "not identified"):
        assert word in result.stdout


@pytest.mark.parametrize("arguments", [["--help"], ["fit", "--help"]])
def test_help_imports_nothing_heavy(arguments):
    program = (
        "import sys\n"
        f"sys.argv = ['tirefit', *{arguments!r}]\n"
        "from tirefit.cli import app\n"
        "try:\n    app()\n"
        "except SystemExit as end:\n    assert not end.code\n"
        "heavy = {'jax', 'matplotlib', 'numpy', 'scipy', 'emcee', 'xarray'}\n"
        "print('HEAVY', sorted(heavy & set(sys.modules)))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert "HEAVY []" in done.stdout and "Usage" in done.stdout


def test_python_dash_m_starts_it():
    done = subprocess.run(
        [sys.executable, "-m", "tirefit", "version"], capture_output=True, text=True
    )
    assert done.returncode == 0 and done.stderr == ""


def test_completion_knows_every_model_without_importing_one():
    assert sorted(MODEL_NAMES) == sorted(MODELS)


def test_completing_a_model_imports_no_jax():
    program = (
        "import sys\n"
        "from tirefit.cli import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "print('jax' in sys.modules, 'numpy' in sys.modules)"
    )
    environment = os.environ | {
        "_TIREFIT_COMPLETE": "complete_bash",
        "COMP_WORDS": "tirefit fit --model brush-dm",
        "COMP_CWORD": "3",
    }
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=environment, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert "False False" in done.stdout
