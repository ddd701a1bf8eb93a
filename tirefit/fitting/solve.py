"""Solve a problem: multi-start least squares with its noise settled."""

from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np
from scipy.special import chdtrc

from tirefit.fitting.config import FitConfig
from tirefit.fitting.inference import (
    REACH,
    Linearised,
    Rule,
    best_of,
    covariance,
    linearise,
    solve_starts,
    threshold,
)
from tirefit.fitting.likelihood import noise_factor
from tirefit.fitting.noise import effective_inflation, robust_scale
from tirefit.fitting.predict import row_moments
from tirefit.fitting.problem import FitProblem, starting_points, with_scale

__all__ = ["Solved", "solve_problem"]


_SETTLED = 1e-3
"""Deviance left to gain at which an estimate counts as settled: 3 % of a standard
deviation."""

_ONE_MINIMUM = 1e-5
"""Distance in z below which two estimates are one."""


class Solved(NamedTuple):
    """A problem with its noise settled: estimate, covariance, deviance rules.

    ``at`` holds residuals, slopes and moments of the used rows at the estimate.
    """

    problem: FitProblem
    at: Linearised
    z: np.ndarray
    covariance: np.ndarray
    rules: dict[str, Rule]
    level: float
    converged: bool
    starts: int
    agreeing: int
    ambiguous: bool
    chi2_dof: float | None
    n_effective: float


def _unit_rules(problem: FitProblem) -> dict[str, Rule]:
    """Before the noise is settled: squares as they are."""
    names = (problem.block_of(channel) for channel in problem.channels)
    return {name: Rule(1.0, 1.0, 0.0) for name in dict.fromkeys(names)}


def _solve(problem: FitProblem, starts, rules, solver: str):
    solution = solve_starts(
        problem.model, problem.layout, starts, problem.rows, problem.channels,
        problem.loss, rules, solver,
    )  # fmt: skip
    return jax.tree.map(np.asarray, solution)


def _scale_updates(problem: FitProblem, z) -> dict[str, float]:
    """Factors that bring the estimated noise scales to the residuals' size."""
    estimated = [c.name for c in problem.channels if c.noise_estimated]
    if estimated and problem.rows.nodes:
        factor = noise_factor(
            problem.model, problem.layout, z, problem.rows,
            problem.channels, problem.loss,
        )  # fmt: skip
        return {name: float(factor) for name in estimated}
    mean, _ = row_moments(problem, z)
    factors = {}
    for name in estimated:
        scale = problem.used(problem.rows.scale[name])
        residual = (problem.used(problem.rows.observed[name]) - mean[name]) / scale
        dof = max(problem.n - problem.layout.size / len(problem.channels), 1.0)
        if problem.loss == "squares":
            square = np.sum(residual**2) / dof
        else:
            square = robust_scale(residual) ** 2 * problem.n / dof
        factors[name] = float(np.sqrt(square))
    return factors


def _settle_noise(problem: FitProblem, z, solver: str):
    """Alternate estimates and noise scales until the scales rest."""
    slope = _largest_slope(problem, z) if problem.slip_noise else 0.0
    problem = with_scale(problem, _scale_updates(problem, z), slope)
    estimated = any(c.noise_estimated for c in problem.channels)
    several = len(problem.channels) > 1 or problem.loss != "squares"
    several = several or any(p.prior for p in problem.layout.free)
    rules = _unit_rules(problem)
    if problem.slip_noise:
        rounds = 12 if estimated else 1
    else:
        rounds = 12 if estimated and several else 0
    for _ in range(rounds):
        z = _solve(problem, z[None], rules, "gauss-newton").z[0]
        factors = _scale_updates(problem, z)
        if all(abs(np.log(factor)) < 1e-3 for factor in factors.values()):
            break
        problem = with_scale(problem, factors, slope)
    if rounds:
        z = _solve(problem, z[None], rules, solver).z[0]
    return problem, z


def _largest_slope(problem: FitProblem, z) -> float:
    """Steepest force over slip among the rows, from forces at nearby slips [N]."""
    slip, rows = problem.channels[0].slip, problem.rows
    step = 1e-4 * float(np.ptp(problem.used(getattr(rows.inputs, slip))))
    moved = rows.inputs._replace(**{slip: getattr(rows.inputs, slip) + step})
    before, _ = row_moments(problem, z)
    after, _ = row_moments(replace(problem, rows=rows._replace(inputs=moved)), z)
    names = [c.name for c in problem.channels if c.slip == slip and c.name != "mz"]
    changes = [np.abs(after[name] - before[name]) for name in names or ["mz"]]
    return float(np.max(changes)) / step


