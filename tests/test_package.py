"""The wheel contains everything the package needs, and its demo runs with it."""

import csv
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hatchling.builders.wheel import WheelBuilder
from typer.testing import CliRunner

from tirefit.cli.commands import app
from tirefit.data.vehicle.vehicle import load_vehicle
from tirefit.diagnosis import diagnose as engine
from tirefit.diagnosis.effects import EFFECTS
from tirefit.names import effect_names
from tirefit.sim.drive import Car

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "tirefit"


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    (built,) = WheelBuilder(str(ROOT)).build(directory=str(tmp_path_factory.mktemp("d")))
    with zipfile.ZipFile(built) as archive:
        yield archive


def test_the_wheel_contains_every_file_of_the_package(wheel):
    ours = {
        path.relative_to(ROOT).as_posix()
        for path in PACKAGE.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    held = {name for name in wheel.namelist() if not name.startswith("tirefit-")}
    assert held == ours
    kinds = {".json", ".csv", ".html", ".typed"}
    assert kinds <= {Path(name).suffix for name in held}


def test_the_wheel_contains_the_licence_of_the_samples(wheel):
    (licence,) = [n for n in wheel.namelist() if n.endswith("licenses/tirefit/samples/LICENSE")]
    source = ROOT / "fits" / "dart_jetracer" / "LICENSE"
    assert wheel.read(licence) == source.read_bytes()


@pytest.mark.parametrize("name", ["circles.csv", "free_driving.csv"])
def test_samples_are_rows_of_measured_cases(name):
    convention, header, *rows = (PACKAGE / "samples" / name).read_text().splitlines()
    case = (ROOT / "fits" / "dart_simulator" / name).read_text().splitlines()
    assert convention == "# convention: braking" and header == case[0]
    assert len(rows) > 300 and set(rows) <= set(case)


def table_of(path):
    with path.open() as file:
        rows = list(csv.DictReader(line for line in file if line[0] != "#"))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def test_the_sample_of_a_drive_is_what_simulate_gives(tmp_path):
    out, truth = tmp_path / "d.csv", tmp_path / "t.csv"
    words = ["simulate", "drive", "--duration", "10", "--out", str(out), "--truth", str(truth)]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0 and "500 rows" in result.stdout and "omega_rr" in result.stdout
    columns = table_of(out)
    for name, values in table_of(PACKAGE / "samples" / "drive.csv").items():
        np.testing.assert_allclose(values, columns[name], atol=6e-4)
    assert set(table_of(truth)["mu"]) == {0.9}
    car, ours = load_vehicle(PACKAGE / "samples" / "vehicle.toml"), Car()
    for name in ("mass", "l_f", "l_r", "yaw_inertia"):
        assert getattr(car, name) == getattr(ours, name)


@pytest.mark.long
def test_the_demo_prints_its_commands_and_where_the_results_are(tmp_path, monkeypatch):
    """It tries one effect here; ``docs/tutorials/simulator.md`` has all of them."""
    few = [effect for effect in EFFECTS if effect.id == effect_names()[0]]
    whole = engine.diagnose
    monkeypatch.setattr(
        engine, "diagnose", lambda data, **how: whole(data, **how | {"effects": few})
    )
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, ["demo", "--out", "first"])
    assert result.exit_code == 0, result.output
    commands = [line for line in result.stdout.splitlines() if line.startswith("$ ")]
    assert [line.split()[2] for line in commands] == ["fit", "diagnose"]
    named = [word.rstrip(":") for word in result.stdout.split() if "first/" in word]
    assert {"first/samples", "first/fit/fit.png"} <= set(named)
    assert "first/gap/free_driving.html" in named
    assert [path for path in named if not Path(path.rstrip(",")).exists()] == []


def test_the_demo_reports_an_unwritable_directory(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("taken").touch()
    result = CliRunner().invoke(app, ["demo", "--out", "taken"])
    assert result.exit_code == 2 and "taken" in result.stderr
