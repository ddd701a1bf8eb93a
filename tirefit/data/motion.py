"""A vehicle log to the motion of the centre of gravity: :func:`read_motion`.

The log's usable rows are brought to a uniform rate between the gaps, low-passed without
phase, moved to the centre of gravity and differentiated. Axes are those of ISO 8855:
x forward, y left, yaw counter-clockwise.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tirefit.data.read import Table, read_table
from tirefit.data.vehicle import POSE, Vehicle
from tirefit.results import DataError, InputProblem

__all__ = ["Motion", "Track", "read_motion"]

_MISSING = {"", "nan", "na", "null", "none"}
_MOST_PROBLEMS = 10
_CLOSEST = 0.3
"""Samples nearer than this part of the log's period are one sample (a repeat)."""


@dataclass(frozen=True)
class Track:
    """Usable samples of a log.

    Attributes:
        time: Increasing, (n,) [s] from the first one.
        signals: (n, k) in SI: the pose or the rates, then the steering command if any.
        active: (n,) bool, whether the vehicle was driven.
        max_gap: Longest time between two samples that is interpolated [s].
        epoch: The log's time [s] at time 0.
        rows: Rows in the file.
        dropped: Reason -> rows that were not used.
        sha256: Of the file.
        notes: What was assumed to read the file.
    """

    time: np.ndarray
    signals: np.ndarray
    active: np.ndarray
    max_gap: float
    epoch: float
    rows: int
    dropped: Mapping[str, int]
    sha256: str
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Motion:
    """Motion of the centre of gravity on the grid, (n,) each, SI, ISO 8855 axes.

    ``heading`` [rad, not wrapped], ``x`` and ``y`` [m] over the floor are NaN of a log
    of rates; ``command`` is the steering command (0 without one); ``part`` (n,) int
    counts the stretches between gaps, ``within`` (n,) [s] is the time to the nearer end
    of the sample's own; ``settled`` (n,) bool is False where an edge or a gap is too
    near, there the others may be NaN.
    """

    time: np.ndarray
    v_x: np.ndarray
    v_y: np.ndarray
    a_x: np.ndarray
    a_y: np.ndarray
    yaw_rate: np.ndarray
    yaw_acceleration: np.ndarray
    heading: np.ndarray
    x: np.ndarray
    y: np.ndarray
    command: np.ndarray
    part: np.ndarray
    within: np.ndarray
    settled: np.ndarray

    def rate_of(self, values: np.ndarray) -> np.ndarray:
        """Time derivative (n,) of values (n,), by central differences within each
        stretch; NaN in one of a single sample."""
        rate = np.full(len(values), np.nan)
        for number in np.unique(self.part):
            rows = self.part == number
            if rows.sum() > 1:
                rate[rows] = np.gradient(values[rows], self.time[rows])
        return rate


def read_motion(path: str | Path, vehicle: Vehicle) -> tuple[Track, Motion, int]:
    """The usable samples of a log, the motion on the grid, and the number of gaps.

    Raises:
        DataError: If the file cannot be read, lacks a column, holds text or is slower
            than the filter needs.
    """
    track = _track(Path(path), vehicle)
    return track, *_motion(track, vehicle)


# --- the file -------------------------------------------------------------------


def _read_columns(path: Path, vehicle: Vehicle) -> tuple[Table, dict[str, np.ndarray]]:
    """The file and, by header, the columns that the vehicle names, (n,) each.

    Empty cells and rows without the header's number of cells are NaN.
    """
    names = vehicle.columns
    wanted = [names.time, *(getattr(names, name) for name in names.motion)]
    wanted += [name for name in (names.steering, vehicle.keep.active) if name]
    table = read_table(path, wanted)
    absent = [name for name in dict.fromkeys(wanted) if name not in table.headers]
    if absent:
        known = ", ".join(table.headers)
        remedy = f"correct [columns] of vehicle.toml; the file has: {known}"
        raise DataError(
            [
                InputProblem("the column is missing", remedy, table.file, column=name)
                for name in absent
            ]
        )
    if table.units_row is not None and table.header_line is None:
        note = "units stated in the file are not used: those of vehicle.toml are"
        table = replace(table, units_row=None, notes=(*table.notes, note))
    if table.units_row is not None:
        assert table.header_line is not None  # units stand below a header
        raise DataError(
            InputProblem(
                "there is a row of units below the header",
                "remove it and state what is not SI in [units] of vehicle.toml",
                table.file,
                table.header_line + 1,
            )
        )
    problems: list[InputProblem] = []
    columns = {name: _numbers(table, name, problems) for name in dict.fromkeys(wanted)}
    if problems:
        more = len(problems) - _MOST_PROBLEMS
        shown = problems[:_MOST_PROBLEMS]
        if more > 0:
            shown.append(
                InputProblem(f"and {more} more cells like these", file=table.file)
            )
        raise DataError(shown)
    return table, columns


