"""MATLAB, Parquet, Arrow and Excel: the same channels, recognised by content."""

import gzip
import pickle
import struct
import sys
import zipfile
from pathlib import Path

import h5py
import numpy as np
import pytest
from rig_file import IMPERIAL_UNITS, METRIC_UNITS, truth, ttc
from scipy.io import savemat
from scipy.sparse import csc_array

from tirefit.data.read import read, read_frame
from tirefit.results import DataError


def said(data, fragment):
    return any(fragment in note for note in data.source.notes)


def same(data, columns):
    for name, values in columns.items():
        np.testing.assert_allclose(data[name], values, rtol=1e-9, atol=1e-12)


def refusal(path, **options):
    with pytest.raises(DataError) as caught:
        read(path, **options)
    assert all(p.file == str(path) and p.remedy for p in caught.value.problems)
    return "\n".join(map(str, caught.value.problems))


# --- MATLAB -------------------------------------------------------------------------


def consortium(imperial=False):
    """Variables of a MATLAB file of the Tire Test Consortium."""
    frame = ttc(truth(), imperial)
    units = IMPERIAL_UNITS if imperial else METRIC_UNITS
    cells = {
        "name": np.array(list(frame), object),
        "units": np.array([str(unit) for unit in units], object),
    }
    return frame | {"channel": cells, "tireid": "no such tire", "testid": "Cornering"}


def save_73(path, variables):
    """A file as MATLAB's ``save -v7.3`` lays it out: HDF5 below a header of text."""
    with h5py.File(path, "w", userblock_size=512) as file:
        _put(file, file, variables)
    header = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: a day".ljust(124)
    with open(path, "r+b") as raw:
        raw.write(header + b"\x00\x02IM")


def _put(file, group, variables):
    for name, value in variables.items():
        if isinstance(value, dict):
            inner = group.create_group(name)
            inner.attrs["MATLAB_class"] = np.bytes_("struct")
            _put(file, inner, value)
        elif isinstance(value, str):
            codes = np.array([[ord(letter)] for letter in value], np.uint16)
            group.create_dataset(name, data=codes).attrs["MATLAB_class"] = np.bytes_("char")
        elif value.dtype == object:
            refs = file.require_group("#refs#")
            cells = np.empty((len(value), 1), h5py.ref_dtype)
            for at, text in enumerate(value):
                place = f"{name}{at}"
                _put(file, refs, {place: text})
                cells[at, 0] = refs[place].ref
            made = group.create_dataset(name, data=cells, dtype=h5py.ref_dtype)
            made.attrs["MATLAB_class"] = np.bytes_("cell")
        else:  # MATLAB's columns first: a column vector is a row here
            made = group.create_dataset(name, data=np.atleast_2d(value))
            made.attrs["MATLAB_class"] = np.bytes_("double")


def column(variables):
    """Vectors as MATLAB's columns, for SciPy."""
    return {
        name: value[:, None]
        if isinstance(value, np.ndarray) and value.ndim == 1
        else column(value)
        if isinstance(value, dict)
        else value
        for name, value in variables.items()
    }


def save_5(path, variables):
    savemat(path, column(variables), oned_as="column")


SAVE = {"5": save_5, "7.3": save_73}


@pytest.mark.parametrize("imperial", [False, True])
@pytest.mark.parametrize("version", SAVE)
def test_matlab_files_of_the_consortium_need_no_declaration(tmp_path, version, imperial):
    path = tmp_path / "run.mat"
    SAVE[version](path, consortium(imperial))
    data = read(path)
    same(data, truth())
    assert data.source.convention == "sae"
    assert said(data, f"MATLAB file of version {version}")
    assert said(data, "'tireid' ('no such tire')")
    assert said(data, "(stated in the file)")
    assert not data.source.warnings


KAPPA = np.array([-0.08, -0.04, -0.01, 0.01, 0.03, 0.06, 0.1])
PLAIN = {"kappa": KAPPA, "fx": 40000 * KAPPA, "fz": np.full(7, 4000.0)}


