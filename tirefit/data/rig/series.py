"""Time series with even spacing, and one low-pass filter for all channels.

A Butterworth filter run forwards and then backwards over the series has the gain
``1 / (1 + (f/f_c)^4)`` and zero phase. The corner ``f_c`` of one pass is set so that both
together have -3 dB at the bandwidth. Constants, ramps and parabolas pass unchanged, so
the peak of a sweep is not flattened to second order.
"""

from typing import NamedTuple

import numpy as np
from scipy.signal import butter, sosfiltfilt

from tirefit.data.table import TireData
from tirefit.results import DataError

_GAP = 3.5  # longest gap within a series, in sampling steps


class Series(NamedTuple):
    """The clock of a file and its unbroken pieces."""

    time: np.ndarray  # (n,) [s]
    rate: float  # [1/s]
    pieces: tuple[slice, ...]  # slices of rows, in order


def runs_of(code: np.ndarray) -> list[tuple[int, int]]:
    """(begin, end) of stretches of equal values of an array (n,) or rows (n, k)."""
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
        rate: rows per second of a file without time.

    Raises:
        DataError: neither a time that rises nor a rate.
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
    if rate is None:
        reason = "no time that rises, by which the test would be segmented"
        remedy = "name it, as in --column time=HEADER, or state the rows per second with --rate;"
        remedy += " points without an order are fitted without `prepare`"
        raise DataError(reason, remedy, data.file)
    pieces = tuple(slice(begin, end) for begin, end in runs_of(data.run))
    return Series(np.arange(n) / rate, rate, pieces)


def bridged(values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Values (n,), interpolated linearly over ``at`` (n,) where they are not finite."""
    good = np.isfinite(values)
    if good.all() or not good.any():
        return np.array(values, float)
    return np.interp(at, at[good], values[good])


_ORDER = 2  # of one pass; both passes together have 80 dB per decade
_HIGHEST = 0.4  # largest bandwidth over the sampling rate; above, a filter has no effect
_UNEVEN = 0.1  # largest deviation of a time stamp from an even grid, in sampling steps
_CLEAR = 4.0  # standard errors of a significant correlation of slip and force


class ZeroPhase(NamedTuple):
    """A low-pass filter for series of ``rate`` samples a second."""

    bandwidth: float  # [Hz] at -3 dB
    rate: float
    corner: float  # [Hz] of one pass at -3 dB
    sections: np.ndarray  # (s, 6) second-order sections of one pass

    @property
    def reach(self) -> float:
        """Time [s] on either side over which a sample has a noticeable effect: beyond it,
        the response to a step is within 1 % of its end value."""
        return 0.7 / self.bandwidth

    @property
    def step(self) -> int:
        """Rows from one independent row to the next: white noise is uncorrelated after half
        a cycle of the bandwidth (correlation 0.01; from there on -0.13 to 0.03)."""
        return max(int(np.ceil(round(self.rate / (2 * self.bandwidth), 3))), 1)

    def __call__(self, values: np.ndarray, time: np.ndarray | None = None) -> np.ndarray:
        """The filtered series.

        Args:
            values: (n,) of one channel, finite, evenly sampled unless ``time`` is given.
            time: (n,) [s]; if it is uneven, the series is interpolated linearly to an
                even grid, filtered there, and interpolated back to its own times.
        """
        if len(values) < 3:
            return np.array(values, float)
        if time is None:
            return self._even(values)
        grid = np.linspace(time[0], time[-1], len(time))
        if np.max(np.abs(grid - time)) <= _UNEVEN / self.rate:
            return self._even(values)
        count = max(len(time), round((time[-1] - time[0]) * self.rate) + 1)
        grid = np.linspace(time[0], time[-1], count)
        return np.interp(time, grid, self._even(np.interp(grid, time, values)))

    def smoothed(self, values: np.ndarray, series: Series) -> np.ndarray:
        """The values (n,), each piece of the series filtered."""
        out = np.array(values, float)
        for piece in series.pieces:
            out[piece] = self(values[piece], series.time[piece])
        return out

    def independent(self, series: Series) -> np.ndarray:
        """The rows (n,) bool that are independent after the filter: each ``step`` of a piece."""
        rows = np.zeros(len(series.time), bool)
        for piece in series.pieces:
            rows[piece.start : piece.stop : self.step] = True
        return rows

    def force_beyond(
        self, series: Series, slip: np.ndarray, force: np.ndarray, rows: np.ndarray
    ) -> float:
        """Movement of the force with the slip beyond the bandwidth, over its largest value.

        There, the noises of slip and force are independent, but what the tire does is not.
        Zero if the correlation is not significant.

        Args:
            slip, force: (n,) unfiltered.
            rows: those that are compared.
        """
        fast = [(values - self.smoothed(values, series))[rows] for values in (slip, force)]
        sizes = [float(np.sqrt(np.mean(change**2))) for change in fast]
        if min(sizes) == 0:
            return 0.0
        shared = abs(float(np.mean(fast[0] * fast[1]))) / (sizes[0] * sizes[1])
        if shared < _CLEAR / np.sqrt(len(rows)):
            return 0.0
        return shared * sizes[1] / float(np.quantile(np.abs(force[rows]), 0.99))

    def _even(self, values: np.ndarray) -> np.ndarray:
        # Extend the series beyond its ends by point reflection.
        room = min(len(values) - 1, int(np.ceil(2 * self.rate / self.bandwidth)))
        return sosfiltfilt(self.sections, values, padtype="odd", padlen=room)


def zero_phase(bandwidth: float, rate: float) -> ZeroPhase | None:
    """The filter, or None if the sampling is too slow for the bandwidth.

    Args:
        bandwidth: frequency [Hz] at which the gain of both passes is -3 dB.
        rate: samples per second.
    """
    if not 0 < bandwidth <= _HIGHEST * rate:
        return None
    # Both passes: 1 / (1 + x^(2 N)) = 1 / sqrt(2), in the prewarped frequency.
    share = (np.sqrt(2) - 1) ** (1 / (2 * _ORDER))
    corner = np.arctan(np.tan(np.pi * bandwidth / rate) / share) * rate / np.pi
    sections = butter(_ORDER, corner, fs=rate, output="sos")
    return ZeroPhase(bandwidth, rate, float(corner), sections)
