"""Exports of data loggers: AiM RaceStudio, MoTeC i2, and the .vbo files of Racelogic.

An export of AiM or MoTeC is a CSV with keys and values above the header, one row of units
below it, and blank lines between; :func:`exported_by` recognises it. A .vbo file has named
sections, of which :func:`vbo_table` makes a header, units and rows.
"""

import re
from collections.abc import Sequence
from typing import NamedTuple

from tirefit.results import DataError

_EXPORT = re.compile(r'"?Format"?\s*[,;\t]\s*"?(AiM|MoTeC) CSV File', re.IGNORECASE)
_NAMES = {"aim": "AiM RaceStudio", "motec": "MoTeC i2"}

_VBO = re.compile(r"(?mi)^\[column names\][ \t\r]*$")
_TITLE = re.compile(r"\[([\w ]+)\]\s*$")

_STANDARD = {
    "sats": "", "time": "s", "lat": "", "long": "", "velocity": "km/h", "heading": "deg",
    "height": "m", "vert-vel": "m/s", "vertvel": "m/s", "longacc": "g", "latacc": "g",
    "event1": "", "event-1": "", "tsample": "s", "sampleperiod": "s", "solution_type": "",
    "velocity_quality": "", "avifileindex": "", "avitime": "",
}  # fmt: skip
"""Standard column of a .vbo file -> its unit, for which [channel units] has no line. Time of
day is written as HHMMSS.SS, and read as seconds since midnight."""

_KNOTS = "velocity knots"  # title in [header] of a velocity in knots, else it is in km/h
_DAY = 86_400.0


class VboTable(NamedTuple):
    """Header, rows, their lines in the file (from 1), units of the columns, and notes."""

    rows: list[list[str]]
    numbers: list[int]
    units: list[str]
    notes: list[str]


def exported_by(line: str) -> str:
    """The program whose CSV export begins with this line; empty for another file."""
    found = _EXPORT.match(line)
    return _NAMES[found[1].casefold()] if found else ""


def is_vbo(text: str) -> bool:
    """Whether a text is, or begins as, a .vbo file."""
    return bool(_VBO.search(text)) and "[data]" in text.casefold()


def vbo_table(text: str, file: str) -> VboTable:
    """Content of a .vbo file, with the time in seconds since midnight of its first day.

    Raises:
        DataError: the file has no columns or no data.
    """
    sections = _sections(text.splitlines())
    names = [(k, line) for k, line in sections.get("column names", []) if line]
    data = [(k, line.split()) for k, line in sections.get("data", []) if line]
    if not (names and data):
        reason = "a .vbo file without columns or data"
        raise DataError(reason, "record it again, or export it as CSV", file)
    header = names[0][1].split()
    units, notes = _units(header, sections)
    if "time" in header:
        _to_seconds([cells for _, cells in data], header.index("time"))
        notes.append("time of day read as seconds since midnight")
    rows = [header, *(cells for _, cells in data)]
    return VboTable(rows, [names[0][0], *(k for k, _ in data)], units, notes)


def _sections(lines: Sequence[str]) -> dict[str, list[tuple[int, str]]]:
    """Title -> numbers and texts of its lines, blank ones too."""
    sections: dict[str, list[tuple[int, str]]] = {}
    title = ""
    for number, line in enumerate(map(str.strip, lines), 1):
        if found := _TITLE.fullmatch(line):
            title = found[1].casefold()
        else:
            sections.setdefault(title, []).append((number, line))
    return sections


def _units(header: Sequence[str], sections) -> tuple[list[str], list[str]]:
    """The unit of each column, and notes. Columns that are not standard have one line each
    in [channel units], which may be blank; a blank line ends the section."""
    titles = [line.casefold() for _, line in sections.get("header", [])]
    known = dict(_STANDARD, velocity="knot") if _KNOTS in titles else _STANDARD
    own = [name for name in header if name.casefold() not in known]
    lines = [line for _, line in sections.get("channel units", [])]
    stated = [line for line in lines if line]
    if len(stated) != len(own):
        stated = lines[:-1] if lines and not lines[-1] else lines
    notes = []
    if any(stated) and len(stated) != len(own):
        notes.append(f"[channel units] has {len(stated)} lines for {len(own)} columns: not used")
    units = dict(zip(own, stated, strict=True)) if len(stated) == len(own) else {}
    return [units.get(name, known.get(name.casefold(), "")) for name in header], notes


def _to_seconds(rows: Sequence[list[str]], column: int) -> None:
    """Rewrite times of day, HHMMSS.SS, as seconds since midnight of the first row's day."""
    days, last = 0, 0.0
    for cells in rows:
        if len(cells) <= column or not re.fullmatch(r"\d{6}(\.\d*)?", cells[column]):
            continue  # the check of numbers reports the cell
        clock = cells[column]
        second = 3600 * int(clock[:2]) + 60 * int(clock[2:4]) + float(clock[4:])
        days += second < last - _DAY / 2
        last = second
        cells[column] = f"{days * _DAY + second:.10g}"
