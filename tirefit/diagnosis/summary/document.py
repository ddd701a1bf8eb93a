"""What is said of one file: the document of a diagnosis and its rows."""

import importlib.metadata

import numpy as np

from tirefit.diagnosis.decide.calibration import as_often_right
from tirefit.diagnosis.decide.findings import floor_of
from tirefit.diagnosis.decide.remainder import widening
from tirefit.diagnosis.decide.verdict import Status, Verdict
from tirefit.diagnosis.evidence.base import Base
from tirefit.diagnosis.evidence.forms import offsets_of_runs, with_fast_waves
from tirefit.diagnosis.evidence.posterior import linear_at
from tirefit.diagnosis.evidence.search import Hypothesis, amplitudes_of
from tirefit.diagnosis.left_out.ladder import ladder_of
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
from tirefit.diagnosis.summary.case import Case
from tirefit.diagnosis.summary.closure import (
    Closure,
    closure_on_rows,
    plausible_forces,
)
from tirefit.diagnosis.summary.forces import all_rows, form_part, rows_of
from tirefit.diagnosis.summary.forecast import confusion, next_measurements
from tirefit.diagnosis.summary.holdout import held_out
from tirefit.diagnosis.summary.records import (
    Amplitude,
    Candidate,
    Gap,
    HeldOut,
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

_LISTED, _MENTIONED = 10, 1e-3
"""Candidates that are listed, at most; probability from which the unknown is one."""

_SHOWN = 0.05
"""Probability of a shape of the remainder from which it is reported."""

_SEEN = 3.3
"""Standard errors of an amplitude that is seen four times in five: 0.84 beyond 2.46,
which noise exceeds once in 72 files."""

_SEEN_ENERGY = 2.5
"""The same of the energy of a generic remainder, in standard deviations of that of the
noise: 0.84 beyond 1.65, which noise exceeds once in 20 files."""

_DIRECTIONS = 40
"""Smooth directions that share the noise's energy, at most: a remainder of a force over
slip has no more."""


def document_of(
    case: Case, whole: Prepared, settings, library, holdout, generator, model, seed
) -> Diagnosis:
    """The verdict on the rows of ``case``, spread over all rows of ``whole``.

    Args:
        settings: :class:`~tirefit.diagnosis.summary.records.Settings`.
        library: effects that were looked for.
        holdout: tables that the search did not use.
    """
    data, base, rig = whole.data, case.base, settings.rig
    prepared = base.prepared
    rows = rows_of(case, base.measured)
    # Everything random is drawn in this order: true forces, held-out data, budget.
    believed, main = rows_of(case, base), prepared.channels[0]
    truth = plausible_forces(case, generator)
    ladder = ladder_of(case.predicted, case.verdict.key, floor_of(base))
    held = held_out(case, holdout, rig, ladder, generator)
    verdict, gaps = case.verdict, _gaps(case, rows, truth)
    candidates, gap = _candidates(case, rows, truth), _gap(case, gaps, held)
    budgets, curves = budgets_of(case, believed, generator), _what_is_left(case)
    said = _verdict(case, curves, gap)
    steps, reason = next_measurements(base, case.search, case.weighed, verdict)
    shown = shown_rows(base, rows[main])
    noise = _noise(case)
    # Whether a simulator's parameters explain all that there is.
    tuned_alone = base.simulator is not None and verdict.status == Status.NONE
    return Diagnosis(
        data=data_summary(data, base, rig),
        model=model,
        simulator=simulator_summary(base, model, gap.rms),
        n=data.n,
        n_effective=prepared.n / noise.inflation,
        noise=noise,
        gap=gap,
        budget=budgets[main],
        budgets=budgets,
        where=tuple(regions(base, _missed(base), shown.gap)),
        spots=spots(base, _missed(base), shown.gap),
        map=tuple(parameter_map(base)),
        verdict=said,
        ladder=ladder,
        candidates=candidates,
        untestable=tuple(case.untestable),
        resolution=_resolution(case),
        forecast=tuple(confusion(case.search)),
        next_measurement=steps,
        next_measurement_reason=reason,
        slip_check=case.slip_check,
        runs=offsets_of_runs(base, case.chosen),
        base_parameters=_base_parameters(base, base.as_given),
        extended_parameters=_base_parameters(base, case.chosen.z),
        settings=settings,
        seed=seed,
        version=importlib.metadata.version("tirefit"),
        rows=all_rows(case, whole, rig, rows),
        table=data,
        mean_load=float(np.mean(data.usable("fz"))),
        residual_map=residual_map(shown, noise.inflation, gap.resolvable),
        comparison=compared(shown, said.names_an_effect or tuned_alone),
        look=next(iter(curves), None),
        library=library,
        meanings={p.name: p.spec.meaning for p in base.layout.free},
    )  # fmt: skip


def _missed(base: Base) -> np.ndarray:
    """Whitened residual of the first channel, (n,)."""
    whole = base.residual(base.as_given, base.amplitudes())
    return whole[: base.prepared.n]


def _gaps(case: Case, rows, truth) -> dict[str, Shrinkage]:
    """How far the gap of each channel shrinks on the rows of the search.

    Args:
        truth: (n, draws) by channel, what the force may truly be.
    """
    base, verdict, gaps = case.base, case.verdict, {}
    for channel, parts in rows.items():
        silent = verdict.status == Status.UNKNOWN and not base.simulator
        extended = parts["base"] if silent else parts["extended"]
        noise = base.noise[channel]
        closure = closure_on_rows(
            truth[channel], parts["base"], extended, noise.std**2, base.prepared.run,
            noise.inflation,
        )  # fmt: skip
        gaps[channel] = _shrinkage(closure, verdict, base)
    return gaps


def _shrinkage(closure: Closure, verdict: Verdict, base: Base) -> Shrinkage:
    # The parameters of a simulator close a part whatever the verdict on effects is.
    silent = not verdict.status.names and not base.simulator
    closed = 0.0 if silent else closure.closed
    return Shrinkage(
        rms=closure.rms,
        resolvable=closure.resolvable
        and (verdict.status != Status.NONE or base.simulator is not None),
        closed=closed if closed is None else float(np.clip(closed, 0.0, 1.0)),
        closed_ci=(0.0, 0.0) if silent else (closure.low, closure.high),
        remaining_rms=closure.rms if silent else closure.remaining,
    )


def _gap(case: Case, gaps: dict[str, Shrinkage], holdout: HeldOut | None) -> Gap:
    base, named = case.base, case.verdict.status.names
    return Gap(
        **vars(gaps[base.prepared.channels[0]]),
        channels=gaps,
        holdout=holdout,
        shares=closed_by_each(base, case.chosen) if named else {},
    )


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
    """The shapes that the remainder resembles, the likeliest first; none where nothing
    unlisted is likelier than not."""
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
    return tuple(
        look_curve(case.chosen, base, look)
        for look in alike
        if look.probability > _SHOWN
    )


def _verdict(case: Case, curves: tuple[LookCurve, ...], gap: Gap) -> VerdictSummary:
    """The verdict, with a probability that says how often such verdicts are right;
    where no effect on the mean is found, what its noise shows."""
    verdict, noise = case.verdict, case.on_the_noise
    status = "noise" if noise else verdict.status
    return VerdictSummary(
        status=Status.NAMED if noise else verdict.status,
        effects=noise or verdict.effects,
        probability=as_often_right(status, verdict.probability),
        each=verdict.each,
        also_possible=verdict.also_possible,
        left=Left(
            rms=gap.remaining_rms,
            share=(gap.remaining_rms / max(gap.rms, ROUNDING)) ** 2,
            unlisted=verdict.unlisted,
            tests=verdict.tests._asdict(),
            looks_like=tuple(curve.look for curve in curves),
        ),
        parameters=parameter_changes(case, _widening(case.base, case.chosen)),
    )  # fmt: skip


def _candidates(case: Case, rows, truth, most: int = _LISTED) -> tuple[Candidate, ...]:
    """The most probable sets of effects, and the unknown; ``rows`` and ``truth`` as in
    :func:`_gaps`."""
    weighed, at = case.weighed, case.base.measured
    main = case.base.prepared.channels[0]
    before, forces = rows[main]["base"], truth[main]
    total, said = _chances(case), case.verdict.key
    ranked = sorted(total, key=lambda key: (key == said, total[key]), reverse=True)
    ranked = ranked[:most]
    closed = [_closure_by(case, at, weighed.best_of[k], before, forces) for k in ranked]
    listed = [
        _candidate(case, key, total[key], closure)
        for key, closure in zip(ranked, closed, strict=True)
    ]
    alone = case.verdict.unlisted if not case.verdict.status.names else 0.0
    if alone > _MENTIONED:
        unknown = Candidate(
            effects=("unknown",), family="unknown", parameters={}, z=None,
            probability=alone, z_given_rivals=None, closed=0.0,
            closed_ci=(0.0, 0.0),
        )  # fmt: skip
        listed.append(unknown)
    return tuple(listed)


def _chances(case: Case) -> dict:
    """Probability of every refitted set: the verdict's, others by their evidence."""
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
    """Of the formulas alone: where an effect has another form, no size of its formula
    is surer than that."""
    return widening(base, base.residual(hypothesis.z, amplitudes_of(base, hypothesis)))


def _candidate(case: Case, key, probability: float, closure: Closure) -> Candidate:
    base, hypothesis = case.base, case.weighed.best_of[key]
    p, parameters = len(hypothesis.z), {}
    spread = np.sqrt(np.maximum(np.diag(hypothesis.covariance)[p:], 0))
    spread = spread * np.sqrt(_widening(case.base, hypothesis))
    scale = np.asarray(base.design.prior_scale)
    effects = [base.atoms[k].effect for k in hypothesis.atoms]
    for j, (k, effect) in enumerate(zip(hypothesis.atoms, effects, strict=True)):
        parameters[f"{effect.id}: {effect.parameter}"] = Amplitude(
            value=float(hypothesis.amplitude[j] * scale[k]),
            # However badly it fits, no less is known of it than beforehand.
            std=float(min(spread[j], 1.0) * scale[k]),
            unit=effect.unit,
            formula=base.atoms[k].formula(
                base.design.rows,
                base.rows.time,
                hypothesis.amplitude[j] * scale[k],
                base.rows,
            ),
        )
    ratio = hypothesis.amplitude / np.maximum(spread, ROUNDING)
    return Candidate(
        effects=tuple(key),
        family=" + ".join(dict.fromkeys(e.family for e in effects)),
        probability=probability,
        parameters=parameters,
        z=max((case.search.score.get(e.id, 0.0) for e in effects), key=abs),
        z_given_rivals=float(np.min(np.abs(ratio))),
        closed=closure.closed,
        closed_ci=(closure.low, closure.high),
    )


def _closure_by(case: Case, at: Base, hypothesis, before, truth) -> Closure:
    """What a hypothesis closes of the first channel's gap, in whatever form.

    Args:
        at: the base fit at the measured slips.
        before, truth: (n,) force of the base and (n, draws) what it may truly be.
    """
    main, run = at.prepared.channels[0], at.prepared.run
    after = at.forces(hypothesis.z, amplitudes_of(at, hypothesis))[main]
    scale = np.asarray(at.design.scale[main])[: len(before)]
    after = after + form_part(case, hypothesis)[: len(before)] * scale
    variance, inflation = at.noise[main].std ** 2, at.noise[main].inflation
    return closure_on_rows(truth, before, after, variance, run, inflation)


def _resolution(case: Case) -> Resolution:
    """Generic remainder that would be seen four times in five, rms [N]."""
    base = case.base
    main = base.prepared.channels[0]
    scale = np.asarray(base.design.scale[main])[: base.prepared.n]
    directions = min(base.generic.smooth.shape[1], _DIRECTIONS)
    needed = np.sqrt(_SEEN_ENERGY * np.sqrt(2 * directions) / base.prepared.n)
    seen = {
        effect: _SEEN * abs(value) for effect, value in _smallest_seen(case).items()
    }
    return Resolution(remainder=float(np.median(scale) * needed), smallest_effects=seen)


def _smallest_seen(case: Case) -> dict[str, float]:
    """One standard deviation of each effect's amplitude on this data, own units."""
    base, left = case.base, case.search.projected
    size, smallest = np.linalg.norm(left, axis=0), {}
    for k in case.search.testable:
        effect = base.atoms[k].effect
        if effect.id not in smallest and size[k] > UNSEEN and not effect.singular:
            scale = np.asarray(base.design.prior_scale)[k]
            smallest[effect.id] = float(scale / size[k])
    return smallest


def _base_parameters(base: Base, z) -> dict[str, float]:
    values = base.layout.natural(z)
    return {name: float(np.asarray(v).ravel()[0]) for name, v in values.items()}
