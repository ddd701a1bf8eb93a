"""Change detection on a series of surprises, each detector at a chosen threshold.

A surprise is a normalized innovation: the error of a prediction over its standard
deviation, about Gaussian with variance one without a change. Each function returns
indices of alarms.
"""

from collections.abc import Sequence

import numpy as np

__all__ = ["DETECTORS", "OFFLINE", "adwin", "page_hinkley", "page_test", "pelt"]


def page_test(surprise: Sequence[float], threshold: float, drift: float = 0.5):
    """Page's two-sided cumulative sum, restarted at each alarm, as in tirefit."""
    rise = fall = 0.0
    alarms = []
    for k, z in enumerate(np.clip(surprise, -4.0, 4.0).tolist()):
        rise, fall = max(rise + z - drift, 0.0), max(fall - z - drift, 0.0)
        if rise > threshold or fall > threshold:
            rise = fall = 0.0
            alarms.append(k)
    return alarms


def page_hinkley(surprise: Sequence[float], threshold: float):
    """river's Page-Hinkley; its mean is over all values since the last alarm."""
    from river.drift import PageHinkley

    detector = PageHinkley(min_instances=20, delta=0.25, threshold=threshold, alpha=1.0)
    return _drifts(detector, surprise)


def adwin(surprise: Sequence[float], threshold: float):
    """river's ADWIN; ``threshold`` is its delta: a smaller one gives fewer alarms."""
    from river.drift import ADWIN

    return _drifts(ADWIN(delta=threshold, clock=1), surprise)


def _drifts(detector, surprise):
    alarms = []
    for k, z in enumerate(np.clip(surprise, -4.0, 4.0).tolist()):
        detector.update(z)
        if detector.drift_detected:
            alarms.append(k)
    return alarms


def pelt(surprise: Sequence[float], threshold: float):
    """ruptures' PELT with the l2 cost: it uses the whole log, including future samples.

    An index is the place of the change, not the time of the detection.
    """
    import ruptures

    values = np.clip(np.asarray(surprise, float), -4.0, 4.0)
    if len(values) < 20:
        return []
    search = ruptures.KernelCPD(kernel="linear", min_size=5)
    return search.fit(values[:, None]).predict(pen=threshold)[:-1]


DETECTORS = {
    "page (tirefit)": (page_test, (4, 6, 8, 10, 12, 16, 24)),
    "river Page-Hinkley": (page_hinkley, (4, 6, 8, 12, 16, 24, 40)),
    "river ADWIN": (adwin, (0.2, 0.05, 0.01, 2e-3, 1e-4, 1e-6)),
    "ruptures PELT (offline)": (pelt, (5, 10, 15, 20, 30, 60)),
}
"""Name -> detector and thresholds, in the order of fewer alarms."""
OFFLINE = ("ruptures PELT (offline)",)
"""Detectors that need the whole log."""
