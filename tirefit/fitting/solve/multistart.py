"""Solve a problem: multi-start least squares, with the noise estimated."""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float
from scipy.special import chdtrc

from tirefit.fitting.problem.build import FitTask
from tirefit.fitting.problem.config import FitConfig
from tirefit.fitting.problem.latent_slip import SlipNodes, slips_of_nodes
from tirefit.fitting.problem.likelihood import (
    FitProblem,
    Rule,
    Widened,
    noise_factor,
    slip_weights,
    steepness,
)
from tirefit.fitting.problem.noise import MAD, effective_inflation
from tirefit.fitting.problem.slip_noise import (
    SMOOTH,
    SMOOTH_STEEP,
    SlipDensity,
    slip_density,
    slip_knots,
)
from tirefit.fitting.solve.hints import Misfit, misfit_by_setting
from tirefit.fitting.solve.inference import (
    REACH,
    Linearised,
    best_of,
    covariance,
    deviance_at,
    linearise,
    minima,
    slope_and_curvature,
    threshold,
)
from tirefit.fitting.solve.least_squares import Solver
from tirefit.params import Values

_SETTLED = 1e-3
"""Deviance still to gain below which an estimate has converged: 0.03 standard errors."""

_DOUBLED = 6.0
"""Degrees of freedom whose 95 % quantile of t^2 equals their own number: the interval
then ends where the sum of squares has doubled."""

_SLIP_ROUNDS, _SLIP_STEP = 40, 0.3
"""Steps of a search with noisy slips, and the longest one in z."""
_SETTLED_SLIPS = 1e-4
"""Deviance that the last step could gain: 0.01 standard errors."""
_LARGE = 3.0  # residual of one row in 400
_SLIP_HALVINGS, _MAY_RISE = 6, 0.5
"""Halvings of a step, and the deviance by which it may rise: where slips are judged for the
forces, the density is not that of the lowest deviance. Of 100 files with 5 N and 0.02 rad, one
ended 80 above its lowest deviance without halvings. Elsewhere they end a
search early: the fit of one file then took 70 s, mostly its profiles, instead of 10."""
_STEEP = 12.0
"""Steepness above which the slips are judged for the forces: at 9, intervals from the joint
likelihood held in 23 of 24 files, at 15 in 14 of 16, at 60 in 6 of 12."""

_ONE_MINIMUM = 1e-5  # distance in z below which two estimates are the same


class Solved(NamedTuple):
    """A solved problem: the estimate, its covariance, the estimated noise."""

    problem: FitProblem
    at: Linearised  # residuals, slopes and moments of the used rows at the estimate
    z: np.ndarray
    covariance: np.ndarray
    level: float
    converged: bool
    starts: int
    agreeing: int
    ambiguous: bool
    chi2_dof: float | None
    n_effective: float
    misfit: Misfit = Misfit()

    def residual(self, channel: str) -> np.ndarray:
        """Measured less fitted force of the used rows, (n,)."""
        return self.problem.used(self.problem.rows.observed[channel]) - self.at.mean[channel]


def starting_points(task: FitTask, count: int, seed: int) -> np.ndarray:
    """The first guess and random starts around it, shape (count, p)."""
    layout = task.problem.layout
    first = layout.unconstrained(task.guess)
    generator = np.random.default_rng(seed)
    scatter = generator.normal(size=(count - 1, layout.size))
    # The stiffness guess is good; on its log scale over 11 decades a step of 1 in z
    # would be a factor of 500.
    widths = np.array([0.1 if p.spec.scale == "log" else 1.0 for _, p in layout.elements])
    return np.concatenate([first[None], first + scatter * widths])


def _scaled(problem: FitProblem, factors: Mapping[str, float]) -> dict[str, np.ndarray]:
    """The force noise times factors, by channel; 1 for channels without one."""
    return {k: np.asarray(v) * factors.get(k, 1.0) for k, v in problem.rows.scale.items()}


