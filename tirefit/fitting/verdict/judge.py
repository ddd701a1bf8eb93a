"""The verdict on a fit: outcomes, and sentences that a user can act on."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import chdtr, chdtrc

from tirefit.data.run_names import label_of_run
from tirefit.data.table import CANONICAL
from tirefit.fitting.result import FitResult, PeakRange, Verdict
from tirefit.fitting.solve.far_rows import FarRow
from tirefit.fitting.uncertainty.derived import quantity_of
from tirefit.models import MODELS
from tirefit.params import specs
from tirefit.results import Outcome

_EXACT = 1e-9  # RMSE over the range of the force below which residuals are rounding

_POOR_CHI2 = 2.0
_POOR_R2 = 0.8
_CHANCE = 1e-3  # one-sided; the intervals are widened at the same level
_STRUCTURE_SIGMAS = 6.0
_SYSTEMATIC = 0.5
"""Correlation of neighbours above which half of the residual variance is misfit."""


def disagreements(result: FitResult) -> dict[str, str]:
    """Sentences on routes to an interval that differ, by label of the parameter.

    Two routes differ if an end differs from the profile's by more than 30 % of its
    half-width. Parameters that are not identified and exact data are skipped.
    """
    apart: dict[str, list[str]] = {}
    profiles = {} if exactness(result) else result.intervals["profile"]
    for label, (low, high) in profiles.items():
        if low is None or high is None or not high > low:
            continue
        if not result.least_squares[label].identified:
            continue
        for route in ("covariance", "posterior"):
            first, last = result.intervals.get(route, {}).get(label, (None, None))
            if first is None or last is None:
                continue
            if max(abs(first - low), abs(last - high)) > 0.3 * (high - low) / 2:
                text = f"{route} interval [{first:.5g}, {last:.5g}] against the profile's"
                apart.setdefault(label, []).append(f"{text} [{low:.5g}, {high:.5g}]")
    return {label: "; ".join(texts) for label, texts in apart.items()}


def _unexplained(result: FitResult) -> list[tuple[Outcome | None, str]]:
    """A sentence on a model that explains little of the variance.

    Not if the noise is given: it may then account for most of the variance.
    """
    statistics = result.statistics
    if statistics.chi2_dof is not None or statistics.r2 >= _POOR_R2:
        return []
    text = (
        f"the model does not describe these data: it explains {100 * max(statistics.r2, 0):.0f} %"
        f" of the variance of {result.forces[0]}"
    )
    return [(Outcome.POOR_FIT, text)]


def _stated_noise(result: FitResult) -> list[tuple[Outcome | None, str]]:
    """A sentence for each force whose residuals contradict its stated noise, by chi-square at
    the effective number of rows. The noise stays as stated."""
    chi2 = result.statistics.chi2_dof
    if chi2 is not None and chi2 > _POOR_CHI2:
        text = (
            f"the model does not describe these data: chi2/dof = {chi2:.3g}, the"
            f" residuals are {np.sqrt(chi2):.2g} times the given noise; the intervals"
            " are widened by that factor, and still assume that the model is right"
        )
        return [(Outcome.POOR_FIT, text)]
    sentences: list[tuple[Outcome | None, str]] = []
    for channel in result.problem.channels:
        residual = result.solved.residual(channel.name)
        square = np.mean(residual**2 / result.solved.at.variance[channel.name])
        size, dof = float(np.sqrt(square)), max(result.statistics.dof, 1.0)
        chance = min(chdtr(dof, size**2 * dof), chdtrc(dof, size**2 * dof))
        if channel.noise_estimated or chance > _CHANCE:
            continue
        outcome = Outcome.NOISE_OVERSTATED if size**2 * _POOR_CHI2 < 1 else None
        advice = "the intervals are widened; check the stated noise"
        if size < 1:
            advice = (
                f"the intervals are too wide, by a factor of up to {1 / size:.2g}; check the unit"
                " of the stated noise, or leave it out: it is then estimated from the residuals"
            )
        text = (
            f"the residuals of {channel.name} are {size:.2g} times the stated noise"
            f" ({result.noise[channel.name]['median_std']:.3g} {CANONICAL[channel.name][0]}; if it"
            f" were right, the probability of this would be below {_CHANCE:g}): {advice}"
        )
        sentences.append((outcome, text))
    return sentences


def exactness(result: FitResult) -> str:
    """A sentence on the intervals of exact data; empty for measured data."""
    solved, shares = result.solved, []
    for name, mean in solved.at.mean.items():
        residual = solved.residual(name)
        spread = max(float(np.ptp(mean + residual)), 1e-300)
        shares.append(float(np.sqrt(np.mean(residual**2))) / spread)
    misfit = max(shares)
    if misfit >= _EXACT:
        return ""
    is_given = "given" in {result.noise[name]["source"] for name in result.forces}
    width = "follow from the given noise" if is_given else "are at rounding level"
    return (
        f"the data are exact for this model (RMSE {misfit:.1g} of the range of the"
        f" force): the intervals {width}"
    )


def is_noise(result: FitResult) -> bool:
    """Whether the residuals are noise rather than rounding or a systematic misfit."""
    return not exactness(result) and result.statistics.slip_structure <= _SYSTEMATIC


def _peak_not_reached(result: FitResult) -> list[tuple[Outcome | None, str]]:
    """A sentence with the range of the peak if it depends on the shape of the model."""
    if not result.peak_range:
        return []
    label, peak = min(result.peak_range.items(), key=lambda item: item[1].share)
    text = f"{range_text(peak)}; rows reach {100 * peak.share:.0f} % of the peak"
    if quantity_of(label) != label:
        text += f" of run {_short(result, label)[len(quantity_of(label)) + 1 : -1]}"
    if more := len(result.peak_range) - 1:
        text += f" ({more} more in fit.json)"
    if peak.worse:
        text += f"; {', '.join(peak.worse)} fit{'s' * (len(peak.worse) == 1)} worse"
    return [(Outcome.SHAPE_DEPENDENT, text)]


def range_text(peak: PeakRange) -> str:
    """The range of the peak as text, with the names of its models."""
    low, high = (None if end is None else f"{end:.3g}" for end in (peak.low, peak.high))
    span = f"mu {low} to {high}" if low and high else f"mu above {low}" if low else "any mu"
    return f"{span} over {', '.join(peak.models)}"


def models_with(name: str, column: str) -> list[str]:
    """Names of models like ``name`` whose force also depends on a column.

    For the speed, friction changes with the sliding speed: linearly, and with its logarithm.
    """
    if column in ("gamma", "pressure"):
        return ["mf61"]
    names = [name.replace("brush", "brush-load", 1)]
    if column == "v":
        names = [f"{name}-n", f"{name}n", f"{name}-ln"]
    names = [like for like in names if like in MODELS and like != name]
    return names + ["mf61"] * (column == "fz")


def _lacking(result: FitResult) -> list[tuple[Outcome | None, str]]:
    """Sentences on the effects that the residuals show and the model lacks."""
    columns = result.solved.misfit.columns
    is_most = sum(column.share for column in columns) > _SYSTEMATIC
    outcome = Outcome.SYSTEMATIC_MISFIT if is_most else None
    findings: list[tuple[Outcome | None, str]] = []
    for column in columns:
        findings.append((outcome, f"{column.sentence}{_advice(result, column.column)}"))
    return findings


def _advice(result: FitResult, column: str) -> str:
    """Text that advises the best of the tried models, or states why none is better."""
    tried = [trial for trial in result.trials if trial.column == column]
    if better := [trial for trial in tried if trial.better]:
        best = min(better, key=lambda trial: trial.aicc[1])
        gain = best.aicc[0] - best.aicc[1]
        return f"; use {best.model}: fitted to these rows, it lowers AICc by {gain:.3g}"
    text = "".join(f"; {trial.model} was tried: {trial.against}" for trial in tried)
    if "mf61" in models_with(result.model, column):
        text += "; not tried: a whole Magic Formula (mf61), which has terms for it"
    return text


def _correlated(result: FitResult) -> list[tuple[Outcome | None, str]]:
    """A sentence on correlated residuals, if they halve the number of rows."""
    statistics = result.statistics
    if statistics.n_effective >= 0.5 * statistics.n:
        return []
    text = f"residuals of neighbouring rows are correlated: {statistics.n} rows count as"
    text += f" {statistics.n_effective:.0f} in every interval"
    if result.solved.misfit.columns:
        text += "; the misfit of the model causes more of it than the noise"
    return [(None, text)]


def _short(result: FitResult, label: str) -> str:
    return label_of_run(label, result.data["runs"])


def _far_rows(result: FitResult) -> list[str]:
    """Sentences on the outliers that were excluded or kept."""
    aside = [row for row in result.far_rows if row.set_aside]
    kept = [row for row in result.far_rows if not row.set_aside]
    messages = [result.noise["too_many"]] if result.noise.get("too_many") else []
    if aside:
        messages.append(
            f"{len(aside)} of {result.statistics.n + len(aside)} rows were excluded as"
            f" outliers: {_row_numbers(aside)}; correct or delete them, or fit all rows"
            " with noise.loss = 'squares'"
        )
    if kept:
        messages.append(f"check these outliers, which were kept: {_row_numbers(kept)}")
    return messages


def _row_numbers(rows: Sequence[FarRow], most: int = 8) -> str:
    """Numbers of rows, with their file where there are several."""
    several = len({row.file for row in rows}) > 1
    names = [f"{row.file} row {row.row}" if several else f"row {row.row}" for row in rows[:most]]
    more = [f"{len(rows) - most} more"] if len(rows) > most else []
    return ", ".join(names + more)


def _findings(result: FitResult) -> list[tuple[Outcome | None, str]]:
    """All sentences of the verdict, each with its outcome."""
    statistics = result.statistics
    findings: list[tuple[Outcome | None, str]] = []
    if not statistics.converged:
        findings.append((Outcome.NOT_CONVERGED, Outcome.NOT_CONVERGED.message))
    check = result.data.get("slip_check")
    if check is not None and check["contradicts"]:
        outcome = Outcome.SLIP_CONTRADICTED
        findings.append((outcome, f"{check['text']}; {outcome.message}"))
    findings += [(None, text) for text in _far_rows(result)]
    exact = exactness(result)
    findings += _unexplained(result)
    # The structure of residuals that are rounding errors is not reported.
    if exact:
        findings.append((None, exact))
    else:
        findings += _stated_noise(result) + _lacking(result)
        structure = statistics.slip_structure
        if structure * np.sqrt(statistics.n) > _STRUCTURE_SIGMAS and structure > 0.2:
            text = (
                f"residuals of neighbouring slips agree (correlation {structure:.2f}): the"
                " curve misses systematically there; look at residuals.png"
            )
            systematic = structure > _SYSTEMATIC
            findings.append((Outcome.SYSTEMATIC_MISFIT if systematic else None, text))
    findings += _peak_not_reached(result)
    if result.solved.ambiguous:
        findings.append((Outcome.STARTS_DISAGREE, Outcome.STARTS_DISAGREE.message))
    for label, estimate in result.least_squares.items():
        if not estimate.identified:
            low, high = estimate.ci95
            text = (
                f"{_short(result, label)} is not identified by these data: anything"
                f" from {low:.4g} to {high:.4g} fits as well (95 %)"
            )
            if label in statistics.at_bound:
                text += f"; the best fit stopped at the bound {estimate.value:.4g}"
                name = quantity_of(label)
                ours = next(p.spec for p in result.problem.layout.free if p.name == name)
                is_ours = ours.bounds != specs(result.problem.model)[name].bounds
                widen = f": widen the bound in parameters.{name}"
                text += widen if is_ours else ", that of the model"
            findings.append((Outcome.NOT_IDENTIFIED, text))
    at_bound = [label for label in statistics.at_bound if result.least_squares[label].identified]
    if at_bound:
        names = ", ".join(_short(result, label) for label in at_bound)
        text = f"the interval of {names} is one-sided"
        findings.append((Outcome.AT_BOUND, text))
    summary = result.posterior
    if summary is not None and summary.outcome is not Outcome.CONVERGED:
        findings.append((summary.outcome, summary.outcome.message))
    if result.interrupted:
        text = "interrupted before the first samples: there is no posterior"
        findings.append((Outcome.INTERRUPTED, text))
    findings += [] if exact else _correlated(result)
    return findings


def judge(result: FitResult) -> FitResult:
    """The same fit with its outcomes and its verdict.

    The first sentence of the verdict gives the reason of its status.
    """
    findings = _findings(result)
    outcomes = tuple(dict.fromkeys(o for o, _ in findings if o is not None))
    differ = disagreements(result)
    if differ:
        names = ", ".join(_short(result, label) for label in differ)
        text = f"the routes to an interval disagree for {names}: trust the profile"
        findings.append((None, f"{text} or the posterior, not the covariance"))
    status = Outcome.gravest(outcomes)
    ordered = sorted(findings, key=lambda finding: finding[0] is not status)
    sentences = tuple(text for _, text in ordered)
    return replace(result, verdict=Verdict(outcomes, sentences, differ))
