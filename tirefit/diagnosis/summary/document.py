"""Build the document of a diagnosis and its rows."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tirefit import __version__
from tirefit.diagnosis.effects.record import Effect
from tirefit.diagnosis.engine import NONZERO, ROUNDING
from tirefit.diagnosis.engine.decide import UNKNOWN, Status, calibration
from tirefit.diagnosis.engine.left_out import Ladder, jackknife_error, sizes_by_group
from tirefit.diagnosis.extended import extension_of
from tirefit.diagnosis.rows.fits import missed_share
from tirefit.diagnosis.rows.prepared import Prepared
from tirefit.diagnosis.rows.rig import Rig
from tirefit.diagnosis.rows.runs import offsets_of_runs
from tirefit.diagnosis.rows.subject import Base
from tirefit.diagnosis.summary.case import Case, Concluded, all_rows, rows_of
from tirefit.diagnosis.summary.closure import budget_of, gaps_of, held_out, parameter_changes
from tirefit.diagnosis.summary.forecast import next_measurements
from tirefit.diagnosis.summary.result import (
    Amplitude,
    Candidate,
    Change,
    Diagnosis,
    Gap,
    HeldOut,
    Left,
    NoiseSummary,
    Settings,
    Shrinkage,
    SimulatorSummary,
    Surrogate,
    VerdictSummary,
)
from tirefit.diagnosis.summary.views import Shape, compared, data_summary, regions, shapes_of
from tirefit.fitting.problem.noise import effective_inflation


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
    n, channels = base.rows.n, base.rows.channels
    rows, main = rows_of(case, base.measured), channels[0]
    # Random numbers are drawn in this order: held-out data, gaps.
    held, ladder = held_out(case, holdout, rig, generator)
    gaps = {c: _gap(case, gap, rows[c]["gap"]) for c, gap in gaps_of(case, generator).items()}
    missed = base.residual(*case.before)[:n]
    # Rows of the fit without effects, counted as by `tirefit fit`: its residuals contain the
    # misfit of the model, which the noise does not.
    null = base.at_null
    scores = np.split(null.residual[:, None] * null.jacobian, len(channels))
    inflations = [effective_inflation(part, base.rows.run, base.rows.time) for part in scores]
    others = parameter_changes(case), np.asarray(base.design.scale[main])[:n], shapes_of(case)
    layout, verdict = base.tire.layout, case.verdict
    # The parameters of a simulator may explain the whole gap.
    tuned_alone = base.simulator is not None and verdict.status == Status.NONE
    return Diagnosis(
        **of_any_subject(case, gaps, held, ladder, *others),
        data=data_summary(data, base, rig),
        model=model,
        simulator=_simulator(base, model, gaps[main].rms),
        n=data.n,
        n_effective=float(np.mean([n / inflation for inflation in inflations])),
        noise=_noise(case),
        where=tuple(regions(base, missed, rows[main]["gap"])),
        next_measurement=next_measurements(base, case.search, case.weighed, case.verdict),
        slip_check=base.rows.slip_check,
        runs=offsets_of_runs(base, case.chosen),
        base_parameters=_first_values(layout.natural(base.as_given)),
        extended_parameters=_first_values(layout.natural(case.chosen.z)),
        extension=extension_of(base, case.chosen),
        settings=settings,
        seed=seed,
        rows=all_rows(case, whole, rig, rows),
        table=data,
        comparison=compared(base, rows[main], bool(verdict.key) or tuned_alone),
        library=library,
        meanings={p.name: p.spec.meaning for p in layout.free},
    )


def _simulator(base: Base, model: str, gap: float) -> SimulatorSummary | None:
    """The record of the given simulator, with the error of its stand-in ``model``, also
    over the whole gap [N]."""
    if base.simulator is None:
        return None
    given, main = base.simulator.given, base.rows.channels[0]
    missed = base.design.offset[main][: base.rows.n]
    off, share = float(np.sqrt(np.mean(missed**2))), missed_share(base.rows, main, missed)
    followed = Surrogate(model, off, share, off / max(gap, NONZERO))
    return SimulatorSummary(given.kind, given.source, given.sha256, followed)


def _noise(case: Case) -> NoiseSummary:
    rows, levels = case.base.rows, case.base.noise.values()
    return NoiseSummary(
        forces={c: float(np.median(level.std)) for c, level in case.base.noise.items()},
        slip_name="alpha" if rows.mode == "y" else "sigma_x",
        slip=float(np.median(rows.slip_std)),
        slip_source=rows.slip_source,
        source="; ".join(dict.fromkeys(level.source for level in levels)),
        flags=case.noise_flags,
        excess=max(level.excess for level in levels),
        inflation=case.base.inflation,
        outliers=sum(int(level.outlier.sum()) for level in levels),
    )


def _first_values(values: Mapping[str, Any]) -> dict[str, float]:
    return {name: float(np.asarray(v).ravel()[0]) for name, v in values.items()}


def _gap(case: Case, gap: Shrinkage, located: np.ndarray) -> Shrinkage:
    """Closure of a channel on the rows of the search, as the verdict allows to tell it.

    Args:
        located: (n,) gap [N], by smooth functions if no effect helps.
    """
    # The parameters of a simulator close a part for every verdict on effects.
    verdict, is_simulator = case.verdict, case.base.simulator is not None
    shows = gap.resolvable and (verdict.status != Status.NONE or is_simulator)
    if not verdict.key and not is_simulator:
        rms = float(np.sqrt(np.mean(located**2)))
        gap = replace(gap, rms=rms, closed=0.0, closed_ci=(0.0, 0.0), remaining_rms=rms)
    return replace(gap, resolvable=shows)


def of_any_subject(
    case: Concluded,
    gaps: Mapping[str, Shrinkage],
    held: HeldOut | None,
    ladder: Ladder,
    parameters: Mapping[str, Change],
    scale: np.ndarray,
    shapes: tuple[Shape, ...] = (),
) -> dict[str, Any]:
    """The fields of a diagnosis that rows and cars fill alike.

    Args:
        gaps: by channel; held: closure on data not used.
        parameters: of a simulator, as given and as measured.
        scale: (n,) units of the whitened residuals of the first channel.
        shapes: that the remainder resembles.
    """
    main, base = next(iter(gaps)), case.base
    gap = Gap(**vars(gaps[main]), channels=gaps, holdout=held)
    verdict = _verdict(case, gap, parameters, shapes)
    # The smallest generic remainder that would be detected four times in five: 0.84 standard
    # deviations of noise above 1.65, which noise exceeds once in 20 files. A force over slip has
    # at most 40 smooth directions.
    directions = min(base.discrepancy.columns.shape[1], 40)
    energy = 2.5 * np.sqrt(2 * directions) / len(scale)
    return {
        "gap": gap,
        "budget": budget_of(ladder),
        "verdict": verdict,
        "ladder": ladder,
        "candidates": _candidates(case, verdict),
        "untestable": case.untestable,
        "resolution": float(np.median(scale) * np.sqrt(energy)),
        "version": __version__,
    }


def _verdict(
    case: Concluded, gap: Gap, parameters: Mapping[str, Change], shapes: tuple[Shape, ...]
) -> VerdictSummary:
    """The verdict with its calibrated probability, the share of such verdicts that are
    right; if no effect on the mean is found, the effects on the noise."""
    verdict, noise, fit = case.verdict, case.on_the_noise, case.chosen
    groups, scale = case.base.groups(), case.base.priors.scale
    status = "noise" if noise else verdict.status
    probability = calibration().often(str(status), verdict.probability)
    # An unlisted effect is all of the claim "unknown", a part of "incomplete", excluded by others.
    unlisted = probability
    if verdict.status == Status.INCOMPLETE:
        unlisted = max(verdict.unlisted, probability)
    elif verdict.status != Status.UNKNOWN:
        unlisted = min(verdict.unlisted, 1 - probability)
    answer = {**vars(verdict), "probability": probability, "unlisted": unlisted}
    if noise:
        answer |= {"status": Status.NAMED, "effects": noise}
    return VerdictSummary(
        **answer,
        left=Left(
            rms=gap.remaining_rms,
            share=(gap.remaining_rms / max(gap.rms, ROUNDING)) ** 2,
            unlisted=unlisted,
            looks_like=shapes,
        ),
        sizes={
            effect: tuple(sizes_by_group(fit, atom, groups, case.widening, float(scale[atom])))
            for atom, effect in zip(fit.atoms, fit.effects, strict=True)
        },
        parameters=parameters,
    )


def _candidates(case: Concluded, verdict: VerdictSummary) -> tuple[Candidate, ...]:
    """The most probable sets of effects, that of the verdict first, and the unknown."""
    total, base = _chances(case, verdict.left.unlisted), case.base
    ranked = sorted(total, key=lambda k: (k == verdict.key, total[k]), reverse=True)
    listed = []
    for key in ranked[:10]:
        fit, parameters = case.weighed.best_of[key], {}
        amplitude, spread = fit.amplitude, fit.errors * np.sqrt(case.widening)
        if key == verdict.key:
            amplitude, spread = case.sizes
        elif key in case.predicted.sets:
            spread = np.maximum(spread, jackknife_error(case.predicted.sets[key].amplitude))
        scale, atoms = base.priors.scale[list(fit.atoms)], [base.atoms[k] for k in fit.atoms]
        # However bad the fit, the error is at most that of the prior.
        sizes = amplitude * scale, np.minimum(spread, 1.0) * scale
        for atom, size, error in zip(atoms, *sizes, strict=True):
            numbers = float(size), float(error), atom.effect.unit
            parameters[f"{atom.effect.id}: amplitude"] = Amplitude(*numbers, case.formula(atom))
        family = " + ".join(dict.fromkeys(atom.effect.family for atom in atoms))
        candidate = Candidate(
            effects=key, family=family, probability=total[key], parameters=parameters
        )
        listed.append(candidate)
    if not verdict.names_an_effect and (alone := verdict.left.unlisted) > 1e-3:
        listed.append(Candidate(effects=(UNKNOWN,), family=UNKNOWN, probability=alone))
    return tuple(listed)


def _chances(case: Concluded, unlisted: float) -> dict[tuple[str, ...], float]:
    """Probability of every refitted set by the evidence; of a named one that of the verdict.

    Args:
        unlisted: stated probability of an unlisted effect.
    """
    verdict = case.verdict
    claims = verdict.status not in (Status.NONE, Status.UNKNOWN)
    named = {verdict.key: verdict.probability} if claims else {}
    others = {k: p for k, p in case.weighed.listed.items() if k and k not in named}
    rest = 1 - max(verdict.unlisted, unlisted)
    if verdict.status != Status.INCOMPLETE:  # else the named set is beside an unlisted effect
        rest -= sum(named.values())
    if verdict.status == Status.NONE:
        rest *= 1 - case.weighed.nothing_shown
    scale = min(rest / max(sum(others.values()), ROUNDING), 1.0)
    return {k: scale * p for k, p in others.items()} | named
