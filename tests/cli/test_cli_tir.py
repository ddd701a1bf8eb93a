"""``tirefit predict FILE.tir``."""

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest

from tirefit.slip import CONVENTIONS

FOLDER = Path(__file__).parents[1] / "data" / "tir"
MF52, MF61 = (FOLDER / f"mfeval_julia/MagicFormula{number}_Parameters.tir" for number in (52, 61))
TRUCK = FOLDER / "chrono/335_65R22_5_G275MSA_60psi.tir"
ISO = ("--convention", "iso-w", "--out", "out.csv")


def points_of(tir, angles="raw"):
    """Reference rows of a file, written as points; and their forces."""
    with open(FOLDER / "reference.csv") as file:
        rows = [
            row
            for row in csv.DictReader(file)
            if row["tir"].endswith(tir.name) and row["angles"] == angles
        ]
    names = ["kappa", "alpha", "gamma", "fz", "v", "p"]
    lines = [",".join(row[name] for name in names) for row in rows]
    Path("points.csv").write_text("\n".join(["kappa,alpha,gamma,fz,v,pressure", *lines]) + "\n")
    return rows


def predicted():
    with open("out.csv") as file:
        rows = list(csv.DictReader(file))
    return {key: np.array([float(row[key] or "nan") for row in rows]) for key in rows[0]}


def assert_reference(rows):
    found = predicted()
    assert list(found)[-5:] == ["fx", "fy", "mz", "mx", "my"]
    for name, share in (("fx", 2e-8), ("fy", 2e-8), ("mz", 2e-9)):
        for row, value in zip(rows, found[name], strict=True):
            if row[name]:
                wanted = float(row[name])
                least = share * float(row["fz"])
                assert abs(value - wanted) <= 2e-6 * abs(wanted) + least


@pytest.mark.parametrize(
    ("path", "angles", "options"),
    [(MF52, "raw", ()), (MF61, "raw", ()), (MF61, "star", ("--starred-angles",))],
)
def test_predictions_agree_with_the_reference(run, path, angles, options):
    rows = points_of(path, angles)
    result = run("predict", path, "points.csv", *options, *ISO)
    assert_reference(rows)
    assert f"wrote out.csv: {len(rows)} rows, kappa, alpha, gamma" in result.stdout
    assert re.search(r"Magic Formula (5\.2|6\.1), TYRESIDE", result.stdout)
    if path == MF52:  # whose reference has no pressure
        assert np.isnan(predicted()["pressure"]).all()


def test_a_tir_file_is_in_iso_w(run):
    rows = points_of(MF61)
    result = run("predict", MF61, "points.csv", "--out", "out.csv")
    assert "(convention iso-w, assumed" in result.stdout
    assert_reference(rows)


def test_unused_keys_and_rows_outside_the_ranges_are_reported(run):
    rows = points_of(TRUCK)
    driven = sum(float(row["kappa"]) > 0 for row in rows)
    result = run("predict", TRUCK, "points.csv", *ISO)
    assert "FE_METHOD" in result.stderr
    said = f"{driven} of {len(rows)} rows outside KPUMIN = -0.8 to KPUMAX = 0"
    assert driven > 2 and said in result.stderr


def test_the_other_side_is_mirrored(run, tmp_path):
    (tmp_path / "points.csv").write_text(
        "kappa,alpha,gamma,fz\n0.1,0.05,0.02,5000\n0.1,-0.05,-0.02,5000\n"
    )
    run("predict", MF61, "points.csv", "--side", "right", *ISO)
    right = predicted()
    result = run("predict", MF61, "points.csv", "--side", "left", *ISO)
    left = predicted()
    assert "TYRESIDE RIGHT, mounted left" in result.stdout
    np.testing.assert_allclose(left["fx"], right["fx"][::-1], rtol=1e-13)
    np.testing.assert_allclose(left["fy"], -right["fy"][::-1], rtol=1e-13)
    np.testing.assert_allclose(left["mz"], -right["mz"][::-1], rtol=1e-13)
    assert abs(left["fy"] - right["fy"]).max() > 10
    result = run("predict", MF52, "points.csv", "--side", "left", *ISO, exit_code=2)
    assert "TYRESIDE is not stated" in result.stderr


