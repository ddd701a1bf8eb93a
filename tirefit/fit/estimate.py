"""``fit``: least squares, noise, intervals, posterior and verdict of one data set."""

import importlib.metadata
import platform
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import chdtrc, stdtrit

from tirefit.data.table import TireData
from tirefit.fit.config import FitConfig, parse_config
from tirefit.fit.derived import DERIVED, derived_values, reference_point
from tirefit.fit.inference import (
    REACH,
    Profile,
    Rule,
    best_of,
    covariance,
    profile_all,
    row_scores,
    solve_starts,
    threshold,
)
from tirefit.fit.likelihood import CHANNEL_SLIP, noise_factor, root_deviance
from tirefit.fit.noise import effective_inflation, robust_scale
from tirefit.fit.predict import row_moments
from tirefit.fit.problem import FitProblem, build, starting_points, with_scale
from tirefit.fit.result import Estimate, FitResult, FitStatistics
from tirefit.params import constrain
from tirefit.results import UsageError

__all__ = ["Solved", "derived_estimates", "fit", "solve_problem"]


class Solved(NamedTuple):
    """A problem with its noise settled: estimate, covariance, deviance rules."""

    problem: FitProblem
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


def _blocks(problem: FitProblem, z) -> dict[str, np.ndarray]:
    blocks = root_deviance(
        problem.model, problem.layout, jnp.asarray(z), problem.rows,
        problem.channels, problem.loss,
    )  # fmt: skip
    return {name: problem.used(block) for name, block in blocks.items()}


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
            problem.model, problem.layout, jnp.asarray(z), problem.rows,
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
    slope = _largest_slope(problem, z)
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
        z = _solve(problem, jnp.asarray(z)[None], rules, "gauss-newton").z[0]
        factors = _scale_updates(problem, z)
        if all(abs(np.log(factor)) < 1e-3 for factor in factors.values()):
            break
        problem = with_scale(problem, factors, slope)
    if rounds:
        z = _solve(problem, jnp.asarray(z)[None], rules, solver).z[0]
    return problem, z


def _largest_slope(problem: FitProblem, z) -> float:
    """Steepest force over slip of the fitted curve at the largest load [N]."""
    fz = float(np.max(problem.used(problem.rows.inputs.fz)))
    v = float(np.median(problem.used(problem.rows.inputs.v)))
    channel = next((c.name for c in problem.channels if c.name != "mz"), "fy")
    found = derived_values(
        problem.model, problem.layout, jnp.asarray(z)[None], channel,
        CHANNEL_SLIP[channel], fz, v,
    )  # fmt: skip
    return float(abs(found["C_x"][0]))


def _order_in_time(data: TireData, problem: FitProblem):
    time = data.columns.get("time")
    used = None if time is None else time[data.used]
    # Rows outside the slip limits of the fit are not among the problem's.
    return used if used is not None and len(used) == problem.n else None


def _rules(problem: FitProblem, data: TireData, z, config: FitConfig):
    """Deviance rules by block, chi2/dof where the noise was given, n_effective."""
    run = problem.used(problem.rows.run)
    time = _order_in_time(data, problem)
    scores = row_scores(
        problem.model, problem.layout, jnp.asarray(z), problem.rows,
        problem.channels, problem.loss,
    )  # fmt: skip
    blocks = _blocks(problem, z)
    rules, ratios, effective_total = {}, [], 0.0
    for name, block in blocks.items():
        channels = problem.block_channels(name)
        inflation = 1.0
        if config.noise.effective_samples == "estimate":
            inflation = effective_inflation(problem.used(scores[name]), run, time)
        effective = problem.n / inflation
        effective_total += effective
        estimated = any(c.noise_estimated for c in channels)
        if not estimated:
            ratio, surprising = _surprise(problem, z, channels, inflation)
            ratios.append(ratio)
            if surprising:
                inflation *= ratio
        plain = (
            estimated and problem.loss == "squares" and name not in problem.slip_noise
        )
        smallest = float(block @ block) if plain else 0.0
        rules[name] = Rule(inflation, effective, smallest)
    chi2_dof = float(np.mean(ratios)) if ratios else None
    return rules, chi2_dof, effective_total / len(blocks)


def _surprise(problem: FitProblem, z, channels, inflation: float):
    """chi2/dof of channels whose noise was given, and whether it is too large for it.

    Slip noise counts as noise: the variance of each row is that given its slip.
    """
    mean, variance = row_moments(problem, z)
    chi2 = 0.0
    for channel in channels:
        residual = problem.used(problem.rows.observed[channel.name])
        residual = residual - mean[channel.name]
        chi2 += float(np.sum(residual**2 / variance[channel.name]))
    dof = max(problem.n * len(channels) - problem.layout.size, 1.0)
    effective = max(dof / inflation, 1.0)
    ratio = chi2 / dof
    return ratio, ratio > 1 and chdtrc(effective, ratio * effective) < 1e-3