def with_densities(
    problem: FitProblem,
    factors: Mapping[str, float],
    z: Float[Values, " p"],
    *,
    counted: np.ndarray | None = None,
) -> tuple[FitProblem, dict[str, SlipDensity]]:
    """The problem with scaled force noise, and nodes and density of the true slips; and the
    densities by noisy slip.

    Args:
        factors: of the force noise, by channel; 1 for channels without one.
        z: parameters at which the forces say something of the true slips.
        counted: (n,) bool, rows by which the density of the slips is estimated; None: all.
    """
    rows, nodes, knots, densities = problem.rows, {}, {}, {}
    problem = problem.with_rows(scale=_scaled(problem, factors))
    if not rows.slip_std:
        return problem, {}
    # Near the limit, a search must not change its likelihood with every step.
    before = _judges_slips(problem)
    steep = float(steepness(problem, z)) > (_STEEP / 2 if before else _STEEP)
    measured = np.flatnonzero(np.ones(problem.n, bool) if counted is None else counted)
    for slip, std in rows.slip_std.items():
        # A padding row repeats the first row, so it has nodes as well.
        slips, width = np.asarray(getattr(rows.inputs, slip)), np.asarray(std)
        knots[slip] = slip_knots(slips[measured], width[measured], steep)
        at = slips_of_nodes(slips, width, knots[slip] if steep else None)
        marked = np.ones(()) if steep else None
        nodes[slip] = SlipNodes(*jax.device_put((at, np.ones(at.shape), marked)))
    problem = problem.with_rows(nodes=nodes)
    for slip, weights in slip_weights(problem, z).items():
        at = np.asarray(nodes[slip].slip)
        weights, smooth = np.asarray(weights)[measured], SMOOTH_STEEP if steep else SMOOTH
        densities[slip] = density = slip_density(knots[slip], at[measured], weights, smooth)
        nodes[slip] = nodes[slip]._replace(density=jax.device_put(density.at(at)))
    return problem.with_rows(nodes=nodes), densities


def _judges_slips(problem: FitProblem) -> bool:
    """Whether measured slips are judged for the forces; see :mod:`latent_slip`."""
    return any(laid.of_force is not None for laid in problem.rows.nodes.values())


def _scale_updates(problem: FitProblem, z: Float[Values, " p"]) -> dict[str, float]:
    """Factors by which the residuals differ from the noise scales that are estimated."""
    estimated = [c.name for c in problem.channels if c.noise_estimated]
    if estimated and problem.rows.nodes:
        return dict.fromkeys(estimated, float(noise_factor(problem, z)))
    if not estimated:
        return {}
    # This program is needed at the end of the fit anyway, so no other one is compiled.
    mean = _used(problem, linearise(problem, z)).mean
    factors = {}
    for name in estimated:
        scale = problem.used(problem.rows.scale[name])
        residual = (problem.used(problem.rows.observed[name]) - mean[name]) / scale
        dof = max(problem.n - problem.layout.size / len(problem.channels), 1.0)
        square = np.mean(residual**2)
        if problem.is_huber:
            square = (MAD * np.median(np.abs(residual - np.median(residual)))) ** 2
        factors[name] = float(np.sqrt(square * problem.n / dof))
    return factors


def _settle_noise(task: FitTask, z: np.ndarray, solver: Solver) -> tuple[FitProblem, np.ndarray]:
    """Estimate parameters and noise scales in turn until the scales no longer change."""
    problem = task.problem
    problem = problem.with_rows(scale=_scaled(problem, _scale_updates(problem, z)))
    if problem.slip_noise:
        return _settle_slips(problem, z)
    several = len(problem.channels) > 1 or problem.is_huber
    several = several or any(p.prior for p in problem.layout.free)
    rounds = 12 if problem.noise_estimated and several else 0
    for _ in range(rounds):
        z = np.asarray(minima(problem, z[None]).z[0])
        factors = _scale_updates(problem, z)
        if all(abs(np.log(factor)) < 1e-3 for factor in factors.values()):
            break
        problem = problem.with_rows(scale=_scaled(problem, factors))
    if rounds:
        z = np.asarray(minima(problem, z[None], solver=solver).z[0])
    return problem, z