def test_coefficients_can_be_set(run, tmp_path):
    (tmp_path / "points.csv").write_text("kappa,alpha,gamma,fz\n-0.5,0,0,5000\n")
    run("predict", MF61, "points.csv", "--set", "LMUX=0.5", "--set", "PVX1=0", *ISO)
    half = predicted()["fx"]
    run("predict", MF61, "points.csv", "--set", "PVX1=0", *ISO)
    assert 0.45 < half[0] / predicted()["fx"][0] < 0.55
    result = run("predict", MF61, "points.csv", "--set", "PXX=1", *ISO, exit_code=2)
    assert "no parameter 'PXX'" in result.stderr


def test_bad_files_and_options_are_refused(run, tmp_path):
    points_of(MF61)
    text = re.sub(r"(?m)^(FITTYP *= +)61", r"\g<1>99", MF61.read_text())
    text = re.sub(r"(?m)^FNOMIN .*\n", "", text)
    Path("bad.tir").write_text(text)
    result = run("predict", "bad.tir", "points.csv", *ISO, exit_code=3)
    for word in ("error", "bad.tir", "FITTYP = 99", "FNOMIN is missing", "remedy: add it"):
        assert word in result.stderr
    assert not Path("out.csv").exists()
    result = run("predict", "none.tir", "points.csv", *ISO, exit_code=3)
    assert "none.tir: cannot read it" in result.stderr
    result = run("predict", "brush", "points.csv", "--side", "left", *ISO, exit_code=2)
    assert "--side" in result.stderr
    Path("own.tir").write_text(MF61.read_text())
    options = ("--convention", "iso-w", "--out", "own.tir")
    result = run("predict", "own.tir", "points.csv", *options, exit_code=2)
    assert "the output is a CSV" in result.stderr
    # The friction falls with the slip speed: the speed of every row is needed.
    Path("slow.tir").write_text(
        MF61.read_text().replace("[SCALING_COEFFICIENTS]", "[SCALING_COEFFICIENTS]\nLMUV = 0.1")
    )
    Path("points.csv").write_text("kappa,alpha,fz\n0.1,0.1,4000\n")
    result = run("predict", "slow.tir", "points.csv", *ISO, exit_code=3)
    assert "needs v (forward speed" in result.stderr


def signed_points(convention):
    """The same points of a tire, as numbers in a file of this convention."""
    signs = CONVENTIONS[convention]
    rows = [
        (k, a, g, signs.fz * fz)
        for k, a, g in ((0.05, 0.06, 0.03), (-0.1, -0.02, 0.03), (0.2, 0.1, -0.05))
        for fz in (2000.0, 5000.0)
    ]
    lines = [",".join(map(str, row)) for row in rows]
    Path("points.csv").write_text("\n".join(["kappa,alpha,gamma,fz", *lines]) + "\n")


@pytest.mark.parametrize("convention", sorted(set(CONVENTIONS) - {"iso-w"}))
def test_data_and_tire_with_the_same_signs_give_the_values_of_iso_w(run, convention):
    """For any name of the signs: a Magic Formula maps numbers to numbers."""
    signed_points("iso-w")
    run("predict", MF61, "points.csv", *ISO)
    wanted = predicted()
    signed_points(convention)
    options = ("--convention", convention, "--signs", convention, "--out", "out.csv")
    result = run("predict", MF61, "points.csv", *options)
    assert f"in signs {convention}" in result.stdout
    assert f"(convention {convention}, as declared)" in result.stdout
    for name in ("fx", "fy", "mz"):
        np.testing.assert_allclose(predicted()[name], wanted[name], rtol=1e-9)


