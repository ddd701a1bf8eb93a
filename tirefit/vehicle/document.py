"""The diagnosis of a car as the record that diagnoses of forces have. The car as given is a
simulator, whose parameters are factors on its tires; the first channel is all channels of the
log over their noise."""

import hashlib
import importlib.metadata
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

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
    parameter_errors,
)
from tirefit.diagnosis.summary.document import candidates_of, resolution, verdict_of
from tirefit.diagnosis.summary.forecast import confusion, manoeuvres
from tirefit.diagnosis.summary.result import (
    Diagnosis,
    Gap,
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
from tirefit.vehicle.windows import CHANNELS, UNITS, CutLog

ALL = "all"
"""The first channel: all channels, in the unit of their noise."""


class CarExtension(NamedTuple):
    """What the amplitudes refer to: the number of the form of each fitted effect, and the mean
    speed [m/s] of the logs."""

    variants: Mapping[str, int]
    speed: PositiveFloat


def document_of(
    case: Concluded,
    found: Mapping[str, CutLog],
    other: Windows | None,
    vehicle: str | Path,
    model: str,
    notes: Sequence[str],
    holdout: Mapping[str, CutLog],
    library: Sequence[Effect],
    seed: int,
) -> Diagnosis:
    """The document of the verdict on the windows of the logs ``found``.

    Args:
        other: the windows of the logs ``holdout``, None without.
        vehicle: the file of the car, or its name.
        model: the car and its tires in words.
        notes: what was assumed.
        library: effects that were looked for.
    """
    base, generator = case.base, np.random.default_rng(seed)
    names, ladder, gaps = CHANNELS[base.model.channels], case.ladder, dict[str, Shrinkage]()
    errors = _Errors(base, base.given_residual)
    held = of_the_ladder(ladder)
    if other is not None:
        held, ladder = _held_out(case, ladder, other, ", ".join(holdout), generator)
    gaps = {c: errors.closure(c, case.chosen.residual, generator) for c in (ALL, *names)}
    gap = Gap(**vars(gaps[ALL]), channels=gaps, holdout=held)
    z, spread = case.chosen.z, parameter_errors(case)
    factors = dict(zip(FACTORS, np.exp(z).tolist(), strict=True))
    changes = {
        name: changed(1.0, factor, float(factor * error))
        for (name, factor), error in zip(factors.items(), spread, strict=True)
    }
    budgets = _budgets(case, ladder, errors, generator)
    steps = manoeuvres(case.search, case.weighed, case.verdict)
    count = len(base.cut.log)
    length = (base.cut.data.logged.shape[1] - 1) * base.step
    of_windows = f"{count} windows of {length:g} s, each from the start state that fits best"
    return Diagnosis(
        data=DataSummary(
            name=", ".join(found),
            path=", ".join(log.path for log in found.values()),
            sha256=", ".join(log.sha256 for log in found.values()),
            convention="",
            channels=(ALL, *names),
            assumptions=(of_windows, *notes),
        ),
        units={ALL: "× noise", **{name: UNITS[name] for name in names}},
        model=model,
        simulator=SimulatorSummary("car", *_source(vehicle), Surrogate(model, 0.0, 0.0, 0.0)),
        n=len(errors.run),
        n_effective=len(errors.run) / base.inflation,
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
        candidates=candidates_of(case, lambda fit: errors.closure(ALL, fit.residual, generator)),
        untestable=case.untestable,
        resolution=resolution(base.unit, base.discrepancy.columns.shape[1]),
        forecast=tuple(confusion(case.search)),
        next_measurement=steps,
        base_parameters=dict.fromkeys(FACTORS, 1.0),
        extended_parameters=factors,
        extension=CarExtension(
            {a.effect.id: a.variant for a in (base.atoms[k] for k in case.chosen.atoms)},
            float(np.mean(base.cut.data.v_x)),
        ),
        settings=Settings(
            rig=None,
            effects=tuple(effect.id for effect in library),
            holdout=tuple(log.sha256 for log in holdout.values()),
        ),
        seed=seed,
        version=importlib.metadata.version("tirefit"),
        library=tuple(library),
        meanings={name: "{1} of the {0} tires".format(*name.split(".")) for name in FACTORS},
    )


def _source(vehicle: str | Path) -> tuple[str, str | None]:
    """The file of a car, and its hash."""
    path = Path(vehicle)
    return str(vehicle), hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else None


class _Errors:
    """Errors of the car as given, over the noise: ``of`` (n, c), and the log ``run`` (n,) of
    each sample."""

    def __init__(self, base: Windows, given: np.ndarray):
        self.base, self.of = base, base.over_noise(given)
        self.run = np.repeat(base.cut.log, base.cut.data.logged.shape[1])

    def closure(self, channel: str, residual: np.ndarray, generator) -> Shrinkage:
        """Closure of the gap of a channel where a fit has these whitened residuals (m,)."""
        before, after, run, noise = self.of, self.base.over_noise(residual), self.run, 1.0
        if channel == ALL:
            run = np.repeat(run, before.shape[1])
        else:
            k = CHANNELS[self.base.model.channels].index(channel)
            before, after, noise = before[:, k], after[:, k], self.base.noise[k]
        given = noise * before.ravel(), noise * after.ravel(), np.full(before.size, noise**2)
        return closure_elsewhere(*given, run, self.base.inflation, generator)


def _held_out(case: Concluded, ladder: Ladder, other: Windows, on: str, generator):
    """Closure on held-out logs, and the ladder with the closure of each step there."""
    null = case.weighed.best_of[()]
    other = other.following(replace(null, state=other.cut.data.start))
    fits = fits_of(case, ladder)
    coefficients = {AS_GIVEN: other.coefficients()} | {
        key: other.coefficients(fit.z, fit.atoms, fit.amplitude) for key, fit in fits.items()
    }
    errors = {key: other.residual_of(z) for key, z in coefficients.items()}
    closure = _Errors(other, errors[AS_GIVEN]).closure(ALL, errors[case.verdict.key], generator)
    missed = {key: other.over_noise(own).ravel() for key, own in errors.items()}
    return on_files(ladder, closure, missed, 1.0, on)


def _budgets(
    case: Concluded, ladder: Ladder, errors: _Errors, generator
) -> dict[str, tuple[Part, ...]]:
    """Parts of the energy of each channel in the order of the ladder: the parameters of the
    tires, the effects, the remainder and the noise."""
    base, fits = case.base, fits_of(case, ladder)
    names = [PARAMETERS, *(" + ".join({*b} - {*a}) for a, b in pairwise(fits))]
    residuals = [errors.of, *(base.over_noise(fit.residual) for fit in fits.values())]
    energy = np.square(residuals)  # (steps, n, c)
    each = {ALL: (1.0, energy.mean(axis=2))}
    for k, name in enumerate(CHANNELS[base.model.channels]):
        each[name] = base.noise[k], base.noise[k] ** 2 * energy[:, :, k]
    fitted = len(case.chosen.pull) * base.inflation / errors.of.size
    found = {}
    for channel, (noise, own) in each.items():
        parts = dict(zip(names, -np.diff(own, axis=0), strict=True))
        floor = np.full(len(errors.run), noise**2 * max(1 - fitted, 0.0))
        rest = own[-1], floor, own[0]
        found[channel] = budget(parts, rest, errors.run, base.inflation, generator)
    return found
