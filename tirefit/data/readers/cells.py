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
from typing import Any, NamedTuple

import numpy as np

from tirefit.data.columns import is_number

_GROUPED = re.compile(r"\s*[+-]?[1-9]\d{0,2}(,\d{3})+\s*")


SPACES = " "  # delimiter: any white space


def split(lines: Iterable[str], delimiter: str) -> Any:
    """A reader of the ``csv`` module: the cells of each line, and ``line_num``."""
    if delimiter == SPACES:
        lines = (line.replace("\t", " ").strip() for line in lines)
    return csv.reader(lines, delimiter=delimiter, skipinitialspace=True)


class Lines(Sequence[list[str]]):
    """Rows of cells of lines without quotation marks, split on demand."""

    def __init__(self, lines: Sequence[str], delimiter: str):
        self._delimiter, self._lines = delimiter, [line for line in lines if line != "\n"]

    def __len__(self) -> int:
        return len(self._lines)

    def __getitem__(self, row: Any) -> Any:
        return next(split([self._lines[row]], self._delimiter))

    def __iter__(self) -> Iterator[list[str]]:
        return split(self._lines, self._delimiter)

    def numbers(self, commas: bool) -> list[np.ndarray | None] | None:
        """The numbers (n,) of each column, None for one of text. None if NumPy finds another
        cell or another number of cells.

        Args:
            commas: whether a comma is the decimal mark.
        """
        text = "".join(self._lines)
        text = text.replace(",", ".") if commas else text
        first: list[str] = next(split(text.splitlines()[:1], self._delimiter), [])
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
        return [np.array(grid[n]) if kind[n].kind == "f" else None for n in names]


class Block(NamedTuple):
    """Some rows of a text."""

    lines: np.ndarray  # (n,) line in the file of each row
    rows: Sequence[list[str]]  # the cells of each row
    values: Sequence[np.ndarray | None]  # numbers (n,) of each column or None; () if not known


class Column(Sequence[str]):
    """The cells of one column as in the file, in blocks of rows."""

    def __init__(self, blocks: Sequence[Block], place: int):
        self._blocks, self._place = blocks, place
        self._ends = [0, *itertools.accumulate(len(block.rows) for block in blocks)]

    def __len__(self) -> int:
        return self._ends[-1]

    def __getitem__(self, row: Any) -> Any:
        block = bisect.bisect_right(self._ends, row) - 1
        return self._blocks[block].rows[int(row) - self._ends[block]][self._place]

    def __iter__(self) -> Iterator[str]:
        return (row[self._place] for block in self._blocks for row in block.rows)

    def numbers(self, commas: bool) -> np.ndarray:
        """float64 (n,), NaN where the cell is not a number."""
        each = [np.empty(0)]
        for block in self._blocks:
            values = block.values[self._place] if block.values else None
            if values is None:
                values = parsed([row[self._place] for row in block.rows], commas)
            each.append(values)
        return np.concatenate(each)


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


def has_decimal_comma(cells: Iterable[str]) -> bool:
    """Whether numbers have commas, not all as in 4,000, and none has a point."""
    marked = [
        cell for cell in cells if ("," in cell or "." in cell) and is_number(cell.replace(",", "."))
    ]
    if any("." in cell and is_number(cell) for cell in marked):
        return False
    return not all(_GROUPED.fullmatch(cell) for cell in marked if "," in cell)


def words_of(cells: Iterable[object]) -> list[str]:
    """The cells of a column as text, without blanks around them; 1.0 of a column of
    numbers is 1."""
    if isinstance(cells, np.ndarray) and cells.dtype.kind == "f":
        return [f"{cell:.15g}" for cell in cells]
    return [str(word).strip() for word in cells]
