"""Read Parquet, Arrow and Excel files as columns and rows of cells."""

import datetime
import io
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from tirefit.data.columns import IsKnown
from tirefit.data.readers.extras import extra, readable
from tirefit.data.readers.mat import Channels
from tirefit.data.readers.text import in_seconds
from tirefit.door import DATA, MIB, too_large
from tirefit.results import DataError

ARROW = b"PAR1", b"ARROW1"  # first bytes of a Parquet and of an Arrow (Feather 2) file
_UNIT_KEYS = (b"unit", b"units", b"Unit", b"Units")
_SEARCHED = 60  # first rows of a sheet, which must contain the header


# --- Parquet and Arrow --------------------------------------------------------------


def channels_of_arrow(content: bytes, file: str) -> Channels:
    """The columns of a Parquet or Arrow file; units from each field's metadata.

    A missing number is NaN, a missing text is empty.

    Raises:
        DataError: pyarrow is missing, or the file is damaged.
    """
    is_parquet = content.startswith(ARROW[0])
    kind = "Parquet" if is_parquet else "Arrow"
    pyarrow = extra("pyarrow", f"{kind} files", file)
    with readable(f"{kind} file", file, "write it again"):
        if is_parquet:
            packed = extra("pyarrow.parquet", "", file).ParquetFile(io.BytesIO(content))
            # Repeated values are compressed: a small file may hold a large table.
            if packed.metadata.num_rows * packed.metadata.num_columns * 8 > DATA:
                raise too_large(file, DATA)
            table = packed.read()
        else:
            table = extra("pyarrow.ipc", "", file).open_file(content).read_all()
        table.validate(full=True)
        columns, left = _columns(table, pyarrow.types)
        units = {
            field.name: field.metadata[key].decode()
            for field in table.schema
            for key in _UNIT_KEYS
            if key in (field.metadata or {})
        }
    unread = [f"columns not read: {', '.join(left)}"] if left else []
    return Channels(columns, units, (f"read as a file of {kind}", *unread))


def _columns(table: Any, types: Any) -> tuple[dict[str, Any], list[str]]:
    """Columns by name, and the columns that are not read."""
    columns: dict[str, Any] = {}
    left = []
    numbers = types.is_boolean, types.is_integer, types.is_floating, types.is_decimal
    texts = types.is_string, types.is_large_string, types.is_string_view
    for name, column in zip(table.column_names, table.columns, strict=True):
        kind = column.type
        if types.is_dictionary(kind):
            column = column.cast(kind.value_type)
            kind = kind.value_type
        if name in columns:
            left.append(f"{name!r} (again)")
        elif any(is_kind(kind) for is_kind in numbers):
            columns[name] = column.cast("double").to_numpy().astype(float)
        elif types.is_duration(kind) or types.is_timestamp(kind):
            columns[name] = in_seconds(column.to_numpy())
        elif any(is_kind(kind) for is_kind in texts):
            columns[name] = ["" if text is None else text for text in column.to_pylist()]
        else:
            left.append(f"{name!r} ({kind})")
    return columns, left


# --- Excel --------------------------------------------------------------------------


_OLE = b"\xd0\xcf\x11\xe0"
"""First bytes of Excel files from before 2007, and of other old Office files."""


def is_excel(content: bytes) -> bool:
    """Whether these are the bytes of an Excel workbook (.xlsx, .xlsm, .xls)."""
    if content.startswith(_OLE):
        return True
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            return "xl/workbook.xml" in archive.namelist()
    except (zipfile.BadZipFile, OSError, ValueError):
        return False


