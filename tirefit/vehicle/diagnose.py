"""Find the effects that the model of a car lacks: :func:`diagnose_vehicle`.

The motion of the car is predicted over windows of measured logs. Its errors are explained
by sets of effects of steering, masses, ground, drive, tires and the log, fitted together
with factors on stiffness and friction of both axles' tires. Evidence, prediction of data
left out and decision are those of a diagnosis of forces, and so is the record: the car as given
is a simulator, whose parameters are factors on its tires; the first channel is all channels of
the log over their noise.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import PositiveFloat, model_validator

from tirefit.data.merged import merged
from tirefit.data.vehicle.motion import Motion
from tirefit.data.vehicle.vehicle import Vehicle
from tirefit.diagnosis.effects import Atom, Effect, atoms_of, effects_by_id
from tirefit.diagnosis.engine.left_out import AS_GIVEN, Ladder
from tirefit.diagnosis.engine.search import Effort, Search, searched
from tirefit.diagnosis.extended import AnyDocument, read_checked
from tirefit.diagnosis.summary.case import Concluded
from tirefit.diagnosis.summary.closure import changed, closure_of, fits_of, of_the_ladder, on_files
from tirefit.diagnosis.summary.document import of_any_subject
from tirefit.diagnosis.summary.forecast import manoeuvres
from tirefit.diagnosis.summary.result import (
    Diagnosis,
    HeldOut,
    NoiseSummary,
    Settings,
    Shrinkage,
    SimulatorSummary,
    Surrogate,
)
from tirefit.diagnosis.summary.views import DataSummary
from tirefit.files import listed
from tirefit.fitting.mf.result import TireLike
from tirefit.fitting.source import GivenTire, axle_tire
from tirefit.precision import require_x64
from tirefit.results import DataError, InputProblem, UsageError, did_you_mean
from tirefit.vehicle.car import AXLES, Changes, State, car_of
from tirefit.vehicle.effects import CAR_EFFECTS, Samples
from tirefit.vehicle.errors import Measured
from tirefit.vehicle.model import PARAMETERS as FACTORS
from tirefit.vehicle.model import Model, as_driven, steered
from tirefit.vehicle.subject import Windows
from tirefit.vehicle.windows import (
    CHANNELS,
    LEAST_WINDOWS,
    CutLog,
    cut_in_windows,
    joined_windows,
    known_vehicle,
    samples_of,
    started_tires,
    stated_delay,
    steering_problems,
)

WINDOW = 1.0
"""Length [s] of a window."""

EFFORT = Effort(singles=8, variants=1, beam=2, width=3, pairs=2, near=5.0)
"""Sets that are refitted: fewer than for rows, as a refit integrates the car."""

_ROUNDS = 2  # number of times that the noise is estimated for the car without effects

ALL = "all"
"""The first channel: all channels, in the unit of their noise."""


class CarExtension(NamedTuple):
    """What the amplitudes refer to: the number of the form of each fitted effect, and the mean
    speed [m/s] of the logs."""

    variants: Mapping[str, int]
    speed: PositiveFloat


Logs = Mapping[str, CutLog]
"""Name of a log -> its windows."""


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
        seed: of the intervals of closure.
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
        >>> few = [effect for effect in CAR_EFFECTS if effect.id == "steering_delay"]
        >>> result = diagnose_vehicle([log], car, effects=few)
        >>> str(result.verdict.status), result.data.channels
        ('none', ('all', 'heading', 'x', 'y'))
    """
    require_x64("a diagnosis")
    stated, effects = known_vehicle(vehicle), CAR_EFFECTS if effects is None else effects
    without = listed(without)
    check_effects(stated, effects, without)
    given = axle_tire(front), axle_tire(rear)
    tell = Steps(progress, 40)  # usual number of refits of a search
    tell("reading logs")
    log_windows = cut_in_windows(logs, stated, window)
    held_out = cut_in_windows(holdout, stated, window) if holdout else {}
    tires, _, _ = started_tires(given, log_windows, stated)
    library = [e for e in effects if e.id not in without]
    case, others = studied(log_windows, stated, tires, library, window, tell), None
    if held_out:
        noise = {"noise": case.base.noise, "inflation": case.base.inflation}
        others = held_out, replace(subject_of(held_out, stated, tires, library)[0], **noise)
    fitted = (
        f"the {axle} tire, {tire.name}, starts as fitted to the forces of derive"
        for axle, tire, of in zip(AXLES, tires, given, strict=True)
        if tire is not of
    )
    notes = ["speed and steering are those of the log; axle loads are static", *fitted]
    notes += merged((k, log.missing) for k, log in log_windows.items())
    name = "vehicle" if isinstance(vehicle, Vehicle) else str(vehicle)
    model = "car on {} (front) and {} (rear)".format(*(tire.name for tire in tires))
    return _document_of(case, log_windows, others, name, model, notes, library, seed)


