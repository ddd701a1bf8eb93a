"""Hints of a fit at a model that would follow what its own leaves over."""

import numpy as np

from tirefit.fitting.noise import autocorrelation_time
from tirefit.fitting.result import FitResult

__all__ = ["hint_at_load"]

_FOLLOWS = {"brush": "brush-load"} | {f"brush-{k}": f"brush-load-{k}" for k in "dmnh"}
"""Model of one stiffness and friction at every load -> the one that follows it."""

_VARIES = 0.2
"""Relative spread of the loads (central 95 %) from which they can show anything."""

_LEAST, _CLEAR = 0.1, 20.0
"""Share of the residuals' variance, and chi-square of two trends at the effective
number of what is left (by chance once in 20,000 fits), that are clear."""


def hint_at_load(result: FitResult) -> list[str]:
    """A sentence where residuals follow the load and the model does not.

    Stiffness that changes with the load leaves a trend at small shares of the friction
    limit, friction one near it: both are the force times the relative load.
    """
    follower = _FOLLOWS.get(result.model)
    if follower is None or result.solved is None:
        return []
    problem = result.solved.problem
    loads = problem.used(problem.rows.inputs.fz)
    low, middle, high = np.percentile(loads, [2.5, 50, 97.5])
    if not high - low > _VARIES * middle:
        return []
    explained = left = effective = 0.0
    for name, mean in result.solved.at.mean.items():
        residual = problem.used(problem.rows.observed[name]) - mean
        share = np.abs(mean) / loads
        trend = mean * (loads / middle - 1)
        columns = np.stack([trend, trend * share / np.max(share)], axis=1)
        rest = residual - columns @ np.linalg.lstsq(columns, residual)[0]
        explained += float(residual @ residual - rest @ rest) / float(np.ptp(mean)) ** 2
        left += float(rest @ rest) / float(np.ptp(mean)) ** 2
        effective += len(rest) / autocorrelation_time([rest])
    whole = explained + left
    clear = effective * explained > _CLEAR * max(left, 1e-300)
    if not (whole > 0 and explained > _LEAST * whole and clear):
        return []
    return [
        f"loads from {low:.4g} to {high:.4g} N, and {100 * explained / whole:.0f} % of"
        f" the residuals' variance follows them: {follower} lets stiffness and friction"
        " change with the load"
    ]
