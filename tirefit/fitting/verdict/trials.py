"""Models with an effect that the residuals of a fit show, tried on the rows of the fit.

A model is advised only if it was fitted to these rows, stops at no bound, and has a lower AICc.
"""

import numpy as np

from tirefit.fitting.problem.build import FitTask
from tirefit.fitting.problem.config import FitConfig
from tirefit.fitting.result import FitResult, Trial, information
from tirefit.fitting.solve.multistart import Solved
from tirefit.fitting.uncertainty.identified import at_bound, minus_two_log_likelihood
from tirefit.fitting.verdict.family import solved_as
from tirefit.fitting.verdict.judge import exactness, models_with
from tirefit.models import MODELS
from tirefit.params import constrain


def tried(result: FitResult, task: FitTask, config: FitConfig) -> tuple[Trial, ...]:
    """Trials of the models that depend on a column which the residuals follow."""
    trials = []
    columns = () if exactness(result) else result.solved.misfit.columns
    pairs = [(c.column, name) for c in columns for name in models_with(task.name, c.column)]
    for column, name in pairs:
        other = solved_as(name, task, config) if name in MODELS else None
        if other is None:
            continue
        z, elements = np.asarray(other.z), other.problem.layout.elements
        stops = [
            k for i, (k, p) in enumerate(elements) if at_bound(p.spec, constrain(z[i], p.spec))
        ]
        before, after = _criteria(result.solved, other)
        against = f"{stops[0]} stops at its bound" if stops else "its AICc is no lower"
        is_better = after < before and not stops
        trials.append(Trial(column, name, "" if is_better else against, (before, after)))
    return tuple(trials)


def _criteria(*models: Solved) -> tuple[float, ...]:
    """AICc of each model, at the number of independent rows of the most likely one."""
    fits = [minus_two_log_likelihood(model) for model in models]
    effective = models[int(np.argmin(fits))].n_effective
    unknowns = [
        m.problem.layout.size + sum(c.noise_estimated for c in m.problem.channels) for m in models
    ]
    rows = models[0].problem.n * len(models[0].problem.channels)
    return tuple(
        information(fit, rows, effective, k)[0] for fit, k in zip(fits, unknowns, strict=True)
    )
