"""Read the usable samples of a vehicle log, in SI: :func:`read_track`."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tirefit.data.check import INFINITE, NO_VALUE, BadRows, excluded, list_problems, read_numbers
from tirefit.data.columns import guess, stated_unit
from tirefit.data.read import Table, read_table
from tirefit.data.readers.cells import words_of
from tirefit.data.readers.loggers import ARC, NO_UNIT
from tirefit.data.readers.quaternion import with_headings
from tirefit.data.readers.remote import Place
from tirefit.data.units import known_unit, units_of
from tirefit.data.vehicle.vehicle import CHECKS, POSE, QUANTITIES, Vehicle, unit_of
from tirefit.results import DataError, InputProblem

_CORRECT = "correct the cell, or name another column in [columns] of vehicle.toml"
_CLOSEST = 0.3  # samples closer than this share of the sampling period are repeats of one sample

_LASTING = 1.0
"""A new run begins if time stamps go back and stay back for this time [s]; rows that a
recorder wrote late end sooner."""

_MEANT = {"yaw": "heading", "v_x": "v"}
"""Quantity of a log -> its canonical column, if that has another name."""


@dataclass(frozen=True)
class Channel:
    """A column of a log, and the unit in which it is read."""

    quantity: str  # of :data:`tirefit.data.vehicle.vehicle.QUANTITIES`, or ``steering``
    header: str
    unit: str  # as written; "" for the steering command, which has a map instead
    factor: float  # from that unit to SI, negative for a channel of opposite sign
    named: bool  # whether ``[columns]`` names it; else it was recognised by its header


@dataclass(frozen=True)
class Track:
    """Usable samples of a log. ``signals`` (n, k) in SI are those of the motion, then the
    steering command if any, then channels to compare, which may be NaN."""

    time: np.ndarray  # increasing, (n,) [s] from the first one
    signals: np.ndarray
    channels: tuple[Channel, ...]  # the column that each signal comes from
    active: np.ndarray  # (n,) bool, whether the vehicle was driven
    max_gap: float  # longest time between two samples that is interpolated [s]
    epoch: float  # the log's time [s] at time 0
    rows: int  # in the file
    dropped: Mapping[str, int]  # reason -> rows that were not used
    sha256: str  # of the file
    notes: tuple[str, ...]  # assumptions in reading the file
    run: np.ndarray  # (n,) int, number of the run of each sample
    runs: tuple[str, ...]  # names of the runs; "" if the log is one run
    missing: tuple[str, ...] = ()  # sentences on what the file lacks: units, values of rows


def read_track(path: Place, vehicle: Vehicle) -> Track:
    """Read the rows with finite values, a stamp later than all before, and a new pose.

    Raises:
        DataError: unreadable file, missing column, text, or too low a rate.
    """
    table, vehicle = _read(path, vehicle)
    notes = list(table.notes)
    clock, *channels = _channels(table, vehicle, notes)
    columns = _numbers(table, [clock, *channels], vehicle.keep.active)
    time = columns[clock.header] * clock.factor
    signals = np.column_stack([columns[c.header] * c.factor for c in channels])
    active = np.ones(len(time), bool)
    if vehicle.keep.active:
        active = columns[vehicle.keep.active] == vehicle.keep.active_value
    headers = [h for h in table.headers if (g := guess(h)) and g.name == "run"]
    header = vehicle.columns.run or (headers[0] if len(headers) == 1 else None)
    label = np.full(len(table.lines), "")
    if header is not None:
        notes.append(f"column {header!r} read as the run")
        label = np.array(words_of(table.cells[table.headers.index(header)]))
    needed = len(vehicle.columns.motion) + (vehicle.steering is not None)
    finite = np.isfinite(time) & np.isfinite(signals[:, :needed]).all(axis=1)
    used = (clock, *channels[:needed])
    read = [c.header for c in used]
    if not finite.any():
        empty = [c for c in used if not np.isfinite(columns[c.header]).any()]
        _refuse(empty, "has no value in any row, but {} is needed", table.file)
        reason = f"no row has a value in all of {', '.join(map(repr, read))}"
        raise DataError(reason, _FILL, table.file)
    absent = {h: np.flatnonzero(~np.isfinite(columns[h])) for h in read}
    faults = [BadRows(header, rows, (), NO_VALUE) for header, rows in absent.items() if len(rows)]
    lacking, _ = excluded(faults, table.lines, table.file, False)
    time, signals, active = time[finite], signals[finite], active[finite]
    period = _period(time, vehicle, table.file)
    # A car that turns by more than noise of its heading leaves both axes.
    if vehicle.columns.motion == POSE and np.ptp(np.unwrap(signals[:, 2])) > 0.1:
        still = [c for c, x in zip(channels[:2], signals.T, strict=False) if not np.ptp(x)]
        _refuse(still, "{} is the same in all rows, while the car turns", table.file)
    max_gap = vehicle.filter.max_gap or 3.5 * period
    time, run, runs = _in_runs(time, label[finite], period, max_gap, notes)
    later = _later(time, period)
    fresh = later.copy()
    if vehicle.columns.motion == POSE:
        # A tracker that loses its target repeats the last pose with new stamps.
        fresh[1:] &= np.any(np.diff(signals[:, :3], axis=0) != 0, axis=1)
    dropped = {
        "a value is missing": int(np.count_nonzero(~finite)),
        "repeated or backward time": int(np.count_nonzero(~later)),
        "repeated pose": int(np.count_nonzero(later & ~fresh)),
    }
    signals = signals[fresh]
    for channel, values in zip(channels, signals.T, strict=True):
        if channel.quantity == "yaw":
            there = np.isfinite(values)
            values[there] = np.unwrap(values[there]) + vehicle.yaw_offset
    missing = (*table.doubts, *filter(None, [lacking]), *_unused(vehicle, (clock, *channels)))
    epoch = float(time[fresh][0]) + (table.epoch if clock.header == "time" else 0.0)
    return Track(
        time[fresh] - time[fresh][0], signals, tuple(channels), active[fresh],
        max_gap, epoch, len(table.lines), dropped, table.sha256,
        tuple(notes), run[fresh], runs, missing,
    )  # fmt: skip


_FILL = "fill the column, or name another one in [columns] of vehicle.toml"


def _refuse(wrong: Sequence[Channel], reason: str, file: str) -> None:
    """Raises DataError with a problem of each channel, if there are any."""
    texts = ((reason.format(channel.quantity), channel.header) for channel in wrong)
    DataError.raise_for([InputProblem(text, _FILL, file, None, header) for text, header in texts])


def _unused(vehicle: Vehicle, channels: Sequence[Channel]) -> list[str]:
    """Sentences on units of quantities that no column of the log has."""
    read = {channel.quantity for channel in channels}
    return [
        f"{name} = {text!r} of [units] or --unit is not used: the log has no column of {name}"
        for name, text in vehicle.units.items()
        if name not in read
    ]


def _in_runs(
    time: np.ndarray, label: np.ndarray, period: float, max_gap: float, notes: list[str]
) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Time (n,) continued where it restarts, the number of the run of each row (n,), and
    the names of the runs.

    Args:
        label: (n,) the names; if they are all the same, runs are found by time only.
    """
    lasting = round(_LASTING / period)
    again, shift = np.zeros(len(time), int), np.zeros(len(time))
    first, latest = 0, -np.inf
    for k in np.flatnonzero(np.diff(time) < -max_gap) + 1:
        if k + lasting <= len(time) and np.all(time[k : k + lasting] < time[k - 1]):
            # Later samples are shifted by the sum of all steps, added up at the end.
            latest = max(latest, np.max(time[first:k]) + shift[first])
            shift[k] = latest - time[k] + 2 * max_gap
            again[k], first = 1, int(k)
    time = time + shift[np.maximum.accumulate(np.where(again, np.arange(len(time)), 0))]
    if again.any():
        notes.append(
            f"time restarts {again.sum()} times: it is continued {2 * max_gap:.3g} s"
            " after the previous sample, as after a gap"
        )
    if len(set(label)) < 2:
        label = (1 + np.cumsum(again)).astype(str)
    names = tuple(dict.fromkeys(label.tolist()))
    codes = {name: code for code, name in enumerate(names)}
    run = np.array([codes[name] for name in label.tolist()], int)
    return time, run, names if len(names) > 1 else ("",)


