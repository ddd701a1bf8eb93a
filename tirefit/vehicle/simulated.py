"""What differs between a car and somebody's simulator of it: :func:`compare_with_simulator`.

The log and the states that the simulator predicted for the same inputs are described by the
same car, with the effects that the diagnosis of either names. The difference of the two
descriptions is what the simulator has wrong.
"""

import csv
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from tirefit.data.read import read_table
from tirefit.data.readers.remote import file_at
from tirefit.data.vehicle.motion import Motion, read_motion, road_wheel
from tirefit.data.vehicle.vehicle import CHECKS, POSE, Columns, Vehicle
from tirefit.diagnosis.effects import Effect
from tirefit.diagnosis.engine.fit import Start
from tirefit.diagnosis.engine.search import MOST_EFFECTS
from tirefit.diagnosis.summary.case import Concluded
from tirefit.diagnosis.summary.compare import (
    Apart,
    Comparison,
    Number,
    Source,
    compared,
    standing_of,
)
from tirefit.fitting.mf.result import TireLike
from tirefit.fitting.source import GivenTire, axle_tire
from tirefit.precision import require_x64
from tirefit.results import DataError, InputProblem
from tirefit.vehicle.diagnose import WINDOW, Steps, check_effects, studied
from tirefit.vehicle.effects import SIMULATOR_EFFECTS
from tirefit.vehicle.model import PARAMETERS, TIRES
from tirefit.vehicle.start import started
from tirefit.vehicle.windows import CutLog, cut_in_windows, derived_rows, known_vehicle

_NOISE = 1.0
"""Noise added to the simulator's states, over that of the log. A simulator is compared as closely
as the log shows the car: below that, effects stand for steps and order of an integration."""

_SPUN, _MORE = math.radians(40.0), 2.0
"""Largest sideslip of a simulated car, and its ratio to that of the car, above which it spins."""

_STEPS = 80  # usual number of refits of both searches

_FACTORS = {"yaw_rate": {"deg/s": math.degrees(1.0)}, "v_y": {"km/h": 3.6}}
"""State of a simulator -> its unit that is often confused with the SI unit, and the factor."""

_UNLIMITED = 3.0
"""Friction of one over that of the other, above which its tires do not reach their limit."""

_BEND = 0.1
"""Change [log] of the stiffness that may make up for the bend of a brush with the largest factor
on its friction, which loses a tenth of the force of a linear tire at 0.28 of its limit."""

_ALIKE = 9.21  # chi-square of three factors about their mean that one of 100 equal ones exceeds

_WITHOUT_SLIP = 0.01
"""Rms of the yaw rate that slip explains, over the whole, below which a simulator has none."""

_RELATED, _NEAR = 0.95, 0.15
"""Least correlation of a state with that of the log, and largest distance [log] of its factor
from that of a unit or a sign, that show the wrong unit or sign."""


_Stated = tuple[str, str, Callable[[Vehicle, float], tuple[float, float]]]


def _arm(name: str, sign: float) -> _Stated:
    """A distance of the car that an amplitude in wheelbases makes longer (sign 1) or shorter."""
    return (
        name,
        "m",
        lambda car, x: (getattr(car, name) + sign * x * car.wheelbase, car.wheelbase),
    )


_STATED: dict[str, _Stated] = {
    "centre_of_gravity": _arm("l_f", -1.0),
    "front_axle": _arm("l_f", 1.0),
    "rear_axle": _arm("l_r", 1.0),
    "yaw_inertia": ("yaw_inertia", "kg m2", lambda car, x: (car.yaw_inertia * math.exp(x),) * 2),
    "steering_delay": (
        "steering.delay",
        "s",
        lambda car, x: ((car.steering.delay if car.steering else 0.0) + x, 1.0),
    ),
}
"""Effect -> the quantity of ``vehicle.toml`` that it changes, its unit, and the function of the
amplitude that gives its value and the size of its slope."""


