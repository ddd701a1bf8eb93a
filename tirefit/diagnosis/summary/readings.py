"""Two readings of a simulator: the simulator, changed; and both described, the measured rows and
the simulator's forces, by the same model with effects. A simulator that is far from the rows keeps
its structure in every prediction of the first; the second does not need it."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tirefit.diagnosis.engine.decide import floor_of
from tirefit.diagnosis.engine.left_out import OWN_MODEL, Step, closed_share, predicted
from tirefit.diagnosis.rows.fits import FARTHEST_OFF, as_measured, missed_share
from tirefit.diagnosis.rows.prepared import Prepared, prepare
from tirefit.diagnosis.rows.rig import Rig
from tirefit.diagnosis.rows.structure import UNLIKE, Structure, rms, slip_behind, structures_of
from tirefit.diagnosis.summary.case import Case
from tirefit.diagnosis.summary.result import Described, Diagnosis, Estimate, Readings
from tirefit.models import TireInputs, forces
from tirefit.params import with_values
from tirefit.results import DataError

SLOPE = "slope at zero slip"
"""Name of the slope of the force over the slip in a description."""

_STEP, _SMALL = 1e-4, 1e-3
"""Steps of a parameter z, and of the slip over its standard deviation, for slopes."""

_EXACT = 0.005
"""Noise given to simulated forces, over their rms: the error of a description that is exact."""


def with_readings(
    result: Diagnosis,
    case: Case,
    whole: Prepared,
    rig: Rig,
    model: str,
    study: Callable[[Prepared, Rig], Case],
) -> Diagnosis:
    """The diagnosis of a simulator with both readings, and with the step of its ladder that the
    second one makes; without them if the model cannot be fitted.

    Args:
        case: the simulator, changed.
        whole: rows of the case.
        model: that describes both; ``study`` diagnoses rows with it.
    """
    given, simulator = case.base.simulator, result.simulator
    assert given is not None and simulator is not None, "the diagnosis is that of a simulator"
    followed = all(
        missed_share(whole, c, np.asarray(x)[: whole.n]) <= FARTHEST_OFF
        for c, x in case.base.design.offset.items()
    )
    try:
        described = study(whole, rig)
    except DataError:
        if not followed:
            raise
        return result
    # The same parts are left out of both.
    folds = case.base.folds(case.weighed.best)
    search = described.search
    chosen = described.chosen
    left = predicted(search.subject, [chosen], search.null, folds).sets[chosen.key].loss
    out, changed = case.predicted, _loss(case)
    share = out.rows / out.rows.sum()
    gains = share * (changed - left)
    gain, error = float(gains.sum()), float(np.sqrt(len(gains)) * np.std(gains, ddof=1))
    structure, itself = structures_of(whole), None
    if not any(feature.id in UNLIKE for feature in structure):
        itself = _of_simulator(whole, rig, study, structure)
    closed = closed_share(out.rows, left, out.first, floor_of(case.base, out))
    step = Step(OWN_MODEL, float(np.sqrt(share @ left)), *closed, gain, error)
    # Where both predict alike, the one that does not depend on a stand-in for the simulator.
    rough = given.given.tire is None and given.stand_in != model
    likelier = gain > (-error if rough else error)
    both = Readings(
        first="described" if likelier or not followed else "changed",
        gain=gain,
        gain_std=error,
        rms_changed=float(np.sqrt(share @ changed)),
        model=model,
        measured=_described(described, step.rms_left_out),
        simulator=itself,
        structure=structure,
    )
    *steps, smooth, noise = result.ladder.steps
    ladder = result.ladder._replace(steps=(*steps, step, smooth, noise))
    return replace(result, ladder=ladder, simulator=simulator._replace(readings=both))


def _of_simulator(
    whole: Prepared, rig: Rig, study: Callable[..., Any], structure: Sequence[Structure]
) -> Described | None:
    """The description of the simulator's own forces, which have next to no noise."""
    data = as_measured(whole.data, whole.channels)
    generator, noise, columns = np.random.default_rng(0), {}, dict(data.columns)
    if any(fault.id == "no_load" for fault in structure):  # it has the same load in every row
        columns["fz"] = np.full(len(data), np.mean(data.usable("fz")))
    for late in (fault.late for fault in structure if fault.late):  # of the slip that it follows
        columns[late.column] = np.full(len(data), np.nan)
        columns[late.column][data.used] = slip_behind(data, late)
        data = data.where(np.isfinite(columns[late.column]))
    for channel in whole.channels:
        noise[channel] = _EXACT * float(np.sqrt(np.nanmean(data.usable(channel) ** 2)))
        columns[channel] = columns[channel] + noise[channel] * generator.standard_normal(len(data))
    rig = replace(rig, noise=noise)
    try:
        case = study(prepare(replace(data, columns=columns), rig, whole.channels), rig)
    except DataError:
        return None
    rows, main = case.predicted.rows, case.base.rows.channels[0]
    missed = float(np.sqrt(rows @ _loss(case) / rows.sum()))
    if missed > FARTHEST_OFF * rms(case.base.rows.observed[main]):
        return None  # parameters of a model that does not follow it mislead
    return _described(case, missed)


def _loss(case: Case) -> np.ndarray:
    """Mean square error (F,) of the effects that help on each part that was left out."""
    return case.predicted.sets[case.verdict.key].loss


def _described(case: Case, rms: float) -> Described:
    base, p, (z, spread) = case.base, len(case.chosen.z), case.parameters
    values = zip(base.tire.layout.labels, *case.natural, strict=True)
    units = {p.name: p.spec.unit for p in base.tire.layout.free}
    parameters = {k: Estimate(float(v), float(e), units.get(k, "")) for k, v, e in values}
    steps = _STEP * np.eye(p)
    slope = np.array([_slope(case, z + step) - _slope(case, z - step) for step in steps])
    covariance = case.chosen.covariance[:p, :p]
    slope = slope * spread / np.sqrt(np.diag(covariance))  # as uncertain as the averages are
    error = np.sqrt(slope @ covariance @ slope) / (2 * _STEP)
    unit = "N" if base.rows.mode == "x" else "N/rad"
    parameters[SLOPE] = Estimate(_slope(case, z), float(error), unit)
    effects = {}
    for atom, size, std in zip(case.chosen.atoms, *case.sizes, strict=True):
        effect, scale = base.atoms[atom].effect, float(base.priors.scale[atom])
        if (each := case.verdict.each.get(effect.id)) is not None:
            amplitude = float(size) * scale, float(std) * scale
            effects[effect.id] = Estimate(*amplitude, effect.unit, each.probability)
    return Described(parameters, effects, rms)


def _slope(case: Case, z: np.ndarray) -> float:
    """Slope of the force over the slip at zero slip and the mean load."""
    tire, rows = case.base.tire, case.base.rows
    along, small = rows.mode == "x", _SMALL * float(np.std(rows.slip))
    state = {c: float(np.mean(rows.column(c))) for c in ("fz", "v") if c in rows.data}
    state["sigma_x" if along else "alpha"] = small
    force = forces(with_values(tire.model, tire.layout.natural(z)), TireInputs(**state))
    return float(np.asarray(force.fx if along else force.fy)) / small
