"""Windows of vehicle logs, over which a car is predicted."""

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from tirefit.data.contradictions import compare
from tirefit.data.derive import name_problems, run_name
from tirefit.data.motion import Motion, read_motion
from tirefit.data.remote import file_at
from tirefit.data.track import Track
from tirefit.data.vehicle import Vehicle, load_vehicle
from tirefit.results import DataError, InputProblem, UsageError

Cut = TypeVar("Cut")


def known_vehicle(vehicle: Vehicle | str | Path) -> Vehicle:
    """The vehicle of a ``vehicle.toml``, or as it is given."""
    return vehicle if isinstance(vehicle, Vehicle) else load_vehicle(vehicle)


def steering_problems(vehicle: Vehicle, what: str) -> list[InputProblem]:
    """That a vehicle has no steering map, which ``what`` needs."""
    if vehicle.steering is not None:
        return []
    remedy = "name columns.steering and give [steering] in vehicle.toml"
    return [InputProblem(f"{what} needs the road wheel angle", remedy)]


def cut_logs(
    logs: Sequence[str | Path],
    vehicle: Vehicle,
    cut: Callable[[Track, Motion], Cut | None],
    long_enough: str,
    shorter: str,
) -> dict[str, tuple[Motion, Cut]]:
    """Motion and windows of each log, under the name of its run.

    Args:
        cut: the windows of a log; None where it has none.
        long_enough: in words, how long a stretch of a log must be.
        shorter: in words, what to ask for where none is.

    Raises:
        UsageError: no log, or two logs of one name.
        DataError: with the problems of all logs: one that cannot be read, whose
            channels contradict each other, or without a stretch that is long enough.
    """
    UsageError.raise_for(name_problems(logs))
    found: dict[str, tuple[Motion, Cut]] = {}
    problems: list[InputProblem] = []
    for path in logs:
        file = file_at(path)
        try:
            track, motion, _ = read_motion(file, vehicle)
        except DataError as error:
            problems += error.problems
            continue
        if faults := compare(track, motion, vehicle, str(file)).problems:
            # An option of derive is none of the commands that cut windows.
            problems += [
                replace(one, remedy=re.sub(r",? or [^,]*--.*", "", one.remedy))
                for one in faults
            ]
            continue
        windows = cut(track, motion)
        if windows is None:
            reason = f"no stretch above {vehicle.v_min:.3g} m/s is {long_enough}"
            remedy = f"ask for {shorter}, or lower keep.v_min of vehicle.toml"
            problems.append(InputProblem(reason, remedy, str(file)))
        else:
            found[run_name(file)] = motion, windows
    DataError.raise_for(problems)
    return found


def stretches(good: np.ndarray, part: np.ndarray) -> list[tuple[int, int]]:
    """First row of each unbroken stretch of good rows (n,), and the row behind its end;
    ``part`` (n,) counts the stretches between gaps of the log."""
    broken = np.flatnonzero(~good[1:] | ~good[:-1] | (np.diff(part) != 0)) + 1
    ends = zip([0, *broken], [*broken, len(good)], strict=True)
    return [(int(first), int(last)) for first, last in ends if good[first]]
