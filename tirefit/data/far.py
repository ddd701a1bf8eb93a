"""Find outliers: single rows with values far from all others of their file, as a wrong unit or
a faulty channel causes them. A fit itself excludes rows that are far from their neighbours."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tirefit.data.table import CANONICAL, TireData
from tirefit.results import InputProblem
from tirefit.slip import LOCKED, slip_ratio_from_sigma

FAR_COLUMNS = ("fz", "sigma_x", "alpha", "fx", "fy", "mz", "v", "gamma", "pressure", "temperature")
"""Columns that are checked."""

_GAP = 3.0
"""Gap between a value and all others, over the range of the others, above which it is an
outlier and not a setting."""
_FEW = 0.05  # largest share of outliers in the rows; more of them are part of the measurement
_LEAST_RANGE = 0.3  # smallest range of a column that is assumed, over its median
_OTHER_LOAD = 3.0  # factor between a load and all others above which its unit is wrong
_FEWEST = 9  # smallest number of rows with outliers
_LOAD_STEP = 0.1  # loads whose logarithms differ by less count as equal, ...
_SLIP_STEP = 0.02  # ... and so do values of the slip across the force.

Beyond = tuple[np.ndarray, float, float]
"""Far rows (n,) bool, and the ends of the range of the others."""


class FarValue(NamedTuple):
    """An outlier: a value far from comparable values."""

    row: int  # counted from 0
    column: str
    value: float
    low: float  # range of the others
    high: float


def far_values(data: TireData, columns: Iterable[str] = FAR_COLUMNS) -> tuple[FarValue, ...]:
    """The outliers of single rows, in the order of the rows.

    A value is an outlier if the gap to all others is three times their range, unless more than one
    row in twenty is.

    Args:
        columns: those to check; names that the data lack are ignored.
    """
    rows = np.flatnonzero(data.used)
    if len(rows) < _FEWEST:
        return ()
    values_far: dict[tuple[int, str], FarValue] = {}
    for column in (column for column in columns if column in data):
        values = data.usable(column)
        if not np.all(np.isfinite(values)):
            continue  # a column with gaps, which fits do not read
        for is_far, low, high in _beyond(column, values):
            if np.count_nonzero(is_far) > max(1, _FEW * len(values)):
                continue
            for i in np.flatnonzero(is_far):
                place = int(rows[i]), column
                values_far.setdefault(place, FarValue(*place, float(values[i]), low, high))
    return tuple(values_far[place] for place in sorted(values_far))


def without_far(data: TireData, columns: Iterable[str] = FAR_COLUMNS) -> TireData:
    """The data without the rows that are far from their file; ``source.masked`` lists
    them. A single one may determine the dependence on load or speed."""
    keep, problems = np.ones(len(data), bool), []
    for value in far_values(data, columns):
        if keep[value.row]:
            keep[value.row], remedy = False, "correct or delete the row"
            problems.append(problem_at(data, value.row, value.column, why_far(value), remedy))
    source = replace(data.source, masked=(*data.source.masked, *problems))
    return replace(data.where(keep), source=source)


def like_slips(data: TireData, slip: str) -> np.ndarray:
    """Order (n_used,) of the used rows by run, load, the other slip, and slip: neighbours
    in it were measured in similar states."""
    load = np.round(np.log(data.usable("fz")) / _LOAD_STEP)
    other = {"sigma_x": "alpha", "alpha": "sigma_x"}[slip]
    across = data.usable(other) if other in data else np.zeros(data.n)
    alike = np.round(np.minimum(across, LOCKED) / _SLIP_STEP)
    return np.lexsort((data.usable(slip), alike, load, data.run[data.used]))


def problem_at(data: TireData, row: int, column: str, reason: str, remedy: str) -> InputProblem:
    """A problem with one row (counted from 0), placed in its own file."""
    source = data.source
    file = source.paths[data.run[row]] if source.paths else data.file
    line = row if source.line is None else int(source.line[row])
    return InputProblem(reason, remedy, file, line, source.columns.get(column, column))


def why_far(value: FarValue) -> str:
    """The reason of a far value, for :func:`problem_at`."""
    unit = f" {CANONICAL[value.column][0]}".removesuffix(" -")
    ends = " to ".join(dict.fromkeys((f"{value.low:.4g}", f"{value.high:.4g}")))
    return f"{value.value:.6g}{unit} is far from all other rows, which have {ends}{unit}"


def _beyond(column: str, values: np.ndarray) -> list[Beyond]:
    """Far rows of a column: by its values, and of positive loads by their logarithms too."""
    if column == "sigma_x":
        return [_beyond_all(values, slip_ratio_from_sigma, LOCKED)]
    if column != "fz":
        return [_beyond_all(values)]
    beyond = []
    for scale in (np.positive, np.log) if np.all(values > 0) else (np.positive,):
        is_far, low, high = _beyond_all(values, scale)
        other = (values > _OTHER_LOAD * high) | (values < low / _OTHER_LOAD)
        beyond.append((is_far & other, low, high))
    return beyond


def _beyond_all(
    values: np.ndarray,
    shape: Callable[[np.ndarray], np.ndarray] = np.positive,
    locked: float = np.inf,
) -> Beyond:
    """Rows that a wide gap separates from all others, at either end.

    Args:
        values: (n,).
        shape: scale on which gaps are compared.
        locked: values above which a row is a locked wheel and no outlier.
    """
    order = np.argsort(values, kind="stable")
    ordered = shape(values[order])
    count, few = len(values), max(1, int(_FEW * len(values)))
    # A share of the values themselves, also on a logarithmic scale.
    middle = 1.0 if shape is np.log else abs(float(np.median(ordered)))
    least = _LEAST_RANGE * middle
    gap = np.diff(ordered)
    # Range of the rows below each gap, and of those above it.
    below = np.maximum(ordered[:-1] - ordered[few], least)
    above = np.maximum(ordered[-1 - few] - ordered[1:], least)
    outer = np.arange(1, count)
    wide_up = (gap > _GAP * below) & (below > 0) & (outer >= count - few)
    wide_down = (gap > _GAP * above) & (above > 0) & (outer <= few)
    first = int(outer[wide_up][0]) if wide_up.any() else count
    last = int(outer[wide_down][-1]) if wide_down.any() else 0
    is_far = np.zeros(count, bool)
    is_far[order[:last]] = is_far[order[first:]] = True
    return is_far & (values < locked), float(values[order[last]]), float(values[order[first - 1]])
