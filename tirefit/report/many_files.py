"""Results of several files on one page, and as a table for the terminal."""

import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tirefit import __version__
from tirefit.data.records import FAILED, FileRecord, dates_of
from tirefit.data.run_names import run_names
from tirefit.files import write_texts
from tirefit.fitting.result import FitResult
from tirefit.fitting.store import record_of_fit
from tirefit.fitting.verdict.across_files import AcrossFiles, across_files
from tirefit.report.canvas import images_of
from tirefit.report.fit.values import Points, points_panel
from tirefit.report.numbers import bracketed, format_estimate, format_number
from tirefit.report.page import Rows, Section, first_of, page, table_parts, verdict_of
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
        return self.name + bracketed(self.unit)


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


def _main(files: Files) -> list[Quantity]:
    """Parameters, effects, gaps and the misfit, from which the other quantities follow."""
    return [q for q in files.quantities if q.kind in _KINDS[:3] or q.name == "rmse"]


def _table_of_files(files: Files) -> Rows:
    """A row for each file, a column for each parameter, effect and gap."""
    shown = _main(files)
    rows = [["file", *(q.title for q in shown), "verdict"]]
    for k, (name, record) in enumerate(zip(files.names, files.records, strict=True)):
        cells = [format_estimate(q.value[k], q.std[k]) if q.known[k] else "-" for q in shown]
        rows.append([name, *cells, record.status])
    return rows


def _quantities(files: Files) -> Rows:
    head = "quantity", "unit", "files", "not determined", "middle", "scatter between files"
    rows = [[*head, "a file's own std", "change, first to last", "differ"]]
    for quantity in files.quantities:
        across, std, count = quantity.across, quantity.std[quantity.known], quantity.known.sum()
        middle = format_number(across.middle), format_number(across.scatter, 2)
        change = "too few files"
        if across.change_std > 0:
            change = format_estimate(across.change, across.change_std) + ": drifts" * across.drifts
        typical = format_number(float(np.median(std))) if std.any() else "-"
        counts = str(count), str(len(quantity.known) - count)
        more = typical, change, str(int(across.outlier.sum()))
        rows.append([quantity.name, quantity.unit, *counts, *middle, *more])
    return rows


def _different(files: Files) -> Rows:
    """The files that differ most in any quantity."""
    outliers = []
    for q in files.quantities:
        places, pulls = np.flatnonzero(q.known)[q.across.outlier], q.across.pulls[q.across.outlier]
        outliers += [(pull, q, k) for pull, k in zip(pulls, places, strict=True)]
    outliers.sort(key=lambda item: -abs(item[0]))
    rows = [("file", "quantity", "value ± std", "unit", "distance in std")]
    for pull, q, k in outliers[:_LISTED]:
        text = format_estimate(q.value[k], q.std[k])
        rows.append((files.records[k].file, q.name, text, q.unit, f"{pull:+.1f}"))
    return rows


def points_of(files: Files, quantity: Quantity) -> Points:
    """A quantity over the dates or the names of the files, with its line over time."""
    known, across, value = quantity.known, quantity.across, quantity.value
    when = np.arange(float(len(known)))
    if files.dates is not None:
        when = files.dates.astype(float) / 86400  # days, as Matplotlib counts them
    at = when[known]
    line = across.middle + across.change * (when - at.mean()) / (np.ptp(at) or 1.0)
    outlier = np.zeros(len(known), bool)
    outlier[known] = across.outlier
    names, bars = () if files.dates is not None else files.names, quantity.std
    ends, line_of = (value - bars, value + bars), (line, across.scatter)
    return Points(quantity.title, names, when, value, *ends, known, outlier, line_of)


def _verdict(files: Files) -> dict[str, Any]:
    """How many files have each status, and the problems of single ones."""
    status = [record.status for record in files.records]
    counts = [f"{count} {name}" for name, count in Counter(status).most_common(_LISTED)]
    lines = [f"{x.file}: {x.status}: {x.problem}" for x in files.records if x.problem]
    sentence = f"Verdict: of {len(status)} files: {', '.join(counts)}"
    return verdict_of(sentence, first_of(lines, _LISTED), set(status) == {Outcome.OK})


def _settings(files: Files) -> Iterator[str]:
    names = {"model": "model", "convention": "convention of the files", "seed": "seed"}
    for column, label in (names | {"version": "version"}).items():
        given = (getattr(record, column) for record in files.records)
        count = Counter(str(value) for value in given if value not in ("", None)).most_common()
        texts = [name + f" ({times} files)" * (len(count) > 1) for name, times in count[:4]]
        yield f"{label}: {', '.join(texts)}" + f" and {len(count) - 4} others" * (len(count) > 4)
    dated = "the dates in the files' names"
    without = "the order of the files: their names do not all have a date"
    yield f"time: {without if files.dates is None else dated}; page by {__version__}"


def files_page(files: Files, title: str) -> str:
    """Results of several files as one HTML document, without script or external resource."""
    none = ["no quantity of three files or more"] * (not files.quantities)
    first = f"the first {_LISTED}" * (len(files.names) > _LISTED)
    note = "± standard deviation; grey: scatter of files {}"
    pictures = images_of(
        points_panel(
            points_of(files, quantity),
            f"{quantity.name} over the files",
            note.format(format_number(quantity.across.scatter, 2)),
        )
        for quantity in _main(files)[:_PICTURES]
    )
    sections = [
        Section("Files", (), _table_of_files(files)[: _LISTED + 1], note=first),
        Section("Quantities over the files", none, _quantities(files), pictures),
        Section("Files that differ", (), _different(files), note=_DISTANCE),
        Section("Data and settings", list(_settings(files))),
    ]
    subtitle = "; ".join(filter(None, [files.pattern, "braking positive, SI"]))
    return page(title, sections, _verdict(files), subtitle)


def write_fleet_page(records: Sequence[FileRecord], path: Path, command: str) -> None:
    """Write the page of all results of a command."""
    files = files_of(records)
    title = f"tirefit {command}: {len(files.names)} files"
    write_texts({path: files_page(files, title)})


def write_fits_page(fits: Mapping[str, FitResult], path: str | os.PathLike[str]) -> None:
    """Write the page of several fits, completely or not at all.

    Args:
        fits: file (or any other name) -> its fit, in the order of the page.
        path: of the page, such as ``fits.html``.

    Raises:
        UsageError: there is no fit.
        OSError: the file cannot be written.

    Example:
        >>> names = ("circles", "free_driving")
        >>> fits = {name: fit(samples / f"{name}.csv") for name in names}
        >>> write_fits_page(fits, folder / "fits.html")
    """
    if not fits:
        raise UsageError("no fit for the page", "give fits by name: {'dry': fit, ...}")
    records = [
        replace(record_of_fit(result.to_dict(), name), file=name) for name, result in fits.items()
    ]
    models = ", ".join(dict.fromkeys(result.model for result in fits.values()))
    title = f"{models} fitted to {len(fits)} files"
    write_texts({path: files_page(files_of(records), title)})
