"""Tire property files: reading, writing, refusals and the reduced file."""

import re
from pathlib import Path

import numpy as np
import pytest

from tirefit.data.read import read
from tirefit.data.tir.tir import notes_on, parse_tir, read_tir, reduced_tir
from tirefit.models import MODELS, TireInputs, forces
from tirefit.models.mf import mf_tire
from tirefit.params import with_values
from tirefit.results import DataError, UsageError

FOLDER = Path(__file__).parent / "tir"
FILES = sorted(FOLDER.glob("*/*.tir"))
MF52, MF61 = (FOLDER / f"mfeval_julia/MagicFormula{number}_Parameters.tir" for number in (52, 61))
TRUCK = FOLDER / "chrono/335_65R22_5_G275MSA_60psi.tir"


def changed(path, *edits):
    """The text of a file with some lines changed once: (pattern, replacement)."""
    text = path.read_text()
    for pattern, replacement in edits:
        text, count = re.subn(pattern, replacement, text, count=1, flags=re.MULTILINE)
        assert count == 1, pattern
    return text


def problems(text):
    with pytest.raises(DataError) as caught:
        parse_tir(text, "x.tir")
    assert all(problem.file == "x.tir" for problem in caught.value.problems)
    assert all(problem.remedy for problem in caught.value.problems)
    return caught.value.problems


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_written_files_equal_the_read_ones(path, tmp_path):
    tir = read_tir(path)
    (tmp_path / "copy.tir").write_text(tir.text)
    assert (tmp_path / "copy.tir").read_bytes() == path.read_bytes()
    assert len(FILES) == 7


def test_values_version_and_side_are_read():
    tir = read_tir(MF61)
    assert (tir.version, tir.side) == ("6.1", "RIGHT")
    known = {
        "FNOMIN": 6752,
        "NOMPRES": 260000,
        "RBY4": 1747.3832,
        "DAMP_VLOW": 0.001,
        "LFZO": 1,
        "PKY1": -28.3155,
        "QSY4": 4e-5,
        "MASS": 17.451,
    }
    assert {key: tir.numbers[key] for key in known} == known
    assert tir.find("MASS", "UNITS").text == "kg"
    assert "PDX3" not in read_tir(TRUCK).numbers
    truck = read_tir(TRUCK)
    assert (truck.version, truck.side) == ("5.2", "UNKNOWN")
    assert truck.numbers["PDY1"] == -0.73151 and truck.numbers["FNOMIN"] == 21674
    assert "0.000" not in truck.numbers  # a row of a table is no key
    notes = " ".join(notes_on(truck))
    assert truck.ellipse and "FE_METHOD" not in notes
    newer = truck.with_values({"FITTYP": 61.0})
    assert not newer.ellipse and "FE_METHOD = 'YES' is not used" in " ".join(notes_on(newer))
    assert notes_on(tir) == []


IN_OTHER_UNITS = (
    ("'meter'", "'mm'"),
    ("'newton'", "'kN'"),
    ("'second'", "'ms'"),
    ("^UNLOADED_RADIUS.*", "UNLOADED_RADIUS = 394.3 $ mm"),
    ("^FNOMIN.*", "FNOMIN = 6.752"),
    ("^FZMAX.*", "FZMAX = 18.0"),
    ("^LONGVL.*", "LONGVL = 16.6"),
    ("^NOMPRES.*", "NOMPRES = 0.00026"),
    ("^INFLPRES.*", "INFLPRES = 0.00026"),
    ("^PRESMIN.*", "PRESMIN = 0.0002"),
    ("^PRESMAX.*", "PRESMAX = 0.0004"),
    ("^VXLOW.*", "VXLOW = 1"),
)


