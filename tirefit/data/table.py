"""The checked, canonical data that every fit reads: :class:`TireData`."""

import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, NamedTuple

import numpy as np

from tirefit.data.merged import merged
from tirefit.data.run_names import run_names
from tirefit.display import Displayed
from tirefit.results import DataError, InputProblem

WHEELS = {"fl": "front left", "fr": "front right", "rl": "rear left", "rr": "rear right"}
"""Suffix of the columns of a wheel -> the wheel."""

CANONICAL = {
    "time": ("s", "time"),
    "sigma_x": ("-", "longitudinal physical slip, braking positive"),
    "alpha": ("rad", "slip angle"),
    "omega": ("rad/s", "wheel speed"),
    "fx": ("N", "longitudinal force, braking positive"),
    "fy": ("N", "lateral force, positive for alpha > 0"),
    "fz": ("N", "load"),
    "mz": ("N m", "aligning moment"),
    "mx": ("N m", "overturning moment"),
    "my": ("N m", "rolling resistance moment, positive if it resists"),
    "v": ("m/s", "forward speed of the wheel centre"),
    "torque": ("N m", "torque of the brake on the wheel, braking positive"),
    "gamma": ("rad", "camber angle"),
    "pressure": ("Pa", "inflation pressure"),
    "temperature": ("degC", "tire temperature"),
    "brake_pressure": ("Pa", "pressure of the brake of this wheel"),
    "alpha_rate": ("rad/s", "rate of the slip angle, at the full sample rate"),
    "steering_rate": ("rad/s", "rate of the road wheel angle to the left, at the full sample rate"),
    "a_x": ("m/s2", "acceleration of the vehicle, forward"),
    "a_y": ("m/s2", "acceleration of the vehicle, to the left"),
    "yaw_rate": ("rad/s", "yaw rate, to the left"),
    "yaw_acceleration": ("rad/s2", "yaw acceleration, to the left"),
    "heading": ("rad", "heading over the floor, counter-clockwise"),
    "x": ("m", "position of the centre of gravity on the floor"),
    "y": ("m", "position of the centre of gravity, to the left of x"),
    "steering": ("rad", "road wheel angle, to the left"),
    "roll_rate": ("rad/s", "roll rate, to the right"),
    "offset": ("m", "distance from the centre line of the lane, to the left"),
    "road_heading": ("rad", "heading of the road there, counter-clockwise"),
    **{f"omega_{w}": ("rad/s", f"wheel speed, {text}") for w, text in WHEELS.items()},
    **{f"torque_{w}": ("N m", f"brake less drive torque, {text}") for w, text in WHEELS.items()},
}
"""Canonical column -> (unit, meaning). Each may have a ``<column>_std``; each force and
moment of the tire may have the value of a simulator, ``<column>_sim``.

The motion of a vehicle, from ``a_x`` on, has the axes of ISO 8855 (x forward, y left,
yaw counter-clockwise) in every convention, as the conventions apply to tires."""


FORCES = ("fx", "fy", "mz", "mx", "my")
"""Columns of the forces and moments on a tire, without the load."""


class Layout(NamedTuple):
    """What a known layout of files defines for its columns, in addition to headers.

    ``names`` maps a header to a canonical column (or slip definition), or to "" if it is
    not read; ``units_from`` is the place of the units; ``convention`` is that of the
    signs, a key of ``slip.CONVENTIONS``, or None; ``stated_in`` is the line of the file
    that states it, or 0.
    """

    names: Mapping[str, str] = {}
    units_from: str = "units row"
    convention: str | None = None
    stated_in: int = 0


SIMULATED = ("fx_sim", "fy_sim", "mz_sim")
"""Columns of the forces of a simulator for the same rows."""