def _numbers(table: Table, name: str, problems: list[InputProblem]) -> np.ndarray:
    """One column, (n,); a missing cell is NaN, text is a problem."""
    values = np.full(len(table.lines), np.nan)
    cells = table.cells[table.headers.index(name)]
    if isinstance(cells, np.ndarray):  # of a file that has numbers, not text
        return cells.astype(float)
    for index, cell in enumerate(cells):
        if cell.strip().lower() in _MISSING:
            continue
        try:
            values[index] = float(cell)
        except ValueError:
            reason, line = f"{cell.strip()!r} is not a number", int(table.lines[index])
            problems.append(InputProblem(reason, "correct it", table.file, line, name))
    return values


# --- usable samples -------------------------------------------------------------


def _track(path: Path, vehicle: Vehicle) -> Track:
    """Rows with finite values, a later stamp than all before, and a new pose."""
    table, columns = _read_columns(path, vehicle)
    names = vehicle.columns
    time = columns[names.time] * vehicle.factor("time")
    measured = [
        columns[getattr(names, quantity)] * vehicle.factor(quantity)
        for quantity in names.motion
    ]
    if names.steering:
        measured.append(columns[names.steering])
    signals = np.column_stack(measured)
    active = np.ones(len(time), bool)
    if vehicle.keep.active:
        active = columns[vehicle.keep.active] == vehicle.keep.active_value
    finite = np.isfinite(time) & np.isfinite(signals).all(axis=1)
    time, signals, active = time[finite], signals[finite], active[finite]
    period = _period(time, vehicle, table.file)
    later = _later(time, period)
    fresh = later.copy()
    if names.motion == POSE:
        # A tracker that lost its target repeats the last pose under new stamps.
        fresh[1:] &= np.any(np.diff(signals[:, :3], axis=0) != 0, axis=1)
    dropped = {
        "a value is missing": int(np.count_nonzero(~finite)),
        "repeated or backward time": int(np.count_nonzero(~later)),
        "repeated pose": int(np.count_nonzero(later & ~fresh)),
    }
    epoch = float(time[fresh][0])
    signals = signals[fresh]
    if names.motion == POSE:
        signals[:, 2] = np.unwrap(signals[:, 2]) + vehicle.yaw_offset
    max_gap = vehicle.filter.max_gap or 3.5 * period
    return Track(
        time[fresh] - epoch, signals, active[fresh], max_gap, epoch,
        len(table.lines), dropped, table.sha256, table.notes,
    )  # fmt: skip


def _period(time: np.ndarray, vehicle: Vehicle, file: str) -> float:
    """Median time between samples [s], from the steps forward."""
    steps = np.diff(time)
    steps = steps[steps > 0]
    cutoff = vehicle.filter.cutoff
    needed = f"a log of at least {4 * cutoff:g} Hz for a cutoff of {cutoff:g} Hz"
    if len(steps) == 0:
        raise DataError(
            InputProblem("holds fewer than two samples", f"give {needed}", file)
        )
    period = float(np.median(steps))
    if period > 1 / (4 * cutoff):
        raise DataError(
            InputProblem(
                f"is sampled at {1 / period:.3g} Hz only",
                f"give {needed}, lower filter.cutoff, or check the unit of time",
                file,
                column=vehicle.columns.time,
            )
        )
    return period


def _later(time: np.ndarray, period: float) -> np.ndarray:
    """Which samples come clearly after the last one taken, (n,) bool."""
    taken = np.zeros(len(time), bool)
    last = -math.inf
    for index, stamp in enumerate(time.tolist()):
        if stamp - last > _CLOSEST * period:
            taken[index] = True
            last = stamp
    return taken


# --- motion ---------------------------------------------------------------------

