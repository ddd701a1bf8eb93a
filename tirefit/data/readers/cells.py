"""One column of a text: its cells, and their numbers."""

import csv
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
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


class Column(Sequence[str]):
    """The cells of one column as in the file, and their numbers ``values`` (n,), NaN for text.

    A million rows need gigabytes as strings, and a tenth of that as numbers with the lines of
    the file, of which ``row`` splits the one whose text is asked for.
    """

    def __init__(self, values: np.ndarray, place: int, row: Callable[[int], list[str]]):
        self.values, self._place, self._row = values, place, row

    def __len__(self) -> int:
        return len(self.values)

    def __getitem__(self, row: Any) -> Any:
        return self._row(row)[self._place]

    def __iter__(self) -> Iterator[str]:
        return (self[row] for row in range(len(self)))


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
