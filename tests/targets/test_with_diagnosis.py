"""Tires exported with the effects of a diagnosis, compared with printed formulas."""

import importlib.util
import json

import numpy as np
import pytest
from typer.testing import CliRunner

import tirefit
from tirefit.cli.commands import app
from tirefit.data.tir.tir import read_tir
from tirefit.models import CombinedMagicFormula, MagicFormula
from tirefit.params import parameter_values
from tirefit.results import DataError, UsageError

MU, CPA2, F0, POWER = 0.9, 5e4, 3600.0, -0.15


def document(path, *effects, model="brush", parameters=None, **known):
    """A document that names effects: (id, name and value of the amplitude)."""
    values = {"cpa2": CPA2, "mu": MU} if parameters is None else parameters
    names = [id for id, _, _ in effects]
    content = {
        "schema": "tirefit.diagnosis/4", "data": {"name": "run", "sha256": "ab" * 32},
        "model": model, "simulator": None,
        "verdict": {
            "status": "named", "effects": names, "probability": 0.9,
            "acts_like": [], "also_possible": [],
        },
        "candidates": [{"effects": names, "parameters": {
            f"{id}: {name}": {"value": value, "std": 0.01, "unit": "-", "formula": ""}
            for id, name, value in effects
        }}],
        "base_parameters": values, "extended_parameters": values,
        "extension": {
            "mode": "x", "variants": dict.fromkeys(names, 0),
            "load": F0, "at": [4000.0, 12.0], "slowest": 0.4,
            "brisk": 5.0, "cruise": 12.0, "rise": 0.04, "peak": 0.9, "used": 0.9,
            "pressure": [2e5, 0.0],
        },
    }  # fmt: skip
    path.write_text(json.dumps(content | known))
    return path


def brush(slip, mu, fz):
    """S(12) as printed, slip of one sign."""
    u = np.minimum(2 * CPA2 * slip / (3 * mu * fz), 1.0)
    return mu * fz * (3 * u - 3 * u**2 + u**3)