def _settle_slips(problem: FitProblem, z: np.ndarray) -> tuple[FitProblem, np.ndarray]:
    """The problem and the parameters at the largest likelihood over parameters, density of
    the slips and noise. Each step is Newton's for the profile over the density."""

    def laid(
        problem: FitProblem, factors: Mapping[str, float], z: Values
    ) -> tuple[FitProblem, dict[str, SlipDensity], Linearised]:
        problem, densities = with_densities(problem, factors, z)
        return problem, densities, _used(problem, linearise(problem, z))

    here = laid(problem, {}, z)
    for _ in range(_SLIP_ROUNDS):
        problem, densities, at = here
        slope, information = _profiled(problem, densities, at)
        step = -np.linalg.solve(information, slope)
        gain = -slope @ step
        step = np.clip(step, -_SLIP_STEP, _SLIP_STEP)
        for _ in range(_SLIP_HALVINGS):
            there = np.clip(z + step, -REACH, REACH)
            here = laid(problem, {}, there)
            if not _judges_slips(here[0]):
                break
            if deviance_at(here[0], here[2]) < deviance_at(problem, at) + _MAY_RISE:
                break
            step = step / 2
        z = there
        if factors := _scale_updates(here[0], z):
            here = laid(here[0], factors, z)
        if gain < _SETTLED_SLIPS:
            break
    return here[0], z


