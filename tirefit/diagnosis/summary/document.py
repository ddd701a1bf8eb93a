"""Build the document of a diagnosis and its rows."""

import importlib.metadata
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tirefit.diagnosis.effects.record import Effect
from tirefit.diagnosis.engine import ROUNDING
from tirefit.diagnosis.engine.decide import UNKNOWN, Status, calibration
from tirefit.diagnosis.engine.fit import Fit
from tirefit.diagnosis.engine.left_out import Step, jackknife_error, sizes_by_group
from tirefit.diagnosis.extended import extension_of
from tirefit.diagnosis.rows.prepared import Prepared
from tirefit.diagnosis.rows.rig import Rig
from tirefit.diagnosis.rows.runs import offsets_of_runs
from tirefit.diagnosis.rows.subject import Base
from tirefit.diagnosis.summary.case import Case, Concluded, all_rows, rows_of
from tirefit.diagnosis.summary.closure import (
    budgets_of,
    closure_on_rows,
    held_out,
    parameter_changes,
    plausible_forces,
    simulator_summary,
)
from tirefit.diagnosis.summary.forecast import confusion, next_measurements
from tirefit.diagnosis.summary.readings import Readings
from tirefit.diagnosis.summary.result import (
    Amplitude,
    Candidate,
    Change,
    Diagnosis,
    Gap,
    Left,
    NoiseSummary,
    Settings,
    Shrinkage,
    VerdictSummary,
)
from tirefit.diagnosis.summary.views import (
    Look,
    compared,
    data_summary,
    look_curves,
    regions,
    residual_map,
    shown_rows,
)
from tirefit.fitting.problem.noise import effective_inflation

_LISTED, _MENTIONED = 10, 1e-3
"""Largest number of candidates; smallest probability of the unknown to be one."""

_SEEN_ENERGY = 2.5
"""Energy of a generic remainder that is detected four times in five, in standard deviations of
that of noise: 0.84 above 1.65, which noise exceeds once in 20 files."""

_DIRECTIONS = 40
"""Largest number of smooth directions with noise; a force over slip has fewer."""


def document_of(
    case: Case,
    whole: Prepared,
    settings: Settings,
    library: tuple[Effect, ...],
    holdout: Sequence[Any],
    generator: np.random.Generator,
    model: str,
    seed: int,
) -> Diagnosis:
    """The document of the verdict on the rows of ``case``, for all rows of ``whole``.

    Args:
        settings: :class:`~tirefit.diagnosis.summary.result.Settings`.
        library: effects that were looked for.
        holdout: tables that the search did not use.
    """
    data, base, rig = whole.data, case.base, settings.rig or Rig()
    prepared = base.rows
    rows, main = rows_of(case, base.measured), prepared.channels[0]
    # Random numbers are drawn in this order: true forces, held-out data, budget.
    truth = plausible_forces(case, generator)
    held, ladder = held_out(case, holdout, rig, generator)
    verdict, gaps = case.verdict, _gaps(case, rows, truth)
    gap = Gap(**vars(gaps[main]), channels=gaps, holdout=held)
    budgets, curves = budgets_of(case, generator), look_curves(case)
    looks = tuple(curve.look for curve in curves)
    message = verdict_of(case, gap, parameter_changes(case), looks)
    steps, reason = next_measurements(base, case.search, case.weighed, verdict)
    shown, noise = shown_rows(base, rows[main]), _noise(case)
    missed = base.residual(base.as_given, base.amplitudes())[: prepared.n]
    # Whether the parameters of a simulator explain the whole gap.
    tuned_alone = base.simulator is not None and verdict.status == Status.NONE
    return Diagnosis(
        data=data_summary(data, base, rig),
        model=model,
        simulator=simulator_summary(base, model, gap.rms),
        n=data.n,
        n_effective=_rows_of_fit(base),
        noise=noise,
        gap=gap,
        budget=budgets[main],
        budgets=budgets,
        where=tuple(regions(base, missed, shown.gap)),
        verdict=message,
        ladder=ladder,
        candidates=candidates_of(
            case, lambda fit: _closure_by(case, fit, rows[main]["base"], truth[main])
        ),
        untestable=case.untestable,
        resolution=resolution(
            np.asarray(base.design.scale[main])[: prepared.n], base.discrepancy.columns.shape[1]
        ),
        forecast=tuple(confusion(case.search)),
        next_measurement=steps,
        next_measurement_reason=reason,
        slip_check=base.rows.slip_check,
        runs=offsets_of_runs(base, case.chosen),
        base_parameters=_base_parameters(base, base.as_given),
        extended_parameters=_base_parameters(base, case.chosen.z),
        extension=extension_of(base, case.chosen),
        settings=settings,
        seed=seed,
        version=importlib.metadata.version("tirefit"),
        rows=all_rows(case, whole, rig, rows),
        table=data,
        mean_load=float(np.mean(data.usable("fz"))),
        residual_map=residual_map(shown, noise.inflation, gap.resolvable),
        comparison=compared(shown, bool(verdict.key) or tuned_alone),
        look=next(iter(curves), None),
        library=library,
        meanings={p.name: p.spec.meaning for p in base.tire.layout.free},
    )