def loaded(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("target", ["numpy", "casadi"])
def test_load_dependent_friction_is_in_the_forces(target, tmp_path):
    if target == "casadi":
        pytest.importorskip("casadi")
    said = document(tmp_path / "run.json", ("load_friction", "power", POWER))
    path = tmp_path / "tire.py"
    done = tirefit.export("brush", target, path, diagnosis=said)
    assert any(note.startswith("in the forces: load_friction") for note in done.notes)
    assert "load_friction power = -0.15 +- 0.01" in path.read_text()
    function = loaded(path).tire
    for kappa, fz in ((-0.02, 2000.0), (-0.1, 4000.0), (-0.4, 9000.0), (0.03, 500.0)):
        size = abs(kappa) / (1 + kappa)
        slip = size if kappa < 0 else -kappa / (1 + kappa)
        wanted = np.sign(kappa) * brush(abs(slip), MU * (fz / F0) ** POWER, fz)
        assert float(function(kappa, 0.0, fz)[0]) == pytest.approx(wanted, rel=1e-9)


def test_speed_dependent_friction_adds_the_speed_argument(tmp_path):
    effect = ("friction_speed_linear", "n / mu", 0.02)
    said = document(tmp_path / "run.json", effect)
    # The variant of all friction, with the speed of travel.
    content = json.loads(said.read_text())
    content["extension"]["variants"] = {effect[0]: 2}
    said.write_text(json.dumps(content))
    tirefit.export("brush", "numpy", tmp_path / "tire.py", diagnosis=said)
    found = loaded(tmp_path / "tire.py").tire(-0.5, 0.0, 4000.0, 20.0)[0]
    assert found == pytest.approx(-MU * (1 - 0.02 * 20) * 4000.0)


def test_a_sensor_offset_and_a_lag_change_no_force(tmp_path):
    pair = (("slip_offset", "amplitude", 0.02), ("relaxation_length", "length", 0.3))
    said = document(tmp_path / "run.json", *pair)
    done = tirefit.export("brush", "numpy", tmp_path / "tire.py", diagnosis=said)
    found = loaded(tmp_path / "tire.py").tire(-0.1, 0.0, 4000.0)[0]
    assert found == pytest.approx(-brush(0.1 / 0.9, MU, 4000.0))
    told = "\n".join(done.notes)
    assert "of the measurement, not in the forces: slip_offset" in told
    assert "relaxation_length length = 0.3 +- 0.01" in told


def test_a_pure_slip_formula_is_combined_before_its_effects(tmp_path):
    own = parameter_values(MagicFormula())
    said = document(
        tmp_path / "run.json",
        ("load_friction", "power", POWER),
        model="magic-formula",
        parameters=own,
    )
    path = tmp_path / "tire.py"
    done = tirefit.export("magic-formula", "numpy", path, diagnosis=said)
    assert any("combined" in note for note in done.notes)
    fx, fy = loaded(path).tire(0.3, 0.3, F0)
    both = {f"{k}{axis}": v for k, v in own.items() for axis in "xy"}
    assert set(both) <= set(parameter_values(CombinedMagicFormula()))
    assert np.hypot(fx, fy) < 1.03 * loaded(path).tire(0.3, 0.0, F0)[0]


def test_a_fit_gets_the_parameters_found_with_the_effects(tmp_path):
    angle = np.linspace(-0.2, 0.2, 60)
    force = -brush(np.tan(np.abs(angle)), 0.8, 4000.0) * np.sign(angle) * -1
    force = force + 20 * np.random.default_rng(1).standard_normal(60)
    fit = tirefit.fit({"alpha": angle, "fz": np.full(60, 4e3), "fy": force}, "brush")
    said = document(tmp_path / "run.json", ("load_friction", "power", POWER))
    path = tmp_path / "tire.py"
    done = tirefit.export(fit, "numpy", path, diagnosis=said)
    assert "mu = 0.9\n" in path.read_text()
    assert any("without standard error" in note for note in done.notes)


def test_a_tir_has_the_parameters_and_reports_lost_effects(tmp_path):
    source = "tests/data/tir/mfeval_julia/MagicFormula61_Parameters.tir"
    given = read_tir(source)
    said = document(
        tmp_path / "run.json",
        ("load_friction", "power", -0.03),
        parameters={"LMUX": 0.8},
        simulator={"kind": "tir"},
    )
    path = tmp_path / "t.tir"
    done = tirefit.export(source, "tir", path, diagnosis=said)
    assert read_tir(path).numbers["LMUX"] == 0.8
    told = "\n".join(done.notes)
    assert "not in this file: load_friction" in told and "in the forces" not in told
    miss = float(told.split("largest error of the file: fx ")[1].split("%")[0])
    # Friction times (F_z / F_z0)^-0.03 at the ends of 0.5 to 1.5 times the load.
    most = (1.5 * given.numbers["FNOMIN"] / F0) ** -0.03 - 1
    peak = 1.23 * 0.8
    assert 0.5 < miss / 100 / (abs(most) * peak) < 1.1


def test_bad_documents_are_refused_and_write_nothing(tmp_path):
    path, said = tmp_path / "tire.py", tmp_path / "run.json"
    arguments = ["export", "brush", "--to", "numpy", "--out", str(path)]
    for text in ("", "{", "[]", '{"schema": "tirefit.diagnosis/4"}'):
        said.write_text(text)
        with pytest.raises(DataError, match="diagnose"):
            tirefit.export("brush", "numpy", path, diagnosis=said)
    done = CliRunner().invoke(app, [*arguments, "--diagnosis", str(said)])
    assert done.exit_code == 3 and "tirefit diagnose" in done.stderr
    document(said, ("load_friction", "power", POWER), model="brush-d")
    with pytest.raises(UsageError, match="the tire is a brush"):
        tirefit.export("brush", "numpy", path, diagnosis=said)
    assert not path.exists()
