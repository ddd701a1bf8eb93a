"""The path of a slip in time, and how fast it changes, from slips with noise.

Local parabolas of several widths, ahead of, around and behind each row, averaged by how
probable each is: wide where the slip moves smoothly, one-sided where it turns sharply.
"""

from typing import NamedTuple

import numpy as np
from scipy.special import comb

from tirefit.diagnosis.negligible import FLAT, NONZERO, ROUNDING
from tirefit.fitting.noise import MAD

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


def _in_pieces(of, values, time, *given) -> list[np.ndarray]:
    """The columns ``of`` (values, time, *given) of one unbroken stretch, a piece at a
    time: rows depend on none beyond their reach, so the pieces are those of the whole.
    """
    pieces = []
    for first in range(0, len(values), _PIECE):
        start, end = max(first - _REACH, 0), first + _PIECE
        near = slice(start, end + _REACH)
        own = slice(first - start, end - start)
        pieces.append([column[own] for column in of(values[near], time[near], *given)])
    return [np.concatenate(column) for column in zip(*pieces, strict=True)]


class _Parabolas(NamedTuple):
    """Every window of one width: ``rows`` (a, w, 3) of the fit, ``fit`` (a, 3, w) that
    gives its coefficients, ``misfit`` (a,), the sum of squares, ``unit`` (a,) of time.
    """

    rows: np.ndarray
    fit: np.ndarray
    misfit: np.ndarray
    unit: np.ndarray


def _parabolas(values, time, window: int) -> _Parabolas:
    view = np.lib.stride_tricks.sliding_window_view
    x, t = view(values, window), view(time, window)
    unit = np.maximum((t[:, -1] - t[:, 0]) / 2, ROUNDING)
    u = (t - t[:, [window // 2]]) / unit[:, None]
    rows = np.stack([np.ones_like(u), u, u * u], axis=2)
    across = np.swapaxes(rows, 1, 2)
    normal = across @ rows
    try:
        fit = np.linalg.inv(normal) @ across
    except np.linalg.LinAlgError:  # times that differ by their last digits alone
        fit = np.linalg.pinv(normal, hermitian=True) @ across
    left = x - (rows @ (fit @ x[:, :, None]))[:, :, 0]
    return _Parabolas(rows, fit, np.sum(left**2, axis=1), unit)


def _left_out(values, time, window: int) -> tuple[np.ndarray]:
    """What each value misses the parabola through its neighbours by: (n,)."""
    local, size = _parabolas(values, time, window), np.arange(len(values))
    start = np.clip(size - window // 2, 0, len(values) - window)
    weights = np.einsum("ni,niw->nw", local.rows[start, size - start], local.fit[start])
    smooth = np.einsum("nw,nw->n", weights, values[start[:, None] + np.arange(window)])
    return ((values - smooth) / (1 - weights[size, size - start]),)


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


def _averaged(values, time, noise: float) -> _Path:
    """The path of one unbroken stretch, whose values scatter by ``noise``."""
    size, row = len(values), np.arange(len(values))
    path, rise = _Mean(values), _Mean(np.zeros(size))
    reach = np.zeros((size, 2 * _REACH + 1))
    for window in (w for w in (_AS_MEASURED, *_WINDOWS) if w <= size):
        local = _parabolas(values, time, window)
        log = _WORTH * (window - _COEFFICIENTS) - 0.5 * local.misfit / noise**2
        for first in (row - window // 2, row, row - window + 1):
            start = np.clip(first, 0, size - window)
            at, fit = local.rows[start, row - start], local.fit[start]
            slope = np.stack([np.zeros(size), np.ones(size), 2 * at[:, 1]], axis=1)
            slope = slope / local.unit[start, None]
            place = (start - row)[:, None] + _REACH + np.arange(window)
            around = values[start[:, None] + np.arange(window)]
            for mean, form in ((rise, slope), (path, at)):
                weights = np.einsum("ni,niw->nw", form, fit)
                estimated = np.einsum("nw,nw->n", weights, around)
                spread = noise**2 * np.sum(weights**2, axis=1)
                fade, share = mean.add(log[start], estimated, spread)
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

    def of(self, values, rate=None, time=None) -> np.ndarray:
        """Any values (n,) at these times: (n, k), in straight lines between the rows,
        or as cubics where their rate (n,) is known."""
        first, last, share = values[self.rows], values[self.others], self.share
        if rate is None:
            return (1 - share) * first + share * last
        step, rest = time[self.others] - time[self.rows], share - 1
        out, back = step * rate[self.rows], step * rate[self.others]
        moved = share**2 * (3 - 2 * share) * (last - first)
        return first + moved + share * rest**2 * out + share**2 * rest * back


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
    window, left_out = _best_window(slip, time, parts)
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
    paths = [
        _Path(*_in_pieces(_averaged, slip[part], time[part], level)) for part in parts
    ]
    usual = float(np.median(np.concatenate([np.diff(time[part]) for part in parts])))
    rate = np.sqrt(np.mean(np.concatenate([path.slope for path in paths]) ** 2))
    period = float(np.std(slip) / rate) if rate > 0 else 0.0
    past = none._replace(interval=max(usual, _SPAN * period))
    sweeps = still._replace(present=True, noise=scatter, past=past)
    past.path[:] = past.of(slip)
    for part, path in zip(parts, paths, strict=True):
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
    for part in parts:
        _, low, share = _places(past, part, time[part])
        past.rows[part], past.others[part] = part[low], part[low + 1]
        past.share[part] = share
    past.path[:] = past.of(slip, rate, time)
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


def _best_window(slip, time, parts) -> tuple[int, float]:
    """Window with the smallest leave-one-out error, and that mean square."""
    best = (_WINDOWS[0], np.inf)
    for window in _WINDOWS:
        errors = [
            _in_pieces(_left_out, slip[part], time[part], window)[0]
            for part in parts
            if len(part) > window
        ]
        if not errors:
            break
        error = float(np.mean(np.concatenate(errors) ** 2))
        if error < best[1]:
            best = (window, error)
    return best
