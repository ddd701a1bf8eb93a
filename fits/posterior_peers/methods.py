"""Every method on one data set or many: its 95 % intervals (B, p, 2)."""

import numpy as np

from fits import formulas
from fits.posterior_peers.cases import NOISE, Case, synthetic
from tirefit.fitting.estimate import fit
from tirefit.fitting.posterior import sample
from tirefit.fitting.result import FitResult
from tirefit.results import Outcome

__all__ = ["CHAINS", "METHODS", "fits_of", "intervals_of"]

CHAINS = ("emcee", "nuts")
WALKERS = {"emcee": 16, "nuts": 8, "importance": 16}
"""Of an ensemble (importance sampling hands over to emcee): fewer than a fit takes by
itself, for the time it takes."""

MOST_STEPS = 1000
"""Of a chain; one that is too short by then is used as it is, and counted."""

METHODS = (
    "profile",
    "covariance",
    "lmfit",
    "mean-field",
    "full-rank",
    "importance",
    "emcee",
    "nuts",
)
"""The slow ones last: what is there can be read before they are done."""


def fits_of(case: Case, seeds) -> list[FitResult]:
    """The fits that every sampler begins with, noise given."""
    noise = {"fx_relative": NOISE, "loss": "squares"}
    config = {"noise": noise, "solver": "gauss-newton"}
    return [fit(synthetic(case, k), case.model, config=config, seed=k) for k in seeds]


def intervals_of(method: str, case: Case, results: list[FitResult], steps=None):
    """Intervals (B, p, 2) and what is to be said of each data set, (B,) texts."""
    if method in ("mean-field", "full-rank"):
        # NumPyro is a peer: the rest runs without it.
        from fits.posterior_peers.variational import vary

        intervals, elbo = vary(results, method, steps)
        return intervals, [f"{value:.4f}" for value in elbo]
    nothing = [""] * len(results)
    if method == "lmfit":
        return np.array([_lmfit(case, result) for result in results]), nothing
    intervals, said = [], []
    for result in results:
        name = method
        if method not in result.intervals:
            result, word = _sampled(method, result)
            name = "posterior"
            said.append(word)
        ends = result.intervals[name]
        intervals.append([ends[label] for label in result.labels])
    return np.array(intervals, float), said or nothing


def _sampled(method: str, result: FitResult) -> tuple[FitResult, str]:
    drawn = sample(
        result,
        sampler=method,
        effective_samples=2000,
        max_steps=MOST_STEPS,
        walkers=WALKERS[method],
    )
    summary = drawn.posterior
    word = "" if summary.sampler == method else f"by {summary.sampler}"
    if summary.outcome is not Outcome.CONVERGED:
        word += " too short"
    return drawn, word.strip()


def _lmfit(case: Case, result: FitResult) -> np.ndarray:
    """Value +- 1.96 stderr (p, 2) of lmfit with the model written by hand in NumPy."""
    import lmfit

    data = result.table.columns

    def force(sigma, fz, **values):
        if case.model == "brush":
            return formulas.brush(sigma, fz, 0.0, values["cpa2"], values["mu"])
        return formulas.magic_formula(sigma / (1 + sigma), fz, **values)

    def residual(parameters):
        values = parameters.valuesdict()
        model = force(data["sigma_x"], data["fz"], **values)
        return (data["fx"] - model) / (NOISE * data["fz"])

    parameters = lmfit.Parameters()
    for one in result.problem.layout.free:
        start = result.least_squares[one.name].value
        parameters.add(one.name, start, min=one.spec.lower, max=one.spec.upper)
    found = lmfit.minimize(residual, parameters, scale_covar=False).params
    ends = [
        found[k].value + z * (found[k].stderr or np.nan)
        for k in result.labels
        for z in (-1.959964, 1.959964)
    ]
    return np.reshape(ends, (-1, 2))
