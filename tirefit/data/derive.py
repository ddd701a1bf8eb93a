"""Vehicle logs to axle slip angle and lateral force, by single-track dynamics.

A log holds the pose of a vehicle (x, y, yaw of one tracked point) or its rates (v_x,
v_y, yaw rate, lateral acceleration). It is brought to a uniform rate, low-passed
without phase, moved to the centre of gravity and differentiated; then, for an axle at
the arm l ahead of the centre of gravity (rear: -l_r) and steered by delta::

    alpha     = delta - atan2(v_y + l r, v_x)
    F_y,rear  = (m l_f a_y - J_z r') / (l_f + l_r)
    F_y,front = (m l_r a_y + J_z r') / (l_f + l_r) / cos(delta)

What :class:`tirefit.data.vehicle.Vehicle` states of the filter is the bandwidth of
the result: neighbouring samples are correlated, n samples are not n facts.
"""

import csv
import gzip
import hashlib
import json
import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tirefit.data.vehicle import POSE, Vehicle, load_vehicle
from tirefit.results import DataError, Problem, UsageError

__all__ = ["DerivedFiles", "DerivedLog", "derive", "derive_files"]

SCHEMA = "tirefit.derive/1"

_MISSING = {"", "nan", "na", "null", "none"}
_MOST_PROBLEMS = 10
_CLOSEST = 0.3
"""Samples nearer than this part of the log's period are one sample (a repeat)."""

_SIGNS = (
    "alpha and fy are both positive in a left turn: a positive slip angle gives a"
    " positive force, as the canonical convention asks; the sides are those of ISO"
    " 8855 (left positive), so a left-right asymmetry of the tire appears mirrored"
    " against the drawing in tirefit.slip"
)


@dataclass(frozen=True)
class DerivedLog:
    """What :func:`derive` found in one log.

    Attributes:
        name: The log's name without its endings; it becomes the run.
        columns: Arrays (n,) of the kept samples: time [s from the first sample],
            alpha [rad], fy, fz [N], v [m/s, forward at the axle], yaw_rate [rad/s],
            a_y [m/s2, at the centre of gravity].
        rows: Rows in the file.
        dropped_rows: Reason -> rows of the file that were not used.
        samples: Samples on the uniform grid.
        dropped_samples: Reason -> grid samples that were not kept (first reason that
            applies, so these and the kept ones add up to ``samples``).
        gaps: Number of gaps that were not interpolated.
        bandwidth: Frequency [Hz] at which the filter's gain is -3 dB.
        assumptions: Sentences: the bandwidth and everything that was assumed.
        source: Path, sha256 and epoch (the log's time [s] at time 0).
    """

    name: str
    columns: Mapping[str, np.ndarray]
    rows: int
    dropped_rows: Mapping[str, int]
    samples: int
    dropped_samples: Mapping[str, int]
    gaps: int
    bandwidth: float
    assumptions: tuple[str, ...]
    source: Mapping[str, str | float]

    def __len__(self) -> int:
        return len(self.columns["time"])

    def summary(self) -> str:
        """Rows in, samples kept, why the others were dropped, ranges, bandwidth."""
        alpha, force = self.columns["alpha"], self.columns["fy"]
        return "\n".join(
            [
                f"{self.name}: {len(self)} of {self.samples} samples kept"
                f" (rows: {self.rows}, gaps: {self.gaps})",
                f"    rows not used: {_counts(self.dropped_rows)}",
                f"    samples not kept: {_counts(self.dropped_samples)}",
                f"    alpha {alpha.min():+.4f} to {alpha.max():+.4f} rad,"
                f" fy {force.min():+.4g} to {force.max():+.4g} N,"
                f" bandwidth {self.bandwidth:.3g} Hz (-3 dB)",
            ]
        )


@dataclass(frozen=True)
class DerivedFiles:
    """What :func:`derive_files` wrote: the CSV, its JSON companion and the logs."""

    data: Path
    metadata: Path
    logs: tuple[DerivedLog, ...]

    def summary(self) -> str:
        """The summary of each log, then the files written."""
        written = f"wrote {self.data} and {self.metadata}"
        return "\n".join([*(log.summary() for log in self.logs), written])


@dataclass(frozen=True)
class _Raw:
    """The columns of a file by header, (n,) each; NaN where a cell is empty."""

    columns: Mapping[str, np.ndarray]
    rows: int
    sha256: str


