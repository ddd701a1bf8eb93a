"""Derive slip angle and lateral force of an axle from a vehicle log (single track).

A log holds the pose of a vehicle (x, y, yaw of one tracked point) or its rates (v_x,
v_y, yaw rate, lateral acceleration). :mod:`tirefit.data.vehicle.motion` computes the motion of
the centre of gravity, left positive. Then, with the canonical signs (drawing in
:mod:`tirefit.slip`: alpha > 0 slides to the left, F_y > 0 acts to the right)::

    alpha_rear  = atan2(v_y - l_r r, v_x)
    alpha_front = atan2(v_y + l_f r, v_x) - delta
    F_y,rear    = -(m l_f a_y - J_z r') / (l_f + l_r)
    F_y,front   = -(m l_r a_y + J_z r') / (l_f + l_r) / cos(delta)

F_x of a driven axle is the force along its wheels that the longitudinal acceleration needs
(:func:`tirefit.data.vehicle.motion.force_along`); F_y at the front is then smaller by
F_x tan(delta).

The filter (see :class:`tirefit.data.vehicle.vehicle.Vehicle`) sets the bandwidth of the result:
neighbouring samples are correlated and do not count as independent.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np

from tirefit import __version__
from tirefit.data.merged import merged
from tirefit.data.readers.remote import Place, file_at
from tirefit.data.vehicle.contradictions import Comparison, compare
from tirefit.data.vehicle.findings import delays, findings, found_in
from tirefit.data.vehicle.motion import (
    Motion,
    error_along,
    force_along,
    not_ahead,
    not_driven,
    read_motion,
    road_wheel,
    slip_and_force,
)
from tirefit.data.vehicle.point import PointCheck, check_point, doubts, zero_of_alpha
from tirefit.data.vehicle.track import Track
from tirefit.data.vehicle.vehicle import POSE, Vehicle, load_vehicle
from tirefit.data.write import csv_text, output_problems
from tirefit.door import replaced_inputs
from tirefit.files import listed, write_texts
from tirefit.results import DataError, InputProblem, UsageError

SCHEMA = "tirefit.derive/1"


@dataclass(frozen=True)
class DerivedLog:
    """The result of :func:`derive` for one log.

    ``columns`` are arrays (n,) of the kept samples: time [s from the first sample],
    alpha [rad], fy, fz [N] with the canonical signs, v [m/s, forward at the axle],
    alpha_rate [rad/s] at the full sample rate, and the motion of the centre of gravity
    in ISO 8855 axes: a_x, a_y [m/s2], yaw_rate [rad/s], yaw_acceleration [rad/s2]; for a
    log of poses heading [rad], x, y [m]; with a steering map steering [rad], the road
    wheel angle, and steering_rate [rad/s]; for a driven axle fx, fx_std [N].
    ``dropped_samples`` counts each grid sample under the first reason that applies:
    dropped and kept samples add up to ``samples``. Texts are sentences.
    """

    name: str  # of the log without its endings; it becomes the run
    columns: Mapping[str, np.ndarray]
    rows: int  # in the file
    dropped_rows: Mapping[str, int]  # reason -> rows of the file that were not used
    samples: int  # on the uniform grid
    dropped_samples: Mapping[str, int]  # reason -> grid samples that were not kept
    gaps: int  # number of gaps that were not interpolated
    bandwidth: float  # frequency [Hz] at which the filter's gain is -3 dB
    heading: str  # sentence on the offset of heading or sideslip
    zero: float | None  # alpha at zero side force [rad], if the log determines it
    point: PointCheck  # position of the tracked point, from force against slip
    run: np.ndarray  # (n,) str, run of each kept sample: the log, or one of its runs
    compared: Comparison  # of redundant channels
    warnings: tuple[str, ...]  # on parts of the columns that a tire hardly caused
    assumptions: tuple[str, ...]  # the bandwidth and all assumptions
    source: Mapping[str, str | float]  # path, sha256, epoch (log's time [s] at time 0)

    def __len__(self) -> int:
        return len(self.columns["time"])

    def summary(self) -> str:
        """A summary: rows, kept samples, reasons of dropped ones, ranges, bandwidth."""
        alpha, force = self.columns["alpha"], self.columns["fy"]
        count = len(set(self.run.tolist()))
        runs = f"runs: {count}, " if count > 1 else ""
        return "\n".join(
            [
                f"{self.name}: {len(self)} of {self.samples} samples kept"
                f" (rows: {self.rows}, {runs}gaps: {self.gaps})",
                f"    rows not used: {_counts(self.dropped_rows)}",
                f"    samples not kept: {_counts(self.dropped_samples)}",
                f"    alpha {alpha.min():+.4f} to {alpha.max():+.4f} rad,"
                f" fy {force.min():+.4g} to {force.max():+.4g} N,"
                f" bandwidth {self.bandwidth:.3g} Hz (-3 dB)",
                *(
                    fill(message, 80, initial_indent=" " * 4, subsequent_indent=" " * 6)
                    for message in (
                        *(self.compared.line, self.heading, self.point.line),
                        *delays(found_in([self])),
                        *(f"warning: {w}" for w in self.warnings),
                    )
                ),
            ]
        )


@dataclass(frozen=True)
class DerivedFiles:
    """The result of :func:`derive_files`: the CSV, its JSON companion and the logs."""

    data: Path
    metadata: Path
    logs: tuple[DerivedLog, ...] = field(repr=False)
    stated: Mapping[str, float] = field(repr=False)  # constants in the first line of the CSV

    def summary(self) -> str:
        """The summary of each log, what several show together in the words of ``fit`` and
        ``diagnose``, then the files written."""
        together = findings(self.stated) if len(self.logs) > 1 else ()
        lines = [_summary(self.logs), *(fill(t, 80, subsequent_indent="  ") for t in together)]
        return "\n".join([*lines, f"wrote {self.data} and {self.metadata}"])


def derive(
    path: str | Place, vehicle: Vehicle, axle: str = "rear", believe: bool = False
) -> DerivedLog:
    """Slip angle and lateral force of one axle from a vehicle log.

    Args:
        path: CSV file with one header line, also gzipped (``.gz``).
        vehicle: The columns of the log, and mass and geometry of the vehicle.
        axle: "rear" or "front"; the front needs a steering map.
        believe: Only warn of channels that contradict each other.

    Raises:
        DataError: If the file cannot be read, lacks a column, holds text, is slower
            than the filter needs, channels contradict each other, or no sample is left.
        UsageError: If the axle is unknown or the front axle lacks a steering map.
    """
    file = file_at(path)
    if axle not in ("rear", "front"):
        raise UsageError(f"unknown axle {axle!r}", "give rear or front")
    if axle == "front" and vehicle.steering is None:
        raise UsageError(
            "the front slip angle needs the road wheel angle",
            "name columns.steering and give [steering] in vehicle.toml, or derive"
            " the rear axle, which needs neither",
        )
    track, motion, gaps = read_motion(file, vehicle)
    compared = compare(track, motion, vehicle, str(file))
    if not believe:
        DataError.raise_for(compared.problems)
    columns = _axle(motion, vehicle, axle)
    kept, dropped = _kept(motion, track, vehicle, axle, str(file))
    few = max(dropped, key=lambda name: dropped[name])
    warnings = [*vehicle.doubts(), *doubts(columns, motion, kept, vehicle)]
    # Share of the samples dropped for one reason above which units are probably wrong.
    if dropped[few] > 0.9 * len(kept):
        warnings[:0] = [
            f"only {np.count_nonzero(kept)} of {len(kept)} samples are kept,"
            f" {dropped[few]} are dropped as {few!r}: check the units of the log"
        ]
    alpha, force = columns["alpha"][kept], columns["fy"][kept]
    # A contradicting channel changes the slip angle in the same way as a wrong point.
    checked = kept & (not compared.problems)
    point = check_point(motion, vehicle, checked, str(file))
    if not believe:
        DataError.raise_for(point.problems)
    last_row = np.searchsorted(track.time, motion.time[kept], side="right") - 1
    columns = {name: values[kept] for name, values in columns.items()}
    heading, zero = zero_of_alpha(vehicle, axle, alpha, force)
    return DerivedLog(
        name=run_name(file),
        columns=columns,
        rows=track.rows,
        dropped_rows=track.dropped,
        samples=len(kept),
        dropped_samples=dropped,
        gaps=gaps,
        bandwidth=vehicle.filter.bandwidth,
        heading=heading,
        zero=zero,
        point=point,
        run=np.array(names_of_runs(file, track))[track.run[last_row]],
        compared=compared,
        warnings=(
            *(f"{p.reason}; {p.remedy}" for p in (*compared.problems, *point.problems)),
            *track.missing,
            *compared.warnings,
            *point.warnings,
            *warnings,
        ),
        assumptions=_assumptions(track, vehicle, axle),
        source={"path": file.name, "sha256": track.sha256, "epoch": track.epoch},
    )


def derive_files(
    paths: Sequence[str | Place],
    vehicle_toml: str | Path,
    out: str | Path,
    axle: str = "rear",
    units: Mapping[str, str] | None = None,
    believe: bool = False,
    unwritten: Callable[[str], None] | None = None,
) -> DerivedFiles:
    """Derive all logs into one CSV with one run for each, and a JSON companion.

    Args:
        paths: The logs; their names become the runs.
        vehicle_toml: See :mod:`tirefit.data.vehicle.vehicle`.
        out: CSV to write, in canonical columns and SI units; ``NAME.derive.json``
            beside it states vehicle, bandwidth, assumptions and sources.
        axle: "rear" or "front".
        units: Unit of a quantity; overrides ``[units]`` of the vehicle.
        believe: Only warn of channels that contradict each other.
        unwritten: Called with the summary of the logs if ``out`` cannot be written.

    Returns:
        The two files, and what was derived of each log.

    Raises:
        DataError: With the problems of all logs; then nothing is written.
        UsageError: wrong configuration, axle or ``out``, or two logs of one name.
        OSError: If a file cannot be written; then neither is.

    Example:
        >>> car, out = samples / "vehicle.toml", folder / "axle.csv"
        >>> derived = derive_files([samples / "drive.csv"], car, out)
        >>> read(derived.data).n
        470
    """
    out = Path(out)
    vehicle = load_vehicle(vehicle_toml, units)
    metadata = out.parent / f"{out.stem}.derive.json"
    paths = listed(paths)
    problems = output_problems(out, ".csv") or output_problems(metadata)
    UsageError.raise_for([*problems, *name_problems(paths)])
    inputs = {"LOG": paths, "--vehicle": [vehicle_toml]}
    DataError.raise_for(replaced_inputs((out, metadata), inputs))
    logs: list[DerivedLog] = []
    for path in paths:
        try:
            logs.append(derive(path, vehicle, axle, believe))
        except DataError as error:
            problems += error.problems
    DataError.raise_for(problems)
    columns = {
        name: np.concatenate([log.columns[name] for log in logs]) for name in logs[0].columns
    }
    columns["run"] = np.concatenate([log.run for log in logs])
    written = {k: f"{v:.4g}" for k, v in {**_stated(vehicle), **found_in(logs)}.items()}
    first = "# tirefit: derived from vehicle logs, SI units, convention braking, constants "
    first += " ".join(f"{k}={v}" for k, v in written.items()) + "\n"
    stated = {k: float(v) for k, v in written.items()}  # rounded as in the file
    content = json.dumps(_metadata(logs, vehicle, axle), indent=2)
    try:
        write_texts({metadata: content + "\n", out: first + csv_text(columns)})
    except OSError:
        if unwritten is not None:
            unwritten(_summary(logs))
        raise
    return DerivedFiles(out, metadata, tuple(logs), stated)


def _summary(logs: Sequence[DerivedLog]) -> str:
    """The summary of each log; the warnings of several are merged below them."""
    if len(logs) == 1:
        return logs[0].summary()
    lines = [replace(log, warnings=()).summary() for log in logs]
    warnings = merged((log.name, log.warnings) for log in logs)
    lines += [fill(f"warning: {text}", 80, subsequent_indent="  ") for text in warnings]
    return "\n".join(lines)


# --- the axle -------------------------------------------------------------------


def _axle(motion: Motion, vehicle: Vehicle, axle: str) -> dict[str, np.ndarray]:
    """The result's columns at every grid sample, (n,) each."""
    alpha, force, speed = slip_and_force(motion, vehicle, axle)
    wheelbase = vehicle.l_f + vehicle.l_r
    other = vehicle.l_f if axle == "rear" else vehicle.l_r
    load = np.full(len(motion.time), vehicle.mass * vehicle.gravity * other / wheelbase)
    if vehicle.h_cg is not None:
        transfer = vehicle.mass * motion.a_x * vehicle.h_cg / wheelbase
        load = load + transfer if axle == "rear" else load - transfer
    columns = {"time": motion.time, "alpha": alpha, "fy": force, "fz": load, "v": speed}
    columns["alpha_rate"] = motion.rate_of(alpha)
    names = ["a_x", "a_y", "yaw_rate", "yaw_acceleration"]
    names += ["heading", "x", "y"] if vehicle.columns.motion == POSE else []
    columns |= {name: getattr(motion, name) for name in names}
    if vehicle.steering is not None:
        columns["steering"] = road_wheel(motion, vehicle)
        columns["steering_rate"] = motion.rate_of(columns["steering"])
    if vehicle.driven in (axle, "all"):
        force = force_along(motion, vehicle, axle)
        columns |= {"fx": force, "fx_std": error_along(force, vehicle, axle)}
    return columns


