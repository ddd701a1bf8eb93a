"""Checks of data, row by row and as a whole.

A rule on rows yields :class:`BadRows`, which become errors or masked rows. Checks of
the whole (constant slip, missing columns) yield problems that remain even if bad rows
are masked. A doubt is a warning: the data can be used, but may have another meaning.
"""

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tirefit.data.columns import is_number
from tirefit.data.readers.cells import Column, parsed
from tirefit.data.vehicle.vehicle_log import vehicle_log
from tirefit.results import InputProblem
from tirefit.slip import LOCKED, SLIP_DEFINITIONS

SHOWN = 5  # rows of one fault that are listed; the others are counted

_LARGEST = 1e100  # no measurement; its square still fits in a float
OR_MASK = ", or mask bad rows with --mask-bad-rows"
_CORRECT = f"correct the row{OR_MASK}"
_CLOCK = re.compile(r"\d{1,2}:\d{2}|\d{1,4}([-./])\d{1,2}\1\d{1,4}(\D|$)")
_IS_TEXT = "is text where a number is needed"
_IS_CLOCK = "is a date or a time of day where a number is needed"
_NO_NUMBERS = (
    "name the column that has the numbers with --column NAME=HEADER, or rename this one"
    " if it is something else, so that it is not read"
)
_SECONDS = (
    "write the seconds since the start of the recording; in Python, read_frame takes a"
    " column of dates and times (pandas.to_datetime) as such seconds"
)
_OF_WHOLE_COLUMN = {_IS_TEXT: _NO_NUMBERS, _IS_CLOCK: _SECONDS}
"""Faults that are faults of the column if all rows have them: correcting or masking rows
is no remedy then."""
_EMPTY, _NOT_A_NUMBER = "where a number is needed", "is not a number"
INFINITE = "is infinite"
NO_VALUE, NO_RUN = "the value is not available", "is not a run's name"
_MISSING = (_EMPTY, _NOT_A_NUMBER, NO_VALUE, NO_RUN)
"""Rules that cells without a value break: their rows are excluded, not refused."""


class BadRows(NamedTuple):
    """Rows that break one rule in one column."""

    column: str | None
    rows: Sequence[int] | np.ndarray
    values: Sequence[str]  # text of each row; the reason is this text and the rule
    rule: str
    remedy: str = _CORRECT
    is_systematic: bool = False  # most rows break it: the column is wrong, not its rows

    @property
    def is_missing(self) -> bool:
        """Whether the cells hold no value, instead of a wrong one."""
        return self.rule in _MISSING


class Rule(NamedTuple):
    """A range rule: which values of a canonical column are bad, and why."""

    column: str
    is_bad: Callable[[np.ndarray], np.ndarray]
    rule: str
    remedy: str = ""  # if the column is right; else the row is to be corrected


_RULES = (
    Rule(
        "sigma_x",
        lambda sigma: (sigma < -1.05) | ((sigma > 5) & (sigma < LOCKED)),
        "is out of the physical range: -1 <= sigma_x <= 5",
        "if the column is in percent: --unit sigma_x=%; if it is v_sx/v_x: --slip kappa; if driving"
        " slip is positive: --convention iso-w, sae or adapted-sae; ",
    ),
    *(
        Rule(
            name,
            lambda slip: abs(slip) > 1 + 1e-6,
            f"is out of the physical range: |{name}| <= 1",
            f"if the column is in percent: --unit {name}=%; if it is defined otherwise:"
            " --slip sigma_x or --slip slip_ratio; ",
        )
        for name in SLIP_DEFINITIONS
        if name != "sigma_x"
    ),
    *(
        Rule(
            name,
            lambda angle: abs(angle) > np.pi / 2,
            f"is out of range: |{name}| <= pi/2 rad",
            f"if the column is in degrees: --unit {name}=deg; ",
        )
        for name in ("alpha", "gamma")
    ),
    # Below 1e-6 N no tire is loaded and no quotient is a number.
    Rule(
        "fz",
        lambda load: load < 1e-6,
        "is not a load: fz > 0 is needed",
        "if loads are negative in the file (z down): --convention sae; if they are positive:"
        " --convention braking or iso-w or adapted-sae; ",
    ),
    Rule("v", lambda speed: speed < 0, "is a negative speed"),
    Rule("pressure", lambda p: p <= 0, "is not a pressure: > 0 is needed"),
)


def drop_absent_noise(columns: dict[str, np.ndarray], headers: dict[str, str]) -> list[str]:
    """Remove the noise of a slip that is zero in all rows, and return a sentence on each."""
    slips = ("alpha", *SLIP_DEFINITIONS)
    stds = [
        name for name in columns if name.endswith("_std") and name.removesuffix("_std") in slips
    ]
    zero = [name for name in stds if not columns[name].any()]
    for name in zero:
        del columns[name]
    return [
        f"column {headers.pop(name, name)!r} is zero in all rows: no slip noise" for name in zero
    ]


