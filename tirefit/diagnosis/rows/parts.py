"""The parts of a file that are left out in turn."""

import numpy as np

from tirefit.data.levels import levels
from tirefit.diagnosis.engine.fit import Folds
from tirefit.diagnosis.rows.prepared import Prepared
from tirefit.diagnosis.rows.slips import shown_runs

LEAST_RUNS = 4
"""Smallest number of runs for leaving out whole runs: three measured circles, two to one
side, do not show a slip offset that four logs show at 14 standard errors."""

_BLOCKS, _LEAST_ROWS = 8, 12
"""Largest number of blocks of time or parts of the slip; smallest number of rows of a fold."""


def folds_of(prepared: Prepared, rows_each: float, across_runs: bool = True) -> Folds:
    """The partition of the used rows: whole runs if there are four or more, else blocks of
    time, else settings and parts of the slip.

    Args:
        rows_each: rows per independent row of the noise; a block of time holds several
            times as many.
        across_runs: whether runs may be left out; an effect that belongs to one run
            cannot be predicted from the others.
    """
    runs = shown_runs(prepared.run, prepared.data.runs)
    if across_runs and len(runs) >= LEAST_RUNS:
        code = np.full(prepared.n, -1)
        for number, run in enumerate(runs):
            code[prepared.run == run] = number
        return Folds(code, f"{len(runs)} runs left out in turn")
    most = int(prepared.n // max(_LEAST_ROWS, 4 * rows_each))
    count = max(min(_BLOCKS, most), 2)
    if prepared.time is not None and np.ptp(prepared.time) and not prepared.random_order:
        # Order runs by name, as their codes follow the order of the rows.
        place = np.argsort(np.argsort(prepared.data.runs))
        code = _in_parts(np.lexsort((prepared.time, place[prepared.run])), count)
        return Folds(code, f"{count} blocks of time left out in turn")
    settings = [levels(prepared.inputs.fz), levels(prepared.covariates.v)]
    each = [found.code for found in settings if found.few()]
    if each:
        _, code, sizes = np.unique(each, axis=1, return_inverse=True, return_counts=True)
        if len(sizes) > 2 and sizes.min() >= _LEAST_ROWS:
            on = f"{len(sizes)} settings of load and speed left out in turn"
            return Folds(code, on)
    parts = _in_parts(np.argsort(prepared.slip, kind="stable"), 2 * count) % count
    return Folds(parts, f"{count} parts of the slip range left out in turn")


def _in_parts(order: np.ndarray, count: int) -> np.ndarray:
    code = np.empty(len(order), int)
    code[order] = np.arange(len(order)) * count // len(order)
    return code
