"""Measured logs, with the change that a case asks for, as tables of one axle.

:func:`table` reads the shipped logs, puts the change into the log or into the vehicle
file, and runs ``tirefit derive``. The result keeps every sample at 100 Hz, with the run
and the rows that are diagnosed (``kept``).
"""

import csv
import gzip
import tempfile
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path

import numpy as np

import tirefit
from tirefit.data.derive import derive
from tirefit.data.vehicle import Vehicle
from tirefit.settings import parse_settings

HERE = Path(__file__).parent
DART = HERE.parent / "dart_jetracer"
LATER = HERE / "dart_later"
RATE = 100.0  # Hz of a whole table
MASS = {True: 5.1, False: 1.58}  # kg: of the f1tenth car, of the dart car
POINT = {"a": 0.170, "d": 0.195, "others": 0.295}
"""Tracked point of the f1tenth car [m ahead of the rear axle], by force and slip."""
DRIVEN = "all"
"""Axles that drive the f1tenth car, where ``vehicle.toml`` has a key for it."""


@dataclass(frozen=True)
class Change:
    """What somebody made of the logs; the defaults change nothing.

    Attributes:
        vehicle: keys of ``vehicle.toml`` with another value.
        late: channel of the log -> time [s] by which it is read too late.
        scaled: derived column -> factor, applied after the derivation.
    """

    vehicle: Mapping[str, object] = field(default_factory=dict)
    late: Mapping[str, float] = field(default_factory=dict)
    scaled: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Logs:
    """Which measured logs, of which axle, with which change.

    Attributes:
        of: "circles", "free", "later" of the dart car, or "a", "d", "others" of the
            f1tenth car; several are joined.
        axle: "rear" or "front".
        change: put into every log.
        runs: "each" log is a run, or each "set" (each item of ``of``) is one.
        part: "all" rows, or the "first" or "second" half of every run.
        only: runs of the tables to keep, by name; all if empty.
        every: rows at 100 Hz from one diagnosed row to the next.
    """

    of: tuple[str, ...]
    axle: str = "rear"
    change: Change = field(default_factory=Change)
    runs: str = "each"
    part: str = "all"
    only: tuple[str, ...] = ()
    every: int = 20


@dataclass(frozen=True)
class Table:
    """Columns (n,) at 100 Hz, the run (n,) of each row, and the rows diagnosed (n,)."""

    columns: Mapping[str, np.ndarray]
    run: np.ndarray
    kept: np.ndarray

    def __getitem__(self, name: str) -> np.ndarray:
        """A column at the kept rows."""
        return self._at_kept[name]

    @cached_property
    def _at_kept(self) -> dict[str, np.ndarray]:
        return {name: values[self.kept] for name, values in self.columns.items()}

    @cached_property
    def codes(self) -> np.ndarray:
        """The run of each kept row, counted from 0."""
        names = {name: k for k, name in enumerate(dict.fromkeys(self.run))}
        return np.array([names[name] for name in self.run[self.kept]])

    @cached_property
    def parts(self) -> list[np.ndarray]:
        """Indices of all rows, cut between runs and where the time jumps."""
        step = np.diff(self.columns["time"])
        jump = (step > 1.5 / RATE) | (step < 0) | (self.run[1:] != self.run[:-1])
        return np.split(np.arange(len(self.run)), np.flatnonzero(jump) + 1)

    def late(self, name: str, delay: float) -> np.ndarray:
        """A column a time [s] ago, at the kept rows; a part begins at rest."""
        time, values = self.columns["time"], self.columns[name]
        return np.concatenate([
            np.interp(time[part][self.kept[part]] - delay, time[part], values[part])
            for part in self.parts
        ])  # fmt: skip