@pytest.mark.parametrize("version", SAVE)
@pytest.mark.parametrize(
    ("variables", "fragment"),
    [
        (PLAIN, "version"),
        ({"test": {"data": PLAIN}}, "struct 'test.data'"),
        ({"data": PLAIN, "other": {"a": KAPPA}}, "structs not read: 'other'"),
        (PLAIN | {"rate": np.array([100.0])}, "variables not read: 'rate' (1 x 1)"),
        (PLAIN | {"a": np.ones(9)}, "variables not read: 'a' ("),
        (
            {
                "data": np.stack(list(PLAIN.values()), axis=1),
                "names": np.array(list(PLAIN), object),
            },
            "version",
        ),
        ({"test": PLAIN | {"units": {"kappa": "-", "fx": "N", "fz": "N"}}}, "stated in the file"),
    ],
)
def test_columns_of_a_matlab_file_are_found(tmp_path, version, variables, fragment):
    path = tmp_path / "run.mat"
    if version == "7.3" and "data" in variables and "names" in variables:
        variables = variables | {"data": variables["data"].T}
    SAVE[version](path, variables)
    data = read(path)
    np.testing.assert_array_equal(data["fx"], PLAIN["fx"])
    np.testing.assert_allclose(data["sigma_x"], KAPPA / (1 - KAPPA))
    assert said(data, fragment)


def test_other_content_of_a_matlab_file_is_listed(tmp_path):
    others = {
        "sparse": csc_array(np.eye(3)),
        "cells": np.array([[1.0, "a"]], object),
        "complex": np.ones((7, 1)) * 1j,
        "empty": np.empty((0, 0)),
        "structs": np.array([{"a": 1.0}, {"a": 2.0}], object),
    }
    savemat(tmp_path / "run.mat", column(PLAIN) | others, do_compression=True)
    data = read(tmp_path / "run.mat")
    for name in others:
        assert said(data, f"'{name}' ("), name
    np.testing.assert_array_equal(data["fx"], PLAIN["fx"])


@pytest.mark.parametrize("version", SAVE)
def test_logger_channels_have_time_value_and_units(tmp_path, version):
    time = np.arange(7) / 100
    logged = {
        name: {
            "Time": time,
            "Value": values / (1000 if name == "fx" else 1),
            "Units": "kN" if name == "fx" else "N" if name == "fz" else "-",
        }
        for name, values in PLAIN.items()
    }
    logged["gps"] = {"Time": np.arange(3.0), "Value": np.arange(3.0), "Units": "m/s"}
    SAVE[version](tmp_path / "log.mat", logged)
    data = read(tmp_path / "log.mat")
    np.testing.assert_allclose(data["fx"], PLAIN["fx"])
    np.testing.assert_allclose(data["time"], time)
    assert said(data, "sampled at other times: 'gps'")


@pytest.mark.parametrize("version", SAVE)
@pytest.mark.parametrize(
    ("variables", "expected"),
    [
        ({"a": np.array([1.0]), "b": "text"}, ["no columns", "'a' (1 x 1)", "struct"]),
        ({"one": PLAIN, "two": PLAIN}, ["several structs", "'one', 'two'", "-struct"]),
        ({"x": np.ones(5), "z": np.ones(5)}, ["columns found: 'x', 'z'"]),
    ],
)
def test_matlab_without_a_table_is_refused(tmp_path, version, variables, expected):
    path = tmp_path / "run.mat"
    SAVE[version](path, variables)
    message = refusal(path)
    assert all(fragment in message for fragment in expected), message


def element(kind, content):
    """One element of a MATLAB file of version 5: tag and content, padded to 8 bytes."""
    return struct.pack("<II", kind, len(content)) + content + bytes(-len(content) % 8)