def range_faults(
    columns: Mapping[str, np.ndarray], shown: Mapping[str, np.ndarray], headers: Mapping[str, str]
) -> list[BadRows]:
    """Rows outside the physical range, by column.

    Args:
        columns: (n,) arrays in canonical units and signs; the slip under the name of
            its definition. NaN is never out of range.
        shown: the same columns in the units and signs of the file, for messages.
        headers: the header of each column in the file.
    """
    faults = []
    stds = (
        Rule(name, lambda std: std <= 0, "is not a standard deviation: > 0 is needed")
        for name in columns
        if name.endswith("_std")
    )
    for rule in (*_RULES, *stds):
        values = columns.get(rule.column, np.empty(0))
        rows = np.flatnonzero(rule.is_bad(values))
        if not len(rows):
            continue
        raw = [f"{value:.6g}" for value in shown[rule.column][rows]]
        header = headers.get(rule.column, f"--constant {rule.column}")
        # Where most loads are right, the signs are, too, and a few rows are wrong.
        is_sound = rule.column == "fz" and 2 * len(rows) < len(values)
        remedy = ("" if is_sound else rule.remedy) + _CORRECT
        faults.append(BadRows(header, rows, raw, rule.rule, remedy, is_systematic=True))
    return faults


def list_problems(
    faults: Sequence[BadRows], lines: np.ndarray, file: str
) -> tuple[list[InputProblem], list[InputProblem]]:
    """Problems of bad rows: the first few of a kind one by one, the others counted.

    Args:
        faults: the bad rows.
        lines: (n,) line of the file of each row.
        file: named in the problems.

    Returns:
        Problems of single rows, and of whole columns, which masking does not solve.
    """
    of_rows, of_columns = [], []
    for column, rows, values, rule, remedy, is_systematic in faults:
        if is_systematic and len(rows) > max(1, len(lines) / 2):
            remedy = remedy.removesuffix(_CORRECT).removesuffix("; ")
            remedy = remedy or "check the column's unit, sign and meaning"
            first = f"{values[0]} in row {lines[rows[0]]}"
            reason = f"{len(rows)} of {len(lines)} rows ({first}, ...): {rule}"
            of_columns.append(InputProblem(reason, remedy, file, column=column))
            continue
        for row, value in list(zip(rows, values, strict=True))[:SHOWN]:
            reason = f"{value} {rule}"
            of_rows.append(InputProblem(reason, remedy, file, int(lines[row]), column))
        if (more := len(rows) - SHOWN) > 0:
            # A rule is half a sentence; its subject is the text of a row.
            reason = f"and {more} more row{'s' * (more > 1)} with the same fault, next in"
            reason += f" row {lines[rows[SHOWN]]}: {values[SHOWN]} {rule}"
            of_rows.append(InputProblem(reason, remedy, file, column=column))
    return of_rows, of_columns


def check_columns(
    columns: Collection[str],
    headers: Sequence[str],
    idle: Sequence[str],
    file: str,
    forces: bool = True,
    units: Sequence[str] | None = None,
) -> list[InputProblem]:
    """Problems of columns that every fit needs: a slip, a force if ``forces``, the load.

    ``columns`` are those read, ``headers`` all headers of the file; ``idle`` are the
    headers of forces that are zero in all rows; ``units`` are those of a row of units.
    """
    problems: list[InputProblem] = []
    has_slip = {"alpha", *SLIP_DEFINITIONS} & set(columns)
    has_force = {"fx", "fy", "mz"} & set(columns)
    # A log may have a sideslip angle that is read as alpha, so look for a force.
    no_tire = not has_slip or (forces and "fz" not in columns)
    if no_tire and not (has_force or idle):
        if log := vehicle_log(headers, file, not has_slip, units):
            return [log]
    there = f"columns found: {', '.join(map(repr, headers))}"
    if len(headers) == 1:
        there += " only; separate columns by comma, semicolon, tab, | or spaces"
    if not has_slip:
        remedy = f"name one, as in --column kappa=HEADER; {there}"
        if {"omega", "v"} <= set(columns):
            remedy = "give --rolling-radius R [m] to compute it from omega and v"
        reason = "no slip: one of sigma_x, kappa, s, slip_ratio, alpha is needed"
        problems.append(InputProblem(reason, remedy, file))
    if forces and not has_force:
        reason = "no force: one of fx, fy, mz is needed"
        reason += f"; {' and '.join(map(repr, idle))} is zero in all rows" if idle else ""
        remedy = f"name one, as in --column fx=HEADER; {there}"
        problems.append(InputProblem(reason, remedy, file))
    if "fz" not in columns:
        remedy = "name it with --column fz=HEADER, or give --constant fz=4000 [N]"
        problems.append(InputProblem("no load: fz is needed", remedy, file))
    return problems


