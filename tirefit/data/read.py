"""Read files and frames into checked, canonical data: :func:`read`, :func:`read_frame`.

An error lists all problems, each with its place and a remedy. Assumptions are sentences
in ``Source.assumptions``.
"""

import os
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from tirefit.data import check, signs
from tirefit.data.check import BadRows
from tirefit.data.columns import Plan, plan_columns
from tirefit.data.declared import DECLARED_BY, Options, Signs, declared
from tirefit.data.readers.cells import words_of
from tirefit.data.readers.kinds import read_table
from tirefit.data.readers.quaternion import with_headings
from tirefit.data.readers.remote import Place, RemoteFile, file_at
from tirefit.data.readers.text import Table, table_of_frame
from tirefit.data.readers.ttc import recognised
from tirefit.data.table import CANONICAL, FORCES, SlipCheck, Source, TireData
from tirefit.data.units import (
    SPINNING,
    base_column,
    sigma_derivative,
    sign_of,
    slip_from_speeds,
    slip_to_sigma,
)
from tirefit.data.vehicle.findings import findings
from tirefit.data.vehicle.vehicle_log import IS_VEHICLE_LOG
from tirefit.results import DataError, InputProblem
from tirefit.slip import LOCKED, SLIP_DEFINITIONS

__all__ = ["Table", "read", "read_frame", "read_table", "require"]


@runtime_checkable
class Columns(Protocol):
    """Columns (n,) by name: a mapping, a frame of pandas or polars, a structured array."""

    def __getitem__(self, name: str, /) -> ArrayLike: ...


def read(
    path: Place | str | os.PathLike[str] | Columns,
    *,
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    convention: str | None = None,
    slip: str | None = None,
    constants: Mapping[str, float] | None = None,
    rolling_radius: float | None = None,
    mask_bad_rows: bool = False,
    forces: bool = True,
    curve: bool = True,
    otherwise: tuple[str, str] | None = None,
) -> TireData:
    """Read a file of measurements into checked, canonical data.

    Text (CSV and similar, columns separated by white space, TYDEX, Tire Test
    Consortium), MATLAB, Parquet, Arrow and Excel, each also gzipped, are recognised by
    their content and not by the file name.

    Args:
        path: the file, or its address (``s3://...`` and others of fsspec); a frame or arrays,
            as :func:`read_frame` takes them.
        columns: canonical name (or slip definition, ``run``, ``<column>_std``) -> header
            of the file; other columns are inferred, which the assumptions report.
        units: canonical name -> unit, e.g. ``{"fx": "kN", "kappa": "%"}``; a leading
            minus (``-N``) flips the sign of a column.
        convention: signs of the file, a key of ``slip.CONVENTIONS``. If None, those
            that the file declares (a line "convention NAME" above the header, TYDEX,
            Tire Test Consortium), else those of ``otherwise``, else "braking".
        slip: definition of the slip column, a key of ``slip.SLIP_DEFINITIONS``.
        constants: canonical columns that are constant over the file, SI and canonical
            signs, e.g. ``{"fz": 4000, "v": 20}``.
        rolling_radius: effective radius [m]; computes the slip from omega and v, or
            compares the slip column with them (``source.slip_check``): a slip that
            contradicts them is read, with a warning.
        mask_bad_rows: keep rows that break a rule as unused rows, listed in
            ``source.masked``, instead of raising.
        forces: False if forces will be predicted: no force column is needed, one operating point is
            enough, and a unit declared for a force that the file lacks is used for writing it.
        curve: False for a log of a vehicle, which need not have slip, force and load;
            the caller checks its columns (:func:`require`).
        otherwise: convention of the model that the data are compared with, and the
            name of the model. It is assumed if neither user nor file declares one.

    Returns:
        All rows in SI units and canonical signs; ``source`` lists what was assumed.

    Raises:
        UsageError: an option has an unknown name or value.
        DataError: unusable file or contradicted convention; it lists all problems.

    Example:
        >>> data = read(samples / "circles.csv")
        >>> data.n, [*data.columns]
        (432, ['time', 'alpha', 'fy', 'fz', 'v'])
    """
    options = declared(
        columns=columns, units=units, convention=convention, slip=slip, constants=constants,
        rolling_radius=rolling_radius, mask_bad_rows=mask_bad_rows, forces=forces,
        curve=curve, otherwise=otherwise,
    )  # fmt: skip
    if isinstance(path, str | os.PathLike | RemoteFile):
        return _checked(read_table(file_at(path), options.columns.values()), options)
    return _checked(table_of_frame(path, "data"), options)