def solve_problem(problem: FitProblem, data: TireData, config: FitConfig) -> Solved:
    """Least squares with the noise settled, and the covariance of z."""
    starts = starting_points(problem, config.starts, config.seed)
    solution = _solve(problem, starts, _unit_rules(problem), config.solver)
    best = best_of(solution)
    z, converged = solution.z[best], bool(solution.converged[best])
    cost = np.where(np.isfinite(solution.cost), solution.cost, np.inf)
    near = cost <= cost[best] * (1 + 1e-6) + 1e-9
    problem, z = _settle_noise(problem, z, config.solver)
    rules, chi2_dof, n_effective = _rules(problem, data, z, config)
    cov = np.asarray(
        covariance(
            problem.model, problem.layout, jnp.asarray(z), problem.rows,
            problem.channels, problem.loss, rules,
        )
    )  # fmt: skip
    spread = np.abs(solution.z[near] - solution.z[best]) / np.sqrt(np.diag(cov))
    any_estimated = any(c.noise_estimated for c in problem.channels)
    level = threshold(any_estimated, n_effective, problem.layout.size)
    return Solved(
        problem, z, cov, rules, level, converged and bool(np.all(np.isfinite(z))),
        config.starts, int(near.sum()), bool(np.any(spread > 3.0)), chi2_dof,
        n_effective,
    )  # fmt: skip


def _not_identified(spec, low: float, high: float, profile: Profile) -> bool:
    """Whether an interval leaves the parameter essentially free.

    It does where it is open on both sides, or open on one and more than half of the
    allowed range wide, or more than 0.8 of the range, or, for a positive quantity,
    a factor of ten (three, for a friction coefficient) from end to end.
    """
    if spec.scale == "log":
        return profile.open_low or profile.open_high or high / low > 10
    share = (high - low) / (spec.upper - spec.lower)
    open_ends = profile.open_low + profile.open_high
    if spec.lower > 0 and high / low > 3:
        return True
    return open_ends == 2 or (open_ends == 1 and share > 0.5) or share > 0.8


def _profile_estimates(solved: Solved, profiles: list[Profile]):
    """Least-squares estimates with profile intervals, and covariance intervals."""
    estimates, by_covariance = {}, {}
    any_estimated = any(c.noise_estimated for c in solved.problem.channels)
    dof = max(solved.n_effective - solved.problem.layout.size, 1.0)
    quantile = float(stdtrit(dof, 0.975)) if any_estimated else 1.959963984540054
    for i, (label, parameter) in enumerate(solved.problem.layout.elements):
        spec, z = parameter.spec, jnp.asarray(solved.z[i])
        value = float(constrain(z, spec))
        slope = float(jax.grad(lambda z, spec=spec: constrain(z, spec))(z))
        std = slope * float(np.sqrt(solved.covariance[i, i]))
        profile = profiles[i]
        low = spec.lower if profile.open_low else float(constrain(profile.low, spec))
        high = spec.upper if profile.open_high else float(constrain(profile.high, spec))
        identified = not _not_identified(spec, low, high, profile)
        at_bound = _at_bound(spec, value)
        estimates[label] = Estimate(
            value, std if identified and not at_bound else None, spec.unit,
            (low, high), identified,
        )  # fmt: skip
        by_covariance[label] = (value - quantile * std, value + quantile * std)
    return estimates, by_covariance


def _at_bound(spec, value: float) -> bool:
    if spec.scale == "log":
        return not spec.lower * 1.01 < value < spec.upper / 1.01
    margin = 1e-3 * (spec.upper - spec.lower)
    return not spec.lower + margin < value < spec.upper - margin