def compare_with_simulator(
    logs: Sequence[str | Path],
    sim_logs: Sequence[str | Path],
    vehicle: Vehicle | str | Path,
    front: TireLike | GivenTire = "brush",
    rear: TireLike | GivenTire = "brush",
    *,
    effects: Sequence[Effect] | None = None,
    without: Sequence[str] = (),
    window: float = WINDOW,
    progress: Callable[[float, str], None] | None = None,
) -> Comparison:
    """Find what differs between a car and a simulator of it, from logs of both.

    Args:
        logs: vehicle logs, as for :func:`tirefit.diagnose_vehicle`.
        sim_logs: the states that the simulator predicted for the inputs of each log, as logs
            with the same columns; columns that one lacks are taken from its log, row by row.
        vehicle: a vehicle or its ``vehicle.toml``, with a steering map; the start for both.
        front: tire of the axle, the start for both.
        rear: likewise.
        effects: to look for; all of the library by default.
        without: ids of effects that are not looked for.
        window: length [s] of the stretches that are predicted.
        progress: called with the share done and the present step.

    Returns:
        The descriptions of the simulator and of the car, side by side.

    Raises:
        UsageError: as :func:`tirefit.diagnose_vehicle`.
        DataError: the same, or a simulated log that has neither a column nor the rows of its log.

    Example:
        >>> log, car = samples / "drive.csv", samples / "vehicle.toml"
        >>> from tirefit.vehicle.effects import SIMULATOR_EFFECTS
        >>> few = [effect for effect in SIMULATOR_EFFECTS if effect.id == "steering_delay"]
        >>> result = compare_with_simulator([log], [log], car, effects=few)
        >>> any(number.differs for number in (*result.numbers, *result.effects))
        False
    """
    require_x64("a diagnosis")
    stated, effects = known_vehicle(vehicle), SIMULATOR_EFFECTS if effects is None else effects
    check_effects(stated, effects, without)
    library = [effect for effect in effects if effect.id not in without]
    if len(logs) != len(sim_logs):
        raise DataError(f"{len(sim_logs)} simulated logs of {len(logs)}", "give one for each log")
    tell = Steps(progress, _STEPS)
    tell("reading logs")
    log_windows = cut_in_windows(logs, stated, window)
    sim_vehicle = _of_sim_logs(stated, sim_logs)
    with TemporaryDirectory() as folder:
        pairs = zip(logs, sim_logs, strict=True)
        whole = [_with_inputs(*pair, sim_vehicle, Path(folder)) for pair in pairs]
        try:
            motions = [read_motion(file_at(path), sim_vehicle)[1] for path in whole]
            triples = zip(log_windows.values(), motions, sim_logs, strict=True)
            DataError.raise_for([x for triple in triples for x in _unlike(*triple, sim_vehicle)])
            simulated = cut_in_windows(whole, sim_vehicle, window)
        except DataError as error:
            given = dict(zip(map(str, whole), map(str, sim_logs), strict=True))
            named = (replace(x, file=given.get(x.file, x.file)) for x in error.problems)
            DataError.raise_for(list(named))
            raise
    tires = [
        started(axle_tire(tire), derived_rows(log_windows, stated, axle))
        for axle, tire in (("front", front), ("rear", rear))
    ]
    car = studied(log_windows, stated, tires, library, window, tell)
    noisy = _noisy(simulated, car.base.noise)
    simulator = studied(noisy, sim_vehicle, tires, library, window, tell)
    # The effects that help either, in the form of the car if it has them.
    helping = {"car": _first_of_twins(car), "simulator": _first_of_twins(simulator)}
    forms = _forms(simulator, helping["simulator"]) | _forms(car, helping["car"])
    ranked = dict.fromkeys(effect for of in helping.values() for effect in of)
    atoms = tuple(sorted([forms[effect] for effect in ranked][:MOST_EFFECTS]))
    sources = [
        _described(name, case, helping[name], atoms, stated, ", ".join(map(str, files)))
        for name, case, files in (("simulator", simulator, sim_logs), ("car", car, logs))
    ]
    note = "both are described by the same car with the effects that either needs; factors on the"
    note += " tires are those on the tires at the start"
    result = compared(sources)
    if no_slip := _no_slip(simulated.values(), sim_vehicle):
        return _bare(result, no_slip)
    numbers = _without_bends(result.numbers)
    meant = _meanings({number.name: number for number in (*numbers, *result.effects)})
    alike = [
        f"{effect} in the {name} may be {' or '.join(twins)} instead: these logs cannot distinguish"
        " them"
        for name, of in helping.items()
        for effect, (_, *twins) in of.items()
        if twins
    ]
    meanings = (*_spins(log_windows.values(), simulated.values()), *meant, *alike)
    return replace(result, numbers=numbers, notes=(*result.notes, note), meanings=meanings)