def _kept(
    motion: Motion, track: Track, vehicle: Vehicle, axle: str, file: str
) -> tuple[np.ndarray, dict[str, int]]:
    """Grid samples to keep (n,) bool, and reason -> samples dropped for it.

    Raises:
        DataError: no sample is kept.
    """
    reasons = {"near an edge or a gap": ~motion.settled}
    reasons |= not_driven(track, motion, vehicle) | not_ahead(motion, vehicle)
    if axle == "front":
        assert vehicle.steering is not None  # checked by :func:`derive`
        command = vehicle.steering.command
        inside = (motion.command >= command[0]) & (motion.command <= command[-1])
        reasons["steering command outside the map"] = ~inside
    kept, dropped = np.ones(len(motion.time), bool), {}
    for reason, rows in reasons.items():
        dropped[reason] = int(np.count_nonzero(kept & rows))
        kept &= ~rows
    if not kept.any():
        reason = f"no sample is left of {len(motion.time)}: {_counts(dropped)}"
        if motion.settled.any():
            reason += f" (at most {np.max(motion.v_x[motion.settled]):.3g} m/s ahead)"
            remedy = "check the units and [keep] of vehicle.toml"
        else:
            reason += f"; the longest stretch is {2 * np.max(motion.within):.2g} s"
            reason += f" of {len(track.runs)} runs" if len(track.runs) > 1 else ""
            remedy = f"record more than {2 * vehicle.margin:.2g} s without a gap, or raise"
            remedy += " cutoff in [filter] of vehicle.toml, which shortens keep.margin"
        raise DataError(reason, remedy, file)
    return kept, dropped


