"""Rows far from everything: values that lie neither among those of their file nor of
their neighbours, as a wrong unit or a faulty channel leaves them in single rows."""

from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tirefit.data.table import CANONICAL, TireData
from tirefit.results import InputProblem
from tirefit.slip import LOCKED, slip_ratio_from_sigma

FAR_COLUMNS = ("fz", "sigma_x", "alpha", "fx", "fy", "mz", "v", "gamma", "pressure", "temperature")
"""Columns that are looked at."""

_GAP = 3.0
"""Gap between a value and all others, in ranges of those others, that is no setting."""
_FEW = 0.05
"""Largest share of rows that are single ones: more are part of what was measured."""
_LEAST_RANGE = 0.3
"""A column that hardly varies counts as if it varied by so much of its median."""
_OTHER_LOAD = 3.0
"""Factor between a load and all others that is no other setting, but another unit."""
_BESIDE = 4
"""Neighbours of a row to either side. What lies outermost of them on both ends may be
absurd itself, and is left out."""
_NEAR = 4.0
"""Distance from the neighbours, in ranges of theirs (in noise some 1.7 standard
deviations wide), and ..."""
_SHARE = 0.25
"""... in ranges of the file, from which a value is far from its neighbours."""
_AGAINST, _SMALL_SLIPS = 0.5, 0.25
"""A force of so much of the largest with a slip of the other sign is absurd, but for
the smallest slips by size, which may have an offset."""
_LOAD_STEP = 0.1  # loads that differ by less in their logarithm are alike, ...
_SLIP_STEP = 0.02  # ... and slips across that of the force.
_CHUNK = 1 << 16  # rows whose neighbours are sorted at once
_ALL = "all other rows"
_SLIP_OF = {"fx": "sigma_x", "fy": "alpha", "mz": "alpha"}


class FarValue(NamedTuple):
    """A value far from all of its like."""

    row: int  # counted from 0
    column: str
    value: float
    low: float  # ends of what the others have
    high: float
    among: str  # which others


def far_values(data: TireData, columns: Iterable[str] = FAR_COLUMNS) -> tuple[FarValue, ...]:
    """Values of single rows that are far from everything, in the order of the rows.

    A value is far from its file where a gap of three times the range of all others
    parts it from them; from its neighbours where it lies outside of what they have by
    four times their range, and by a quarter of the file's. In a log the neighbours are
    the rows before and after; elsewhere those of a force are rows of about its slip and
    load, and its slip gives it its sign. A row is named once for a column; where more
    than one row in twenty would be, none is.

    Args:
        columns: those to look at; names that the data lack are passed over.
    """
    rows = np.flatnonzero(data.used)
    if len(rows) < 2 * _BESIDE + 1:
        return ()
    by_place: dict[tuple[int, str], FarValue] = {}
    for column in columns:
        if column not in data:
            continue
        values = data.usable(column)
        if not np.all(np.isfinite(values)):
            continue  # a column with gaps, which no fit reads
        for among, (far, low, high) in _rules(data, column, values):
            if np.count_nonzero(far) > max(1, _FEW * len(values)):
                continue
            for i in np.flatnonzero(far):
                place = int(rows[i]), column
                numbers = float(values[i]), float(low[i]), float(high[i])
                by_place.setdefault(place, FarValue(*place, *numbers, among))
    return tuple(by_place[place] for place in sorted(by_place))


def without_far(data: TireData, columns: Iterable[str] = FAR_COLUMNS) -> TireData:
    """The data without the rows that a value parts from all others of their file; each
    is among ``source.masked``. No neighbours say what such a row should be, and a
    single one may decide what a load or a speed is said to do."""
    keep, problems = np.ones(len(data), bool), []
    for far in far_values(data, columns):
        if far.among == _ALL and keep[far.row]:
            keep[far.row] = False
            remedy = "correct or delete the row"
            problems.append(problem_at(data, far.row, far.column, why_far(far), remedy))
    source = replace(data.source, masked=(*data.source.masked, *problems))
    return replace(data.where(keep), source=source)


def like_slips(data: TireData, slip: str) -> np.ndarray:
    """Order (n_used,) of the used rows by run, load, the other slip, and slip: rows
    that are neighbours in it were measured in about the same state."""
    load = np.round(np.log(data.usable("fz")) / _LOAD_STEP)
    other = {"sigma_x": "alpha", "alpha": "sigma_x"}[slip]
    across = data.usable(other) if other in data else np.zeros(data.n)
    alike = np.round(np.minimum(across, LOCKED) / _SLIP_STEP)
    return np.lexsort((data.usable(slip), alike, load, data.run[data.used]))


