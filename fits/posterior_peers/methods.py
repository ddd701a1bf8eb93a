"""All methods on B data sets: their 95 % intervals (B, p, 2)."""

import numpy as np

from fits import formulas
from fits.posterior_peers.cases import NOISE, Case, synthetic
from tirefit.fitting.estimate import fit
from tirefit.fitting.result import FitResult
from tirefit.fitting.uncertainty.posterior import sample
from tirefit.results import Outcome

__all__ = ["CHAINS", "METHODS", "fits_of", "intervals_of"]

CHAINS = ("emcee",)
WALKERS = {"emcee": 16, "importance": 16}
"""Walkers of an ensemble (importance sampling may switch to emcee): fewer than the default
of a fit, to save time."""

MOST_STEPS = 1000
"""Steps of a chain; a chain that is still too short is used and counted."""

METHODS = ("profile", "covariance", "lmfit", "mean-field", "full-rank", "importance", "emcee")
"""The slow methods are last, so that the other results can be read earlier."""


def fits_of(case: Case, seeds) -> list[FitResult]:
    """The fits from which every sampler starts, with given noise."""
    noise = {"fx_relative": NOISE, "loss": "squares"}
    config = {"noise": noise, "solver": "gauss-newton"}
    return [fit(synthetic(case, k), case.model, config=config, seed=k) for k in seeds]


def intervals_of(method: str, case: Case, results: list[FitResult], steps=None):
    """Intervals (B, p, 2) and a note on each data set, (B,) texts."""
    if method in ("mean-field", "full-rank"):
        # Imported here, because the other methods run without NumPyro.
        from fits.posterior_peers.variational import vary

        intervals, elbo = vary(results, method, steps)
        return intervals, [f"{value:.4f}" for value in elbo]
    empty = [""] * len(results)
    if method == "lmfit":
        return np.array([_lmfit(case, result) for result in results]), empty
    intervals, notes = [], []
    for result in results:
        name = method
        if method not in result.intervals:
            result, word = _sampled(method, result)
            name = "posterior"
            notes.append(word)
        ends = result.intervals[name]
        intervals.append([ends[label] for label in result.labels])
    return np.array(intervals, float), notes or empty


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
    """Value +- 1.96 stderr (p, 2) of lmfit with the model written in NumPy."""
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
