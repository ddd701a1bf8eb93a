"""Build the document of a diagnosis and its rows."""

import importlib.metadata
from dataclasses import replace

import numpy as np

from tirefit.diagnosis.decide.findings import as_often_right, floor_of
from tirefit.diagnosis.decide.remainder import widening
from tirefit.diagnosis.decide.verdict import Status
from tirefit.diagnosis.evidence.base import Base
from tirefit.diagnosis.evidence.forms import offsets_of_runs, with_fast_waves
from tirefit.diagnosis.evidence.posterior import linear_at
from tirefit.diagnosis.evidence.search import Hypothesis, amplitudes_of
from tirefit.diagnosis.extended import Extension, extension_of
from tirefit.diagnosis.left_out import ladder_of
from tirefit.diagnosis.negligible import ROUNDING, UNSEEN
from tirefit.diagnosis.rows.basis import without
from tirefit.diagnosis.rows.patterns import looks
from tirefit.diagnosis.rows.prepared import Prepared
from tirefit.diagnosis.summary.budget import (
    budgets_of,
    closed_by_each,
    parameter_changes,
    simulator_summary,
)
from tirefit.diagnosis.summary.case import Case, all_rows, form_part, rows_of
from tirefit.diagnosis.summary.closure import closure_on_rows, held_out, plausible_forces
from tirefit.diagnosis.summary.forecast import confusion, next_measurements
from tirefit.diagnosis.summary.records import (
    Amplitude,
    Candidate,
    Gap,
    Left,
    NoiseSummary,
    Resolution,
    Shrinkage,
    VerdictSummary,
)
from tirefit.diagnosis.summary.result import Diagnosis
from tirefit.diagnosis.summary.views import (
    LookCurve,
    compared,
    look_curve,
    residual_map,
    shown_rows,
)
from tirefit.diagnosis.summary.where import data_summary, parameter_map, regions, spots
from tirefit.fitting.noise import effective_inflation

_LISTED, _MENTIONED = 10, 1e-3
"""Largest number of candidates; smallest probability of the unknown to be one."""

_SHOWN = 0.05  # smallest probability of a shape of the remainder that is reported

_SEEN = 3.3
"""Standard errors of an amplitude that is detected four times in five: 0.84 above 2.46,
which noise exceeds once in 72 files."""

_SEEN_ENERGY = 2.5
"""The same for the energy of a generic remainder, in standard deviations of that of
noise: 0.84 above 1.65, which noise exceeds once in 20 files."""

_DIRECTIONS = 40
"""Largest number of smooth directions with noise; a force over slip has fewer."""


def document_of(
    case: Case, whole: Prepared, settings, library, holdout, generator, model, seed
) -> Diagnosis:
    """The document of the verdict on the rows of ``case``, for all rows of ``whole``.

    Args:
        settings: :class:`~tirefit.diagnosis.summary.records.Settings`.
        library: effects that were looked for.
        holdout: tables that the search did not use.
    """
    data, base, rig = whole.data, case.base, settings.rig
    prepared = base.prepared
    rows = rows_of(case, base.measured)
    # Random numbers are drawn in this order: true forces, held-out data, budget.
    believed, main = rows_of(case, base), prepared.channels[0]
    truth = plausible_forces(case, generator)
    ladder = ladder_of(case.predicted, case.verdict.key, floor_of(base, case.predicted))
    held, ladder = held_out(case, holdout, rig, ladder, generator)
    verdict, gaps = case.verdict, _gaps(case, rows, truth)
    candidates = _candidates(case, rows[main]["base"], truth[main])
    shares = closed_by_each(base, case.chosen) if verdict.status.names else {}
    gap = Gap(**vars(gaps[main]), channels=gaps, holdout=held, shares=shares)
    budgets, curves = budgets_of(case, believed, generator), _what_is_left(case)
    message = _verdict(case, curves, gap)
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
        spots=spots(base, missed, shown.gap),
        map=tuple(parameter_map(base)),
        verdict=message,
        ladder=ladder,
        candidates=candidates,
        untestable=tuple(case.untestable),
        resolution=_resolution(case),
        forecast=tuple(confusion(case.search)),
        next_measurement=steps,
        next_measurement_reason=reason,
        slip_check=base.rows.slip_check,
        runs=offsets_of_runs(base, case.chosen),
        base_parameters=_base_parameters(base, base.as_given),
        extended_parameters=_base_parameters(base, case.chosen.z),
        extension=_extension(case),
        settings=settings,
        seed=seed,
        version=importlib.metadata.version("tirefit"),
        rows=all_rows(case, whole, rig, rows),
        table=data,
        mean_load=float(np.mean(data.usable("fz"))),
        residual_map=residual_map(shown, noise.inflation, gap.resolvable),
        comparison=compared(shown, message.names_an_effect or tuned_alone),
        look=next(iter(curves), None),
        library=library,
        meanings={p.name: p.spec.meaning for p in base.layout.free},
    )