def test_units_are_converted_on_reading_and_writing():
    """In mm, kN and ms: pressures in kN/mm2 = GPa; speeds are unchanged."""
    plain = read_tir(MF61)
    tir = parse_tir(changed(MF61, *IN_OTHER_UNITS))
    for key in ("UNLOADED_RADIUS", "FNOMIN", "FZMAX", "LONGVL", "NOMPRES", "PRESMAX"):
        np.testing.assert_allclose(tir.numbers[key], plain.numbers[key], rtol=1e-14)
    assert tir.numbers["PDX1"] == plain.numbers["PDX1"]
    new = tir.with_values({"UNLOADED_RADIUS": 0.4, "NOMPRES": 2.5e5, "PDX1": 1.2})
    assert new.numbers["UNLOADED_RADIUS"] == 0.4
    lines = zip(tir.lines, new.lines, strict=True)
    differing = [after for before, after in lines if before != after]
    assert [line.split("$")[0].split("=")[1].strip() for line in differing] == [
        "400",
        "0.00025",
        "1.2",
    ]
    assert differing[0] == "UNLOADED_RADIUS = 400 $ mm\n"


def test_pressures_may_have_a_separate_unit():
    edits = [("^TIME .*", "TIME = 'second'\nPRESSURE = 'bar'")]
    edits += [(f"^{key}.*", f"{key} = 2.6") for key in ("NOMPRES", "INFLPRES")]
    assert parse_tir(changed(MF61, *edits)).numbers["NOMPRES"] == 2.6e5


def test_a_changed_file_keeps_all_other_lines():
    own = (r"^\[SHAPE\]", "[MY_OWN]\nMY_KEY = 'kept' $why\n[SHAPE]")
    tir = parse_tir(changed(MF52, own))
    assert tir.find("MY_KEY").text == "kept" and "{radial width}" in tir.text
    new = tir.with_values({"PDX1": 0.5, "LXAL": 0.1})
    assert (new.numbers["PDX1"], new.numbers["LXAL"]) == (0.5, 0.1)
    lines = zip(tir.lines, new.lines, strict=True)
    differing = [(a.split("$"), b.split("$")) for a, b in lines if a != b]
    assert len(differing) == 2
    for before, after in differing:
        assert before[1] == after[1] and before[0].split("=")[0] == after[0].split("=")[0]


def test_new_coefficients_are_written_to_their_sections():
    tir = read_tir(TRUCK)
    new = tir.with_values({"PDX3": -8.5, "LMUX": 0.9, "NOMPRES": 4e5})
    assert new.find("PDX3").section == "LONGITUDINAL_COEFFICIENTS"
    assert new.find("NOMPRES").section == "OPERATING_CONDITIONS"
    assert new.numbers["LMUX"] == 0.9 and new.numbers["PDX3"] == -8.5
    kept = [line for line in new.lines if line in tir.lines]
    assert len(kept) == len(tir.lines) - 1
    assert all(line.endswith("\r\n") for line in new.lines)
    parse_tir(new.text)
    with pytest.raises(UsageError, match="(?s)NONSENSE is not a key of the file.*GARBAGE"):
        tir.with_values({"NONSENSE": 1.0, "GARBAGE": 2.0})


def test_a_side_is_written_as_text(tmp_path):
    other = read_tir(MF61).with_values({"TYRESIDE": "LEFT"})
    (tmp_path / "left.tir").write_text(other.text)
    assert read_tir(tmp_path / "left.tir").side == "LEFT"
    assert "'LEFT'" in other.text


def test_other_spellings_are_accepted():
    quoted = changed(MF61, ("'RIGHT'", '"Right" $side'))
    assert parse_tir(quoted).side == "RIGHT"
    bare = parse_tir(changed(MF61, *((f"^{u} .*", "") for u in ("LENGTH", "FORCE"))))
    assert bare.numbers["FNOMIN"] == 6752
    without = re.sub(r"(?s)\[UNITS\].*?\[MODEL\]", "[MODEL]", MF61.read_text())
    assert "SI units assumed" in notes_on(parse_tir(without))[0]