def studied(
    log_windows: Logs,
    vehicle: Vehicle,
    tires: Sequence[GivenTire],
    library: Sequence[Effect],
    window: float,
    tell: "Steps",
) -> Concluded:
    """The verdict on the windows of cut logs, for a car on these tires."""
    subject, lacks = subject_of(log_windows, vehicle, tires, library)
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
    """The search of the effects of a subject, with its noise."""
    missed = subject.over_noise(subject.given_residual)
    subject = replace(subject, noise=subject.noise * np.sqrt(np.mean(missed**2, axis=0)))
    for _ in range(_ROUNDS):
        subject = subject.following(subject.refit([subject.start], [()])[0])
        subject = subject.with_noise_of(subject.refit([subject.start], [()])[0])
    return searched(subject, EFFORT)


def check_effects(vehicle: Vehicle, effects: Sequence[Effect], without: Sequence[str]) -> None:
    """Raise UsageError for a vehicle without a steering map, or ids that are none."""
    problems = steering_problems(vehicle, "a diagnosis of a vehicle")
    known = [effect.id for effect in effects]
    for name in sorted({*without} - {*known}):
        remedy = f"{did_you_mean(name, known)}known effects: {', '.join(known)}"
        problems.append(InputProblem(f"no effect {name!r} of a vehicle", remedy))
    UsageError.raise_for(problems)


def subject_of(
    log_windows: Logs, vehicle: Vehicle, tires: Sequence[GivenTire], library: Sequence[Effect]
) -> tuple[Windows, dict[str, tuple[str, ...]]]:
    """The subject of a diagnosis of cut logs with unit noise, and the needs that they do
    not meet, by effect."""
    cut, has = joined_windows(log_windows, vehicle, tires)
    lacks = {e.id: tuple(n for n in e.needs if n not in has) for e in library}
    lacks = {name: needs for name, needs in lacks.items() if needs}
    atoms = atoms_of(library)
    scales = tuple(a.effect.scale for a in atoms)
    model = Model(atoms, scales, cut.data.logged.shape[-1], stated_delay(vehicle))
    testable = tuple(k for k, a in enumerate(atoms) if a.effect.id not in lacks)
    car = car_of(vehicle, tires[0].tire, tires[1].tire)
    step = 1 / vehicle.filter.sample_rate
    return Windows(model, car, cut, step, testable, np.ones(model.channels)), lacks


# --- the document ---------------------------------------------------------------------


