"""A text is read in blocks of rows with the result of a single block."""

import numpy as np
import pytest

from tirefit.data.read import read
from tirefit.data.readers import text
from tirefit.results import DataError

ROWS = 60


def rows(seed=0, count=ROWS):
    generator = np.random.default_rng(seed)
    kappa = generator.uniform(-0.05, 0.2, count)
    force = 8e4 * kappa / (1 + 20 * abs(kappa))
    names = [f"{1 + i * 4 // count}" for i in range(count)]
    return [
        [f"{i / 100:.2f}", f"{k:.6f}", f"{f:.2f}", "4000", name]
        for i, (k, f, name) in enumerate(zip(kappa, force, names, strict=True))
    ]


HEADER = ["time", "kappa", "fx", "fz", "run"]


def text_of(table, delimiter=",", end="\n", header=HEADER):
    return end.join(delimiter.join(row) for row in [header, *table]) + end


def told(path, **options):
    """Everything that reading returns, or the text of all its errors."""
    try:
        data = read(path, **options)
    except DataError as error:
        return str(error)
    columns = {name: values.tolist() for name, values in data.columns.items()}
    said = [str(problem) for problem in data.source.masked]
    return (
        repr(columns),
        data.used.tolist(),
        data.run.tolist(),
        data.runs,
        data.source.line.tolist(),
        data.source.notes,
        said,
    )


def changed(edit, **how):
    table = rows()
    edit(table)
    return text_of(table, **how)


def cell(row, column, text):
    return lambda table: table[row].__setitem__(column, text)


def line(row, *cells):
    return lambda table: table.insert(row, list(cells))


TEXTS = {
    "plain": text_of(rows()),
    "no line end": text_of(rows()).removesuffix("\n"),
    "line ends of DOS": text_of(rows(), end="\r\n"),
    "tabs": text_of(rows(), delimiter="\t"),
    "white space": text_of(rows(), delimiter="   "),
    "decimal comma": text_of(rows(), delimiter=";").replace(".", ","),
    "a decimal comma and points": changed(cell(50, 2, "1,5"), delimiter=";"),
    "grouped": changed(cell(50, 3, "4,000"), delimiter=";").replace(".", ""),
    "numbers of runs": text_of([[*row[:4], f"{i // 20}"] for i, row in enumerate(rows())]),
    "names of runs": text_of([[*row[:4], "run " + row[4]] for row in rows()]),
    "blank lines": changed(line(40, "")),
    "a comment": changed(line(40, "# here the rig stopped")),
    "a comment of cells": changed(line(40, "#1", "2", "3", "4", "5")),
    "spaces": changed(cell(45, 1, "  0.01 ")),
    "a sign": changed(cell(45, 1, "+.5e-2")),
    "text": changed(cell(45, 2, "abc")),
    "an empty cell": changed(cell(45, 2, "")),
    "nan": changed(cell(45, 2, "nan")),
    "infinity": changed(cell(45, 2, "-inf")),
    "too large": changed(cell(45, 2, "1e400")),
    "an underscore": changed(cell(45, 3, "4_000")),
    "a hexadecimal": changed(cell(45, 3, "0x10")),
    "a minus sign": changed(cell(45, 1, "\N{MINUS SIGN}0.01")),
    "a control character": changed(cell(45, 1, "0.\x01")),
    "quoted": changed(cell(45, 1, '"0.01"')),
    "a quoted comma": changed(cell(45, 4, '"1, warm"')),
    "a quoted line": changed(cell(45, 4, '"1\nwarm"')),
    "an open quotation mark": changed(cell(45, 4, '"1')),
    "a short row": changed(line(45, "1", "2")),
    "long and short rows": changed(
        lambda t: [t.insert(k, ["1"] * n) for k, n in ((20, 6), (30, 2), (44, 9))]
    ),
    "a last row cut off": text_of(rows())[:-15],
    "a delimiter at the end": text_of(rows()).replace("\n", ",\n"),
    "a second table": text_of(rows()) + text_of(rows()),
    "a load of zero": changed(cell(45, 3, "0")),
    "units": text_of([["s", "-", "kN", "N", "-"], *rows()]),
    "an old line end": text_of(rows(), end="\r"),
}


@pytest.mark.parametrize("name", TEXTS)
def test_blocks_are_read_like_the_whole(name, tmp_path, monkeypatch):
    path = tmp_path / "log.csv"
    path.write_text(TEXTS[name], newline="")
    whole = told(path, mask_bad_rows=True)
    monkeypatch.setattr(text, "_BLOCK", 20)
    assert told(path, mask_bad_rows=True) == whole


@pytest.mark.parametrize("name", ["plain", "blank lines", "tabs", "line ends of DOS", "spaces"])
def test_a_text_has_the_numbers_and_lines_of_its_rows(name, tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(TEXTS[name], newline="")
    data, table = read(path, convention="braking"), rows()
    np.testing.assert_array_equal(data["time"], [float(row[0]) for row in table])
    np.testing.assert_array_equal(data["fx"], [float(row[2]) for row in table])
    assert data.runs == ("1", "2", "3", "4")
    blank = (name == "blank lines") * (np.arange(ROWS) >= 40)
    np.testing.assert_array_equal(data.source.line, 2 + np.arange(ROWS) + blank)


def test_names_of_runs_with_points_leave_the_decimal_comma(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("run;kappa;fx;fz\n2024.1;0,5;10,5;4000,0\n2024.2;0,4;11,5;4000,5\n")
    found = read(path, convention="braking")
    assert list(found.runs) == ["2024.1", "2024.2"] and list(found["fz"]) == [4000.0, 4000.5]
