"""``predict``, ``inspect``, ``models``, and what starting up imports."""

import csv
import json
import os
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.main import get_command

from tirefit.cli.commands import COMMANDS, app
from tirefit.cli.commands.simulate import simulate
from tirefit.models import MODELS
from tirefit.names import MODEL_NAMES, effect_names

FZ = 4000.0
VEHICLE = Path(__file__).parents[2] / "fits" / "dart_jetracer" / "vehicle.toml"


def parabolic(slip):
    x = np.clip(slip * 5e4 / (1.5 * FZ), -1, 1)
    return FZ * (3 * x - 3 * x * abs(x) + x**3)


def rows_of(path):
    with open(path) as file:
        rows = list(csv.DictReader(file))
    return {k: np.array([float(row[k]) for row in rows]) for k in rows[0]}


def write(path, header, *columns):
    lines = [header, *(",".join(f"{v:.12g}" for v in row) for row in zip(*columns, strict=True))]
    path.write_text("\n".join(lines) + "\n")


SLIP = np.linspace(-0.15, 0.3, 31)
SETS = ("--set", "cpa2=5e4", "--set", "mu=1.0")


def test_predict_with_a_named_model_and_given_parameters(run, tmp_path):
    write(tmp_path / "data.csv", "sigma_x,fz", SLIP, np.full(31, FZ))
    result = run("predict", "brush", "data.csv", *SETS, "--out", "f.csv")
    assert "wrote f.csv: 31 rows" in result.stdout
    np.testing.assert_allclose(rows_of("f.csv")["fx"], parabolic(SLIP), atol=1e-6)


def test_predicted_forces_use_convention_and_unit_of_the_file(run, tmp_path):
    # ISO-W: driving positive, so slip and force both turn around; kappa in per cent.
    kappa = SLIP / (1 + SLIP)
    write(tmp_path / "iso.csv", "kappa,fz", -100 * kappa, np.full(31, FZ / 1000))
    options = ("--convention", "iso-w", "--unit", "kappa=%", "--unit", "fz=kN", "--unit", "fx=kN")
    run("predict", "brush", "iso.csv", *SETS, *options, "--out", "f.csv")
    np.testing.assert_allclose(rows_of("f.csv")["fx"], -parabolic(SLIP) / 1000, atol=1e-9)


def test_fit_of_an_iso_file_predicts_its_forces(run, no_figures, tmp_path):
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
    assert list(found) == ["sigma_x", "fz", "fx", "fx_std"]
    np.testing.assert_array_equal(found["sigma_x"], rows_of("iso.csv")["sigma_x"])
    np.testing.assert_allclose(found["fx"], -parabolic(slip), atol=25)
    residual = (-force - found["fx"]) / found["fx_std"]
    np.testing.assert_allclose(residual.std(), 1.0, atol=4 / np.sqrt(800))
    assert (found["fx_std"] > 40).all()


def test_predictions_are_written_with_the_inputs_to_plot_them(run, tmp_path):
    # Locked, spinning up and free, in per cent and driving positive; angle in degrees.
    slip = np.array([-100.0, -20.0, -0.1, 0.0, 10.0])
    (tmp_path / "d.csv").write_text(
        "run,Fx,slip [%],SA [deg],load / kN,t [ms]\n"
        + "".join(
            f"{name},9,{s},{a},4.2,{t}\n"
            for name, s, a, t in zip("aabbb", slip, slip / 50, range(5), strict=True)
        )
        + "b,9,x,0,4.2,5\n"
    )
    run(
        "predict", "brush", "d.csv", *SETS, "--column", "kappa=slip [%]", "--out",
        "f.csv", "--convention", "adapted-sae", "--constant", "v=20", "--mask-bad-rows",
    )  # fmt: skip
    with open(tmp_path / "f.csv") as file:
        rows = list(csv.DictReader(file))
    first = ["run", "t [ms]", "slip [%]", "SA [deg]", "load / kN", "v"]
    assert list(rows[0])[:6] == first and list(rows[0])[6:] == ["Fx", "fy", "mz"]
    assert [row["run"] for row in rows] == ["a", "a", "b", "b", "b", "b"]
    assert [float(row["slip [%]"]) for row in rows[:5]] == slip.tolist()
    assert [float(row["SA [deg]"]) for row in rows[:5]] == (slip / 50).tolist()
    assert {row["load / kN"] for row in rows} == {"4.2"}
    assert [float(row["t [ms]"]) for row in rows] == [0, 1, 2, 3, 4, 5]
    assert rows[5]["slip [%]"] == rows[5]["Fx"] == "" and rows[0]["Fx"] != ""


