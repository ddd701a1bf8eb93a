"""Read text files and frames as tables of cells: bytes, encoding, delimiter, header."""

import codecs
import csv
import gzip
import io
import itertools
import re
import zlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from tirefit.data.check import BadRows
from tirefit.data.columns import guess, is_number
from tirefit.data.declared import stated_convention
from tirefit.data.loggers import exported_by, vbo_table
from tirefit.data.remote import Place
from tirefit.data.table import Layout
from tirefit.data.units import known_unit
from tirefit.data.white import commented_header, header_above_numbers, tabbed
from tirefit.door import DATA, too_large
from tirefit.results import DataError, did_you_mean

SPACED = "columns separated by white space"  # note on such a text

_DELIMITERS = "\t;|,"
_END = "\0"
_CONSTANT = re.compile(r"([A-Za-z_]+)=(-?\d+(?:\.\d+)?(?:e[-+]?\d+)?)\b")
"""A constant of the tire in the first line of a table that this package wrote."""
_SEARCHED = 60  # first lines with content, which must contain the header
_LONGEST = 10  # largest number of lines of a header with quoted line ends


@dataclass(frozen=True)
class Table:
    """Cells of a file or frame before their meaning is known."""

    file: str
    name: str
    headers: list[str]
    cells: list  # per column n strings or an (n,) number array
    lines: np.ndarray  # (n,) lines of the rows
    ragged: np.ndarray  # (n,) bool, rows without the header's number of fields
    header_line: int | None = None
    delimiter: str = ""
    units_row: list[str] | None = None
    units_line: int | None = None
    sha256: str = ""
    notes: tuple[str, ...] = ()  # assumptions
    faults: tuple[BadRows, ...] = ()
    layout: Layout = field(default_factory=Layout)
    doubts: tuple[str, ...] = ()  # warnings on content that may have another meaning
    constants: Mapping[str, float] = field(default_factory=dict)  # see ``Source``


def read_bytes(path: Place) -> bytes:
    """Bytes of a file. If it does not exist, the DataError suggests a similar name."""
    try:
        with path.open("rb") as file:
            raw = file.read(DATA + 1)
    except FileNotFoundError:
        if isinstance(path, Path) and path.is_symlink():
            reason = f"it is a link to {path.readlink()}, which does not exist"
            raise _refusal(reason, "correct the link", path) from None
        try:
            beside = [other.name for other in path.parent.iterdir()]
        except OSError:
            beside = []
        remedy = did_you_mean(path.name, beside).strip() or "check the path"
        raise _refusal("the file does not exist", remedy, path) from None
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        cause = getattr(error, "strerror", None) or error
        reason = f"the file cannot be read: {cause}"
        raise _refusal(reason, "check the path and its permissions", path) from error
    if len(raw) > DATA:
        raise too_large(path, DATA)
    return raw


def _refusal(reason: str, remedy: str, path, row: int | None = None) -> DataError:
    return DataError(reason, remedy, str(path), row)


def gunzipped(raw: bytes, path: Place) -> bytes:
    """The bytes themselves, or the content of a gzip file."""
    if not raw.startswith(b"\x1f\x8b"):
        return raw
    try:
        with gzip.open(io.BytesIO(raw)) as packed:
            content = packed.read(DATA + 1)
    except (OSError, EOFError, zlib.error) as error:
        reason = f"the gzip file is damaged: {error}"
        raise _refusal(reason, "copy or compress it again", path) from error
    if len(content) > DATA:
        raise too_large(path, DATA)
    return content


def decoded(raw: bytes, path: Place) -> tuple[str, list[str]]:
    """Text of the file, and notes on its encoding."""
    export = "give a text file: CSV, semicolon- or tab-separated, also gzipped (.gz)"
    if raw.startswith(b"PK\x03\x04"):
        reason = "not a text file but a zip archive or spreadsheet"
        raise _refusal(reason, "export the sheet as CSV", path)
    try:
        if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
            text, notes = raw.decode("utf-16"), ["read as UTF-16"]
        else:
            text, notes = raw.decode("utf-8"), []
    except UnicodeDecodeError as error:
        if error.encoding.startswith("utf-16"):
            raise _refusal("not a text file: broken UTF-16", export, path) from error
        raw = raw.removeprefix(codecs.BOM_UTF8)
        text, notes = raw.decode("latin-1"), ["not UTF-8: read as Latin-1"]
    # Joined files have byte order marks inside; DOS ends a text with \x1a.
    text = text.replace("\ufeff", "").removesuffix("\x1a")
    binary = re.search(r"[\x00-\x08\x0e-\x1a\x1c-\x1f]", text)
    if binary:
        row = len(re.findall(r"\r\n?|\n", text[: binary.start()])) + 1
        reason = "not a text file: it holds binary data"
        if text.count("\0") > len(text) / 3:
            reason = "it looks like UTF-16 or UTF-32 without a byte order mark"
            export = "save it as UTF-8"
        raise _refusal(reason, export, path, row)
    return text, notes


