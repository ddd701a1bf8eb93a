"""Measured logs with the change of a case, as tables of one axle.

:func:`table` reads the shipped logs, applies the change to the log or to the vehicle
file, and derives slip angle and force at 100 Hz. ``kept`` marks the diagnosed rows.
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
from tirefit.data.vehicle.derive import derive
from tirefit.data.vehicle.vehicle import Vehicle
from tirefit.settings import parse_settings

HERE = Path(__file__).parent
DART = HERE.parent / "dart_jetracer"
FOLDERS = {
    "circles": DART / "circles_rubbery_floor",
    "free": DART / "free_driving_16_sept_2024",
    "later": HERE / "dart_later",
}
POINT = {"a": 0.170, "d": 0.195, "others": 0.295}
"""Tracked point of the f1tenth car [m ahead of the rear axle], from force and slip."""
MASS = {True: 5.1, False: 1.58}  # kg, of the f1tenth car and of the dart car
RATE = 100.0  # Hz, before rows are selected
TENTHS = 10  # blocks per run


@dataclass(frozen=True)
class Logs:
    """A choice of measured logs, axle and change.

    Attributes:
        of: "circles", "free", "later" of the dart car, or "a", "d", "others" of the
            f1tenth car; several are joined.
        axle: "rear" or "front".
        vehicle: keys of ``vehicle.toml`` with their changed values.
        late: channel of the log, or derived fy -> delay [s].
        scaled: derived column -> factor.
        runs: "each" log is a run, or each "set" (each item of ``of``) is one.
        part: "all" rows; "odd" or "even" tenths of every run.
        only: runs to keep, by name; all if empty.
        every: step between diagnosed rows, in rows at 100 Hz.
    """

    of: tuple[str, ...]
    axle: str = "rear"
    vehicle: Mapping[str, object] = field(default_factory=dict)
    late: Mapping[str, float] = field(default_factory=dict)
    scaled: Mapping[str, float] = field(default_factory=dict)
    runs: str = "each"
    part: str = "all"
    only: tuple[str, ...] = ()
    every: int = 20


@dataclass(frozen=True)
class Table:
    """Columns (n,) at 100 Hz, the run (n,) of each row, and the mask of diagnosed rows (n,).

    In addition to the derived columns: push, the force that accelerates the car [N], and
    turn, the change of slip angle per 1 m of distance to the rear [rad].
    """

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
        """The number of the run of each kept row, from 0."""
        names = {name: k for k, name in enumerate(dict.fromkeys(self.run))}
        return np.array([names[name] for name in self.run[self.kept]])

    @cached_property
    def parts(self) -> list[np.ndarray]:
        """Indices of all rows, split between runs and at jumps of the time."""
        step = np.diff(self.columns["time"])
        jump = (step > 1.5 / RATE) | (step < 0) | (self.run[1:] != self.run[:-1])
        return np.split(np.arange(len(self.run)), np.flatnonzero(jump) + 1)

    def late(self, name: str, delay: float) -> np.ndarray:
        """A column delayed by a time [s], all rows; before a part its first value holds."""
        time, values = self.columns["time"], self.columns[name]
        before = (np.interp(time[p] - delay, time[p], values[p]) for p in self.parts)
        return np.concatenate([*before])


@cache
def _raw(source: str) -> dict[str, dict[str, np.ndarray]]:
    """Log -> header -> column (n,) of one set as shipped, angles unwrapped."""
    if source in FOLDERS:
        paths = sorted(FOLDERS[source].glob("*.csv.gz"), key=lambda path: path.name)
        keep = {"vicon time", "vicon x", "vicon y", "vicon yaw", "safety_value"}
        return {
            path.name.removesuffix(".csv.gz").split("recording_")[1]: {
                name: np.unwrap(values) if name == "vicon yaw" else values
                for name, values in _columns(path).items()
                if name in keep
            }
            for path in paths
        }
    whole, logs = _columns(HERE / "f1tenth" / f"{source}.csv.gz"), {}
    for run in np.unique(whole["run_id"]):
        log = {name: x[whole["run_id"] == run] for name, x in whole.items()}
        log["a_y"] = log["v_x"] * log["r"] + np.gradient(log["v_y"], log["time"])
        logs[f"{source}_{run:.0f}"] = log
    return logs


def _columns(path: Path) -> dict[str, np.ndarray]:
    with gzip.open(path, "rt") as file:
        header, *rows = csv.reader(file)
    return dict(zip(header, np.array(rows, dtype=float).T, strict=True))


def _vehicle(source: str, logs: Logs) -> Vehicle:
    """The vehicle of one set by its ``vehicle.toml``, with the change."""
    at = HERE / "f1tenth" if source in POINT else DART
    content = tomllib.loads((at / "vehicle.toml").read_text())
    if source in POINT:
        content["tracked_point"] = [POINT[source], 0.0]
        # F_x = m a_x / 2; at the front, F_y would then depend on the late steering.
        if "driven" in Vehicle.model_fields and logs.axle == "rear":
            content["driven"] = "all"
    return parse_settings(Vehicle, content | dict(logs.vehicle), source)


def _derived(source: str, logs: Logs) -> dict[str, dict[str, np.ndarray]]:
    """Run -> derived columns at 100 Hz of one set."""
    vehicle, found = _vehicle(source, logs), {}
    for name, log in _raw(source).items():
        if logs.only and name not in logs.only:
            continue
        clock = log[vehicle.columns.time]
        written = log | {
            key: np.interp(clock - delay, clock, log[key])
            for key, delay in logs.late.items()
            if key in log
        }
        with tempfile.TemporaryDirectory() as folder:
            path, cells = Path(folder, "log.csv"), np.stack([*written.values()], axis=1)
            header = ",".join(written)
            np.savetxt(path, cells, "%.6f", ",", header=header, comments="")
            columns = dict(derive(path, vehicle, logs.axle, believe=True).columns)
        if len(columns["time"]) > 3.0 * RATE:  # s
            found[name] = columns
    return found


def table(logs: Logs) -> Table:
    """The derived table of the logs, with the change."""
    parts, runs = [], []
    for source in logs.of:
        start = 0.0
        for name, columns in _derived(source, logs).items():
            if logs.runs == "set":  # the logs of one set follow each other
                name = source
                columns["time"] = columns["time"] - columns["time"][0] + start
                start = columns["time"][-1] + 5.0
            columns["push"] = MASS[source in POINT] * columns["a_x"]
            columns["turn"] = columns["yaw_rate"] / columns["v"]
            parts.append(columns)
            runs.append(np.full(len(columns["time"]), name))
    joined = {c: np.concatenate([part[c] for part in parts]) for c in parts[0]}
    for column, factor in logs.scaled.items():
        joined[column] = joined[column] * factor
    run = np.concatenate(runs)
    kept = np.zeros(len(run), bool)
    for name in dict.fromkeys(run):
        rows = np.flatnonzero(run == name)[:: logs.every]
        odd = np.arange(len(rows)) * TENTHS // len(rows) % 2 == 1
        kept[rows[{"all": odd | ~odd, "odd": odd, "even": ~odd}[logs.part]]] = True
    made = Table(dict(joined), run, kept)
    for column, delay in logs.late.items():
        if column in joined:
            joined[column] = made.late(column, delay)
            for part in made.parts:  # the values before its first row are not known
                kept[part[: round(delay * RATE)]] = False
    return Table(joined, run, kept)


def data(made: Table, name: str):
    """The diagnosed rows as data of ``tirefit``."""
    columns = {key: made[key] for key in made.columns if key not in ("push", "turn")}
    columns["run"] = made.run[made.kept]
    return tirefit.read_frame(columns, name, convention="braking")
