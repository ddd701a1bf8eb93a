"""``tirefit brake`` on the command line."""

import csv
import json

import pytest

QUICK = ("--speed", "6", "--road", "mu=0.5", "--vehicle", "quarter")


@pytest.mark.long
def test_controllers_are_compared_on_each_road(run, tmp_path):
    run("brake", "--controller", "abs,none", *QUICK, "--seed", "4", "--stops", "3", "--out", "o")
    made = {path.name for path in (tmp_path / "o").iterdir()}
    assert made == {"summary.json", "series.csv", "stops.csv", "stop.png", "slip.png"}
    summary = json.loads((tmp_path / "o" / "summary.json").read_text())
    assert summary["schema"] == "tirefit.brake/1" and summary["seed"] == 4
    assert summary["convention"] == "braking, SI"
    assert summary["units"]["pressure_rms_fluctuation"] == "Pa"
    assert summary["manoeuvre"]["parameters"]["m"] == 0.5
    assert summary["stopped"] is True and summary["recovery_time"] is None
    assert summary["seeds"]["none"]["locked_time"]["k"] == 3
    assert summary["controllers"]["abs"]["settings"]["slip"] == 0.07
    with (tmp_path / "o" / "series.csv").open() as file:
        rows = list(csv.DictReader(file))
    locked = [row for row in rows if row["controller"] == "none"]
    distance = float(locked[-1]["distance"])
    assert summary["controllers"]["none"]["stopping_distance"] == distance
    assert locked[-1]["omega"] == "0.0" and locked[0]["xbs"] == ""
    with (tmp_path / "o" / "stops.csv").open() as file:
        assert [row["seed"] for row in csv.DictReader(file)] == ["4", "5", "6"] * 2


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (("--controller", "asb"), 2, "did you mean 'abs'"),
        (("--road", "ice"), 2, "write it as mu=0.4"),
        (("--tire", "magic-formula", "--steer", "0.1"), 2, "no combined slip"),
        (("--tire", "brsh"), 2, "did you mean"),
        (("--tire", __file__), 2, "ends in .json (a fit) or .tir"),
        (("--tire", "none.tir"), 3, "none.tir"),
        (("--set", "mu=99"), 2, "outside its bounds"),
        (("--set", "mu=nan"), 2, "give a finite value in SI units"),
        (("--set", "B=1"), 2, "brush-m has no parameter 'B'"),  # the default
        (("--tune", "abs.slip=9"), 2, "abs.slip = 9.0 is outside its bounds"),
        (("--tune", "xbs-servo.servo_gain=-400"), 2, "O(11)"),
        (("--tune", "quick"), 2, "NAME=VALUE"),
        (("--plant", "dealy=1"), 2, "no --plant quantity 'dealy'"),
        (("--plant", "demand=-1"), 2, "out of range"),
        (("--speed", "500"), 2, "--speed 500 is out of range"),
    ],
)
def test_wrong_options_are_reported_with_a_remedy(run, tmp_path, arguments, code, said):
    result = run("brake", "--out", "o", *arguments, exit_code=code)
    assert said in result.stderr
    assert not (tmp_path / "o").exists()


def test_a_tire_of_another_size_is_reported(run, unrendered):
    """A tire fitted to a model car; a stop may not take a thousand seconds."""
    arguments = ["brake", *QUICK, "--controller", "abs", "--out", "o"]
    small = ("--tire", "brush", "--set", "cpa2=39", "--time-limit", "1")
    said = run(*arguments, *small).stderr
    assert "warning: the slope of the braking force of brush" in said
    for plant, remedy in (("delay=1e6", "0 to 0.5 s"), ("demand=1e30", "Pa")):
        said = run(*arguments, "--plant", plant, exit_code=2).stderr
        assert remedy in said and "--time-limit" not in said