def test_signs_option_is_only_for_tir_files(run):
    points_of(MF61)
    for command in (
        ("predict", "brush", "points.csv", "--out", "o.csv"),
        ("diagnose", "points.csv", "--model", "brush", "--out", "o"),
        ("convert", "--magic-formula", "10,1.5,1,0", "--loads", "4000", "--out", "o"),
        ("brake", "--tire", "brush", "--out", "o"),
    ):
        assert "--signs" in run(*command, "--signs", "sae", exit_code=2).stderr
    result = run("predict", MF61, "points.csv", "--signs", "sea", *ISO, exit_code=2)
    assert "did you mean 'sae'" in result.stderr


def test_signs_stated_in_a_data_file_override_those_of_the_tire(run):
    """Braking positive, F_x only: the other sign would be accepted as well."""
    text = "# tirefit 0.1: convention braking\nkappa,fz\n0.1,4000\n-0.2,4000\n"
    Path("points.csv").write_text(text)
    result = run("predict", MF61, "points.csv", "--out", "out.csv")
    assert "(convention braking, stated in line 1, not as 'iso-w'" in result.stdout
    said = predicted()["fx"]
    Path("points.csv").write_text("kappa,fz\n-0.1,4000\n0.2,4000\n")
    run("predict", MF61, "points.csv", *ISO)
    np.testing.assert_allclose(said, -predicted()["fx"], rtol=1e-12)
    Path("points.csv").write_text(text)
    result = run("predict", MF61, "points.csv", *ISO, exit_code=3)
    assert "--convention iso-w contradicts the file" in result.stderr
    assert "'braking': kappa" in result.stderr and "leave out" in result.stderr


def without_combined(path):
    """A file as truck makers write it: PAC2002, no FITTYP, no combined slip."""
    text = re.sub(r"(?m)^(R[BCEHV][XY]\d|FITTYP|PROPERTY_FILE_FORMAT) .*\n", "", path.read_text())
    new = "[MODEL]\nPROPERTY_FILE_FORMAT ='PAC2002'\n"
    Path("plain.tir").write_text(text.replace("[MODEL]\n", new))
    lines = ["-0.1,0,4000", "0,0.1,4000", "-0.1,0.1,4000", "-0.1,-0.1,4000"]
    Path("points.csv").write_text("\n".join(["kappa,alpha,fz", *lines]) + "\n")


def test_missing_combined_slip_coefficients_are_reported_and_replaced(run):
    without_combined(MF52)
    said = run("predict", "plain.tir", "points.csv", *ISO).stderr
    assert "PROPERTY_FILE_FORMAT = 'PAC2002', and no FITTYP" in said
    assert "2 of 4 rows with both slips: F_x and F_y by the method of similarity" in said
    similar = predicted()
    size = np.hypot(similar["fx"], similar["fy"])
    said = run("predict", "plain.tir", "points.csv", "--combination", "none", *ISO).stderr
    assert "F_x and F_y as in pure slip: the weighting function is one" in said
    alone = predicted()
    np.testing.assert_allclose(alone["fx"][2:], alone["fx"][0], rtol=1e-12)
    np.testing.assert_allclose(alone["fx"][0], similar["fx"][0], atol=1e-3)
    np.testing.assert_allclose(alone["fy"][1], similar["fy"][1], atol=1e-3)
    assert (np.hypot(alone["fx"], alone["fy"])[2:] > 1.15 * size[2:]).all()
    # Rows of one slip do not depend on it, and a whole file says nothing.
    Path("points.csv").write_text("kappa,alpha,fz\n" + 4 * "-0.1,0,4000\n")
    Path("out.csv").unlink()  # other columns
    assert "slips" not in run("predict", "plain.tir", "points.csv", *ISO).stderr
    Path("out.csv").unlink()
    points_of(MF61)
    assert "slips" not in run("predict", MF61, "points.csv", *ISO).stderr
    values = ("--set", "RBX1=10", "--set", "RCX1=1")
    Path("out.csv").unlink()
    without_combined(MF52)
    said = run("predict", "plain.tir", "points.csv", *values, *ISO).stderr
    assert "both slips: F_y by the method" in said
    given = run("predict", "brush", "points.csv", "--combination", "none", *ISO, exit_code=2)
    assert "--combination with brush\n" in given.stderr