_Rates = tuple[np.ndarray, ...]
"""v_x, v_y, a_x, a_y, r, r', heading, x, y of the centre of gravity, (n,) each."""


def _stretch(*fields) -> Motion:
    """From the fields in their order."""
    return Motion(**dict(zip(Motion.__dataclass_fields__, fields, strict=True)))


def _motion(track: Track, vehicle: Vehicle) -> tuple[Motion, int]:
    """Motion on one uniform grid that leaves out the gaps, and their number."""
    rate = vehicle.filter.sample_rate
    splits = np.flatnonzero(np.diff(track.time) > track.max_gap) + 1
    margin = vehicle.margin
    convert = _from_pose if vehicle.columns.motion == POSE else _from_rates
    parts = []
    for number, rows in enumerate(np.split(np.arange(len(track.time)), splits)):
        time = track.time[rows]
        first, last = math.ceil(time[0] * rate), math.floor(time[-1] * rate)
        grid = np.arange(first, last + 1) / rate
        signals = _filtered(time, track.signals[rows], grid, vehicle)
        part = np.full(len(grid), number)
        within = np.minimum(grid - time[0], time[-1] - grid)
        inside = (grid >= time[0] + margin) & (grid <= time[-1] - margin)
        if signals is None:
            nan, never = np.full(len(grid), np.nan), np.zeros(len(grid), bool)
            parts.append(_stretch(grid, *[nan] * 10, part, within, never))
            continue
        command = signals[:, -1] if vehicle.steering else np.zeros(len(grid))
        rates = convert(signals, vehicle)
        parts.append(_stretch(grid, *rates, command, part, within, inside))
    fields = Motion.__dataclass_fields__
    joined = {
        name: np.concatenate([getattr(part, name) for part in parts]) for name in fields
    }
    return Motion(**joined), len(splits)


def _filtered(time, signals, grid, vehicle: Vehicle) -> np.ndarray | None:
    """Signals (n, k) on the grid, low-passed without phase; None if too short."""
    # Slow to import, and no other reader needs them.
    from scipy.interpolate import CubicSpline
    from scipy.signal import butter, sosfiltfilt

    settings = vehicle.filter
    padding = math.ceil(settings.settling * settings.sample_rate)
    if len(grid) <= 2 * padding:
        return None
    # Cubic: a straight line would cut the corners of a turn.
    uniform = CubicSpline(time, signals)(grid)
    sections = butter(
        settings.order, settings.cutoff, fs=settings.sample_rate, output="sos"
    )
    return sosfiltfilt(sections, uniform, axis=0, padlen=padding)


def _from_pose(signals: np.ndarray, vehicle: Vehicle) -> _Rates:
    """:data:`_Rates` from x, y, yaw."""
    rate = vehicle.filter.sample_rate
    x, y, yaw = signals[:, :3].T
    cos, sin = np.cos(yaw), np.sin(yaw)
    ahead, left = vehicle.cg_from_tracked
    position = np.array([x + ahead * cos - left * sin, y + ahead * sin + left * cos])
    velocity = np.gradient(position, 1 / rate, axis=1)
    acceleration = np.gradient(velocity, 1 / rate, axis=1)
    yaw_rate = np.gradient(yaw, 1 / rate)

    def body(world: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return cos * world[0] + sin * world[1], cos * world[1] - sin * world[0]

    return (
        *body(velocity),
        *body(acceleration),
        yaw_rate,
        np.gradient(yaw_rate, 1 / rate),
        yaw,
        *position,
    )


def _from_rates(signals: np.ndarray, vehicle: Vehicle) -> _Rates:
    """As :func:`_from_pose`, from v_x, v_y, yaw rate, a_y at the tracked point."""
    rate = vehicle.filter.sample_rate
    v_x, v_y, yaw_rate, a_y = signals[:, :4].T
    yaw_acceleration = np.gradient(yaw_rate, 1 / rate)
    ahead, left = vehicle.cg_from_tracked
    a_x = np.gradient(v_x, 1 / rate) - yaw_rate * v_y
    return (
        v_x - yaw_rate * left,
        v_y + yaw_rate * ahead,
        a_x - yaw_acceleration * left - yaw_rate**2 * ahead,
        a_y + yaw_acceleration * ahead - yaw_rate**2 * left,
        yaw_rate,
        yaw_acceleration,
        *[np.full(len(v_x), np.nan)] * 3,
    )
