"""Results of many files as one small self-contained page."""

from collections import Counter
from pathlib import Path

import numpy as np

from tirefit import __version__
from tirefit.data.records import FAILED
from tirefit.files import write_text_atomic
from tirefit.report.fleet import Fleet, Quantity, fleet_of, quantity_figure
from tirefit.report.html import Section, image_of, page
from tirefit.report.numbers import format_estimate, format_number

_PICTURES, _LISTED = 12, 40
"""Largest numbers of drawn quantities and of listed files."""
_DISTANCE = f"""\
distance from the line over time, in units of the file's own standard deviation and the scatter \
between files together. The line is robust (Huber), and the scatter is that of the middle half of \
the files. Among files that do not differ, one would be listed for one quantity in a hundred; a \
drift is reported at the same odds. The {_LISTED} farthest are listed, the others are in the table \
of results"""


def write_fleet_page(table: Path, path: Path, command: str) -> None:
    """The page of a table of all results that ``command`` wrote."""
    write_text_atomic(path, fleet_page(fleet_of(table), command))


def fleet_page(fleet: Fleet, command: str) -> str:
    """Status, quantities over the files, files that differ, files without a result."""
    status = Counter(fleet.files["status"])
    pictures = [
        image_of(quantity_figure(one, fleet.dates is not None), f"{one.name} over the files")
        for one in fleet.quantities[:_PICTURES]
    ]
    left = [one.name for one in fleet.quantities[_PICTURES:]]
    quantities, outliers, failed = _quantities(fleet), _outliers(fleet), _failed(fleet)
    none = "no quantity of three files or more"
    sections = [
        Section("", [f"{count} {name}" for name, count in status.most_common(_LISTED)]),
        Section("Quantities", [none] * (len(quantities) == 1), quantities, pictures),
        Section("", [f"not drawn: {', '.join(left)}"] if left else ()),
        Section("Files that differ", ["none"] * (len(outliers) == 1), outliers, note=_DISTANCE),
        Section("Files without a result", ["none"] * (len(failed) == 1), failed),
        Section("Settings", _settings(fleet, command)),
    ]
    return page(f"tirefit {command}: {len(fleet.files['file'])} files", sections)


def _different(fleet: Fleet, column: str) -> str:
    values = [str(v) for v in fleet.files[column] if v not in ("", None)]
    count = Counter(values).most_common(4)
    more = len(set(values)) - len(count)
    text = ", ".join(f"{name} ({times} files)" if len(count) > 1 else name for name, times in count)
    return f"{text} and {more} others" if more else text


def _settings(fleet: Fleet, command: str) -> list[str]:
    time = "the dates in the files' names"
    if fleet.dates is None:
        time = "the order of the files: their names do not all have a date"
    return [
        f"model: {_different(fleet, 'model')}",
        f"convention: braking positive, SI units; of the files: {_different(fleet, 'convention')}",
        f"seed: {_different(fleet, 'seed')}",
        f"version: {_different(fleet, 'version')}, page by {__version__}",
        f"time: {time}",
    ]


def _quantities(fleet: Fleet) -> list[tuple[str, ...]]:
    head = ("quantity", "unit", "files", "not determined", "middle", "scatter between files",
            "a file's own std", "change, first to last", "differ")  # fmt: skip
    rows: list[tuple[str, ...]] = [head]
    for one in fleet.quantities:
        across = one.across
        change = "too few files"
        if across.change_std > 0:
            change = format_estimate(across.change, across.change_std)
            change += ": drifts" if across.drifts else ""
        own = format_number(float(np.median(one.std))) if one.std.any() else "-"
        rows.append(
            (
                one.name,
                one.unit,
                str(len(one.value)),
                str(one.untold),
                format_number(across.middle),
                format_number(across.scatter, 2),
                own,
                change,
                str(int(across.outlier.sum())),
            )
        )
    return rows


def _outliers(fleet: Fleet) -> list[tuple[str, ...]]:
    """The files that differ most in any quantity."""
    far: list[tuple[float, Quantity, int]] = [
        (abs(float(one.across.pulls[k])), one, int(k))
        for one in fleet.quantities
        for k in np.flatnonzero(one.across.outlier)
    ]
    far.sort(key=lambda item: -item[0])
    rows: list[tuple[str, ...]]
    rows = [("file", "quantity", "value ± std", "unit", "distance in std")]
    for _, one, k in far[:_LISTED]:
        std = float(one.std[k])
        value = float(one.value[k])
        text = format_estimate(value, std) if std else format_number(value)
        pull = f"{one.across.pulls[k]:+.1f}"
        file = fleet.files["file"][int(one.number[k]) - 1]
        rows.append((file, one.name, text, one.unit, pull))
    return rows


def _failed(fleet: Fleet) -> list[tuple[str, ...]]:
    files = fleet.files
    lines = zip(files["file"], files["status"], files["problem"], strict=True)
    bad = [(file, problem) for file, status, problem in lines if status == FAILED]
    rows: list[tuple[str, ...]] = [("file", "problem"), *bad[:_LISTED]]
    return [*rows, (f"and {len(bad) - _LISTED} more", "")] if bad[_LISTED:] else rows
