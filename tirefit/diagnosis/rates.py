"""The path of a slip in time, and how fast it changes, from slips with noise.

Local parabolas of several widths, ahead of, around and behind each row, averaged by how
probable each is: wide where the slip moves smoothly, one-sided where it turns sharply.
"""

from typing import NamedTuple

import numpy as np
from scipy.special import comb

from tirefit.diagnosis.negligible import FLAT, NONZERO, ROUNDING
from tirefit.fitting.noise import MAD

__all__ = ["AGES", "AHEAD", "STEPS", "Past", "Sweeps", "segments", "slip_rate"]

_WINDOWS = (5, 7, 11, 17, 25, 41)
"""Rows of the local parabolas: each half as wide again as the one before."""
_COEFFICIENTS = 3
"""Of a parabola."""
_NOISY = 17
"""Width from which, where it predicts best, neighbours differ by noise."""
_ALONE = 0.05
"""Share of its path that is not a row's own value, at least."""
_REACH = _WINDOWS[-1] - 1
_AS_MEASURED = 3
"""Rows of the parabola that goes through the values: that none is noise."""
_ORDERS = range(2, 9)
"""Differences that are tried for the scatter of values about a curve."""
_PIECE = 4_000
"""Rows of a long stretch worked out at once: so many stay near the processor."""

AHEAD = 4
"""Columns of the past that lie after its row."""

STEPS = (1, 1, 1, 1, 1, 1, 2, 2, 4, 4, 6, 8)
"""Intervals from each column before the row to the one before that: the longer ago a
slip was, the less its details count."""

AGES = np.concatenate([np.arange(-AHEAD, 1), np.cumsum(STEPS)])
"""How many intervals ago each column was."""

_SPAN = 0.45 / 12
"""The interval, at least, over the time that the slip takes for a change of its
standard deviation: a straight line over as much misses it by 2e-4 of that."""


_WORTH = 0.7
"""Log probability for each value that a parabola explains, against leaving the values
as measured, which the shortest does; on saw-tooth and sine sweeps the error claimed is
the true one."""

_UNSTEADY = 0.15
"""Share of the slip's variance that neighbours in time may leave open in a sweep."""

_MORE = 1.3
"""Scatter of the slip over the stated one from which it counts instead."""

_SURE = 0.05
"""Share of the usual rate from which a measured one has a sign."""

_FINEST = 1e-9
"""Error of a slope over the largest slope, at least."""

_GAP = 5.0
"""A pause of so many median intervals parts two segments of a run."""


def segments(time, run) -> list[np.ndarray]:
    """Rows of each unbroken stretch in time order: index arrays."""
    order = np.lexsort((time, run))
    step = np.diff(time[order])
    same = np.diff(run[order]) == 0
    usual = np.median(step[same & (step > 0)]) if np.any(same & (step > 0)) else 1.0
    breaks = np.flatnonzero(~same | (step > _GAP * usual) | (step <= 0)) + 1
    return np.split(order, breaks)


class _Stretches(NamedTuple):
    """Values and times (n,) of unbroken stretches, one after the other, and the rows
    between which each row's own stretch lies: its first, and that behind its last."""

    values: np.ndarray
    time: np.ndarray
    first: np.ndarray
    behind: np.ndarray

    def near(self, begin: int, end: int) -> "_Stretches":
        """The rows from ``begin`` to before ``end`` alone."""
        cut = (column[begin:end] for column in self[:2])
        edges = (np.clip(row[begin:end], begin, end) - begin for row in self[2:])
        return _Stretches(*cut, *edges)

    @property
    def longest(self) -> int:
        return int(np.max(self.behind - self.first))

    def starts(self, first, window: int):
        """(n,) where a window begins that would begin at ``first``, held within each
        row's stretch, and whether it is as long as that at all."""
        fits = self.behind - self.first >= window
        held = np.clip(first, self.first, np.maximum(self.behind - window, self.first))
        return np.where(fits, held, 0), fits


def _stretches(values, time, parts) -> _Stretches:
    sizes = np.array([len(part) for part in parts])
    ends, rows = np.cumsum(sizes), np.concatenate(parts)
    edges = np.repeat(ends - sizes, sizes), np.repeat(ends, sizes)
    return _Stretches(values[rows], time[rows], *edges)


