"""No command writes over a file that it reads, by whatever name."""

import os
import shutil
from importlib.resources import files
from pathlib import Path

import pytest

SAMPLES = Path(str(files("tirefit") / "samples"))
CAR = ["--vehicle", "car.toml"]
LOG = "drive.csv"
TIRES = ["--front", "brush", "--rear", "brush"]

CASES = {
    # command, its arguments, the input that would be replaced, the option that names it
    "the vehicle of a fit": (
        ["fit", LOG, "--vehicle", "vehicle.toml", "--out", "."],
        "vehicle.toml",
        "--vehicle",
    ),
    "a model of a fit of a car": (
        ["fit", LOG, *CAR, "--model", "front=front.json,rear=brush", "--out", "."],
        "front.json",
        "--model",
    ),
    "the data of a fit": (["fit", "o/fit.json", "--out", "o"], "o/fit.json", "FILES"),
    "data of another file's result": (["fit", LOG, "drive/fit.json"], "drive/fit.json", "FILES"),
    "the page of all fits": (["fit", LOG, "o/fits.html", "--out", "o"], "o/fits.html", "FILES"),
    "the tire that a fit borrows from": (
        ["fit", LOG, "--model", "mf52", "--like", "o/fit.tir", "--out", "o"],
        "o/fit.tir",
        "--like",
    ),
    "a tire of a replay": (
        ["replay", LOG, *CAR, "--front", "o/replay.json", "--rear", "brush", "--out", "o"],
        "o/replay.json",
        "--front",
    ),
    "a tire of a simulation": (
        ["brake", "--tire", "o/summary.json", "--out", "o"],
        "o/summary.json",
        "--tire",
    ),
    "a log of estimates": (["estimate", "o/estimates.csv", "--out", "o"], "o/estimates.csv", "LOG"),
    "rows of a diagnosis": (
        ["diagnose", "o/a.csv", "o/a.rows.csv", "--out", "o"],
        "o/a.rows.csv",
        "FILES",
    ),
    "the tire of a diagnosis of a car": (
        ["diagnose", LOG, *CAR, "--front", "o/vehicle_diagnosis.json", "--out", "o"],
        "o/vehicle_diagnosis.json",
        "--front",
    ),
    "a fit that is compared": (
        ["compare", "o/comparison.json", "b.json", "--out", "o"],
        "o/comparison.json",
        "FILES",
    ),
    "a recording": (["prepare", "o/run.csv", "--out", "o"], "o/run.csv", "FILES"),
    "data of a prediction": (
        ["predict", "brush", "o/p.csv", "--out", "o/p.csv"],
        "o/p.csv",
        "DATA",
    ),
    "a log that is derived": (["derive", "o/p.csv", *CAR, "--out", "o/p.csv"], "o/p.csv", "FILES"),
    "a vehicle beside derived rows": (
        ["derive", LOG, "--vehicle", "o/p.derive.json", "--out", "o/p.csv"],
        "o/p.derive.json",
        "--vehicle",
    ),
    "a tire that is exported": (
        ["export", "o/t.tir", "--to", "tir", "--out", "o/t.tir", "--force"],
        "o/t.tir",
        "SOURCE",
    ),
    "a tire that is explored": (["explore", "o/t.html", "--out", "o/t.html"], "o/t.html", "TIRES"),
    "a .tir beside a tire of Chrono": (
        ["export", "o/t.tir", "--to", "chrono", "--out", "o/t.json", "--force"],
        "o/t.tir",
        "the tire",
    ),
}


def contents(folder):
    return {p: p.read_bytes() for p in folder.rglob("*") if p.is_file() or p.is_symlink()}


@pytest.mark.parametrize("name", CASES)
def test_no_input_is_replaced(run, tmp_path, name):
    arguments, replaced, option = CASES[name]
    shutil.copytree(SAMPLES, tmp_path, dirs_exist_ok=True)
    shutil.copy(SAMPLES / "vehicle.toml", tmp_path / "car.toml")
    (tmp_path / "o").mkdir()
    file = tmp_path / replaced
    file.parent.mkdir(exist_ok=True)
    if not file.exists():
        text = "# mine\n"
        if "derive" in arguments:  # it reads the vehicle first
            text = (SAMPLES / "vehicle.toml").read_text()
        file.write_text(text)
    before = contents(tmp_path)
    ended = run(*arguments, exit_code=3)
    assert f"{replaced}: it is an input file ({option}), which would be replaced" in ended.stderr
    assert "remedy: choose another --out" in ended.stderr
    assert contents(tmp_path) == before


