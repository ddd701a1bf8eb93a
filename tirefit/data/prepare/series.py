"""Rows as series: which of them follow each other evenly in time."""

from typing import NamedTuple

import numpy as np

from tirefit.data.table import TireData

_GAP = 3.5
"""Sampling steps without a row from which on a series is cut in two."""


class Series(NamedTuple):
    """The clock of a file and its unbroken pieces.

    ``time`` (n,) is in seconds, or counts rows where the file has no time: then
    ``rate`` is None. ``pieces`` are slices of rows, in order.
    """

    time: np.ndarray
    rate: float | None
    pieces: tuple[slice, ...]

    @property
    def hertz(self) -> float:
        """The rate of a series that has one."""
        assert self.rate is not None
        return self.rate


def runs_of(code: np.ndarray) -> list[tuple[int, int]]:
    """(begin, end) of the stretches of equal values of an (n,) array, or of equal rows
    of an (n, k) one."""
    if not len(code):
        return []
    table = np.asarray(code).reshape(len(code), -1)
    cuts = np.flatnonzero((table[1:] != table[:-1]).any(axis=1)) + 1
    ends = [0, *cuts.tolist(), len(table)]
    return list(zip(ends[:-1], ends[1:], strict=True))


def series_of(data: TireData, rate: float | None = None) -> Series:
    """The series of a file: pieces of one run each, time rising without gaps.

    Args:
        data: the rows in their order.
        rate: rows a second of a file without time; None counts the rows.
    """
    n = len(data)
    if "time" in data and np.isfinite(data["time"]).any():
        time = bridged(data["time"], np.arange(n, dtype=float))
        steps = np.diff(time)
        rising = steps[steps > 0]
        step = float(np.median(rising)) if len(rising) else 0.0
        if step > 0:
            broken = (steps <= 0) | (steps > _GAP * step)
            broken |= data.run[1:] != data.run[:-1]
            cuts = [0, *(np.flatnonzero(broken) + 1).tolist(), n]
            pieces = tuple(map(slice, cuts[:-1], cuts[1:]))
            return Series(time, 1 / step, pieces)
    row = np.arange(n, dtype=float)
    pieces = tuple(slice(begin, end) for begin, end in runs_of(data.run))
    return Series(row if rate is None else row / rate, rate, pieces)


def bridged(values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Values (n,) with straight lines over ``at`` (n,) where they are not finite."""
    good = np.isfinite(values)
    if good.all() or not good.any():
        return np.array(values, float)
    return np.interp(at, at[good], values[good])
