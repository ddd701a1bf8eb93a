"""Read large text files: numbers by NumPy's reader, the text of a cell only on demand.

A million rows need gigabytes as strings, and a tenth of that as numbers with the bytes
of the file. The head is read as in other text files and gives the columns; the rest is
read in pieces. A piece with other cells where the head has numbers is split as other
text, and its text is kept as the bytes of the file, so that messages can quote a cell.
"""

import csv
import io
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tirefit.data.cells import TextColumn
from tirefit.data.check import BadRows, parsed
from tirefit.data.columns import is_number
from tirefit.data.remote import Place
from tirefit.data.text import (
    SPACED,
    Table,
    content_lines,
    decoded,
    even_out,
    split_rows,
    table_of_text,
)
from tirefit.data.tydex import is_tydex
from tirefit.data.white import tabbed
from tirefit.results import DataError

LARGE = 2**21
"""Bytes from which a file is read in this way; smaller files are fast in any way."""

_HEAD = 2**17
_PIECE = 2**21

_LONGEST = 2**16  # bytes of a line; a longer one is of another kind of file

_PLAIN = bytes([*range(0x20, 0x7F), *b"\n\r\t"])
"""Bytes allowed below the head: those that need no encoding."""


class _Piece(NamedTuple):
    """Rows of a part of the file."""

    lines: np.ndarray
    starts: np.ndarray  # bytes at which they start
    ragged: np.ndarray  # (n,)
    numbers: np.ndarray  # (columns, n)
    faults: tuple[BadRows, ...] = ()


class _Layout(NamedTuple):
    """The rules by which lines below the head are split."""

    path: Place
    width: int
    delimiter: str
    spaced: bool
    kind: np.dtype  # type of a row, ``S1`` for a column of text
    commas: bool  # whether a comma is the decimal point


class _Rows:
    """Rows of the head, then of the pieces; ``commas``: decimal ones."""

    def __init__(self, content: bytes, head: Table, layout: _Layout):
        self._content, self._layout = content, layout
        self._head = list(zip(*head.cells, strict=True))
        self.commas = layout.commas
        numbers = [parsed(column, layout.commas) for column in head.cells]
        none = np.full(len(head.lines), -1)
        self._pieces = [_Piece(head.lines, none, head.ragged, np.array(numbers))]

    def add(self, piece: _Piece) -> None:
        self._pieces.append(piece)

    def joined(self) -> _Piece:
        """All rows, which are complete now."""
        lines, starts, ragged, numbers, _ = zip(*self._pieces, strict=True)
        self._all = _Piece(
            np.concatenate(lines),
            np.concatenate(starts),
            np.concatenate(ragged),
            np.concatenate(numbers, axis=1),
        )
        self._pieces = []
        return self._all

    def __len__(self) -> int:
        return len(self._all.lines)

    def numbers(self, column: int) -> np.ndarray:
        """The numbers of a column (n,), NaN for a cell that is none."""
        return self._all.numbers[column]

    def may_hold(self, mark: str) -> bool:
        return mark.encode() in self._content

    def row(self, index: int) -> Sequence[str]:
        if index < len(self._head):
            return self._head[index]
        return next(self._split(slice(index, index + 1)))

    def rows(self) -> Iterator[Sequence[str]]:
        yield from self._head
        yield from self._split(slice(len(self._head), None))

    def _split(self, which: slice) -> Iterator[list[str]]:
        content, layout = self._content, self._layout
        starts, ragged = self._all.starts[which], self._all.ragged[which]

        def lines() -> Iterator[str]:
            for start in starts.tolist():
                stop = content.find(b"\n", start) + 1 or len(content)
                line = content[start:stop].decode("ascii")
                yield tabbed(["", line], [])[1] if layout.spaced else line

        cells = csv.reader(lines(), delimiter=layout.delimiter, skipinitialspace=True)
        for row, is_ragged in zip(cells, ragged, strict=True):
            yield ["nan"] * layout.width if is_ragged else row


def table_of_large(
    content: bytes, path: Place, digest: str, declared: Collection[str]
) -> Table | None:
    """As ``table_of_text`` for a large text; None if it must be read as other texts.

    That is a text whose body is not plain ASCII, with quoted cells over several lines,
    or with an error in its head.
    """
    first = content.rfind(b"\n", 0, _HEAD) + 1
    if len(content) < LARGE or not first or not _is_plain(content, first):
        return None
    try:
        text, notes = decoded(content[:first], path)
        if is_tydex(text):
            return None
        head = table_of_text(text, path, digest, declared, notes)
    except DataError:
        return None
    layout = _layout(content, head, first, path)
    rows, faults = _Rows(content, head, layout), [*head.faults]
    number, count = len(list(io.StringIO(text, newline=""))) + 1, len(head.lines)
    for start, stop in _pieces(content, first):
        piece = _read(content[start:stop], start, number, layout)
        if piece is None:
            return None
        rows.add(piece)
        faults += [
            fault._replace(rows=[count + row for row in fault.rows]) for fault in piece.faults
        ]
        number += content.count(b"\n", start, stop)
        count += len(piece.lines)
    whole = rows.joined()
    columns = [TextColumn(rows, i) for i in range(len(head.headers))]
    return replace(
        head, cells=columns, lines=whole.lines, ragged=whole.ragged, faults=_merged(faults)
    )


