"""The check for transient models, which need rows that form a time series."""

import numpy as np

from tirefit.data.far import problem_at
from tirefit.data.table import TireData
from tirefit.results import DataError


def check_time_series(data: TireData, name: str) -> None:
    """Raises DataError unless the used rows of each run are contiguous, with rising time.

    Args:
        data: with a time column.
        name: name of the transient model, for the message.
    """
    rows = np.flatnonzero(data.used)
    run, time = data.run[rows], data["time"][rows]
    same = run[1:] == run[:-1]
    # Each run begins only once, after the end of the previous run.
    again = ~same & ~np.isin(np.arange(1, len(run)), np.unique(run, return_index=True)[1])
    problems = []
    for wrong, reason in (
        (again, "the rows of run {run!r} are not contiguous"),
        (same & ~(np.diff(time) > 0), "time {time:g} s is not after {before:g} s"),
    ):
        if not wrong.any():
            continue
        at = int(np.argmax(wrong)) + 1
        text = reason.format(run=data.runs[run[at]], time=time[at], before=time[at - 1])
        more = f" ({wrong.sum()} such rows)" if wrong.sum() > 1 else ""
        text += f"{more}; {name} follows the slip through time"
        remedy = "sort the rows by run and time, and name the runs in a column run"
        problems.append(problem_at(data, int(rows[at]), "time", text, remedy))
    DataError.raise_for(problems)
