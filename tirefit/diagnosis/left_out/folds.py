"""Which rows are left out together: one partition of a file for everything that needs
data left out."""

from typing import NamedTuple

import numpy as np

from tirefit.data.levels import levels
from tirefit.diagnosis.rows.prepared import Prepared
from tirefit.diagnosis.rows.slips import shown_runs

LEAST_RUNS = 4
"""Runs from which whole runs are left out: three measured circles, two to one side, do
not tell a slip offset that four logs show at 14 standard errors."""

_BLOCKS = 8
"""Blocks of time, or parts of the slip, that are left out in turn."""

_LEAST_ROWS = 12
"""Rows of a fold, at least."""


class Folds(NamedTuple):
    """``code`` (n,) is the fold of each row, -1 for a row that is never left out;
    ``on`` names the parts for the report; ``across_runs``: they are whole runs."""

    code: np.ndarray
    on: str
    across_runs: bool = False

    @property
    def number(self) -> int:
        return int(self.code.max()) + 1


def folds_of(prepared: Prepared, rows_each: float, across_runs: bool = True) -> Folds:
    """The partition of the used rows: whole runs where there are four or more, else
    blocks of time, else settings and parts of the slip.

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
        return Folds(code, f"{len(runs)} runs left out in turn", True)
    most = int(prepared.n // max(_LEAST_ROWS, 4 * rows_each))
    count = max(min(_BLOCKS, most), 2)
    if prepared.time is not None and not prepared.random_order:
        # By the names of the runs: their codes follow the order of the rows.
        place = np.argsort(np.argsort(prepared.data.runs))
        order = np.lexsort((prepared.time, place[prepared.run]))
        return Folds(
            _in_parts(order, count), f"{count} blocks of time left out in turn"
        )
    return _settings(prepared, count)


def _in_parts(order: np.ndarray, count: int) -> np.ndarray:
    code = np.empty(len(order), int)
    code[order] = np.arange(len(order)) * count // len(order)
    return code


def _settings(prepared: Prepared, count: int) -> Folds:
    """Combinations of load and speed; of a single one, parts of the slip range."""
    loads, speeds = levels(prepared.inputs.fz), levels(prepared.covariates.v)
    code = np.zeros(prepared.n, int)
    for found in (loads, speeds):
        if found.few():
            code = code * len(found.center) + found.code
    _, code = np.unique(code, return_inverse=True)
    sizes = np.bincount(code)
    if len(sizes) > 2 and sizes.min() >= _LEAST_ROWS:
        return Folds(code, f"{len(sizes)} settings of load and speed left out in turn")
    parts = _in_parts(np.argsort(prepared.slip, kind="stable"), 2 * count) % count
    return Folds(parts, f"{count} parts of the slip range left out in turn")
