"""Files of tires by their content: what is read, and the name of what is not."""

import re
from pathlib import Path

import numpy as np
import pytest

from tirefit.data.read import read
from tirefit.data.tir.tir import notes_on, read_tir
from tirefit.data.tir.tire_file import tire_kind
from tirefit.door import read_toml
from tirefit.fitting.predict import predict
from tirefit.fitting.source import given_tire
from tirefit.results import DataError, UsageError
from tirefit.targets.export import export

FOLDER = Path(__file__).parent / "tir"
MF52 = FOLDER / "mfeval_julia/MagicFormula52_Parameters.tir"
ROWS = {"sigma_x": [0.02, 0.1, -0.05], "alpha": [0.05, -0.02, 0.1], "fz": [3000.0, 5000.0, 7000.0]}

HEAD = "[MDI_HEADER]\nFILE_TYPE = 'tir'\n[UNITS]\nLENGTH = 'mm'\n[MODEL]\n"
FORMAT = HEAD + "PROPERTY_FILE_FORMAT = '{}'\n[DIMENSION]\nUNLOADED_RADIUS = 326\n"
OTHERS = {
    "pac89.tir": (FORMAT.format("PAC89"), "model PAC89", 6),
    "fiala.tir": (FORMAT.format("Fiala"), "model Fiala", 6),
    "mc.tir": (FORMAT.format("PAC_MC"), "model PAC_MC", 6),
    "521.tir": (FORMAT.format("5.2.1"), "model 5.2.1", 6),
    "ua.tir": (FORMAT.format("UATIRE"), "model UATIRE", 6),
    "tmeasy.tir": (FORMAT.format("TMEASY"), "model TMEASY", 6),
}


@pytest.mark.parametrize("name", OTHERS)
def test_tires_of_other_models_are_named(tmp_path, name):
    """The one problem names the model, at every place that takes a tire or data."""
    text, what, row = OTHERS[name]
    path = tmp_path / name
    path.write_text(text)
    uses = [read, given_tire, lambda one: predict(str(one), ROWS)]
    uses += [read_tir] if name.endswith(".tir") else []
    for use in uses:
        with pytest.raises(DataError) as caught:
            use(path)
        (problem,) = caught.value.problems
        assert problem.reason.startswith("this is a ") and what in problem.reason
        assert (problem.file, problem.row) == (str(path), row)
        assert "FNOMIN" not in str(caught.value) and "table of slip" in problem.remedy


@pytest.mark.parametrize("above", ["", "// mine\n", "/* mine */ ", "# mine\n"])
def test_json_with_comments_is_not_called_no_json(tmp_path, above):
    path = tmp_path / "fit.json"
    path.write_text(above + '{\n  // mine\n  "schema": "tirefit.fit/1"\n}\n')
    with pytest.raises(DataError, match="JSON with comments or a fault, which tirefit did not"):
        given_tire(path)
    with pytest.raises(DataError, match="this is JSON or a file of settings"):
        read(path)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("log.csv", "alpha,fy,fz\n0.1,800,4000\n"),
        ("fit.json", '{\n "schema": "tirefit.fit/1",\n "model": "brush"\n}\n'),
        ("vehicle.toml", "mass = 1500\n[columns]\ntime = 't'\n"),
    ],
)
def test_another_file_in_the_place_of_a_tir_gets_no_advice_to_add_coefficients(
    tmp_path, name, text
):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(DataError) as caught:
        read_tir(path)
    (problem,) = caught.value.problems
    assert problem.reason.startswith("this is no .tir file") and "add" not in problem.remedy


def test_settings_in_the_place_of_data_are_named(tmp_path):
    path = tmp_path / "vehicle.toml"
    path.write_text("mass = 1500\n[columns]\ntime = 't'\n")
    with pytest.raises(DataError, match="file of settings, and no table"):
        read(path)


