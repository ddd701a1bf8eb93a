"""Rows that lack a value are excluded and counted, in every reader, up to a tenth of them."""

import numpy as np
import pytest
from scipy.io import savemat

import tirefit
from tirefit.data.read import read, read_frame
from tirefit.results import DataError

N = 80
SLIP = np.linspace(-0.2, 0.2, N)
COLUMNS = {
    "alpha": SLIP,
    "fy": 3600 * np.tanh(12 * SLIP),
    "fz": np.full(N, 4000.0),
    "temperature": np.linspace(40.0, 60.0, N),
}
GONE = {"alpha": [7], "fy": [3, 7, 20], "fz": [79]}
ROWS = sorted({row for rows in GONE.values() for row in rows})
WORDS = ["", "NaN", "NA", "n/a", "null", " "]


def holed(gone=None):
    """The columns with NaN in these rows."""
    columns = {name: values.copy() for name, values in COLUMNS.items()}
    for name, rows in (GONE if gone is None else gone).items():
        columns[name][rows] = np.nan
    return columns


def text(path, columns, word=""):
    rows = [
        ",".join(word if value != value else repr(float(value)) for value in row)
        for row in zip(*columns.values(), strict=True)
    ]
    path.write_text("\n".join([",".join(columns), *rows]) + "\n")
    return path


def save_csv(path, columns):
    return text(path, columns)


def save_parquet(path, columns):
    pa = pytest.importorskip("pyarrow")
    import pyarrow.parquet as pq

    table = {k: pa.array(v, mask=np.isnan(v) & (np.arange(N) != 3)) for k, v in columns.items()}
    pq.write_table(pa.table(table), path)  # nulls, and a NaN in row 3
    return path


def save_excel(path, columns):
    book = pytest.importorskip("openpyxl").Workbook()
    book.active.append(list(columns))
    for row in zip(*columns.values(), strict=True):
        book.active.append([None if value != value else float(value) for value in row])
    book.save(path)
    return path


def save_mat(path, columns):
    savemat(path, columns)
    return path


READERS = {
    "a.csv": (save_csv, 2),
    "a.parquet": (save_parquet, 1),
    "a.xlsx": (save_excel, 2),
    "a.mat": (save_mat, 1),
}
"""File -> how it is written, and the number that a message gives the first row."""


@pytest.mark.parametrize("name", READERS)
def test_rows_without_a_value_are_excluded_and_named(name, tmp_path):
    save, first = READERS[name]
    data = read(save(tmp_path / name, holed()))
    np.testing.assert_array_equal(np.flatnonzero(~data.used), ROWS)
    named = (
        f"excluded 4 of {N} rows, which lack a value: "
        f"'alpha' in row {7 + first}; 'fy' in rows {3 + first}, {7 + first}, {20 + first};"
        f" 'fz' in row {79 + first}"
    )
    assert [one for one in data.source.warnings if "lack" in one] == [named]
    assert not data.source.masked
    for column in ("alpha", "fy", "fz"):
        np.testing.assert_allclose(data.usable(column), np.delete(COLUMNS[column], ROWS))


@pytest.mark.parametrize("word", WORDS)
def test_every_spelling_of_a_missing_value_is_one(word, tmp_path):
    data = read(text(tmp_path / "a.csv", holed(), word))
    np.testing.assert_array_equal(np.flatnonzero(~data.used), ROWS)


def test_another_fault_beside_them_is_still_an_error(tmp_path):
    path = text(tmp_path / "a.csv", holed())
    path.write_text(path.read_text().replace(",4000.0,", ",abc,", 1))
    with pytest.raises(DataError) as caught:
        read(path)
    assert [(p.row, p.column) for p in caught.value.problems] == [(2, "fz")]


@pytest.mark.parametrize(("count", "refused"), [(8, False), (9, True)])
def test_more_than_a_tenth_is_an_error_that_names_them(count, refused, tmp_path):
    path = text(tmp_path / "a.csv", holed({"fy": np.arange(count)}))
    if not refused:
        assert read(path).n == N - count
        return
    with pytest.raises(DataError) as caught:
        read(path)
    (problem,) = caught.value.problems
    assert (problem.file, problem.column) == (str(path), "fy")
    assert problem.reason == f"9 of {N} rows (11.2%) lack a value (rows 2, 3, 4, 5, 6 and 4 more)"
    assert "--mask-bad-rows" in problem.remedy
    assert read(path, mask_bad_rows=True).n == N - count


