"""TYDEX files, recognised by keywords, with factors, offsets, constants and gaps."""

import numpy as np
import pytest
from rig_file import DEG, truth, tydex
from test_read_kinds import said

from tirefit.data.read import read
from tirefit.data.table import join
from tirefit.results import DataError


def written(tmp_path, lines, name="test.tdx"):
    path = tmp_path / name
    path.write_text("\n".join(lines) + "\n")
    return path


def same(data, columns):
    """Equal within the six digits of the file."""
    for name in set(columns) - {"gamma"}:
        np.testing.assert_allclose(data[name], columns[name], rtol=2e-5, atol=4e-3)


@pytest.mark.parametrize("per_line", [8, 10, 3])
@pytest.mark.parametrize("name", ["test.tdx", "test.tyd", "test.csv"])
def test_a_tydex_file_is_recognised_by_its_content(tmp_path, name, per_line):
    columns = truth()
    lines = tydex(columns, per_line)
    data = read(written(tmp_path, lines, name))
    same(data, columns)
    np.testing.assert_allclose(data["gamma"], 3 * DEG)
    assert data.source.convention == "iso-w"
    assert data.source.line[0] == lines.index("**MEASURDATA") + 2
    for sentence in (
        "TYDEX 1.3: signs read as 'iso-w'",
        "constants not read: MANUFACT, NOMWIDTH",
        "FNOMIN = 700: FZW Nominal vertical force N 700",
        "INCLANGL = 3.0 deg in all rows (**CONSTANTS)",
        "SLIPANGL = 0.5 * (value + 0) + 1 [deg]",
        "FYW = 0.001 * (value + 4) + 0 [kN]",
        "columns not read: 'MEASNUMB'",
    ):
        assert said(data, sentence), sentence
    (warning,) = data.source.warnings
    assert "measurement offset of FYW was added before the factor" in warning


def test_values_without_space_are_split_by_column_width(tmp_path):
    columns = truth()
    lines = tydex(columns)
    start = lines.index("**MEASURDATA") + 1
    # The first line of each record as columns of ten characters without a blank.
    for at in range(start, len(lines) - 2, 2):
        words = lines[at].split()
        lines[at] = "".join(f"{float(word):+010.3f}" for word in words)
    data = read(written(tmp_path, lines))
    np.testing.assert_allclose(data["fz"], columns["fz"], atol=1e-3)
    np.testing.assert_allclose(data["alpha"], columns["alpha"], atol=1e-3 * DEG)


def test_unavailable_values_mask_their_rows(tmp_path):
    columns = truth()
    path = written(tmp_path, tydex(columns, 10, {(4, "FYW"), (7, "SLIPANGL")}))
    masked = read(path, mask_bad_rows=True)
    assert {problem.column for problem in masked.source.masked} == {"FYW", "SLIPANGL"}
    data = read(path)
    assert np.flatnonzero(~data.used).tolist() == np.flatnonzero(~masked.used).tolist() == [4, 7]
    same(data.where(data.used), {"fz": columns["fz"]})


def test_road_axes_are_preferred(tmp_path):
    lines = tydex(truth(), 10)
    at = next(i for i, line in enumerate(lines) if line.startswith("TYRETEMP"))
    lines[at] = f"{'FZH':<10}{'Vertical force':<30}{'N':<10}{'1':<10}"
    data = read(written(tmp_path, lines))
    assert said(data, "channel FZH not read: another has the same meaning")
    np.testing.assert_allclose(data["fz"], truth()["fz"], rtol=1e-5)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (("**MEASURDATA", "**MODELPARAMETERS"), ["has no **MEASURDATA", ".tir files"]),
        (("MEASNUMB  Meas", "nonsense\nMEASNUMB  Meas"), ["row 22", "not a channel"]),
        (("LONGVEL ", "RUNTIME "), ["row 24, column 'RUNTIME'", "is there twice"]),
        (("deg       0.5", "deg       0  "), ["'SLIPANGL'", "conversion factor", "0"]),
    ],
)
def test_errors_name_file_line_and_remedy(tmp_path, change, expected):
    text = "\n".join(tydex(truth(), 10))
    assert change[0] in text
    with pytest.raises(DataError) as caught:
        read(written(tmp_path, text.replace(*change).split("\n")))
    for fragment in ("test.tdx", "remedy", *expected):
        assert fragment in str(caught.value)


def test_a_row_of_another_width_is_reported(tmp_path):
    lines = tydex(truth(), 10)
    lines[-4] = lines[-4][:-20]
    with pytest.raises(DataError) as caught:
        read(written(tmp_path, lines))
    assert f"row {len(lines) - 3}: 8 values where there are 10" in str(caught.value)


def test_the_file_ending_alone_does_not_make_a_file_tydex(tmp_path):
    path = written(tmp_path, ["kappa,fx,fz", "0.1,400,4000", "0.2,700,4000"])
    assert read(path).n == 2


