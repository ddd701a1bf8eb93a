"""TYDEX files: told by their keywords, with factors, offsets, constants and gaps."""

import numpy as np
import pytest
from rig_file import DEG, truth, tydex

from tirefit.data.read import read
from tirefit.results import DataError


def written(tmp_path, lines, name="test.tdx"):
    path = tmp_path / name
    path.write_text("\n".join(lines) + "\n")
    return path


def said(data, fragment):
    return any(fragment in note for note in data.source.notes)


def same(data, columns):
    """Equal to the six digits that the file has."""
    for name in set(columns) - {"gamma"}:
        np.testing.assert_allclose(data[name], columns[name], rtol=2e-5, atol=4e-3)


@pytest.mark.parametrize("per_line", [8, 10, 3])
@pytest.mark.parametrize("name", ["test.tdx", "test.tyd", "test.csv"])
def test_a_file_of_tydex_is_read_by_its_content(tmp_path, name, per_line):
    columns = truth()
    lines = tydex(columns, per_line)
    data = read(written(tmp_path, lines, name))
    same(data, columns)
    np.testing.assert_allclose(data["gamma"], 3 * DEG)
    assert data.source.convention == "iso-w"
    assert data.source.line[0] == lines.index("**MEASURDATA") + 2
    for sentence in (
        "TYDEX 1.3: signs read as 'iso-w'",
        "comment: New tyre used",
        "SUPPLIER = DEMO",
        "constants not read: MANUFACT, NOMWIDTH, FZW",
        "INCLANGL = 3.0 deg in all rows (**CONSTANTS)",
        "SLIPANGL = 0.5 * value + 1 [deg]",
        "FYW = 0.001 * (value + 4) [kN]",
        "columns not read: 'MEASNUMB'",
    ):
        assert said(data, sentence), sentence
    (warning,) = data.source.warnings
    assert "measurement offset of FYW was added before the factor" in warning


def test_values_that_touch_are_told_by_their_columns(tmp_path):
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


def test_values_that_are_not_available_are_rows_that_are_masked(tmp_path):
    columns = truth()
    path = written(tmp_path, tydex(columns, 10, {(4, "FYW"), (7, "SLIPANGL")}))
    with pytest.raises(DataError, match="NOTAVAIL: the value is not") as caught:
        read(path)
    assert {problem.column for problem in caught.value.problems} == {"FYW", "SLIPANGL"}
    data = read(path, mask_bad_rows=True)
    assert np.flatnonzero(~data.used).tolist() == [4, 7]
    same(data.where(data.used), {"fz": columns["fz"]})


def test_of_two_axes_the_roads_are_read(tmp_path):
    lines = tydex(truth(), 10)
    at = next(i for i, line in enumerate(lines) if line.startswith("TYRETEMP"))
    lines[at] = f"{'FZH':<10}{'Vertical force':<30}{'N':<10}{'1':<10}"
    data = read(written(tmp_path, lines))
    assert said(data, "channel FZH not read: another means the same")
    np.testing.assert_allclose(data["fz"], truth()["fz"], rtol=1e-5)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (("**MEASURDATA", "**MODELPARAMETERS"), ["has no **MEASURDATA", ".tir files"]),
        (("MEASNUMB  Meas", "nonsense\nMEASNUMB  Meas"), ["row 22", "no channel"]),
        (("LONGVEL ", "RUNTIME "), ["row 24, column 'RUNTIME'", "is there twice"]),
        (("deg       0.5", "deg       0  "), ["'SLIPANGL'", "conversion factor", "0"]),
    ],
)
def test_errors_name_file_place_and_remedy(tmp_path, change, expected):
    text = "\n".join(tydex(truth(), 10))
    assert change[0] in text
    with pytest.raises(DataError) as caught:
        read(written(tmp_path, text.replace(*change).split("\n")))
    for fragment in ("test.tdx", "remedy", *expected):
        assert fragment in str(caught.value)


def test_a_row_of_another_width_is_named(tmp_path):
    lines = tydex(truth(), 10)
    lines[-4] = lines[-4][:-20]
    with pytest.raises(DataError) as caught:
        read(written(tmp_path, lines))
    assert f"row {len(lines) - 3}: 8 values where there are 10" in str(caught.value)


def test_the_ending_alone_makes_no_tydex(tmp_path):
    path = written(tmp_path, ["kappa,fx,fz", "0.1,400,4000", "0.2,700,4000"])
    assert read(path).n == 2