def test_the_share_that_is_refused_is_above_a_tenth_as_printed(tmp_path):
    short = "run,alpha,fz,fy\n" + "".join(
        f"a,{0.1 - 1e-4 * k},4000,{'' if k < 101 else k - 1000}\n" for k in range(1000)
    )
    (tmp_path / "a.csv").write_text(short)
    with pytest.raises(DataError, match=r"101 of 1000 rows \(10\.1%\) lack a value"):
        read(tmp_path / "a.csv")


def test_a_column_that_no_model_needs_costs_no_row_where_it_is_mostly_empty(tmp_path):
    path = text(tmp_path / "a.csv", holed({"temperature": np.arange(N) % 10 > 0}))
    data = read(path)
    assert data.n == N and "temperature" not in data
    assert "column 'temperature' is not read: 72 of its 80 cells" in data.source.warnings[0]
    with pytest.raises(DataError, match="72 of 80 rows"):
        read(path, columns={"temperature": "temperature"})


def test_a_fit_is_that_of_the_other_rows():
    whole = {name: np.delete(values, ROWS) for name, values in COLUMNS.items()}
    one, other = tirefit.fit(holed()), tirefit.fit(whole)
    assert one.statistics.n == other.statistics.n == N - len(ROWS)
    for name, estimate in one.parameters.items():
        assert estimate.value == pytest.approx(other.parameters[name].value, rel=1e-9)


def test_a_prediction_keeps_the_rows_and_needs_no_force():
    given = holed({"alpha": np.arange(30), "fy": np.arange(10, 50)})
    predicted = tirefit.predict("brush", given)["fy"]
    assert predicted.shape == (N,)
    np.testing.assert_array_equal(np.isnan(predicted), np.arange(N) < 30)
    whole = tirefit.predict("brush", COLUMNS)["fy"]
    np.testing.assert_array_equal(predicted[30:], whole[30:])


def test_rows_without_a_force_cause_no_warning_of_units():
    """Their forces are no part of the percentiles, which would not be numbers."""
    given = read_frame(holed({"fy": np.arange(10, 50)}), forces=False)
    assert np.isnan(given["fy"]).sum() == 40
    assert not [one for one in given.source.warnings if "nan" in one or "unit" in one]


def test_the_name_of_a_run_may_be_missing():
    names = np.array(["a"] * 40 + [""] + ["b"] * 39)
    data = read_frame(COLUMNS | {"run": names})
    np.testing.assert_array_equal(data.used, np.arange(N) != 40)
    assert "'run' in row 40" in data.source.warnings[0]


@pytest.mark.parametrize("name", ["fx", "mz", "gamma", "omega", "v", "kappa", "temperature", "run"])
def test_a_column_without_any_value_that_nobody_needs_is_not_read(tmp_path, name):
    path = text(tmp_path / "a.csv", COLUMNS | {name: np.full(N, np.nan)})
    if name == "run":  # it divides the rows: never guessed
        with pytest.raises(DataError, match="run"):
            read(path)
        return
    data = read(path)
    canonical = "sigma_x" if name == "kappa" else name
    assert data.n == N and canonical not in data and canonical not in data.source.units
    assert f"column '{name}' is not read: {N} of its {N} cells have no value" in "".join(
        data.source.warnings
    )


@pytest.mark.parametrize("name", ["alpha", "fy", "fz"])
def test_a_needed_column_without_any_value_is_named(tmp_path, name):
    path = text(tmp_path / "a.csv", COLUMNS | {name: np.full(N, np.nan)})
    with pytest.raises(DataError) as caught:
        read(path)
    (problem,) = caught.value.problems
    assert f"column '{name}' is not read: {N} of its {N} cells have no value" in problem.reason


def test_a_variable_of_another_length_is_named_where_it_lacks(tmp_path):
    path = tmp_path / "log.mat"
    slips = np.linspace(-0.1, 0.1, 30)
    savemat(path, {"alpha": slips, "fy": slips[:9], "fz": np.full(30, 4e3)})
    with pytest.raises(DataError, match=r"no force: .*not read: 'fy' \(1 x 9\)"):
        read(path)