def _gaps(case: Case, rows, truth) -> dict[str, Shrinkage]:
    """Closure of the gap of each channel on the rows of the search.

    Args:
        truth: (n, draws) by channel: draws of the true force.
    """
    base, status, gaps = case.base, case.verdict.status, {}
    # The parameters of a simulator close a part for every verdict on effects.
    is_simulator = base.simulator is not None
    for channel, parts in rows.items():
        alone = status == Status.UNKNOWN and not is_simulator
        noise, after = base.noise[channel], parts["base" if alone else "extended"]
        found = closure_on_rows(
            truth[channel], parts["base"], after, noise.std**2, base.prepared.run, noise.inflation
        )
        shows = found.resolvable and (status != Status.NONE or is_simulator)
        gaps[channel] = replace(found, resolvable=shows)
        if not status.names and not is_simulator:
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
        slip_name="alpha" if base.prepared.mode == "y" else "sigma_x",
        slip=base.slip_noise,
        slip_source=base.prepared.slip_source,
        source="; ".join(dict.fromkeys(level.source for level in levels.values())),
        flags=case.noise_flags,
        excess=max(one.excess for one in base.noise.values()),
        inflation=max(level.inflation for level in levels.values()),
        outliers=sum(int(level.outlier.sum()) for level in levels.values()),
    )


def _what_is_left(case: Case) -> tuple[LookCurve, ...]:
    """The shapes that the remainder resembles, the likeliest first; empty if an unlisted
    effect is unlikely."""
    base = case.base
    if case.verdict.status not in (Status.UNKNOWN, Status.INCOMPLETE):
        return ()
    linear = linear_at(base, case.chosen)
    if case.verdict.key in case.weighed.other_form:
        linear = linear.in_other_form()
    among, left = base.generic.patterns, without(linear.residual, linear.explained)
    if base.rows.time is not None:
        among = with_fast_waves(among, base.rows.time, left)
    alike = looks(among, linear.explained, linear.residual)
    return tuple(look_curve(case.chosen, base, look) for look in alike if look.probability > _SHOWN)


def _verdict(case: Case, curves: tuple[LookCurve, ...], gap: Gap) -> VerdictSummary:
    """The verdict with its calibrated probability, the share of such verdicts that are
    right; if no effect on the mean is found, the effects on the noise."""
    verdict, noise = case.verdict, case.on_the_noise
    status = "noise" if noise else verdict.status
    probability = as_often_right(status, verdict.probability)
    # Only one of the two probabilities includes the absence of an unlisted effect.
    unlisted = verdict.unlisted
    if verdict.status == Status.INCOMPLETE:
        unlisted = max(unlisted, probability)
    elif verdict.status != Status.UNKNOWN:
        unlisted = min(unlisted, 1 - probability)
    return VerdictSummary(
        status=Status.NAMED if noise else verdict.status,
        effects=noise or verdict.effects,
        probability=probability,
        each=verdict.each,
        also_possible=verdict.also_possible,
        left=Left(
            rms=gap.remaining_rms,
            share=(gap.remaining_rms / max(gap.rms, ROUNDING)) ** 2,
            unlisted=unlisted,
            tests=verdict.tests._asdict(),
            looks_like=tuple(curve.look for curve in curves),
        ),
        parameters=parameter_changes(case, _widening(case.base, case.chosen)),
    )


def _candidates(case: Case, before, truth) -> tuple[Candidate, ...]:
    """The most probable sets of effects, and the unknown.

    Args:
        before, truth: (n,) base force, (n, draws) of the true one, first channel.
    """
    total, verdict = _chances(case), case.verdict
    ranked = sorted(total, key=lambda k: (k == verdict.key, total[k]), reverse=True)
    listed = [
        _candidate(case, key, total[key], _closure_by(case, key, before, truth))
        for key in ranked[:_LISTED]
    ]
    alone = verdict.unlisted if not verdict.status.names else 0.0
    if alone > _MENTIONED:
        unknown = Candidate(
            effects=("unknown",),
            family="unknown",
            parameters={},
            z=None,
            probability=alone,
            z_given_rivals=None,
            closed=0.0,
            closed_ci=(0.0, 0.0),
        )
        listed.append(unknown)
    return tuple(listed)