def _statistics(solved: Solved) -> FitStatistics:
    problem = solved.problem
    name = problem.channels[0].name
    mean, _ = row_moments(problem, solved.z)
    observed = problem.used(problem.rows.observed[name])
    residual = observed - mean[name]
    parameters = problem.layout.size + sum(c.noise_estimated for c in problem.channels)
    minus_two_log = _minus_two_log_likelihood(solved)
    effective = solved.n_effective * len(solved.rules)
    correction = 2 * parameters * (parameters + 1) / max(effective - parameters - 1, 1)
    labels = tuple(
        label
        for i, (label, p) in enumerate(problem.layout.elements)
        if _at_bound(p.spec, float(constrain(solved.z[i], p.spec)))
    )
    total = float(np.sum((observed - observed.mean()) ** 2))
    return FitStatistics(
        rmse=float(np.sqrt(np.mean(residual**2))),
        r2=1 - float(residual @ residual) / total if total > 0 else float("nan"),
        chi2_dof=solved.chi2_dof,
        aicc=minus_two_log + 2 * parameters + correction,
        bic=minus_two_log + parameters * float(np.log(max(effective, 1))),
        n=problem.n,
        n_effective=solved.n_effective,
        dof=solved.n_effective - problem.layout.size,
        converged=solved.converged,
        at_bound=labels,
        starts=solved.starts,
        starts_agreeing=solved.agreeing,
        slip_structure=_slip_structure(problem, residual),
    )


def _minus_two_log_likelihood(solved: Solved) -> float:
    """With the effective number of rows, so that models compare fairly on
    autocorrelated residuals."""
    problem, total = solved.problem, 0.0
    for name, block in _blocks(problem, solved.z).items():
        rule = solved.rules[name]
        share = float(rule.effective) / problem.n
        for channel in problem.block_channels(name):
            scale = problem.used(problem.rows.scale[channel.name])
            total += share * float(np.sum(np.log(2 * np.pi * scale**2)))
        total += share * float(block @ block)
    return total


def _slip_structure(problem: FitProblem, residual) -> float:
    """Correlation of the residuals of neighbours in slip: 0 for noise, 1 for a bias.

    The mean over runs-free order of slip of products of neighbours, over the variance.
    """
    slip = problem.used(getattr(problem.rows.inputs, problem.slip_name))
    ordered = residual[np.argsort(slip, kind="stable")]
    ordered = ordered - ordered.mean()
    power = float(ordered @ ordered)
    return float(ordered[1:] @ ordered[:-1]) / power if power > 0 else 0.0


def derived_estimates(solved: Solved, z_draws) -> dict[str, Estimate]:
    """Derived quantities: the estimate's value, spread and interval of the draws."""
    problem = solved.problem
    channel = next((c.name for c in problem.channels if c.name != "mz"), None)
    if channel is None:
        return {}
    at = reference_point(problem)
    z = jnp.concatenate([jnp.asarray(solved.z)[None], jnp.asarray(z_draws)])
    found = derived_values(
        problem.model, problem.layout, z, channel, CHANNEL_SLIP[channel],
        at["fz"], at["v"],
    )  # fmt: skip
    estimates = {}
    for name, values in found.items():
        values = np.asarray(values)
        draws = values[1:]
        defined = np.isfinite(values[0]) and np.mean(np.isfinite(draws)) > 0.975
        if not defined:
            estimates[name] = Estimate(
                float("nan"), None, DERIVED[name][0], (None, None), identified=False
            )
            continue
        low, high = np.nanquantile(draws, [0.025, 0.975])
        unit = DERIVED[name][0]
        std = float(np.nanstd(draws))
        estimates[name] = Estimate(
            float(values[0]), std, unit, (float(low), float(high))
        )
    return estimates


def _gaussian_draws(solved: Solved, seed: int, count: int = 512) -> np.ndarray:
    generator = np.random.default_rng(seed)
    values, vectors = np.linalg.eigh(solved.covariance)
    root = vectors * np.sqrt(np.maximum(values, 0))
    draws = solved.z + generator.normal(size=(count, len(solved.z))) @ root.T
    return np.clip(draws, -REACH, REACH)


def _versions() -> dict[str, str]:
    packages = ("jax", "optimistix", "jaxopt", "emcee", "numpy", "scipy")
    return {"python": platform.python_version()} | {
        name: importlib.metadata.version(name) for name in packages
    }


def _data_record(data: TireData) -> dict[str, Any]:
    source = data.source
    return {
        "file": source.path or data.name,
        "sha256": source.sha256,
        "rows": len(data),
        "used": data.n,
        "masked": [str(problem) for problem in source.masked],
        "runs": list(data.runs),
        "convention": source.convention,
        "slip_definition": source.slip_definition,
        "columns": dict(source.columns),
        "units": dict(source.units),
        "assumptions": list(source.assumptions),
    }