def test_zeros_of_a_file_are_kept_and_reported(run):
    """RCY1 = 0 is kept unless the user requests a replacement."""
    Path("points.csv").write_text("kappa,alpha,fz\n-0.1,0.1,20000\n")
    said = run("predict", TRUCK, "points.csv", "--combination", "none", *ISO).stderr
    assert "1 of 1 rows with both slips: F_y as in pure slip" in said
    plain = predicted()
    said = run("predict", TRUCK, "points.csv", *ISO).stderr
    assert "1 of 1 rows with both slips: F_x and F_y by the friction ellipse" in said
    assert abs(predicted()["fy"]) < abs(plain["fy"])
    said = run("predict", TRUCK, "points.csv", "--combination", "similarity", *ISO)
    assert "F_x and F_y by the method of similarity" in said.stderr
    assert abs(predicted()["fy"]) < abs(plain["fy"])


def test_missing_forces_of_a_file_are_reported_with_the_reason(run):
    moments = r"(?ms)^\[(OVERTURNING|ROLLING)_COEFF.*?(?=^\[)"
    text = re.sub(moments, "", MF61.read_text())
    text = re.sub(r"(?m)^PDX1 .*", "PDX1 = $unknown", text)
    Path("lateral.tir").write_text(text)
    points_of(MF61)
    said = run("predict", "lateral.tir", "points.csv", *ISO).stderr
    assert "no F_x in this file: PDX1 is missing (the longitudinal friction)" in said
    assert "keys without a value are ignored: PDX1" in said
    lateral = predicted()
    assert "fx" not in lateral
    run("predict", MF61, "points.csv", *ISO)
    np.testing.assert_allclose(lateral["fy"], predicted()["fy"], rtol=1e-12)
    Path("points.csv").write_text("kappa,fz\n-0.1,4000\n")
    run_again = ("predict", "lateral.tir", "points.csv", *ISO)
    assert "computes only fy and mz" in run(*run_again, exit_code=3).stderr
    result = run("convert", "lateral.tir", "--out", "out", exit_code=3)
    assert "no F_x in this file: PDX1 is missing" in result.stderr
    assert "or ask for fy" in result.stderr and not Path("out").exists()


def test_unused_columns_are_reported(run):
    text = re.sub(r"(?m)^(PDY3|PKY3|PHY3|PVY3|PVY4|PEY4) .*\n", "", MF52.read_text())
    Path("own.tir").write_text(text)
    lines = ["0.1,0,0.03,4000,2e5", "0.1,0,0,6000,3e5", "0,0.1,0,4000,2e5"]
    Path("points.csv").write_text("\n".join(["kappa,alpha,gamma,fz,pressure", *lines]) + "\n")
    said = run("predict", "own.tir", "points.csv", *ISO).stderr
    assert "1 of 3 rows with camber, which changes no F_y" in said
    assert "1 of 3 rows with pressure, which changes no force" in said


@pytest.mark.long
def test_a_wheel_brakes_on_a_tire_without_combined_coefficients(run):
    """Its coefficients decide whether it depends on the speed, also when compiled."""
    without_combined(MF52)
    options = ("--vehicle", "quarter", "--speed", 6, "--controller", "none")
    short = ("--road", "mu=0.5", "--time-limit", "0.2")
    said = run("brake", "--tire", "plain.tir", *options, *short, "--out", "out")
    assert "BRAKING plain.tir from 6 m/s" in said.stdout
    assert "wherever both slips act: F_x and F_y by the method of similarity" in said.stderr
    summary = json.loads(Path("out/summary.json").read_text())
    # Shorter than what the pressure's running mean runs over, and than the stop.
    assert 0 < summary["mean_friction_used"] < 1 and not summary["stopped"]