def table_of_text(
    text: str, path: Place, digest: str, declared: Collection[str], notes: list[str]
) -> Table:
    """Cells of a text; ``declared`` headers help to find the header."""
    raw = list(io.StringIO(text, newline=""))
    lines = content_lines(raw)
    if header := commented_header(raw, lambda name: guess(name) is not None):
        lines[: header[0] + 1] = ["\n"] * header[0] + [header[1]]
        notes.append(f"header read from the comment in line {header[0] + 1}")
    content = (i for i, line in enumerate(lines) if line != "\n")
    searched = list(itertools.islice(content, _SEARCHED))
    if not searched:
        raise _refusal("the file is empty", "give a header line and data rows", path)
    if logger := exported_by(raw[0]):
        start = _names_of_export(lines, searched)
        searched = [index for index in searched if index >= start] or searched
    start, delimiter, words = _find_header(lines, searched, declared)
    if words:
        notes.append(SPACED)
        lines[start:] = tabbed(lines[start:], words)
    if start != searched[0]:
        notes.append(f"lines before the header in line {start + 1} skipped")
    rows, numbers = split_rows(lines[start:], delimiter, start, path)
    if logger:
        notes.append(f"export of {logger}")
        # Names, units and, in some versions of AiM, channel numbers.
        kept = [k for k, r in enumerate(rows) if not (0 < k < 4 and _counts_up(r))]
        rows, numbers = [rows[k] for k in kept], [numbers[k] for k in kept]
    common = 0.0 if logger else 0.5
    table = table_of_rows(rows, numbers, path, digest, notes, delimiter, common)
    layout, doubts = stated_convention(raw[:start], str(path))
    above = raw[0] if raw[0].startswith(("# tirefit ", "# tirefit:")) else ""
    stated = re.findall(r".*, constants (.*)", above)
    constants = {k: float(v) for k, v in _CONSTANT.findall("".join(stated))}
    return replace(table, layout=layout, doubts=doubts, constants=constants)


def table_of_vbo(text: str, path: Place, digest: str, notes: list[str]) -> Table:
    """Cells of a .vbo file of Racelogic."""
    found = vbo_table(text, str(path))
    notes = [*notes, "read as a .vbo file of Racelogic", *found.notes]
    table = table_of_rows(found.rows, found.numbers, path, digest, notes)
    layout = Layout(units_from="[channel units], or standard in .vbo files")
    return replace(table, units_row=found.units, layout=layout, doubts=found.doubts)


def content_lines(lines: list[str]) -> list[str]:
    """The same lines, with lines without content (such as comments) reduced to line ends."""
    return ["\n" if line.lstrip().startswith("#") or not line.strip() else line for line in lines]


def table_of_rows(
    rows: list[list[str]],
    numbers: list[int],
    path: Place,
    digest: str,
    notes: list[str],
    delimiter: str = "",
    common: float = 0.5,
) -> Table:
    """A table of rows of cells, the header first, and the line of each in the file.

    ``common`` is the smallest share of common units in a row of units.
    """
    headers = [re.sub(r"\s*[\r\n]\s*", " ", cell.strip()) for cell in rows[0]]
    header_line, rows, numbers = numbers[0], rows[1:], numbers[1:]
    if all(is_number(word) for cell in headers for word in cell.split() or [cell]):
        reason = "the first line holds numbers, not column names"
        remedy = "add a header line such as kappa,fx,fz, without a # before it"
        raise _refusal(reason, remedy, path, header_line)
    units_row = units_line = None
    if rows and _is_units_row(rows[0], len(headers), common):
        notes.append(f"row {numbers[0]} read as units")
        units_row, units_line = rows[0], numbers[0]
        rows, numbers = rows[1:], numbers[1:]
    if not rows:
        reason = "there are no data rows below the header"
        raise _refusal(reason, "give at least as many rows as parameters", path)
    ragged, faults = even_out(rows, len(headers), numbers)
    return Table(
        str(path), stem_of(path), headers, list(zip(*rows, strict=True)),
        np.array(numbers), ragged, header_line, delimiter, units_row, units_line,
        digest, tuple(notes), faults,
    )  # fmt: skip