@pytest.mark.parametrize("how", ["symbolic", "hard", "to", "relative", "absolute", "folder"])
def test_a_link_or_another_name_of_an_input_is_refused(run, tmp_path, how):
    log, out = tmp_path / "drive.csv", tmp_path / "o" / "estimates.csv"
    out.parent.mkdir()
    text = (SAMPLES / "drive.csv").read_bytes()
    given, folder = str(log), "o"
    if how == "symbolic":  # the result is a link to the input
        log.write_bytes(text)
        out.symlink_to(log)
    elif how == "hard":
        log.write_bytes(text)
        os.link(log, out)
    elif how == "to":  # the input is a link to the result
        out.write_bytes(text)
        log.symlink_to(out)
    else:
        out.write_bytes(text)
        given = {"relative": "o/../o/./estimates.csv"}.get(how, str(out))
    if how == "folder":
        (tmp_path / "other").symlink_to(out.parent)
        folder = "other"
    ended = run("estimate", given, "--out", folder, exit_code=3)
    assert "estimates.csv: it is an input file (LOG)" in ended.stderr
    assert out.read_bytes() == text and Path(given).read_bytes() == text


@pytest.mark.parametrize("name", ["fit.json", "vehicle.toml"])
def test_a_file_of_another_origin_is_not_replaced(run, tmp_path, name):
    """A user's JSON or TOML file in the folder of the results, which no option names."""
    (tmp_path / name).write_text('{"mine": "tirefit.fit/1"}\n' if name[0] == "f" else "# mine\n")
    shutil.copy(SAMPLES / "vehicle.toml", tmp_path / "car.toml")
    shutil.copy(SAMPLES / "drive.csv", tmp_path / "drive.csv")
    before = contents(tmp_path)
    arguments = CAR if name == "vehicle.toml" else []
    ended = run("fit", "drive.csv", *arguments, "--out", ".", exit_code=3)
    assert f"{name}: it would be replaced, but tirefit did not write it" in ended.stderr
    assert contents(tmp_path) == before


OF_OTHERS = {
    "a figure of a fit": (["fit", LOG, "--out", "o"], "o/fit.png"),
    "a page of fits": (["fit", LOG, "circles.csv", "--out", "o"], "o/fits.html"),
    "a figure of a car": (["fit", LOG, *CAR, "--out", "o"], "o/trajectory.png"),
    "a converted tire": (["convert", "t.tir", "--out", "o"], "o/fit.png"),
    "rows of a diagnosis": (["diagnose", LOG, "--out", "o"], "o/drive.rows.csv"),
    "a figure of a diagnosed car": (
        ["diagnose", LOG, *CAR, "--out", "o"],
        "o/vehicle_diagnosis.png",
    ),
    "a prepared table": (["prepare", LOG, "--out", "o"], "o/drive.csv"),
    "a table of many files": (["diagnose", LOG, "--jobs", "2", "--out", "o"], "o/results.parquet"),
    "a replay": (["replay", LOG, *CAR, *TIRES, "--out", "o"], "o/replay.png"),
    "estimates": (["estimate", LOG, "--out", "o"], "o/estimates.csv"),
    "a simulated stop": (["brake", "--out", "o"], "o/stops.csv"),
    "a page with sliders": (["explore", "brush", "--out", "o/p.html"], "o/p.html"),
    "derived rows": (["derive", LOG, *CAR, "--out", "o/p.csv"], "o/p.csv"),
}


@pytest.mark.parametrize("name", OF_OTHERS)
def test_a_figure_or_table_of_another_origin_is_not_replaced(run, tmp_path, name):
    """Files that cannot name tirefit: there is no document of its result beside them."""
    arguments, kept = OF_OTHERS[name]
    shutil.copytree(SAMPLES, tmp_path, dirs_exist_ok=True)
    shutil.copy(SAMPLES / "vehicle.toml", tmp_path / "car.toml")
    (tmp_path / "o").mkdir()
    (tmp_path / kept).write_text("mine,too\n1,2\n")
    before = contents(tmp_path)
    ended = run(*arguments, exit_code=3)
    assert f"{kept}: it would be replaced, but" in ended.stderr
    assert contents(tmp_path) == before


def test_the_demo_does_not_replace_changed_samples(run, tmp_path):
    changed = tmp_path / "d" / "samples" / "vehicle.toml"
    changed.parent.mkdir(parents=True)
    changed.write_text("# that tirefit fit estimated, and I changed\n")
    before = contents(tmp_path)
    ended = run("demo", "--out", "d", exit_code=3)
    assert f"{changed.relative_to(tmp_path)}: it would be replaced" in ended.stderr
    assert contents(tmp_path) == before
