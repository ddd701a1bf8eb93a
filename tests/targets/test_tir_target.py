"""Tire property files and Chrono's JSON, read like their programs read them."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import tirefit
from tirefit.cli.commands import app
from tirefit.data.tir.tir import read_tir, reduced_tir
from tirefit.fitting.tir import own_tire
from tirefit.models import MODELS, TireInputs, forces
from tirefit.params import with_values
from tirefit.results import UsageError
from tirefit.slip import sigma_from_kappa

TIR = Path("tests/data/tir/mfeval_julia")
WHEEL = {
    "mass": 9.0,
    "ixx": 0.4,
    "iyy": 0.7,
    "vertical_stiffness": 2e5,
    "vertical_damping": 50.0,
    "width": 0.2,
}

KAPPA, ALPHA, LOAD = (
    axis.ravel()
    for axis in np.meshgrid(
        [-0.3, -0.02, 0.0, 0.05, 0.4], [-0.2, 0.0, 0.03], [2e3, 5e3, 9e3], indexing="ij"
    )
)


def given_by(tire, kappa=KAPPA, alpha=ALPHA, load=LOAD):
    at = TireInputs(sigma_from_kappa(-kappa), alpha, load, 16.0)
    found = forces(tire, at)
    return np.stack([-np.asarray(found.fx), -np.asarray(found.fy)], axis=1)


def brush_in(path):
    """c_p a^2 and mu of a brush by the reduced file: PKX1 FNOMIN = 2 c_p a^2, PDX1 = mu."""
    numbers = read_tir(path).numbers
    return {"cpa2": numbers["PKX1"] * numbers["FNOMIN"] / 2, "mu": numbers["PDX1"]}


def missed(one, other):
    return np.max(np.abs(given_by(one) - given_by(other)) / LOAD[:, None])


@pytest.mark.parametrize("version", ["52", pytest.param("61", marks=pytest.mark.long), "62"])
def test_a_rewritten_file_keeps_its_forces(version, tmp_path):
    source = TIR / f"MagicFormula{version}_Parameters.tir"
    done = tirefit.export(source, "tir", tmp_path / "t.tir")
    text = done.path.read_text()
    assert text.startswith("$ written by tirefit export") and "largest error" not in text
    assert text.endswith(source.read_text())
    assert missed(own_tire(read_tir(done.path)), own_tire(read_tir(source))) == 0


def test_given_values_are_in_the_file(tmp_path):
    source, path = TIR / "MagicFormula61_Parameters.tir", tmp_path / "t.tir"
    tirefit.export(source, "tir", path, values={"PDX1": 0.5})
    assert read_tir(path).numbers["PDX1"] == 0.5


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """A Magic Formula fitted to F_y, and the file of the fit."""
    angle, load = (np.tile(np.linspace(-0.2, 0.2, 41), 2), np.repeat([3000.0, 6000.0], 41))
    source = own_tire(read_tir(TIR / "MagicFormula61_Parameters.tir"))
    force = np.asarray(forces(source, TireInputs(0.0, angle, load)).fy)
    force = force + 20 * np.random.default_rng(1).standard_normal(82)
    fit = tirefit.fit_magic_formula({"alpha": angle, "fz": load, "fy": force}, "mf61")
    folder = tmp_path_factory.mktemp("fit")
    fit.save(folder)
    return fit, folder / "fit.json"


def test_a_fitted_magic_formula_keeps_errors_and_range(fitted, tmp_path):
    fit = fitted[0]
    for given in fitted:
        done = tirefit.export(given, "tir", tmp_path / "t.tir")
        read = read_tir(done.path)
        assert missed(own_tire(read), fit.tire) < 1e-9
        line = next(x for x in done.path.read_text().splitlines() if "PDY1 " in x)
        std = fit.coefficients["PDY1"].std
        assert float(line.split("+-")[1]) == pytest.approx(std, rel=0.01)
        assert read.numbers["FZMAX"] == 6000 and read.numbers["ALPMIN"] == -0.2


def test_a_fitted_magic_formula_is_exported_as_source_code(fitted, tmp_path):
    fit = fitted[0]
    wanted = given_by(fit.tire)[:, 1]
    for given in fitted:
        done = tirefit.export(given, "numpy", tmp_path / "tire.py")
        exec(done.path.read_text(), code := {})
        found = dict(zip(("fx", "fy"), code["tire"](KAPPA, ALPHA, LOAD), strict=False))
        assert np.max(np.abs(found["fy"] - wanted) / LOAD) < 1e-9
        assert any("fx was not fitted" in note for note in done.notes)
        std = fit.coefficients["PDY1"].std
        line = next(x for x in done.path.read_text().splitlines() if "PDY1 =" in x)
        assert float(line.split("+-")[1].split()[0]) == pytest.approx(std, rel=0.06)


def test_a_brush_is_reduced_with_reported_losses(tmp_path):
    slip = np.linspace(-0.1, 0.25, 60)
    force = np.asarray(forces(MODELS["brush"], TireInputs(slip, 0.0, 4000.0)).fx)
    force = force + 20 * np.random.default_rng(1).standard_normal(60)
    data = {"sigma_x": slip, "fz": np.full(60, 4000.0), "fx": force}
    fit = tirefit.fit(data, "brush")
    path = tmp_path / "t.tir"
    with pytest.raises(UsageError, match="limit is 5%"):
        tirefit.export(fit, "tir", path, wheel={"radius": 0.3})
    done = tirefit.export(fit, "tir", path, wheel={"radius": 0.3}, force=True)
    values = brush_in(path)
    assert values["mu"] == pytest.approx(fit.least_squares["mu"].value, rel=1e-12)
    assert values["cpa2"] == pytest.approx(fit.least_squares["cpa2"].value, rel=1e-12)
    told = next(note for note in done.notes if "largest error" in note)
    head = path.read_text().partition("[MDI_HEADER]")[0]
    # What is kept is stated with its errors, and no moment that the file lacks.
    assert f"cpa2 = {fit.least_squares['cpa2'].value:.8g} +- " in " ".join(head.split("\n$  "))
    assert "mz of the tire is not included" in head
    assert "mz was not fitted" not in head and "aligning moment" not in head
    slip = np.linspace(-0.1, 0.25, 400)
    own, read = (
        np.asarray(forces(tire, TireInputs(slip, 0.0, 4000.0)).fx)
        for tire in (with_values(MODELS["brush"], values), own_tire(read_tir(path)))
    )
    worst = 100 * np.max(np.abs(own - read)) / 4000.0
    assert float(told.split("fx ")[1].split("%")[0]) == pytest.approx(worst, abs=0.1)


def test_the_loss_of_a_force_without_measured_slip_is_over_usual_slips(tmp_path):
    """A fit to fy alone: the file has fx too, by the same c_p a^2 and mu."""
    slip = np.linspace(-0.2, 0.2, 60)
    force = np.asarray(forces(MODELS["brush"], TireInputs(0.0, slip, 4000.0)).fy)
    force = force + 20 * np.random.default_rng(1).standard_normal(60)
    fit = tirefit.fit({"alpha": slip, "fz": np.full(60, 4000.0), "fy": force}, "brush")
    path = tmp_path / "t.tir"
    done = tirefit.export(fit, "tir", path, wheel={"radius": 0.3}, force=True)
    told = next(note for note in done.notes if "largest error" in note)
    own, read = with_values(MODELS["brush"], brush_in(path)), own_tire(read_tir(path))
    kappa = np.linspace(-0.3, 0.3, 400)
    at = TireInputs(sigma_from_kappa(kappa), 0.0, 4000.0)
    worst = 100 * np.max(np.abs(np.asarray(forces(own, at).fx - forces(read, at).fx))) / 4000.0
    assert worst > 3 and "kappa -0.3 to 0.3" in told
    pure = float(told.split("fx ")[1].split("in pure slip ")[1].split("%")[0])
    assert pure == pytest.approx(worst, abs=0.2)  # between the points of the grid


def test_unsupported_models_are_refused_and_write_nothing(tmp_path):
    path = tmp_path / "t.tir"
    for source, asked, words in (
        ("brush", {}, "radius"),
        ("brush", {"wheel": {"radius": 0.3}}, "limit is 5%"),
        ("magic-formula", {}, "not magic-formula"),
        ("brush", {"model": "mf6"}, "did you mean"),
        ("brush", {"wheel": {"radus": 0.3}}, "did you mean"),
        ("brush", {"convention": "sae"}, "leave it out"),
    ):
        with pytest.raises(UsageError, match=words):
            tirefit.export(source, "tir", path, **asked)
    with pytest.raises(UsageError, match="does not use it"):
        tirefit.export("brush", "c", tmp_path / "t.h", wheel={"radius": 0.3})
    assert not path.exists()
    tirefit.export("brush", "tir", path, wheel={"radius": 0.3}, force=True)
    assert brush_in(path)["mu"] == 1.0


@pytest.mark.parametrize("model", ["mf52", "mf61", pytest.param("mf62", marks=pytest.mark.long)])
def test_the_reduced_form_has_the_slopes_and_the_limit_in_every_version(model, tmp_path):
    path, values = tmp_path / "t.tir", {"cpa2": 3e4, "mu": 0.4}
    wheel = {"radius": 0.3}
    tirefit.export("brush", "tir", path, values=values, model=model, wheel=wheel, force=True)
    read = read_tir(path)
    tire, fz = own_tire(read), read.numbers["FNOMIN"]
    assert read.version == f"{model[2]}.{model[3]}"
    for slip, name in (("sigma_x", "fx"), ("alpha", "fy")):
        for at, wanted in ((1e-6, 2 * 3e4 * 1e-6), (0.9, 0.4 * fz)):
            given = TireInputs(fz=fz)._replace(**{slip: at})
            found = float(getattr(forces(tire, given), name))
            assert found == pytest.approx(wanted, rel=1e-2 if at > 0.1 else 1e-4)


def test_chrono_accepts_a_brush(tmp_path):
    path, wheel = tmp_path / "wheel.json", WHEEL | {"radius": 0.3, "friction": 0.9}
    tirefit.export("brush", "chrono", path, wheel=wheel, force=True)
    values = chrono_values(path.with_suffix(".tir"))
    assert values["MODEL", "FITTYP"] == "6" and values["MODEL", "FE_METHOD"] == "NO"
    assert json.loads(path.read_text())["Coefficient of Friction"] == 0.9


def test_another_version_of_a_magic_formula_is_refused(tmp_path):
    source = TIR / "MagicFormula62_Parameters.tir"
    with pytest.raises(UsageError, match=r"the tire is a Magic Formula 6\.2(.|\n)*predict"):
        tirefit.export(source, "tir", tmp_path / "t.tir", model="mf61", force=True)


# --- Project Chrono -----------------------------------------------------------------


def test_a_moment_that_is_zero_everywhere_is_fitted():
    """That of the reduced form of a brush, which gives the fit no size of its noise."""
    tir = reduced_tir(cpa2=5e4, mu=0.9, fz=4000.0, radius=0.3)
    rows = TireInputs(0.0, np.linspace(-0.3, 0.3, 41), np.full(41, 4000.0), np.full(41, 16.0))
    of_tire = forces(own_tire(tir), rows)
    table = {"alpha": rows.alpha, "fz": rows.fz, "v": rows.v, "fy": np.asarray(of_tire.fy)}
    data = tirefit.read_frame(table)
    data = replace(data, columns={**data.columns, "mz": np.asarray(of_tire.mz)})
    fit = tirefit.fit_magic_formula(data, "mf52", part="mz", leave_out="none")
    at = TireInputs(sigma_from_kappa(KAPPA), ALPHA, 4000.0, 16.0)
    assert np.max(np.abs(forces(fit.tire, at).mz)) < 1e-6  # N m; the rows have zero


def chrono_values(path):
    """Values read by ChPac02Tire of Project Chrono: keys by section, up to a blank."""
    found, section = {}, ""
    for line in path.read_text().splitlines():
        line = line.lstrip(" \t")
        assert len(line) < 199  # longer lines are cut
        if not line or line[0] in "!$":
            continue
        if line[0] == "[":
            section = line[1 : line.index("]")]
            continue
        key, _, value = line.split("$")[0].partition("=")
        found[section, key.split(" ")[0]] = value.strip().strip("'")
    return found


def of_chrono(values, kappa, alpha, fz):
    """F_x and F_y of ChPac02Tire, upright, at nominal pressure, scaling factors 1."""
    p = {key: float(v) for (_, key), v in values.items() if key not in TEXTS}
    dfz, arctan = fz / p["FNOMIN"] - 1, np.arctan

    def bent(x, e):
        return arctan(x - min(e, 1.0) * (x - arctan(x)))

    def limited(x):
        return np.clip(x, -np.pi / 2 + 0.01, np.pi / 2 - 0.01)

    slip = kappa + p["PHX1"] + p["PHX2"] * dfz
    ex = p["PEX1"] + p["PEX2"] * dfz + p["PEX3"] * dfz**2
    ex *= 1 - p["PEX4"] * np.sign(slip)
    dx = (p["PDX1"] + p["PDX2"] * dfz) * fz
    kx = fz * (p["PKX1"] + p["PKX2"] * dfz) * np.exp(p["PKX3"] * dfz)
    x = limited(kx / (p["PCX1"] * dx + 0.1) * slip)
    fx = dx * np.sin(p["PCX1"] * bent(x, ex)) + fz * (p["PVX1"] + p["PVX2"] * dfz)
    angle = alpha + p["PHY1"] + p["PHY2"] * dfz
    ey = (p["PEY1"] + p["PEY2"] * dfz) * (1 - p["PEY3"] * np.sign(angle))
    dy = abs(p["PDY1"] + p["PDY2"] * dfz) * fz
    ky = p["PKY1"] * p["FNOMIN"] * np.sin(2 * arctan(fz / p["PKY2"] / p["FNOMIN"]))
    y = limited(ky / (p["PCY1"] * dy + 0.1) * angle)
    fy = dy * np.sin(p["PCY1"] * bent(y, ey)) + fz * (p["PVY1"] + p["PVY2"] * dfz)
    bxa = abs(p["RBX1"] * np.cos(arctan(p["RBX2"] * kappa)))
    byk = p["RBY1"] * np.cos(arctan(p["RBY2"] * (alpha - p["RBY3"])))
    gx, gy = (
        np.cos(c * arctan(b * (s + h))) / np.cos(c * arctan(b * h))
        for c, b, s, h in ((p["RCX1"], bxa, alpha, p["RHX1"]), (p["RCY1"], byk, kappa, p["RHY1"]))
    )
    induced = dy * (p["RVY1"] + p["RVY2"] * dfz) * np.cos(arctan(p["RVY4"] * alpha))
    return fx * gx, fy * gy + induced * np.sin(p["RVY5"] * arctan(p["RVY6"] * kappa))


TEXTS = {
    "FILE_TYPE", "FILE_FORMAT", "LENGTH", "FORCE", "ANGLE", "MASS", "TIME",
    "PROPERTY_FILE_FORMAT", "TYRESIDE", "FE_METHOD",
}  # fmt: skip


def test_chrono_reads_both_files_and_reproduces_the_forces(tmp_path):
    source = TIR / "MagicFormula52_Parameters.tir"
    # Coefficients that Chrono does not read.
    unread = dict.fromkeys("PDX3 REX1 REX2 REY1 REY2 RHY2".split(), 0.0)
    path = tmp_path / "wheel.json"
    tirefit.export(source, "chrono", path, values=unread, wheel=WHEEL)
    content = json.loads(path.read_text())
    assert content["Type"] == "Tire" and content["Template"] == "Pac02Tire"
    assert content["Mass"] == 9.0 and content["Inertia"] == [0.4, 0.7, 0.4]
    assert content["Coefficient of Friction"] == 0.8
    values = chrono_values(tmp_path / content["TIR Specification File"])
    assert values["MODEL", "PROPERTY_FILE_FORMAT"] == "PAC2002"
    assert values["MODEL", "USE_MODE"] == "4" and values["MODEL", "FE_METHOD"] == "NO"
    assert float(values["VERTICAL", "VERTICAL_STIFFNESS"]) == 2e5
    tire = own_tire(read_tir(source), values=unread)
    for kappa, alpha, fz in (
        (0.02, 0.0, 9e3),
        (0.0, 0.05, 5e3),
        (-0.04, 0.03, 12e3),
        (0.05, -0.1, 9e3),
    ):
        wanted = given_by(tire, np.array([kappa]), np.array([alpha]), np.array([fz]))
        found = of_chrono(values, kappa, alpha, fz)
        assert np.max(np.abs(found - wanted[0])) < 1e-4 * fz


def test_limits_of_chrono_are_reported(tmp_path):
    source, path = TIR / "MagicFormula52_Parameters.tir", tmp_path / "wheel.json"
    with pytest.raises(UsageError, match="limit is 5%"):
        tirefit.export(source, "chrono", path, wheel=WHEEL)
    done = tirefit.export(source, "chrono", path, wheel=WHEEL, force=True)
    told = "\n".join(done.notes)
    assert "does not read PDX3, REX1, REX2, REY1, REY2, RHY2" in told
    assert "limits B times the slip to 1.56" in told
    # At a large load the force stays the same beyond the limit, and that of the file does not.
    values = chrono_values(path.with_suffix(".tir"))
    tire = own_tire(read_tir(path.with_suffix(".tir")))
    kappa, fz = np.array([0.25, 0.3]), np.full(2, 1.5 * tire.nominal.FNOMIN)
    of_file = [of_chrono(values, *row)[0] for row in zip(kappa, 0 * kappa, fz, strict=True)]
    assert of_file[0] == of_file[1]
    assert np.ptp(given_by(tire, kappa, 0 * kappa, fz)[:, 0]) > 0.001 * fz[0]


def test_chrono_files_are_written_both_or_not_at_all(tmp_path):
    source, path = TIR / "MagicFormula52_Parameters.tir", tmp_path / "wheel.json"
    beside = path.with_suffix(".tir")
    line = ["export", str(source), "--to", "chrono", "--out", str(path)]
    done = CliRunner().invoke(app, line)
    assert done.exit_code == 2 and "--wheel mass=..." in done.stderr
    for name, value in WHEEL.items():
        line += ["--wheel", f"{name}={value}"]
    beside.write_text("mine")
    done = CliRunner().invoke(app, line)
    assert done.exit_code == 2 and "is not an export, or was changed since" in done.stderr
    assert beside.read_text() == "mine" and not path.exists()
    done = CliRunner().invoke(app, [*line, "--force"])
    # At twice the largest load the forces of this file exceed the ellipse.
    assert done.exit_code == 4 and "NOT within 1.05 of it" in done.stderr
    assert path.exists() and "written by tirefit export" in beside.read_text()
    done = CliRunner().invoke(app, ["export", "--list"])
    assert "chrono " in done.stdout and "tir " in done.stdout