# --- the file -------------------------------------------------------------------


def _read(path: Place, vehicle: Vehicle) -> tuple[Table, Vehicle]:
    """Read the file and check that it has the columns of the vehicle; returns both.

    If the yaw of the vehicle is a quaternion, it is replaced by the column of its heading.
    """
    yaw = vehicle.columns.yaw or ""
    wanted = [n for n in (*vehicle.columns.model_dump().values(), vehicle.keep.active) if n]
    table, headings = with_headings(read_table(path, wanted))
    if yaw in headings:
        columns = vehicle.columns.model_copy(update={"yaw": headings[yaw]})
        vehicle = vehicle.model_copy(update={"columns": columns})
        wanted = [headings[name] if name == yaw else name for name in wanted]
    absent = [name for name in dict.fromkeys(wanted) if name not in table.headers]
    remedy = f"correct [columns] of vehicle.toml; the file has: {', '.join(table.headers)}"
    remedy += "".join(f"; {note}" for note in table.notes if "not read" in note)
    what = "the column is missing"
    DataError.raise_for([InputProblem(what, remedy, table.file, column=name) for name in absent])
    return table, vehicle


def _channels(table: Table, vehicle: Vehicle, notes: list[str]) -> list[Channel]:
    """The columns to read: time, those of the motion, steering command, comparisons."""
    names, problems = vehicle.columns, list[InputProblem]()
    steering = ["steering"] if names.steering else []
    channels = [
        Channel(quantity, header, "", 1.0, True)
        if quantity == "steering"
        else _channel(table, quantity, header, vehicle, notes, problems)
        for quantity in ("time", *names.motion, *steering, *names.beyond)
        for header in [getattr(names, quantity)]
    ]
    DataError.raise_for(problems)
    taken = {channel.header for channel in channels}
    for quantity in CHECKS:
        if quantity in (channel.quantity for channel in channels):
            continue
        meant = _MEANT.get(quantity, quantity)
        headers = [h for h in table.headers if (g := guess(h)) and g.name == meant]
        if len(headers) == 1 and headers[0] not in taken:
            # A column that the vehicle does not name may have any content: skip odd ones.
            channel = _channel(table, quantity, headers[0], vehicle, notes, problems, False)
            cells = table.cells[table.headers.index(headers[0])]
            faults = read_numbers(cells, headers[0], table.ragged, gaps=True)[1]
            channels += [] if problems or faults else [channel]
            problems.clear()
    return channels


