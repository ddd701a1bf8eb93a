"""Summarise a data set: :func:`inspect`."""

import dataclasses
import math
import textwrap
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from tirefit.data.accept import DataLike, as_data
from tirefit.data.rig.levels import levels
from tirefit.data.table import CANONICAL, TireData
from tirefit.data.units import base_column
from tirefit.files import json_safe
from tirefit.slip import CONVENTIONS

_WIDTH = 80


@dataclass(frozen=True)
class ColumnSummary:
    """One column, min/median/max of its used rows in the canonical ``unit``."""

    name: str
    unit: str
    header: str | None
    file_unit: str | None
    min: float
    median: float
    max: float


@dataclass(frozen=True)
class Level:
    """A level of a column, such as a load or speed that was held, with ``n`` rows."""

    median: float
    min: float
    max: float
    n: int


@dataclass(frozen=True)
class RunSummary:
    """One run: its used rows, levels, slips and samples per second."""

    name: str
    n: int
    loads: tuple[Level, ...]
    speeds: tuple[Level, ...]
    slip: dict[str, tuple[float, float]]  # sigma_x and alpha -> (min, max)
    sampling_rate: float | None


@dataclass(frozen=True)
class Inspection:
    """The result of :func:`inspect`."""

    file: str
    sha256: str
    rows: int
    used: int
    convention: str
    slip_definition: str
    columns: tuple[ColumnSummary, ...]
    runs: tuple[RunSummary, ...]
    warnings: tuple[str, ...]
    assumptions: tuple[str, ...]
    masked: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON; numbers that are not finite are None."""
        return json_safe(dataclasses.asdict(self))

    def summary(self) -> str:
        """A plain-text report of at most 80 columns."""
        meaning = CONVENTIONS[self.convention].description
        lines = [
            *_wrap(f"{self.file}"),
            f"  {self.rows} rows, {self.used} used, {self.rows - self.used} masked",
            *_wrap(f"convention {self.convention}: {meaning}"),
            f"  slip column as {self.slip_definition}",
            *([f"  sha256 {self.sha256}"] if self.sha256 else []),
            "",
            *_column_lines(self.columns),
        ]
        lines += ["", "runs", *(line for run in self.runs for line in _run_lines(run))]
        for title, messages in (
            ("warnings", self.warnings),
            ("what was assumed", self.assumptions),
            ("masked rows", self.masked),
        ):
            if messages:
                lines += ["", title, *(line for text in messages for line in _wrap(text))]
        return "\n".join(lines)


def inspect(data: DataLike) -> Inspection:
    """Summarise data: ranges, runs, loads and speeds, warnings and assumptions.

    Args:
        data: a result of ``tirefit.read``, or a path, a frame, a mapping of arrays.

    Returns:
        The summary; ``print(inspect(data).summary())`` shows it.

    Raises:
        DataError: as :func:`tirefit.read`.

    Example:
        >>> summary = inspect(samples / "circles.csv")
        >>> [(column.name, column.unit) for column in summary.columns][:3]
        [('time', 's'), ('alpha', 'rad'), ('fy', 'N')]
    """
    data = as_data(data)
    source = data.source
    return Inspection(
        file=data.file,
        sha256=source.sha256,
        rows=len(data),
        used=data.n,
        convention=source.convention,
        slip_definition=source.slip_definition,
        columns=tuple(_summarise(data, name) for name in data.columns),
        runs=tuple(_inspect_run(data, code) for code in range(len(data.runs))),
        warnings=source.warnings,
        assumptions=source.assumptions,
        masked=tuple(
            str(dataclasses.replace(problem, remedy="", file="")) for problem in source.masked
        ),
    )


def _summarise(data: TireData, name: str) -> ColumnSummary:
    values, source = data.usable(name), data.source
    ranges = [f(values) if len(values) else math.nan for f in (np.min, np.median, np.max)]
    unit = CANONICAL[base_column(name)][0]
    header, file_unit = source.columns.get(name), source.units.get(name)
    return ColumnSummary(name, unit, header, file_unit, *map(float, ranges))


def _inspect_run(data: TireData, code: int) -> RunSummary:
    part = data.where(data.run == code)
    slips = {name: part.usable(name) for name in ("sigma_x", "alpha") if name in part and part.n}
    rate = None  # samples per second, from the median step in time
    if "time" in part and part.n > 1:
        step = float(np.median(np.diff(part.usable("time"))))
        rate = 1 / step if step > 0 else None
    return RunSummary(
        data.runs[code],
        part.n,
        loads=_levels(part, "fz"),
        speeds=_levels(part, "v"),
        slip={name: (float(slip.min()), float(slip.max())) for name, slip in slips.items()},
        sampling_rate=rate,
    )


def _levels(part: TireData, name: str) -> tuple[Level, ...]:
    """The levels of a column; its whole range if it was swept."""
    if name not in part or not part.n:
        return ()
    here = levels(part.usable(name))
    numbers = zip(*(values.tolist() for values in (*here[:3], np.bincount(here.code))), strict=True)
    return tuple(Level(*each) for each in numbers)


def _wrap(text: str, indent: str = "    ") -> list[str]:
    return textwrap.wrap(text, _WIDTH, initial_indent="  ", subsequent_indent=indent) or [""]


def _column_lines(columns: Iterable[ColumnSummary]) -> Iterator[str]:
    yield f"{'column':<16}{'unit':<7}{'min':>11}{'median':>11}{'max':>11}  read from"
    for c in columns:
        header = c.header if c.header is not None else "(declared or computed)"
        if c.file_unit and c.file_unit != c.unit:
            header += f", {c.file_unit}"
        start = f"{c.name:<16}{c.unit:<7}{c.min:>11.4g}{c.median:>11.4g}{c.max:>11.4g}  "
        yield start + textwrap.shorten(header, _WIDTH - len(start), placeholder=".")


def _run_lines(run: RunSummary) -> list[str]:
    slips = [f"{name} {low:.3g} to {high:.3g}" for name, (low, high) in run.slip.items()]
    rate = [f"{run.sampling_rate:.4g} Hz"] if run.sampling_rate else []
    lines = _wrap(f"{run.name}: {', '.join([f'{run.n} rows', *slips, *rate])}")
    for word, held, unit in (("loads", run.loads, "N"), ("speeds", run.speeds, "m/s")):
        texts = []
        for level in held:
            is_wide = level.max - level.min > 0.2 * abs(level.median)
            spread = f" from {level.min:.3g} to {level.max:.3g}" if is_wide else ""
            texts.append(f"{level.median:.4g} {unit} (n={level.n}){spread}")
        lines += _wrap(f"  {word}: {', '.join(texts)}") if texts else []
    return lines
