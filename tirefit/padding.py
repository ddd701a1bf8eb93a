"""Arrays of few lengths, so that few programs are compiled: :func:`padded_size`."""

import numpy as np


def padded_size(n: int, least: int = 8) -> int:
    """The next of 2^k and 1.5 * 2^k from ``least`` on: at most 50 % padding.

    ``least`` is larger where a program takes long to compile and short to run.
    """
    power = 2 ** int(np.floor(np.log2(max(n, least))))
    return next(size for size in (power, power * 3 // 2, power * 2) if size >= max(n, least))


def pad_rows(array, size: int) -> np.ndarray:
    """The first row again after the last one, up to ``size`` rows: (size, ...).

    A copy of a row that is there is inside every range that a program asks for; the
    caller says by a weight of zero that it does not count.
    """
    array = np.asarray(array)
    return np.concatenate([array, np.repeat(array[:1], size - len(array), axis=0)])