# --- words ----------------------------------------------------------------------

_POSE_CLOCK = 0.005
"""Standard error [s] of the time between x, y and yaw, which are from one instrument."""


def _stated(vehicle: Vehicle) -> dict[str, float]:
    """Values that the vehicle file states, so that they need not be assumed, by key."""
    stated = dict(
        wheelbase=vehicle.wheelbase,
        yaw_inertia=vehicle.yaw_inertia,
        tracked_point=None if vehicle.tracked_point is None else vehicle.tracked_point[0],
        clock=vehicle.clock or (_POSE_CLOCK if vehicle.columns.motion == POSE else None),
        wheel_radius=vehicle.wheel_radius,
    )
    return {key: value for key, value in stated.items() if value is not None}


def _assumptions(track: Track, vehicle: Vehicle, axle: str) -> tuple[str, ...]:
    """Sentences on bandwidth, model and all assumptions of a log."""
    settings = vehicle.filter
    messages = [
        f"bandwidth {settings.bandwidth:.3g} Hz (-3 dB): Butterworth of order"
        f" {settings.order}, {settings.cutoff:g} Hz, run both ways, then central"
        f" differences at {settings.sample_rate:g} Hz; neighbouring samples are"
        " correlated and do not count as independent",
        f"gaps over {track.max_gap:.3g} s are not interpolated; shorter ones and uneven"
        " sampling are bridged by a cubic spline",
        "one rigid body on a flat floor, one wheel per axle: no roll, pitch, lateral"
        " load transfer or drag, and no yaw moment but that of the axles' side forces",
        "alpha > 0 where the axle slides to the left; fy > 0 to the right, as the force"
        " then acts: alpha and fy are negative in a left turn (the canonical convention)",
        "fz is the static axle load (h_cg is not given)"
        if vehicle.h_cg is None
        else "fz is the axle load with the load transfer m a_x h_cg / L",
    ]
    if vehicle.tracked_point is None:
        messages.append("the log describes the centre of gravity (no tracked_point)")
    if axle == "front":
        assert vehicle.steering is not None
        delay = vehicle.steering.delay
        late = f"{delay:g} s later" if delay else "at once"
        messages.append(f"the road wheels follow the steering command {late}")
    if vehicle.driven not in (axle, "all"):
        messages.append(f"the {axle} axle neither drives nor brakes")
    elif vehicle.driven == "all" and vehicle.rear_share is None:
        messages.append("the rear axle has half of the drive force (no rear_share)")
    return (*messages, *vehicle.columns.notes, *track.notes)