def _profiled(
    problem: FitProblem, densities: Mapping[str, SlipDensity], at: Linearised, fixed: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Half the slope (p,) of the deviance, and its curvature (p, p) from the slopes of the
    rows: with the density profiled out where the likelihood depends on it, or fixed."""
    size = problem.layout.size
    slope, information = np.zeros(size), np.eye(size) / REACH**2
    for name, values in at.values.items():
        slopes = np.asarray(at.slopes[name])
        slope += slopes.T @ values
        if name not in densities:
            information += slopes.T @ slopes
            continue
        judged = problem.rows.nodes[name].of_force is not None
        # Squares of large residuals say nothing of the curvature, and make the steps too short.
        scores = -slopes * np.where(judged & (values > _LARGE), 1.0, values)[:, None]
        fixed = fixed or judged
        information += scores.T @ scores if fixed else densities[name].profiled(scores)
    return slope, information


def _widened(problem: FitProblem, z: Float[Values, " p"]) -> FitProblem:
    """The problem whose deviance has the curvature of the profile over the density of the
    slips; see :class:`likelihood.Widened`. A layout per run is left as it is."""
    if not problem.slip_noise or problem.layout.is_sparse:
        return problem
    plain, densities = with_densities(problem, {}, z)
    at = _used(plain, linearise(plain, z))
    profiled, known = (_profiled(plain, densities, at, fixed)[1] for fixed in (False, True))
    values, axes = np.linalg.eigh(known)
    root, inverse = (axes * values**power @ axes.T for power in (0.5, -0.5))
    ratios, turned = np.linalg.eigh(inverse @ profiled @ inverse)
    matrix = inverse @ (turned * np.sqrt(np.clip(ratios, 0.0, 1.0)) @ turned.T) @ root
    return replace(problem, widened=Widened(*jax.device_put((z, matrix))))


def _used(problem: FitProblem, at: Linearised) -> Linearised:
    """The linearisation without padding rows; priors are kept."""

    def cut(arrays: Mapping[str, Values]) -> dict[str, np.ndarray]:
        return {k: np.asarray(v) if k == "prior" else problem.used(v) for k, v in arrays.items()}

    return Linearised(*(cut(arrays) for arrays in at))


def _judged(
    problem: FitProblem, time: np.ndarray | None, at: Linearised, config: FitConfig, misfit: Misfit
) -> tuple[FitProblem, float | None, float]:
    """(the problem with its rules, chi2/dof if the noise was given, n_effective).

    Correlated residuals leave few independent rows. With few degrees of freedom, t can
    widen an interval to the whole range. If the residuals are misfit that depends on
    the settings, the number of independent rows therefore has a lower limit: a force
    that changes by more than the misfit certainly fits worse.
    """
    run = problem.used(problem.rows.run)
    rules, ratios, effective_total = {}, [], 0.0
    for name, values in at.values.items():
        if name == "prior":
            continue
        channels = problem.block_channels(name)
        rows_per_one = 1.0
        if config.noise.effective_samples == "estimate":
            scores = np.asarray(values[:, None] * at.slopes[name])
            rows_per_one = effective_inflation(scores, run, time)
        estimated = any(c.noise_estimated for c in channels)
        if misfit.columns and estimated:
            most = problem.n / (problem.layout.size + _DOUBLED)
            rows_per_one = min(rows_per_one, max(most, misfit.rows_per_one))
        effective = problem.n / rows_per_one
        effective_total += effective
        if not estimated:
            # The variance of a row includes the effect of slip noise.
            observed = {c.name: problem.used(problem.rows.observed[c.name]) for c in channels}
            squares = [(v - at.mean[k]) ** 2 / at.variance[k] for k, v in observed.items()]
            dof = max(problem.n * len(channels) - problem.layout.size, 1.0)
            ratio, independent = float(np.sum(squares)) / dof, max(dof / rows_per_one, 1.0)
            ratios.append(ratio)
            if ratio > 1 and chdtrc(independent, ratio * independent) < 1e-3:
                rows_per_one *= ratio
        plain = estimated and not problem.is_huber and name not in problem.slip_noise
        smallest = float(values @ values) if plain else 0.0
        rules[name] = Rule(rows_per_one, effective, smallest)
    chi2_dof = float(np.mean(ratios)) if ratios else None
    return problem.with_rules(rules), chi2_dof, effective_total / len(rules)


def on_rows(
    whole: FitTask, kept: np.ndarray, task: FitTask, solved: Solved
) -> tuple[FitProblem, Linearised]:
    """All rows of a task with the noise of a fit to some of them, and linearised at it.

    Fitted rows keep the values of the fit, in which a transient model skips the others.

    Args:
        kept: (n,) bool, the rows of ``whole`` that ``task`` has and ``solved`` fitted.
    """
    scales = {}
    for channel in task.problem.channels:
        mine = whole.problem.used(whole.problem.rows.scale[channel.name])[kept]
        fitted = solved.problem.used(solved.problem.rows.scale[channel.name])
        scales[channel.name] = float(np.median(fitted / mine))
    problem = replace(whole.problem, model=solved.problem.model)
    problem, _ = with_densities(problem, scales, solved.z, counted=kept)
    every = _used(problem, linearise(problem, solved.z))

    def joined(all_rows: np.ndarray, fitted: np.ndarray) -> np.ndarray:
        if len(all_rows) != len(kept):
            return fitted  # priors
        rows = np.array(all_rows)
        rows[kept] = fitted
        return rows

    return problem, jax.tree.map(joined, every, solved.at)


def solve_problem(task: FitTask, config: FitConfig) -> Solved:
    """Solve by least squares with the noise estimated; adds the covariance of z."""
    starts = starting_points(task, config.starts, config.seed)
    solution = minima(task.problem, starts, solver=config.solver)
    best = best_of(solution)
    z, converged = np.asarray(solution.z[best]), bool(solution.converged[best])
    cost = np.where(np.isfinite(solution.cost), solution.cost, np.inf)
    near = cost <= cost[best] * (1 + 1e-6) + 1e-9
    problem, z = _settle_noise(task, z, config.solver)
    at = _used(problem, linearise(problem, z))
    misfit = misfit_by_setting(problem, at, task.time)
    problem, chi2_dof, n_effective = _judged(problem, task.time, at, config, misfit)
    problem = _widened(problem, z)
    cov = covariance(problem, z, at)
    if not converged and np.all(np.isfinite(z)):
        # At a bound the bijection goes to infinity and no solver stops, although the other
        # parameters have converged: one more step would gain nothing in them.
        free = np.abs(z) < 0.6 * REACH
        gradient = slope_and_curvature(problem, at)[0][free]
        information = np.linalg.inv(cov)[np.ix_(free, free)]
        converged = bool(gradient @ np.linalg.solve(information, gradient) < _SETTLED)
    converged = converged and bool(np.all(np.isfinite(z)))
    # With exact data, starts that agree to the solver's tolerance found one minimum.
    apart = np.maximum(3 * np.sqrt(np.diag(cov)), _ONE_MINIMUM)
    ambiguous = bool(np.any(np.abs(solution.z[near] - solution.z[best]) > apart))
    level = threshold(problem.noise_estimated, n_effective, problem.layout.size)
    return Solved(
        problem, at, z, cov, level, converged, config.starts, int(near.sum()),
        ambiguous, chi2_dof, n_effective, misfit,
    )  # fmt: skip
