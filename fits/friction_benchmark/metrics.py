"""Scores an estimate against a known truth, for any estimator, with NumPy alone.

All times are in seconds. Only rows that the estimator supports (``supported``) count;
their share is a score as well.
"""

from typing import NamedTuple

import numpy as np

__all__ = [
    "SETTLE",
    "WINDOW",
    "Accuracy",
    "Detection",
    "Trace",
    "accuracy",
    "crossings",
    "detection",
]

SETTLE = 10.0
"""Seconds at the start of a log that are not scored for accuracy; alarms there count."""
WINDOW = 10.0
"""Seconds after a drop within which an alarm is a detection: five saw-teeth."""
_QUANTILE = 1.959964


class Trace(NamedTuple):
    """The output of an estimator for a log, row by row (n,).

    ``mu`` and its standard deviation ``mu_std`` [-], NaN for none; ``supported``:
    whether the estimator supports it (bool); ``alarm``: whether it raised one (bool).
    """

    time: np.ndarray
    mu: np.ndarray
    mu_std: np.ndarray
    supported: np.ndarray
    alarm: np.ndarray


class Accuracy(NamedTuple):
    """Mean and standard deviation of the error [-], share of the rows whose stated 95 %
    interval contains the truth, share of the rows that the estimator supports."""

    bias: float
    std: float
    covered: float
    supported: float


class Detection(NamedTuple):
    """``delay`` [s] from a drop to its alarm, NaN if missed or without a drop; the number of
    ``false`` alarms in ``seconds`` of driving outside the window after a drop."""

    delay: float
    false: int
    seconds: float


def accuracy(trace: Trace, truth, begin=SETTLE, end=np.inf) -> Accuracy:
    """The error of an estimate from ``begin`` to ``end``.

    Args:
        trace: of n rows.
        truth: the friction (n,) [-], or one number.
    """
    asked = (trace.time >= begin) & (trace.time <= end)
    kept = asked & trace.supported & np.isfinite(trace.mu)
    if not asked.any() or not kept.any():
        return Accuracy(np.nan, np.nan, np.nan, 0.0)
    error = (trace.mu - truth)[kept]
    covered = np.abs(error) <= _QUANTILE * trace.mu_std[kept]
    share = np.count_nonzero(kept) / np.count_nonzero(asked)
    return Accuracy(error.mean(), error.std(), covered.mean(), share)


def detection(alarms, drop: float, duration: float, window=WINDOW) -> Detection:
    """Alarms against the one drop of a log, or none.

    Args:
        alarms: times (k,) of alarms.
        drop: time of the drop, NaN for none.
        duration: of the log, which starts at 0.
        window: time after a drop in which alarms belong to it; the first is the
            detection, the others do not count.
    """
    alarms = np.sort(np.asarray(alarms, float))
    if np.isnan(drop):
        return Detection(np.nan, len(alarms), duration)
    belongs = (alarms >= drop) & (alarms <= drop + window)
    delay = alarms[belongs][0] - drop if belongs.any() else np.nan
    left = duration - (min(drop + window, duration) - drop)
    return Detection(float(delay), int(np.count_nonzero(~belongs)), left)


def crossings(trace: Trace, level: float) -> np.ndarray:
    """Times at which the supported estimate falls below a level.

    This is the simplest use of an estimate: a warning below the level. Rows that are not
    supported are skipped; a first estimate below the level counts.
    """
    kept = trace.supported & np.isfinite(trace.mu)
    below = trace.mu[kept] < level
    fell = below & ~np.r_[False, below[:-1]]
    return trace.time[kept][fell]
