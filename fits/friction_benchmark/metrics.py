"""How good an estimate is against a known truth: NumPy alone, whoever estimated.

All times in seconds. An estimate counts where its estimator stands by it
(``supported``); how often it does is a number of the table too.
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
"""Seconds at the start of a log that are not scored for accuracy; alarms are."""
WINDOW = 10.0
"""Seconds after a drop within which a detection is one: five saw-teeth."""
_QUANTILE = 1.959964


class Trace(NamedTuple):
    """What an estimator said of a log, row by row (n,).

    ``mu`` and its standard deviation ``mu_std`` [-], NaN for none; ``supported``:
    whether the estimator stands by it (bool); ``alarm``: whether it raised one (bool).
    """

    time: np.ndarray
    mu: np.ndarray
    mu_std: np.ndarray
    supported: np.ndarray
    alarm: np.ndarray


class Accuracy(NamedTuple):
    """Mean and standard deviation of the error [-], share of the rows whose stated 95 %
    interval holds the truth, share of the rows that the estimator stands by."""

    bias: float
    std: float
    covered: float
    supported: float


class Detection(NamedTuple):
    """``delay`` [s] from a drop to its alarm, NaN where it was missed or none came;
    ``false`` alarms within ``seconds`` of driving in which each would be one."""

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
        drop: time of the drop, NaN where there is none.
        duration: of the log, which starts at 0.
        window: after a drop in which alarms belong to it; the first is the detection,
            the others are neither that nor false.
    """
    alarms = np.sort(np.asarray(alarms, float))
    if np.isnan(drop):
        return Detection(np.nan, len(alarms), duration)
    belongs = (alarms >= drop) & (alarms <= drop + window)
    delay = alarms[belongs][0] - drop if belongs.any() else np.nan
    left = duration - (min(drop + window, duration) - drop)
    return Detection(float(delay), int(np.count_nonzero(~belongs)), left)


def crossings(trace: Trace, level: float) -> np.ndarray:
    """Times at which the supported estimate comes down through a level.

    The simplest use of an estimate: warn when it says less than the level. Rows that
    are not supported are passed over; a first estimate below the level counts.
    """
    kept = trace.supported & np.isfinite(trace.mu)
    below = trace.mu[kept] < level
    fell = below & ~np.r_[False, below[:-1]]
    return trace.time[kept][fell]
