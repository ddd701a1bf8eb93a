"""One column of a large text: its numbers, and the text of a cell on demand."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np


class TextColumn(Sequence[str]):
    """The cells of one column as in the file, and their numbers; ``body`` holds the rows
    of all columns (``tirefit.data.bulk``)."""

    def __init__(self, body: Any, index: int):
        self._body, self._index = body, index

    def __len__(self) -> int:
        return len(self._body)

    def __getitem__(self, row):
        if isinstance(row, slice):
            return [self[i] for i in range(*row.indices(len(self)))]
        return self._body.row(int(row))[self._index]

    def __iter__(self) -> Iterator[str]:
        return (row[self._index] for row in self._body.rows())

    def numbers(self, commas: bool) -> np.ndarray | None:
        """float64 (n,), NaN where the cell is not a number; None if the numbers were read
        with another decimal mark."""
        if commas != self._body.commas and self.may_hold(","):
            return None
        return self._body.numbers(self._index)

    def may_hold(self, mark: str) -> bool:
        """False if no cell of the file holds this character."""
        return self._body.may_hold(mark)

    def words(self) -> list[str]:
        """The cells, as at the first of each stretch of rows with the same number."""
        values = self._body.numbers(self._index)
        first = np.flatnonzero(np.diff(values, prepend=np.nan) != 0)
        if not np.all(np.isfinite(values)) or 10 * len(first) > len(self):
            return list(self)
        texts = np.array([self[row] for row in first], object)
        return np.repeat(texts, np.diff(first, append=len(self))).tolist()


def words_of(cells: Any) -> list[str]:
    """The cells of a column as text, without blanks around them; 1.0 of a column of
    numbers is 1."""
    if isinstance(cells, np.ndarray) and cells.dtype.kind == "f":
        return [f"{cell:.15g}" for cell in cells]
    words = cells.words() if isinstance(cells, TextColumn) else cells
    return [str(word).strip() for word in words]


def may_hold(cells: Sequence[str], mark: str) -> bool:
    """Whether some cell holds a character; of a large text, of any column."""
    if isinstance(cells, TextColumn):
        return cells.may_hold(mark)
    return mark in "".join(cells)