def test_a_table_object_of_version_5_is_refused_with_a_remedy(tmp_path):
    path = tmp_path / "run.mat"
    savemat(path, {"a": np.array([1.0])})
    text, matrix, opaque = 1, 14, 17
    flags = element(6, struct.pack("<II", opaque, 0))
    names = [element(text, name) for name in (b"T", b"MCOS", b"table")]
    inner = element(6, struct.pack("<II", 13, 0)) + element(5, struct.pack("<ii", 1, 1))
    inner += element(text, b"") + element(6, struct.pack("<I", 1))
    content = element(matrix, flags + b"".join(names) + element(matrix, inner))
    path.write_bytes(path.read_bytes() + content)
    message = refusal(path)
    assert "'T' (MATLAB table)" in message
    assert "table2struct(T, 'ToScalar', true)" in message


def test_a_table_object_of_version_7_3_is_refused_with_a_remedy(tmp_path):
    path = tmp_path / "run.mat"
    save_73(path, {"T": np.ones(6)})
    with h5py.File(path, "r+") as file:
        file["T"].attrs["MATLAB_class"] = np.bytes_("timetable")
        file["T"].attrs["MATLAB_object_decode"] = np.int32(3)
    message = refusal(path)
    assert "'T' (MATLAB timetable)" in message
    assert "table2struct(T, 'ToScalar', true)" in message


@pytest.mark.parametrize("version", SAVE)
def test_a_damaged_matlab_file_is_reported(tmp_path, version):
    path = tmp_path / "run.mat"
    SAVE[version](path, PLAIN)
    path.write_bytes(path.read_bytes()[:-40])
    assert "MATLAB file cannot be read" in refusal(path)


# --- Parquet, Arrow, Excel ----------------------------------------------------------


def save_parquet(path, table):
    import pyarrow.parquet

    pyarrow.parquet.write_table(table, path)


def save_arrow(path, table):
    import pyarrow.feather

    pyarrow.feather.write_feather(table, path, compression="uncompressed")


def arrow_table(columns, units=()):
    pyarrow = pytest.importorskip("pyarrow")
    units = dict(units)
    arrays = [pyarrow.array(values) for values in columns.values()]
    fields = [
        pyarrow.field(name, array.type, metadata={"unit": units[name]} if name in units else None)
        for name, array in zip(columns, arrays, strict=True)
    ]
    return pyarrow.Table.from_arrays(arrays, schema=pyarrow.schema(fields))


@pytest.mark.parametrize("save", [save_parquet, save_arrow])
@pytest.mark.parametrize("name", ["a.parquet", "a.csv", "a"])
def test_parquet_and_arrow_have_typed_columns(tmp_path, save, name):
    pytest.importorskip("pyarrow")
    columns = {
        "kappa": 100 * KAPPA,
        "fx": (40000 * KAPPA).astype(np.float32),
        "fz": np.full(7, 4),
        "on": KAPPA > 0,
        "run": ["a"] * 3 + ["b"] * 4,
        "time": np.arange(7).astype("timedelta64[ms]"),
        "day": np.datetime64("2020-01-01") + np.arange(7).astype("timedelta64[s]"),
        "list": [[1.0]] * 7,
    }
    units = {"kappa": "%", "fz": "kN"}
    save(tmp_path / name, arrow_table(columns, units.items()))
    data = read(tmp_path / name)
    np.testing.assert_allclose(data["sigma_x"], KAPPA / (1 - KAPPA))
    np.testing.assert_array_equal(data["fz"], 4000)
    np.testing.assert_allclose(data["time"], np.arange(7) / 1000)
    assert data.runs == ("a", "b")
    assert said(data, "column 'kappa' read as kappa in % (metadata of the column)")
    assert said(data, "columns not read: 'list' (list<")
    assert said(data, "columns not read: 'on', 'day'")


def save_excel(path, sheets):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.remove(book.active)
    for title, rows in sheets.items():
        sheet = book.create_sheet(title)
        for row in rows:
            sheet.append(row)
    book.save(path)


SHEET = [list(PLAIN), *np.stack(list(PLAIN.values()), axis=1).tolist()]


