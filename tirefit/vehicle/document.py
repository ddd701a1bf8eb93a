"""The diagnosis of a car as the record that diagnoses of forces have. The car as given is a
simulator, whose parameters are factors on its tires; the first channel is all channels of the
log over their noise."""

import importlib.metadata
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import PositiveFloat

from tirefit.diagnosis.effects import Effect
from tirefit.diagnosis.engine.left_out import AS_GIVEN, Ladder
from tirefit.diagnosis.summary.case import Concluded
from tirefit.diagnosis.summary.closure import (
    PARAMETERS,
    budget,
    changed,
    closure_elsewhere,
    fits_of,
    of_the_ladder,
    on_files,
)
from tirefit.diagnosis.summary.document import candidates_of, resolution, verdict_of
from tirefit.diagnosis.summary.forecast import confusion, manoeuvres
from tirefit.diagnosis.summary.result import (
    Diagnosis,
    Gap,
    HeldOut,
    NoiseSummary,
    Part,
    Settings,
    Shrinkage,
    SimulatorSummary,
    Surrogate,
)
from tirefit.diagnosis.summary.views import DataSummary
from tirefit.vehicle.model import PARAMETERS as FACTORS
from tirefit.vehicle.subject import Windows
from tirefit.vehicle.windows import CHANNELS, CutLog

ALL = "all"
"""The first channel: all channels, in the unit of their noise."""


class CarExtension(NamedTuple):
    """What the amplitudes refer to: the number of the form of each fitted effect, and the mean
    speed [m/s] of the logs."""

    variants: Mapping[str, int]
    speed: PositiveFloat


def document_of(
    case: Concluded,
    found: Mapping[str, CutLog[Any]],
    others: tuple[Mapping[str, CutLog[Any]], Windows] | None,
    vehicle: str | Path,
    model: str,
    notes: Sequence[str],
    library: Sequence[Effect],
    seed: int,
) -> Diagnosis:
    """The document of the verdict on the windows of the logs ``found``.

    Args:
        others: logs that were held out, and their windows; None without.
        vehicle: the file of the car, or its name.
        model: the car and its tires in words.
        notes: what was assumed.
        library: effects that were looked for.
    """
    base, generator, ladder = case.base, np.random.default_rng(seed), case.ladder
    held = of_the_ladder(ladder)
    if others is not None:
        held, ladder = _held_out(case, ladder, *others, generator)
    hashes = tuple(log.sha256 for log in (others[0] if others else {}).values())
    left, (z, spread) = case.chosen.residual, case.parameters
    gaps = {c: _closure(base, c, base.given_residual, left, generator) for c in _channels(base)}
    gap = Gap(**vars(gaps[ALL]), channels=gaps, holdout=held)
    factors = dict(zip(FACTORS, np.exp(z).tolist(), strict=True))
    std = np.exp(z) * spread
    changes = {
        name: changed(1.0, factor, float(error))
        for (name, factor), error in zip(factors.items(), std, strict=True)
    }
    budgets = _budgets(case, ladder, generator)
    rows, names = base.cut.data.v_x.size, CHANNELS[base.model.channels]
    return Diagnosis(
        data=_data(base, found, notes),
        model=model,
        simulator=SimulatorSummary("car", str(vehicle), None, Surrogate(model, 0.0, 0.0, 0.0)),
        n=rows,
        n_effective=rows / base.inflation,
        noise=NoiseSummary(
            forces=dict(zip(names, base.noise.tolist(), strict=True)),
            source="what all effects together leave",
            inflation=base.inflation,
        ),
        gap=gap,
        budget=budgets[ALL],
        budgets=budgets,
        verdict=verdict_of(case, gap, changes),
        ladder=ladder,
        candidates=candidates_of(
            case, lambda fit: _closure(base, ALL, base.given_residual, fit.residual, generator)
        ),
        untestable=case.untestable,
        resolution=resolution(base.unit, base.discrepancy.columns.shape[1]),
        forecast=tuple(confusion(case.search)),
        next_measurement=manoeuvres(case.search, case.weighed, case.verdict),
        base_parameters=dict.fromkeys(FACTORS, 1.0),
        extended_parameters=dict(zip(FACTORS, np.exp(case.chosen.z).tolist(), strict=True)),
        extension=CarExtension(
            {base.atoms[k].effect.id: base.atoms[k].variant for k in case.chosen.atoms},
            float(np.mean(base.cut.data.v_x)),
        ),
        settings=Settings(rig=None, effects=tuple(e.id for e in library), holdout=hashes),
        seed=seed,
        version=importlib.metadata.version("tirefit"),
        library=tuple(library),
        meanings={name: "{1} of the {0} tires".format(*name.split(".")) for name in FACTORS},
    )