def _metadata(logs: Sequence[DerivedLog], vehicle: Vehicle, axle: str) -> dict[str, Any]:
    return {
        "schema": SCHEMA,
        "tirefit": __version__,
        "axle": axle,
        "vehicle": vehicle.model_dump(),
        "found": found_in(logs),
        "runs": [
            {
                "run": log.name,
                "runs": list(dict.fromkeys(log.run.tolist())),
                **log.source,
                "bandwidth": log.bandwidth,
                "rows": log.rows,
                "dropped_rows": dict(log.dropped_rows),
                "samples": log.samples,
                "kept": len(log),
                "dropped_samples": dict(log.dropped_samples),
                "gaps": log.gaps,
                "heading": log.heading,
                "alpha_zero": log.zero,
                "point": log.point.estimate,
                "agreement": [agreement.as_dict() for agreement in log.compared.pairs],
                "warnings": list(log.warnings),
                "assumptions": list(log.assumptions),
            }
            for log in logs
        ],
    }


def _counts(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{reason} {count}" for reason, count in counts.items() if count) or "none"


def run_name(path: Place) -> str:
    """The name of the run of a log: that of its file."""
    return path.name.removesuffix(".gz").removesuffix(".csv")


def names_of_runs(path: Place, track: Track) -> tuple[str, ...]:
    """The names of the runs of a log: that of its file, with their own names if several."""
    name = run_name(path)
    return tuple(f"{name}_{run}" if run else name for run in track.runs)


def name_problems(paths: Sequence[str | Place]) -> list[InputProblem]:
    """Problems if there is no log, or two logs have the same name."""
    names = [run_name(file_at(path)) for path in paths]
    if not names:
        return [InputProblem("no log given", "name at least one")]
    remedy = "rename one: the run gets the name of its file"
    twice = sorted({name for name in names if names.count(name) > 1})
    return [InputProblem(f"two logs are named {name!r}", remedy) for name in twice]