@dataclass(frozen=True)
class SlipCheck:
    """Comparison of a slip column with the slip of the speeds, (v - omega R) / (omega R)."""

    radius: float  # the given rolling radius R [m]
    difference: float  # median size of the difference of the two, as slip ratios [-]
    contradicts: bool  # whether it is larger than the noise of the slip could be
    text: str = ""  # sentence on the probable cause; empty if the two agree


@dataclass(frozen=True)
class Source:
    """The origin of data, and the assumptions in reading them. ``constants`` are the
    dimensions and nominal values of the tire in the file [SI], by .tir key, and in lower
    case the statements of ``tirefit derive``."""

    path: str = ""
    sha256: str = ""
    convention: str = "braking"
    convention_from: str = ""  # its source, in words
    slip_definition: str = "sigma_x"  # a key of ``slip.SLIP_DEFINITIONS``
    columns: Mapping[str, str] = field(default_factory=dict)  # canonical -> header
    units: Mapping[str, str] = field(default_factory=dict)  # in which it was read
    units_beside: tuple[str, ...] = ()  # columns whose unit is stated outside the header
    assumptions: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()  # on columns that may have another meaning
    masked: tuple[InputProblem, ...] = ()
    slip_check: SlipCheck | None = None  # if slip, omega, v and radius are given
    line: np.ndarray | None = None  # of each row
    place: np.ndarray | None = None  # of each row in the file, if the rows were sorted
    paths: tuple[str, ...] = ()  # file of each run where several were joined
    constants: Mapping[str, float] = field(default_factory=dict)

    @property
    def notes(self) -> tuple[str, ...]:
        """All warnings, then all assumptions."""
        return (*(f"warning: {text}" for text in self.warnings), *self.assumptions)


@dataclass(frozen=True, repr=False)
class TireData(Displayed):
    """Measured force-slip data in the canonical convention (see ``tirefit.slip``).

    ``columns`` holds float64 arrays of shape ``(n,)`` by canonical name. Rows are
    never dropped: ``used`` (n,) bool is False for a masked row, whose values may be
    NaN. ``run`` (n,) int indexes ``runs``.
    """

    html_by: ClassVar[str] = "tirefit.report.page:data_fragment"

    name: str
    columns: Mapping[str, np.ndarray]
    used: np.ndarray
    run: np.ndarray
    runs: tuple[str, ...]
    source: Source = field(default_factory=Source)

    def __repr__(self) -> str:
        columns = ", ".join(self.columns)
        return f"TireData({self.name!r}, {self.n} of {len(self)} rows: {columns})"

    def __len__(self) -> int:
        return len(self.used)

    def __contains__(self, column: str) -> bool:
        return column in self.columns

    def __getitem__(self, column: str) -> np.ndarray:
        return self.columns[column]

    @property
    def n(self) -> int:
        """Number of used rows."""
        return int(np.count_nonzero(self.used))

    @property
    def file(self) -> str:
        """Path of the file, or the name of data without a file."""
        return self.source.path or self.name

    def first_masked(self, most: int = 3) -> tuple[str, ...]:
        """The first unused rows with reasons, and their number if there are more."""
        masked = self.source.masked
        first = [replace(at, remedy="", file="") for at in masked[:most]]
        rest = [f"{len(self) - self.n} rows in all"] if len(masked) > most else []
        return (*map(str, first), *rest)

    def where(self, rows: np.ndarray) -> "TireData":
        """The same data, in which only ``rows`` (n,) bool are used."""
        return replace(self, used=self.used & rows)

    def in_order(self) -> "TireData":
        """The same data, sorted by run, in the order of the runs' names (numbers by size), and by
        time within each run; unchanged without time."""
        if "time" not in self:
            return self
        ranked = sorted(range(len(self.runs)), key=lambda k: _natural(self.runs[k]))
        run = np.argsort(ranked)[self.run]
        order = np.lexsort((self["time"], run))
        if np.array_equal(order, np.arange(len(self))) and np.array_equal(run, self.run):
            return self
        columns = {name: values[order] for name, values in self.columns.items()}
        line = None if self.source.line is None else self.source.line[order]
        paths = tuple(self.source.paths[k] for k in ranked) if self.source.paths else ()
        source = replace(self.source, line=line, place=order, paths=paths)
        runs = tuple(self.runs[k] for k in ranked)
        return replace(
            self, columns=columns, used=self.used[order], run=run[order], runs=runs, source=source
        )

    def usable(self, column: str) -> np.ndarray:
        """The used rows of one column, shape (n_used,)."""
        return self.columns[column][self.used]