OUTPUTS = {
    "no folder": ("none/f.csv", "none/f.csv: there is no folder none"),
    "in a file": ("d.csv/f.csv", "d.csv/f.csv: there is no folder d.csv"),
    "a folder": (".", "is a folder, where a file is to be written"),
    "empty": ("", "'--out': it is empty"),
    "an input": ("d.csv", "d.csv: it is an input file ("),
}


@pytest.mark.parametrize(("out", "said"), OUTPUTS.values(), ids=OUTPUTS)
@pytest.mark.parametrize("command", ["predict", "derive"])
def test_unwritable_outputs_are_refused(run, tmp_path, command, out, said):
    write(tmp_path / "d.csv", "sigma_x,fz", SLIP, np.full(31, FZ))
    before = sorted(tmp_path.iterdir())
    arguments = ["brush", "d.csv"]
    if command == "derive":
        arguments = ["d.csv", "--vehicle", str(VEHICLE)]
    result = run(command, *arguments, "--out", out, exit_code=3 if out == "d.csv" else 2)
    assert said in result.stderr and "/." not in result.stderr
    assert sorted(tmp_path.iterdir()) == before


def test_data_options_have_the_same_meaning_in_every_command(run, no_figures, tmp_path):
    kappa = SLIP / (1 + SLIP)
    write(tmp_path / "d.csv", "a,b", -100 * kappa, -parabolic(SLIP) / 1000)
    (tmp_path / "fit.toml").write_text(
        "solver = 'gauss-newton'\n[noise]\nfx = 40\n[data]\nconvention = 'sae'\n"
        "[data.units]\nfx = 'N'\n[data.constants]\nfz = 4000\n"
    )
    options = (
        "--config", "fit.toml", "--column", "kappa=a", "--column", "fx=b",
        "--unit", "kappa=%", "--unit", "fx=kN", "--convention", "iso-w", "--slip",
        "kappa", "--constant", "v=20",
    )  # fmt: skip
    found = json.loads(run("inspect", "d.csv", "--json", "--no-gate", *options).stdout)
    largest = {column["name"]: column["max"] for column in found["columns"]}
    assert found["convention"] == "iso-w" and found["warnings"] == []
    np.testing.assert_allclose(
        [largest[name] for name in ("sigma_x", "fx", "fz", "v")],
        [0.3, parabolic(SLIP).max(), FZ, 20],
    )
    run("fit", "d.csv", "--no-posterior", "--out", "o", *options)
    record = json.loads((tmp_path / "o/fit.json").read_text())
    assert abs(record["parameters"]["mu"]["value"] - 1) < 1e-3
    assert record["data"]["convention"] == "iso-w"
    run("predict", "brush", "d.csv", *SETS, "--out", "f.csv", *options)
    predicted = rows_of("f.csv")
    np.testing.assert_allclose(predicted["b"], rows_of("d.csv")["b"], atol=1e-9)


def test_rows_without_a_prediction_are_listed(run, tmp_path):
    rows = [f"{0.01 * k},{'x' if k in (3, 7, 8, 9, 11) else FZ}" for k in range(31)]
    (tmp_path / "d.csv").write_text("\n".join(["sigma_x,fz", *rows]))
    how = ("--out", "f.csv", "--mask-bad-rows")
    said = run("predict", "brush", "d.csv", *SETS, *how).stderr
    assert "excluded, no force: row 5, column 'fz': 'x' is text" in said
    assert "excluded, no force: 5 rows in all" in said
    with open("f.csv") as file:
        forces = [row["fx"] for row in csv.DictReader(file)]
    assert len(forces) == 31 and forces.count("") == 5


WRONG = {
    "unknown model": (["brsh", "d.csv"], 2, "did you mean brush"),
    "unknown parameter": (["brush", "d.csv", "--set", "nu=1"], 2, "no parameter 'nu'"),
    "outside bounds": (["brush", "d.csv", "--set", "mu=9"], 2, "outside its bounds"),
    "not a number": (["brush", "d.csv", "--set", "mu=x"], 2, "not a valid number"),
    "no value": (["brush", "d.csv", "--set", "mu"], 2, "'--set': 'mu': write it as NAME=VALUE"),
    "no data": (["brush", "none.csv"], 3, "none.csv"),
    "no such fit": (["none.json", "d.csv"], 3, "none.json"),
    "set on a fit": (["none.json", "d.csv", "--set", "mu=1"], 2, "--set"),
    "speed needed": (["brush-n", "d.csv"], 3, "needs v (forward speed"),
    "no CSV": (["brush", "d.csv", "--out", "f.parquet"], 2, "the output is a CSV"),
}


