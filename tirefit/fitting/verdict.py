"""What a fit amounts to, in sentences a user can act on."""

from dataclasses import replace

import numpy as np

from tirefit.fitting.result import FitResult
from tirefit.results import Outcome

__all__ = ["disagreements", "judge"]

_POOR_CHI2 = 2.0
_POOR_R2 = 0.8
_STRUCTURE_SIGMAS = 6.0


def disagreements(result: FitResult) -> dict[str, str]:
    """Where the routes to an interval differ, by label.

    An end that differs from the profile's by more than 30 % of its half-width is named.
    """
    found = {}
    for label, (low, high) in result.intervals["profile"].items():
        half = (high - low) / 2
        if not half > 0:
            continue
        for route in ("covariance", "posterior"):
            ends = result.intervals.get(route, {}).get(label)
            if ends is None or None in ends:
                continue
            worst = max(abs(ends[0] - low), abs(ends[1] - high)) / half
            if worst > 0.3:
                text = (
                    f"{route} interval [{ends[0]:.5g}, {ends[1]:.5g}] against the"
                    f" profile's [{low:.5g}, {high:.5g}]"
                )
                found[label] = f"{found[label]}; {text}" if label in found else text
    return found


def _fit_quality(result: FitResult) -> list[str]:
    """Sentences on a model that does not describe the data; none if it does."""
    statistics, found = result.statistics, []
    chi2 = statistics.chi2_dof
    if chi2 is not None and chi2 > _POOR_CHI2:
        found.append(
            f"chi2/dof = {chi2:.3g}: the residuals are {np.sqrt(chi2):.2g} times the"
            " given noise; the intervals are widened by that factor, and still assume"
            " that the model is right"
        )
    # Where the noise is known, a small share may be all that it leaves.
    if chi2 is None and statistics.r2 < _POOR_R2:
        found.append(
            f"the model explains {100 * max(statistics.r2, 0):.0f} % of the variance of"
            f" {result.forces[0]}"
        )
    return found


def _structure(result: FitResult) -> list[str]:
    value, n = result.statistics.slip_structure, result.statistics.n
    if value * np.sqrt(n) > _STRUCTURE_SIGMAS and value > 0.2:
        return [
            f"residuals of neighbouring slips agree (correlation {value:.2f}): the"
            " curve misses systematically there; look at residuals.png"
        ]
    return []


def judge(result: FitResult) -> FitResult:
    """The same fit with its outcomes and its verdict."""
    outcomes, sentences = [], []
    statistics = result.statistics
    if not statistics.converged:
        outcomes.append(Outcome.NOT_CONVERGED)
        sentences.append(Outcome.NOT_CONVERGED.value)
    if result.solved is not None and result.solved.ambiguous:
        outcomes.append(Outcome.STARTS_DISAGREE)
        sentences.append(Outcome.STARTS_DISAGREE.value)
    vague = [label for label, e in result.least_squares.items() if not e.identified]
    if vague:
        outcomes.append(Outcome.NOT_IDENTIFIED)
        for label in vague:
            low, high = result.least_squares[label].ci95
            sentences.append(
                f"{label} is not identified by these data: anything from {low:.4g} to"
                f" {high:.4g} fits as well (95 %)"
            )
    at_bound = [label for label in statistics.at_bound if label not in vague]
    if at_bound:
        outcomes.append(Outcome.AT_BOUND)
        sentences.append(
            f"at its bound: {', '.join(at_bound)}; its interval is one-sided"
        )
    poor = _fit_quality(result)
    if poor:
        outcomes.append(Outcome.POOR_FIT)
        sentences.append(Outcome.POOR_FIT.value)
    sentences += poor + _structure(result) + _speed_limit(result)
    summary = result.posterior
    if summary is not None and summary.outcome is not Outcome.CONVERGED:
        outcomes.append(summary.outcome)
        sentences.append(summary.outcome.value)
    differ = disagreements(result)
    sentences += [
        f"intervals of {label} differ: {text}" for label, text in differ.items()
    ]
    if result.statistics.n_effective < 0.5 * statistics.n:
        sentences.append(
            f"the residuals are autocorrelated: {statistics.n} rows count as"
            f" {statistics.n_effective:.0f} independent ones in every interval"
        )
    status = _status(outcomes)
    verdict = {"status": status, "sentences": sentences, "disagreements": differ}
    return replace(result, outcomes=tuple(outcomes), verdict=verdict)


def _speed_limit(result: FitResult) -> list[str]:
    """S(35) is meaningful only while n max(v_s) < mu_0."""
    n, mu = result.least_squares.get("n"), result.least_squares.get("mu")
    if n is None or mu is None or result.problem is None:
        return []
    inputs, problem = result.problem.rows.inputs, result.problem
    slip = problem.used(inputs.sigma_x)
    fastest = np.max(
        np.abs(problem.used(inputs.v))
        * np.maximum(
            np.abs(slip / (1 + slip)), np.abs(np.tan(problem.used(inputs.alpha)))
        )
    )
    if n.value * fastest < mu.value:
        return []
    return [
        f"n max(v_s) = {n.value * fastest:.3g} is not below mu = {mu.value:.3g}: the"
        " linear friction law has no friction left at the fastest rows; use"
        " an exponential one (h)"
    ]


_STATUS = (
    (Outcome.NOT_CONVERGED, "not converged"),
    (Outcome.POOR_FIT, "poor fit"),
    (Outcome.STARTS_DISAGREE, "not unique"),
    (Outcome.NOT_IDENTIFIED, "not identified"),
    (Outcome.INTERRUPTED, "interrupted"),
    (Outcome.CHAIN_TOO_SHORT, "chain too short"),
    (Outcome.AT_BOUND, "at a bound"),
)


def _status(outcomes) -> str:
    return next((text for outcome, text in _STATUS if outcome in outcomes), "ok")
