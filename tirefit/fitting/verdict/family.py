"""Other models on the rows of a fit: the peak over a family of them, and what to try.

Below the peak the rows do not determine the peak: the shape of the model does. The same
rows are then fitted with models of other shapes, and the result is the range of the peak
over those that describe the rows as well as the best one. Rows that reach the peak are
treated likewise if the peak of such a model lies outside of the interval of the fit.

``docs/how-it-works/uncertainty.md`` states how often the true peak lies in the interval of
a fit that is ok, and in the range of the others (``make statistics``).

Models with an effect that the residuals show are tried too (:func:`tried`). One is advised only if
it was fitted to these rows, stops at no bound, and lowers AICc clearly.
"""

import re
from collections.abc import Mapping

import numpy as np
from scipy.special import chdtrc

from tirefit.fitting.problem.build import FitTask, build
from tirefit.fitting.problem.config import FitConfig
from tirefit.fitting.result import Estimate, FitResult, PeakRange, Trial, information
from tirefit.fitting.solve.hints import remainder
from tirefit.fitting.solve.multistart import Solved, solve_problem
from tirefit.fitting.uncertainty.derived import derived_from_profile, quantity_of
from tirefit.fitting.uncertainty.identified import labels_at_bound, minus_two_log_likelihood
from tirefit.fitting.verdict.judge import exactness, models_with
from tirefit.models import MODELS, modelled
from tirefit.params import specs
from tirefit.results import DataError, UsageError

NEAR_PEAK = 0.98
"""Share of the fitted peak below which the rows do not reach it; a brush has it at 0.73 of
the slip of full sliding."""

_CONTRADICTED = 0.01
"""Probability of the likelihood ratio below which a model is not in the range. The test is
exact for nested models (brush in brush-d)."""

_IN_DOUBT = 0.3
"""Probability of the residuals under the model of the fit below which other shapes are
fitted to rows that reach the peak. It finds 95 of 96 sets of the wrong model in which
another is significantly better (0.1: 92); of 100 sets that follow the model, other shapes
are fitted to 30, which takes 0.3 s of processor."""

_CLEAR = 6.0
"""Least decrease of AICc at which a model is advised: odds of 20 to 1 for it, exp(6 / 2), if the
rows are as independent as they are counted."""

_BRUSH = re.compile(r"(brush(?:-load|-anisotropic)?)(?:-(d?)([mnhs]*))?")
"""Name of a brush: family, pressure, friction."""


def family_of(task: FitTask) -> list[str]:
    """Names of models of other shapes for the rows of a task: brush, brush-d, Magic Formula,
    with the friction law of the task's model, its load dependence and its lag."""
    name, rows = task.name, task.problem.rows
    if task.problem.model.transient:
        names = ["brush-relaxation", "magic-formula-relaxation"]
    else:
        parts = _BRUSH.fullmatch(name)
        family, friction = (parts[1], parts[3] or "") if parts else ("brush", "")
        names = [f"{family}-{letters}".rstrip("-") for letters in (friction, f"d{friction}")]
        slips = [np.abs(np.asarray(x)) for x in (rows.inputs.sigma_x, rows.inputs.alpha)]
        combined = np.mean(np.minimum(*slips) > 0.05 * max(map(np.max, slips))) > 0.05
        names.append("magic-formula-combined" if combined else "magic-formula")
    return [like for like in names if like in MODELS and like != name]


def solved_as(name: str, task: FitTask, config: FitConfig) -> Solved | None:
    """Another model solved on the rows of a task, with the settings that apply to it.

    None if the model lacks a force or an input, or if the settings do not suit it.
    """
    forces = [channel.name for channel in task.problem.channels]
    if not {*forces} <= {*modelled(MODELS[name])}:
        return None
    known = specs(MODELS[name])
    settings = {k: s for k, s in config.parameters.items() if {k, s.tied or k} <= {*known}}
    chosen = {"model": name, "force": forces, "parameters": settings}
    config = config.model_copy(update=chosen)
    try:
        return solve_problem(build(task.data, name, config, len(task.problem.rows.weight)), config)
    except (DataError, UsageError):
        return None


def reached(solved: Solved, derived: Mapping[str, Estimate]) -> dict[str, float]:
    """Largest share of each fitted peak among the fitted forces of its rows.

    By label of ``derived``; without peaks that are fixed or not identified.
    """
    problem, mean, shares = solved.problem, solved.at.mean, {}
    forces = [mean[name] for name in ("fx", "fy") if name in mean]
    if not forces:
        return {}
    over_load = np.sqrt(np.sum(np.square(forces), axis=0)) / problem.used(problem.rows.inputs.fz)
    run = problem.used(problem.rows.run)
    for label, peak in derived.items():
        at = derived.get(label.replace("F_max_over_fz", "slip_at_peak"))
        if quantity_of(label) != "F_max_over_fz" or not peak.identified or peak.fixed:
            continue
        if at is None or not np.isfinite(at.value):
            continue
        of = label.removeprefix("F_max_over_fz")[1:-1]
        of_run = run == problem.layout.runs.index(of) if of else slice(None)
        shares[label] = float(np.max(over_load[of_run])) / peak.value
    return shares


