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
from tirefit.data.vehicle.motion import road_wheel
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
from tirefit.vehicle.car import AXLES
from tirefit.vehicle.diagnose import WINDOW, Steps, check_effects, studied
from tirefit.vehicle.effects import SIMULATOR_EFFECTS
from tirefit.vehicle.model import PARAMETERS, TIRES
from tirefit.vehicle.windows import (
    CutLog,
    cut_in_windows,
    known_vehicle,
    started_tires,
    stated_delay,
)

_SPUN, _MORE = math.radians(40.0), 2.0
"""Largest sideslip of a simulated car, and its ratio to that of the car, above which it spins."""

_WITHOUT_SLIP = 0.01
"""Rms of the yaw rate that slip explains, over the whole, below which a simulator has none."""

_RELATED, _NEAR = 0.95, 0.15
"""Least correlation of a lateral speed with that of the log, and largest distance [log] of its
factor from that of a unit, that show the wrong unit or sign."""

_STATED: dict[str, tuple[str, str, Callable[[Vehicle, float], float]]] = {
    "centre_of_gravity": ("l_f", "m", lambda car, x: car.l_f - x * car.wheelbase),
    "front_axle": ("l_f", "m", lambda car, x: car.l_f + x * car.wheelbase),
    "rear_axle": ("l_r", "m", lambda car, x: car.l_r + x * car.wheelbase),
    "yaw_inertia": ("yaw_inertia", "kg m2", lambda car, x: car.yaw_inertia * math.exp(x)),
    "steering_delay": ("steering.delay", "s", lambda car, x: stated_delay(car) + x),
}
"""Effect -> the quantity of ``vehicle.toml`` that it changes, its unit, and its value as a function
of the amplitude."""


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
    tell = Steps(progress, 80)  # usual number of refits of both searches
    tell("reading logs")
    sim_vehicle = _of_sim_logs(stated, sim_logs)
    log_windows = cut_in_windows(logs, stated, window)
    with TemporaryDirectory() as folder:
        pairs = zip(logs, sim_logs, strict=True)
        whole = [_with_inputs(*pair, sim_vehicle, Path(folder)) for pair in pairs]
        try:
            simulated = cut_in_windows(whole, sim_vehicle, window)
        except DataError as error:
            given = dict(zip(map(str, whole), map(str, sim_logs), strict=True))
            advice = "; a simulated log needs the signs and the units of its log"
            problems = [
                replace(x, file=given.get(x.file, x.file), remedy=x.remedy + advice)
                for x in error.problems
            ]
            raise DataError(problems) from error
    triples = zip(log_windows.values(), simulated.values(), sim_logs, strict=True)
    DataError.raise_for([x for triple in triples for x in _unlike(*triple, sim_vehicle)])
    files = {"simulator": ", ".join(map(str, sim_logs)), "car": ", ".join(map(str, logs))}
    if no_slip := _no_slip(simulated.values(), sim_vehicle):
        states = tuple(Source(name, "states", file) for name, file in files.items())
        return Comparison(sources=states, meanings=(no_slip,))
    axles = axle_tire(front), axle_tire(rear)
    tires, _, _ = started_tires(axles, log_windows, stated)
    car = studied(log_windows, stated, tires, library, window, tell)
    noisy = _noisy(simulated, car.base.noise)
    simulator = studied(noisy, sim_vehicle, tires, library, window, tell)
    # The effects that help either, in the form of the car if it has them.
    helping = {"car": _first_of_twins(car), "simulator": _first_of_twins(simulator)}
    forms = _forms(simulator, helping["simulator"]) | _forms(car, helping["car"])
    ranked = dict.fromkeys(effect for of in helping.values() for effect in of)
    atoms = tuple(sorted([forms[effect] for effect in ranked][:MOST_EFFECTS]))
    sources = [
        _described(name, case, helping[name], atoms, stated, files[name])
        for name, case in (("simulator", simulator), ("car", car))
    ]
    note = "both are described by the same car with the effects that either needs; factors on the"
    note += " tires are those on the tires at the start"
    result = compared(sources)
    meant = _meanings({number.name: number for number in (*result.numbers, *result.effects)})
    alike = [
        f"{effect} in the {name} may be {' or '.join(twins)} instead: these logs cannot distinguish"
        " them"
        for name, of in helping.items()
        for effect, (_, *twins) in of.items()
        if twins
    ]
    meanings = (*_spins(log_windows.values(), simulated.values()), *meant, *alike)
    return replace(result, notes=(*result.notes, note), meanings=meanings)


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


