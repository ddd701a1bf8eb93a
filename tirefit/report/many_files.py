"""Results of several files on one page, and as a table for the terminal."""

import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tirefit import __version__
from tirefit.data.merged import merged
from tirefit.data.records import FAILED, FileRecord, dates_of
from tirefit.data.run_names import run_names
from tirefit.files import write_texts
from tirefit.fitting.result import FitResult
from tirefit.fitting.store import record_of_fit
from tirefit.fitting.uncertainty.derived import quantity_of
from tirefit.fitting.verdict.across_files import AcrossFiles, across_files
from tirefit.report.canvas import images_of
from tirefit.report.fit.values import Points, points_panel
from tirefit.report.numbers import format_estimate, format_number
from tirefit.report.page import Rows, Section, page, table_parts, verdict_of
from tirefit.results import Outcome, UsageError

_KINDS = ("parameter", "effect", "gap", "derived", "statistic")
"""Kinds of quantities in the order of the page, without given values (``base``)."""
_OWN_STD = ("parameter", "effect", "derived")
"""Kinds whose numbers have a standard deviation; without one a number counts as unknown."""
_PICTURES, _LISTED = 12, 40
"""Largest numbers of drawn quantities and of listed files."""
_DISTANCE = f"""\
distance from the line over time, in units of the file's own standard deviation and the scatter \
between files together. The line is robust (Huber), and the scatter is that of the middle half of \
the files. Among files that do not differ, one would be listed for one quantity in a hundred; a \
drift is reported at the same odds. The {_LISTED} farthest are listed"""


class Quantity(NamedTuple):
    """A quantity of n files, NaN where a file does not have it."""

    kind: str
    name: str
    unit: str
    value: np.ndarray  # (n,)
    std: np.ndarray  # (n,), zero without a standard deviation of its own
    known: np.ndarray  # (n,) whether the data of the file determine it
    across: AcrossFiles  # of the known ones

    @property
    def title(self) -> str:
        return f"{self.name} [{self.unit}]" if self.unit not in ("", "-") else self.name

    @property
    def whole(self) -> bool:
        """Whether it counts something, such as rows."""
        values = self.value[self.known]
        return self.kind == "statistic" and np.array_equal(values, np.round(values))


class Files(NamedTuple):
    """All files, their short names and their quantities."""

    records: Sequence[FileRecord]
    names: Sequence[str]
    pattern: str  # of the names that were shortened
    dates: np.ndarray | None  # (n,) from their names; None: use the order of files
    quantities: list[Quantity]


def files_of(records: Sequence[FileRecord]) -> Files:
    """Files with the quantities that enough of them have."""
    count, files = len(records), [record.file for record in records]
    given: dict[tuple[str, str, str], np.ndarray] = {}
    for number, record in enumerate(records):
        for row in record.rows:
            key = row.kind, row.name, row.unit
            if key not in given:
                given[key] = np.full((2, count), np.nan)
            given[key][:, number] = [np.nan if x is None else x for x in (row.value, row.std)]
    quantities = []
    dates = dates_of(files)
    when = np.arange(count) + 1.0 if dates is None else dates.astype(float) / 86400
    for (kind, name, unit), (value, std) in given.items():
        if kind not in _OWN_STD:
            std = np.zeros(count)
        known = np.isfinite(value + std)
        # Smallest number of files for a quantity to be shown.
        if kind in _KINDS and known.sum() >= min(3, count):
            across = across_files(value[known], std[known], when[known])
            quantities.append(Quantity(kind, name, unit, value, std, known, across))
    quantities.sort(key=lambda quantity: _KINDS.index(quantity.kind))
    done = [record.file for record in records if record.status != FAILED]
    short = run_names(done)
    shorter = dict(zip(done, short.short, strict=True))
    shown = [shorter.get(name, name) for name in files]
    return Files(records, shown, short.pattern, dates, quantities)