def _in_pieces(of, along: _Stretches, *given) -> list[np.ndarray]:
    """The columns ``of`` (stretches, *given), a piece at a time: rows depend on none
    beyond their reach, so the pieces are those of the whole."""
    pieces = []
    for first in range(0, len(along.values), _PIECE):
        start, end = max(first - _REACH, 0), first + _PIECE
        own = slice(first - start, end - start)
        near = along.near(start, min(end + _REACH, len(along.values)))
        pieces.append([column[own] for column in of(near, *given)])
    return [np.concatenate(column) for column in zip(*pieces, strict=True)]


class _Parabolas(NamedTuple):
    """Every window of one width: ``rows`` (a, w, 3) of the fit, ``fit`` (a, 3, w) that
    gives its ``coefficients`` (a, 3), their ``covariance`` (a, 3, 3) for values of unit
    scatter, ``misfit`` (a,), the sum of squares, ``unit`` (a,) of time; ``at`` (n,)
    says which of them begins at a row."""

    rows: np.ndarray
    fit: np.ndarray
    coefficients: np.ndarray
    covariance: np.ndarray
    misfit: np.ndarray
    unit: np.ndarray
    at: np.ndarray


def _parabolas(along: _Stretches, window: int) -> _Parabolas:
    view, size = np.lib.stride_tricks.sliding_window_view, len(along.values)
    whole = along.behind - np.arange(size) >= window
    begin = np.flatnonzero(whole)
    x, t = view(along.values, window)[begin], view(along.time, window)[begin]
    unit = np.maximum((t[:, -1] - t[:, 0]) / 2, ROUNDING)
    u = (t - t[:, [window // 2]]) / unit[:, None]
    rows = np.stack([np.ones_like(u), u, u * u], axis=2)
    across = np.swapaxes(rows, 1, 2)
    covariance = np.linalg.inv(across @ rows)
    fit = covariance @ across
    found = fit @ x[:, :, None]
    misfit = np.sum((x - (rows @ found)[:, :, 0]) ** 2, axis=1)
    at = np.maximum(np.cumsum(whole) - 1, 0)
    return _Parabolas(rows, fit, found[:, :, 0], covariance, misfit, unit, at)


def _left_out(along: _Stretches, window: int) -> tuple[np.ndarray]:
    """What each value misses the parabola through its neighbours by: (n,); NaN where
    a stretch is no longer than the window."""
    local, row = _parabolas(along, window), np.arange(len(along.values))
    start, _ = along.starts(row - window // 2, window)
    at, place = local.at[start], np.clip(row - start, 0, window - 1)
    weights = np.einsum("ni,niw->nw", local.rows[at, place], local.fit[at])
    around = np.minimum(start[:, None] + np.arange(window), row[-1])
    smooth = np.einsum("nw,nw->n", weights, along.values[around])
    missed = (along.values - smooth) / (1 - weights[row, place])
    return (np.where(along.behind - along.first > window, missed, np.nan),)


class _Path(NamedTuple):
    """``value`` and ``slope`` (n,) with the standard deviation of the slope, and
    ``reach`` (n, 2 _REACH + 1): how much of the values around each value is made of."""

    value: np.ndarray
    slope: np.ndarray
    slope_error: np.ndarray
    reach: np.ndarray


class _Mean:
    """Mean and variance over estimates that are added one by one, by their log
    probability (n,)."""

    def __init__(self, about):
        self.about, size = about, len(about)
        self.top = np.full(size, -np.inf)
        self.total, self.first, self.second = np.zeros((3, size))

    def add(self, log, value, variance):
        """What the sums so far fade by, and the share of this one: (n,) each."""
        top = np.maximum(self.top, log)
        fade, share = np.exp(self.top - top), np.exp(log - top)
        off = value - self.about
        self.top = top
        self.total = fade * self.total + share
        self.first = fade * self.first + share * off
        self.second = fade * self.second + share * (off**2 + variance)
        return fade, share

    def result(self) -> tuple[np.ndarray, np.ndarray]:
        """(mean, standard deviation)."""
        off = self.first / self.total
        variance = np.maximum(self.second / self.total - off**2, 0.0)
        return self.about + off, np.sqrt(variance)


def _averaged(along: _Stretches, noise: float) -> _Path:
    """The path of stretches whose values scatter by ``noise``."""
    values, size = along.values, len(along.values)
    row = np.arange(size)
    path, rise = _Mean(values), _Mean(np.zeros(size))
    reach = np.zeros((size, 2 * _REACH + 1))
    for window in (w for w in (_AS_MEASURED, *_WINDOWS) if w <= along.longest):
        local = _parabolas(along, window)
        log = _WORTH * (window - _COEFFICIENTS) - 0.5 * local.misfit / noise**2
        for first in (row - window // 2, row, row - window + 1):
            start, fits = along.starts(first, window)
            of, place = local.at[start], np.clip(row - start, 0, window - 1)
            at = local.rows[of, place]
            slope = np.stack([np.zeros(size), np.ones(size), 2 * at[:, 1]], axis=1)
            slope = slope / local.unit[of, None]
            likely = np.where(fits, log[of], -np.inf)
            for mean, form in ((rise, slope), (path, at)):
                estimated = np.sum(form * local.coefficients[of], axis=1)
                spread = np.einsum("ni,nij,nj->n", form, local.covariance[of], form)
                fade, share = mean.add(likely, estimated, noise**2 * spread)
            weights = np.einsum("ni,niw->nw", at, local.fit[of])
            place = (start - row)[:, None] + _REACH + np.arange(window)
            place = np.clip(place, 0, 2 * _REACH)
            reach *= fade[:, None]
            reach[row[:, None], place] += share[:, None] * weights
    return _Path(path.result()[0], *rise.result(), reach / path.total[:, None])


class Past(NamedTuple):
    """What was before each row, :data:`AGES` times ``interval`` [s] ago: column
    :data:`AHEAD` is the row itself, those before it come later, those after it earlier.

    ``path`` (n, k) is the slip there as the other rows show it: a row's own noise moves
    neither its own path nor that of its neighbours. Times beyond the sweep are held at
    its end. ``rows``, ``others`` and ``share`` (n, k) say between which rows each time
    falls.
    """

    path: np.ndarray
    rows: np.ndarray
    others: np.ndarray
    share: np.ndarray
    interval: float

    def of(self, values) -> np.ndarray:
        """Any values (n,) at these times: (n, k)."""
        return (1 - self.share) * values[self.rows] + self.share * values[self.others]


def _no_past(values) -> Past:
    row = np.repeat(np.arange(len(values))[:, None], len(AGES), axis=1)
    return Past(np.zeros(row.shape), row, row.copy(), np.zeros(row.shape), 1.0)


def _places(past: Past, part, time):
    """Row numbers (n, 1), and between which rows (n, k) of the stretch the times of the
    past fall: after ``low``, by so much of a step."""
    size = len(part)
    when = np.clip(time[:, None] - past.interval * AGES, time[0], time[-1])
    low = np.clip(np.searchsorted(time, when, side="right") - 1, 0, size - 2)
    share = (when - time[low]) / (time[low + 1] - time[low])
    return np.arange(size)[:, None], low, share


def _fill_past(past: Past, part, values, time, path: _Path) -> None:
    """The past of the rows ``part`` of one unbroken stretch, written into ``past``."""
    row, low, share = _places(past, part, time)

    def own(at):
        """How much of each row's own value is in the path at a row."""
        far = np.abs(row - at) > _REACH
        weight = path.reach[at, np.clip(row - at, -_REACH, _REACH) + _REACH]
        return np.where(far, 0.0, weight)

    alone = np.maximum(1 - path.reach[:, _REACH], _ALONE)
    noise = ((values - path.value) / alone)[:, None]
    mean = (1 - share) * path.value[low] + share * path.value[low + 1]
    past.path[part] = mean - ((1 - share) * own(low) + share * own(low + 1)) * noise
    past.rows[part], past.others[part] = part[low], part[low + 1]
    past.share[part] = share


class Sweeps(NamedTuple):
    """How a slip moves in time: ``rate`` (n,) [1/s]; ``turning`` (n,), +1 where it
    grows in size, -1 where it shrinks; ``path`` (n,), the smooth slip; ``past``, what
    it was before; ``present``, whether the rows are sweeps in time at all; ``noise``,
    what the measured slip scatters about the path, 0 where it is not known."""

    rate: np.ndarray
    turning: np.ndarray
    path: np.ndarray
    past: Past
    present: bool
    noise: float


def slip_rate(slip, time, run, noise: float = 0.0, rate=None) -> Sweeps:
    """Rate of change of the slip.

    Args:
        slip: (n,) measured values.
        time: (n,) [s], or None.
        run: (n,) run of each row.
        noise: what is known of the scatter of the values; 0 is nothing.
        rate: (n,) [1/s] as it was measured between rows that are too far apart to show
            it, or None.
    """
    count = len(slip)
    none = _no_past(slip)
    still = Sweeps(np.zeros(count), np.zeros(count), slip.copy(), none, False, 0.0)
    if time is None:
        return still
    parts = [part for part in segments(time, run) if len(part) >= _WINDOWS[0] + 2]
    if sum(len(part) for part in parts) < 0.5 * count:
        return still
    if rate is not None and np.any(rate):
        return _by_its_rate(slip, time, rate, parts, still)
    along = _stretches(slip, time, parts)
    window, left_out = _best_window(along)
    if left_out > _UNSTEADY * np.var(slip):
        return still
    # Left out, a row misses by its own noise and that of the local parabola, which has
    # 9 / (4 w) of the variance at its middle. Where few neighbours predict best it is
    # the curve that misses, not noise.
    seen = np.sqrt(left_out / (1 + 9 / (4 * window)))
    scatter = seen if window >= _NOISY else 0.0
    seen = scatter or min(seen, _about_a_curve(slip, parts))
    seen = max(seen, FLAT * np.std(slip))
    level = max(noise, scatter if scatter > _MORE * noise else 0.0) or seen
    whole = _Path(*_in_pieces(_averaged, along, level))
    usual = float(np.median(np.concatenate([np.diff(time[part]) for part in parts])))
    rate = np.sqrt(np.mean(whole.slope**2))
    period = float(np.std(slip) / rate) if rate > 0 else 0.0
    past = none._replace(interval=max(usual, _SPAN * period))
    sweeps = still._replace(present=True, noise=scatter, past=past)
    past.path[:] = past.of(slip)
    ends = np.cumsum([len(part) for part in parts])[:-1]
    for part, *columns in zip(
        parts, *(np.split(column, ends) for column in whole), strict=True
    ):
        path = _Path(*columns)
        _fill_past(past, part, slip[part], time[part], path)
        sweeps.path[part], sweeps.rate[part] = path.value, path.slope
        # Slips that a formula gave have no error at all.
        finest = _FINEST * float(np.max(np.abs(path.slope)))
        error = np.maximum(path.slope_error, max(finest, NONZERO))
        certain = np.sign(slip[part]) * path.slope / (2 * error)
        sweeps.turning[part] = np.clip(certain, -1, 1)
    return sweeps


def _by_its_rate(slip, time, rate, parts, still: Sweeps) -> Sweeps:
    """Cubics through values and rates, as finely as the rate moves the slip: a past
    that lies between the rows."""
    usual = float(np.sqrt(np.mean(rate**2)))
    past = still.past._replace(interval=_SPAN * float(np.std(slip)) / usual)
    moving = still._replace(present=True, rate=rate, past=past)
    past.path[:] = past.of(slip)
    for part in parts:
        _, low, share = _places(past, part, time[part])
        step = time[part][low + 1] - time[part][low]
        first, last = (slip[part][at] for at in (low, low + 1))
        out, back = (step * rate[part][at] for at in (low, low + 1))
        rest = share - 1
        past.path[part] = (
            first + share**2 * (3 - 2 * share) * (last - first)
            + share * rest**2 * out + share**2 * rest * back
        )  # fmt: skip
        past.rows[part], past.others[part] = part[low], part[low + 1]
        past.share[part] = share
    sure = np.sign(slip) * rate / (2 * _SURE * usual)
    moving.turning[:] = np.clip(sure, -1, 1)
    return moving


def _about_a_curve(slip, parts) -> float:
    """Scatter of the values about a curve, however it bends: differences of rising
    order leave ever less of the curve, and the same of the scatter."""
    return min(
        MAD * np.median(np.abs(np.concatenate([np.diff(slip[p], k) for p in parts])))
        / np.sqrt(comb(2 * k, k))
        for k in _ORDERS
        if min(len(part) for part in parts) > k
    )  # fmt: skip


def _best_window(along: _Stretches) -> tuple[int, float]:
    """Window with the smallest leave-one-out error, and that mean square."""
    best = (_WINDOWS[0], np.inf)
    for window in (w for w in _WINDOWS if w < along.longest):
        error = float(np.nanmean(_in_pieces(_left_out, along, window)[0] ** 2))
        if error < best[1]:
            best = (window, error)
    return best