@dataclass(frozen=True)
class _Track:
    """Usable samples: increasing time (n,) [s], signals (n, k) in SI, active (n,)."""

    time: np.ndarray
    signals: np.ndarray
    active: np.ndarray
    period: float
    epoch: float
    dropped: Mapping[str, int]


@dataclass(frozen=True)
class _Motion:
    """Motion of the centre of gravity on the grid, (n,) each, SI, ISO 8855 axes."""

    time: np.ndarray
    v_x: np.ndarray
    v_y: np.ndarray
    a_x: np.ndarray
    a_y: np.ndarray
    yaw_rate: np.ndarray
    yaw_acceleration: np.ndarray
    command: np.ndarray
    settled: np.ndarray


def derive(path: str | Path, vehicle: Vehicle, axle: str = "rear") -> DerivedLog:
    """Slip angle and lateral force of one axle from a vehicle log.

    Args:
        path: CSV file with one header line, also gzipped (``.gz``).
        vehicle: What the log's columns are and the vehicle's mass and geometry.
        axle: "rear" or "front"; the front needs a steering map.

    Raises:
        DataError: If the file cannot be read, lacks a column, holds text, is slower
            than the filter needs, or no sample is left.
        UsageError: If the axle is unknown or the front axle lacks a steering map.
    """
    path = Path(path)
    if axle not in ("rear", "front"):
        raise UsageError(Problem(f"unknown axle {axle!r}", "say rear or front"))
    if axle == "front" and vehicle.steering is None:
        raise UsageError(
            Problem(
                "the front slip angle needs the road wheel angle",
                "name columns.steering and give [steering] in vehicle.toml, or derive"
                " the rear axle, which needs neither",
            )
        )
    raw = _read_log(path, vehicle)
    track = _track(raw, vehicle, str(path))
    motion, gaps = _motion(track, vehicle)
    columns = _axle(motion, vehicle, axle)
    kept, dropped = _kept(motion, track, vehicle, axle)
    if not kept.any():
        raise DataError(
            Problem(
                f"no sample is left of {len(kept)}: {_counts(dropped)}",
                "check the units and [keep] of vehicle.toml",
                str(path),
            )
        )
    return DerivedLog(
        name=_run_name(path),
        columns={name: values[kept] for name, values in columns.items()},
        rows=raw.rows,
        dropped_rows=track.dropped,
        samples=len(kept),
        dropped_samples=dropped,
        gaps=gaps,
        bandwidth=vehicle.filter.bandwidth,
        assumptions=_assumptions(vehicle, axle, _max_gap(track, vehicle)),
        source={"path": path.name, "sha256": raw.sha256, "epoch": track.epoch},
    )


def derive_files(
    paths: Sequence[str | Path],
    vehicle_toml: str | Path,
    out: str | Path,
    axle: str = "rear",
) -> DerivedFiles:
    """Derive every log into one CSV, a run each, with a JSON companion.

    Args:
        paths: The logs; their names become the runs.
        vehicle_toml: See :mod:`tirefit.data.vehicle`.
        out: CSV to write, in canonical columns and SI units; ``NAME.derive.json``
            beside ``NAME.csv`` states the vehicle, the bandwidth, the assumptions and
            the sources.
        axle: "rear" or "front".

    Raises:
        DataError: With the problems of all logs; then nothing is written.
        UsageError: If the configuration, the axle or ``out`` is wrong, or two logs
            have one name.
    """
    from tirefit.data.write import write_csv, write_text_atomic

    out = Path(out)
    vehicle = load_vehicle(vehicle_toml)
    _check_names(paths, out)
    logs, problems = [], []
    for path in paths:
        try:
            logs.append(derive(path, vehicle, axle))
        except DataError as error:
            problems += error.problems
    if problems:
        raise DataError(problems)
    columns = {
        name: np.concatenate([log.columns[name] for log in logs])
        for name in ("time", "alpha", "fy", "fz", "v")
    }
    columns["run"] = np.repeat([log.name for log in logs], [len(log) for log in logs])
    metadata = out.with_name(f"{out.stem}.derive.json")
    write_csv(out, columns)
    content = json.dumps(_metadata(logs, vehicle, axle), indent=2)
    write_text_atomic(metadata, content + "\n")
    return DerivedFiles(out, metadata, tuple(logs))