def read_frame(frame: Columns, name: str = "data", **options: Any) -> TireData:
    """Read a frame or arrays into canonical, checked data.

    Args:
        frame: a frame of pandas or polars, a structured array, or a mapping of name to (n,) array.
        name: what reports call the data.
        options: arguments of :func:`read`.

    Returns:
        As of :func:`read`; its problems count rows from 0, as ``iloc`` does.

    Raises:
        UsageError, DataError: as :func:`read`.

    Example:
        >>> swept = {"alpha": np.linspace(-8, 8, 40), "fz": np.full(40, 4000.0)}
        >>> swept["fy"] = 3500 * np.tanh(swept["alpha"] / 3)
        >>> data = read_frame(swept, units={"alpha": "deg"})
        >>> float(data["alpha"].max().round(4))
        0.1396
    """
    return _checked(table_of_frame(frame, name), declared(**options))


def require(data: TireData, columns: Sequence[str], why: str) -> None:
    """Raises DataError if a column that ``why`` (a model, a fit) needs is missing."""
    problems = []
    for column in columns:
        if column in data:
            continue
        unit, meaning = CANONICAL[base_column(column)]
        remedy = f"name its column with --column {column}=HEADER"
        if base_column(column) not in ("sigma_x", "alpha", "time", *FORCES):
            remedy += f", or give --constant {column}=VALUE [{unit}]"
        if column == "sigma_x":
            remedy += " (also kappa, s), or give omega, v and --rolling-radius"
        reason = f"{why} needs {column} ({meaning}), which the data do not have"
        problems.append(InputProblem(reason, remedy, data.file))
    DataError.raise_for(problems)


@dataclass
class _Reading:
    """State while reading: the columns, their faults and assumptions so far."""

    table: Table
    options: Options
    plan: Plan
    signs: Signs
    columns: dict[str, np.ndarray] = field(default_factory=dict)
    shown: dict[str, np.ndarray] = field(default_factory=dict)
    headers: dict[str, str] = field(default_factory=dict)
    faults: list[BadRows] = field(default_factory=list)
    idle: list[str] = field(default_factory=list)
    unread: list[str] = field(default_factory=list)
    problems: list[InputProblem] = field(default_factory=list)
    assumptions: list[str] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)
    sign_doubts: list[str] = field(default_factory=list)
    slip_check: SlipCheck | None = None

    def problem(self, reason: str, remedy: str, column: str | None = None) -> None:
        """Add a problem of the whole file."""
        self.problems.append(InputProblem(reason, remedy, self.table.file, column=column))

    def fault(self, name: str, rows: np.ndarray, rule: str, header: str) -> None:
        """Add rows, if any, that break a rule."""
        if len(rows):
            shown = [f"{value:.6g}" for value in self.shown[name][rows]]
            self.faults.append(BadRows(header, rows, shown, rule))

    def bad(self) -> np.ndarray:
        """(n,) bool: rows with a fault."""
        bad = np.zeros(len(self.table.lines), bool)
        for fault in self.faults:
            bad[np.asarray(fault.rows, int)] = True
        return bad