def _natural(name: str) -> list[int | str]:
    """A key that sorts names by their numbers, as log 2 before log 10."""
    return [int(x) if x.isdecimal() else x for x in re.split(r"(\d+)", name)]


def _shared_constants(sources: Sequence[Source]) -> tuple[dict[str, float], list[str]]:
    """Constants that agree in all files that state them, and warnings on the others."""
    shared, warnings = {}, []
    for name in dict.fromkeys(key for source in sources for key in source.constants):
        values = [source.constants[name] for source in sources if name in source.constants]
        # Rounding may cause a relative difference of 1e-3.
        if np.ptp(values) <= 1e-3 * max(values):
            shared[name] = values[0]
        elif not name.islower():
            warnings.append(
                f"{name} differs between files, {min(values):g} to {max(values):g}: not"
                f" used; state it in fit.toml: parameters.{name}.value"
            )
    return shared, warnings


def join(tables: Sequence[TireData]) -> TireData:
    """Join files as the runs of one data set; only columns that all have are kept.

    A file that holds several runs keeps them, named ``file:run``.
    """
    if not tables:
        raise DataError("no data given", "give at least one file or table")
    names: dict[str, str] = {}
    for table in tables:
        for key in filter(None, (table.source.sha256, table.source.path)):
            if key in names:
                reason = f"the same name or content as {names[key]}: its rows would count twice"
                remedy = "give each file once, and each frame a name=... of its own"
                raise DataError(reason, remedy, table.file)
            names[key] = table.file
    shared = [c for c in tables[0].columns if all(c in table for table in tables)]
    runs: list[str] = []
    codes = []
    for table in tables:
        codes.append(table.run + len(runs))
        several = len(table.runs) > 1
        runs += [f"{table.name}:{r}" if several else table.name for r in table.runs]
    short = run_names([table.name for table in tables]).short
    sources = [(name, t.source) for name, t in zip(short, tables, strict=True)]
    messages = merged((name, source.assumptions) for name, source in sources)
    if dropped := sorted({c for table in tables for c in table.columns} - set(shared)):
        messages.append(f"columns that some files lack were left out: {', '.join(dropped)}")
    signs = dict.fromkeys(table.source.convention for table in tables)
    if len(signs) > 1:
        messages.append(
            f"files in several conventions: {', '.join(signs)}; each is read in its own"
        )
    digest = hashlib.sha256("".join(t.source.sha256 for t in tables).encode()).hexdigest()
    lines = [t.source.line for t in tables if t.source.line is not None]
    checks = [t.source.slip_check for t in tables if t.source.slip_check is not None]
    constants, differing = _shared_constants([source for _, source in sources])
    source = replace(
        tables[0].source,
        constants=constants,
        slip_check=max(checks, key=lambda check: check.difference, default=None),
        path=", ".join(table.source.path for table in tables),
        sha256=digest,
        assumptions=tuple(messages),
        warnings=(*merged((name, s.warnings) for name, s in sources), *differing),
        masked=tuple(problem for table in tables for problem in table.source.masked),
        line=np.concatenate(lines) if len(lines) == len(tables) else None,
        paths=tuple(t.file for t in tables for _ in t.runs),
    )
    return TireData(
        "+".join(table.name for table in tables),
        {c: np.concatenate([table[c] for table in tables]) for c in shared},
        np.concatenate([table.used for table in tables]),
        np.concatenate(codes),
        tuple(runs),
        source,
    )