def summary_table(fits: Sequence[FileRecord]) -> str:
    """Directory, parameters with standard deviations, RMSE and verdict of every fit."""
    if not fits:
        return "no file could be fitted"
    directories = run_names([fit.result for fit in fits])
    files = files_of(fits)._replace(names=directories.short)
    of = f" of {directories.pattern}" if directories.pattern else ""
    return "\n".join(["", f"SUMMARY{of}", *table_parts(_table_of_files(files))])


def _cell(value: float | None, std: float | None) -> str:
    """A value with its standard deviation; ``-`` if the data do not determine it."""
    return "-" if value is None or np.isnan(value) else format_estimate(value, std or None)


def _main(files: Files) -> list[Quantity]:
    """Parameters, effects, gaps and the misfit, from which the other quantities follow."""
    return [q for q in files.quantities if q.kind in _KINDS[:3] or q.name == "rmse"]


def _table_of_files(files: Files) -> Rows:
    """A row for each file, a column for each parameter, effect and gap."""
    shown = _main(files)
    rows = [["file", *(q.title for q in shown), "verdict"]]
    for k, (name, record) in enumerate(zip(files.names, files.records, strict=True)):
        cells = [_cell(q.value[k], q.std[k]) if q.known[k] else "-" for q in shown]
        rows.append([name, *cells, record.status])
    return rows


def _quantities(files: Files) -> Rows:
    head = ("quantity", "unit", "files", "not determined", "middle", "scatter between files",
            "a file's own std", "change, first to last", "differ")  # fmt: skip
    rows: list[Sequence[str]] = [head]
    for quantity in files.quantities:
        across, std = quantity.across, quantity.std[quantity.known]
        change = "too few files"
        if across.change_std > 0:
            change = format_estimate(across.change, across.change_std)
            change += ": drifts" * across.drifts
        rows.append(
            (
                quantity.name,
                quantity.unit,
                str(quantity.known.sum()),
                str(len(quantity.known) - quantity.known.sum()),
                format_number(across.middle),
                format_number(across.scatter, 2),
                format_number(float(np.median(std))) if std.any() else "-",
                change,
                str(int(across.outlier.sum())),
            )
        )
    return rows


def _different(files: Files) -> Rows:
    """The files that differ most in any quantity."""
    outliers: list[tuple[float, Quantity, int]] = [
        (float(pull), quantity, int(k))
        for quantity in files.quantities
        for k, pull, is_far in zip(
            np.flatnonzero(quantity.known),
            quantity.across.pulls,
            quantity.across.outlier,
            strict=True,
        )
        if is_far
    ]
    outliers.sort(key=lambda item: -abs(item[0]))
    rows = [("file", "quantity", "value ± std", "unit", "distance in std")]
    for pull, quantity, k in outliers[:_LISTED]:
        text = _cell(quantity.value[k], quantity.std[k])
        rows.append((files.records[k].file, quantity.name, text, quantity.unit, f"{pull:+.1f}"))
    return rows


def points_of(files: Files, quantity: Quantity) -> Points:
    """A quantity over the dates or the names of the files, with its line over time."""
    count, known, across = len(quantity.known), quantity.known, quantity.across
    when = np.arange(float(count))
    if files.dates is not None:
        when = files.dates.astype(float) / 86400  # days, as Matplotlib counts them
    at = when[known]
    share = (at - at.mean()) / (np.ptp(at) or 1.0)
    outlier = np.zeros(count, bool)
    outlier[known] = across.outlier
    line = at, across.middle + across.change * share, across.scatter
    return Points(
        quantity.title,
        () if files.dates is not None else files.names,
        when,
        quantity.value,
        quantity.value - quantity.std,
        quantity.value + quantity.std,
        known,
        outlier,
        line,
        quantity.whole,
    )


def _pictures(files: Files) -> list[dict[str, Any]]:
    note = "± standard deviation; grey: scatter of files {}"
    return images_of(
        points_panel(
            points_of(files, quantity),
            f"{quantity.name} over the files",
            note.format(format_number(quantity.across.scatter, 2)),
        )
        for quantity in _main(files)[:_PICTURES]
    )


