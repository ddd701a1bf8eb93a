"""``simulate``, ``estimate`` and ``methods`` on the command line."""

import csv
import io
import json
import re
import shutil
from contextlib import chdir
from pathlib import Path

import pytest
from typer.testing import CliRunner

import tirefit
from tirefit.cli.commands import app
from tirefit.online.methods import METHODS

NAMES = "rls,ekf"
# Of one length, for which a method and a simulation are compiled once.
SIMULATED = ("simulate", "braking", "--teeth", "4")
LOG = (*SIMULATED, "--out", "log.csv", "--seed", "3")


def rows_of(text):
    return list(csv.DictReader(io.StringIO(text)))


@pytest.fixture(scope="module")
def estimated(tmp_path_factory):
    """A folder with a simulated log, the truth and the estimates from it."""
    folder = tmp_path_factory.mktemp("estimated")
    of_log = (*LOG, "--truth", "truth.csv", "--drop", "4=0.5")
    with chdir(folder):
        made = CliRunner().invoke(app, of_log)
        done = CliRunner().invoke(app, ["estimate", "log.csv", "--method", NAMES, "--out", "out"])
    assert "800 rows" in made.stdout and "seed 3" in made.stdout
    assert done.exit_code == 0 and "ONLINE ESTIMATES" in done.stdout
    return folder


@pytest.fixture
def log(estimated, tmp_path):
    return Path(shutil.copy(estimated / "log.csv", tmp_path))


def test_estimates_of_a_simulated_log_are_right(estimated):
    rows = rows_of((estimated / "out" / "estimates.csv").read_text())
    assert len(rows) == 800
    assert list(rows[0]) == [
        "time", "rls_mu", "rls_mu_std", "rls_cpa2", "rls_cpa2_std", "rls_flag",
        "ekf_mu", "ekf_mu_std", "ekf_cpa2", "ekf_cpa2_std", "ekf_flag",
    ]  # fmt: skip
    summary = json.loads((estimated / "out" / "summary.json").read_text())
    assert summary["schema"] == "tirefit.estimate/1"
    ekf = summary["methods"]["ekf"]
    assert ekf["model"] == "brush"
    final = ekf["final"]["mu"]
    assert final["unit"] == "-" and final["value"] == float(rows[-1]["ekf_mu"])
    # Up to the truth's 0.5, less what a brush makes of a Magic Formula near its peak.
    assert 0.4 < final["value"] < 0.52
    change = next(c for c in ekf["changes"] if c["parameter"] == "mu")
    assert 4 < change["time"] < 6 and change["after"] < 0.55 < change["before"]
    flagged = sum(row["ekf_flag"] != "" for row in rows)
    assert flagged == sum(ekf["flags"].values()) > 0
    assert (estimated / "out" / "estimates.png").read_bytes().startswith(b"\x89PNG")
    truth = rows_of((estimated / "truth.csv").read_text())
    assert {row["mu"] for row in truth} == {"0.98", "0.5"}


def test_bad_rows_are_reported_and_flagged(run, tmp_path, log):
    lines = log.read_text().splitlines()
    lines[50] = lines[50].replace(lines[50].split(",")[2], "broken")
    log.write_text("\n".join(lines) + "\n")
    result = run("estimate", log, "--out", "out")
    assert "row 51, column 'fx'" in result.stderr
    rows = rows_of((tmp_path / "out" / "estimates.csv").read_text())
    assert [r["rls_flag"] for r in rows].index("sample missing") == 49


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (("log.csv", "--method", "rsl", "--out", "o"), 2, "did you mean 'rls'"),
        (("log.csv", "--out", "o", "--set", "ekf.mu=1"), 2, "'ekf' is not chosen"),
        (("log.csv", "--out", "o", "--set", "mu=9"), 2, "outside its bounds"),
        (("none.csv", "--out", "o"), 3, "does not exist"),
        (("bare.csv", "--out", "o"), 3, "needs time"),
    ],
)
def test_wrong_options_are_reported_with_a_remedy(run, tmp_path, arguments, code, said):
    (tmp_path / "log.csv").write_text("time,sigma_x,fx,fz\n0,.01,4e3,3e4\n1,.02,8e3,3e4\n")
    (tmp_path / "bare.csv").write_text("sigma_x,fx,fz\n.01,4e3,27e3\n.02,8e3,27e3\n")
    result = run("estimate", *arguments, exit_code=code)
    assert said in result.stderr
    assert not (tmp_path / "o").exists()


