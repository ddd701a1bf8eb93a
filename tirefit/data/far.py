"""Find rows with a value far from all others of their column, as a wrong unit or a faulty
channel causes it."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tirefit.data.table import CANONICAL, TireData
from tirefit.results import InputProblem
from tirefit.slip import LOCKED, slip_ratio_from_sigma

FAR_COLUMNS = ("fz", "sigma_x", "alpha", "fx", "fy", "mz", "v", "gamma", "pressure", "temperature")
"""Columns that are checked."""

_FEWEST = 9  # rows in which a value can be far from all others
_GAP = 3.0
"""Gap between a value and all others, over the range of the others, above which it is an
outlier and not a setting."""
_FEW = 0.05  # largest share of outliers in the rows; more of them are part of the measurement
_LEAST_RANGE = 0.3  # smallest range of a column that is assumed, over its median
_OTHER_LOAD = 3.0  # factor between a load and all others above which its unit is wrong


class FarValue(NamedTuple):
    """An outlier: a value that a wide gap separates from all others of its column."""

    row: int  # counted from 0
    column: str
    value: float
    low: float  # range of the others
    high: float


def far_values(
    data: TireData, columns: Iterable[str] = FAR_COLUMNS, *, locking: bool = True
) -> tuple[FarValue, ...]:
    """The outliers of single rows, in the order of the rows.

    The gap between an outlier and all others is three times their range. A column with more
    than one such row in twenty has no outliers.

    Args:
        columns: those to check; names that the data lack are ignored.
        locking: whether large slips sigma_x may be those of a wheel that locks.
    """
    rows, by_place = np.flatnonzero(data.used), dict[tuple[int, str], FarValue]()
    for column in columns:
        values = data.usable(column) if column in data else np.zeros(0)
        if len(values) < _FEWEST or not np.all(np.isfinite(values)):
            continue  # a column with gaps, which fits do not read
        scales: tuple[Callable[[np.ndarray], np.ndarray], ...] = (np.positive,)
        if column == "sigma_x" and locking:
            scales = (slip_ratio_from_sigma,)
        elif column == "fz" and np.all(values > 0):
            scales = np.positive, np.log
        for scale in scales:
            is_far, low, high = _beyond_all(values, scale)
            if column == "fz":
                is_far &= (values > _OTHER_LOAD * high) | (values < low / _OTHER_LOAD)
            elif column == "sigma_x":
                is_far &= values < LOCKED  # a locked wheel is no outlier
            for i in np.flatnonzero(is_far):
                place = int(rows[i]), column
                by_place.setdefault(place, FarValue(*place, float(values[i]), low, high))
    return tuple(by_place[place] for place in sorted(by_place))


def without_far(data: TireData, columns: Iterable[str] = FAR_COLUMNS) -> TireData:
    """The data without the rows that are far from their file; ``source.masked`` lists
    them. They have no neighbours to compare them with, and a single one may determine
    the dependence on load or speed."""
    keep, problems = np.ones(len(data), bool), []
    for value in far_values(data, columns):
        if keep[value.row]:
            keep[value.row], remedy = False, "correct or delete the row"
            problems.append(problem_at(data, value.row, value.column, why_far(value), remedy))
    source = replace(data.source, masked=(*data.source.masked, *problems))
    return replace(data.where(keep), source=source)


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


def _beyond_all(
    values: np.ndarray, scale: Callable[[np.ndarray], np.ndarray]
) -> tuple[np.ndarray, float, float]:
    """Rows (n,) that a wide gap separates from all others, at either end, on a scale; and the
    range of the others."""
    order = np.argsort(values, kind="stable")
    ordered = scale(values[order])
    count, few = len(values), max(1, int(_FEW * len(values)))
    # A share of the values themselves, also on a logarithmic scale.
    least = _LEAST_RANGE * (1.0 if scale is np.log else abs(float(np.median(ordered))))
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
    if np.count_nonzero(is_far) > few:
        is_far[:] = False
    return is_far, float(values[order[last]]), float(values[order[first - 1]])
