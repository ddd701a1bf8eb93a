"""How fast the slip changes, from slips measured with noise."""

from typing import NamedTuple

import numpy as np
from scipy.signal import savgol_filter

__all__ = ["Sweeps", "segments", "slip_rate"]

_WINDOWS = (5, 7, 11, 17, 25, 41)
_NOISY = 17
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


def _smoothed(values, window: int):
    """Local parabolas: (smooth values, slope per row, leave-one-out residual)."""
    smooth = savgol_filter(values, window, 2, mode="interp")
    slope = savgol_filter(values, window, 2, deriv=1, mode="interp")
    impulse = np.zeros(window)
    impulse[window // 2] = 1.0
    own = savgol_filter(impulse, window, 2)[window // 2]
    return smooth, slope, (values - smooth) / (1 - own)


class Sweeps(NamedTuple):
    """How a slip moves in time: ``rate`` (n,) [1/s]; ``turning`` (n,), +1 where it
    grows in size, -1 where it shrinks; ``path`` (n,), the smooth slip; ``found``,
    whether the rows are sweeps in time at all; ``noise``, what the measured slip
    scatters about the path, 0 where it is not known."""

    rate: np.ndarray
    turning: np.ndarray
    path: np.ndarray
    found: bool
    noise: float


def slip_rate(slip, time, run) -> Sweeps:
    """Rate of change of the slip.

    Args:
        slip: (n,) measured values.
        time: (n,) [s], or None.
        run: (n,) run of each row.
    """
    rate, turning, path = np.zeros(len(slip)), np.zeros(len(slip)), slip.copy()
    if time is None:
        return Sweeps(rate, turning, path, False, 0.0)
    parts = [part for part in segments(time, run) if len(part) >= _WINDOWS[0] + 2]
    if sum(len(part) for part in parts) < 0.5 * len(slip):
        return Sweeps(rate, turning, path, False, 0.0)
    window, left_out = _best_window(slip, parts)
    if left_out > 0.15 * np.var(slip):
        return Sweeps(rate, turning, path, False, 0.0)
    noise = np.sqrt(left_out)
    for part in parts:
        use = min(window, len(part) - 1 + len(part) % 2)
        path[part], slope, _ = _smoothed(slip[part], use)
        interval = np.median(np.diff(time[part]))
        rate[part] = slope / interval
        # Standard error of the slope of a parabola over the window.
        unsure = noise * np.sqrt(12 / use**3)
        turning[part] = np.clip(
            np.sign(slip[part]) * slope / max(2 * unsure, 1e-12), -1, 1
        )
    # Left out, a row misses by its own noise and that of the local parabola. Where few
    # neighbours predict best it is the curve that misses, not noise.
    scatter = noise / np.sqrt(1 + 2.25 / window) if window >= _NOISY else 0.0
    return Sweeps(rate, turning, path, True, scatter)


def _best_window(slip, parts) -> tuple[int, float]:
    """Window with the smallest leave-one-out error, and that mean square."""
    best = (_WINDOWS[0], np.inf)
    for window in _WINDOWS:
        errors = [
            _smoothed(slip[part], window)[2] for part in parts if len(part) > window
        ]
        if not errors:
            break
        error = float(np.mean(np.concatenate(errors) ** 2))
        if error < best[1]:
            best = (window, error)
    return best
