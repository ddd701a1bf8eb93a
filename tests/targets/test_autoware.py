"""Parameters of Autoware, read by a steering that was written after its documentation."""

import json

import numpy as np
import pytest
import yaml

import tirefit
from tests.targets.support import CAR, ran
from tirefit.results import DataError, UsageError

WORDS = "steer_time_delay input_delay steer_time_constant vehicle_model_steer_tau steer_bias"
WORDS += " steer_dead_band debug_steer_scaling_factor wheel_base wheel_radius"
STEERED = CAR + "[columns]\ntime = 't'\nx = 'x'\ny = 'y'\nyaw = 'yaw'\nsteering = 's'\n"
STEERED += "[steering]\ncommand = [-1.0, 1.0]\nangle = [-0.4, 0.4]\ndelay = 0.01\n"


def estimate(value, std, unit="-", identified=True):
    return {"value": value, "std": std, "unit": unit, "identified": identified}


def trajectory(folder, converged=True, **parameters):
    content = {
        "schema": "tirefit.trajectory/1",
        "logs": ["lap"],
        "converged": converged,
        "parameters": {"front.mu": estimate(0.9, 0.1), **parameters},
        "vehicle": {"wheelbase": 0.33, "wheel_radius": None},
    }
    path = folder / "trajectory.json"
    path.write_text(json.dumps(content))
    return path


def diagnosis(folder, **sizes):
    amplitudes = {
        f"{name}: amplitude": {"value": value, "std": 0.001, "unit": "-"}
        for name, value in sizes.items()
    }
    content = {
        "schema": "tirefit.diagnosis/4",
        "data": {"name": "lap", "sha256": "0" * 64},
        "model": "car on brush (front) and brush (rear)",
        "simulator": None,
        "verdict": {
            "status": "named",
            "effects": [*sizes],
            "acts_like": [],
            "probability": 0.9,
            "also_possible": [],
        },
        "candidates": [{"effects": [*sizes], "parameters": amplitudes}],
        "base_parameters": {},
        "extended_parameters": {},
    }
    path = folder / "vehicle_diagnosis.json"
    path.write_text(json.dumps(content))
    return path


def read(path):
    """The parameters as ROS reads them: those of every node, all doubles."""
    (found,) = yaml.safe_load(path.read_text())["/**"].values()
    assert set(found) <= set(WORDS.split())
    assert {type(value) for value in found.values()} == {float}
    return found


def steered(p, command, seconds, step=1e-3):
    """The wheel angle at the end, of DELAY_STEER_ACC as its documentation describes it."""
    time = np.arange(0, seconds, step)
    queue, steer = [0.0] * round(p["steer_time_delay"] / step), 0.0
    slow = max(p["steer_time_constant"], 0.03)
    for wanted in command(time):
        queue.append(wanted * p["debug_steer_scaling_factor"])
        steer -= step * (steer + p["steer_bias"] - queue.pop(0)) / slow
    return steer


def test_a_diagnosis_turns_the_wheels_of_autoware_as_it_says(tmp_path):
    """A sinusoid through a delay of 0.05 s (0.01 of it stated), a lag of 0.1 s, a ratio of 0.9
    and an offset."""
    (tmp_path / "car.toml").write_text(STEERED)
    sizes = {"delay": 0.04, "lag": 0.1, "ratio": -0.1, "offset": 0.012}
    path = diagnosis(tmp_path, **{f"steering_{name}": size for name, size in sizes.items()})
    out = tmp_path / "car.param.yaml"
    done = ran(path, "--vehicle", tmp_path / "car.toml", "--to", "autoware", "--out", out)
    assert done.exit_code == 0 and "wrote" in done.stdout, done.stderr
    p = read(out)
    assert p["wheel_base"] == pytest.approx(0.33) and p["input_delay"] == pytest.approx(0.05)
    w, a = 4.0, 0.2
    for seconds in (3.0, 3.4, 3.9):
        got = steered(p, lambda t: a * np.sin(w * t), seconds)
        phase = w * (seconds - 0.05) - np.arctan(w * 0.1)
        true = 0.9 * a / np.hypot(1, w * 0.1) * np.sin(phase) + 0.012
        assert got == pytest.approx(true, abs=1e-3)  # steps of 1 ms


def test_only_what_its_standard_error_allows_is_written(tmp_path):
    path = trajectory(
        tmp_path,
        steering_delay=estimate(0.06, 0.02, "s"),
        steering_offset=estimate(0.02, 0.004, "rad"),
        steering_ratio=estimate(0.98, 0.01, identified=False),
    )
    done = tirefit.export(path, "autoware", tmp_path / "car.yaml")
    found = read(done.path)
    assert found == {"wheel_base": 0.33, "steer_bias": -0.02}
    text = done.path.read_text()
    assert "steer_bias: -0.02  # -0.02 +- 0.004 rad" in text
    notes = "\n".join(done.notes)
    assert "steer_time_delay, input_delay: not written: 0.06 +- 0.02 s: its standard" in notes
    assert "factor: not written: 0.98 +- 0.01: the logs do not determine it" in notes
    assert "vehicle_model_steer_tau: not written, as no steering_lag was estimated" in notes
    assert all(f"# {note}" in text for note in done.notes) and done.shape.sound


@pytest.mark.parametrize("value, written", [(-0.004, 0.0), (-0.05, None)])
def test_a_delay_below_zero_is_zero_or_refused(value, written, tmp_path):
    path = trajectory(tmp_path, steering_delay=estimate(value, 0.005, "s"))
    done = tirefit.export(path, "autoware", tmp_path / "car.yaml")
    assert read(done.path).get("steer_time_delay") == written
    assert ("less than zero" in " ".join(done.notes)) == (written is None)


@pytest.mark.parametrize("converged", [True, False])
def test_a_fit_that_did_not_converge_is_exported_with_a_note(converged, tmp_path):
    path = trajectory(tmp_path, converged, steering_offset=estimate(0.02, 0.004, "rad"))
    done = tirefit.export(path, "autoware", tmp_path / "car.yaml")
    said = [note for note in done.notes if "before it converged" in note]
    assert len(said) == (not converged) and set(said) <= set(done.path.read_text().split("\n# "))


def test_other_sources_and_options_are_refused(tmp_path, vehicle):
    out, path = tmp_path / "car.yaml", trajectory(tmp_path)
    with pytest.raises(UsageError, match="describes a car's steering"):
        tirefit.export(tirefit.MODELS["brush"], "autoware", out)
    with pytest.raises(DataError, match="vehicle_diagnosis.json"):
        tirefit.export("brush", "autoware", out)
    with pytest.raises(UsageError, match="contains the car"):
        tirefit.export(path, "autoware", out, vehicle=vehicle)
    with pytest.raises(UsageError, match="does not contain the car"):
        tirefit.export(diagnosis(tmp_path), "autoware", out)
    for more in (["--set", "mu=1"], ["--over", "fz=1:2"], ["--convention", "sae"]):
        done = ran(path, "--to", "autoware", "--out", out, *more)
        assert done.exit_code == 2 and "does not use it" in done.stderr
    assert not out.exists()
