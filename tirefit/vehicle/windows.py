"""Windows of logs, in each of which a car is predicted from its own start state: their cut,
the quantities at their samples on which effects depend, and least squares over all windows
with the start states eliminated."""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import cumulative_trapezoid

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
from tirefit.fitting.source import GivenTire
from tirefit.models import AbstractTire, TireInputs
from tirefit.results import DataError, InputProblem, UsageError
from tirefit.vehicle.car import axle_loads
from tirefit.vehicle.effects import Samples
from tirefit.vehicle.shooting import Data

Piece = TypeVar("Piece")

_START_ROWS = 4000
"""Approximate number of rows to which the first tire of an axle is fitted."""


class CutLog(NamedTuple, Generic[Piece]):
    """A log, cut up, and the names of its runs."""

    motion: Motion
    windows: Piece
    runs: tuple[str, ...]
    missing: tuple[str, ...] = ()  # see ``Track``, and what ``[keep]`` leaves out
    path: str = ""
    sha256: str = ""
    epoch: float = 0.0  # see ``Track``


def known_vehicle(vehicle: Vehicle | str | Path) -> Vehicle:
    """The vehicle of a ``vehicle.toml``, or the given one."""
    return vehicle if isinstance(vehicle, Vehicle) else load_vehicle(vehicle)


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
    cut: Callable[[Track, Motion], Piece | None],
    long_enough: str,
    shorter: str,
) -> dict[str, CutLog[Piece]]:
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
    log_windows: dict[str, CutLog[Piece]] = {}
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
            reason += f": the longest is {_longest(motion, vehicle):.2g} s"
            remedy = f"use {shorter}, or lower keep.v_min of vehicle.toml"
            problems.append(InputProblem(reason, remedy, str(file)))
        else:
            log_windows[run_name(file)] = CutLog(
                motion,
                windows,
                names_of_runs(file, track),
                (*track.missing, *left),
                str(file),
                track.sha256,
                track.epoch,
            )
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


def _longest(motion: Motion, vehicle: Vehicle) -> float:
    """Length [s] of the longest stretch of a log in which the car drives forward."""
    good = motion.settled & (motion.v_x > vehicle.v_min)
    rows = [last - first for first, last in stretches(good, motion.part)]
    return max(rows, default=0) / vehicle.filter.sample_rate


def stretches(good: np.ndarray, part: np.ndarray) -> list[tuple[int, int]]:
    """First row of each unbroken stretch of good rows (n,), and the row after its end;
    ``part`` (n,) numbers the stretches between gaps of the log."""
    broken = np.flatnonzero(~good[1:] | ~good[:-1] | (np.diff(part) != 0)) + 1
    ends = zip([0, *broken], [*broken, len(good)], strict=True)
    return [(int(first), int(last)) for first, last in ends if good[first]]


_MOST = 10_000
"""Most windows of a log. They overlap, so that more of them hardly change the errors. With
10,000 windows a replay of 1,000,000 rows at 50 Hz takes 42 s of processor time and 3.5 GB."""


def starts_in(
    each: Sequence[tuple[int, int]], least: int, step: int
) -> tuple[list[tuple[int, int]], int]:
    """Starts of windows in stretches, and the rows from one to the next.

    Args:
        each: first row of each stretch, and the row after its end.
        least: rows of the shortest window.
        step: rows from one start to the next; a multiple of it in a long log.

    Returns:
        (start, end of its stretch) of each window, about :data:`_MOST` or fewer unless
        there are as many stretches; and the step.
    """
    room = sum(max(last - first - least, 0) for first, last in each)
    step *= max(math.ceil(room / step / _MOST), 1)
    return [(k, last) for first, last in each for k in range(first, last - least + 1, step)], step


