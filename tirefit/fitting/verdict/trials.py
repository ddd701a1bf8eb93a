"""Models with an effect that the residuals of a fit show, tried on the rows of the fit.

A model is advised only if it was fitted to these rows, identifies all its parameters, and
predicts rows that were left out better than the model of the fit does. Blocks of
consecutive rows are left out, as neighbours have correlated residuals.
"""

import re
from collections.abc import Iterable

import numpy as np
from scipy.special import stdtrit

from tirefit.fitting.problem.build import FitTask
from tirefit.fitting.problem.config import FitConfig
from tirefit.fitting.problem.likelihood import row_moments
from tirefit.fitting.result import Trial
from tirefit.fitting.solve.inference import minima
from tirefit.fitting.solve.multistart import Solved
from tirefit.fitting.uncertainty.identified import at_bound
from tirefit.fitting.verdict.family import estimates_of, solved_as
from tirefit.models import MODELS
from tirefit.params import specs

_BLOCKS = 8
"""Blocks of consecutive rows that are left out in turn."""

_SURE = 0.95
"""One-sided probability of Student's t, of the gain of the blocks, above which a model
predicts better: of 20 models without a gain one is advised."""


SLIDING = "v_s"
"""``column`` of a trial for a linear friction law that has no friction at the fastest rows: the
sliding speed, which is no column of the file."""


def candidates(name: str, column: str) -> list[str]:
    """Names of models like ``name`` whose force also depends on a column.

    There are few, as the first fit of a model takes 3 s of processor time. For the speed, friction
    changes with the sliding speed: linearly, and with its logarithm.
    """
    if column == "fz":
        names = [name.replace("brush", "brush-load", 1)]
    elif column == "v":
        names = [f"{name}-n", f"{name}n", f"{name}-ln"]
    else:
        names = [re.sub(r"n(s?)$", r"h\1", name)] if column == SLIDING else []
    return [like for like in names if like in MODELS and like != name]


def tried(
    columns: Iterable[str], task: FitTask, solved: Solved, config: FitConfig
) -> tuple[Trial, ...]:
    """Trials of the models that depend on one of these columns."""
    pairs = [(column, name) for column in columns for name in candidates(task.name, column)]
    trials = (_tried(name, column, task, solved, config) for column, name in pairs)
    return tuple(trial for trial in trials if trial)


def _tried(
    name: str, column: str, task: FitTask, solved: Solved, config: FitConfig
) -> Trial | None:
    other = solved_as(name, task, config)
    if other is None:
        return None
    known, estimates = specs(MODELS[name]), estimates_of(other)[1]
    for label, estimate in estimates.items():
        if at_bound(known[label.partition("[")[0]], estimate.value):
            return Trial(column, name, f"{label} stops at its bound")
        if not estimate.identified:
            return Trial(column, name, f"{label} is not identified")
    before, after = (errors_left_out(each, task) for each in (solved, other))
    forces = list(before)
    scales = {k: np.median(solved.problem.used(solved.problem.rows.scale[k])) for k in forces}
    gains = sum((before[k] ** 2 - after[k] ** 2) / scales[k] ** 2 for k in forces)
    sums = np.array([np.sum(gains[block]) for block in _blocks(task)])
    error = np.std(sums, ddof=1) * np.sqrt(len(sums))
    rms = tuple(float(np.sqrt(np.mean(each[forces[0]] ** 2))) for each in (before, after))
    if not np.sum(sums) > stdtrit(len(sums) - 1, _SURE) * error:
        return Trial(column, name, "it predicts rows left out no better", rms)
    return Trial(column, name, "", rms)


def _blocks(task: FitTask) -> list[np.ndarray]:
    """Rows of each block, consecutive in time, or in the file if there is no time."""
    problem = task.problem
    run = problem.used(problem.rows.run)
    order = np.arange(problem.n) if task.time is None else np.lexsort((task.time, run))
    return np.array_split(order, min(_BLOCKS, problem.n))


def errors_left_out(solved: Solved, task: FitTask) -> dict[str, np.ndarray]:
    """Error (n,) of each force [N, N m] in each block, predicted by a fit to the other blocks."""
    problem = solved.problem
    errors = {channel.name: np.zeros(problem.n) for channel in problem.channels}
    for block in _blocks(task):
        weight = np.array(problem.rows.weight)
        weight[block] = 0.0
        z = minima(problem.with_rows(weight=weight), solved.z[None]).z[0]
        mean, _ = row_moments(problem, z)
        for name, error in errors.items():
            error[block] = (problem.used(problem.rows.observed[name]) - mean[name])[block]
    return errors