def _gaps(
    case: Case, rows: Mapping[str, Mapping[str, np.ndarray]], truth: Mapping[str, np.ndarray]
) -> dict[str, Shrinkage]:
    """Closure of the gap of each channel on the rows of the search.

    Args:
        truth: (n, draws) by channel: draws of the true force.
    """
    base, verdict, gaps = case.base, case.verdict, {}
    # The parameters of a simulator close a part for every verdict on effects.
    is_simulator = base.simulator is not None
    for channel, parts in rows.items():
        noise, after = base.noise[channel], parts["extended"]
        found = closure_on_rows(
            truth[channel], parts["base"], after, noise.std**2, base.rows.run, noise.inflation
        )
        shows = found.resolvable and (verdict.status != Status.NONE or is_simulator)
        gaps[channel] = replace(found, resolvable=shows)
        if not verdict.key and not is_simulator:
            gaps[channel] = replace(
                gaps[channel], closed=0.0, closed_ci=(0.0, 0.0), remaining_rms=found.rms
            )
        elif found.closed is not None:
            closed = float(np.clip(found.closed, 0.0, 1.0))
            gaps[channel] = replace(gaps[channel], closed=closed)
    return gaps


def _rows_of_fit(base: Base) -> float:
    """Effective number of rows of the fit without effects, counted as by ``tirefit fit``: its
    residuals contain the misfit of the model, which the noise does not."""
    rows, (residual, jacobian, *_) = base.rows, base.at_null
    scores = np.split(residual[:, None] * jacobian, len(rows.channels))
    each = [effective_inflation(part, rows.run, rows.time) for part in scores]
    return float(np.mean([rows.n / one for one in each]))


def _noise(case: Case) -> NoiseSummary:
    base, levels = case.base, case.base.noise
    return NoiseSummary(
        forces={c: float(np.median(level.std)) for c, level in levels.items()},
        slip_name="alpha" if base.rows.mode == "y" else "sigma_x",
        slip=float(np.median(base.rows.slip_std)),
        slip_source=base.rows.slip_source,
        source="; ".join(dict.fromkeys(level.source for level in levels.values())),
        flags=case.noise_flags,
        excess=max(one.excess for one in base.noise.values()),
        inflation=base.inflation,
        outliers=sum(int(level.outlier.sum()) for level in levels.values()),
    )


def verdict_of(
    case: Concluded, gap: Gap, parameters: Mapping[str, Change], looks: tuple[Look, ...] = ()
) -> VerdictSummary:
    """The verdict with its calibrated probability, the share of such verdicts that are
    right; if no effect on the mean is found, the effects on the noise.

    Args:
        parameters: of a simulator, as given and as measured.
        looks: shapes that the remainder resembles.
    """
    verdict, noise, fit = case.verdict, case.on_the_noise, case.chosen
    groups, scale = case.base.groups(), case.base.priors.scale
    status = "noise" if noise else verdict.status
    probability = calibration().often(str(status), verdict.probability)
    # Only one of the two probabilities includes the absence of an unlisted effect.
    unlisted = verdict.unlisted
    if verdict.status == Status.INCOMPLETE:
        unlisted = max(unlisted, probability)
    elif verdict.status != Status.UNKNOWN:
        unlisted = min(unlisted, 1 - probability)
    return VerdictSummary(
        status=Status.NAMED if noise else verdict.status,
        effects=noise or verdict.effects,
        acts_like=verdict.acts_like,
        probability=probability,
        each=verdict.each,
        also_possible=verdict.also_possible,
        left=Left(
            rms=gap.remaining_rms,
            share=(gap.remaining_rms / max(gap.rms, ROUNDING)) ** 2,
            unlisted=unlisted,
            looks_like=looks,
        ),
        sizes={
            effect: tuple(sizes_by_group(fit, atom, groups, case.widening, float(scale[atom])))
            for atom, effect in zip(fit.atoms, fit.effects, strict=True)
        },
        parameters=parameters,
    )


