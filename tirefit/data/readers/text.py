"""Read text files and frames as tables of cells: bytes, encoding, delimiter, header."""

import codecs
import csv
import gzip
import io
import itertools
import re
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tirefit.data.check import BadRows
from tirefit.data.columns import Guess, IsKnown, guess, is_number
from tirefit.data.declared import stated_convention
from tirefit.data.readers.cells import Column, has_decimal_comma, parsed, split
from tirefit.data.readers.header import (
    commented_header,
    counts_up,
    find_header,
    is_units_row,
    names_of_export,
    spaced_head,
)
from tirefit.data.readers.loggers import exported_by, vbo_table
from tirefit.data.readers.remote import Place
from tirefit.data.table import Layout
from tirefit.door import DATA, too_large
from tirefit.results import DataError, UsageError, did_you_mean

Row = tuple[int, list[str]]
"""Line in the file, and cells."""

_END = "\0"
_OF_TEXT = bytes([*range(0x20, 0x7F), *b"\n\r\t"])
_CONSTANT = re.compile(r"([A-Za-z_]+)=(-?\d+(?:\.\d+)?(?:e[-+]?\d+)?)\b")
"""A constant of the tire in the first line of a table that this package wrote."""
_SEARCHED = 60  # first lines with content, which must contain the header


@dataclass(frozen=True)
class Table:
    """Cells of a file or frame before their meaning is known."""

    file: str
    name: str
    headers: list[str]
    cells: list[Any]  # per column n strings or an (n,) number array
    lines: np.ndarray  # (n,) lines of the rows
    ragged: np.ndarray  # (n,) bool, rows without the header's number of fields
    header_line: int | None = None
    units_row: list[str] | None = None
    units_line: int | None = None
    sha256: str = ""
    notes: tuple[str, ...] = ()  # assumptions
    faults: tuple[BadRows, ...] = ()
    layout: Layout = field(default_factory=Layout)
    doubts: tuple[str, ...] = ()  # warnings on content that may have another meaning
    constants: Mapping[str, float] = field(default_factory=dict)  # see ``Source``
    epoch: float = 0.0  # the file's time [s] where its column ``time`` is 0


def read_bytes(path: Place) -> bytes:
    """Bytes of a file. If it does not exist, the DataError suggests a similar name."""
    try:
        with path.open("rb") as file:
            raw = file.read(DATA + 1)
    except FileNotFoundError:
        beside = list[str]()
        with suppress(OSError):  # no such folder, or no permission to list it
            beside = [x.name for x in path.parent.iterdir()] if isinstance(path, Path) else beside
        remedy = did_you_mean(path.name, beside).strip() or "check the path"
        raise DataError("the file does not exist", remedy, str(path)) from None
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        cause = getattr(error, "strerror", None) or error
        reason = f"the file cannot be read: {cause}"
        raise DataError(reason, "check the path and its permissions", str(path)) from error
    if len(raw) > DATA:
        raise too_large(str(path), DATA)
    return raw


def gunzipped(raw: bytes, path: Place) -> bytes:
    """The bytes themselves, or the content of a gzip file."""
    if not raw.startswith(b"\x1f\x8b"):
        return raw
    try:
        with gzip.open(io.BytesIO(raw)) as packed:
            content = packed.read(DATA + 1)
    except (OSError, EOFError, zlib.error) as error:
        reason = f"the gzip file is damaged: {error}"
        raise DataError(reason, "copy or compress it again", str(path)) from error
    if len(content) > DATA:
        raise too_large(str(path), DATA)
    return content


def decoded(raw: bytes, path: Place) -> tuple[str, list[str]]:
    """Text of the file, and notes on its encoding."""
    export = "give a text file: CSV, semicolon- or tab-separated, also gzipped (.gz)"
    if raw.startswith(b"PK\x03\x04"):
        reason = "not a text file but a zip archive or spreadsheet"
        raise DataError(reason, "export the sheet as CSV", str(path))
    try:
        if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
            text, notes = raw.decode("utf-16"), ["read as UTF-16"]
        else:
            text, notes = raw.decode("utf-8"), []
    except UnicodeDecodeError as error:
        if error.encoding.startswith("utf-16"):
            raise DataError("not a text file: broken UTF-16", export, str(path)) from error
        raw = raw.removeprefix(codecs.BOM_UTF8)
        text, notes = raw.decode("latin-1"), ["not UTF-8: read as Latin-1"]
    # Joined files have byte order marks inside; DOS ends a text with \x1a.
    text = text.replace("\ufeff", "").removesuffix("\x1a")
    # Bytes of text are deleted first, as the search of a large text is slow.
    holds_others = raw.translate(None, _OF_TEXT)
    binary = re.search(r"[\x00-\x08\x0e-\x1a\x1c-\x1f]", text) if holds_others else None
    if binary:
        row = len(re.findall(r"\r\n?|\n", text[: binary.start()])) + 1
        reason = "not a text file: it holds binary data (or UTF-16 without a byte order mark)"
        raise DataError(reason, export, str(path), row)
    return text, notes