def _chances(case: Case) -> dict:
    """Probability of every refitted set: that of the verdict; others by evidence."""
    verdict, listed = case.verdict, case.weighed.listed
    named = verdict.status.names
    some = {k: p for k, p in listed.items() if k and not (named and k == verdict.key)}
    alone = verdict.status in (Status.NAMED, Status.CANNOT_TELL)
    rest = 1 - verdict.unlisted - verdict.probability * alone
    if verdict.status == Status.NONE:
        rest *= 1 - case.weighed.nothing_shown
    scale = rest / max(sum(some.values()), ROUNDING)
    shared = {k: min(scale, 1.0) * p for k, p in some.items()}
    return shared | ({verdict.key: verdict.probability} if named else {})


def _widening(base: Base, hypothesis: Hypothesis) -> float:
    """Amplitudes by the formulas alone; if another form is used, with its larger errors."""
    return widening(base, base.residual(hypothesis.z, amplitudes_of(base, hypothesis)))


def _candidate(case: Case, key, probability: float, closure: Shrinkage) -> Candidate:
    base, hypothesis = case.base, case.weighed.best_of[key]
    p, parameters = len(hypothesis.z), {}
    spread = np.sqrt(np.maximum(np.diag(hypothesis.covariance)[p:], 0))
    spread = spread * np.sqrt(_widening(base, hypothesis))
    ratio = hypothesis.amplitude / np.maximum(spread, ROUNDING)
    atoms = [base.atoms[k] for k in hypothesis.atoms]
    scale = np.asarray(base.design.prior_scale)[list(hypothesis.atoms)]
    sizes = hypothesis.amplitude * scale
    # However bad the fit, the error is at most that of the prior.
    errors = np.minimum(spread, 1.0) * scale
    for atom, size, error in zip(atoms, sizes, errors, strict=True):
        formula = atom.formula(base.design.rows, base.rows.time, size, base.rows)
        name = f"{atom.effect.id}: {atom.effect.parameter}"
        unit = atom.effect.unit
        parameters[name] = Amplitude(float(size), float(error), unit, formula)
    score = case.search.score
    return Candidate(
        effects=key,
        family=" + ".join(dict.fromkeys(atom.effect.family for atom in atoms)),
        probability=probability,
        parameters=parameters,
        z=max((score.get(effect, 0.0) for effect in hypothesis.effects), key=abs),
        z_given_rivals=float(np.min(np.abs(ratio))),
        closed=closure.closed,
        closed_ci=closure.closed_ci,
    )


def _closure_by(case: Case, key, before, truth) -> Shrinkage:
    """Closure of the gap of the first channel by a set of effects, in any form; arguments
    as in :func:`_candidates`."""
    at, hypothesis = case.base.measured, case.weighed.best_of[key]
    main, n = at.prepared.channels[0], len(before)
    after = at.forces(hypothesis.z, amplitudes_of(at, hypothesis))[main]
    after = after + form_part(case, hypothesis)[:n] * at.design.scale[main][:n]
    noise = at.noise[main]
    given = noise.std**2, at.prepared.run, noise.inflation
    return closure_on_rows(truth, before, after, *given)


def _resolution(case: Case) -> Resolution:
    """The smallest generic remainder, rms [N], and the smallest amplitudes of effects, in
    their own units, that would be detected four times in five."""
    base, n = case.base, case.base.prepared.n
    scale = np.asarray(base.design.scale[base.prepared.channels[0]])[:n]
    directions = min(base.generic.smooth.shape[1], _DIRECTIONS)
    needed = np.sqrt(_SEEN_ENERGY * np.sqrt(2 * directions) / n)
    size, smallest = np.linalg.norm(case.search.projected, axis=0), {}
    for k in case.search.testable:
        effect = base.atoms[k].effect
        if effect.id not in smallest and size[k] > UNSEEN and not effect.singular:
            std = float(base.design.prior_scale[k] / size[k])
            smallest[effect.id] = _SEEN * abs(std)
    remainder = float(np.median(scale) * needed)
    return Resolution(remainder=remainder, smallest_effects=smallest)


def _extension(case: Case) -> Extension:
    other_form = case.verdict.key in case.weighed.other_form
    return extension_of(case.base, case.chosen, other_form)


def _base_parameters(base: Base, z) -> dict[str, float]:
    values = base.layout.natural(z)
    return {name: float(np.asarray(v).ravel()[0]) for name, v in values.items()}