@pytest.mark.parametrize(("arguments", "code", "said"), WRONG.values(), ids=WRONG)
def test_wrong_options_of_predict_are_refused(run, tmp_path, arguments, code, said):
    write(tmp_path / "d.csv", "sigma_x,fz", SLIP, np.full(31, FZ))
    result = run("predict", "--out", "f.csv", *arguments, exit_code=code)
    assert said in result.stderr and "Traceback" not in result.stderr
    assert not list(tmp_path.glob("f.*"))


def test_inspect_goes_on_after_a_bad_file(run, tmp_path):
    write(tmp_path / "d.csv", "sigma_x,fx,fz", SLIP, parabolic(SLIP), np.full(31, FZ))
    result = run("inspect", "none.csv", "d.csv", "--no-gate", exit_code=3)
    assert "none.csv" in result.stderr and "d.csv" in result.stdout


def test_version(run):
    from tirefit import __version__

    assert run("--version").stdout.strip() == f"tirefit {__version__}"


@cache
def modules_after(*arguments):
    """Names of the modules that a command has imported at its end, and its output."""
    program = (
        "import sys\n"
        f"sys.argv = ['tirefit', *{arguments!r}]\n"
        "from tirefit.cli.commands import app\n"
        "try:\n    app()\n"
        "except SystemExit as end:\n    assert not end.code\n"
        "print('LOADED', *sys.modules)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    said, _, modules = done.stdout.rpartition("LOADED ")
    return set(modules.split()), said


@pytest.mark.parametrize("arguments", [["--help"], ["fit", "--help"]])
def test_help_imports_nothing_heavy(arguments):
    modules, said = modules_after(*arguments)
    assert "typer" in modules and "Usage" in said
    assert not modules & {"jax", "matplotlib", "numpy", "scipy", "emcee", "xarray"}


def test_the_list_of_commands_imports_none_of_them():
    modules, _ = modules_after("--help")
    assert [m for m in modules if m.startswith("tirefit.cli.")] == ["tirefit.cli.commands"]


def test_the_list_of_commands_holds_the_beginning_of_their_own_help():
    listed = get_command(app).commands
    assert list(listed) == list(COMMANDS)
    for name, command in listed.items():
        paragraph = command.loaded().help.split("\n\n")[0]
        assert command.help == " ".join(paragraph.split()), name


def test_python_dash_m_starts_tirefit():
    done = subprocess.run(
        [sys.executable, "-m", "tirefit", "--version"], capture_output=True, text=True
    )
    assert done.returncode == 0 and done.stderr == ""


def test_completion_knows_every_model_without_importing_one():
    assert sorted(MODEL_NAMES) == sorted(MODELS)


def test_completion_knows_every_effect_without_importing_one():
    from tirefit.diagnosis.effects import EFFECTS

    assert effect_names() == [effect.id for effect in EFFECTS]


COMPLETED = {
    "fit --model brush-dm": {"brush-dm", "brush-dmn", "brush-dmns", "brush-dmh", "brush-dmhs"},
    "diagnose d.csv --model lug": {"lugre", "lugre-lumped"},
    "fit d.csv --convention i": {"iso-w"},
    "inspect d.csv --convention s": {"sae"},
    "fit d.csv --slip ka": {"kappa"},
    "fit d.csv --sampler im": {"importance"},
    "diagnose d.csv --without yaw": {"yaw_inertia"},
    "--vers": {"--version"},
}


def test_completing_imports_no_jax():
    program = (
        "import os, sys\n"
        f"for begun in {list(COMPLETED)}:\n"
        "    words = {'COMP_WORDS': 'tirefit ' + begun, 'COMP_CWORD': str(len(begun.split()))}\n"
        "    os.environ.update(words)\n"
        "    sys.argv = ['tirefit']\n"
        "    from tirefit.cli import main\n"
        "    try: main()\n"
        "    except SystemExit: pass\n"
        "    print('END')\n"
        "print('jax' in sys.modules, 'numpy' in sys.modules)"
    )
    environment = os.environ | {"_TIREFIT_COMPLETE": "complete_bash"}
    done = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True
    )
    *offered, heavy = done.stdout.split("END\n")
    assert [set(words.split()) for words in offered] == list(COMPLETED.values())
    assert heavy == "False False\n"