# --- the file -------------------------------------------------------------------


def _read_log(path: Path, vehicle: Vehicle) -> _Raw:
    """The columns that the vehicle names, as floats; other columns are not parsed."""
    names = vehicle.columns
    wanted = [names.time, *(getattr(names, name) for name in names.motion)]
    wanted += [name for name in (names.steering, vehicle.keep.active) if name]
    content, text = _content(path)
    lines = csv.reader(text.splitlines())
    header = [name.strip() for name in next(lines, [])]
    absent = [name for name in dict.fromkeys(wanted) if name not in header]
    if absent:
        remedy = f"correct [columns] of vehicle.toml; the file has: {', '.join(header)}"
        raise DataError(
            [
                Problem("the column is missing", remedy, str(path), column=name)
                for name in absent
            ]
        )
    places = {name: header.index(name) for name in wanted}
    rows = [(lines.line_num, row) for row in lines if row]
    problems: list[Problem] = []
    columns = {
        name: np.array(
            [_number(row, place, line, name, path, problems) for line, row in rows]
        )
        for name, place in places.items()
    }
    if problems:
        more = len(problems) - _MOST_PROBLEMS
        shown = problems[:_MOST_PROBLEMS]
        if more > 0:
            shown.append(Problem(f"and {more} more cells like these", file=str(path)))
        raise DataError(shown)
    return _Raw(columns, len(rows), hashlib.sha256(content).hexdigest())