def _checked(table: Table, options: Options) -> TireData:
    """Convert a table of cells to data; raises one error with all problems."""
    table, _ = with_headings(recognised(table))
    plan = plan_columns(table.headers, table.units_row, options, table.file, table.layout)
    read_as = options.signs(table.layout, plan.columns, table.file)
    reading = _Reading(table, options, plan, read_as)
    lines = table.header_line, table.units_line or table.header_line
    by_row = {column.header for column in plan.columns.values() if column.beside}
    reading.problems = [replace(p, row=lines[p.column in by_row]) for p in plan.problems]
    reading.problems += read_as.problems
    reading.faults += table.faults
    reading.doubts += table.doubts
    run, runs = _runs(reading)
    _numbers_to_si(reading)
    _constants(reading)
    reading.assumptions += check.drop_absent_noise(reading.columns, reading.headers)
    reading.faults += check.range_faults(reading.columns, reading.shown, reading.headers)
    definition = plan.slip or "sigma_x"
    if plan.slip is not None and plan.slip in reading.columns:  # not a constant
        _slip_to_sigma(reading, plan.slip)
    if options.rolling_radius is not None:
        _use_rolling_radius(reading, definition, options.rolling_radius)
    if options.forces and options.curve and not reading.bad().all():
        for name in FORCES:  # those that are zero in all rows were not measured
            if name in reading.columns and not np.any(reading.columns[name][~reading.bad()]):
                del reading.columns[name]
                header = reading.headers.pop(name, name)
                reading.idle.append(header)
                sentence = f"column {header!r} not used: it is zero in all rows"
                reading.assumptions.append(sentence)
    masked = _raise_or_mask(reading)
    assumptions = (
        *table.notes,
        *plan.assumptions,
        *(column.note for column in plan.columns.values()),
        str(read_as),
        *reading.assumptions,
        *findings(table.constants),
    )
    source = Source(
        path=table.file,
        sha256=table.sha256,
        convention=read_as.convention,
        convention_from=read_as.whose,
        slip_definition=definition,
        columns=reading.headers,
        units=plan.units_to_write
        | {_canonical(c.name): c.unit_text for c in plan.columns.values() if c.unit},
        units_beside=tuple(_canonical(c.name) for c in plan.columns.values() if c.beside),
        assumptions=assumptions,
        warnings=_warnings(reading, run),
        masked=masked,
        slip_check=reading.slip_check,
        line=table.lines,
        constants=table.constants,
    )
    names = (f"{c}{end}" for c in CANONICAL for end in ("", "_std", "_sim"))
    ordered = {name: reading.columns[name] for name in names if name in reading.columns}
    return TireData(table.name, ordered, ~reading.bad(), run, runs, source)


def _canonical(name: str) -> str:
    """Canonical name of a column that was read; that of any slip definition is sigma_x."""
    base = base_column(name)
    return name.replace(base, "sigma_x", 1) if base in SLIP_DEFINITIONS else name


def _runs(reading: _Reading) -> tuple[np.ndarray, tuple[str, ...]]:
    """Codes (n,) int in order of appearance, and the names of the runs."""
    column, table = reading.plan.columns.get("run"), reading.table
    if column is None:
        return np.zeros(len(table.lines), int), (table.name,)
    names = words_of(table.cells[column.index])
    empty = [i for i, name in enumerate(names) if name in ("", "nan") and not table.ragged[i]]
    if empty:
        values = ["an empty cell"] * len(empty)
        reading.faults.append(BadRows(column.header, empty, values, check.NO_RUN))
    codes: dict[str, int] = {}
    run = [codes.setdefault(name, len(codes)) for name in names]
    return np.array(run, int), tuple(codes)


