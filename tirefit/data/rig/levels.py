"""Find the settings of a rig: the levels at which the values of a column cluster."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

FEW_SETTINGS = 6
"""Largest number of levels that count as settings; a column with more is a range."""

_LEAST = 0.005
"""A gap is ignored below this share of the range and of the largest value: it may be a step of a
logger or drift of a controller. Settings are at least three times as far apart."""
_WIDER = 3.0
"""A gap separates two settings if it is this multiple of the next narrower gap, and of the scatter
about the settings. Of 300 normal or uniform samples of 20 rows and more, none is split; settings
with a standard deviation of a tenth of their distance are found."""
_ROWS = 2  # smallest number of rows of a setting; a single one is an outlier or part of a sweep


class Levels(NamedTuple):
    """Levels of a column in increasing order."""

    center: np.ndarray  # (k,) medians
    low: np.ndarray  # (k,) ends
    high: np.ndarray
    code: np.ndarray  # (n,) level of each row
    is_swept: bool  # no clusters; the only level is the whole range

    def few(self, most: int = FEW_SETTINGS) -> bool:
        """Whether these are settings, and at most ``most``."""
        return not self.is_swept and len(self.center) <= most


def levels(values: ArrayLike) -> Levels:
    """The settings at which values cluster, separated by gaps.

    The values are cut at their widest gaps, as long as each is clearly wider than the
    scatter within the parts and than the gaps that are not cut. A range without such
    gaps is swept, unless it is too narrow for more than one setting.

    Args:
        values: (n,) finite.

    Returns:
        Read-only arrays.
    """
    return _levels_of(np.asarray(values, float).tobytes())


# Several steps use the levels of the same columns.
@lru_cache(maxsize=16)
def _levels_of(column: bytes) -> Levels:
    values = np.frombuffer(column)
    if not len(values):
        none = np.zeros(0)
        return Levels(none, none, none, np.zeros(0, int), False)
    order = np.argsort(values, kind="stable")
    ordered = values[order]
    least = _LEAST * max(ordered[-1] - ordered[0], np.max(np.abs(ordered)))
    cuts = _cuts(ordered, least)
    while len(cuts):
        sizes = np.diff(np.concatenate([[0], cuts, [len(ordered)]]))
        lone = int(np.argmin(sizes))
        if sizes[lone] >= _ROWS:
            break
        gaps = np.concatenate([[np.inf], ordered[cuts] - ordered[cuts - 1], [np.inf]])
        # A part that is too small joins the nearer of its neighbours.
        cuts = np.delete(cuts, lone - 1 if gaps[lone] < gaps[lone + 1] else lone)
    parts = np.split(ordered, cuts)
    code = np.empty(len(values), int)
    code[order] = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    each = zip(*((np.median(part), part[0], part[-1]) for part in parts), strict=True)
    center, low, high = map(np.array, each)
    for array in (center, low, high, code):
        array.setflags(write=False)
    is_swept = bool(len(parts) == 1 and ordered[-1] - ordered[0] > least)
    return Levels(center, low, high, code, is_swept)


def _cuts(ordered: np.ndarray, least: float) -> np.ndarray:
    """The cuts of sorted values into settings: first index of every setting but one."""
    gaps = np.diff(ordered)
    widest = np.argsort(-gaps, kind="stable")
    width = np.append(gaps[widest], 0.0)
    chosen = np.zeros(0, int)
    for count in range(1, len(ordered) // _ROWS):
        narrowest = width[count - 1]
        if narrowest <= _WIDER * least:
            break
        if narrowest < _WIDER * width[count]:
            continue
        cuts = np.sort(widest[:count]) + 1
        sizes = np.diff(np.concatenate([[0], cuts, [len(ordered)]]))
        sums = np.add.reduceat(ordered, np.concatenate([[0], cuts]))
        away = ordered - np.repeat(sums / sizes, sizes)
        if narrowest >= _WIDER * np.sqrt(away @ away / (len(ordered) - count - 1)):
            chosen = cuts
    return chosen


def cells(
    codes: np.ndarray, size: int, values: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Count, mean and sample standard deviation of the values in each cell.

    Args:
        codes: (n,) from 0, the cell of each value.
        size: number of cells.
        values: (n,).

    Returns:
        (size,) each; zero for an empty cell, and its deviation for one value.
    """
    count = np.bincount(codes, minlength=size)
    mean = np.bincount(codes, values, size) / np.maximum(count, 1)
    rest = np.bincount(codes, (values - mean[codes]) ** 2, size)
    return count, mean, np.sqrt(rest / np.maximum(count - 1, 1))
