"""One column of a text: its cells, and their numbers.

A million rows need gigabytes as strings, and a tenth of that as numbers with the lines of the
file. NumPy's reader gives the numbers; a cell of these lines is split off on demand.
"""

import bisect
import csv
import io
import itertools
import re
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from tirefit.data.columns import is_number

_GROUPED = re.compile(r"\s*[+-]?[1-9]\d{0,2}(,\d{3})+\s*")


SPACES = " "  # delimiter: any white space


def split(lines: Iterable[str], delimiter: str) -> Any:
    """A reader of the ``csv`` module: the cells of each line, and ``line_num``."""
    if delimiter == SPACES:
        lines = (line.replace("\t", " ").strip() for line in lines)
    return csv.reader(lines, delimiter=delimiter, skipinitialspace=True)


class Lines(Sequence[Sequence[str]]):
    """Rows of cells of lines without quotation marks, split on demand."""

    def __init__(self, lines: Sequence[str], delimiter: str):
        self._delimiter, self._lines = delimiter, [line for line in lines if line != "\n"]

    def __len__(self) -> int:
        return len(self._lines)

    def __getitem__(self, row: Any) -> Any:
        return next(split([self._lines[row]], self._delimiter))

    def __iter__(self) -> Iterator[list[str]]:
        return split(self._lines, self._delimiter)

    def numbers(self) -> tuple[list[np.ndarray | None], str] | None:
        """The numbers (n,) of each column, None for one of text, and their decimal mark: empty
        if there is none. None if NumPy finds another cell or another number of cells."""
        text = "".join(self._lines)
        point = "." in text
        commas = not point and self._delimiter != "," and "," in text
        text = text.replace(",", ".") if commas else text
        first: list[str] = next(split(self._lines[:1], self._delimiter), [])
        first = [cell.replace(",", ".") for cell in first] if commas else first
        kinds = ["f8" if is_number(cell) else "S1" for cell in first]
        kind = np.dtype([(f"f{k}", kind) for k, kind in enumerate(kinds)])
        apart = None if self._delimiter == SPACES else self._delimiter
        try:
            grid = np.loadtxt(io.StringIO(text), kind, comments=None, delimiter=apart, ndmin=1)
        except ValueError:
            return None
        if len(grid) != len(self._lines):
            return None
        names = kind.names or ()
        mark = "," if commas else "." if point else ""
        return [np.array(grid[n]) if kind[n].kind == "f" else None for n in names], mark


class _Block(Sequence[str]):
    """The cells of a column in some lines, and their numbers if it has only numbers."""

    def __init__(self, rows: Lines, place: int, values: np.ndarray | None, mark: str):
        self._rows, self._place = rows, place
        self.values, self.mark = values, mark

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, row: Any) -> Any:
        return self._rows[row][self._place]

    def __iter__(self) -> Iterator[str]:
        return (row[self._place] for row in self._rows)


class Column(Sequence[str]):
    """The cells of one column as in the file, in blocks of rows."""

    def __init__(self) -> None:
        self._blocks: list[Sequence[str]] = []
        self._ends = [0]

    def add(self, cells: Sequence[str]) -> None:
        """Append the cells of a block of rows."""
        self._blocks.append(cells)
        self._ends.append(len(self) + len(cells))

    def add_lines(self, rows: Lines, place: int, values: np.ndarray | None, mark: str) -> None:
        """Append the cells at this place of the rows, and their numbers (n,) if known."""
        self.add(_Block(rows, place, values, mark))

    def __len__(self) -> int:
        return self._ends[-1]

    def __getitem__(self, row: Any) -> Any:
        block = bisect.bisect_right(self._ends, row) - 1
        return self._blocks[block][int(row) - self._ends[block]]

    def __iter__(self) -> Iterator[str]:
        return itertools.chain.from_iterable(self._blocks)

    def numbers(self, commas: bool) -> np.ndarray:
        """float64 (n,), NaN where the cell is not a number."""
        each = [np.empty(0)]
        for block in self._blocks:
            values = block.values if isinstance(block, _Block) else None
            if values is None or (not commas and getattr(block, "mark", "") == ","):
                values = parsed(block, commas)
            each.append(values)
        return np.concatenate(each)

    def may_hold(self, mark: str) -> bool:
        """Whether some cell holds a decimal mark; in a block of numbers, of any column."""
        return any(
            mark == block.mark
            if isinstance(block, _Block) and block.values is not None
            else mark in "".join(block)
            for block in self._blocks
        )

    def words(self) -> list[str]:
        """The cells; in a block of numbers, as at the first of each stretch of equal ones."""
        words: list[str] = []
        for block in self._blocks:
            values = block.values if isinstance(block, _Block) else None
            if values is None:
                words += block
                continue
            first = np.flatnonzero(np.diff(values, prepend=np.nan) != 0)
            few = 10 * len(first) < len(values) and bool(np.isfinite(values).all())
            texts = [block[int(k)] for k in first] if few else block
            counts = np.diff(first, append=len(values)) if few else 1
            words += np.repeat(np.array(texts, object), counts).tolist()
        return words


def parsed(cells: Iterable[str], commas: bool = False) -> np.ndarray:
    """Numbers (n,) of text cells, NaN for other text; a decimal comma if ``commas``."""
    texts = [cell.replace(",", ".") for cell in cells] if commas else list(cells)
    try:
        # float() accepts 1_000, which no measuring system writes
        if "_" in "".join(texts):
            raise ValueError
        return np.fromiter(map(float, texts), float, len(texts))
    except ValueError:
        texts = [text.replace("\N{MINUS SIGN}", "-") for text in texts]
        return np.array([float(t) if is_number(t) else np.nan for t in texts], float)


def all_grouped(cells: Iterable[str]) -> bool:
    """Whether all cells with commas have them as in 4,000."""
    return all(_GROUPED.fullmatch(cell) for cell in cells if "," in cell)


def words_of(cells) -> list[str]:
    """The cells of a column as text, without blanks around them; 1.0 of a column of
    numbers is 1."""
    if isinstance(cells, np.ndarray) and cells.dtype.kind == "f":
        return [f"{cell:.15g}" for cell in cells]
    words = cells.words() if isinstance(cells, Column) else cells
    return [str(word).strip() for word in words]


def may_hold(cells: Sequence[str], mark: str) -> bool:
    """Whether some cell holds a decimal mark."""
    return cells.may_hold(mark) if isinstance(cells, Column) else mark in "".join(cells)