def candidates_of(case: Concluded, closure: Callable[[Fit], Shrinkage]) -> tuple[Candidate, ...]:
    """The most probable sets of effects, and the unknown.

    Args:
        closure: of the gap of the first channel by a fit.
    """
    total, verdict = _chances(case), case.verdict
    ranked = sorted(total, key=lambda k: (k == verdict.key, total[k]), reverse=True)
    listed = [
        _candidate(case, key, total[key], closure(case.weighed.best_of[key]))
        for key in ranked[:_LISTED]
    ]
    alone = verdict.unlisted if not verdict.key else 0.0
    if alone > _MENTIONED:
        listed.append(Candidate(effects=(UNKNOWN,), family=UNKNOWN, probability=alone))
    return tuple(listed)


def _chances(case: Concluded) -> dict[tuple[str, ...], float]:
    """Probability of every refitted set: that of the verdict; others by evidence."""
    verdict, listed = case.verdict, case.weighed.listed
    named = bool(verdict.key)
    some = {k: p for k, p in listed.items() if k and not (named and k == verdict.key)}
    alone = verdict.status in (Status.NAMED, Status.CANNOT_TELL)
    rest = 1 - verdict.unlisted - verdict.probability * alone
    if verdict.status == Status.NONE:
        rest *= 1 - case.weighed.nothing_shown
    scale = rest / max(sum(some.values()), ROUNDING)
    shared = {k: min(scale, 1.0) * p for k, p in some.items()}
    return shared | ({verdict.key: verdict.probability} if named else {})


def _candidate(
    case: Concluded, key: tuple[str, ...], probability: float, closure: Shrinkage
) -> Candidate:
    base, hypothesis = case.base, case.weighed.best_of[key]
    found, parameters = hypothesis.amplitude, {}
    spread = hypothesis.errors * np.sqrt(case.widening)
    if key == case.verdict.key:
        found, spread = case.sizes
    elif key in case.predicted.effects:
        left_out = case.predicted.amplitude[case.predicted.effects.index(key)]
        spread = np.maximum(spread, jackknife_error(left_out))
    ratio = found / np.maximum(spread, ROUNDING)
    atoms = [base.atoms[k] for k in hypothesis.atoms]
    scale = base.priors.scale[list(hypothesis.atoms)]
    sizes = found * scale
    # However bad the fit, the error is at most that of the prior.
    errors = np.minimum(spread, 1.0) * scale
    for atom, size, error in zip(atoms, sizes, errors, strict=True):
        name = f"{atom.effect.id}: {atom.effect.parameter}"
        unit = atom.effect.unit
        parameters[name] = Amplitude(float(size), float(error), unit, case.formula(atom))
    return Candidate(
        effects=key,
        family=" + ".join(dict.fromkeys(atom.effect.family for atom in atoms)),
        probability=probability,
        parameters=parameters,
        z=max((case.search.score.get(effect, 0.0) for effect in hypothesis.effects), key=abs),
        z_given_rivals=float(np.min(np.abs(ratio))),
        closed=closure.closed,
        closed_ci=closure.closed_ci,
    )


def _closure_by(case: Case, hypothesis: Fit, before: np.ndarray, truth: np.ndarray) -> Shrinkage:
    """Closure of the gap of the first channel by a set of effects.

    Args:
        before, truth: (n,) base force, (n, draws) of the true one.
    """
    at = case.base.measured
    main = at.rows.channels[0]
    after = at.forces(hypothesis.z, at.amplitudes(hypothesis.atoms, hypothesis.amplitude))[main]
    noise = at.noise[main]
    given = noise.std**2, at.rows.run, noise.inflation
    return closure_on_rows(truth, before, after, *given)


def resolution(scale: np.ndarray, columns: int) -> float:
    """The smallest generic remainder, rms, that would be detected four times in five.

    Args:
        scale: (n,) units of the whitened residuals.
        columns: number of functions for an unlisted effect.
    """
    directions = min(columns, _DIRECTIONS)
    energy = _SEEN_ENERGY * np.sqrt(2 * directions) / len(scale)
    return float(np.median(scale) * np.sqrt(energy))


def _base_parameters(base: Base, z: np.ndarray) -> dict[str, float]:
    values = base.tire.layout.natural(z)
    return {name: float(np.asarray(v).ravel()[0]) for name, v in values.items()}


def with_readings(found: Diagnosis, read: tuple[Readings, Step] | None) -> Diagnosis:
    """The diagnosis of a simulator with both readings, and their step in its ladder."""
    if read is None or found.simulator is None:
        return found
    both, step = read
    steps = found.ladder.steps
    ladder = found.ladder._replace(steps=(*steps[:-2], step, *steps[-2:]))
    return replace(found, ladder=ladder, simulator=found.simulator._replace(readings=both))
