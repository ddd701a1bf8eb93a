"""Find the effects that the model of a car lacks: :func:`diagnose_vehicle`.

The motion of the car is predicted over windows of measured logs. Its errors are explained
by sets of effects of steering, masses, ground, drive, tires and the log, fitted together
with factors on stiffness and friction of both axles' tires. Evidence, prediction of data
left out and decision are those of a diagnosis of forces.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tirefit.data.merged import merged
from tirefit.data.vehicle.vehicle import Vehicle
from tirefit.diagnosis.effects import Effect, atoms_of
from tirefit.diagnosis.engine.search import Effort, Search, searched
from tirefit.diagnosis.summary.case import Concluded
from tirefit.diagnosis.summary.result import Diagnosis
from tirefit.files import listed
from tirefit.fitting.mf.result import TireLike
from tirefit.fitting.source import GivenTire, axle_tire
from tirefit.precision import require_x64
from tirefit.results import DataError, InputProblem, UsageError, did_you_mean
from tirefit.vehicle.car import car_of
from tirefit.vehicle.document import document_of
from tirefit.vehicle.effects import CAR_EFFECTS
from tirefit.vehicle.model import Model
from tirefit.vehicle.start import started
from tirefit.vehicle.subject import Windows
from tirefit.vehicle.windows import (
    LEAST_WINDOWS,
    CutLog,
    cut_in_windows,
    derived_rows,
    joined_windows,
    known_vehicle,
    steering_problems,
)

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
    seed: int = 0,
    progress: Callable[[float, str], None] | None = None,
) -> Diagnosis:
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
        seed: of the intervals of closure and budget.
        progress: called with the share done and the present step.

    Returns:
        The record of :func:`tirefit.diagnose`, with the car as given as its simulator, factors
        on the tires as its parameters, and ``all`` channels over their noise as first channel.

    Raises:
        UsageError: a vehicle without a steering map, an id that is none.
        DataError: a log that cannot be read, or none whose stretches are long enough.

    Example:
        >>> log, car = samples / "drive.csv", samples / "vehicle.toml"
        >>> from tirefit.vehicle.effects import CAR_EFFECTS
        >>> few = [one for one in CAR_EFFECTS if one.id == "steering_delay"]
        >>> found = diagnose_vehicle([log], car, effects=few)
        >>> str(found.verdict.status), found.data.channels
        ('none', ('all', 'heading', 'x', 'y'))
    """
    require_x64("a diagnosis")
    stated, effects = known_vehicle(vehicle), CAR_EFFECTS if effects is None else effects
    without = listed(without)
    check_effects(stated, effects, without)
    given = axle_tire(front), axle_tire(rear)
    tell = Steps(progress, _STEPS)
    tell("reading logs")
    found = cut_in_windows(logs, stated, window)
    kept = cut_in_windows(holdout, stated, window) if holdout else {}
    tires = [
        started(tire, derived_rows(found, stated, axle))
        for axle, tire in zip(("front", "rear"), given, strict=True)
    ]
    library = [e for e in effects if e.id not in without]
    case, others = studied(found, stated, tires, library, window, tell), None
    if kept:
        noise = {"noise": case.base.noise, "inflation": case.base.inflation}
        others = kept, replace(subject_of(kept, stated, tires, library)[0], **noise)
    name = "vehicle" if isinstance(vehicle, Vehicle) else vehicle
    model = "car on {} (front) and {} (rear)".format(*(tire.name for tire in tires))
    notes = (*_notes(given, tires), *merged((k, log.missing) for k, log in found.items()))
    return document_of(case, found, others, name, model, notes, library, seed)


def studied(
    found: Mapping[str, CutLog[Any]],
    vehicle: Vehicle,
    tires: Sequence[GivenTire],
    library: Sequence[Effect],
    window: float,
    tell: "Steps",
) -> Concluded:
    """The verdict on the windows of cut logs, for a car on these tires."""
    subject, lacks = subject_of(found, vehicle, tires, library)
    if (count := len(subject.cut.log)) < LEAST_WINDOWS:
        reason = f"{count} windows of {window:g} s; a diagnosis needs {LEAST_WINDOWS}"
        raise DataError(reason, "give longer logs, or more of them")
    tell("the car without effects")
    search = _searched(replace(subject, tick=partial(tell, "sets of effects")))
    tell("data left out")
    return Concluded.of(search, lacks)


class Steps:
    """Reports steps and their share in about ``count`` of them, slower near the end."""

    def __init__(self, report: Callable[[float, str], None] | None, count: int) -> None:
        self.report, self.count, self.done = report or (lambda share, note: None), count, 0

    def __call__(self, note: str) -> None:
        self.done += 1
        self.report(self.done / (self.done + max(self.count - self.done, 0.1 * self.done)), note)


def _searched(subject: Windows) -> Search:
    """The search of the effects of a subject, with its noise; repeated if the remainder of its
    best set shows another noise."""
    subject = replace(subject, noise=subject.rms(subject.coefficients()))
    for _ in range(_ROUNDS):
        subject = subject.following(subject.refit([subject.start], [()])[0])
        fit = subject.refit([subject.start], [()])[0]
        subject = subject.with_noise_of(fit)
    search = searched(subject, EFFORT)
    judged = subject.with_noise_of(search.ranked[0])
    wide = (one.noise * np.sqrt(one.inflation) for one in (judged, subject))
    if np.any(np.abs(np.log(np.divide(*wide))) > _OTHER_NOISE):
        return searched(judged, EFFORT)
    return search


def _notes(given: tuple[GivenTire, ...], tires: Sequence[GivenTire]) -> tuple[str, ...]:
    fitted = (
        f"the {axle} tire, {tire.name}, starts as fitted to the forces of derive"
        for axle, tire, of in zip(("front", "rear"), tires, given, strict=True)
        if tire is not of
    )
    return "speed and steering are those of the log; axle loads are static", *fitted


def check_effects(vehicle: Vehicle, effects: Sequence[Effect], without: Sequence[str]) -> None:
    """Raise UsageError for a vehicle without a steering map, or ids that are none."""
    problems = steering_problems(vehicle, "a diagnosis of a vehicle")
    known = [effect.id for effect in effects]
    for name in sorted({*without} - {*known}):
        remedy = f"{did_you_mean(name, known)}known effects: {', '.join(known)}"
        problems.append(InputProblem(f"no effect {name!r} of a vehicle", remedy))
    UsageError.raise_for(problems)


def subject_of(
    found: Mapping[str, CutLog[Any]],
    vehicle: Vehicle,
    tires: Sequence[GivenTire],
    library: Sequence[Effect],
) -> tuple[Windows, dict[str, tuple[str, ...]]]:
    """The subject of a diagnosis of cut logs with unit noise, and the needs that they do
    not meet, by effect."""
    cut, has = joined_windows(found, vehicle, tires)
    lacks = {e.id: tuple(n for n in e.needs if n not in has) for e in library}
    lacks = {name: needs for name, needs in lacks.items() if needs}
    atoms = atoms_of(library)
    scales = tuple(a.effect.scale for a in atoms)
    stated = vehicle.steering.delay if vehicle.steering else 0.0
    model = Model(atoms, scales, cut.data.logged.shape[-1], stated)
    testable = tuple(k for k, a in enumerate(atoms) if a.effect.id not in lacks)
    car = car_of(vehicle, tires[0].tire, tires[1].tire)
    step = 1 / vehicle.filter.sample_rate
    return Windows(model, car, cut, step, testable, np.ones(model.channels)), lacks