@pytest.mark.parametrize(("name", "remedy"), [("fit.json", "give a TOML"), ("a.toml", "correct")])
def test_another_file_in_the_place_of_settings_is_named(tmp_path, name, remedy):
    path = tmp_path / name
    path.write_text('{"schema": "tirefit.fit/1"}')
    with pytest.raises(UsageError) as caught:
        read_toml(path)
    assert caught.value.problems[0].remedy.startswith(remedy)


def test_a_tir_in_the_place_of_data_is_named(tmp_path):
    with pytest.raises(DataError, match="Magic Formula coefficients, which describes a tire"):
        read(MF52)


def infofile():
    """The file of MF 5.2 as an infofile of CarMaker."""
    group, lines = "", ["#INFOFILE1.1 - Do not remove this line!", "FileIdent = CarMaker-Tire-MF 2"]
    lines += ["Description:", "\tLat.PDY1 = 7 is text here", ""]
    names = {"VERTICAL": "Vertical", "LONGITUDINAL_COEFFICIENTS": "Long"}
    names |= {"LATERAL_COEFFICIENTS": "Lat", "ALIGNING_COEFFICIENTS": "Align"}
    for line in MF52.read_text().splitlines():
        if section := re.match(r"\[(\w+)\]", line):
            group = names.get(section[1], section[1].title())
        elif group != "Units" and (found := re.match(r"(\w+)\s*=\s*([-+.\deE]+)", line)):
            lines.append(f"{group}.{found[1]} = {found[2]}")
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("name", ["tire", "tire.tir"])
def test_an_infofile_of_carmaker_is_the_tire_of_its_coefficients(tmp_path, name):
    path = tmp_path / name
    path.write_text(infofile())
    assert "Vertical.FNOMIN = " in infofile() and tire_kind(str(path)) == "tir"
    found, expected = predict(path, ROWS), predict(MF52, ROWS)
    for force in ("fx", "fy", "mz"):
        np.testing.assert_array_equal(found[force], expected[force])
    tir = read_tir(path)
    assert "infofile of CarMaker, in SI units" in " ".join(notes_on(tir))
    changed = tir.with_values({"PDY1": 0.5})
    assert changed.numbers["PDY1"] == 0.5 and "Lat.PDY1 = 0.5\n" in changed.text
    with pytest.raises(UsageError, match="PEY5 is not a key of the file"):
        tir.with_values({"PEY5": 0.1})
    export(path, "tir", tmp_path / "out.tir")
    assert "[VERTICAL]" in (tmp_path / "out.tir").read_text()
    for force, values in predict(tmp_path / "out.tir", ROWS).items():
        np.testing.assert_allclose(values, expected[force], rtol=1e-12)


def test_the_kind_of_a_tire_is_that_of_its_content(tmp_path):
    assert [tire_kind(one) for one in ("brush", "no.json", "no.TIR", "no.csv")] == [
        "", "fit", "tir", "",
    ]  # fmt: skip
    table = tmp_path / "brush"
    table.write_text("kappa,fx,fz\n0.1,2,3\n")
    assert tire_kind(str(table)) == ""
    (tmp_path / "mine").write_bytes(MF52.read_text().encode("utf-16"))
    assert tire_kind(str(tmp_path / "mine")) == "tir"


def test_a_failed_check_of_an_export_is_its_outcome(tmp_path):
    """Without the ellipse that FE_METHOD asks for, the truck's F_y does not fall with kappa."""
    truck = FOLDER / "chrono/335_65R22_5_G275MSA_60psi.tir"
    plain = tmp_path / "plain.tir"
    plain.write_text(re.sub(r"(?m)^FE_METHOD.*$", "", truck.read_text()))
    both = {"with_ellipse": truck, "without": plain}
    sound, failed = (export(f, "numpy", tmp_path / f"{name}.py") for name, f in both.items())
    assert sound.status == "ok" and not sound.shape.failed
    assert failed.status == "unsound" and "NOT within 1.05 of it" in failed.warnings[0]
