"""Find the effects that the model of a car lacks: :func:`diagnose_vehicle`.

The motion of the car is predicted over windows of measured logs. Its errors are explained
by sets of effects of steering, masses, ground, drive, tires and the log, fitted together
with factors on stiffness and friction of both axles' tires. Evidence, prediction of data
left out and decision are those of a diagnosis of forces.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np

from tirefit import __version__
from tirefit.data.merged import merged
from tirefit.data.vehicle import Vehicle
from tirefit.diagnosis.effects import Effect, atoms_of
from tirefit.diagnosis.engine.decide import (
    Verdict,
    calibration,
    decide,
    findings_of,
    floor_of,
    predictions,
)
from tirefit.diagnosis.engine.fit import Fit
from tirefit.diagnosis.engine.left_out import (
    Ladder,
    Predicted,
    SizeByGroup,
    jackknife_error,
    ladder_of,
)
from tirefit.diagnosis.engine.search import Effort, Search, searched
from tirefit.diagnosis.summary.document import sizes_of
from tirefit.diagnosis.summary.result import NOT_WRITTEN, Amplitude, mappings
from tirefit.display import Record
from tirefit.files import json_safe
from tirefit.fitting.mf.result import TireLike
from tirefit.fitting.source import GivenTire, axle_tire
from tirefit.precision import require_x64
from tirefit.results import DataError, InputProblem, Outcome, UsageError, did_you_mean
from tirefit.vehicle.car import car_of
from tirefit.vehicle.effects import CAR_EFFECTS
from tirefit.vehicle.model import PARAMETERS, Model
from tirefit.vehicle.subject import Windows
from tirefit.vehicle.trajectory import started
from tirefit.vehicle.windows import (
    CHANNELS,
    LEAST_WINDOWS,
    Cut,
    CutLog,
    cut_in_windows,
    derived_rows,
    joined_windows,
    known_vehicle,
    steering_problems,
)

SCHEMA = "tirefit.vehicle_diagnosis/1"

WINDOW = 1.0
"""Length [s] of a window."""

EFFORT = Effort(singles=8, variants=1, beam=2, width=3, pairs=2, near=5.0)
"""Sets that are refitted: fewer than for rows, as a refit integrates the car."""

_ROUNDS = 2
"""Number of times that the noise is estimated for the car without effects."""

_STEPS = 40
"""Usual number of refits of a search."""

_OTHER_NOISE = 0.25
"""Change of the log noise above which the search is repeated."""


class Miss(NamedTuple):
    """Rms of predicted - logged by channel over windows, each from its best start state:
    of the car as given, with fitted tires, and with the effects."""

    as_given: Mapping[str, float]
    fitted: Mapping[str, float]
    with_effects: Mapping[str, float]


@dataclass(frozen=True, repr=False)
class VehicleDiagnosis(Record):
    """The result of :func:`diagnose_vehicle`.

    Attributes:
        logs: names of the logs; windows: number of windows of ``window`` seconds.
        verdict: which effects are there, and what is left.
        ladder: how the rms over the noise shrinks on windows left out.
        sizes: of each named effect by groups of each covariate, the most unequal first.
        amplitudes: of each named effect; variants: the number of its form; speed: mean
            speed [m/s], to which effects of the speed refer.
        parameters: factor on each number of the tires in the fit of the named effects.
        noise: channel -> noise of the log: the remainder of all effects together.
        miss: errors on these logs; held_out: errors on held-out logs, None without.
        untestable: effect -> the data that the logs lack.
        effects: the records that were looked for, by id.
        notes: what was assumed.
    """

    text_by: ClassVar[str] = "tirefit.report.vehicle_diagnosis:vehicle_diagnosis_text"
    plot_by: ClassVar[str] = "tirefit.report.vehicle_diagnosis:vehicle_diagnosis_figure"

    logs: tuple[str, ...]
    windows: int
    window: float
    verdict: Verdict
    ladder: Ladder
    sizes: Mapping[str, tuple[SizeByGroup, ...]]
    amplitudes: Mapping[str, Amplitude]
    variants: Mapping[str, int]
    speed: float
    parameters: Mapping[str, Amplitude]
    noise: Mapping[str, float]
    miss: Miss
    held_out: Miss | None
    untestable: Mapping[str, tuple[str, ...]]
    effects: Mapping[str, Effect] = field(metadata=NOT_WRITTEN)
    notes: tuple[str, ...]

    @property
    def limits(self) -> dict[Outcome, str]:
        """Where the answer of ``verdict`` is open."""
        return self.verdict.status.limits

    @property
    def probability(self) -> float:
        """Share of verdicts of this status and probability that are right."""
        return calibration().often(self.verdict.status.value, self.verdict.probability)

    def to_dict(self) -> dict[str, Any]:
        """All numbers, as in ``vehicle_diagnosis.json``."""
        verdict = mappings(self.verdict) | {"probability": self.probability}
        ladder = {"left_out": self.ladder.on, "steps": mappings(self.ladder.steps)}
        content = {"schema": SCHEMA, "version": __version__, **mappings(self)}
        return json_safe(content | {"verdict": verdict, "ladder": ladder})

    def files(self, name: str = "") -> dict[str, str]:
        """``vehicle_diagnosis.json``."""
        return {"vehicle_diagnosis.json": self.to_json()}


def diagnose_vehicle(
    logs: Sequence[str | Path],
    vehicle: Vehicle | str | Path,
    front: TireLike | GivenTire = "brush",
    rear: TireLike | GivenTire = "brush",
    *,
    effects: Sequence[Effect] | None = None,
    without: Sequence[str] = (),
    holdout: Sequence[str | Path] = (),
    window: float = WINDOW,
    progress: Callable[[float, str], None] | None = None,
) -> VehicleDiagnosis:
    """Find the effects that the model of a car on these tires lacks, from measured logs.

    The car is predicted over windows of the logs, with speed and steering as measured.
    Sets of effects are fitted to the errors, together with factors on stiffness and
    friction of both axles' tires, and weighed as in :func:`tirefit.diagnose`.

    Args:
        logs: vehicle logs, as for :func:`tirefit.derive_files`.
        vehicle: a vehicle or its ``vehicle.toml``, with a steering map.
        front: tire of the axle, as for :func:`tirefit.replay`; a model by its name is
            first fitted to the forces that ``derive`` gives.
        rear: likewise.
        effects: to look for; all of the library by default.
        without: ids of effects that are not looked for.
        holdout: logs that only check the answer.
        window: length [s] of the stretches that are predicted.
        progress: called with the share done and the present step.

    Returns:
        ``verdict`` as in :class:`tirefit.Diagnosis`; ``amplitudes``; ``miss``: errors of
        the car as given, with fitted tires, and with the effects.

    Raises:
        UsageError: a vehicle without a steering map, an id that is none.
        DataError: a log that cannot be read, or none whose stretches are long enough.

    Example:
        >>> log, car = samples / "drive.csv", samples / "vehicle.toml"
        >>> from tirefit.vehicle.effects import CAR_EFFECTS
        >>> few = [one for one in CAR_EFFECTS if one.id == "steering_delay"]
        >>> found = diagnose_vehicle([log], car, effects=few)
        >>> str(found.verdict.status), found.windows
        ('none', 9)
    """
    require_x64("a diagnosis")
    vehicle, effects = known_vehicle(vehicle), CAR_EFFECTS if effects is None else effects
    _check(vehicle, effects, without)
    given = axle_tire(front), axle_tire(rear)
    tell = Steps(progress, _STEPS)
    tell("reading logs")
    found = cut_in_windows(logs, vehicle, window)
    others = cut_in_windows(holdout, vehicle, window) if holdout else None
    tires = [
        started(tire, derived_rows(found, vehicle, axle))
        for axle, tire in zip(("front", "rear"), given, strict=True)
    ]
    library = [e for e in effects if e.id not in without]
    subject, untestable = subject_of(found, vehicle, tires, library)
    windows = subject.cut
    _enough(windows, window)
    tell("the car without effects")
    base, search = _searched(replace(subject, tick=partial(tell, "sets of effects")))
    tell("data left out")
    weighed, out = predictions(search)
    verdict = decide(findings_of(search, weighed, out))
    null, best = weighed.best_of[()], weighed.best_of[verdict.key]
    held_out = None
    if others is not None:
        other = replace(subject_of(others, vehicle, tires, library)[0], noise=base.noise)
        started_there = replace(null, state=other.cut.data.start)
        held_out = _miss(other.following(started_there), null, best)
    return VehicleDiagnosis(
        tuple(found),
        len(windows.log),
        window,
        verdict,
        ladder_of(out, verdict.key, floor_of(base, out)),
        sizes_of(best, base.model.scales, base.groups()),
        _amplitudes(base, best, _errors(best, out)),
        {a.effect.id: a.variant for a in (base.atoms[k] for k in best.atoms)},
        float(np.mean(windows.data.v_x)),
        _parameters(best),
        _by_channel(base, base.noise),
        _miss(base, null, best),
        held_out,
        untestable,
        {effect.id: effect for effect in effects},
        (*_notes(given, tires), *merged((k, log.missing) for k, log in found.items())),
    )


class Steps:
    """Reports steps and their share in about ``count`` of them, slower near the end."""

    def __init__(self, report: Callable[[float, str], None] | None, count: int):
        self.report, self.count, self.done = report or (lambda share, note: None), count, 0

    def __call__(self, note: str) -> None:
        self.done += 1
        self.report(self.done / (self.done + max(self.count - self.done, 0.1 * self.done)), note)


def _searched(subject: Windows) -> tuple[Windows, Search]:
    """The subject with its noise, and the search of the effects. The search is repeated if
    the remainder of its best set shows another noise."""
    subject = replace(subject, noise=subject.rms(subject.coefficients()))
    for _ in range(_ROUNDS):
        subject = subject.following(subject.refit([subject.start], [()])[0])
        fit = subject.refit([subject.start], [()])[0]
        subject = subject.with_noise_of(fit)
    search = searched(subject, EFFORT)
    judged = subject.with_noise_of(search.ranked[0])
    wide = (one.noise * np.sqrt(one.inflation) for one in (judged, subject))
    if np.any(np.abs(np.log(np.divide(*wide))) > _OTHER_NOISE):
        subject = judged
        search = searched(subject, EFFORT)
    return subject, search


def _errors(fit: Fit, out: Predicted) -> np.ndarray:
    """Standard errors of the amplitudes, in prior scales: from the curvature, or from the
    jackknife over the parts left out if that is larger."""
    if fit.key not in out.effects:
        return fit.errors
    left_out = jackknife_error(out.amplitude[out.effects.index(fit.key)])
    return np.maximum(fit.errors, left_out)


def _enough(windows: Cut, window: float) -> None:
    count = len(windows.log)
    if count < LEAST_WINDOWS:
        reason = f"{count} windows of {window:g} s; a diagnosis needs {LEAST_WINDOWS}"
        raise DataError(InputProblem(reason, "give longer logs, or more of them"))


def _by_channel(base: Windows, values) -> dict[str, float]:
    names = CHANNELS[base.model.channels]
    return dict(zip(names, map(float, values), strict=True))


def _miss(base: Windows, null: Fit, best: Fit) -> Miss:
    each = (), (null.z,), (best.z, best.atoms, best.amplitude)
    return Miss(*(_by_channel(base, base.rms(base.coefficients(*one))) for one in each))


def _notes(given, tires) -> tuple[str, ...]:
    notes = ["speed and steering are those of the log; axle loads are static"]
    notes += [
        f"the {axle} tire, {tire.name}, starts as fitted to the forces of derive"
        for axle, tire, of in zip(("front", "rear"), tires, given, strict=True)
        if tire is not of
    ]
    return tuple(notes)


def _check(vehicle: Vehicle, effects, without) -> None:
    problems = steering_problems(vehicle, "a diagnosis of a vehicle")
    known = [effect.id for effect in effects]
    for name in sorted({*without} - {*known}):
        remedy = f"{did_you_mean(name, known)}known effects: {', '.join(known)}"
        problems.append(InputProblem(f"no effect {name!r} of a vehicle", remedy))
    UsageError.raise_for(problems)


def subject_of(
    found: Mapping[str, CutLog], vehicle: Vehicle, tires, library: Sequence[Effect]
) -> tuple[Windows, dict[str, tuple[str, ...]]]:
    """The subject of a diagnosis of cut logs with unit noise, and the needs that they do
    not meet, by effect."""
    cut, has = joined_windows(found, vehicle, tires)
    lacks = {e.id: tuple(n for n in e.needs if n not in has) for e in library}
    lacks = {name: needs for name, needs in lacks.items() if needs}
    atoms = atoms_of(library)
    model = Model(atoms, tuple(a.effect.scale for a in atoms), cut.data.logged.shape[-1])
    testable = tuple(k for k, a in enumerate(atoms) if a.effect.id not in lacks)
    car = car_of(vehicle, tires[0].tire, tires[1].tire)
    step = 1 / vehicle.filter.sample_rate
    return Windows(model, car, cut, step, testable, np.ones(model.channels)), lacks


def _amplitudes(base: Windows, fit: Fit, std: np.ndarray) -> dict[str, Amplitude]:
    found = {}
    for k, size, error in zip(fit.atoms, fit.amplitude, std, strict=True):
        atom, scale = base.atoms[k], base.model.scales[k]
        values = float(scale * size), float(scale * error), atom.effect.unit
        found[atom.effect.id] = Amplitude(*values, atom.formula(None, None))
    return found


def _parameters(fit: Fit) -> dict[str, Amplitude]:
    std = np.sqrt(np.diag(fit.covariance))
    factors = np.exp(fit.z)
    return {
        name: Amplitude(float(factor), float(factor * error), "-")
        for name, factor, error in zip(PARAMETERS, factors, std, strict=False)
    }
