"""The wheel contains everything the package needs, and its demo runs with it."""

import csv
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hatchling.builders.wheel import WheelBuilder
from typer.testing import CliRunner

from tirefit.cli.commands import app
from tirefit.data.vehicle.vehicle import load_vehicle
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


ONE_EFFECT = """
import sys
from tirefit.cli import main
from tirefit.diagnosis import diagnose as engine
from tirefit.diagnosis.effects import EFFECTS
whole, few = engine.diagnose, list(EFFECTS)[:1]
engine.diagnose = lambda data, **how: whole(data, **how | {"effects": few})
print(engine.__file__)
main()
"""


@pytest.mark.long
def test_the_demo_of_the_wheel_prints_its_commands_and_where_the_results_are(wheel, tmp_path):
    """It runs without the repository, as by uvx or pipx, and tries one effect here;
    ``docs/tutorials/simulator.md`` has all of them."""
    wheel.extractall(tmp_path / "wheel")
    command = [sys.executable, "-c", ONE_EFFECT, "demo", "--out", "first"]
    done = subprocess.run(
        command,
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(tmp_path / "wheel")},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(str(tmp_path / "wheel"))
    commands = [line for line in done.stdout.splitlines() if line.startswith("$ ")]
    assert [line.split()[2] for line in commands] == ["fit", "diagnose"]
    named = [word.rstrip(":") for word in done.stdout.split() if "first/" in word]
    assert {"first/samples", "first/fit/fit.png"} <= set(named)
    assert "first/gap/free_driving.html" in named
    assert [path for path in named if not (tmp_path / path.rstrip(",")).exists()] == []


def test_the_demo_reports_an_unwritable_directory(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("taken").touch()
    result = CliRunner().invoke(app, ["demo", "--out", "taken"])
    assert result.exit_code == 2 and "taken" in result.stderr


def test_each_step_of_the_installation_is_announced():
    done = subprocess.run(
        ["make", "-n", "-B", "install"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    lines = [line for line in done.stdout.splitlines() if "@#" not in line and line[:1] != "#"]
    steps = [k for k, line in enumerate(lines) if line.startswith("echo ")]
    assert len(steps) == 3
    assert "-m venv" in lines[steps[0] + 1]
    assert all("pip install" in lines[k + 1] for k in steps[1:])