def _first_of_twins(case: Concluded) -> dict[str, tuple[str, ...]]:
    """The first in the library of each effect that helps and its twins -> the one that helps, and
    the others of these: which helps more may change with a row of the log."""
    order = [atom.effect.id for atom in case.base.atoms]
    named = dict[str, tuple[str, ...]]()
    for effect in case.chosen.effects:
        twins = {*case.verdict.each[effect].twins} - {*named, *case.chosen.effects}
        first, *others = sorted({effect, *twins}, key=order.index)
        named[first] = (effect, *others)
    return named


def _forms(case: Concluded, effects: Iterable[str]) -> dict[str, int]:
    """Effect -> its atom in the fit that helps, or in the best fit that has it."""
    fits = [*case.search.ranked[::-1], case.chosen]
    forms = {e: atom for fit in fits for e, atom in zip(fit.effects, fit.atoms, strict=True)}
    return {effect: forms[effect] for effect in effects}


def _unlimited(numbers: Mapping[str, Apart]) -> dict[str, str]:
    """Axle -> the one of simulator and car whose tires have no friction limit."""
    unlimited = {}
    for axle in ("front", "rear"):
        friction = numbers[f"{axle}.friction"]
        (low, _), (high, name) = sorted((x.value, name) for name, x in friction.values.items())
        if friction.differs and high > _UNLIMITED * low:
            unlimited[axle] = name
    return unlimited


def _without_bends(numbers: Sequence[Apart]) -> tuple[Apart, ...]:
    """The factors on the tires; the stiffness of an axle without a friction limit does not differ
    if it only makes up for the bend of the brush that stands for it."""
    factors = {number.name: number for number in numbers}
    for axle in _unlimited(factors):
        stiffness = factors[f"{axle}.stiffness"]
        if np.ptp(np.log([x.value for x in stiffness.values.values()])) < _BEND:
            factors[stiffness.name] = stiffness._replace(differs=False)
    return tuple(factors.values())


def _meanings(numbers: Mapping[str, Apart]) -> Iterator[str]:
    """What differences mean: tires without a friction limit, or another mass."""
    for axle, name in _unlimited(numbers).items():
        yield (
            f"the {axle} tires of the {name} do not saturate in these logs: they have no"
            " friction limit, or a far higher one"
        )
    names = "front.stiffness", "rear.stiffness", "yaw_inertia: yaw_inertia"
    if not all(name in numbers and numbers[name].differs for name in names):
        return
    pairs = [[numbers[name].values[of] for of in ("car", "simulator")] for name in names]
    logs = np.log([ours.value / theirs.value for ours, theirs in pairs])
    weight = [1 / sum(((x.std or 0) / x.value) ** 2 for x in pair) for pair in pairs]
    mean = np.average(logs, weights=weight)
    if weight @ (logs - mean) ** 2 < _ALIKE:
        yield (
            "yaw inertia and the stiffness of both axles differ by the same factor: so they do if"
            f" the mass of the simulator is {math.exp(mean):.3g} times that of the car"
        )


def _spins(logs: Iterable[CutLog[Any]], simulated: Iterable[CutLog[Any]]) -> Iterator[str]:
    """A sentence if the simulated car spins where the car does not."""
    car, simulator = (
        max(float(np.nanmax(np.abs(np.arctan2(m.v_y, m.v_x)[m.settled]))) for m in motions)
        for motions in ([log.motion for log in cut] for cut in (logs, simulated))
    )
    if simulator > max(_SPUN, _MORE * car):
        yield (
            "the simulated car spins: its sideslip reaches"
            f" {math.degrees(simulator):.0f} deg, that of"
            f" the car {math.degrees(car):.0f} deg. What differs is uncertain: give a log in which"
            " the simulator does not spin"
        )