@cache
def _raw(source: str) -> dict[str, dict[str, np.ndarray]]:
    """Log -> header -> (n,) of one set as it is shipped."""
    if source in POINT:
        whole = _columns(HERE / "f1tenth" / f"{source}.csv.gz")
        whole["a_y"] = np.zeros(len(whole["time"]))
        logs = {}
        for run in np.unique(whole["run_id"]):
            rows = whole["run_id"] == run
            log = {name: values[rows] for name, values in whole.items()}
            log["a_y"] = log["v_x"] * log["r"] + np.gradient(log["v_y"], log["time"])
            logs[f"{source}_{run:.0f}"] = log
        return logs
    folder = {"circles": DART / "circles_rubbery_floor", "later": LATER}
    at = folder.get(source, DART / "free_driving_16_sept_2024")
    paths = sorted(at.glob("*.csv.gz"), key=lambda path: path.name)
    return {p.name.removesuffix(".csv.gz").split("recording_")[1]: _columns(p)
            for p in paths}  # fmt: skip


def _columns(path: Path) -> dict[str, np.ndarray]:
    names = {"vicon time", "vicon x", "vicon y", "vicon yaw", "safety_value"}
    with gzip.open(path, "rt") as file:
        header, *rows = csv.reader(file)
    cells = np.array(rows)
    wanted = [
        k for k, n in enumerate(header) if "vicon" not in header[-1] or n in names
    ]
    return {header[k]: cells[:, k].astype(float) for k in wanted}


def _vehicle(source: str, changed: Mapping[str, object]) -> Vehicle:
    """What ``vehicle.toml`` of one set states, with the change."""
    at = HERE / "f1tenth" if source in POINT else DART
    content = tomllib.loads((at / "vehicle.toml").read_text())
    if source in POINT:
        content["tracked_point"] = [POINT[source], 0.0]
        if "driven" in Vehicle.model_fields:
            content["driven"] = DRIVEN
    return parse_settings(Vehicle, content | dict(changed), source)


def _derived(source: str, logs: Logs) -> dict[str, dict[str, np.ndarray]]:
    """Log -> derived columns at 100 Hz of one set, of logs of more than 3 s."""
    vehicle, found = _vehicle(source, logs.change.vehicle), {}
    for name, log in _raw(source).items():
        clock = log[vehicle.columns.time]
        late = {
            key: np.interp(clock - delay, clock, log[key])
            for key, delay in logs.change.late.items()
        }
        written = log | late
        with tempfile.TemporaryDirectory() as folder:
            path, cells = Path(folder, "log.csv"), np.stack([*written.values()], axis=1)
            header = ",".join(written)
            np.savetxt(path, cells, "%.6f", ",", header=header, comments="")
            found[name] = dict(derive(path, vehicle, logs.axle, believe=True).columns)
    return {name: log for name, log in found.items() if len(log["time"]) > 300}


def table(logs: Logs) -> Table:
    """The derived table of the logs, with the change that was asked for."""
    parts, runs = [], []
    for source in logs.of:
        start = 0.0
        for name, columns in _derived(source, logs).items():
            if logs.only and name not in logs.only:
                continue
            for column, factor in logs.change.scaled.items():
                columns[column] = columns[column] * factor
            if logs.runs == "set":  # the logs of one set follow each other
                columns["time"] = columns["time"] - columns["time"][0] + start
                start = columns["time"][-1] + 5.0
            runs.append(
                np.full(len(columns["time"]), source if logs.runs == "set" else name)
            )
            parts.append(columns)
    shared = [c for c in parts[0] if all(c in part for part in parts)]
    joined = {c: np.concatenate([part[c] for part in parts]) for c in shared}
    joined["push"] = MASS[logs.of[0] in POINT] * joined["a_x"]
    run = np.concatenate(runs)
    kept = np.zeros(len(run), bool)
    for name in dict.fromkeys(run):
        rows = np.flatnonzero(run == name)[:: logs.every]
        half = len(rows) // 2
        rows = {"all": rows, "first": rows[:half], "second": rows[half:]}[logs.part]
        kept[rows] = True
    return Table(joined, run, kept)


def data(made: Table, name: str):
    """The diagnosed rows as ``tirefit`` reads them from a file."""
    columns = {key: made[key] for key in made.columns if key != "push"}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, f"{name}.csv")
        with path.open("w") as file:
            file.write(",".join([*columns, "run"]) + "\n")
            for run, *row in zip(made.run[made.kept], *columns.values(), strict=True):
                file.write(",".join([*(f"{x:.6f}" for x in row), run]) + "\n")
        return tirefit.read(path, convention="braking")
