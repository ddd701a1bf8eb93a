"""The logs of the benchmark: scenarios, their number and seeds.

A log is two CSV files of canonical columns, NAME.csv (measured) and NAME.truth.csv, and a
line in index.csv. The kinds are the keys of ``KINDS``: a further kind needs a function
that makes logs from a :class:`Scenario`, and its uses of friction.
"""

import csv
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from fits.formulas import brush
from tirefit.sim.braking import LOAD, PEAK, STIFFNESS, Braking, SimulatedLog, simulate_braking
from tirefit.sim.drive import Drive, simulate_drive

DROPS = (0.6, 0.8)
"""Friction after a drop from 0.98: a wet road, and a slightly lower friction."""
TOOTH = 2.0
"""Period [s] of the saw-tooth."""
BEND = 5.0
"""Period [s] of the bends of a drive."""
HALF_LENGTH = 0.1
"""Half length of the contact patch [m], for logs with aligning moment."""
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
    duration = round(60 * hours / 3 * 60 / TOOTH) * TOOTH
    for kind, (_, uses, period) in KINDS.items():
        for use in uses:
            percent = f"{kind}_{100 * use:.0f}"
            for seed in range(3):
                name = f"{percent}_steady_{seed}"
                listed.append(Scenario(name, kind, use, seed, duration))
            for after in DROPS:
                for k in range(drops):
                    # Spread over a tooth: unused friction cannot be detected.
                    when = 20 + period * (k + 0.5) / drops
                    name = f"{percent}_drop_{100 * after:.0f}_{k}"
                    seed = 1000 + 100 * DROPS.index(after) + k
                    listed.append(Scenario(name, kind, use, seed, 40, when, after))
    return listed


def _drop(scenario: Scenario) -> tuple[float, float] | None:
    steady = np.isnan(scenario.drop)
    return None if steady else (scenario.drop, scenario.after)


def _braking(scenario: Scenario) -> SimulatedLog:
    teeth = round(scenario.duration / TOOTH)
    drop = _drop(scenario)
    how = Braking(scenario.use, teeth, TOOTH, seed=scenario.seed, drop=drop)
    return simulate_braking(how)


def _drive(scenario: Scenario) -> SimulatedLog:
    how = Drive(
        duration=scenario.duration,
        bend=scenario.use,
        bend_period=BEND,
        friction=PEAK,
        drop=_drop(scenario),
        seed=scenario.seed,
    )
    return simulate_drive(how)


def _cornering(scenario: Scenario) -> SimulatedLog:
    """A brush that is steered in saw-teeth: lateral force and moment."""
    n = round(100 * scenario.duration)
    time, random = np.arange(n) / 100, np.random.default_rng(scenario.seed)
    mu = np.full(n, PEAK)
    if not np.isnan(scenario.drop):
        mu[time >= scenario.drop] = scenario.after
    cpa2 = STIFFNESS / 2
    largest = 3 * PEAK * LOAD * (1 - (1 - scenario.use) ** (1 / 3)) / (2 * cpa2)
    slip = largest * (time % TOOTH) / TOOTH
    fy = brush(slip, LOAD, 20.0, cpa2, mu)
    sliding = np.minimum(2 * cpa2 * slip / (3 * mu * LOAD), 1.0)
    # S section 3.6: M_z = -F_z a mu theta (1 - theta)^3.
    mz = -LOAD * HALF_LENGTH * mu * sliding * (1 - sliding) ** 3
    one = np.ones(n)
    truth = {
        "time": time,
        "alpha": np.arctan(slip),
        "fy": fy,
        "mz": mz,
        "fz": LOAD * one,
        "v": 20.0 * one,
    }
    noise = random.standard_normal((2, n))
    columns = truth | {
        "fy": fy + 0.0447 * LOAD * noise[0],
        "mz": mz + 0.005 * HALF_LENGTH * LOAD * noise[1],
    }
    return SimulatedLog(columns, truth | {"mu": mu})


KINDS = {
    "braking": (_braking, (0.5, 0.6, 0.75), TOOTH),
    "cornering": (_cornering, (0.5, 0.6, 0.75), TOOTH),
    "drive": (_drive, (0.25, 0.35, 0.45), BEND),
}
"""Kind of log -> the function that makes it, its low, medium and high use of friction, and
the period [s] of the use. The use refers to the first friction; on a friction of 0.6 a
car cannot be held above 0.45 of 0.98."""


def make(scenario: Scenario) -> Log:
    """The log of a scenario."""
    made = KINDS[scenario.kind][0](scenario)
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
            row["name"],
            row["kind"],
            float(row["use"]),
            int(row["seed"]),
            *(float(row[key]) for key in ("duration", "drop", "after")),
        )
        for row in rows
    ]


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
        begin = file.tell()
        try:
            cells = np.loadtxt(file, delimiter=",", ndmin=2)
        except ValueError:  # an empty cell, which only genfromtxt accepts
            file.seek(begin)
            cells = np.genfromtxt(file, delimiter=",", ndmin=2)
    return dict(zip(header, cells.T, strict=True))


def _write(path: Path, columns: dict[str, np.ndarray]) -> None:
    values = np.stack(list(columns.values()), axis=1)
    header = ",".join(columns)
    row = ",".join(["%.7g"] * values.shape[1])
    lines = [row % tuple(cells) for cells in values.tolist()]
    path.write_text("\n".join([header, *lines]) + "\n")
