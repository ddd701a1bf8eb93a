"""Results of many files as one Parquet table, with a row for each number and file.

Columns: ``number`` (of the file in the order given, from 1), ``file``, ``result`` (its
path), ``model``, ``status`` (the verdict; ``failed`` without a result),
``kind`` (parameter, derived, statistic; of a diagnosis base, effect, gap), ``name``,
``value``, ``std``, ``low`` and ``high`` (95 % interval of a fit), ``unit``,
``identified``, ``problem`` (reason of a failure), ``convention``, ``seed``, ``version``,
``sha256`` (of the data). A file without a result has one row without a name.
"""

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from tirefit.data.readers.extras import extra
from tirefit.files import replacing

if TYPE_CHECKING:
    import pandas


FAILED = "failed"

_GROUP = 100_000  # rows that are written at a time


class Row(NamedTuple):
    """One number of one file; values that do not exist are None."""

    kind: str
    name: str
    value: float | None
    std: float | None = None
    low: float | None = None
    high: float | None = None
    unit: str = ""
    identified: bool = True


def frame(rows: Sequence[Row]) -> "pandas.DataFrame":
    """The numbers as a pandas data frame, a row for each.

    Raises:
        DataError: pandas is missing.
    """
    return extra("pandas", "a data frame", "", doing="making").DataFrame(rows, columns=Row._fields)


@dataclass(frozen=True)
class FileRecord:
    """The results of one file; ``outcomes`` are those of a fit, in lower case."""

    file: str
    result: str
    model: str
    status: str
    rows: tuple[Row, ...] = ()
    outcomes: tuple[str, ...] = ()
    problem: str = ""
    convention: str = ""
    seed: int | None = None
    version: str = ""
    sha256: str = ""


_TEXTS = ("file", "result", "model", "status", "kind", "name", "unit", "problem",
          "convention", "version", "sha256")  # fmt: skip
_NUMBERS = ("value", "std", "low", "high")
_NOTHING = Row("", "", None, identified=False)


class _Writer:
    """Rows that are collected and written in groups."""

    def __init__(self, path: Path, name: str):
        pyarrow = extra("pyarrow", "the table of results", name, "cluster", "writing")
        parquet = extra("pyarrow.parquet", "", name)
        fields = {"number": pyarrow.int64()}
        fields |= dict.fromkeys(_TEXTS, pyarrow.string())
        fields |= dict.fromkeys(_NUMBERS, pyarrow.float64())
        fields |= {"identified": pyarrow.bool_(), "seed": pyarrow.int64()}
        self.table, self.schema = pyarrow.Table.from_pylist, pyarrow.schema(fields.items())
        self.file = parquet.ParquetWriter(path, self.schema, compression="zstd")
        self.rows: list[dict[str, Any]] = []
        self.number = 0

    def add(self, record: FileRecord) -> None:
        """Add the rows of the next file."""
        self.number += 1
        whole = {name: getattr(record, name, None) for name in (*_TEXTS, "seed")}
        whole["number"] = self.number
        self.rows += [whole | row._asdict() for row in record.rows or (_NOTHING,)]
        if len(self.rows) >= _GROUP:
            self.flush()

    def flush(self) -> None:
        self.file.write_table(self.table(self.rows, schema=self.schema))
        self.rows.clear()


@contextmanager
def records_into(path: Path) -> Iterator[Any]:
    """Context manager: an object whose ``add`` takes one :class:`FileRecord` at a time.

    The table is written to ``path`` at the end of the block, unless the block fails.

    Raises:
        DataError: pyarrow is missing.
    """
    with replacing(path) as temporary:
        writer = _Writer(temporary, str(path))
        try:
            yield writer
            writer.flush()
        finally:
            writer.file.close()


_DATE = re.compile(
    r"(?<!\d)((?:19|20)\d\d)([-_.]?)(0[1-9]|1[0-2])\2(0[1-9]|[12]\d|3[01])"
    r"(?:[T _-]?([01]\d|2[0-3])[-_:.h]?([0-5]\d)(?:[-_:.m]?([0-5]\d))?)?(?!\d)"
)


def dates_of(files: Sequence[str]) -> np.ndarray | None:
    """Dates (n,) datetime64[s] in file names; None unless all have one and differ."""
    dates = []
    for file in files:
        date = _DATE.search(file.replace("\\", "/").rsplit("/", 1)[-1])
        if date is None:
            return None
        year, _, month, day, *clock = date.groups()
        hour, minute, second = (part or "00" for part in clock)
        dates.append(f"{year}-{month}-{day}T{hour}:{minute}:{second}")
    with suppress(ValueError):  # the 31st of February
        return np.array(dates, "datetime64[s]") if len(set(dates)) > 1 else None
    return None