def _used(problem: FitProblem, at: Linearised) -> Linearised:
    """Without the padding rows; priors, which are no rows, as they are."""

    def cut(arrays):
        return {
            k: np.asarray(v) if k == "prior" else problem.used(v)
            for k, v in arrays.items()
        }

    return Linearised(*(cut(arrays) for arrays in at))


def _rules(problem: FitProblem, at: Linearised, config: FitConfig):
    """Deviance rules by block, chi2/dof where the noise was given, n_effective."""
    run = problem.used(problem.rows.run)
    rules, ratios, effective_total = {}, [], 0.0
    for name, values in at.values.items():
        if name == "prior":
            continue
        channels = problem.block_channels(name)
        inflation = 1.0
        if config.noise.effective_samples == "estimate":
            scores = values[:, None] * at.slopes[name]
            inflation = effective_inflation(scores, run, problem.time)
        effective = problem.n / inflation
        effective_total += effective
        estimated = any(c.noise_estimated for c in channels)
        if not estimated:
            ratio, surprising = _surprise(problem, at, channels, inflation)
            ratios.append(ratio)
            if surprising:
                inflation *= ratio
        plain = (
            estimated and problem.loss == "squares" and name not in problem.slip_noise
        )
        smallest = float(values @ values) if plain else 0.0
        rules[name] = Rule(inflation, effective, smallest)
    chi2_dof = float(np.mean(ratios)) if ratios else None
    return rules, chi2_dof, effective_total / len(rules)


def _surprise(problem: FitProblem, at: Linearised, channels, inflation: float):
    """chi2/dof of channels whose noise was given, and whether it is too large for it.

    Slip noise counts as noise: the variance of each row is that given its slip.
    """
    chi2 = 0.0
    for channel in channels:
        residual = problem.used(problem.rows.observed[channel.name])
        residual = residual - at.mean[channel.name]
        chi2 += float(np.sum(residual**2 / at.variance[channel.name]))
    dof = max(problem.n * len(channels) - problem.layout.size, 1.0)
    effective = max(dof / inflation, 1.0)
    ratio = chi2 / dof
    return ratio, ratio > 1 and chdtrc(effective, ratio * effective) < 1e-3


def _still_to_gain(at: Linearised, z, cov, rules) -> float:
    """Deviance that one more Gauss-Newton step would gain, bounds aside.

    At a bound the bijection runs to infinity and no solver comes to rest, although
    nothing is left to gain in any other direction.
    """
    free = np.abs(z) < 0.6 * REACH
    gradient = sum(
        at.slopes[name].T @ values / (rules[name].inflation if name in rules else 1.0)
        for name, values in at.values.items()
    )[free]
    information = np.linalg.inv(cov)[np.ix_(free, free)]
    return float(gradient @ np.linalg.solve(information, gradient))


def solve_problem(problem: FitProblem, config: FitConfig) -> Solved:
    """Least squares with the noise settled, and the covariance of z."""
    starts = starting_points(problem, config.starts, config.seed)
    solution = _solve(problem, starts, _unit_rules(problem), config.solver)
    best = best_of(solution)
    z, converged = solution.z[best], bool(solution.converged[best])
    cost = np.where(np.isfinite(solution.cost), solution.cost, np.inf)
    near = cost <= cost[best] * (1 + 1e-6) + 1e-9
    problem, z = _settle_noise(problem, z, config.solver)
    arguments = (
        problem.model, problem.layout, z, problem.rows, problem.channels, problem.loss
    )  # fmt: skip
    at = _used(problem, linearise(*arguments))
    rules, chi2_dof, n_effective = _rules(problem, at, config)
    cov = covariance(*arguments, rules, at)
    converged = bool(np.all(np.isfinite(z))) and (
        converged or _still_to_gain(at, z, cov, rules) < _SETTLED
    )
    # With exact data starts that agree to the solver's tolerance are one minimum.
    far = np.maximum(3 * np.sqrt(np.diag(cov)), _ONE_MINIMUM)
    ambiguous = bool(np.any(np.abs(solution.z[near] - solution.z[best]) > far))
    any_estimated = any(c.noise_estimated for c in problem.channels)
    level = threshold(any_estimated, n_effective, problem.layout.size)
    return Solved(
        problem, at, z, cov, rules, level, converged,
        config.starts, int(near.sum()), ambiguous, chi2_dof,
        n_effective,
    )  # fmt: skip