def integrated(motion: Motion, rate: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Heading and position (n,) of a log of rates, relative to its first sample."""
    yaw, v_x, v_y = (np.nan_to_num(v) for v in (motion.yaw_rate, motion.v_x, motion.v_y))
    integral = partial(cumulative_trapezoid, dx=1 / rate, initial=0)
    heading = integral(yaw)
    cos, sin = np.cos(heading), np.sin(heading)
    return heading, integral(v_x * cos - v_y * sin), integral(v_x * sin + v_y * cos)


_LEAD = 0.3
"""Time [s] of steering before a window, for its delay beyond the stated one."""

_LESS = 0.5  # share of the curvature left unexplained up to which a later steering explains more

_EXACT = 1e-9  # smallest standard error of a state, of a log without noise

CHANNELS = {2: ("v_y", "yaw_rate"), 3: ("heading", "x", "y")}
"""Names of the logged channels of a log of rates, and of one of poses."""


def windows_of(
    track: Track, motion: Motion, vehicle: Vehicle, window: float
) -> tuple[Data, np.ndarray] | None:
    """:class:`Data` of a log, and the rows (w, k) of its motion; None without a window."""
    rate = vehicle.filter.sample_rate
    stated = vehicle.steering.delay if vehicle.steering else 0.0
    count, lead = round(window * rate) + 1, round((_LEAD + stated) * rate)
    logged, command = logged_channels(track, motion, vehicle)
    state = states_of(motion, vehicle)
    steering = road_wheel(replace(motion, command=command), vehicle)
    good = motion.settled & (motion.v_x > vehicle.v_min)
    good &= np.isfinite(np.column_stack([motion.v_x, logged, steering])).all(axis=1)
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
    noisy = states_of(with_noise(track, motion, vehicle, np.random.default_rng(0)), vehicle)
    std = np.tile(np.std((noisy - state)[good], axis=0) + _EXACT, (len(at), 1))
    cut = motion.v_x[at], steering[rows], logged[at], state[at[:, 0]], std
    return Data(*map(jnp.asarray, cut)), at


def cut_in_windows(
    logs: Sequence[str | Path], vehicle: Vehicle, window: float
) -> dict[str, CutLog[tuple[Data, np.ndarray]]]:
    """:func:`cut_logs` by :func:`windows_of` of a length [s]."""
    return cut_logs(
        listed(logs),
        vehicle,
        partial(windows_of, vehicle=vehicle, window=window),
        f"{window:g} s long",
        "a shorter window",
    )


def logged_channels(
    track: Track, motion: Motion, vehicle: Vehicle
) -> tuple[np.ndarray, np.ndarray]:
    """Values of the log for the centre of gravity, on the grid, unfiltered: channels (n, c),
    and the steering command (n,), without the stated delay."""
    raw = {
        channel.quantity: np.interp(motion.time, track.time, values)
        for channel, values in zip(track.channels, track.signals.T, strict=True)
        if np.isfinite(values).all()
    }
    ahead, left = vehicle.cg_from_tracked
    command = raw.get("steering")
    if command is None:  # a log with blanks: the filtered one, which has the stated delay
        late = vehicle.steering.delay if vehicle.steering else 0.0
        command = np.interp(motion.time + late, motion.time, motion.command, right=np.nan)
    if vehicle.columns.motion == POSE:
        yaw = raw["yaw"]
        cos, sin = np.cos(yaw), np.sin(yaw)
        place = raw["x"] + ahead * cos - left * sin, raw["y"] + ahead * sin + left * cos
        return np.column_stack([yaw, *place]), command
    cos, sin = np.cos(vehicle.sideslip_offset), np.sin(vehicle.sideslip_offset)
    v_y = cos * raw["v_y"] + sin * raw["v_x"] + ahead * raw["yaw_rate"]
    return np.column_stack([v_y, raw["yaw_rate"]]), command


def states_of(motion: Motion, vehicle: Vehicle) -> np.ndarray:
    """States (n, s) of the centre of gravity as measured, filtered: the first of
    :class:`tirefit.vehicle.car.State`."""
    place = [motion.heading, motion.x, motion.y] if vehicle.columns.motion == POSE else []
    return np.column_stack([motion.v_y, motion.yaw_rate, *place])


_MOST_SAMPLES = 4000
"""Largest number of samples of all windows, evenly spread."""

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
    log_windows: Mapping[str, CutLog[Any]], vehicle: Vehicle, tires: Sequence[GivenTire]
) -> tuple[JoinedWindows, set[str]]:
    """The windows of all logs, and the needs of effects that they meet."""
    data, rows, log = [], [], []
    passed = 0.0
    for number, part in enumerate(log_windows.values()):
        motion, (windows, at) = part.motion, part.windows
        data.append(windows)
        rows.append(samples_of(motion, at, vehicle, tires, passed))
        log.append(np.full(len(at), number))
        passed += float(motion.time[-1] - motion.time[0])
    whole = jax.tree.map(lambda *part: np.concatenate(part), *data)
    joint = jax.tree.map(lambda *part: np.concatenate(part), *rows)
    speed = joint.speed / np.mean(joint.speed)
    joint = joint._replace(speed=speed, time=joint.time / passed - 0.5)
    has = {"heading"} if vehicle.columns.motion == POSE else {"rates"}
    has |= {"acceleration"} if np.std(joint.along) > _VARIES else set()
    has |= {"speeds"} if np.std(speed) > _VARIES else set()
    cut = JoinedWindows(whole, joint, np.concatenate(log))
    most = max(_MOST_SAMPLES // speed.shape[1], LEAST_WINDOWS)
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


def derived_rows(log_windows: Mapping[str, CutLog[Any]], vehicle: Vehicle, axle: str) -> TireData:
    """Slip angle and force of an axle by the equations of ``derive``, of all logs.

    Slip angles of the front axle are those of the steering at :func:`lateness`: of a steering that
    is late, the force may seem to fall with the slip.
    """
    late = lateness(log_windows, vehicle) if axle == "front" else 0.0
    columns: dict[str, list[Any]] = {"alpha": [], "fy": [], "v": [], "run": []}
    for log in log_windows.values():
        motion, (name, *_) = _later(log.motion, late), log.runs
        alpha, force, speed = slip_and_force(motion, vehicle, axle)
        good = motion.settled & (motion.v_x > vehicle.v_min)
        good &= (np.abs(alpha) < np.pi / 2) & (speed > 0)  # not while the car spins
        each: tuple[Any, ...] = alpha[good], force[good], speed[good]
        for key, values in zip(columns, (*each, [name] * good.sum()), strict=True):
            columns[key].extend(values)
    step = max(len(columns["run"]) // _START_ROWS, 1)
    cells = {k: np.array(v)[::step] for k, v in columns.items()}
    load = axle_loads(vehicle)[axle == "rear"]
    return read_frame(cells | {"fz": np.full(len(cells["run"]), load)}, ", ".join(log_windows))


def _later(motion: Motion, late: float) -> Motion:
    """The motion with its steering command later by a time [s]."""
    return replace(motion, command=np.interp(motion.time - late, motion.time, motion.command))


def lateness(log_windows: Mapping[str, CutLog[Any]], vehicle: Vehicle) -> float:
    """Delay [s] beyond the stated one, up to :data:`_LEAD`, at which steering and curvature of the
    path have the largest correlation; 0 if that is negative, as of a reversed steering, or explains
    hardly more of the curvature."""
    correlations = dict[float, float]()
    for late in np.arange(0.0, _LEAD, 1 / vehicle.filter.sample_rate):
        pairs = []
        for log in log_windows.values():
            motion = _later(log.motion, late)
            good = motion.settled & (motion.v_x > vehicle.v_min)
            curvature = motion.yaw_rate[good] / motion.v_x[good]
            pairs.append(np.stack([road_wheel(motion, vehicle)[good], curvature]))
        correlations[float(late)] = float(np.corrcoef(np.concatenate(pairs, axis=1))[0, 1])
    best = max(correlations, key=lambda late: abs(correlations[late]))
    first, largest = correlations[0.0], correlations[best]
    return best if largest > 0 and 1 - largest**2 < _LESS * (1 - first**2) else 0.0
