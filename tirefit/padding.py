"""Pad arrays to a few lengths, so that few programs are compiled."""

import numpy as np
from numpy.typing import ArrayLike


def padded_size(n: int, least: int = 8) -> int:
    """The smallest 2^k or 1.5 * 2^k that is at least n and ``least``: at most 50 % padding.

    Use a larger ``least`` for a program that compiles slowly and runs fast.
    """
    power = 2 ** int(np.floor(np.log2(max(n, least))))
    return next(size for size in (power, power * 3 // 2, power * 2) if size >= max(n, least))


def pad_rows(array: ArrayLike, size: int) -> np.ndarray:
    """Append copies of the first row up to ``size`` rows: (size, ...).

    A copy of a valid row is valid everywhere; the caller gives it a weight of zero.
    """
    array = np.asarray(array)
    return np.concatenate([array, np.repeat(array[:1], size - len(array), axis=0)])