def peak_ranges(
    task: FitTask,
    solved: Solved,
    derived: Mapping[str, Estimate],
    config: FitConfig,
    noisy: bool = True,
) -> dict[str, PeakRange]:
    """Range of the peak over models of other shapes, by label of ``derived``.

    Only of peaks that the rows do not reach, and of those whose interval does not contain
    the peak of another shape that describes the rows as well.

    Args:
        noisy: whether the residuals are noise. If not, the verdict reports the misfit, and
            other shapes are fitted only below the peak.
    """
    shares = reached(solved, derived)
    if not any(share < NEAR_PEAK for share in shares.values()):
        if not shares or not noisy or not shape_in_doubt(solved):
            return {}
    every = {task.name: solved}
    every |= {n: solution for n in family_of(task) if (solution := solved_as(n, task, config))}
    chances = probabilities(every)
    as_good = [name for name, chance in chances.items() if chance > _CONTRADICTED]
    # Without profiles of the parameters: those of a Magic Formula, which are redundant below
    # the peak, take minutes if the slip has noise.
    others = [name for name in as_good if name != task.name]
    peaks = {name: derived_from_profile(every[name], only=("F_max",)) for name in others}
    peaks |= {task.name: dict(derived)}
    worse, ranges = tuple(name for name in every if name not in as_good), {}
    for label, share in shares.items():
        low, high = derived[label].ci95
        # That of all runs, if the peak of the model does not differ by run; a model whose peak
        # does, where that of the fit does not, has none.
        peaks_of = {
            name: peak
            for name in as_good
            if (peak := peaks[name].get(label, peaks[name].get(quantity_of(label))))
        }
        peaks_of = peaks_of or {task.name: derived[label]}
        inside = [(low or 0.0) <= peak.value <= (high or np.inf) for peak in peaks_of.values()]
        if share < NEAR_PEAK or not all(inside):
            # Without an upper end if the peak is not identified.
            ends = {
                k: (p.ci95[0], p.ci95[1] if p.identified else None) for k, p in peaks_of.items()
            }
            lows, highs = zip(*ends.values(), strict=True)
            # Rows that reach a force show that the peak is not below it, up to the error of
            # the fit: a shape that a few effective rows leave open does not say otherwise.
            least = min(low or 0.0, share * derived[label].value)
            bottom = None if None in lows else max(min(lows), least)
            top = None if None in highs else max(highs)
            ranges[label] = PeakRange(bottom, top, share, ends, worse)
    return ranges


def shape_in_doubt(solved: Solved) -> bool:
    """Whether a curve of another shape may explain a part of the residuals.

    The residuals are regressed on the force times the slip and on the force times itself,
    which are nearly the differences of the other shapes from the fitted curve. Forces whose
    slip has noise are not tested, as their rows have no residual.
    """
    problem, chance = solved.problem, 1.0
    for channel in problem.channels:
        name = channel.name
        if name not in problem.rules or name not in ("fx", "fy"):
            continue
        values, slopes = np.asarray(solved.at.values[name]), np.asarray(solved.at.slopes[name])
        scale = problem.used(problem.rows.scale[name])
        force = solved.at.mean[name] / scale
        slip = np.abs(problem.used(getattr(problem.rows.inputs, channel.slip)))
        share = np.abs(solved.at.mean[name]) / problem.used(problem.rows.inputs.fz)
        more = np.column_stack([force * slip, force * share])
        (before, fewer), (after, rank) = (
            remainder(values, slopes),
            remainder(values, np.hstack([slopes, more])),
        )
        gain = (before @ before - after @ after) / problem.rules[name].inflation
        if channel.noise_estimated:
            gain *= problem.n / max(float(after @ after), 1e-300)
        chance = min(chance, float(chdtrc(max(rank - fewer, 1), max(gain, 0.0))))
    return chance < _IN_DOUBT


def probabilities(models: Mapping[str, Solved]) -> dict[str, float]:
    """Probability of each model's likelihood if it is as good as the best one, which has 1.

    Every model counts the rows that the best one counts as independent.
    """
    fits = {name: minus_two_log_likelihood(model) for name, model in models.items()}
    best = min(fits, key=lambda name: fits[name])
    problem = models[best].problem
    independent = float(np.mean([1 / rule.inflation for rule in problem.rules.values()]))

    def chance(name: str) -> float:
        extra = max(problem.layout.size - models[name].problem.layout.size, 1)
        return float(chdtrc(extra, max(independent * (fits[name] - fits[best]), 0.0)))

    return {name: chance(name) for name in fits}


def tried(result: FitResult, task: FitTask, config: FitConfig) -> tuple[Trial, ...]:
    """Trials of the models that depend on a column which the residuals follow."""
    trials = []
    columns = () if exactness(result) else result.solved.misfit.columns
    pairs = [(c.column, name) for c in columns for name in models_with(task.name, c.column)]
    for column, name in pairs:
        other = solved_as(name, task, config) if name in MODELS else None
        if other is None:
            continue
        before, after = _criteria(result.solved, other)
        gain, stops, against = before - after, labels_at_bound(other), ""
        if stops:
            against = f"{stops[0]} stops at its bound"
        elif gain <= 0:
            against = "its AICc is no lower"
        elif gain < _CLEAR:
            against = f"it lowers AICc by only {gain:.3g}, too little to tell"
        trials.append(Trial(column, name, against, (before, after)))
    return tuple(trials)


def _criteria(*models: Solved) -> tuple[float, ...]:
    """AICc of each model, at the number of independent rows of the most likely one."""
    fits = [minus_two_log_likelihood(model) for model in models]
    effective = models[int(np.argmin(fits))].n_effective
    rows = models[0].problem.n * len(models[0].problem.channels)
    unknowns = [model.problem.unknowns for model in models]
    return tuple(
        information(fit, rows, effective, k)[0] for fit, k in zip(fits, unknowns, strict=True)
    )