def _bare(result: Comparison, meaning: str) -> Comparison:
    """The comparison with one sentence in place of numbers and effects."""
    sources = tuple(
        source._replace(kind="states", numbers={}, effects={}, standing={})
        for source in result.sources
    )
    return replace(result, sources=sources, numbers=(), effects=(), meanings=(meaning,))


def _no_slip(simulated: Iterable[CutLog[Any]], vehicle: Vehicle) -> str:
    """A sentence if the yaw rate of the simulated car is that of its wheels without slip, and its
    sideways speed in proportion to the yaw rate; else empty."""
    parts = []
    for log in simulated:
        motion = log.motion
        good = motion.settled & (motion.v_x > vehicle.v_min)
        turn = motion.v_x * np.tan(road_wheel(motion, vehicle))
        parts.append(np.stack([motion.yaw_rate, motion.v_y, turn, motion.v_x])[:, good])
    yaw_rate, v_y, *wheels = np.concatenate(parts, axis=1)
    allowed, arms = _WITHOUT_SLIP * np.std(yaw_rate), []
    for values, by, length in (
        (yaw_rate, np.transpose(wheels), 1.0),
        (v_y, yaw_rate[:, None], vehicle.l_r),
    ):
        factors = np.linalg.lstsq(by, values)[0]
        if not allowed or np.std(values - by @ factors) > allowed * length:
            return ""  # it has slip, or drives straight
        arms.append(float(factors[0]))
    return (
        "the simulated car has no slip: its yaw rate is that of its wheels with a wheelbase of"
        f" {1 / arms[0]:.3g} m, and it describes a point {arms[1]:.3g} m ahead of the rear axle."
        " Nothing else is compared: give it tires first"
    )


def _of_sim_logs(vehicle: Vehicle, sim_logs: Sequence[str | Path]) -> Vehicle:
    """The vehicle with the columns of simulated logs: their states, inputs, and no measurement
    of the car as a check of them."""
    columns, lacking, problems = vehicle.columns, set[str](), []
    for path in sim_logs:
        headers = read_table(file_at(path), []).headers
        lacks = {x for x in CHECKS if not {*_headers(columns, x)} <= {*headers}}
        states = POSE if columns.motion == POSE else ("v_y", "yaw_rate")
        if absent := [name for name in states if name in lacks]:
            reason = f"it lacks {', '.join(absent)}, which the simulator has to predict"
            problems.append(InputProblem(reason, "name the columns as in the log", str(path)))
        lacking |= lacks
    DataError.raise_for(problems)
    checks = dict.fromkeys(lacking & {"a_y", "a_x", *columns.beyond})
    return vehicle.model_copy(update={"columns": columns.model_copy(update=checks)})


def _headers(columns: Columns, name: str) -> list[str]:
    given = getattr(columns, name)
    return given if isinstance(given, list) else [given] if given else []


def _unlike(
    log: CutLog[Any], theirs: Motion, file: str | Path, vehicle: Vehicle
) -> Iterator[InputProblem]:
    """Problems of states of a simulator in another unit or of another sign than in the log."""
    ours = log.motion
    there = ours.settled & (ours.time >= theirs.time[0]) & (ours.time <= theirs.time[-1])
    for name, units in _FACTORS.items():
        if name == "v_y" and not vehicle.columns.a_y_follows:
            continue  # the simulator's own a_y or pose is compared with it
        logged = getattr(ours, name)[there]
        simulated = np.interp(ours.time[there], theirs.time, getattr(theirs, name))
        good = np.isfinite(simulated) & np.isfinite(logged)
        logged, simulated = logged[good], simulated[good]
        if not good.any() or min(np.ptp(simulated), np.ptp(logged)) == 0.0:
            continue  # a state that never changes shows neither unit nor sign
        correlation = np.corrcoef(simulated, logged)[0, 1]
        ratio = float(np.std(simulated) / np.std(logged))
        for unit, factor in {**units, "": 1.0}.items():
            sign = "" if correlation > 0 else "of the other sign"
            near = min(abs(math.log(ratio * by)) for by in (factor, 1 / factor)) < _NEAR
            if abs(correlation) > _RELATED and near and (unit or sign):
                what = " and ".join(filter(None, (sign, unit and f"in another unit, as {unit}")))
                reason = f"{name} is {math.copysign(ratio, correlation):.3g} times that of the log"
                reason += f" (correlation {correlation:.2f}): it is {what}"
                remedy = "write it with the sign and the unit of the log"
                if name == "v_y":
                    remedy += "; if it has these, give a_y of the simulator as well"
                # Of a pose, the yaw rate is the change of the heading.
                header = (_headers(vehicle.columns, name) or _headers(vehicle.columns, "yaw"))[0]
                yield InputProblem(reason, remedy, str(file), column=header)


