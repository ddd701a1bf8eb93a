"""Rows that lack a value: they are excluded and counted, up to a tenth of the rows."""

import shlex
from collections.abc import Sequence

import numpy as np

from tirefit.data.check import SHOWN, BadRows
from tirefit.data.units import base_column
from tirefit.results import InputProblem
from tirefit.slip import SLIP_DEFINITIONS

MOST = 0.1
"""Largest share of rows that are excluded without an option: without a tenth of the rows a standard
error is 5 % larger (1 / sqrt(0.9))."""

_INPUTS = {"run", "time", "alpha", "fz", "v", "gamma", "omega", *SLIP_DEFINITIONS}
_NEEDED = _INPUTS | {"fx", "fy", "mz"}


def may_miss(name: str, forces: bool) -> bool:
    """Whether rows without a value in this canonical column are used.

    Rows without pressure are at nominal pressure; a prediction needs only what a model
    reads.

    Args:
        forces: False if forces will be predicted.
    """
    return name == "pressure" or (not forces and base_column(name) not in _INPUTS)


def is_spare(name: str, missing: int, rows: int) -> bool:
    """Whether a canonical column is left out because too many of its cells are empty.

    Columns of slip, load and forces are left out only if all their cells are: what then
    lacks for a fit is an error of the columns.

    Args:
        missing: number of cells without a value.
        rows: number of all cells.
    """
    if name == "pressure":  # rows without it are at nominal pressure
        return False
    return missing == rows if base_column(name) in _NEEDED else missing > MOST * rows


def unread(name: str, header: str, missing: int, rows: int) -> str:
    """A sentence on a column that :func:`is_spare` leaves out."""
    text = f"column {header!r} is not read: {missing} of its {rows} cells have no value"
    column = shlex.quote(f"{name}={header}")
    return text + (f"; --column {column} reads it" if missing < rows else "")


def of_read(notes: Sequence[str], unread: Sequence[str]) -> list[str]:
    """The notes on columns without those on columns that were left out."""
    out = tuple(f"{text.partition(' is not read')[0]} read as " for text in unread)
    return [note for note in notes if not note.startswith(out)]


def excluded(
    faults: Sequence[BadRows], lines: np.ndarray, file: str, limited: bool
) -> tuple[str | None, list[InputProblem]]:
    """A warning that names the rows without a value; problems instead if they are too many.

    Args:
        faults: missing values only.
        lines: (n,) line of the file of each row.
        limited: whether more than :data:`MOST` of the rows are an error.
    """
    rows = np.unique(np.array([row for fault in faults for row in fault.rows], int))
    if not len(rows):
        return None, []
    places: dict[str | None, set[int]] = {}
    for fault in faults:
        places.setdefault(fault.column, set()).update(map(int, fault.rows))
    where = {}
    for column, each in places.items():  # the first rows by their lines, and the number of others
        first = ", ".join(str(lines[row]) for row in sorted(each)[:SHOWN])
        more = f" and {len(each) - SHOWN} more" if len(each) > SHOWN else ""
        where[column] = f"row{'s' if len(each) > 1 else ''} {first}{more}"
    if limited and len(rows) > MOST * len(lines):
        remedy = f"fill the cells, or exclude the rows with --mask-bad-rows: up to {MOST:.0%} of"
        remedy += " the rows are excluded without it"
        problems = []
        for column, each in places.items():
            reason = f"{len(each)} of {len(lines)} rows ({len(each) / len(lines):.1%}) lack a value"
            reason += f" ({where[column]})"
            problems.append(InputProblem(reason, remedy, file, column=column))
        return None, problems
    named = "; ".join(f"{column!r} in {where[column]}" for column in places)
    return f"excluded {len(rows)} of {len(lines)} rows, which lack a value: {named}", []