def table_of_text(
    text: str, path: Place, digest: str, is_known: IsKnown, notes: list[str]
) -> Table:
    """Cells of a text."""
    # A StringIO would take four bytes for each character.
    raw = list(io.TextIOWrapper(io.BytesIO(text.encode()), "utf-8", newline=""))
    # Lines without content, such as comments, are reduced to line ends.
    blank = ("", "#") if "#" in text else ("",)
    lines = ["\n" if line.lstrip()[:1] in blank else line for line in raw]
    if header := commented_header(raw):
        lines[: header[0] + 1] = ["\n"] * header[0] + [header[1]]
        notes.append(f"header read from the comment in line {header[0] + 1}")
    content = (i for i, line in enumerate(lines) if line != "\n")
    searched = list(itertools.islice(content, _SEARCHED))
    if not searched:
        raise DataError("the file is empty", "give a header line and data rows", str(path))
    logger, delimiter = exported_by(raw[0])
    if logger:
        start, words = names_of_export(lines, searched, delimiter), list[str]()
    else:
        start, delimiter, words = find_header(lines, searched, is_known)
    if words:
        notes.append("columns separated by white space")
        head = spaced_head(lines[start : start + _LEAD], words)
        lines[start : start + len(head)] = head
    if start != searched[0]:
        notes.append(f"lines before the header in line {start + 1} skipped")
    if logger:
        notes.append(f"export of {logger}")
    rows = _split_rows(lines[start:], delimiter, start, path)
    lead = list(itertools.islice(rows, _LEAD))
    table, count = _head(lead, path, digest, notes, bool(logger))
    first = [*lead[count:], *itertools.islice(rows, _BLOCK)]
    commas = delimiter != "," and _has_commas(first, table.headers, is_known)

    def row_of(line: int) -> list[str]:  # a cell in quotation marks may go on in the next lines
        return next(split((lines[k] for k in range(line - 1, len(lines))), delimiter))

    table = _with_rows(table, itertools.chain(first, rows), row_of, commas)
    # Comments stand above the header, or between it and the rows.
    above = raw[: table.lines[0] - 1]
    above = [x if k < start or lines[k] == "\n" else "" for k, x in enumerate(above)]
    layout, doubts = stated_convention(above, str(path))
    of_us = raw[0] if raw[0].startswith(("# tirefit ", "# tirefit:")) else ""
    stated = re.findall(r".*, constants (.*)", of_us)
    constants = {k: float(v) for k, v in _CONSTANT.findall("".join(stated))}
    return replace(table, layout=layout, doubts=doubts, constants=constants)


def table_of_vbo(text: str, path: Place, digest: str, notes: list[str]) -> Table:
    """Cells of a .vbo file of Racelogic."""
    rows, units, more, doubts = vbo_table(text, str(path))
    notes = [*notes, "read as a .vbo file of Racelogic", *more]
    table = table_of_rows(rows, path, digest, notes)
    layout = Layout(units_from="[channel units], or standard in .vbo files")
    return replace(table, units_row=units, layout=layout, doubts=doubts)


def table_of_rows(rows: list[Row], path: Place, digest: str, notes: list[str]) -> Table:
    """A table of rows of cells, the header first."""
    table, count = _head(rows[:2], path, digest, notes, False)
    return _with_rows(table, iter(rows[count:]), dict(rows).__getitem__)


def _head(
    rows: list[Row], path: Place, digest: str, notes: list[str], is_export: bool
) -> tuple[Table, int]:
    """A table without rows, and the number of rows above those of data: of the header, units
    and, in an export of a logger, channel numbers."""
    header_line, header = rows[0]
    headers = [re.sub(r"\s*[\r\n]\s*", " ", cell.strip()) for cell in header]
    if all(is_number(word) for cell in headers for word in cell.split() or [cell]):
        reason = "the first line holds numbers, not column names"
        remedy = "add a header line such as kappa,fx,fz, without a # before it"
        raise DataError(reason, remedy, str(path), header_line)
    units_row = units_line = None
    count = 1
    for number, row in rows[1:]:
        if units_row is None and is_units_row(row, len(headers), 0.0 if is_export else 0.5):
            notes.append(f"row {number} read as units")
            units_row, units_line = row, number
        elif not (is_export and counts_up(row)):
            break
        count += 1
    empty = Table(
        str(path), stem_of(path), headers, [], np.empty(0), np.empty(0), header_line,
        units_row=units_row, units_line=units_line, sha256=digest, notes=tuple(notes),
    )  # fmt: skip
    return empty, count


_LEAD = 4  # rows of header, units and channel numbers, and one of data

_BLOCK = 2**14  # rows that are converted at once