def _numbers_to_si(reading: _Reading) -> None:
    """Fill ``columns`` with values in canonical units and signs; the slip as defined."""
    table, plan, note = reading.table, reading.plan, reading.assumptions.append
    for column in [column for name, column in plan.columns.items() if name != "run"]:
        base = base_column(column.name)
        # Rows without pressure are at nominal pressure; a prediction needs only what models read.
        is_needed = base in check.INPUTS or (reading.options.forces and base != "pressure")
        values, faults = check.read_numbers(
            table.cells[column.index], column.header, table.ragged, gaps=not is_needed
        )
        count = sum(len(fault.rows) for fault in faults if fault.is_missing)
        declared = column.name in reading.options.columns or reading.options.mask_bad_rows
        # What lacks for a fit if all cells of these columns are empty is an error of the columns.
        is_rare = base not in {*check.INPUTS, "fx", "fy", "mz"}
        if not declared and count > (check.MOST * len(values) if is_rare else len(values) - 1):
            text = f"column {column.header!r} is not read: {count} of its {len(values)} cells"
            option = shlex.quote(f"{column.name}={column.header}")
            reads = f"; --column {option} reads it" if count < len(values) else ""
            reading.unread.append(f"{text} have no value{reads}")
            del plan.columns[column.name]
            continue
        reading.faults += faults
        if column.name == "pressure" and np.isnan(values[~table.ragged]).any():
            note(f"rows without {column.header!r} are at nominal pressure")
        if column.unit is None:
            continue
        if column.unit.scale < 0:
            note(f"sign of column {column.header!r} flipped, as declared")
        is_std = column.name.endswith("_std")
        sign = sign_of(reading.signs.convention, column.name)
        reading.shown[column.name] = values
        reading.columns[column.name] = sign * column.unit.to_si(values, is_std)
        reading.headers[column.name] = column.header


def _constants(reading: _Reading) -> None:
    for name, value in reading.options.constants.items():
        there = {_canonical(known): known for known in reading.headers}
        if name in there:
            header = reading.headers[there[name]]
            reason = f"{name} = {value:g}, declared by {DECLARED_BY['constants']}, conflicts"
            remedy = f"remove the constant: the file has {name}"
            reading.problem(f"{reason} with this column", remedy, header)
            continue
        reading.columns[name] = np.full(len(reading.table.lines), float(value))
        reading.shown[name] = reading.columns[name]
        unit = CANONICAL[base_column(name)][0]
        reading.assumptions.append(f"{name} = {value:g} {unit} in all rows, as declared")


def _slip_to_sigma(reading: _Reading, definition: str) -> None:
    """Replace the slip column and its std by physical slip sigma_x."""
    columns, headers = reading.columns, reading.headers
    header, alpha = headers.pop(definition), columns.get("alpha")
    slip = columns.pop(definition)
    if definition == "s" and alpha is not None:
        reading.assumptions.append("kappa = s / cos(alpha) before conversion")
        with np.errstate(invalid="ignore"):
            over = np.flatnonzero((slip / np.cos(alpha) > 1 + 1e-6) & (slip <= 1))
        reading.fault("s", over, "gives kappa = s / cos(alpha) > 1, beyond a locked wheel", header)
    sigma = slip_to_sigma(slip, definition, alpha)
    columns["sigma_x"] = np.where(reading.bad(), np.nan, sigma)
    headers["sigma_x"] = header
    if definition != "sigma_x":
        reading.assumptions.append(f"{definition} converted to sigma_x")
    _note_limits(reading, header)
    for name in [n for n in columns if _canonical(n) == "sigma_x_std"]:
        slope = sigma_derivative(columns["sigma_x"], definition, alpha)
        columns["sigma_x_std"] = columns.pop(name) * slope
        headers["sigma_x_std"] = headers.pop(name)


def _note_limits(reading: _Reading, header: str) -> None:
    for limit, meaning in ((LOCKED, "are a locked wheel"), (SPINNING, "spin on the spot")):
        if count := np.sum(reading.columns["sigma_x"] == limit):
            note = f"{count} rows of {header!r} {meaning}: sigma_x = {limit:g}"
            reading.assumptions.append(note)