def _with_inputs(log: str | Path, sim: str | Path, vehicle: Vehicle, folder: Path) -> Path:
    """The simulated log, with the columns that it lacks from the log."""
    wanted = [x for name in vehicle.columns.model_dump() for x in _headers(vehicle.columns, name)]
    wanted += [vehicle.keep.active] if vehicle.keep.active else []
    simulated = read_table(file_at(sim), [])
    lacking = [name for name in wanted if name not in simulated.headers]
    if not lacking:
        return Path(sim)
    logged = read_table(file_at(log), wanted)
    if len(simulated.lines) != len(logged.lines):
        reason = f"it lacks {', '.join(lacking)}, and has {len(simulated.lines)} rows; the log has"
        remedy = "add the columns, or write a row for each row of the log"
        raise DataError(f"{reason} {len(logged.lines)}", remedy, str(sim))
    taken = [name for name in lacking if name in logged.headers]
    cells = [*simulated.cells, *(logged.cells[logged.headers.index(name)] for name in taken)]
    path = folder / f"{Path(sim).stem}.csv"
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([[*simulated.headers, *taken], *zip(*cells, strict=True)])
    return path


def _noisy(log_windows: Mapping[str, Any], noise: np.ndarray) -> dict[str, Any]:
    """Cut logs with as much noise again on their channels as the log has."""
    generator, noisy = np.random.default_rng(0), {}
    for name, log in log_windows.items():
        data, rows = log.windows
        added = _NOISE * noise * generator.standard_normal(data.logged.shape)
        noisy[name] = log._replace(windows=(data._replace(logged=data.logged + added), rows))
    return noisy


def _described(
    name: str,
    case: Concluded,
    helping: Mapping[str, tuple[str, ...]],
    atoms: tuple[int, ...],
    vehicle: Vehicle,
    file: str,
) -> Source:
    """The description of logs: factors on the tires, and sizes of these effects."""
    base, chosen = case.base, case.chosen
    first = dict(zip(chosen.atoms, chosen.amplitude, strict=True))
    start = Start(chosen.z, np.array([first.get(k, 0.0) for k in atoms]), chosen.state)
    (fit,) = base.refit([start], [atoms])
    factors, errors = np.exp(fit.z), np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    each = zip(PARAMETERS, factors.tolist(), errors.tolist(), strict=False)
    numbers = {name: Number(factor, factor * error, "-") for name, factor, error in each}
    sizes = {}
    for k, atom in enumerate(fit.atoms):
        effect, scale = base.atoms[atom].effect, float(base.priors.scale[atom])
        size, std = float(fit.amplitude[k]) * scale, float(errors[TIRES + k]) * scale
        key, unit, slope = f"{effect.id}: amplitude", effect.unit, 1.0
        if effect.id in _STATED:
            quantity, unit, of = _STATED[effect.id]
            key, (size, slope) = f"{effect.id}: {quantity}", of(vehicle, size)
        sizes[key] = Number(size, std * slope, unit)
    standing = standing_of(case.verdict, [untestable.effect for untestable in case.untestable])
    for effect_id, (helps, *_) in helping.items():
        standing[effect_id], standing[helps] = standing[helps], standing.get(effect_id, "possible")
    return Source(name, "description", file, "car", "", numbers, {}, sizes, standing)