def stem_of(path: Place) -> str:
    """Name of the data of a file: the file name without its endings."""
    return Path(path.name.removesuffix(".gz")).stem


def split_rows(lines, delimiter, start, path) -> tuple[list[list[str]], list[int]]:
    """Rows of cells without blank lines, and the line of each in the file."""
    # An added last line shows whether an open quotation mark includes the end.
    reader = csv.reader([*lines, _END], delimiter=delimiter, skipinitialspace=True)
    rows, numbers, number = [], [], start + 1
    try:
        for row in reader:
            if row:
                rows.append(row)
                numbers.append(number)
            number = start + reader.line_num + 1
    except csv.Error as error:
        reason = f"the line cannot be split: {error}"
        remedy = "look for a quotation mark that is not closed"
        raise _refusal(reason, remedy, path, number) from error
    if rows.pop() != [_END] or not rows:
        reason = "a quotation mark is not closed"
        raise _refusal(reason, "close or remove it", path, numbers[-1])
    return rows, numbers[:-1]


def even_out(rows: list[list[str]], width: int, lines) -> tuple[np.ndarray, tuple]:
    """Make all rows ``width`` long; rows of another length are marked and faulty."""
    ragged = np.zeros(len(rows), bool)
    wrong_rows = []
    for index, row in enumerate(rows):
        if len(row) == width:
            continue
        if len(row) > width and not any(cell.strip() for cell in row[width:]):
            rows[index] = row[:width]  # a delimiter at the end of the line
            continue
        inside = sum(cell.count("\n") for cell in row)
        until = f" in rows {lines[index]} to {lines[index] + inside}" if inside else ""
        wrong_rows.append((index, f"{len(row)} fields{until}"))
        ragged[index] = True
        rows[index] = ["nan"] * width
    if not wrong_rows:
        return ragged, ()
    indices, shown = zip(*wrong_rows, strict=True)
    return ragged, (BadRows(None, indices, shown, f"where the header has {width}"),)


def table_of_frame(frame, name: str) -> Table:
    """A table of a frame, a structured array or a mapping of arrays; rows are counted
    from 0. Dates and times become seconds since the first."""
    if hasattr(frame, "collect_schema") and hasattr(frame, "collect"):
        frame = frame.collect()  # a lazy frame of polars
    fields = getattr(getattr(frame, "dtype", None), "names", None)
    names = list(fields or getattr(frame, "columns", frame))
    headers = [str(header) for header in names]
    if hasattr(frame, "iloc"):
        values = [frame.iloc[:, i].to_numpy() for i in range(len(headers))]
    else:
        values = [_shown(frame[name]) for name in names]
    values = [_seconds(value) if value.dtype.kind in "mM" else value for value in values]
    lengths = {value.shape for value in values}
    if not values or len(lengths) > 1 or values[0].ndim != 1 or not len(values[0]):
        shapes = ", ".join(f"{h}: {v.shape}" for h, v in zip(headers, values, strict=True))
        reason = f"columns must be one-dimensional, equally long and not empty ({shapes})"
        raise _refusal(reason, "give arrays of shape (n,)", name)
    cells = [
        value if value.dtype.kind in "fiub" else ["" if x is None else str(x) for x in value]
        for value in values
    ]
    n = len(values[0])
    return Table(name, name, headers, cells, np.arange(n), np.zeros(n, bool))


def _shown(values) -> np.ndarray:
    """An array; masked elements become missing values."""
    if isinstance(values, np.ma.MaskedArray) and values.dtype.kind in "fiub":
        return np.ma.filled(values.astype(float), np.nan)
    return np.asarray(values)