def _channel(
    table: Table,
    quantity: str,
    header: str,
    vehicle: Vehicle,
    notes: list[str],
    problems: list[InputProblem],
    named: bool = True,
) -> Channel:
    """The column with its unit: declared, from the header, or from the row below it."""
    dimension = QUANTITIES[quantity]
    usual = units_of(dimension)
    text, where = vehicle.units.get(quantity), ""
    in_header = stated_unit(header)
    place = table.headers.index(header)
    below = None if table.units_row is None else table.units_row[place]
    remedy = f'correct [columns], or set units.{quantity} = "{usual[0]}" in vehicle.toml'
    remedy += f" (--unit {quantity}={usual[0]})"
    if below == ARC:
        text, remedy = ARC, "name columns in metres; these are latitude and longitude"
    if text is None and in_header:
        text = in_header
    elif text is None and below is not None:
        text, where = below.strip().strip("[](){}"), " (units row)"
    elif text is not None and in_header not in (None, text):
        where = f" (declared; the header says {in_header!r})"
    if text == NO_UNIT:
        remedy = f"state it: {quantity} = ... in [units] of vehicle.toml, or --unit {quantity}=..."
        remedy += f" ({', '.join(usual)})"
    unit = unit_of(text, quantity) if text else None
    # Round brackets may contain other text, as in ``W (IMU)``.
    bracketed = text if f"({in_header})" in header and text == in_header else None
    label = bracketed is not None and known_unit(bracketed.removeprefix("-")) is None
    if text and text != "-" and unit is None and not label:
        reason = f"unit {text!r} is not a unit of {dimension}, as {quantity} needs"
        problems.append(InputProblem(reason, remedy, table.file, table.header_line, header))
    if unit is None:
        where = f" ({text!r} is not a unit)" if label else " (no unit stated)"
        text = usual[0]
    if named or text != usual[0]:
        notes.append(f"column {header!r} read as {quantity} in {text}{where}")
    return Channel(quantity, header, text or "", unit.scale if unit else 1.0, named)


def _numbers(
    table: Table, channels: Sequence[Channel], active: str | None
) -> dict[str, np.ndarray]:
    """Header -> values (n,) of the columns that are read.

    Cells without a value, infinity and rows without the header's number of cells are NaN.
    """
    wanted = [channel.header for channel in channels] + ([active] if active else [])
    cells = {name: table.cells[table.headers.index(name)] for name in dict.fromkeys(wanted)}
    columns, faults = {}, []
    for name, column in cells.items():
        columns[name], wrong = read_numbers(column, name, table.ragged, gaps=True)
        faults += [fault._replace(remedy=_CORRECT) for fault in wrong if fault.rule != INFINITE]
    of_rows, of_columns = list_problems(faults, table.lines, table.file)
    DataError.raise_for([*of_rows, *of_columns])
    return columns


# --- usable samples -------------------------------------------------------------


def _period(time: np.ndarray, vehicle: Vehicle, file: str) -> float:
    """Median of the positive time steps [s]."""
    steps = np.diff(time)
    steps = steps[steps > 0]
    cutoff = vehicle.filter.cutoff
    remedy = f"give a log of at least {4 * cutoff:g} Hz for a cutoff of {cutoff:g} Hz"
    period = float(np.median(steps)) if len(steps) else math.inf
    # Allow for jitter: 20 Hz by the clock of a bus is 19.9 Hz.
    if period <= 1.05 / (4 * cutoff):
        return period
    reason = f"is sampled at {1 / period:.3g} Hz only"
    if len(steps):
        lower = max(math.floor(100 / (4 * period)) / 100, 0.001)
        remedy += f", set cutoff = {lower:g} in [filter] of vehicle.toml, or check the unit of time"
    elif len(time) > 1:
        reason = "time does not rise from any sample to the next"
        remedy = "sort the log by time, or name the right column"
    else:
        reason = "holds fewer than two samples"
    raise DataError(reason, remedy, file, column=vehicle.columns.time)


def _later(time: np.ndarray, period: float) -> np.ndarray:
    """Which samples (n,) bool are clearly later than the last one taken."""
    taken, last = np.zeros(len(time), bool), -math.inf
    for index, stamp in enumerate(time.tolist()):
        if stamp - last > _CLOSEST * period:
            taken[index], last = True, stamp
    return taken