BAD = {
    "version": ("^FITTYP.*", "FITTYP = 70", "FITTYP = 70 is not a", "61 (MF 6.1)"),
    "other model": ("= +'USER'", "= 'FIALA'", "model FIALA (PROPERTY_FILE_FORMAT", "5.2"),
    "no load": ("^FNOMIN .*", "", "FNOMIN is missing", "[VERTICAL]"),
    "no pressure": ("^NOMPRES .*", "", "to which PPX1 refers", "PPMX1, QSY8 to 0"),
    "twice": (
        "^PDX2 .*",
        "PDX2 = 1\nPDX2 = 2",
        "PDX2 = 2 contradicts PDX2 = 1 in row",
        "remove one",
    ),
    "in two sections": ("^QSX1 .*", "PDX1 = 2", "PDX1 = 2 contradicts PDX1 = 1.1632", "remove one"),
    "range": ("^FZMIN .*", "FZMIN = 2e4", "FZMIN = 20000 contradicts FZMAX = 18000", "correct one"),
    "text": ("^PDX2 .*", "PDX2 = 0,5", "PDX2 = 0,5 is not a number", "changes the"),
    "unit": ("'newton'", "'stone'", "FORCE = 'stone'", "newton"),
    "side": ("'RIGHT'", "'TOP'", "TYRESIDE = 'TOP'", "LEFT, RIGHT"),
    "mirrored": ("^USE_MODE .*", "USE_MODE = -12", "USE_MODE = -12 mirrors", "--side"),
    "negative": (
        "^UNLOADED_RADIUS .*",
        "UNLOADED_RADIUS = -1",
        "is not positive",
        "correct UNLOADED_RADIUS",
    ),
    "pressure unit": ("^NOMPRES .*", "NOMPRES = 2.6", "NOMPRES is 2.6 Pa", "'bar'"),
    "quote": ("'RIGHT'", "'RIGHT", "is not a section, KEY = VALUE or comment", "quotes"),
    "bracket": (r"^\[LATERAL_C.*", "[LATERAL", "'[LATERAL' is not a section", "brackets"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_refused_with_key_and_remedy(name):
    pattern, replacement, reason, remedy = BAD[name]
    text = changed(MF61, (pattern, replacement))
    (problem,) = problems(text)
    assert reason in problem.reason and remedy in problem.remedy
    if "missing" not in problem.reason:
        line = text.splitlines()[problem.row - 1]
        assert replacement.splitlines()[-1].split(" =")[0] in line


def test_speed_is_needed_if_friction_depends_on_it():
    parse_tir(changed(MF61, ("^LFZO .*", "LFZO = 1\nLMUV = 0.2")))
    edits = [("^LFZO .*", "LFZO = 1\nLMUV = 0.2"), ("^LONGVL .*", "")]
    (problem,) = problems(changed(MF61, *edits))
    assert "LONGVL is missing: LMUV" in problem.reason


def test_all_problems_are_reported_in_file_order():
    text = changed(
        MF61,
        ("'newton'", "'stone'"),
        ("^FITTYP.*", "FITTYP = 7"),
        ("^FNOMIN .*", ""),
        ("^PCY1 .*", "PCY1 = x"),
        ("^FZMIN .*", "FZMIN = 2e4"),
    )
    found = problems(text)
    rows = [problem.row or 0 for problem in found]
    assert len(found) == 5 and rows == sorted(rows)
    everywhere = re.sub(r"(?m)^(P[A-Z]Y\d +=).*", r"\1 1,5", MF61.read_text())
    (problem,) = problems(everywhere)
    assert "values are not numbers: PPY1 = 1,5" in problem.reason or "PCY1 = 1,5" in (
        problem.reason
    )


def test_missing_files_are_refused():
    with pytest.raises(DataError, match="none.tir.*cannot read it"):
        read_tir("none.tir")


def brush_share(x):
    """Force over mu F_z of the parabolic brush at x = 2 c_p a^2 sigma / (mu F_z)."""
    x = np.minimum(x, 3.0)
    return x - x**2 / 3 + x**3 / 27


CPA2, MU, FZ = 4.2e4, 0.85, 3900.0


def reduced(**other):
    tir = reduced_tir(CPA2, MU, FZ, 0.31)
    return with_values(mf_tire(tir.version, tir.numbers), other)


def test_reduced_file_has_the_slope_and_friction_of_the_brush(tmp_path):
    tir = reduced_tir(CPA2, MU, FZ, 0.31)
    (tmp_path / "reduced.tir").write_text(tir.text)
    assert read_tir(tmp_path / "reduced.tir").numbers == tir.numbers
    np.testing.assert_allclose(tir.numbers["PKX1"] * FZ, 2 * CPA2, rtol=1e-14)
    tire, step = reduced(), np.array([-1e-7, 1e-7])
    for model in (tire, with_values(MODELS["brush"], {"cpa2": CPA2, "mu": MU})):
        along = forces(model, TireInputs(step, 0.0, FZ)).fx
        across = forces(model, TireInputs(0.0, step, FZ)).fy
        for force in (along, across):
            np.testing.assert_allclose(np.diff(force) / 2e-7, 2 * CPA2, rtol=1e-5)
    kappa = np.linspace(0, 0.999, 500)
    fx = np.asarray(forces(tire, TireInputs(kappa / (1 - kappa), 0.0, FZ)).fx)
    assert (np.diff(fx) > 0).all() and fx[-1] < MU * FZ and fx[-1] > 0.99 * MU * FZ
    expected = MU * FZ * brush_share(2 * CPA2 / (MU * FZ) * kappa)
    assert np.max(abs(fx - expected)) < 0.046 * MU * FZ
    moments = forces(tire, TireInputs(0.0, 0.05, FZ))
    assert moments.mx is None and moments.my is None
    assert moments.mz == 0


def test_reduced_lateral_stiffness_is_that_of_the_brush_at_every_load():
    point = TireInputs(fz=FZ * np.array([0.2, 0.5, 1.0, 2.0]), alpha=1e-7)
    force = np.asarray(forces(reduced(), point).fy)
    np.testing.assert_allclose(force, 2 * CPA2 * 1e-7, rtol=1e-5)


def test_the_reduced_curvature_is_the_best_fit_to_the_brush():
    kappa = np.linspace(0, 0.999, 500)
    expected = MU * FZ * brush_share(2 * CPA2 / (MU * FZ) * kappa)

    def miss(**other):
        fx = forces(reduced(**other), TireInputs(kappa / (1 - kappa), 0.0, FZ)).fx
        return np.max(abs(np.asarray(fx) - expected))

    best = miss()
    for other in (-0.54, -0.34, 0.0):
        assert miss(PEX1=other) > 1.02 * best
    assert miss(PCX1=1.1) > 1.02 * best


def test_reduced_stiffness_is_stationary_at_the_nominal_load():
    for channel, slip in (("fx", "sigma_x"), ("fy", "alpha")):
        point = TireInputs(fz=FZ * np.array([0.99, 1.0, 1.01]))._replace(**{slip: 1e-7})
        force = np.asarray(getattr(forces(reduced(), point), channel))
        assert np.max(abs(force / force[1] - 1)) < 1e-4


def test_reduced_tire_keeps_to_the_friction_circle():
    generator = np.random.default_rng(2)
    kappa, alpha = generator.uniform(-0.3, 0.3, (2, 500))
    inputs = TireInputs(kappa / (1 - kappa), alpha, FZ)
    fx, fy = map(np.asarray, forces(reduced(), inputs)[:2])
    assert np.max(np.hypot(fx, fy)) < 1.02 * MU * FZ
    # Without curvature it is the isotropic tire exactly.
    fx, fy = map(np.asarray, forces(reduced(PEX1=0.0, PEY1=0.0), inputs)[:2])
    x, y = 2 * CPA2 / (MU * FZ) * np.array([kappa, alpha])
    share = MU * FZ / np.sqrt(1 + x**2 + y**2)
    np.testing.assert_allclose(fx, x * share, rtol=1e-12)
    np.testing.assert_allclose(fy, y * share, rtol=1e-12)


def test_an_empty_pressure_is_nominal_and_other_empty_cells_exclude_the_row(tmp_path):
    path = tmp_path / "p.csv"
    path.write_text("kappa,fz,pressure [bar]\n0.1,4000,2.5\n0.1,4000,\n0.1,4000,x\n")
    with pytest.raises(DataError) as caught:
        read(path, forces=False, convention="iso-w")
    assert [problem.row for problem in caught.value.problems] == [4]
    path.write_text("kappa,fz,pressure [bar]\n0.1,4000,2.5\n0.1,4000,\n")
    data = read(path, forces=False, convention="iso-w")
    np.testing.assert_array_equal(data["pressure"], [2.5e5, np.nan])
    assert data.used.all() and "nominal" in " ".join(data.source.assumptions)
    path.write_text("kappa,fz\n0.1,4000\n0.1,\n")
    data = read(path, forces=False, convention="iso-w")
    assert data.used.tolist() == [True, False]