def _is_plain(content: bytes, first: int) -> bool:
    """Whether all below the head is ASCII text in lines that end with a line feed."""
    for start in range(first, len(content), _PIECE):
        piece = content[start : start + _PIECE]
        if piece.translate(None, _PLAIN):
            return False
        if b"\r" in piece and piece.count(b"\r") != content.count(
            b"\r\n", start, start + _PIECE + 1
        ):
            return False
    return True


def _pieces(content: bytes, first: int) -> Iterator[tuple[int, int]]:
    """Ends of pieces of whole lines."""
    while first < len(content):
        stop = content.rfind(b"\n", first, first + _PIECE) + 1
        if not stop:
            stop = content.find(b"\n", first) + 1 or len(content)
        yield first, stop
        first = stop


def _layout(content: bytes, head: Table, first: int, path: Place) -> _Layout:
    apart = head.delimiter not in ("", ",")
    commas = apart and b"," in content and content.find(b".", first) < 0
    mark = "," if commas else "."
    is_text = [
        not any(is_number(cell.replace(mark, ".")) for cell in column) for column in head.cells
    ]
    kind = np.dtype([(f"f{i}", "S1" if text else "f8") for i, text in enumerate(is_text)])
    spaced = SPACED in head.notes
    return _Layout(path, len(is_text), head.delimiter, spaced, kind, commas)


def _read(piece: bytes, start: int, number: int, layout: _Layout) -> _Piece | None:
    """The rows of a piece that starts at this byte and line number; None if a quoted cell
    runs over several lines."""
    ends = np.flatnonzero(np.frombuffer(piece, np.uint8) == ord("\n")) + 1
    starts = start + np.concatenate([[0], ends[ends < len(piece)]])
    if np.max(np.diff(starts), initial=len(piece) - starts[-1] + start) > _LONGEST:
        return None
    numbers = _by_numpy(piece, layout)
    if numbers is not None and numbers.shape[1] == len(starts):
        lines = number + np.arange(len(starts))
        return _Piece(lines, starts, np.zeros(len(starts), bool), numbers)
    return _by_csv(piece, starts, number, layout)


def _by_numpy(piece: bytes, layout: _Layout) -> np.ndarray | None:
    """Numbers (columns, n), NaN in columns of text; None if another cell is not a number."""
    if b'"' in piece or b"#" in piece or not piece.strip():
        return None
    source = io.BytesIO(piece.replace(b",", b".") if layout.commas else piece)
    delimiter = None if layout.spaced else layout.delimiter
    try:
        grid = np.loadtxt(source, layout.kind, comments=None, delimiter=delimiter, ndmin=1)
    except ValueError:
        return None
    numbers = np.full((layout.width, len(grid)), np.nan)
    for column, name in enumerate(layout.kind.names or ()):
        if layout.kind[name].kind == "f":
            numbers[column] = grid[name]
    return numbers


def _by_csv(piece: bytes, starts, number: int, layout: _Layout) -> _Piece | None:
    """The rows of a piece with blank lines, comments, and cells of any kind."""
    lines = content_lines(list(io.StringIO(piece.decode("ascii"), newline="")))
    there = [index for index, line in enumerate(lines) if line != "\n"]
    if layout.spaced:
        lines = tabbed(["", *lines], [])[1:]
    try:
        rows, numbers = split_rows(lines, layout.delimiter, number - 1, layout.path)
    except DataError:
        return None
    if numbers != [number + index for index in there]:
        return None
    ragged, faults = even_out(rows, layout.width, numbers)
    columns = [parsed(column, layout.commas) for column in zip(*rows, strict=True)]
    values = np.array(columns) if rows else np.empty((layout.width, 0))
    return _Piece(np.array(numbers, int), starts[there], ragged, values, faults)


def _merged(faults: list[BadRows]) -> tuple[BadRows, ...]:
    """One fault for all rows with a wrong number of fields."""
    if not faults:
        return ()
    rows = [row for fault in faults for row in fault.rows]
    values = [value for fault in faults for value in fault.values]
    return (faults[0]._replace(rows=rows, values=values),)
