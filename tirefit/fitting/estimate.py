"""``fit``: least squares, noise, intervals, posterior and verdict of one data set."""

import importlib.metadata
import platform
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from tirefit.compiled import release_programs
from tirefit.data.accept import DataLike, as_data
from tirefit.data.table import TireData
from tirefit.fitting.problem.config import FitConfig, parse_config
from tirefit.fitting.problem.likelihood import FitProblem
from tirefit.fitting.problem.noise import noise_by_row
from tirefit.fitting.result import Estimate, FitResult, FitStatistics, Verdict, information
from tirefit.fitting.solve.far_rows import FarRow, Settled, settle
from tirefit.fitting.solve.least_squares import Solver, solver_name
from tirefit.fitting.solve.multistart import Solved
from tirefit.fitting.uncertainty.derived import derived_from_profile, reference_points
from tirefit.fitting.uncertainty.identified import (
    labels_at_bound,
    minus_two_log_likelihood,
    profile_estimates,
)
from tirefit.fitting.uncertainty.profile import profile_all
from tirefit.fitting.verdict.family import peak_ranges, tried
from tirefit.fitting.verdict.judge import is_noise, judge
from tirefit.models import TireInputs
from tirefit.params import constrain, parameter_values, specs
from tirefit.precision import require_x64


def _statistics(solved: Solved) -> FitStatistics:
    problem = solved.problem
    name = problem.channels[0].name
    observed, residual = problem.used(problem.rows.observed[name]), solved.residual(name)
    minus_two_log = minus_two_log_likelihood(solved)
    rows = problem.n * len(problem.channels)
    aicc, bic = information(minus_two_log, rows, solved.n_effective, problem.unknowns)
    total = float(np.sum((observed - observed.mean()) ** 2))
    return FitStatistics(
        rmse=float(np.sqrt(np.mean(residual**2))),
        r2=1 - float(residual @ residual) / total if total > 0 else float("nan"),
        chi2_dof=solved.chi2_dof,
        aicc=aicc,
        bic=bic,
        minus_two_log_likelihood=minus_two_log,
        unknowns=problem.unknowns,
        n=problem.n,
        n_effective=solved.n_effective,
        dof=solved.n_effective - problem.layout.size,
        converged=solved.converged,
        at_bound=labels_at_bound(solved),
        starts=solved.starts,
        starts_agreeing=solved.agreeing,
        slip_structure=_slip_structure(problem, residual),
    )


def _slip_structure(problem: FitProblem, residual: np.ndarray) -> float:
    """Correlation of the residuals of neighbours in slip: 0 for noise, 1 for a bias.

    It is the larger one of two orders: by slip, and by slip within run and load.
    """
    inputs = problem.rows.inputs
    slip = problem.used(getattr(inputs, problem.slip_name))
    run, load = problem.used(problem.rows.run), problem.used(inputs.fz)
    # Neighbours within a run and a load: otherwise a misfit that alternates between
    # conditions would resemble noise.
    residual = residual - residual.mean()
    power = float(residual @ residual)
    orders = np.argsort(slip, kind="stable"), np.lexsort((slip, np.round(np.log(load) / 0.1), run))
    ordered = [residual[order] for order in orders]
    return max(float(part[1:] @ part[:-1]) / power if power > 0 else 0.0 for part in ordered)


_PACKAGES = ("jax", "optimistix", "jaxopt", "emcee", "numpy", "scipy")
"""Packages whose versions a result states."""


def data_record(data: TireData, used: int, outliers: tuple[FarRow, ...]) -> dict[str, Any]:
    """Content of ``fit.json`` on the rows: number used, and the outliers."""
    source = data.source
    return {
        "file": data.file,
        "sha256": source.sha256,
        "rows": len(data),
        "used": used,
        "set_aside": sum(row.set_aside for row in outliers),
        "masked": [str(problem) for problem in source.masked],
        "runs": list(data.runs),
        "convention": source.convention,
        "slip_definition": source.slip_definition,
        "columns": dict(source.columns),
        "units": dict(source.units),
        "assumptions": list(source.notes),
        "constants": dict(source.constants),
        "range": {
            name: (float(np.min(values)), float(np.max(values)))
            for name in TireInputs._fields
            if name != "time" and name in data and len(values := data.usable(name))
        },
        "slip_check": None if source.slip_check is None else asdict(source.slip_check),
    }


def _noise_record(settled: Settled, config: FitConfig) -> dict[str, Any]:
    problem, at = settled.solved.problem, settled.solved.at
    fz = problem.used(problem.rows.inputs.fz)
    record: dict[str, Any] = {"loss": config.noise.loss}
    if config.noise.loss == "trimmed":
        record |= {"limit": settled.limit, "too_many": settled.note}
    for channel in problem.channels:
        scale = problem.used(problem.rows.scale[channel.name])
        varies, ratio = np.ptp(scale) > 1e-9 * scale.max(), scale / fz
        record[channel.name] = {
            "median_std": float(np.median(scale)),
            "proportional_to_load": bool(varies and np.ptp(ratio) < 1e-9 * ratio.max()),
            "source": "estimated" if channel.noise_estimated else "given",
        }
        one_std = channel.noise_estimated and np.ptp(scale) == 0
        if one_std and not problem.is_huber and not problem.rows.nodes:
            residual, force = settled.solved.residual(channel.name), at.mean[channel.name]
            run, runs = problem.used(problem.rows.run), problem.layout.runs
            record[channel.name] |= noise_by_row(residual, fz, np.asarray(force), run, runs)
    for slip, std in problem.slip_noise.items():
        # The share of the variance of each force about its prediction, over all rows.
        shares = {
            c.name: float(
                1
                - np.sum(problem.used(problem.rows.scale[c.name]) ** 2)
                / np.sum(at.variance[c.name])
            )
            for c in problem.channels
            if c.slip == slip
        }
        record[slip] = {"median_std": float(np.median(std)), "source": "given"}
        record[slip]["share_of_variance"] = shares
    record["inflation"] = {k: float(rule.inflation) for k, rule in problem.rules.items()}
    return record