def test_simulate_writes_rig_sweeps_and_reports_wrong_options(run, tmp_path):
    run("simulate", "rig", "--out", "r.csv", "--set", "mu=0.8", "--load", "3000")
    rows = rows_of((tmp_path / "r.csv").read_text())
    assert len(rows) == 100 and {r["fz"] for r in rows} == {"3000.0"}
    for arguments, said in (
        (("rig", "--set", "nu=1"), "brush has no parameter 'nu'"),
        (("rig", "--set", "mu=-1"), "mu = -1.0 is outside its bounds"),
        (("braking", "--drop", "soon"), "TIME=FRICTION"),
        (("braking", "--truth", "x.csv"), "--truth is the same file as --out"),
        (("braking", "--teeth", "1000000000"), "number of rows 2e+11 is out"),
        (("braking", "--drop", "500=0.4"), "time of the drop 500 is out of range"),
        (("drive", "--bend", "2"), "bend 2 is out of range"),
        (("rig", "--truth", "t.xlsx"), "t.xlsx: the output is a CSV"),
    ):
        result = run("simulate", *arguments, "--out", "x.csv", exit_code=2)
        assert said in result.stderr
        assert "Traceback" not in result.stderr
        assert sorted(p.name for p in tmp_path.iterdir()) == ["r.csv"]


def test_methods_lists_all_methods(run):
    text = run("methods").stdout
    assert max(map(len, text.splitlines())) <= 88
    for name, kind in METHODS.items():
        assert f"{name}: {kind.method.meaning}" in text.replace("\n   ", "")


@pytest.mark.long
def test_a_wheel_that_locks_is_flagged_as_locked(run, tmp_path):
    run(*SIMULATED, "--out", "log.csv", "--drop", "3=0.4")
    names = "rls,slip-slope-braking,lugre-observer"
    result = run("estimate", "log.csv", "--method", names, "--out", "out")
    (warning,) = re.findall("warning: (.*)", result.stderr)  # how many, and the first of them
    assert "of 800 rows cannot be used" in warning and warning.count("out of the physical") == 3
    flags = json.loads((tmp_path / "out" / "summary.json").read_text())["methods"]
    for name in names.split(","):
        assert flags[name]["flags"]["wheel locked"] > 100
        assert flags[name]["flags"]["sample missing"] < 20


@pytest.mark.long
def test_a_lugre_wheel_is_simulated_and_observed(run, tmp_path):
    run(*SIMULATED, "--out", "l.csv", "--tire", "lugre", "--friction", "0.8")
    run("estimate", "l.csv", "--method", "lugre-observer", "--out", "out")
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    final = summary["methods"]["lugre-observer"]["final"]
    assert abs(final["mu"]["value"] - 0.8) < 3 * final["mu"]["std"] < 0.15
    result = run("simulate", "braking", "--out", "m.csv", "--tire", "brush", exit_code=2)
    assert "magic-formula or lugre" in result.stderr
    for setting, said in (
        ("gain=0.5", "none of lugre-observer has it"),
        ("theta=9", "theta at first: 0.05 to 4\n"),
    ):
        arguments = ("--method", "lugre-observer", "--set", setting, "--out", "o")
        assert said in run("estimate", "l.csv", *arguments, exit_code=2).stderr
    arguments = ("--method", "lugre-observer", "--set", "sigma0=90", "--out", "o")
    run("estimate", "l.csv", *arguments)  # a setting of the tire within the method


@pytest.mark.long
def test_a_drive_is_simulated_read_and_estimated(run, tmp_path):
    options = ("--duration", "6", "--bend", "0.5", "--seed", "2")
    said = run("simulate", "drive", "--out", "d.csv", "--truth", "t.csv", *options)
    assert "300 rows" in said.stdout and "omega_rr" in said.stdout
    lines = (tmp_path / "d.csv").read_text().splitlines()
    lines[200] = lines[200].replace(lines[200].split(",")[2], "", 1)
    (tmp_path / "d.csv").write_text("\n".join(lines) + "\n")
    run("estimate", "d.csv", "--method", "position,path", "--out", "o")
    rows = rows_of((tmp_path / "o" / "estimates.csv").read_text())
    assert len(rows) == 300 and rows[199]["position_flag"] == "sample missing"
    assert float(rows[-1]["path_C_f"]) > 0 and rows[-1]["path_tlc_std"] != "0.0"
    summary = json.loads((tmp_path / "o" / "summary.json").read_text())
    assert summary["units"]["tlc"] == "s"
    truth = rows_of((tmp_path / "t.csv").read_text())
    assert {row["mu"] for row in truth} == {"0.9"}


def test_missing_inputs_of_a_method_are_named(run):
    """Those of the method, not those of a fit."""
    sample = Path(tirefit.__file__).parent / "samples" / "drive.csv"
    result = run("estimate", sample, "--out", "p", exit_code=3)
    assert "method 'rls' needs sigma_x" in result.stderr


def test_a_log_with_time_backwards_is_refused(run, log):
    header, *rows = log.read_text().splitlines()
    log.write_text("\n".join([header, *rows[::-1]]) + "\n")
    said = run("estimate", log, "--out", "back", exit_code=3).stderr
    assert "the time never increases" in said and "sort the rows by time" in said