def _seconds(values: np.ndarray) -> np.ndarray:
    """Durations in seconds; dates and times in seconds since the first one."""
    if values.dtype.kind == "M":
        known = values[~np.isnat(values)]
        values = values - (known.min() if len(known) else np.datetime64(0, "s"))
    return values / np.timedelta64(1, "s")


def _names_of_export(lines: Sequence[str], searched: Sequence[int]) -> int:
    """Index of the line of names in the export of a logger: the last one above the numbers
    that is as wide as they are and no row of units; else the line below the first blank one."""
    for delimiter in _DELIMITERS:
        try:
            split = [next(csv.reader([lines[i]], delimiter=delimiter)) for i in searched]
        except csv.Error:
            continue
        cells = [[cell.strip(' "') for cell in row] for row in split]
        rows = dict(zip(searched, cells, strict=True))
        found = [i for i, row in rows.items() if _is_numeric(row) and not _counts_up(row)]
        names = [
            i
            for i, row in rows.items()
            if found and i < found[0] and len(row) == len(rows[found[0]])
            if row[0] and not _counts_up(row) and known_unit(row[0]) is None
        ]
        if names:
            return names[-1]
    return lines.index("\n") + 1 if "\n" in lines else 1


def _is_numeric(row: Sequence[str]) -> bool:
    """Whether a row has several cells, all numbers or empty."""
    cells = [cell.replace(",", ".", 1) for cell in row if cell]
    return len(cells) > 1 and all(map(is_number, cells))


def _find_header(lines, searched, declared) -> tuple[int, str, list[str]]:
    """Index of the header line, the delimiter, and its words if white space separates.

    Some systems write a title first: the header is the first of the searched lines with
    two recognised columns, or else the first as wide as the rows of numbers below it.
    White space separates if no delimiter gives columns and white space gives as many as
    the rows of numbers have.
    """
    declared = {header.strip().casefold() for header in declared}

    def is_known(name: str) -> bool:
        return name.casefold() in declared or guess(name) is not None

    def split(index: int, delimiter: str) -> tuple[int, int]:
        """Recognised columns and all columns of a line, which quotes may extend."""
        some = lines[index : index + _LONGEST]
        try:
            names = next(csv.reader(some, delimiter=delimiter, skipinitialspace=True))
        except csv.Error:  # too long for one cell
            return 0, 0
        return sum(is_known(name.strip()) for name in names), len(names)

    first = searched[0]
    best = {}
    for index in searched:
        widths = {delimiter: split(index, delimiter) for delimiter in _DELIMITERS}
        best[index] = max(_DELIMITERS, key=widths.__getitem__)
        if widths[best[index]][0] < 2:
            continue
        is_title = split(first, best[index])[1] < widths[best[index]][1]
        header = index if is_title else first
        words = _spaced_under_tabs(lines, header, best[header], is_known)
        return header, best[header], words
    below = header_above_numbers(lines, searched, is_known)
    if below and (below[0] != first or split(first, best[first])[1] == 1):
        return below[0], "\t", below[1]
    for delimiter in _DELIMITERS:
        columns = [split(index, delimiter)[1] for index in searched]
        header = searched[columns.index(columns[-1])]
        cells = lines[header].split(delimiter)
        if columns[-1] > columns[0] > 0 and not any(map(is_number, cells)):
            return header, delimiter, []
    return first, best[first], []


def _spaced_under_tabs(lines, header, delimiter, is_known) -> list[str]:
    """Words of a header that has tabs while the rows below have none; else empty."""
    tabs = any("\t" in line for line in lines[header + 1 : header + _LONGEST])
    below = header_above_numbers(lines, [header], is_known)
    return below[1] if delimiter == "\t" and below and not tabs else []


def _counts_up(row: list[str]) -> bool:
    """Whether a row holds the channel numbers 1, 2, 3, ..."""
    cells = [cell.strip() for cell in row if cell.strip()]
    return len(cells) > 1 and cells == [str(k + 1) for k in range(len(cells))]


def _is_units_row(row: list[str], width: int, common: float) -> bool:
    """Whether a row has no numbers and at least the share ``common`` of known units."""
    cells = [cell.strip() for cell in row]
    stated = [cell for cell in cells if cell not in ("", "-")]
    if len(row) != width or not stated or any(map(is_number, cells)):
        return False
    known = sum(known_unit(cell) is not None for cell in stated)
    return known >= common * len(stated)