def fit(
    data: DataLike,
    model: str | None = None,
    *,
    config: FitConfig | dict[str, Any] | None = None,
    solver: Solver | None = None,
    seed: int | None = None,
) -> FitResult:
    """Fit a tire model by least squares, with covariance and profile intervals.

    Args:
        data: a result of ``tirefit.read``, or data that it reads with its defaults: a
            path, a frame, a mapping of column -> (n,) array.
        model: a name of ``tirefit.MODELS``; by default that of ``config``, or ``brush``.
        config: content of ``fit.toml`` as a dict or a ``FitConfig``: ``force`` (fx, fy, mz),
            ``starts``, ``parameters`` ({"mu": {...}} with value, free, lower, upper, prior,
            per_run, tied, factor), ``noise`` ({"fx": 20.0} in N, fx_relative, sigma_x,
            loss, ...) and ``posterior`` (sampler, effective_samples, ...).
        solver: ``gauss-newton``; to check it, ``optimistix``, ``jaxopt`` or a least-squares
            solver of optimistix. Profiles are by ``gauss-newton``.
        seed: of the random starts and of all sampling.

    Returns:
        The fit; ``sample`` adds the posterior.

    Raises:
        UsageError: unknown model, parameter, solver or option; or 32-bit floats in use.
        DataError: missing columns that the model needs, or too few rows.

    Example:
        >>> swept = simulate("rig", values={"mu": 0.9}, seed=1)
        >>> found = fit(swept.columns, "brush")
        >>> mu = found.parameters["mu"]
        >>> str(found.status), round(mu.value, 3), round(mu.std, 3)
        ('ok', 0.899, 0.001)
        >>> import optimistix as optx
        >>> checked = fit(swept.columns, solver=optx.LevenbergMarquardt(rtol=1e-8, atol=1e-8))
        >>> checked.solver, round(checked.parameters["mu"].value / mu.value, 6)
        ('LevenbergMarquardt', 1.0)
    """
    require_x64("a fit")
    release_programs()
    data = as_data(data)
    config = parse_config(config or {}) if not isinstance(config, FitConfig) else config
    given = {"solver": solver, "seed": seed, "model": model}
    given = {key: value for key, value in given.items() if value is not None}
    parse_config({k: v for k, v in given.items() if k != "solver" or isinstance(v, str)}, "fit()")
    solver_name(given.get("solver", config.solver))
    config = config.model_copy(update=given)
    settled = settle(data, config.model or "brush", config)
    return _summarise(settled, data, config)


def _summarise(settled: Settled, data: TireData, config: FitConfig) -> FitResult:
    task, solved = settled.task, settled.solved
    problem = solved.problem
    profiles = profile_all(problem, solved.z, solved.covariance, solved.level)
    estimates, by_covariance = profile_estimates(solved, profiles)
    std = np.sqrt(np.diag(solved.covariance))
    elements = problem.layout.elements
    result = FitResult(
        model=task.name,
        forces=tuple(c.name for c in problem.channels),
        parameters=with_fixed(estimates, problem),
        least_squares=estimates,
        intervals={
            "covariance": by_covariance,
            "profile": {label: value.ci95 for label, value in estimates.items()},
        },
        derived=derived_from_profile(solved, profiles, list(estimates.values())),
        statistics=_statistics(solved),
        noise=_noise_record(settled, config) | {"notes": list(task.notes)},
        verdict=Verdict(),
        labels=problem.layout.labels,
        correlation=solved.covariance / np.outer(std, std),
        data=data_record(data, problem.n, settled.outliers),
        reference=reference_points(problem),
        solver=solver_name(config.solver),
        seed=config.seed,
        version=importlib.metadata.version("tirefit"),
        versions={"python": platform.python_version()}
        | {name: importlib.metadata.version(name) for name in _PACKAGES},
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
        solved=solved,
        table=task.data,
        far_rows=settled.outliers,
    )
    ranges = peak_ranges(task, solved, result.derived, config, is_noise(result))
    trials = tried(result, task, config)
    return judge(replace(result, peak_range=ranges, trials=trials))


def with_fixed(estimates: dict[str, Estimate], problem: FitProblem) -> dict[str, Estimate]:
    """Estimates plus the fixed and tied parameters, in the model's order."""
    everything, free = dict(estimates), {p.name for p in problem.layout.free}
    ties = {tie.name: tie for tie in problem.layout.ties}
    ends = ("", *(f"[{run}]" for run in problem.layout.runs))
    for name, spec in specs(problem.model).items():
        if name in ties:
            factor, of = ties[name].factor, ties[name].other
            # One for each run, if the other one is per run.
            for end in (end for end in ends if of + end in estimates):
                everything[name + end] = estimates[of + end].times(factor, spec.unit)
        elif name not in free and (spec.free or name != "half_length"):
            value = float(parameter_values(problem.model)[name])
            everything[name] = Estimate(value, None, spec.unit, (None, None), fixed=True)
    return everything
