"""Summarise a data set and the fits that it supports: :func:`inspect`."""

import dataclasses
import math
import textwrap
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from tirefit.data.accept import DataLike, as_data
from tirefit.data.far import FarValue, far_values, problem_at, why_far
from tirefit.data.rig.levels import levels
from tirefit.data.table import CANONICAL, TireData
from tirefit.data.units import base_column
from tirefit.files import json_safe
from tirefit.slip import CONVENTIONS, slip_ratio_from_sigma

_WIDTH = 80
_COMBINED = 10  # smallest number of rows for combined slip to be intended
_FAR_ROWS = 8  # far rows that the text names one by one
_VARIES = 0.2  # smallest relative range of load or speed that shows a dependence despite noise


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
    """One run: its used rows, levels, slips and sampling."""

    name: str
    n: int
    loads: tuple[Level, ...]
    speeds: tuple[Level, ...]
    slip: dict[str, tuple[float, float]]  # sigma_x and alpha -> (min, max)
    directions: tuple[str, ...]
    sampling_rate: float | None


@dataclass(frozen=True)
class Support:
    """Whether the data support a kind of fit, and the reason."""

    fit: str
    possible: bool
    reason: str


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
    supports: tuple[Support, ...]
    combined_rows: int  # with fx, fy and both slips beyond 0.01
    warnings: tuple[str, ...]
    assumptions: tuple[str, ...]
    masked: tuple[str, ...]
    far_rows: tuple[str, ...] = ()  # outliers

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
        if self.combined_rows >= _COMBINED:
            both = "combined slip: fx, fy with sigma_x and alpha varying together"
            lines += _wrap(f"{both} in {self.combined_rows} rows")
        lines += ["", "fits these data support"]
        for support in self.supports:
            answer = "yes" if support.possible else "no "
            lines += _wrap(f"{answer} {support.fit}: {support.reason}", "      ")
        outliers = [*self.far_rows[:_FAR_ROWS]]
        if more := len(self.far_rows) - len(outliers):
            outliers.append(f"and {more} more: --json lists them")
        for title, messages in (
            ("warnings", self.warnings),
            ("what was assumed", self.assumptions),
            ("outliers (a fit decides itself which of them to exclude)", outliers),
            ("masked rows", self.masked),
        ):
            if messages:
                lines += ["", title, *(line for text in messages for line in _wrap(text))]
        return "\n".join(lines)


def inspect(data: DataLike) -> Inspection:
    """Summarise data: ranges, runs, loads, speeds, and which fits they support.

    Args:
        data: a result of ``tirefit.read``, or a path, a frame, a mapping of arrays.

    Returns:
        The summary; ``print(found.summary())`` shows it.

    Raises:
        DataError: as :func:`tirefit.read`.

    Example:
        >>> found = inspect(samples / "circles.csv")
        >>> [one.fit for one in found.supports if one.possible]
        ['fy from alpha', 'speed-dependent friction']
    """
    data = as_data(data)
    source = data.source
    combined = 0
    if {"sigma_x", "alpha", "fx", "fy"} <= data.columns.keys():
        slips = (abs(data.usable(name)) > 0.01 for name in ("sigma_x", "alpha"))
        combined = int(np.count_nonzero(np.logical_and(*slips)))
    return Inspection(
        file=data.file,
        sha256=source.sha256,
        rows=len(data),
        used=data.n,
        convention=source.convention,
        slip_definition=source.slip_definition,
        columns=tuple(_summarise(data, name) for name in data.columns),
        runs=tuple(_inspect_run(data, code) for code in range(len(data.runs))),
        supports=tuple(_supports(data)),
        combined_rows=combined,
        warnings=source.warnings,
        assumptions=source.assumptions,
        masked=tuple(
            str(dataclasses.replace(problem, remedy="", file="")) for problem in source.masked
        ),
        far_rows=tuple(_far_row(data, value) for value in far_values(data)),
    )


def _far_row(data: TireData, value: FarValue) -> str:
    remedy = "correct or delete the row"
    place = problem_at(data, value.row, value.column, why_far(value), remedy)
    # The report names the file, unless several were joined.
    place = place if data.source.paths else dataclasses.replace(place, file="")
    return str(place).replace("\n    ", "; ")


def _summarise(data: TireData, name: str) -> ColumnSummary:
    values, source = data.usable(name), data.source
    ranges = [f(values) if len(values) else math.nan for f in (np.min, np.median, np.max)]
    unit = CANONICAL[base_column(name)][0]
    header, file_unit = source.columns.get(name), source.units.get(name)
    return ColumnSummary(name, unit, header, file_unit, *map(float, ranges))