def check_variation(columns: Mapping[str, np.ndarray], file: str) -> list[InputProblem]:
    """A problem if the slip is constant, as it then gives no slip curve."""
    slips = [name for name in ("sigma_x", "alpha") if name in columns]
    spread = [np.ptp(columns[name]) if len(columns[name]) else 0.0 for name in slips]
    if not slips or max(spread) > 1e-9:
        return []
    value = ", ".join(f"{name} = {columns[name][0]:.6g}" for name in slips)
    remedy = "a fit needs rows at several slips: check that the right column is read"
    return [InputProblem(f"constant slip ({value} in all used rows)", remedy, file)]


def doubt_time(time: np.ndarray, run: np.ndarray, lines: np.ndarray, header: str) -> list[str]:
    """A warning if the time goes back within a run.

    Args:
        time, run, lines: (n,) time [s], run and line in the file of the used rows.
        header: the header of the time in the file.
    """
    order = np.argsort(run, kind="stable")
    back = (np.diff(time[order]) < 0) & (np.diff(run[order]) == 0)
    if not back.any():
        return []
    at = int(np.argmax(back))
    before, row = order[at], order[at + 1]
    more = f" (and {back.sum() - 1} times more)" if back.sum() > 1 else ""
    return [
        f"row {lines[row]}, column {header!r}: the time goes back, from"
        f" {time[before]:.6g} s to {time[row]:.6g} s within a run{more}: give each recording its"
        " own run (--column run=HEADER), or correct the time"
    ]


def read_numbers(
    cells: Sequence[str] | np.ndarray, header: str, ragged: np.ndarray, gaps: bool = False
) -> tuple[np.ndarray, list[BadRows]]:
    """Numbers of a column of cells, and the faulty ones.

    Args:
        cells: n strings, also as a column of a large text, or an (n,) array.
        header: named in the faults.
        ragged: (n,) bool, rows already known to be bad.
        gaps: whether cells without a value (empty, NaN, NA) are allowed.

    Returns:
        float64 (n,) with NaN for every fault, and the faults by kind.
    """
    if isinstance(cells, np.ndarray):
        values = cells.astype(float)
    else:
        values = cells.values if isinstance(cells, Column) else parsed(cells)
    is_sane = abs(values) < _LARGEST
    kinds: dict[str, list[tuple[int, str]]] = {}
    for row in np.flatnonzero(~is_sane & ~ragged):
        shown, kind = _fault_of(str(cells[int(row)]))
        if gaps and kind in _MISSING:
            continue
        kinds.setdefault(kind, []).append((int(row), shown))
    whole, faults = np.count_nonzero(~ragged), []
    for kind, there in kinds.items():
        rows, texts = zip(*there, strict=True)
        remedy = _OF_WHOLE_COLUMN.get(kind) if len(there) == whole else None
        faults.append(BadRows(header, rows, texts, kind, remedy or _CORRECT, bool(remedy)))
    return np.where(is_sane, values, np.nan), faults


def _fault_of(cell: str) -> tuple[str, str]:
    """The text by which a message quotes a cell without a finite number, and its fault."""
    text = cell.strip()
    if not text:
        return "an empty cell", _EMPTY
    shown = text if len(text) <= 30 else text[:27] + "..."
    word = text.lstrip("+-").casefold()
    if word in ("inf", "infinity"):
        return shown, INFINITE
    if is_number(text):
        return shown, f"is larger than any measured value (beyond {_LARGEST:g})"
    if word == "nan":
        return text, _NOT_A_NUMBER
    if word in ("notavail", "n/a", "#n/a", "na", "null", "none"):
        return f"{text}:", NO_VALUE
    if "," in text and is_number(text.replace(",", "")):
        return repr(shown), "has a comma: write 4000.5, without group separators"
    if _CLOCK.match(text):
        return repr(shown), _IS_CLOCK
    return repr(shown), _IS_TEXT


# --- rows that lack a value -----------------------------------------------------------

MOST = 0.1
"""Largest share of rows that are excluded without an option: without a tenth of the rows a standard
error is 5 % larger (1 / sqrt(0.9))."""

INPUTS = {"run", "time", "alpha", "fz", "v", "gamma", "omega", *SLIP_DEFINITIONS}
"""Columns without which a row cannot be predicted."""


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
        remedy = f"fill the cells, or exclude more than {MOST:.0%} of the rows with --mask-bad-rows"
        shares = {c: f"{len(each)} of {len(lines)} rows ({len(each) / len(lines):.1%})"
                  for c, each in places.items()}  # fmt: skip
        reasons = {c: f"{share} lack a value ({where[c]})" for c, share in shares.items()}
        return None, [InputProblem(reasons[c], remedy, file, column=c) for c in places]
    named = "; ".join(f"{column!r} in {where[column]}" for column in places)
    return f"excluded {len(rows)} of {len(lines)} rows, which lack a value: {named}", []