JSON = {
    "columns": ('{"kappa": [0.1, 0.2], "fx": [1, 2]}', "read_frame takes a dict"),
    "rows": ('[\n {"kappa": 0.1, "fx": 1},\n {"kappa": 0.2, "fx": 2}\n]', "read_frame"),
    "lines": ('\ufeff{"kappa": 0.1}\n{"kappa": 0.2}\n', "write its columns as CSV"),
    "a fit": ('{"schema": "tirefit.fit/1"}', "give a fit as the tire (--model)"),
}


@pytest.mark.parametrize(("content", "remedy"), JSON.values(), ids=JSON)
def test_json_is_refused_with_a_remedy(tmp_path, content, remedy):
    (tmp_path / "a.csv").write_text(content, encoding="utf-8")
    with pytest.raises(DataError, match="JSON") as caught:
        read(tmp_path / "a.csv")
    (problem,) = caught.value.problems
    assert remedy in problem.remedy


def test_a_header_in_brackets_is_not_taken_for_json(tmp_path):
    (tmp_path / "a.csv").write_text("[s],kappa,fx,fz\n0,0.1,1,2\n1,0.2,2,2\n")
    assert read(tmp_path / "a.csv").n == 2


@pytest.mark.parametrize("name", ["a.xlsx", "a.csv"])
@pytest.mark.parametrize(
    ("rows", "fragment"),
    [
        (SHEET, "sheets not read: 'notes'"),
        ([["Measured on a rig"], [], *SHEET], "rows before the header in row 3"),
        ([SHEET[0], ["-", "N", "N"], *SHEET[1:]], "row 2 read as units"),
        ([["", *row] for row in map(list, SHEET)], "read from the sheet 'run 1'"),
        ([[*row, ""] for row in map(list, SHEET)], "read from the sheet 'run 1'"),
    ],
)
def test_the_sheet_with_columns_is_read(tmp_path, rows, fragment, name):
    save_excel(tmp_path / name, {"notes": [["Made by hand", 3]], "run 1": rows})
    data = read(tmp_path / name)
    np.testing.assert_array_equal(data["fx"], PLAIN["fx"])
    assert said(data, fragment)
    assert data.source.line[-1] == len(rows)


def test_cells_beyond_the_stated_size_of_a_sheet_are_read(tmp_path):
    save_excel(tmp_path / "made.xlsx", {"one": SHEET})
    path = tmp_path / "a.xlsx"
    with zipfile.ZipFile(tmp_path / "made.xlsx") as made:
        with zipfile.ZipFile(path, "w") as stated:
            for name in made.namelist():
                content = made.read(name)
                stated.writestr(name, content.replace(b'ref="A1:C8"', b'ref="A1:A1"'))
                assert name[-10:] != "sheet1.xml" or b'ref="A1:C8"' in content
    assert read(path).n == len(KAPPA)


@pytest.mark.parametrize("save", [save_parquet, save_arrow])
def test_a_file_without_rows_or_cut_short_is_refused(tmp_path, save):
    pytest.importorskip("pyarrow")
    path = tmp_path / "a.parquet"
    empty = {"kappa": [], "day": np.array([], "datetime64[ns]")}
    save(path, arrow_table(empty))
    assert "no data rows" in refusal(path)
    save(path, arrow_table(PLAIN))
    path.write_bytes(path.read_bytes()[:-100])
    assert "file cannot be read" in refusal(path)


def test_an_ambiguous_workbook_is_refused(tmp_path):
    path = tmp_path / "a.xlsx"
    save_excel(path, {"one": SHEET, "two": SHEET})
    assert "several sheets hold columns: 'one', 'two'" in refusal(path)
    save_excel(path, {"one": []})
    assert "the workbook is empty" in refusal(path)
    rows = [SHEET[0], *SHEET[1:3], [0.1, "#DIV/0!", 4000.0], *SHEET[4:]]
    save_excel(path, {"one": rows})
    assert "row 4, column 'fx': '#DIV/0!' is text" in refusal(path)


OLD = Path(__file__).parent / "xls" / "sweep.xls"