def _with_rows(
    table: Table, rows: Iterator[Row], row_of: Callable[[int], list[str]], commas: bool = False
) -> Table:
    """The table with rows; ``row_of`` gives the cells of a line. Rows of another length than the
    header become NaN; delimiters at the end of a line do not count."""
    width, lines, wrong = len(table.headers), list[int](), dict[int, str]()
    columns: list[list[np.ndarray]] = [[] for _ in range(width)]
    while block := list(itertools.islice(rows, _BLOCK)):
        for k, (line, row) in enumerate(block):
            if len(row) < width or any(cell.strip() for cell in row[width:]):
                inside = sum(cell.count("\n") for cell in row)
                until = f" in rows {line} to {line + inside}" if inside else ""
                wrong[len(lines) + k] = f"{len(row)} fields{until}"
                block[k] = line, ["nan"] * width
        for k, values in enumerate(columns):
            values.append(parsed([row[k] for _, row in block], commas))
        lines += [line for line, _ in block]
    if not lines:
        reason = "there are no data rows below the header"
        raise DataError(reason, "give at least as many rows as parameters", table.file)

    def row_at(k: int) -> list[str]:
        return ["nan"] * width if k in wrong else row_of(lines[k])

    ragged = np.zeros(len(lines), bool)
    ragged[list(wrong)] = True
    rule = f"where the header has {width}"
    faults = (BadRows(None, [*wrong], [*wrong.values()], rule),) if wrong else ()
    numbers = [Column(np.concatenate(values), k, row_at) for k, values in enumerate(columns)]
    notes = [*table.notes, *["numbers read with a decimal comma (1,5 is 1.5)"] * commas]
    table = replace(table, notes=tuple(notes), lines=np.array(lines), ragged=ragged)
    return replace(table, cells=numbers, faults=faults)


def _has_commas(rows: list[Row], headers: Sequence[str], is_known: IsKnown) -> bool:
    """Whether a comma is the decimal mark of the first rows, by their known columns."""
    # Names of runs, as "dry, lap 1" or "2024.1", say nothing of the numbers.
    run = Guess("run", None)
    known = [k for k, x in enumerate(headers) if is_known(x) and guess(x) != run]
    cells = [row[k] for _, row in rows for k in known or range(len(row)) if k < len(row)]
    return any("," in cell for cell in cells) and has_decimal_comma(cells)


def stem_of(path: Place) -> str:
    """Name of the data of a file: the file name without its endings."""
    return Path(path.name.removesuffix(".gz")).stem


def _split_rows(lines: list[str], delimiter: str, start: int, path: Place) -> Iterator[Row]:
    """Line in the file and cells of each row that is not blank."""
    # An added last line shows whether an open quotation mark includes the end.
    reader = split([*lines, _END], delimiter)
    number, last = start + 1, 0
    try:
        for row in reader:
            if row == [_END] and last:
                return
            if row:
                last = number
                yield number, row
            number = start + reader.line_num + 1
    except csv.Error as error:
        reason = f"the line cannot be split: {error}"
        remedy = "look for a quotation mark that is not closed"
        raise DataError(reason, remedy, str(path), number) from error
    reason = "a quotation mark is not closed"
    raise DataError(reason, "close or remove it", str(path), last)


def table_of_frame(frame: Any, name: str) -> Table:
    """A table of a frame, a structured array or a mapping of arrays; rows are counted
    from 0. Dates and times become seconds since the first.

    Raises:
        UsageError: data of another type.
        DataError: columns of different lengths.
    """
    if hasattr(frame, "collect_schema") and hasattr(frame, "collect"):
        frame = frame.collect()  # a lazy frame of polars
    fields = getattr(getattr(frame, "dtype", None), "names", None)
    if not (fields or isinstance(frame, Mapping) or hasattr(frame, "columns")):
        raise UsageError(
            f"data of type {type(frame).__name__}: give what `tirefit.read` returns, a path,"
            " a frame, or a mapping of column to array"
        )
    names = list(fields or getattr(frame, "columns", frame))
    headers = [str(header) for header in names]
    if hasattr(frame, "iloc"):
        values = [frame.iloc[:, i].to_numpy() for i in range(len(headers))]
    else:
        values = [_shown(frame[name]) for name in names]
    values = [in_seconds(value) for value in values]
    lengths = {value.shape for value in values}
    if not values or len(lengths) > 1 or values[0].ndim != 1 or not len(values[0]):
        shapes = ", ".join(f"{h}: {v.shape}" for h, v in zip(headers, values, strict=True))
        reason = f"columns must be one-dimensional, equally long and not empty ({shapes})"
        raise DataError(reason, "give arrays of shape (n,)", name)
    cells = [
        value if value.dtype.kind in "fiub" else ["" if x is None else str(x) for x in value]
        for value in values
    ]
    n = len(values[0])
    return Table(name, name, headers, cells, np.arange(n), np.zeros(n, bool))


def in_seconds(values: np.ndarray) -> np.ndarray:
    """Dates (n,) as seconds since the first, durations as seconds; other values unchanged."""
    if values.dtype.kind == "M":
        known = values[~np.isnat(values)]
        values = values - (known.min() if len(known) else np.datetime64(0, "s"))
    return values / np.timedelta64(1, "s") if values.dtype.kind == "m" else values


def _shown(values: ArrayLike) -> np.ndarray:
    """An array; masked elements become missing values."""
    if isinstance(values, np.ma.MaskedArray) and values.dtype.kind in "fiub":
        return np.ma.filled(values.astype(float), np.nan)
    return np.asarray(values)
