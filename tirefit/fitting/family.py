"""The peak over a family of models, where the rows do not reach the peak of one.

Below the peak a curve alone does not determine the peak: the shape of the model does. The
same rows are then fitted with models of other shapes, and the result is the range of the
peak over those that describe the rows as well as the best one.
"""

import re
from collections.abc import Mapping

import numpy as np
from scipy.special import chdtri

from tirefit.fitting.config import FitConfig
from tirefit.fitting.derived import derived_from_profile, quantity_of
from tirefit.fitting.identified import minus_two_log_likelihood
from tirefit.fitting.others import Other, estimates_of, solved_as
from tirefit.fitting.problem import FitTask
from tirefit.fitting.result import Estimate, PeakRange
from tirefit.fitting.solve import Solved
from tirefit.models import MODELS

NEAR_PEAK = 0.95

_WORSE = 0.05
"""Probability of the likelihood-ratio test below which a model describes the rows worse
than the best one. The test is exact for nested models (brush in brush-d)."""

_BRUSH = re.compile(r"(brush(?:-load|-anisotropic)?)(?:-(d?)([mnhs]*))?")
"""Name of a brush: family, pressure, friction."""


def family_of(task: FitTask) -> list[str]:
    """Names of models of other shapes for the rows of a task: brush, brush-d, Magic Formula,
    with the friction law of the task's model, its load dependence and its lag."""
    name, rows = task.name, task.problem.rows
    if task.problem.model.transient:
        names = ["brush-relaxation", "magic-formula-relaxation"]
    else:
        found = _BRUSH.fullmatch(name)
        family, friction = (found[1], found[3] or "") if found else ("brush", "")
        names = [f"{family}-{letters}".rstrip("-") for letters in (friction, f"d{friction}")]
        slips = [np.abs(np.asarray(x)) for x in (rows.inputs.sigma_x, rows.inputs.alpha)]
        combined = np.mean(np.minimum(*slips) > 0.05 * max(map(np.max, slips))) > 0.05
        names.append("magic-formula-combined" if combined else "magic-formula")
    return [one for one in names if one in MODELS and one != name]


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
        own = run == problem.layout.runs.index(of) if of else slice(None)
        shares[label] = float(np.max(over_load[own])) / peak.value
    return shares


def peak_ranges(
    task: FitTask, solved: Solved, derived: Mapping[str, Estimate], config: FitConfig
) -> dict[str, PeakRange]:
    """Range of the peak over models of other shapes, by label of ``derived``.

    Only of peaks that the rows do not reach.
    """
    low = {k: share for k, share in reached(solved, derived).items() if share < NEAR_PEAK}
    if not low:
        return {}
    others = [one for name in family_of(task) if (one := solved_as(name, task, config))]
    every = [Other(task.name, task, solved), *others]
    as_good = [one.name for one in as_good_as_the_best(every)]
    peaks = {task.name: derived} | {
        one.name: _peaks(one.solved) for one in others if one.name in as_good
    }
    worse = tuple(one.name for one in every if one.name not in as_good)
    return {label: _range(label, share, peaks, as_good, worse) for label, share in low.items()}


def as_good_as_the_best(models: list[Other]) -> list[Other]:
    """Those that describe the rows as well as the one of largest likelihood.

    Every model counts the rows that the best one counts as independent.
    """
    fits = [minus_two_log_likelihood(one.solved) for one in models]
    best = int(np.argmin(fits))
    size, rules = models[best].solved.problem.layout.size, models[best].solved.problem.rules
    independent = float(np.mean([1 / rule.inflation for rule in rules.values()]))

    def good(i: int) -> bool:
        extra = max(size - models[i].solved.problem.layout.size, 1)
        return independent * (fits[i] - fits[best]) <= chdtri(extra, _WORSE)

    return [one for i, one in enumerate(models) if good(i)]


def _peaks(solved: Solved) -> dict[str, Estimate]:
    """Peak forces of a solved problem, and over the load."""
    profiles, estimates = estimates_of(solved)
    return derived_from_profile(solved, profiles, list(estimates.values()), only=("F_max",))


def _range(label: str, share: float, peaks, as_good: list[str], worse) -> PeakRange:
    ends = {}
    for name in as_good:
        of = peaks[name]
        one = of.get(label) or of[quantity_of(label)]
        ends[name] = one.ci95 if one.identified else (one.ci95[0], None)
    lows, highs = zip(*ends.values(), strict=True)
    low = None if None in lows else min(lows)
    return PeakRange(low, None if None in highs else max(highs), share, ends, worse)
