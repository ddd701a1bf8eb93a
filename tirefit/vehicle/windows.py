"""Cut vehicle logs into windows over which a car is predicted."""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from tirefit.data.contradictions import compare
from tirefit.data.derive import name_problems, names_of_runs, run_name
from tirefit.data.motion import Motion, not_ahead, read_motion, slip_and_force
from tirefit.data.read import read_frame
from tirefit.data.remote import file_at
from tirefit.data.table import TireData
from tirefit.data.track import Track
from tirefit.data.vehicle import Vehicle, load_vehicle
from tirefit.results import DataError, InputProblem, UsageError

Cut = TypeVar("Cut")

_START_ROWS = 4000
"""Approximate number of rows to which the first tire of an axle is fitted."""


class CutLog(NamedTuple, Generic[Cut]):
    """A log, cut up, and the names of its runs."""

    motion: Motion
    windows: Cut
    runs: tuple[str, ...]
    missing: tuple[str, ...] = ()  # see :class:`tirefit.data.track.Track`


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
    cut: Callable[[Track, Motion], Cut | None],
    long_enough: str,
    shorter: str,
) -> dict[str, CutLog[Cut]]:
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
    found: dict[str, CutLog[Cut]] = {}
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
            problems += [
                replace(one, remedy=re.sub(r",? or [^,]*--.*", "", one.remedy)) for one in faults
            ]
            continue
        windows = cut(track, motion)
        if windows is None:
            reason = f"no stretch above {vehicle.v_min:.3g} m/s is {long_enough}"
            reason += f": the longest is {_longest(motion, vehicle):.2g} s"
            remedy = f"use {shorter}, or lower keep.v_min of vehicle.toml"
            problems.append(InputProblem(reason, remedy, str(file)))
        else:
            found[run_name(file)] = CutLog(
                motion, windows, names_of_runs(file, track), track.missing
            )
    DataError.raise_for(problems)
    return found


def left_out(motion: Motion, vehicle: Vehicle) -> tuple[str, ...]:
    """Sentences on the time in which the car does not drive forward, by reason."""
    there, messages = motion.settled, []
    for reason, rows in not_ahead(motion, vehicle).items():
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


def integrated(motion: Motion, rate: float):
    """Heading and position (n,) of a log of rates, relative to its first sample."""
    yaw, v_x, v_y = (np.nan_to_num(v) for v in (motion.yaw_rate, motion.v_x, motion.v_y))
    heading = _summed(yaw) / rate
    cos, sin = np.cos(heading), np.sin(heading)
    return (heading, _summed(v_x * cos - v_y * sin) / rate, _summed(v_x * sin + v_y * cos) / rate)


def _summed(values: np.ndarray) -> np.ndarray:
    """Cumulative integral by the trapezoidal rule, from zero."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]))])


def derived_rows(found: Mapping[str, CutLog], vehicle: Vehicle, axle: str) -> TireData:
    """Slip angle and force of an axle by the equations of ``derive``, of all logs."""
    columns: dict[str, list] = {"alpha": [], "fy": [], "v": [], "run": []}
    for log in found.values():
        motion, (name, *_) = log.motion, log.runs
        alpha, force, speed = slip_and_force(motion, vehicle, axle)
        good = motion.settled & (motion.v_x > vehicle.v_min)
        good &= (np.abs(alpha) < np.pi / 2) & (speed > 0)  # not while the car spins
        each = alpha[good], force[good], speed[good]
        for key, values in zip(columns, (*each, [name] * good.sum()), strict=True):
            columns[key].extend(values)
    step = max(len(columns["run"]) // _START_ROWS, 1)
    cells = {k: np.array(v)[::step] for k, v in columns.items()}
    arm = vehicle.l_r if axle == "front" else vehicle.l_f
    load = vehicle.mass * vehicle.gravity * arm / (vehicle.l_f + vehicle.l_r)
    return read_frame(cells | {"fz": np.full(len(cells["run"]), load)}, ", ".join(found))