# --- constants of the tire --------------------------------------------------------


def constant(name, comment, unit, value):
    return f"{name:<10}{comment:<30}{unit:<10}{value:<10}"


def stating(tmp_path, *constants, name="test.tdx", seed=3):
    """A TYDEX file with these lines added to its constants, read."""
    lines = tydex(truth(seed=seed), 10)
    at = lines.index("**MEASURCHANNELS") - 1
    keep = [line for line in lines[:at] if not line.startswith(("FZW", "NOMWIDTH"))]
    return read(written(tmp_path, [*keep, *constants, *lines[at:]], name))


@pytest.mark.parametrize(
    ("lines", "radius"),
    [
        ([("OVALLDIA", "Overall diameter", "mm", "634")], 0.317),
        ([("OVALLDIA", "Overall diameter", "m", "0.634")], 0.317),
        ([("OVALLDIA", "Overall diameter", "inch", "25")], 0.3175),
        ([("RFREE", "", "m", "0.31"), ("OVALLDIA", "", "m", "0.634")], 0.31),
        ([("DIA_X", "Overall diameter of the tyre", "cm", "63.4")], 0.317),
        ([("OVALLDIA", "", "m", "0.64"), ("RFREE", "", "m", "0.31")], 0.31),
        ([("OVALLDIA", "Overall diameter", "", "634")], None),
        ([("RIMDIAME", "Nominal rim diameter", "inch", "15")], None),
        ([("OVALLDIA", "Overall diameter", "m", "634")], None),
        ([("OVALLDIA", "Overall diameter", "N", "0.634")], None),
        ([("OVALLDIA", "Overall diameter", "m", "NOTAVAIL")], None),
        ([("TESTDATE", "Date", "-", "2019/11/12")], None),
    ],
)
def test_the_radius_is_read_from_the_constants(tmp_path, lines, radius):
    data = stating(tmp_path, *(constant(*line) for line in lines))
    assert data.source.constants.get("UNLOADED_RADIUS") == (
        None if radius is None else pytest.approx(radius)
    )
    if radius is None:
        assert said(data, lines[-1][0])  # as not read, or as what else it is
    else:
        assert said(data, f"UNLOADED_RADIUS = {radius:.4g}: ")


NOMINAL = (
    ("OVALLDIA", "Overall diameter", "mm", "634"),
    ("FNOMIN", "Nominal vertical load", "kN", "1.2"),
    ("NOMPRES", "Nominal inflation pressure", "kPa", "90"),
)


def test_the_nominal_state_of_a_magic_formula_is_read_from_the_constants(tmp_path):
    from tirefit.fitting.mf.fit import nominal_of
    from tirefit.fitting.mf.rows import rows_of_forces
    from tirefit.fitting.problem.config import parse_config

    data = stating(tmp_path, *(constant(*line) for line in NOMINAL))
    known = data.source.constants
    config = parse_config({"parameters": {"NOMPRES": {"value": 8e4}}})
    rows = rows_of_forces(data, ["fy", "mz"])
    tire, notes = nominal_of("mf61", rows, config, known)
    nominal = tire.nominal
    assert nominal.UNLOADED_RADIUS == pytest.approx(0.317)
    assert nominal.FNOMIN == pytest.approx(1200)
    assert nominal.NOMPRES == nominal.INFLPRES == 8e4  # what the user states
    text = " ".join(notes)
    assert "UNLOADED_RADIUS = 0.317: stated by the data file" in text
    assert "NOMPRES" not in text
    without, assumed = nominal_of("mf61", rows, config)
    assert without.nominal.UNLOADED_RADIUS == 0.3 and "no radius" in " ".join(assumed)


def test_prepared_files_keep_the_constants(tmp_path):
    from tirefit.data.rig.prepare import prepare
    from tirefit.data.rig.store import prepared_csv

    data = stating(tmp_path, *(constant(*line) for line in NOMINAL))
    path = tmp_path / "prepared.csv"
    path.write_text(prepared_csv(prepare(data)))
    assert read(path).source.constants == pytest.approx(data.source.constants)
    assert read(path).source.convention == "braking"


def test_constants_that_differ_between_files_are_not_used(tmp_path):
    one, two = (
        stating(
            tmp_path,
            constant("OVALLDIA", "", unit, value),
            constant("FNOMIN", "", "N", load),
            name=f"{load}.tdx",
            seed=seed,
        )
        for unit, value, load, seed in (("m", "0.634", "4000", 1), ("mm", "634", "5000", 2))
    )
    both = join([one, two]).source
    assert both.constants == {"UNLOADED_RADIUS": pytest.approx(0.317)}
    (text,) = [text for text in both.warnings if "FNOMIN" in text]
    assert "4000 to 5000" in text and "parameters.FNOMIN.value" in text
