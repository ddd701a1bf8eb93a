"""Find outliers: single rows with values far from their file or from their neighbours, as
a wrong unit or a faulty channel causes them."""

from collections.abc import Callable, Iterable, Iterator
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
_BESIDE = 4
"""Neighbours of a row on either side. The largest and the smallest of them are ignored,
as they may be outliers themselves."""
_NEAR = 4.0
"""Distance from the neighbours over their range (about 1.7 standard deviations in noise)
above which a value is far, if it is also ..."""
_SHARE = 0.25
"""... farther from them than this share of the range of the file."""
_AGAINST, _SMALL_SLIPS = 0.5, 0.25
"""A force above this share of the largest, with a slip of the opposite sign, is an
outlier, except at the smallest slips, which may have an offset."""
_LOAD_STEP = 0.1  # loads whose logarithms differ by less count as equal, ...
_SLIP_STEP = 0.02  # ... and so do values of the slip across the force.
_CHUNK = 1 << 16  # rows whose neighbours are sorted at once
_ALL = "all other rows"
_SLIP_OF = {"fx": "sigma_x", "fy": "alpha", "mz": "alpha"}


Beyond = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Far rows (n,), and the ends (n,) of the range of the others."""


class FarValue(NamedTuple):
    """An outlier: a value far from comparable values."""

    row: int  # counted from 0
    column: str
    value: float
    low: float  # range of the others
    high: float
    among: str  # name of the others


def far_values(data: TireData, columns: Iterable[str] = FAR_COLUMNS) -> tuple[FarValue, ...]:
    """The outliers of single rows, in the order of the rows.

    A value is far from its file if the gap to all others is three times their range. It is far from
    its neighbours if it is outside their range by four times that range and by a quarter of the
    range of the file. In a log the neighbours are the rows before and after; elsewhere, the
    neighbours of a force are rows of similar slip and load, and its slip determines its sign. A row
    is reported once for each column. Rules that find more than one row in twenty are ignored.

    Args:
        columns: those to check; names that the data lack are ignored.
    """
    rows = np.flatnonzero(data.used)
    if len(rows) < 2 * _BESIDE + 1:
        return ()
    by_place: dict[tuple[int, str], FarValue] = {}
    for column in (column for column in columns if column in data):
        values = data.usable(column)
        if not np.all(np.isfinite(values)):
            continue  # a column with gaps, which fits do not read
        for among, (is_far, low, high) in _rules(data, column, values):
            if np.count_nonzero(is_far) > max(1, _FEW * len(values)):
                continue
            for i in np.flatnonzero(is_far):
                place = int(rows[i]), column
                numbers = float(values[i]), float(low[i]), float(high[i])
                by_place.setdefault(place, FarValue(*place, *numbers, among))
    return tuple(by_place[place] for place in sorted(by_place))


def without_far(data: TireData, columns: Iterable[str] = FAR_COLUMNS) -> TireData:
    """The data without the rows that are far from their file; ``source.masked`` lists
    them. They have no neighbours to compare them with, and a single one may determine
    the dependence on load or speed."""
    keep, problems = np.ones(len(data), bool), []
    for value in far_values(data, columns):
        if value.among == _ALL and keep[value.row]:
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
    return f"{value.value:.6g}{unit} is far from {value.among}, which have {ends}{unit}"


def _rules(data: TireData, column: str, values: np.ndarray) -> Iterator[tuple[str, Beyond]]:
    """For each rule: (name of the others, (far rows, ends of the range of the others))."""
    if column == "fz":
        scales = (np.positive, np.log) if np.all(values > 0) else (np.positive,)
        for is_far, low, high in (_beyond_all(values, scale) for scale in scales):
            other = (values > _OTHER_LOAD * high) | (values < low / _OTHER_LOAD)
            yield _ALL, (is_far & other, low, high)
    elif column == "sigma_x":
        yield _ALL, _beyond_all(values, slip_ratio_from_sigma, LOCKED)
    else:
        yield _ALL, _beyond_all(values)
    if "time" in data:
        order = np.lexsort((data.usable("time"), data.run[data.used]))
        yield "the rows before and after", _beside(values, order)
    elif column in _SLIP_OF and _SLIP_OF[column] in data:
        # In a log a tire may lag behind its slip.
        slip = _SLIP_OF[column]
        yield f"rows of similar {slip}", _beside(values, like_slips(data, slip))
        if column != "mz":
            # A force that is large and has the sign that belongs to the opposite slip.
            slips, size = data.usable(slip), max(map(abs, _inner_range(values)))
            clear = np.abs(slips) > np.quantile(np.abs(slips), _SMALL_SLIPS)
            is_far = (values * slips < 0) & (np.abs(values) > _AGAINST * size) & clear
            ends = np.where(slips > 0, 0.0, -size), np.where(slips > 0, size, 0.0)
            yield f"forces with this sign of {slip}", (is_far, *ends)


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
    ends = np.full(count, values[order[last]]), np.full(count, values[order[first - 1]])
    return is_far & (values < locked), *ends


def _beside(values: np.ndarray, order: np.ndarray) -> Beyond:
    """Rows far outside the range of their neighbours in an order.

    The first and last rows have neighbours on one side only and are not checked, as a
    steep curve leaves the range of its neighbours there.
    """
    low, high = np.empty(len(values)), np.empty(len(values))
    ordered = values[order]
    for first in range(0, len(values), _CHUNK):
        at = np.arange(first, min(first + _CHUNK, len(values)))
        near = np.sort(ordered[_neighbours(at, len(values))], axis=1)
        low[order[at]], high[order[at]] = near[:, 1], near[:, -2]
    width = high - low
    whole = float(np.diff(_inner_range(values))[0])
    reach = np.maximum(_NEAR * np.maximum(width, np.median(width)), _SHARE * whole)
    is_far = (np.maximum(low - values, values - high) > reach) & (whole > 0)
    is_far[order[:_BESIDE]] = is_far[order[-_BESIDE:]] = False
    return is_far, low, high


def _inner_range(values: np.ndarray) -> tuple[float, float]:
    """Range of the values without one in a hundred at either end."""
    few = max(1, len(values) // 100)
    ordered = np.partition(values, (few, len(values) - 1 - few))
    return float(ordered[few]), float(ordered[-1 - few])


def _neighbours(at: np.ndarray, count: int) -> np.ndarray:
    """Positions (m, 8) of the nearest rows to each of m positions, without itself."""
    start = np.clip(at - _BESIDE, 0, count - 2 * _BESIDE - 1)
    near = start[:, None] + np.arange(2 * _BESIDE)
    return near + (near >= at[:, None])
