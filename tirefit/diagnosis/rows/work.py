"""The work of sliding that a tire has done so far, and what of it a cooling leaves."""

import numpy as np

from tirefit.data.table import TireData
from tirefit.diagnosis.rows.rates import segments

_COOLINGS = (None, 0.2, 0.05)
"""How long the warmth of sliding lasts, in shares of the record; None is for good."""


def work_of_sliding(power, data: TireData, time, run) -> np.ndarray:
    """Work so far under each cooling: (n, coolings).

    Args:
        power: (n,) force times sliding speed.
        time: (n,); a pause cools, and heats nothing.
    """
    work = np.zeros((data.n, len(_COOLINGS)))
    span = np.ptp(time)
    if span <= 0:
        return work
    parts = segments(time, run)
    heated = np.zeros(data.n)
    for part in parts:
        mean = 0.5 * (power[part][1:] + power[part][:-1])
        heated[part[1:]] = mean * np.diff(time[part])
    order = np.lexsort((time, run))
    step = np.maximum(np.diff(time[order], prepend=time[order][0]), 0.0)
    for column, cooling in enumerate(_COOLINGS):
        keep = np.ones(data.n) if cooling is None else np.exp(-step / (cooling * span))
        warmth = 0.0
        for row, left in zip(order.tolist(), keep.tolist(), strict=True):
            warmth = left * warmth + heated[row]
            work[row, column] = warmth
    return work