def _noise_record(solved: Solved) -> dict[str, Any]:
    problem = solved.problem
    record: dict[str, Any] = {"loss": problem.loss}
    for channel in problem.channels:
        scale = problem.used(problem.rows.scale[channel.name])
        record[channel.name] = {
            "median_std": float(np.median(scale)),
            "source": "estimated" if channel.noise_estimated else "given",
        }
    for slip, std in problem.slip_noise.items():
        record[slip] = {"median_std": float(np.median(std)), "source": "given"}
    record["inflation"] = {k: float(rule.inflation) for k, rule in solved.rules.items()}
    return record


def _config(config: FitConfig | dict | None, **changes) -> FitConfig:
    if config is None:
        config = FitConfig()
    elif isinstance(config, dict):
        config = parse_config(config)
    given = {key: value for key, value in changes.items() if value is not None}
    return config.model_copy(update=given)


def fit(
    data: TireData,
    model: str | None = None,
    *,
    config: FitConfig | dict | None = None,
    solver: str | None = None,
    seed: int | None = None,
) -> FitResult:
    """Fit a tire model by least squares, with covariance and profile intervals.

    Args:
        data: measured data from ``tirefit.read``.
        model: a name of ``tirefit.MODELS``; ``brush`` if nowhere given.
        config: content of ``fit.toml`` as a dict or a ``FitConfig``.
        solver: ``optimistix`` or ``jaxopt``.
        seed: of the scattered starts and of all sampling.

    Returns:
        the fit; ``sample`` adds the posterior.

    Raises:
        UsageError: unknown model, parameter or option; or 32-bit floats in use.
        DataError: the data lack a column that the model needs, or are too few.
    """
    if not jax.config.jax_enable_x64:
        raise UsageError(
            "a fit needs 64-bit floats: jax.config.update('jax_enable_x64', True)"
            " before the first array, or JAX_ENABLE_X64=1 in the environment"
        )
    config = _config(config, solver=solver, seed=seed, model=model)
    problem = build(data, config.model or "brush", config)
    return _summarise(solve_problem(problem, data, config), data, config)


def _summarise(solved: Solved, data: TireData, config: FitConfig) -> FitResult:
    from tirefit.fit.verdict import judge

    problem = solved.problem
    profiles = profile_all(
        problem.model, problem.layout, solved.z, solved.covariance, problem.rows,
        problem.channels, problem.loss, solved.rules, solved.level,
    )  # fmt: skip
    estimates, by_covariance = _profile_estimates(solved, profiles)
    std = np.sqrt(np.diag(solved.covariance))
    draws = _gaussian_draws(solved, config.seed)
    elements = problem.layout.elements
    result = FitResult(
        model=problem.name,
        forces=tuple(c.name for c in problem.channels),
        parameters=_with_fixed(estimates, problem),
        least_squares=estimates,
        intervals={
            "covariance": by_covariance,
            "profile": {label: value.ci95 for label, value in estimates.items()},
        },
        derived=derived_estimates(solved, draws),
        statistics=_statistics(solved),
        noise=_noise_record(solved) | {"notes": list(problem.notes)},
        verdict={},
        outcomes=(),
        labels=problem.layout.labels,
        correlation=solved.covariance / np.outer(std, std),
        data=_data_record(data),
        reference=reference_point(problem),
        solver=config.solver,
        seed=config.seed,
        version=importlib.metadata.version("tirefit"),
        versions=_versions(),
        z=solved.z,
        covariance=solved.covariance,
        profiles={
            label: {
                "value": np.asarray(constrain(profiles[i].z, parameter.spec)),
                "deviance": profiles[i].deviance,
                "level": np.array(solved.level),
            }
            for i, (label, parameter) in enumerate(elements)
        },
        problem=problem,
        table=data,
    )
    result = replace(result, solved=solved)
    return judge(result)


def _with_fixed(estimates: dict[str, Estimate], problem: FitProblem):
    """Estimates plus the fixed and tied parameters, in the model's order."""
    from tirefit.params import parameter_values, specs

    everything = dict(estimates)
    free = {p.name for p in problem.layout.free}
    ties = {tie.name: tie for tie in problem.layout.ties}
    for name, spec in specs(problem.model).items():
        if name in free:
            continue
        if name in ties and ties[name].other in estimates:
            tie, other = ties[name], estimates[ties[name].other]
            ends = tuple(
                None if end is None else tie.factor * end for end in other.ci95
            )
            everything[name] = Estimate(
                tie.factor * other.value,
                None if other.std is None else abs(tie.factor) * other.std,
                spec.unit, ends, other.identified,
            )  # fmt: skip
        elif name not in ties and (spec.free or name != "half_length"):
            value = float(parameter_values(problem.model)[name])
            everything[name] = Estimate(
                value, None, spec.unit, (None, None), fixed=True
            )
    return everything