def test_derive_refuses_a_wrong_unit_with_a_working_remedy(run, tmp_path):
    time = np.arange(0, 30, 0.02)
    rng = np.random.default_rng(0)
    v, r = (20 + 2 * np.sin(0.3 * time), 0.2 * np.sin(1.1 * time) + 0.1 * np.sin(0.4 * time))
    v_y = 0.5 * r - 0.008 * v**2 * r
    a_y = v * r + np.gradient(v_y, time)
    signals = (x + 0.01 * rng.standard_normal(len(time)) for x in (3.6 * v, v_y, r, a_y))
    write(tmp_path / "log.csv", "t,vx,vy,r,ay", time, *signals)
    (tmp_path / "v.toml").write_text(
        "mass = 1500\nyaw_inertia = 2500\nl_f = 1.2\nl_r = 1.4\n[columns]\n"
        'time = "t"\nv_x = "vx"\nv_y = "vy"\nyaw_rate = "r"\na_y = "ay"\n'
    )
    arguments = ("derive", "log.csv", "--vehicle", "v.toml", "--out", "out.csv")
    result = run(*arguments, exit_code=3)
    assert "v_x is in km/h, but read in m/s" in result.stderr
    assert "--unit v_x=km/h" in result.stderr
    assert not (tmp_path / "out.csv").exists()
    assert "channels compared: " in run(*arguments, "--unit", "v_x=km/h").stdout
    assert "warning: channels contradict" in run(*arguments, "--believe").stdout
    result = run(*arguments, "--unit", "v_x", exit_code=2)
    assert "'--unit': 'v_x': write it as NAME=VALUE" in result.stderr


def test_inspect_lists_identifiable_parameters(run, tmp_path):
    run("simulate", "rig", "--out", "rig.csv", "--largest", "0.004")
    said = run("inspect", "rig.csv", "--model", "brush").stdout
    assert "fx brush" in said and "not mu" in said
    content = json.loads(run("inspect", "rig.csv", "--model", "brush", "--json").stdout)
    (gate,) = content["identifiability"]["gates"]
    grades = {p["name"]: p["grade"] for p in gate["parameters"]}
    assert grades == {"cpa2": "well", "mu": "not"}
    plain = run("inspect", "rig.csv", "--no-gate").stdout
    assert "expected standard errors" not in plain
    run("inspect", "rig.csv", "--model", "brusch", exit_code=2)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("fit", "tirefit fit: missing argument 'FILE'\n    remedy: 'FILE': measurements: CSV"),
        (
            "fit a.csv --modle x",
            "fit: no such option: --modle\n    remedy: did you mean '--model'?",
        ),
        ("fit a.csv --seed x", "value for '--seed': Input should be a valid integer"),
        ("fit a.csv --model", "fit: option '--model' requires an argument"),
        ("brake --out o --stops 0", "remedy: '--stops': number of stops, each with"),
        ("simulate rigg", "simulate: no such command 'rigg'\n    remedy: did you mean 'rig'?"),
        ("fitt a.csv", "tirefit: no such command 'fitt'\n    remedy: did you mean 'fit'?"),
        ("--foo", "tirefit: no such option: --foo"),
    ],
)
def test_wrong_words_are_reported_with_a_remedy(run, words, said):
    result = run(*words.split(), exit_code=2)
    assert result.stderr.startswith("error:\n  tirefit") and said in result.stderr
    command = re.match(r"error:\n  (.*?): ", result.stderr)[1]
    assert f"`{command} --help` lists what it takes\n" in result.stderr


def helps():
    """The words of every command and of every kind of simulation."""
    kinds = typer.main.get_command(simulate).commands
    return [(), *((name,) for name in COMMANDS), *(("simulate", kind) for kind in kinds)]


@pytest.mark.parametrize("words", helps(), ids=" ".join)
def test_help_is_whole_at_80_columns(run, monkeypatch, words):
    monkeypatch.setenv("COLUMNS", "80")
    lines = run(*words, "--help").stdout.splitlines()
    assert max(map(len, lines)) <= 80
    cut = [line for line in lines[1:] if re.search(r"\w\.\.\.$", line)]
    assert cut == [] and not re.search(r"\.{4}|\}\.\.\.\}|\[\[", lines[0])
