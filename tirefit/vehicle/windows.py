"""Windows of logs, in each of which a car is predicted from its own start state: their cut, and
the quantities at their samples on which effects depend."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from tirefit.data.read import read_frame
from tirefit.data.readers.remote import file_at
from tirefit.data.table import TireData
from tirefit.data.vehicle.contradictions import compare
from tirefit.data.vehicle.derive import name_problems, names_of_runs, run_name
from tirefit.data.vehicle.motion import (
    Motion,
    not_driven,
    read_motion,
    road_wheel,
    slip_and_force,
    with_noise,
)
from tirefit.data.vehicle.track import Track
from tirefit.data.vehicle.vehicle import POSE, Vehicle, load_vehicle
from tirefit.diagnosis.effects.state import peak_ratio, slope_at_rest
from tirefit.files import listed
from tirefit.fitting.problem.build import build
from tirefit.fitting.problem.config import FitConfig
from tirefit.fitting.solve.multistart import solve_problem
from tirefit.fitting.source import GivenTire
from tirefit.fitting.store import at_estimate
from tirefit.models import MODELS, AbstractTire, TireInputs
from tirefit.results import DataError, InputProblem, UsageError
from tirefit.vehicle.car import AXLES, State, axle_loads
from tirefit.vehicle.effects import Samples
from tirefit.vehicle.shooting import Data

_START_ROWS = 4000
"""Approximate number of rows to which the first tire of an axle is fitted."""


class CutLog(NamedTuple):
    """A log, cut into windows, with its path and the names of its runs."""

    motion: Motion
    windows: Any
    runs: tuple[str, ...]
    track: Track
    missing: tuple[str, ...] = ()  # see ``Track``, and what ``[keep]`` leaves out
    path: str = ""


def known_vehicle(vehicle: Vehicle | str | Path) -> Vehicle:
    """The vehicle of a ``vehicle.toml``, or the given one."""
    return vehicle if isinstance(vehicle, Vehicle) else load_vehicle(vehicle)


def stated_delay(vehicle: Vehicle) -> float:
    """Delay [s] of the wheels behind the logged steering that ``vehicle.toml`` states."""
    return vehicle.steering.delay if vehicle.steering else 0.0


def steering_problems(vehicle: Vehicle, what: str) -> list[InputProblem]:
    """A problem if a vehicle has no steering map, which ``what`` needs."""
    if vehicle.steering is not None:
        return []
    remedy = "name columns.steering and give [steering] in vehicle.toml; without,"
    remedy += " tirefit derive --axle rear gives the rear axle's slip and force"
    return [InputProblem(f"{what} needs the road wheel angle", remedy)]


def cut_logs(
    logs: Sequence[str | Path],
    vehicle: Vehicle,
    cut: Callable[[Track, Motion], Any],
    long_enough: str,
    shorter: str,
) -> dict[str, CutLog]:
    """Motion and windows of each log, under the name of the log.

    Args:
        cut: returns the windows of a log; None if it has none.
        long_enough: in words, how long a stretch of a log must be.
        shorter: in words, what to ask for where none is.

    Raises:
        UsageError: no log, or two logs of one name.
        DataError: with the problems of all logs: one that cannot be read, whose
            channels contradict each other, or without a stretch that is long enough.
    """
    UsageError.raise_for(name_problems(logs))
    log_windows: dict[str, CutLog] = {}
    problems: list[InputProblem] = []
    for path in logs:
        file = file_at(path)
        try:
            track, motion, _ = read_motion(file, vehicle)
        except DataError as error:
            problems += error.problems
            continue
        if faults := compare(track, motion, vehicle, str(file)).problems:
            # --believe is an option of derive only, so do not mention it here.
            for fault in faults:
                remedy = re.sub(r",? or [^,]*--.*", "", fault.remedy)
                problems.append(replace(fault, remedy=remedy))
            continue
        stopped = not_driven(track, motion, vehicle)
        left = left_out(motion, stopped, vehicle)
        motion = replace(motion, settled=motion.settled & ~np.any([*stopped.values()], axis=0))
        windows = cut(track, motion)
        if windows is None:
            reason = f"no stretch above {vehicle.v_min:.3g} m/s is {long_enough}"
            good = motion.settled & (motion.v_x > vehicle.v_min)
            rows = max((last - first for first, last in stretches(good, motion.part)), default=0)
            reason += f": the longest is {rows / vehicle.filter.sample_rate:.2g} s"
            remedy = f"use {shorter}, or lower keep.v_min of vehicle.toml"
            problems.append(InputProblem(reason, remedy, str(file)))
        else:
            runs, missing = names_of_runs(file, track), (*track.missing, *left)
            log_windows[run_name(file)] = CutLog(motion, windows, runs, track, missing, str(file))
    DataError.raise_for(problems)
    return log_windows


def left_out(
    motion: Motion, reasons: Mapping[str, np.ndarray], vehicle: Vehicle
) -> tuple[str, ...]:
    """Sentences on the settled time that is left out for each reason -> samples (n,) bool."""
    there, messages = motion.settled, []
    for reason, rows in reasons.items():
        if span := np.count_nonzero(there & rows) / vehicle.filter.sample_rate:
            messages.append(f"{span:.3g} s are left out as {reason}")
        there = there & ~rows
    return tuple(messages)


def stretches(good: np.ndarray, part: np.ndarray) -> list[tuple[int, int]]:
    """First row of each unbroken stretch of good rows (n,), and the row after its end;
    ``part`` (n,) numbers the stretches between gaps of the log."""
    broken = np.flatnonzero(~good[1:] | ~good[:-1] | (np.diff(part) != 0)) + 1
    ends = zip([0, *broken], [*broken, len(good)], strict=True)
    return [(int(first), int(last)) for first, last in ends if good[first]]


LEAD = 0.3
"""Time [s] of steering before a window, for its delay beyond the stated one."""

CHANNELS = {2: ("v_y", "yaw_rate"), 3: ("heading", "x", "y")}
"""Names of the logged channels of a log of rates, and of one of poses."""


def windows_of(
    track: Track, motion: Motion, vehicle: Vehicle, window: float
) -> tuple[Data, np.ndarray] | None:
    """:class:`Data` of a log, and the rows (w, k) of its motion; None without a window."""
    rate = vehicle.filter.sample_rate
    count, lead = round(window * rate) + 1, round((LEAD + stated_delay(vehicle)) * rate)
    logged, command = logged_channels(track, motion, vehicle)
    fields = State._fields[: 5 if vehicle.columns.motion == POSE else 2]
    state, noisy = (
        np.column_stack([getattr(of, name) for name in fields])
        for of in (motion, with_noise(track, motion, vehicle, np.random.default_rng(0)))
    )
    steering = road_wheel(replace(motion, command=command), vehicle)
    good = motion.settled & (motion.v_x > vehicle.v_min)
    starts = [
        k
        for first, last in stretches(good, motion.part)
        for k in range(first + lead, last - count + 1, count - 1)
    ]
    if not starts:
        return None
    rows = np.array(starts)[:, None] + np.arange(-lead, count)
    at = rows[:, lead:]
    # The noise of the log, through its filter.
    # Above zero, for a log without noise.
    std = np.tile(np.std((noisy - state)[good], axis=0) + 1e-9, (len(at), 1))
    cut = motion.v_x[at], steering[rows], logged[at], state[at[:, 0]], std
    return Data(*map(jnp.asarray, cut)), at


def cut_in_windows(
    logs: Sequence[str | Path], vehicle: Vehicle, window: float
) -> dict[str, CutLog]:
    """:func:`cut_logs` by :func:`windows_of` of a length [s]."""
    cut = partial(windows_of, vehicle=vehicle, window=window)
    return cut_logs(listed(logs), vehicle, cut, f"{window:g} s long", "a shorter window")


def logged_channels(
    track: Track, motion: Motion, vehicle: Vehicle
) -> tuple[np.ndarray, np.ndarray]:
    """Values of the log for the centre of gravity, on the grid, unfiltered: channels (n, c),
    and the steering command (n,), without the stated delay."""
    raw = {
        channel.quantity: np.interp(motion.time, track.time, values)
        for channel, values in zip(track.channels, track.signals.T, strict=True)
    }
    command, (ahead, left) = raw["steering"], vehicle.cg_from_tracked
    if vehicle.columns.motion == POSE:
        yaw = raw["yaw"]
        cos, sin = np.cos(yaw), np.sin(yaw)
        place = raw["x"] + ahead * cos - left * sin, raw["y"] + ahead * sin + left * cos
        return np.column_stack([yaw, *place]), command
    cos, sin = np.cos(vehicle.sideslip_offset), np.sin(vehicle.sideslip_offset)
    v_y = cos * raw["v_y"] + sin * raw["v_x"] + ahead * raw["yaw_rate"]
    return np.column_stack([v_y, raw["yaw_rate"]]), command


LEAST_WINDOWS = 8
"""Smallest number of windows of a diagnosis."""

_VARIES = 0.02
"""Smallest spread of the forward acceleration over g, and of the speed over its mean, that
shows effects of these."""


class JoinedWindows(NamedTuple):
    """Windows (w, k) of all logs: :class:`Data`, :class:`Samples` of effects, and the
    log (w,) of each."""

    data: Data
    rows: Samples
    log: np.ndarray


def joined_windows(
    log_windows: Mapping[str, CutLog], vehicle: Vehicle, tires: Sequence[GivenTire]
) -> tuple[JoinedWindows, set[str]]:
    """The windows of all logs, and the needs of effects that they meet."""
    parts, passed = [], 0.0
    for number, log in enumerate(log_windows.values()):
        data, at = log.windows
        rows = samples_of(log.motion, at, vehicle, tires, passed)
        parts.append(JoinedWindows(data, rows, np.full(len(at), number)))
        passed += float(np.ptp(log.motion.time))
    cut: JoinedWindows = jax.tree.map(lambda *part: np.concatenate(part), *parts)
    speed = cut.rows.speed / np.mean(cut.rows.speed)
    cut = cut._replace(rows=cut.rows._replace(speed=speed, time=cut.rows.time / passed - 0.5))
    has = {"heading"} if vehicle.columns.motion == POSE else {"rates"}
    has |= {"acceleration"} if np.std(cut.rows.along) > _VARIES else set()
    has |= {"speeds"} if np.std(speed) > _VARIES else set()
    most = max(4000 // speed.shape[1], LEAST_WINDOWS)  # of 4000 samples, evenly spread
    if len(cut.log) > most:
        kept = np.linspace(0, len(cut.log) - 1, most).round().astype(int)
        cut = jax.tree.map(lambda part: part[kept], cut)
    return cut, has


def samples_of(
    motion: Motion,
    rows: np.ndarray,
    vehicle: Vehicle,
    tires: Sequence[GivenTire],
    passed: float = 0.0,
) -> Samples:
    """The quantities on which effects depend, at the rows (w, k) of a log. ``across`` and ``turn``
    are zero until they are set from a fit; ``passed`` [s] is the duration of the previous logs."""
    g, count = vehicle.gravity, len(rows)
    weight, wheelbase = vehicle.mass * g, vehicle.l_f + vehicle.l_r
    v_x = motion.v_x[rows]
    speed = float(v_x.mean())
    axles = zip(tires, axle_loads(vehicle), strict=True)
    sliding = [_sliding(tire.tire, float(load), speed) for tire, load in axles]
    heading = motion.heading if vehicle.columns.motion == POSE else 0 * motion.time
    return Samples(
        speed=v_x,
        along=motion.a_x[rows] / g,
        across=0 * v_x,
        turn=0 * v_x,
        time=passed + motion.time[rows] - motion.time[0],
        heading=heading[rows],
        weight=np.full(count, weight),
        wheelbase=np.full(count, wheelbase),
        sliding=np.tile(sliding, (count, 1)),
    )


def _sliding(tire: AbstractTire, load: float, speed: float) -> float:
    """Slip above which a brush with slope and peak of the tire slides."""
    slope = slope_at_rest(tire, TireInputs(fz=load, v=speed), "y")
    return float(3 * peak_ratio(tire, load, speed) * load / slope)


def started_tires(
    tires: Sequence[GivenTire], log_windows: Mapping[str, CutLog], vehicle: Vehicle
) -> tuple[list[GivenTire], list[TireData], float]:
    """The tires of both axles, a model given by name fitted to the slip angles and forces of the
    logs by the equations of ``derive``; these; and the :func:`lateness` of the steering."""
    late = lateness(log_windows, vehicle)
    rows = [derived_rows(log_windows, vehicle, axle, late) for axle in AXLES]
    started = []
    for tire, of_axle in zip(tires, rows, strict=True):
        if tire.fit is None and tire.name in MODELS:
            solved = solve_problem(build(of_axle, tire.name, FitConfig()), FitConfig())
            layout = solved.problem.layout
            made = at_estimate(solved.problem.model, layout, solved.z)
            tire = replace(tire, tire=made, fit=(layout, solved.z, solved.covariance))
        started.append(tire)
    return started, rows, late


def derived_rows(
    log_windows: Mapping[str, CutLog], vehicle: Vehicle, axle: str, late: float
) -> TireData:
    """Slip angle and force of an axle by the equations of ``derive``, of all logs, with a steering
    that is late by a time [s]: as logged, the force may seem to fall with the slip of the front
    axle."""
    parts = []
    for log in log_windows.values():
        alpha, force, speed = slip_and_force(_later(log.motion, late), vehicle, axle)
        good = log.motion.settled & (log.motion.v_x > vehicle.v_min)
        good &= (np.abs(alpha) < np.pi / 2) & (speed > 0)  # not while the car spins
        parts.append((alpha[good], force[good], speed[good], [log.runs[0]] * good.sum()))
    columns = [np.concatenate(part) for part in zip(*parts, strict=True)]
    step = max(len(columns[0]) // _START_ROWS, 1)
    cells = {k: x[::step] for k, x in zip(("alpha", "fy", "v", "run"), columns, strict=True)}
    cells["fz"] = np.full(len(cells["run"]), axle_loads(vehicle)[AXLES.index(axle)])
    return read_frame(cells, ", ".join(log_windows))


def _later(motion: Motion, late: float) -> Motion:
    """The motion with its steering command later by a time [s]."""
    return replace(motion, command=np.interp(motion.time - late, motion.time, motion.command))


def lateness(log_windows: Mapping[str, CutLog], vehicle: Vehicle) -> float:
    """Delay [s] beyond the stated one, up to :data:`LEAD`, at which steering and curvature of the
    path have the largest correlation; 0 if that is negative, as of a reversed steering, or explains
    hardly more of the curvature."""
    correlations = dict[float, float]()
    for late in np.arange(0.0, LEAD, 1 / vehicle.filter.sample_rate):
        pairs = []
        for log in log_windows.values():
            motion = _later(log.motion, late)
            good = motion.settled & (motion.v_x > vehicle.v_min)
            curvature = motion.yaw_rate[good] / motion.v_x[good]
            pairs.append(np.stack([road_wheel(motion, vehicle)[good], curvature]))
        correlations[float(late)] = float(np.corrcoef(np.concatenate(pairs, axis=1))[0, 1])
    best = max(correlations, key=lambda late: abs(correlations[late]))
    first, largest = correlations[0.0], correlations[best]
    # It explains more if it leaves half of the curvature that the stated delay leaves.
    return best if largest > 0 and 1 - largest**2 < 0.5 * (1 - first**2) else 0.0
