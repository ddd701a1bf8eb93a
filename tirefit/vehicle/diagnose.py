"""Find the effects that the model of a car lacks: :func:`diagnose_vehicle`.

The motion of the car is predicted over windows of measured logs. Its errors are explained
by sets of effects of steering, masses, ground, drive, tires and the log, fitted together
with factors on stiffness and friction of both axles' tires. Evidence, prediction of data
left out and decision are those of a diagnosis of forces.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import jax
import numpy as np

from tirefit import __version__
from tirefit.data.merged import merged
from tirefit.data.motion import Motion
from tirefit.data.vehicle import POSE, Vehicle
from tirefit.diagnosis.decide.verdict import Verdict, decide
from tirefit.diagnosis.effects import Effect, atoms_of
from tirefit.diagnosis.effects.state import peak_ratio, slope_at_rest
from tirefit.diagnosis.left_out import Ladder, ladder_of
from tirefit.display import Record
from tirefit.files import json_safe
from tirefit.fitting.mf.result import TireLike
from tirefit.fitting.source import GivenTire, axle_tire
from tirefit.models import TireInputs
from tirefit.precision import require_x64
from tirefit.results import DataError, InputProblem, Outcome, UsageError, did_you_mean
from tirefit.vehicle.car import car_of
from tirefit.vehicle.effects import CAR_EFFECTS, Samples
from tirefit.vehicle.evidence import PARAMETERS, SHAPES, Base, Cut, Fit, Model
from tirefit.vehicle.search import errors, findings, searched
from tirefit.vehicle.shooting import CHANNELS, windows_of
from tirefit.vehicle.trajectory import derived_rows, started
from tirefit.vehicle.windows import cut_logs, known_vehicle, steering_problems

SCHEMA = "tirefit.vehicle_diagnosis/1"

WINDOW = 1.0
"""Length [s] of a window."""

_MOST_SAMPLES = 4000
"""Largest number of samples of all windows, evenly spread."""

_LEAST_WINDOWS = 8
"""Smallest number of windows of a diagnosis."""

_VARIES = 0.02
"""Smallest spread of the forward acceleration over g, and of the speed over its mean, that
shows effects of these."""


class Amplitude(NamedTuple):
    """An amplitude with its standard error."""

    value: float
    std: float
    unit: str


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
        amplitudes: of each named effect; which: text on its form; variants: the number
            of its form; speed: mean speed [m/s], to which effects of the speed refer.
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
    amplitudes: Mapping[str, Amplitude]
    which: Mapping[str, str]
    variants: Mapping[str, int]
    speed: float
    parameters: Mapping[str, Amplitude]
    noise: Mapping[str, float]
    miss: Miss
    held_out: Miss | None
    untestable: Mapping[str, tuple[str, ...]]
    effects: Mapping[str, Effect]
    notes: tuple[str, ...]

    @property
    def limits(self) -> dict[Outcome, str]:
        """Where the answer of ``verdict`` is open."""
        return self.verdict.status.limits

    def to_dict(self) -> dict[str, Any]:
        """All numbers, as in ``vehicle_diagnosis.json``."""
        verdict = self.verdict
        return json_safe({
            "schema": SCHEMA, "version": __version__, "logs": self.logs,
            "windows": self.windows, "window": self.window,
            "verdict": {
                "status": verdict.status.value, "effects": verdict.effects,
                "probability": verdict.probability,
                "each": {k: v._asdict() for k, v in verdict.each.items()},
                "also_possible": verdict.also_possible, "unlisted": verdict.unlisted,
            },
            "amplitudes": {k: v._asdict() for k, v in self.amplitudes.items()},
            "forms": dict(self.which), "variants": dict(self.variants),
            "speed": self.speed,
            "parameters": {k: v._asdict() for k, v in self.parameters.items()},
            "noise": dict(self.noise),
            "ladder": {
                "left_out": self.ladder.on,
                "steps": [step._asdict() for step in self.ladder.steps],
            },
            "miss": self.miss._asdict(),
            "held_out": self.held_out._asdict() if self.held_out else None,
            "untestable": dict(self.untestable), "notes": self.notes,
        })  # fmt: skip

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

    def cut(some):
        return cut_logs(
            some,
            vehicle,
            lambda track, motion: windows_of(track, motion, vehicle, window),
            f"{window:g} s long",
            "a shorter window",
        )

    found, others = cut(logs), cut(holdout) if holdout else None
    tires = [
        started(tire, derived_rows(found, vehicle, axle))
        for axle, tire in zip(("front", "rear"), given, strict=True)
    ]
    windows, has = _joined(found, vehicle, tires)
    _enough(windows, window)
    library = [e for e in effects if e.id not in without]
    untestable = {e.id: tuple(n for n in e.needs if n not in has) for e in library}
    base = _base(windows, vehicle, tires, library, untestable)
    weighed, out, tests = searched(base)
    verdict = decide(findings(weighed, out, tests))
    null, best = weighed.best_of[()], weighed.best_of[verdict.key]
    std = errors(weighed, out, verdict.key)
    held_out = None
    if others is not None:
        other = _base(_joined(others, vehicle, tires)[0], vehicle, tires, library, {})
        other.noise = base.noise
        other.follow(replace(null, starts=other.cut.data.start))
        held_out = _miss(other, null, best)
    return VehicleDiagnosis(
        tuple(found),
        len(windows.log),
        window,
        verdict,
        ladder_of(out, verdict.key, 1.0),
        _amplitudes(base, best, std),
        _words(base, best),
        {a.effect.id: a.variant for a in (base.model.atoms[k] for k in best.atoms)},
        float(np.mean(windows.data.v_x)),
        _parameters(best),
        _by_channel(base, base.noise / np.sqrt(base.inflation)),
        _miss(base, null, best),
        held_out,
        {name: lacks for name, lacks in untestable.items() if lacks},
        {effect.id: effect for effect in effects},
        (*_notes(given, tires), *merged((k, log.missing) for k, log in found.items())),
    )


def _enough(windows: Cut, window: float) -> None:
    count = len(windows.log)
    if count < _LEAST_WINDOWS:
        reason = f"{count} windows of {window:g} s; a diagnosis needs {_LEAST_WINDOWS}"
        raise DataError(InputProblem(reason, "give longer logs, or more of them"))


def _by_channel(base: Base, values) -> dict[str, float]:
    names = CHANNELS[base.model.channels]
    return dict(zip(names, map(float, values), strict=True))


def _miss(base: Base, null: Fit, best: Fit) -> Miss:
    each = np.zeros(base.model.size), null.z, best.z
    return Miss(*(_by_channel(base, base.rms(z)) for z in each))


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


def _joined(found, vehicle: Vehicle, tires) -> tuple[Cut, set[str]]:
    """The windows of all logs, and the needs of effects that they meet."""
    data, rows, log = [], [], []
    passed = 0.0
    for number, each in enumerate(found.values()):
        motion, (windows, own) = each.motion, each.windows
        data.append(windows)
        rows.append(samples_of(motion, own, vehicle, tires, passed))
        log.append(np.full(len(own), number))
        passed += float(motion.time[-1] - motion.time[0])
    joined = jax.tree.map(lambda *part: np.concatenate(part), *data)
    joint = jax.tree.map(lambda *part: np.concatenate(part), *rows)
    speed = joint.speed / np.mean(joint.speed)
    joint = joint._replace(speed=speed, time=joint.time / passed - 0.5)
    has = {"heading"} if vehicle.columns.motion == POSE else {"rates"}
    has |= {"acceleration"} if np.std(joint.along) > _VARIES else set()
    has |= {"speeds"} if np.std(speed) > _VARIES else set()
    shapes = np.zeros((*speed.shape, SHAPES))  # until they are set from a fit
    cut = Cut(joined, joint, shapes, np.concatenate(log))
    most = max(_MOST_SAMPLES // speed.shape[1], _LEAST_WINDOWS)
    if len(cut.log) > most:
        kept = np.linspace(0, len(cut.log) - 1, most).round().astype(int)
        cut = jax.tree.map(lambda part: part[kept], cut)
    return cut, has


def samples_of(motion: Motion, own, vehicle: Vehicle, tires, passed: float = 0.0) -> Samples:
    """The quantities on which effects depend, at the rows (w, k) of a log. ``across`` and ``turn``
    are zero until they are set from a fit; ``passed`` [s] is the duration of the previous logs."""
    g, count = vehicle.gravity, len(own)
    weight, wheelbase = vehicle.mass * g, vehicle.l_f + vehicle.l_r
    loads = weight * vehicle.l_r / wheelbase, weight * vehicle.l_f / wheelbase
    v_x = motion.v_x[own]
    sliding = [
        _sliding(one, load, float(v_x.mean())) for one, load in zip(tires, loads, strict=True)
    ]
    heading = motion.heading if vehicle.columns.motion == POSE else 0 * motion.time
    return Samples(
        speed=v_x,
        along=motion.a_x[own] / g,
        across=0 * v_x,
        turn=0 * v_x,
        time=passed + motion.time[own] - motion.time[0],
        heading=heading[own],
        weight=np.full(count, weight),
        wheelbase=np.full(count, wheelbase),
        sliding=np.tile(sliding, (count, 1)),
    )


def _sliding(axle: GivenTire, load: float, speed: float) -> float:
    """Slip above which a brush with slope and peak of the tire slides."""
    at_rest = TireInputs(fz=load, v=speed)
    slope = slope_at_rest(axle.tire, at_rest, "y")
    return float(3 * peak_ratio(axle.tire, load, speed) * load / slope)


def _base(cut: Cut, vehicle: Vehicle, tires, library, untestable) -> Base:
    atoms = atoms_of(library)
    scales = tuple(a.effect.scale for a in atoms)
    model = Model(atoms, scales, cut.data.logged.shape[-1])
    testable = [k for k, a in enumerate(atoms) if not untestable.get(a.effect.id)]
    car = car_of(vehicle, tires[0].tire, tires[1].tire)
    return Base(model, car, cut, 1 / vehicle.filter.sample_rate, testable)


def _amplitudes(base: Base, fit: Fit, std: np.ndarray) -> dict[str, Amplitude]:
    found = {}
    for k, size, error in zip(fit.atoms, fit.amplitude, std, strict=True):
        effect, scale = base.model.atoms[k].effect, base.model.scales[k]
        found[effect.id] = Amplitude(float(scale * size), float(scale * error), effect.unit)
    return found


def _words(base: Base, fit: Fit) -> dict[str, str]:
    atoms = [base.model.atoms[k] for k in fit.atoms]
    return {
        atom.effect.id: atom.effect.which(atom.constants, base.cut.rows, None)  # type: ignore
        for atom in atoms
        if atom.effect.which
    }


def _parameters(fit: Fit) -> dict[str, Amplitude]:
    std = np.sqrt(np.diag(fit.covariance))
    factors = np.exp(fit.z[: len(PARAMETERS)])
    return {
        name: Amplitude(float(factor), float(factor * error), "-")
        for name, factor, error in zip(PARAMETERS, factors, std, strict=False)
    }
