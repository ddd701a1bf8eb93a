"""The logs of the benchmark: what is driven, how often, from which seeds.

A log is two CSV files of canonical columns, NAME.csv (what was measured) and
NAME.truth.csv, and a line in index.csv. The kinds are the keys of ``KINDS``: a further
one (a whole vehicle, say) is a function that makes logs from a :class:`Scenario`.
"""

import csv
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from tirefit.sim.braking import Braking, SimulatedLog, simulate_braking

USES = (0.5, 0.6, 0.75)
"""Largest brake torque over that of the peak: low, medium and high use of friction."""
DROPS = (0.6, 0.8)
"""Friction after a drop from 0.98: to wet, and to a little less."""
TOOTH = 2.0
"""Period [s] of the saw-tooth."""
TRUE = ("time", "mu", "cpa2", "sigma_x", "fx")


@dataclass(frozen=True)
class Scenario:
    """One log: ``drop`` is the time [s] of a drop to the friction ``after``, or NaN."""

    name: str
    kind: str
    use: float
    seed: int
    duration: float
    drop: float = np.nan
    after: float = np.nan


@dataclass(frozen=True)
class Log:
    """A scenario with its measured columns (n,) and its truth (n,)."""

    scenario: Scenario
    columns: dict[str, np.ndarray]
    truth: dict[str, np.ndarray]


def scenarios(hours: float = 0.5, drops: int = 10) -> list[Scenario]:
    """Every log of the benchmark.

    Args:
        hours: of driving without a drop, for each use of friction.
        drops: logs with a drop, for each use and each size of drop.
    """
    listed = []
    minutes = 60 * hours / 3
    for use in USES:
        percent = f"braking_{100 * use:.0f}"
        for seed in range(3):
            name = f"{percent}_steady_{seed}"
            listed.append(Scenario(name, "braking", use, seed, 60 * minutes))
        for after in DROPS:
            for k in range(drops):
                # Anywhere within a tooth: what is not braked cannot be noticed.
                when = 20 + TOOTH * (k + 0.5) / drops
                name = f"{percent}_drop_{100 * after:.0f}_{k}"
                seed = 1000 + 100 * DROPS.index(after) + k
                listed.append(Scenario(name, "braking", use, seed, 40, when, after))
    return listed


def _braking(scenario: Scenario) -> SimulatedLog:
    drop = None if np.isnan(scenario.drop) else (scenario.drop, scenario.after)
    teeth = round(scenario.duration / TOOTH)
    how = Braking(scenario.use, teeth, TOOTH, seed=scenario.seed, drop=drop)
    return simulate_braking(how)


KINDS = {"braking": _braking}
"""Kind of log -> what makes one."""


def make(scenario: Scenario) -> Log:
    """The log of a scenario."""
    made = KINDS[scenario.kind](scenario)
    truth = {name: made.truth[name] for name in TRUE if name in made.truth}
    return Log(scenario, dict(made.columns), truth)


def write_logs(folder: Path, listed: list[Scenario]) -> None:
    """index.csv, and for every scenario NAME.csv and NAME.truth.csv."""
    folder.mkdir(parents=True, exist_ok=True)
    for scenario in listed:
        log = make(scenario)
        _write(folder / f"{scenario.name}.csv", log.columns)
        _write(folder / f"{scenario.name}.truth.csv", log.truth)
    with open(folder / "index.csv", "w", newline="") as file:
        rows = csv.DictWriter(file, list(asdict(listed[0])))
        rows.writeheader()
        rows.writerows(asdict(scenario) for scenario in listed)


def read_index(folder: Path) -> list[Scenario]:
    """The scenarios whose logs are in a folder."""
    with open(folder / "index.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    return [
        Scenario(
            row["name"], row["kind"], float(row["use"]), int(row["seed"]),
            *(float(row[key]) for key in ("duration", "drop", "after")),
        )
        for row in rows
    ]  # fmt: skip


def read_log(folder: Path, scenario: Scenario) -> Log:
    """The log of a scenario from its files."""
    measured = read_columns(folder / f"{scenario.name}.csv")
    return Log(scenario, measured, read_columns(folder / f"{scenario.name}.truth.csv"))


def read_columns(path: Path) -> dict[str, np.ndarray]:
    """Columns (n,) of a CSV file of numbers; empty cells are NaN."""
    with open(path) as file:
        header = file.readline().strip().split(",")
        if "" in header:
            raise ValueError(f"{path}: a column without a name")
        cells = np.genfromtxt(file, delimiter=",", ndmin=2)
    return dict(zip(header, cells.T, strict=True))


def _write(path: Path, columns: dict[str, np.ndarray]) -> None:
    values = np.stack(list(columns.values()), axis=1)
    header = ",".join(columns)
    np.savetxt(path, values, "%.7g", ",", header=header, comments="")