def _meanings(numbers: Mapping[str, Apart]) -> Iterator[str]:
    """What differences mean: tires without a friction limit, or another mass."""
    for axle in AXLES:
        friction = numbers[f"{axle}.friction"]
        (low, _), (high, name) = sorted((x.value, name) for name, x in friction.values.items())
        # Of three times the friction of the other, tires do not reach their limit.
        if friction.differs and high > 3.0 * low:
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
    # The chi-square of three factors about their mean that one of 100 equal ones exceeds.
    if weight @ (logs - mean) ** 2 < -2 * math.log(0.01):
        yield (
            "yaw inertia and the stiffness of both axles differ by the same factor: so they do if"
            f" the mass of the simulator is {math.exp(mean):.3g} times that of the car"
        )


def _spins(logs: Iterable[CutLog], simulated: Iterable[CutLog]) -> Iterator[str]:
    """A sentence if the simulated car spins where the car does not."""
    car, simulator = (
        max(float(np.nanmax(np.abs(np.arctan2(m.v_y, m.v_x)[m.settled]))) for m in motions)
        for motions in ([log.motion for log in cut] for cut in (logs, simulated))
    )
    if simulator > max(_SPUN, _MORE * car):
        yield (
            f"the simulated car spins: its sideslip reaches {math.degrees(simulator):.0f} deg, that"
            f" of the car {math.degrees(car):.0f} deg. What differs is uncertain: give a log in"
            " which the simulator does not spin"
        )


def _no_slip(simulated: Iterable[CutLog], vehicle: Vehicle) -> str:
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
    log: CutLog, simulated_log: CutLog, file: str | Path, vehicle: Vehicle
) -> Iterator[InputProblem]:
    """A problem of a lateral speed of a simulator in another unit or of another sign than in the
    log. The other states contradict the inputs if they are."""
    if not vehicle.columns.a_y_follows:
        return  # the simulator's own a_y or pose is compared with it
    ours, theirs = log.motion, simulated_log.motion
    simulated = np.interp(ours.time, theirs.time, theirs.v_y, left=np.nan, right=np.nan)
    good = ours.settled & np.isfinite(simulated) & np.isfinite(ours.v_y)
    simulated, logged = simulated[good], ours.v_y[good]
    if not good.any() or min(np.ptp(simulated), np.ptp(logged)) == 0.0:
        return  # a state that never changes shows neither unit nor sign
    correlation = np.corrcoef(simulated, logged)[0, 1]
    ratio = float(np.std(simulated) / np.std(logged))
    in_kmh = abs(abs(math.log(ratio)) - math.log(3.6)) < _NEAR
    reversed_sign = correlation < 0 and abs(math.log(ratio)) < _NEAR
    if abs(correlation) > _RELATED and (in_kmh or reversed_sign):
        reason = f"v_y is {math.copysign(ratio, correlation):.3g} times that of the log: it is in"
        reason += f" another unit, as km/h, or of the other sign (correlation {correlation:.2f})"
        remedy = "if it has those of the log, give a_y of the simulator as well"
        yield InputProblem(reason, remedy, str(file), column=str(vehicle.columns.v_y))


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
    """Cut logs of a simulator with as much noise as the log has: they are compared as closely as
    the log shows the car. Below that, effects stand for steps and order of an integration."""
    generator, noisy = np.random.default_rng(0), {}
    for name, log in log_windows.items():
        data, rows = log.windows
        added = noise * generator.standard_normal(data.logged.shape)
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
        quantity, unit, of = _STATED.get(effect.id, ("amplitude", effect.unit, lambda _, x: x))
        slope = abs(of(vehicle, size + 1e-6) - of(vehicle, size - 1e-6)) / 2e-6
        sizes[f"{effect.id}: {quantity}"] = Number(of(vehicle, size), std * slope, unit)
    standing = standing_of(case.verdict, [untestable.effect for untestable in case.untestable])
    for effect_id, (helps, *_) in helping.items():
        standing[effect_id], standing[helps] = standing[helps], standing.get(effect_id, "possible")
    return Source(name, "description", file, "car", "", numbers, {}, sizes, standing)