def _use_rolling_radius(reading: _Reading, definition: str, radius: float) -> None:
    """Compute sigma_x = (v - omega R) / (omega R), or compare the slip column with it."""
    columns = reading.columns
    if without := " and ".join(name for name in ("omega", "v") if name not in columns):
        if not {"sigma_x", "alpha"} & columns.keys():
            reason = f"--rolling-radius needs {without} to give a slip"
            reading.problem(reason, "name them, as in --column omega=HEADER")
        return
    sigma = slip_from_speeds(columns["omega"], columns["v"], radius)
    if "sigma_x" in columns:
        good = ~reading.bad() & np.isfinite(sigma + columns["sigma_x"])
        if good.any():
            header = reading.headers.get("sigma_x", "sigma_x")  # a constant has no header
            given = columns["sigma_x"][good]
            alpha = columns["alpha"][good] if "alpha" in columns else None
            compared = signs.check_slip(given, sigma[good], definition, alpha, radius)
            reading.slip_check = compared
            reading.doubts += [f"column {header!r}: {compared.text}"] if compared.text else []
        return
    header = reading.headers.get("omega", "omega")
    for rows, rule in (
        (np.flatnonzero(columns["omega"] < 0), "is a wheel turning backwards"),
        (np.flatnonzero((columns["omega"] == 0) & (columns["v"] == 0)), "at standstill: no slip"),
    ):
        reading.fault("omega", rows, rule, header)
    columns["sigma_x"] = np.where(reading.bad(), np.nan, sigma)
    reading.assumptions.append(f"sigma_x = (v - omega R) / (omega R) with R = {radius:g} m")
    _note_limits(reading, header)


def _raise_or_mask(reading: _Reading) -> tuple[InputProblem, ...]:
    """Raises DataError with all problems that masking does not solve; returns those of
    masked rows. Rows that only lack a value are excluded with a warning."""
    table, faults, mask = reading.table, reading.faults, reading.options.mask_bad_rows
    forces, curve = reading.options.forces, reading.options.curve
    too_many: list[InputProblem] = []
    if not mask:
        absent = [fault for fault in faults if fault.is_missing]
        warning, too_many = check.excluded(absent, table.lines, table.file, forces)
        reading.doubts += [warning] if warning else []
        faults = [fault for fault in faults if not fault.is_missing]
    of_rows, of_columns = check.list_problems(faults, table.lines, table.file)
    of_rows += too_many
    whole = reading.problems + of_columns
    if curve:
        plan = reading.plan.columns.items()
        named = {_canonical(name) for name, c in plan if c.header not in reading.idle}
        there = named | set(reading.columns)
        lacking = check.check_columns(
            there, table.headers, reading.idle, table.file, forces, table.units_row
        )
        unread = [*reading.unread, *(note for note in table.notes if " not read" in note)]
        whole += [replace(p, reason="; ".join([p.reason, *unread])) for p in lacking]
    good = ~reading.bad()
    if not whole:
        used = {name: values[good] for name, values in reading.columns.items()}
        if good.any():
            whole += check.check_variation(used, table.file) if forces and curve else []
            slip = reading.plan.slip or "sigma_x"
            units = {name: column.unit_text for name, column in reading.plan.columns.items()}
            is_derived = "wheelbase" in table.constants
            problems, reading.sign_doubts = signs.judge_signs(
                used, reading.headers, reading.signs, table.file, slip, units, is_derived
            )
            whole += problems
        elif mask or not of_rows:
            remedy = "see the rows' problems without --mask-bad-rows"
            remedy = remedy if mask else "every row lacks a value in a column that is needed"
            whole.append(InputProblem("no usable rows are left", remedy, table.file))
    if any(problem.reason == IS_VEHICLE_LOG for problem in whole):
        of_rows = []  # a vehicle log has no slip and force to check
    if mask:  # without the advice to mask them
        of_rows = [replace(p, remedy=p.remedy.replace(check.OR_MASK, "")) for p in of_rows]
    if whole or (of_rows and not mask):
        raise DataError([*whole, *of_rows])
    return tuple(of_rows)


def _warnings(reading: _Reading, run: np.ndarray) -> tuple[str, ...]:
    """Warnings by the rows that are complete: a prediction keeps others, without a force."""
    good = ~reading.bad() & np.all([np.isfinite(v) for v in reading.columns.values()], axis=0)
    if not good.any():
        return tuple(reading.unread + reading.doubts)
    used = {name: values[good] for name, values in reading.columns.items()}
    lines = reading.table.lines[good]
    doubts = reading.sign_doubts + reading.unread + reading.doubts
    doubts += signs.doubt_units(used, reading.headers, reading.plan)
    if "time" in used and reading.options.curve:
        header = reading.headers.get("time", "time")
        doubts += check.doubt_time(used["time"], run[good], lines, header)
    return tuple(doubts)