def _document_of(
    case: Concluded,
    log_windows: Logs,
    others: tuple[Logs, Windows] | None,
    vehicle: str,
    model: str,
    notes: Sequence[str],
    library: Sequence[Effect],
    seed: int,
) -> Diagnosis:
    """The document of the verdict on the windows of logs, with logs that were held out."""
    base, generator, ladder = case.base, np.random.default_rng(seed), case.ladder
    held = of_the_ladder(ladder)
    if others is not None:
        held, ladder = _held_out(case, ladder, *others, generator)
    z, spread = case.parameters
    gaps = {
        channel: _closure(base, channel, base.given_residual, case.chosen.residual, generator)
        for channel in _channels(base)
    }
    each = zip(FACTORS, np.exp(z).tolist(), (np.exp(z) * spread).tolist(), strict=True)
    rows, names = base.cut.data.v_x.size, CHANNELS[base.model.channels]
    length = (base.cut.data.v_x.shape[1] - 1) * base.step
    of_windows = f"{len(base.cut.log)} windows of {length:g} s, each from the start state that"
    return Diagnosis(
        **of_any_subject(
            case,
            gaps,
            held,
            ladder,
            {name: changed(1.0, factor, error) for name, factor, error in each},
            base.unit,
        ),
        data=DataSummary(
            name=", ".join(log_windows),
            path=", ".join(log.path for log in log_windows.values()),
            sha256=", ".join(log.track.sha256 for log in log_windows.values()),
            convention="",
            channels=tuple(gaps),
            assumptions=(f"{of_windows} fits best", *notes),
        ),
        model=model,
        simulator=SimulatorSummary("car", vehicle, None, Surrogate(model, 0.0, 0.0, 0.0)),
        n=rows,
        n_effective=rows / base.inflation,
        noise=NoiseSummary(
            forces=dict(zip(names, base.noise.tolist(), strict=True)),
            source="what all effects together leave",
            inflation=base.inflation,
        ),
        next_measurement=manoeuvres(case.search, case.weighed, case.verdict),
        base_parameters=dict.fromkeys(FACTORS, 1.0),
        extended_parameters=dict(zip(FACTORS, np.exp(case.chosen.z).tolist(), strict=True)),
        extension=CarExtension(
            {base.atoms[k].effect.id: base.atoms[k].variant for k in case.chosen.atoms},
            float(np.mean(base.cut.data.v_x)),
        ),
        settings=Settings(
            rig=None,
            effects=tuple(e.id for e in library),
            holdout=tuple(log.track.sha256 for log in (others[0] if others else {}).values()),
        ),
        seed=seed,
        library=tuple(library),
        meanings={name: "{1} of the {0} tires".format(*name.split(".")) for name in FACTORS},
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
    unit, columns = _channels(base)[channel]
    before, after = (unit * base.over_noise(x)[:, columns].ravel() for x in (before, after))
    run = np.repeat(base.cut.log, before.size // len(base.cut.log))
    variance = np.full(before.size, unit**2)
    return closure_of(before, after, variance, run, base.inflation, generator)


def _held_out(
    case: Concluded, ladder: Ladder, logs: Logs, other: Windows, generator: np.random.Generator
) -> tuple[HeldOut, Ladder]:
    """Closure on held-out logs, and the ladder with the closure of each step there."""
    other = other.following(replace(case.weighed.best_of[()], state=other.cut.data.start))
    left = {AS_GIVEN: other.given_residual} | {
        key: other.residual_of(other.coefficients(fit.z, fit.atoms, fit.amplitude))
        for key, fit in fits_of(case, ladder).items()
    }
    closure = _closure(other, ALL, left[AS_GIVEN], left[case.verdict.key], generator)
    missed = {key: other.over_noise(rest).ravel() for key, rest in left.items()}
    return on_files(ladder, closure, missed, 1.0, ", ".join(logs))


# --- the effects of a document applied to a log -----------------------------------------


@dataclass(frozen=True)
class Applied:
    """Named effects with their sizes.

    Attributes:
        model: with their atoms; z: its coefficients.
        speed: mean speed [m/s] of the logs that were diagnosed.
    """

    model: Model
    z: np.ndarray
    speed: float

    def samples(self, motion: Motion, rows: Any, vehicle: Vehicle, tires: Any) -> Samples:
        """The quantities on which effects depend, at rows (w, k) of the motion of a log;
        the time is the middle of that of the diagnosis."""
        samples = samples_of(motion, rows, vehicle, tires)
        across, turn = motion.a_y[rows] / vehicle.gravity, motion.yaw_rate[rows] / motion.v_x[rows]
        speed = samples.speed / self.speed
        return samples._replace(speed=speed, time=0 * samples.time, across=across, turn=turn)


def with_effects(model: Model, z: Any, window: Measured, step: float) -> tuple[Measured, Changes]:
    """A window of a log with the effects of the steering and without the errors of the log, and
    the changes of the car; ``model.channels`` are those of the log."""
    samples = window.samples
    assert samples is not None  # every window of a replay with effects has them
    setting, series = model.setting(z, samples), dict(window.series)
    angle = steered(setting.steering, window.steering, samples.across, step)
    series["yaw_rate"] -= setting.reading.yaw_rate
    fields = State._fields[: 5 if model.channels == 3 else 2]
    driven = as_driven([series[name] for name in fields], setting.reading, window.v_x)
    series |= {name: getattr(driven, name) for name in fields}
    return window._replace(steering=angle, series=series), setting.car


def applied(source: Diagnosis | str | os.PathLike[str]) -> Applied:
    """The effects named by a diagnosis of a car, or by its ``vehicle_diagnosis.json``.

    Raises:
        DataError: not a diagnosis of a car, or of another version.
    """
    name, command = "vehicle_diagnosis.json", "tirefit diagnose --vehicle"
    document = read_checked(source, _Document, name, command)
    library, to = effects_by_id(CAR_EFFECTS), document.extension
    atoms = tuple(Atom(library[k], to.variants[k]) for k in document.sizes)
    scales = tuple(atom.effect.scale for atom in atoms)
    of_tires = [np.log(document.extended_parameters[name]) for name in FACTORS]
    amplitudes = np.divide([*document.sizes.values()], scales)
    return Applied(Model(atoms, scales, 2), np.array([*of_tires, *amplitudes], float), to.speed)


class _Document(AnyDocument):
    """The parts of ``vehicle_diagnosis.json`` that a prediction needs."""

    extension: CarExtension

    @property
    def sizes(self) -> dict[str, float]:
        """Effect -> amplitude."""
        return {name.partition(": ")[0]: size.value for name, size in self.amplitudes.items()}

    @model_validator(mode="after")
    def _known(self) -> Any:
        library, variants = effects_by_id(CAR_EFFECTS), self.extension.variants
        for name in self.sizes:
            if name not in library or variants.get(name) not in range(len(library[name].variants)):
                raise ValueError(f"{name!r} is not an effect of a car, or has no such form")
        for name in FACTORS:
            if not self.extended_parameters.get(name, 0.0) > 0:
                raise ValueError(f"extended_parameters.{name} is not a positive number")
        return self