def sheet_of_excel(
    content: bytes, file: str, is_known: IsKnown
) -> tuple[list[tuple[int, list[str]]], list[str]]:
    """The only sheet with a header of at least two known columns: number and cells of each row
    from its header, and notes.

    Raises:
        DataError: openpyxl, or xlrd for a file from before 2007, is missing, the file is
            damaged, or no sheet or several sheets have columns.
    """
    sheets = _sheets(content, file)
    filled = {title: rows for title, rows in sheets.items() if rows}
    if not filled:
        raise DataError("the workbook is empty", "give a header and rows", file)
    headers = {}  # title -> index of the first row with the most known names, and how many
    for title, rows in filled.items():
        counts = [sum(map(is_known, texts)) for _, texts in rows[:_SEARCHED]]
        headers[title] = counts.index(max(counts)), max(counts)
    known = [title for title, (_, count) in headers.items() if count >= 2]
    if len(known) > 1:
        reason = f"several sheets hold columns: {', '.join(map(repr, known))}"
        raise DataError(reason, "save each as a workbook of its own, or as CSV", file)
    title = known[0] if known else next(iter(filled))
    start = headers[title][0] if known else 0
    notes = [f"read from the sheet {title!r}"]
    if start:
        notes.append(f"rows before the header in row {filled[title][start][0]} skipped")
    if others := ", ".join(repr(other) for other in sheets if other != title):
        notes.append(f"sheets not read: {others}")
    rows = filled[title][start:]
    width = max((i + 1 for i, cell in enumerate(rows[0][1]) if cell), default=0)
    return [(n, [*row[:width], *filter(None, row[width:])]) for n, row in rows], notes


def _sheets(content: bytes, file: str) -> dict[str, list[tuple[int, list[str]]]]:
    """Title -> rows of every sheet."""
    module, age, cells = "openpyxl", "", _cells_of_xlsx
    if content.startswith(_OLE):
        module, age, cells = "xlrd", " of before 2007 (.xls)", _cells_of_xls
    library = extra(module, f"Excel files{age}", file)
    if not age:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            size = sum(part.file_size for part in archive.infolist())
        if size > _UNPACKED:
            reason = f"unpacked, the workbook has {size / MIB:.0f} MiB,"
            raise DataError(f"{reason} more than {_UNPACKED // MIB}", _AS_CSV, file)
    remedy = "save it again, as .xlsx and without a password"
    with readable(f"Excel file{age}", file, remedy):
        return {title: _rows(rows, file) for title, rows in cells(library, content)}


def _cells_of_xlsx(
    library: Any, content: bytes
) -> Iterator[tuple[str, Iterable[Sequence[object]]]]:
    """Title and rows of values of each sheet."""
    book = library.load_workbook(io.BytesIO(content), read_only=True, data_only=True)
    for sheet in book.worksheets:
        sheet.reset_dimensions()  # some writers state fewer cells than the sheet has
        yield sheet.title, sheet.iter_rows(values_only=True)
    book.close()


def _cells_of_xls(library: Any, content: bytes) -> Iterator[tuple[str, Iterable[Sequence[object]]]]:
    """Title and rows of values of each sheet of a .xls file."""
    book = library.open_workbook(file_contents=content, logfile=io.StringIO())

    def value(cell: Any) -> Any:
        if cell.ctype == library.XL_CELL_DATE:
            return library.xldate_as_datetime(cell.value, book.datemode)
        if cell.ctype == library.XL_CELL_ERROR:
            return library.error_text_from_code.get(cell.value, "#N/A")
        # Every number is a float: run 1 is 1.0.
        number = isinstance(cell.value, float)
        return int(cell.value) if number and cell.value.is_integer() else cell.value

    for sheet in book.sheets():
        yield sheet.name, ([value(cell) for cell in row] for row in sheet.get_rows())


_AS_CSV = "export the sheet as CSV, or save it as Parquet"
_UNPACKED, _CELLS = 128 * MIB, 4_000_000
"""Largest size of a workbook when unpacked, and most cells of a sheet, empty ones included.
400,000 numbers have 14 MiB, and take openpyxl 4 s of processor time."""


def _rows(cells: Iterable[Sequence[object]], file: str) -> list[tuple[int, list[str]]]:
    """Rows with content as (number in the sheet, texts), all of one length.

    Raises:
        DataError: more than :data:`_CELLS` cells.
    """
    rows, count = [], 0
    for number, row in enumerate(cells, 1):
        count += len(row)
        if count > _CELLS:
            reason = f"a sheet has more than {_CELLS:,} cells"
            raise DataError(reason, _AS_CSV, file)
        texts = [
            repr(cell.total_seconds())
            if isinstance(cell, datetime.timedelta)
            else repr(cell)
            if isinstance(cell, float)
            else str("" if cell is None else cell).strip()
            for cell in row
        ]
        if any(texts):
            rows.append((number, texts))
    width = max((len(texts) for _, texts in rows), default=0)
    return [(number, texts + [""] * (width - len(texts))) for number, texts in rows]