def test_an_excel_file_from_before_2007_is_read(tmp_path):
    pytest.importorskip("xlrd")
    (tmp_path / "a.csv").write_bytes(OLD.read_bytes())  # by content, not by ending
    old, twin = read(tmp_path / "a.csv"), read(OLD.with_suffix(".csv"))
    for name in ("sigma_x", "fx", "fz"):
        np.testing.assert_array_equal(old[name], twin[name])
    assert old.runs == twin.runs == ("1", "2")
    assert old.source.units == twin.source.units and old.source.units["fx"] == "kN"
    assert old.source.line[0] == 5 and said(old, "read from the sheet 'run 1'")
    for end in (3000, 4500):
        (tmp_path / "cut.xls").write_bytes(OLD.read_bytes()[:end])
        message = refusal(tmp_path / "cut.xls")
        assert "Excel file of before 2007 (.xls) cannot be read" in message


def pickled(protocol):
    return lambda path: path.write_bytes(pickle.dumps(PLAIN, protocol))


def of_numpy(save, *arrays, **named):
    def written(path):
        with path.open("wb") as file:
            save(file, *arrays, **named)

    return written


PYTHON = {
    "npz": of_numpy(np.savez, **PLAIN),
    "npy": of_numpy(np.save, PLAIN["fx"]),
    "pkl": pickled(4),
    "pkl of old": pickled(0),
}


@pytest.mark.parametrize("save", PYTHON.values(), ids=PYTHON)
def test_python_files_are_refused_with_a_remedy(tmp_path, save):
    path = tmp_path / "run.dat"
    save(path)
    message = refusal(path)
    assert "is not read" in message and "tirefit.read_frame" in message


def test_the_remedy_for_npz_works(tmp_path):
    np.savez(tmp_path / "a.npz", **PLAIN)
    same(read_frame(dict(np.load(tmp_path / "a.npz"))), {"fx": PLAIN["fx"]})


# --- all of them --------------------------------------------------------------------


def test_any_kind_may_be_gzipped(tmp_path):
    save_5(tmp_path / "a.mat", PLAIN)
    path = tmp_path / "a.mat.gz"
    path.write_bytes(gzip.compress((tmp_path / "a.mat").read_bytes()))
    assert read(path).name == "a"


@pytest.mark.parametrize(
    ("module", "save"),
    [
        ("pyarrow", lambda path: save_parquet(path, arrow_table(PLAIN))),
        ("openpyxl", lambda path: save_excel(path, {"one": SHEET})),
        ("xlrd", lambda path: path.write_bytes(OLD.read_bytes())),
    ],
)
def test_a_missing_library_is_reported_with_its_install_command(
    tmp_path, monkeypatch, module, save
):
    pytest.importorskip(module)
    save(tmp_path / "a.dat")
    monkeypatch.setitem(sys.modules, module, None)
    message = refusal(tmp_path / "a.dat")
    assert f"needs {module}, which is not installed" in message
    assert f"pip install 'tirefit[files]' (or: pip install {module})" in message


@pytest.mark.parametrize(
    ("start", "module"),
    [
        (b"MDF     4.10", "asammdf"),
        (b"\x89MCAP0\r\n", "rosbags.highlevel"),
        (b"SQLite format 3\x00", "rosbags.highlevel"),
    ],
)
def test_log_files_need_an_optional_extra(tmp_path, monkeypatch, start, module):
    path = tmp_path / "a.csv"
    path.write_bytes(start + bytes(200))
    monkeypatch.setitem(sys.modules, module, None)
    message = refusal(path)
    library = module.split(".")[0]
    assert f"pip install 'tirefit[logs]' (or: pip install {library})" in message


@pytest.mark.parametrize(
    ("start", "kind"),
    [
        (b"\xd0\xcf\x11\xe0\xa1\xb1", "before 2007"),
        (b"TDSm", "LabVIEW"),
        (b"\x89HDF\r\n\x1a\n", "HDF5 file that is not MATLAB's"),
    ],
)
def test_unsupported_known_formats_are_named(tmp_path, start, kind):
    path = tmp_path / "a.csv"
    path.write_bytes(start + bytes(200))
    assert kind in refusal(path)