def problem_at(data: TireData, row: int, column: str, reason: str, remedy: str) -> InputProblem:
    """A problem with one row (counted from 0), placed in its own file."""
    source = data.source
    paths = source.paths
    file = paths[data.run[row]] if paths else data.file
    line = row if source.line is None else int(source.line[row])
    header = source.columns.get(column, column)
    return InputProblem(reason, remedy, file, line, header)


def why_far(value: FarValue) -> str:
    """The reason of a far value, for :func:`problem_at`."""
    unit = CANONICAL[value.column][0]
    unit = "" if unit == "-" else f" {unit}"
    ends = f"{value.low:.4g}", f"{value.high:.4g}"
    have = f"{' to '.join(dict.fromkeys(ends))}{unit}"
    return f"{value.value:.6g}{unit} is far from {value.among}, which have {have}"


def _rules(data: TireData, column: str, values):
    """(who the others are, (far rows, ends of what the others have)), rule by rule."""
    if column == "fz":
        scales = (np.positive, np.log) if np.all(values > 0) else (np.positive,)
        for far, low, high in (_beyond_all(values, scale) for scale in scales):
            other = (values > _OTHER_LOAD * high) | (values < low / _OTHER_LOAD)
            yield _ALL, (far & other, low, high)
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
        yield f"rows of about its {slip}", _beside(values, like_slips(data, slip))
        if column != "mz":
            among = f"forces of its sign of {slip}"
            yield among, _against(values, data.usable(slip))


def _beyond_all(values, shape=np.positive, locked=np.inf):
    """Rows that a wide gap parts from all others, at either end.

    Args:
        values: (n,).
        shape: scale on which gaps are compared.
        locked: values from which on a row is no stray, but a locked wheel.
    """
    order = np.argsort(values, kind="stable")
    ordered = shape(values[order])
    count, few = len(values), max(1, int(_FEW * len(values)))
    # A share of the values themselves, on a logarithmic scale too.
    middle = 1.0 if shape is np.log else abs(float(np.median(ordered)))
    least = _LEAST_RANGE * middle
    gap = np.diff(ordered)
    # How far the rows below a gap, and those above it, reach from the other end.
    below = np.maximum(ordered[:-1] - ordered[few], least)
    above = np.maximum(ordered[-1 - few] - ordered[1:], least)
    outer = np.arange(1, count)
    wide_up = (gap > _GAP * below) & (below > 0) & (outer >= count - few)
    wide_down = (gap > _GAP * above) & (above > 0) & (outer <= few)
    first = int(outer[wide_up][0]) if wide_up.any() else count
    last = int(outer[wide_down][-1]) if wide_down.any() else 0
    far = np.zeros(count, bool)
    far[order[:last]] = far[order[first:]] = True
    ends = np.full(count, values[order[last]]), np.full(count, values[order[first - 1]])
    return far & (values < locked), *ends


def _beside(values, order):
    """Rows that lie far outside of what their neighbours in an order have.

    The first and last rows, which have neighbours to one side only, are not judged:
    a steep curve goes on beyond its neighbours.
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
    far = (np.maximum(low - values, values - high) > reach) & (whole > 0)
    far[order[:_BESIDE]] = far[order[-_BESIDE:]] = False
    return far, low, high


def _against(values, slip):
    """Rows whose force is large and has the direction of a slip of the other sign."""
    outer = _inner_range(values)
    size = max(abs(outer[0]), abs(outer[1]))
    clear = np.abs(slip) > np.quantile(np.abs(slip), _SMALL_SLIPS)
    far = (values * slip < 0) & (np.abs(values) > _AGAINST * size) & clear
    return far, np.where(slip > 0, 0.0, -size), np.where(slip > 0, size, 0.0)


def _inner_range(values) -> tuple[float, float]:
    """Ends of the values but for one in a hundred at either."""
    few = max(1, len(values) // 100)
    ordered = np.partition(values, (few, len(values) - 1 - few))
    return float(ordered[few]), float(ordered[-1 - few])


def _neighbours(at, count: int):
    """Positions (m, 8) of the nearest rows of each of m positions, itself left out."""
    start = np.clip(at - _BESIDE, 0, count - 2 * _BESIDE - 1)
    near = start[:, None] + np.arange(2 * _BESIDE)
    return near + (near >= at[:, None])