def _content(path: Path) -> tuple[bytes, str]:
    """The bytes of the file and its text, unpacked where it is gzipped."""
    try:
        content = path.read_bytes()
        unpacked = gzip.decompress(content) if path.suffix == ".gz" else content
        return content, unpacked.decode("utf-8-sig")
    except (OSError, EOFError, zlib.error, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise DataError(
            Problem(f"cannot be read: {reason}", "give a CSV log", str(path))
        ) from error


def _number(row, place, line, name, path, problems) -> float:
    """One cell; an empty one or a short row is NaN, text is a problem."""
    cell = row[place].strip() if place < len(row) else ""
    if cell.lower() in _MISSING:
        return math.nan
    try:
        return float(cell)
    except ValueError:
        problems.append(
            Problem(f"{cell!r} is not a number", "correct it", str(path), line, name)
        )
        return math.nan


# --- usable samples -------------------------------------------------------------


def _track(raw: _Raw, vehicle: Vehicle, file: str) -> _Track:
    """Rows with finite values, a later stamp than all before, and a new pose."""
    names = vehicle.columns
    time = raw.columns[names.time] * vehicle.factor("time")
    signals = [
        raw.columns[getattr(names, quantity)] * vehicle.factor(quantity)
        for quantity in names.motion
    ]
    if names.steering:
        signals.append(raw.columns[names.steering])
    signals = np.column_stack(signals)
    active = np.ones(len(time), bool)
    if vehicle.keep.active:
        active = raw.columns[vehicle.keep.active] == vehicle.keep.active_value
    finite = np.isfinite(time) & np.isfinite(signals).all(axis=1)
    time, signals, active = time[finite], signals[finite], active[finite]
    period = _period(time, vehicle, file)
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
    return _Track(time[fresh] - epoch, signals, active[fresh], period, epoch, dropped)


def _period(time: np.ndarray, vehicle: Vehicle, file: str) -> float:
    """Median time between samples [s], from the steps forward."""
    steps = np.diff(time)
    steps = steps[steps > 0]
    cutoff = vehicle.filter.cutoff
    needed = f"a log of at least {4 * cutoff:g} Hz for a cutoff of {cutoff:g} Hz"
    if len(steps) == 0:
        raise DataError(Problem("holds fewer than two samples", f"give {needed}", file))
    period = float(np.median(steps))
    if period > 1 / (4 * cutoff):
        raise DataError(
            Problem(
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


def _max_gap(track: _Track, vehicle: Vehicle) -> float:
    return vehicle.filter.max_gap or 3.5 * track.period


def _margin(vehicle: Vehicle) -> float:
    margin = vehicle.keep.margin
    return vehicle.filter.settling if margin is None else margin


# --- motion ---------------------------------------------------------------------


def _motion(track: _Track, vehicle: Vehicle) -> tuple[_Motion, int]:
    """Motion on one uniform grid that leaves out the gaps, and their number."""
    rate = vehicle.filter.sample_rate
    splits = np.flatnonzero(np.diff(track.time) > _max_gap(track, vehicle)) + 1
    margin = _margin(vehicle)
    convert = _from_pose if vehicle.columns.motion == POSE else _from_rates
    parts = []
    for rows in np.split(np.arange(len(track.time)), splits):
        time = track.time[rows]
        first, last = math.ceil(time[0] * rate), math.floor(time[-1] * rate)
        grid = np.arange(first, last + 1) / rate
        signals = _filtered(time, track.signals[rows], grid, vehicle)
        if signals is None:
            unknown = [np.full(len(grid), np.nan)] * 7
            parts.append(_Motion(grid, *unknown, settled=np.zeros(len(grid), bool)))
            continue
        inside = (grid >= time[0] + margin) & (grid <= time[-1] - margin)
        command = signals[:, -1] if vehicle.steering else np.zeros(len(grid))
        rates = convert(signals, vehicle)
        parts.append(_Motion(grid, *rates, command=command, settled=inside))
    fields = _Motion.__dataclass_fields__
    joined = {
        name: np.concatenate([getattr(part, name) for part in parts]) for name in fields
    }
    return _Motion(**joined), len(splits)


def _filtered(time, signals, grid, vehicle: Vehicle) -> np.ndarray | None:
    """Signals (n, k) on the grid, low-passed without phase; None if too short."""
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


def _from_pose(signals: np.ndarray, vehicle: Vehicle) -> tuple[np.ndarray, ...]:
    """v_x, v_y, a_x, a_y, r, r' of the centre of gravity from x, y, yaw; (n,) each."""
    rate = vehicle.filter.sample_rate
    x, y, yaw = signals[:, :3].T
    cos, sin = np.cos(yaw), np.sin(yaw)
    ahead, left = vehicle.cg_from_tracked
    position = np.array([x + ahead * cos - left * sin, y + ahead * sin + left * cos])
    velocity = np.gradient(position, 1 / rate, axis=1)
    acceleration = np.gradient(velocity, 1 / rate, axis=1)
    yaw_rate = np.gradient(yaw, 1 / rate)

    def body(world):
        return cos * world[0] + sin * world[1], cos * world[1] - sin * world[0]

    return (
        *body(velocity),
        *body(acceleration),
        yaw_rate,
        np.gradient(yaw_rate, 1 / rate),
    )


def _from_rates(signals: np.ndarray, vehicle: Vehicle) -> tuple[np.ndarray, ...]:
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
    )


# --- the axle -------------------------------------------------------------------


def _axle(motion: _Motion, vehicle: Vehicle, axle: str) -> dict[str, np.ndarray]:
    """The result's columns at every grid sample, (n,) each."""
    inertial = motion.yaw_acceleration * vehicle.yaw_inertia
    if axle == "rear":
        arm, other, steer = -vehicle.l_r, vehicle.l_f, 0.0
        lateral = vehicle.mass * other * motion.a_y - inertial
    else:
        arm, other = vehicle.l_f, vehicle.l_r
        steer = np.interp(
            motion.command, vehicle.steering.command, vehicle.steering.angle
        )
        lateral = vehicle.mass * other * motion.a_y + inertial
    wheelbase = vehicle.l_f + vehicle.l_r
    load = np.full(len(motion.time), vehicle.mass * vehicle.gravity * other / wheelbase)
    if vehicle.h_cg is not None:
        transfer = vehicle.mass * motion.a_x * vehicle.h_cg / wheelbase
        load = load + transfer if axle == "rear" else load - transfer
    sideways = motion.v_y + arm * motion.yaw_rate
    return {
        "time": motion.time,
        "alpha": steer - np.arctan2(sideways, motion.v_x),
        "fy": lateral / wheelbase / np.cos(steer),
        "fz": load,
        "v": motion.v_x * np.cos(steer) + sideways * np.sin(steer),
        "yaw_rate": motion.yaw_rate,
        "a_y": motion.a_y,
    }


def _kept(motion: _Motion, track: _Track, vehicle: Vehicle, axle: str):
    """Grid samples to keep (n,) bool, and reason -> samples dropped for it."""
    last_row = np.searchsorted(track.time, motion.time, side="right") - 1
    keep = vehicle.keep
    reasons = {
        "beside an edge or a gap": ~motion.settled,
        "not active": ~track.active[last_row],
        f"slower than {keep.v_min:g} m/s": motion.v_x <= keep.v_min,
    }
    if keep.a_y_max is not None:
        # The filter smears a glitch over its settling time: that goes with it.
        glitches = motion.time[np.abs(motion.a_y) > keep.a_y_max]
        reach = _margin(vehicle)
        until = np.searchsorted(glitches, motion.time + reach, side="right")
        name = f"near |a_y| above {keep.a_y_max:g} m/s2"
        reasons[name] = until > np.searchsorted(glitches, motion.time - reach)
    if axle == "front":
        command = vehicle.steering.command
        reasons["steering command outside the map"] = (motion.command < command[0]) | (
            motion.command > command[-1]
        )
    kept = np.ones(len(motion.time), bool)
    dropped = {}
    for reason, rows in reasons.items():
        dropped[reason] = int(np.count_nonzero(kept & rows))
        kept &= ~rows
    return kept, dropped


# --- words ----------------------------------------------------------------------


def _assumptions(vehicle: Vehicle, axle: str, max_gap: float) -> tuple[str, ...]:
    settings = vehicle.filter
    said = [
        f"bandwidth {settings.bandwidth:.3g} Hz (-3 dB): Butterworth of order"
        f" {settings.order}, {settings.cutoff:g} Hz, run both ways, then central"
        f" differences at {settings.sample_rate:g} Hz; neighbouring samples are"
        " correlated, so n samples are not n facts",
        f"gaps over {max_gap:.3g} s are not interpolated; shorter ones and uneven"
        " sampling are bridged by a cubic spline",
        "one rigid body on a flat floor, one wheel per axle: no roll, pitch, lateral"
        " load transfer or drag, and no yaw moment but that of the axles' side forces",
        _SIGNS,
    ]
    if vehicle.h_cg is None:
        said.append("fz is the static axle load (h_cg is not given)")
    else:
        said.append("fz is the axle load with the load transfer m a_x h_cg / L")
    if vehicle.yaw_offset:
        said.append(f"{vehicle.yaw_offset:g} rad were added to the logged yaw")
    elif vehicle.columns.motion == POSE:
        said.append(
            "the logged yaw is the car's heading: an offset of it would shift alpha"
        )
    if vehicle.tracked_point is None:
        said.append("the log describes the centre of gravity (no tracked_point)")
    if axle == "front":
        said.append(
            "the road wheels follow the steering command at once, and the front axle"
            " neither drives nor brakes"
        )
    return tuple(said)


def _metadata(logs: Sequence[DerivedLog], vehicle: Vehicle, axle: str) -> dict:
    return {
        "schema": SCHEMA,
        "tirefit": _version(),
        "axle": axle,
        "vehicle": vehicle.model_dump(),
        "runs": [
            {
                "run": log.name,
                **log.source,
                "bandwidth": log.bandwidth,
                "rows": log.rows,
                "dropped_rows": dict(log.dropped_rows),
                "samples": log.samples,
                "kept": len(log),
                "dropped_samples": dict(log.dropped_samples),
                "gaps": log.gaps,
                "assumptions": list(log.assumptions),
            }
            for log in logs
        ],
    }


def _version() -> str | None:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("tirefit")
    except PackageNotFoundError:  # run from the sources, not installed
        return None


def _counts(counts: Mapping[str, int]) -> str:
    found = [f"{reason} {count}" for reason, count in counts.items() if count]
    return ", ".join(found) or "none"


def _run_name(path: Path) -> str:
    return path.name.removesuffix(".gz").removesuffix(".csv")


def _check_names(paths: Sequence[str | Path], out: Path) -> None:
    """Raise UsageError unless ``out`` is a CSV and every log has its own name."""
    problems = []
    if out.suffix != ".csv":
        problems.append(Problem("the output is a CSV", "end it in .csv", str(out)))
    names = [_run_name(Path(path)) for path in paths]
    if not names:
        problems.append(Problem("no log given", "name at least one"))
    for name in sorted({name for name in names if names.count(name) > 1}):
        problems.append(
            Problem(f"two logs are named {name!r}", "rename one: the name is the run")
        )
    if problems:
        raise UsageError(problems)
