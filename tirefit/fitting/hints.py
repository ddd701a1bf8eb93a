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

    A parameter that changes with the load leaves residuals like its own slope times
    the relative load.
    """
    follower = _FOLLOWS.get(result.model)
    if follower is None or result.solved is None:
        return []
    problem, at = result.solved.problem, result.solved.at
    loads = problem.used(problem.rows.inputs.fz)
    low, middle, high = np.percentile(loads, [2.5, 50, 97.5])
    if not high - low > _VARIES * middle:
        return []
    explained = left = effective = 0.0
    for name in at.mean:
        if name not in at.values or len(at.values[name]) != len(loads):
            return []  # noise of the slip shares rows among blocks
        residual, slopes = np.asarray(at.values[name]), np.asarray(at.slopes[name])
        relative = (loads / middle - 1)[:, None]
        without = _remainder(residual, slopes)
        rest = _remainder(residual, np.hstack([slopes, slopes * relative]))
        explained += float(without @ without - rest @ rest)
        left += float(rest @ rest)
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


def _remainder(values, columns):
    """What the columns (n, k) leave of the values (n,)."""
    return values - columns @ np.linalg.lstsq(columns, values)[0]