def _inspect_run(data: TireData, code: int) -> RunSummary:
    part = data.where(data.run == code)
    slips = {name: part.usable(name) for name in ("sigma_x", "alpha") if name in part and part.n}
    ranges = {name: (float(slip.min()), float(slip.max())) for name, slip in slips.items()}
    rate = None  # samples per second, from the median step in time
    if "time" in part and part.n > 1:
        step = float(np.median(np.diff(part.usable("time"))))
        rate = 1 / step if step > 0 else None
    return RunSummary(
        data.runs[code],
        part.n,
        loads=_levels(part, "fz"),
        speeds=_levels(part, "v"),
        slip=ranges,
        directions=tuple(_direction(name, *ends) for name, ends in ranges.items()),
        sampling_rate=rate,
    )


def _levels(part: TireData, name: str) -> tuple[Level, ...]:
    """The levels of a column; its whole range if it was swept."""
    if name not in part or not part.n:
        return ()
    here = levels(part.usable(name))
    numbers = zip(*(values.tolist() for values in (*here[:3], np.bincount(here.code))), strict=True)
    return tuple(Level(*each) for each in numbers)


def _direction(name: str, low: float, high: float) -> str:
    positive, negative = "+", "-"
    if name == "sigma_x":  # bounded, so that a locked wheel does not dwarf driving
        positive, negative = "braking", "driving"
        low, high = slip_ratio_from_sigma(low), slip_ratio_from_sigma(high)
    least = 0.01 * max(abs(low), abs(high))
    if low < -least and high > least:
        return f"{name} both signs"
    if low >= -least and high <= least:
        return f"{name} zero"
    return f"{name} {positive if low >= -least else negative} only"


def _supports(data: TireData) -> Iterator[Support]:
    for force, slip in (("fx", "sigma_x"), ("fy", "alpha"), ("mz", "alpha")):
        lacking = [name for name in (force, slip) if name not in data]
        reason = f"no {' and no '.join(lacking)}"
        if not lacking:
            values = data.usable(slip)
            varies = data.n > 0 and bool(np.ptp(values) >= 1e-9)
            distinct = len(np.unique(np.round(values, 9)))
            reason = f"{data.n} rows, {distinct} different values of {slip}"
            reason = reason if varies else f"{slip} is constant"
        yield Support(f"{force} from {slip}", not lacking and varies, reason)
    yield _spread_support(data, "v", "speed-dependent friction")
    yield _spread_support(data, "fz", "load dependence", "brush-load")
    for fit, names in (
        ("errors in slip", ["sigma_x_std", "alpha_std"]),
        ("a noise level that is known", ["fx_std", "fy_std", "mz_std"]),
    ):
        have = [name for name in names if name in data]
        reason = f"{', '.join(have)} is there" if have else f"no {' or '.join(names)}"
        yield Support(fit, bool(have), reason)


def _spread_support(data: TireData, name: str, fit: str, model: str = "") -> Support:
    if name not in data or not data.n:
        return Support(fit, False, "no usable rows" if name in data else f"no {name}")
    low, middle, high = np.percentile(data.usable(name), [2.5, 50, 97.5])
    spread = (high - low) / abs(middle) if middle else 0.0
    reason = f"{name} from {low:.4g} to {high:.4g} {CANONICAL[name][0]}"
    if spread <= _VARIES:
        reason += f": less than {_VARIES:.0%} apart"
    elif model:
        reason += f"; {model} follows it"
    return Support(fit, bool(spread > _VARIES), reason)


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
    rate = [f"{run.sampling_rate:.4g} Hz"] if run.sampling_rate else []
    lines = _wrap(f"{run.name}: {', '.join([f'{run.n} rows', *run.directions, *rate])}")
    for word, held, unit in (("loads", run.loads, "N"), ("speeds", run.speeds, "m/s")):
        texts = []
        for level in held:
            scale, prefix = (1e-3, "k") if unit == "N" and level.median >= 1000 else (1.0, "")
            middle = level.median * scale
            text = f"{middle:#.2g}" if middle < 10 else f"{middle:.3g}"
            text = f"{text} {prefix}{unit} (n={level.n})"
            if level.max - level.min > _VARIES * abs(level.median):
                text += f" from {level.min * scale:.3g} to {level.max * scale:.3g}"
            texts.append(text)
        lines += _wrap(f"  {word}: {', '.join(texts)}") if texts else []
    return lines
