"""Divide a slip over time into legs: held, swept up or down, or moved."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from tirefit.data.rig.series import runs_of

HELD, SWEPT, MOVED = "held", "swept", "moved"

LEAST = {"alpha": np.radians(0.5), "sigma_x": 0.01}
"""Range of a slip below which it was held and not swept."""

_REVERSAL = 0.02  # share of the range by which a slip goes back when a sweep turns
_STILL = 0.008  # share of the range within which a slip is held
_LONGER = 3  # factor by which windows are longer if the slip moves too little in shorter ones
_NOISES = 8.0  # smallest change [standard deviations of the noise] that is a movement
_PAUSE = 0.3
"""A stop shorter than this share of the sweeps next to it is their turning point: a sine
is within ``_STILL`` of its end for 0.11 of a sweep."""
_STEP = 0.4  # a movement shorter than this share of both stops next to it is a step between them


class Leg(NamedTuple):
    """Rows ``begin`` to ``end`` (exclusive) in which a slip was held, swept or moved."""

    begin: int
    end: int
    how: str  # held, swept or moved
    direction: int = 0  # +1 or -1 of a sweep, else 0

    @property
    def rows(self) -> int:
        return self.end - self.begin


def swept_range(slip: np.ndarray) -> float:
    """Range of a slip without its extreme rows."""
    low, high = np.percentile(slip, [0.2, 99.8])
    return float(high - low)


def legs(
    slip: np.ndarray, pieces: Iterable[slice], noise: float, least: float, shortest: int
) -> list[Leg]:
    """The legs of a slip: they cover all rows of the pieces, in order.

    Args:
        slip: (n,) smoothed, finite.
        pieces: slices of consecutive rows.
        noise: standard deviation of the noise in it.
        least: range below which the slip was held in all rows.
        shortest: smallest number of rows of a hold.
    """
    size = swept_range(slip)
    if size < max(least, 2 * _NOISES * noise):
        return [Leg(piece.start, piece.stop, HELD) for piece in pieces]
    still = max(_STILL * size, _NOISES * noise)
    reversal = max(_REVERSAL * size, _NOISES * noise)
    all_legs: list[Leg] = []
    for piece in pieces:
        part = slip[piece]
        stops = _stops(part, still, shortest)
        moving = _between(part, stops, reversal)
        kept = []
        for a, b in stops:
            beside = [leg for leg in moving if leg.end == a or leg.begin == b]
            opposite = len(beside) > 1 and not sum(leg.direction for leg in beside)
            # Else it is only the turning point of sweeps.
            if not opposite or b - a >= _PAUSE * min(leg.rows for leg in beside):
                kept.append((a, b))
        if len(kept) < len(stops):
            moving = _between(part, kept, reversal)
        here = sorted([*(Leg(*stop, HELD) for stop in kept), *moving])
        all_legs += [
            leg._replace(begin=leg.begin + piece.start, end=leg.end + piece.start) for leg in here
        ]
    # Legs between two stops are steps if they are short compared with both.
    steps = list(all_legs)
    for k in range(1, len(all_legs) - 1):
        before, leg, after = steps[k - 1], all_legs[k], all_legs[k + 1]
        joined = before.end == leg.begin and leg.end == after.begin
        if leg.how == SWEPT and joined and {before.how, after.how} == {HELD}:
            if leg.rows < _STEP * min(before.rows, after.rows):
                steps[k] = leg._replace(how=MOVED, direction=0)
    return _without_returns(slip, steps)


def number_of(all_legs: list[Leg]) -> np.ndarray:
    """The number (n,) of the leg of each row, from 0."""
    return np.repeat(np.arange(len(all_legs)), [leg.rows for leg in all_legs])


def _stops(slip: np.ndarray, still: float, shortest: int) -> list[tuple[int, int]]:
    """Stretches of at least ``shortest`` rows in which the slip does not change."""
    n = len(slip)
    if n < shortest:
        return [(0, n)] if np.ptp(slip) <= still else []
    # Range of the window that begins at each row.
    shift = -((shortest - 1) // 2) if shortest % 2 else -(shortest // 2)
    high = maximum_filter1d(slip, shortest, origin=shift, mode="nearest")
    low = minimum_filter1d(slip, shortest, origin=shift, mode="nearest")
    begins = np.flatnonzero((high - low <= still)[: n - shortest + 1])
    if not len(begins):
        return []
    mark = np.zeros(n + 1, int)
    np.add.at(mark, begins, 1)
    np.add.at(mark, begins + shortest, -1)
    inside = np.cumsum(mark)[:-1] > 0
    kept = []
    for a, b in ((a, b) for a, b in runs_of(inside) if inside[a]):
        if np.ptp(slip[a:b]) <= 2 * still:
            kept.append((a, b))
        else:  # overlapping windows can follow a slow sweep, so use longer ones
            inner = _stops(slip[a:b], still, _LONGER * shortest)
            kept += [(a + first, a + last) for first, last in inner]
    return kept


def _between(slip: np.ndarray, stops: Iterable[tuple[int, int]], reversal: float) -> list[Leg]:
    """Legs between the stops, cut where the slip turns."""
    edges = [0, *(edge for stop in stops for edge in stop), len(slip)]
    moving: list[Leg] = []
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        if end <= begin:
            continue
        # Include the ends of the stops between which the slip moves.
        first, last = max(begin - 1, 0), min(end + 1, len(slip))
        cuts = [begin]
        for turn in (t + first for t in _turns(slip[first:last], reversal)):
            if begin < turn < end:
                # First row of the leg after a turn; the extreme belongs to the slower leg.
                before = abs(slip[turn] - slip[turn - 1])
                after = abs(slip[turn + 1] - slip[turn]) if turn + 1 < len(slip) else np.inf
                cuts.append(turn + 1 if before <= after else turn)
        cuts.append(end)
        for a, b in zip(cuts[:-1], cuts[1:], strict=True):
            if a == b:  # a jump from one row to the next
                continue
            change = slip[min(b, len(slip) - 1)] - slip[max(a - 1, 0)]
            how = SWEPT if abs(change) >= reversal else MOVED
            moving.append(Leg(a, b, how, int(np.sign(change)) if how == SWEPT else 0))
    return moving


def _turns(slip: np.ndarray, reversal: float) -> list[int]:
    """Rows at which the slip turns: extremes that it then leaves by ``reversal``."""
    turns = []
    values = slip.tolist()
    low = high = 0
    direction = 0
    for row, value in enumerate(values):
        if value > values[high]:
            high = row
        if value < values[low]:
            low = row
        if direction >= 0 and values[high] - value >= reversal:
            turns += [high] if direction else []
            direction, low = -1, row
            high = row
        elif direction <= 0 and value - values[low] >= reversal:
            turns += [low] if direction else []
            direction, high = 1, row
            low = row
    return turns


def _without_returns(slip: np.ndarray, all_legs: list[Leg]) -> list[Leg]:
    """Mark sweeps as moved that are much faster than those next to them."""

    def speed(leg: Leg) -> float:
        return abs(slip[leg.end - 1] - slip[leg.begin]) / leg.rows

    out = []
    for k, leg in enumerate(all_legs):
        beside = [*all_legs[max(k - 1, 0) : k], *all_legs[k + 1 : k + 2]]
        slower = [
            other
            for other in beside
            if leg.how == other.how == SWEPT
            and leg.direction != other.direction
            and (other.end == leg.begin or leg.end == other.begin)
        ]
        # A movement faster than the next sweep by this factor only takes the slip back.
        if any(speed(leg) > 2.5 * speed(other) for other in slower):
            leg = leg._replace(how=MOVED, direction=0)
        out.append(leg)
    return out