def _verdict(files: Files) -> dict[str, Any]:
    """How many files have each status, and the problems of single ones."""
    status = [record.status for record in files.records]
    counts = [f"{count} {name}" for name, count in Counter(status).most_common(_LISTED)]
    lines = [
        f"{record.file}: {record.status}: {record.problem}"
        for record in files.records
        if record.problem
    ]
    more = [f"and {len(lines) - _LISTED} more"] * (len(lines) > _LISTED)
    sentence = f"Verdict: of {len(status)} files: {', '.join(counts)}"
    return verdict_of(sentence, [*lines[:_LISTED], *more], set(status) == {Outcome.OK})


def _settings(files: Files, notes: Sequence[str]) -> Iterator[str]:
    def each(column: str) -> str:
        given = (getattr(record, column) for record in files.records)
        values = [str(value) for value in given if value not in ("", None)]
        count = Counter(values).most_common(4)
        more = len(set(values)) - len(count)
        texts = [f"{name} ({times} files)" if len(count) > 1 else name for name, times in count]
        return ", ".join(texts) + f" and {more} others" * bool(more)

    yield f"model: {each('model')}"
    yield f"convention of the files: {each('convention')}"
    yield f"seed: {each('seed')}"
    yield f"version: {each('version')}, page by {__version__}"
    if files.dates is None:
        yield "time: the order of the files: their names do not all have a date"
    else:
        yield "time: the dates in the files' names"
    yield from notes


def files_page(files: Files, title: str, notes: Sequence[str] = ()) -> str:
    """Results of several files as one HTML document, without script or external resource.

    Args:
        notes: assumptions on the files.
    """
    none = ["no quantity of three files or more"] * (not files.quantities)
    first = f"the first {_LISTED}" * (len(files.names) > _LISTED)
    sections = [
        Section("Files", (), _table_of_files(files)[: _LISTED + 1], note=first),
        Section("Quantities over the files", none, _quantities(files), _pictures(files)),
        Section("Files that differ", (), _different(files), note=_DISTANCE),
        Section("Data and settings", list(_settings(files, notes))),
    ]  # fmt: skip
    subtitle = "; ".join(filter(None, [files.pattern, "braking positive, SI"]))
    return page(title, sections, _verdict(files), subtitle)


def write_fleet_page(records: Sequence[FileRecord], path: Path, command: str) -> None:
    """Write the page of all results of a command."""
    files = files_of(records)
    title = f"tirefit {command}: {len(files.names)} files"
    write_texts({path: files_page(files, title)})


def fits_page(fits: Mapping[str, FitResult], failed: Mapping[str, str] | None = None) -> str:
    """Several fits as one HTML document; arguments as :func:`write_fits_page`."""
    if not fits:
        raise UsageError("no fit for the page", "give fits by name: {'dry': fit, ...}")
    records = []
    for name, result in fits.items():
        problem = result.warnings[0] if result.outcomes else ""
        record = record_of_fit(result.to_dict(), name)
        # Parameters per run are on the page of each fit.
        rows = tuple(row for row in record.rows if row.name == quantity_of(row.name))
        records.append(replace(record, file=name, problem=problem, rows=rows))
    records += [
        FileRecord(name, "", "", FAILED, problem=text) for name, text in (failed or {}).items()
    ]
    files = files_of(records)
    notes = merged((name, result.data["assumptions"]) for name, result in fits.items())
    models = ", ".join(dict.fromkeys(result.model for result in fits.values()))
    return files_page(files, f"{models} fitted to {len(fits)} files", notes)


def write_fits_page(
    fits: Mapping[str, FitResult],
    path: str | os.PathLike[str],
    failed: Mapping[str, str] | None = None,
) -> None:
    """Write the page of several fits, completely or not at all.

    Args:
        fits: file (or any other name) -> its fit, in the order of the page.
        path: of the page, such as ``fits.html``.
        failed: file -> reason why it could not be fitted.

    Raises:
        UsageError: there is no fit.
        OSError: the file cannot be written.

    Example:
        >>> names = ("circles", "free_driving")
        >>> fits = {name: fit(samples / f"{name}.csv") for name in names}
        >>> write_fits_page(fits, folder / "fits.html")
    """
    write_texts({path: fits_page(fits, failed)})
