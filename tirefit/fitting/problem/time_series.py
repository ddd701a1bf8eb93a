"""Checks for transient models, which need rows that form a time series."""

from collections.abc import Iterable

import numpy as np

from tirefit.data.table import TireData
from tirefit.fitting.problem.config import FitConfig
from tirefit.results import DataError, InputProblem, UsageError


def check_time_series(data: TireData, name: str) -> None:
    """Raises DataError unless the used rows of each run are contiguous, with rising time.

    Args:
        data: with a time column.
        name: name of the transient model, for the message.
    """
    rows = np.flatnonzero(data.used)
    run, time = data.run[rows], data["time"][rows]
    file, column = data.file, data.source.columns.get("time")
    same = run[1:] == run[:-1]
    # Each run begins only once, after the end of the previous run.
    first = np.unique(run, return_index=True)[1]
    again = ~same & ~np.isin(np.arange(1, len(run)), first)
    problems = []
    for wrong, reason in (
        (again, "the rows of run {run!r} are not contiguous"),
        (same & ~(np.diff(time) > 0), "time {time:g} s is not after {before:g} s"),
    ):
        if not wrong.any():
            continue
        at = int(np.argmax(wrong)) + 1
        text = reason.format(run=data.runs[run[at]], time=time[at], before=time[at - 1])
        several, lines = int(wrong.sum()), data.source.line
        line = None if lines is None else int(lines[rows[at]])
        more = f" ({several} such rows)" if several > 1 else ""
        problems.append(
            InputProblem(
                f"{text}{more}; {name} follows the slip through time",
                "sort the rows by run and time, and name the runs in a column run",
                file,
                line,
                column or "time",
            )
        )
    DataError.raise_for(problems)


def check_whole_series(data: TireData, name: str, slips: Iterable[str], config: FitConfig) -> None:
    """Raises UsageError if settings or columns hide part of the slip's history.

    Args:
        data: the measured data.
        name: name of the transient model.
        slips: slips of the fitted forces.
        config: limits and noise of the slip.
    """
    problems = []
    for key in ("slip_min", "slip_max"):
        if getattr(config.data, key) is not None:
            reason = f"data.{key} excludes rows that still affect later rows of {name}"
            remedy = f"remove {key}, or fit the steady model"
            problems.append(InputProblem(reason, remedy, config.source))
    remedy = "fit the steady model, or remove the noise of the slip"
    for slip in slips:
        reason = f"{name} follows the slip through time, which must have no noise"
        if getattr(config.noise, slip) is not None:
            reason = f"noise.{slip}: {reason}"
            problems.append(InputProblem(reason, remedy, config.source))
        elif f"{slip}_std" in data:
            file = data.file
            column = data.source.columns.get(f"{slip}_std", f"{slip}_std")
            problems.append(InputProblem(reason, remedy, file, column=column))
    UsageError.raise_for(problems)