def _data(base: Windows, found: Mapping[str, CutLog[Any]], notes: Sequence[str]) -> DataSummary:
    """The logs, and what was assumed."""
    count, length = len(base.cut.log), (base.cut.data.v_x.shape[1] - 1) * base.step
    of_windows = f"{count} windows of {length:g} s, each from the start state that fits best"
    return DataSummary(
        name=", ".join(found),
        path=", ".join(log.path for log in found.values()),
        sha256=", ".join(log.sha256 for log in found.values()),
        convention="",
        channels=tuple(_channels(base)),
        assumptions=(of_windows, *notes),
    )


def _channels(base: Windows) -> dict[str, tuple[float, slice]]:
    """Channel -> its unit over the noise, and its columns of ``base.over_noise``."""
    names = CHANNELS[base.model.channels]
    each = {name: (base.noise[k], slice(k, k + 1)) for k, name in enumerate(names)}
    return {ALL: (1.0, slice(None)), **each}


def _closure(
    base: Windows,
    channel: str,
    before: np.ndarray,
    after: np.ndarray,
    generator: np.random.Generator,
) -> Shrinkage:
    """Closure of the gap of a channel from whitened residuals (m,) to others."""
    unit, own = _channels(base)[channel]
    before, after = (unit * base.over_noise(x)[:, own].ravel() for x in (before, after))
    run = np.repeat(base.cut.log, before.size // len(base.cut.log))
    variance = np.full(before.size, unit**2)
    return closure_elsewhere(before, after, variance, run, base.inflation, generator)


def _held_out(
    case: Concluded,
    ladder: Ladder,
    logs: Mapping[str, CutLog[Any]],
    other: Windows,
    generator: np.random.Generator,
) -> tuple[HeldOut, Ladder]:
    """Closure on held-out logs, and the ladder with the closure of each step there."""
    null = case.weighed.best_of[()]
    other = other.following(replace(null, state=other.cut.data.start))
    left = {AS_GIVEN: other.given_residual} | {
        key: other.residual_of(other.coefficients(fit.z, fit.atoms, fit.amplitude))
        for key, fit in fits_of(case, ladder).items()
    }
    closure = _closure(other, ALL, left[AS_GIVEN], left[case.verdict.key], generator)
    missed = {key: other.over_noise(one).ravel() for key, one in left.items()}
    return on_files(ladder, closure, missed, 1.0, ", ".join(logs))


def _budgets(
    case: Concluded, ladder: Ladder, generator: np.random.Generator
) -> dict[str, tuple[Part, ...]]:
    """Parts of the energy of each channel in the order of the ladder: the parameters of the
    tires, the effects, the remainder and the noise."""
    base, fits, found = case.base, fits_of(case, ladder), {}
    names = [PARAMETERS, *(" + ".join({*b} - {*a}) for a, b in pairwise(fits))]
    left = [base.given_residual, *(fit.residual for fit in fits.values())]
    squares = np.square([base.over_noise(one) for one in left])
    run = np.repeat(base.cut.log, base.cut.data.v_x.shape[1])
    fitted = len(case.chosen.pull) * base.inflation / squares[0].size
    for channel, (unit, own) in _channels(base).items():
        energy = unit**2 * squares[:, :, own].mean(axis=2)
        parts = dict(zip(names, -np.diff(energy, axis=0), strict=True))
        floor = np.full(len(run), unit**2 * max(1 - fitted, 0.0))
        rest = energy[-1], floor, energy[0]
        found[channel] = budget(parts, rest, run, base.inflation, generator)
    return found
