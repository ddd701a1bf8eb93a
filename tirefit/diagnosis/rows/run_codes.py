"""Which runs of a file are long enough to speak for themselves."""

import numpy as np

_LEAST_ROWS = 20
"""Rows of a run from which it has an offset of its own."""


def shown_runs(run, names) -> list[int]:
    """Codes of the runs that are long enough to have an offset of their own.

    Args:
        run: (n,) codes.
        names: of all runs.
    """
    return [k for k in range(len(names)) if np.sum(run == k) >= _LEAST_ROWS]
