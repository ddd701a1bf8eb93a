"""Exports of data loggers: AiM RaceStudio, MoTeC i2, and the .vbo files of Racelogic.

An export of AiM or MoTeC is a CSV with keys and values above the header, one row of units
below it, and blank lines between; :func:`exported_by` recognises it. A .vbo file has named
sections, of which :func:`vbo_table` makes a header, units and rows.
"""

import re
from collections.abc import Mapping, Sequence

import numpy as np

from tirefit.results import DataError

_EXPORT = re.compile(r'"?Format"?\s*([,;\t])\s*"?(AiM|MoTeC) CSV File', re.IGNORECASE)

VBO = re.compile(rb"\[\0?d\0?a\0?t\0?a\0?\]", re.IGNORECASE)
"""In the bytes of every .vbo file, in UTF-16 as well."""
_SECTION = re.compile(r"(?i)(?:^|[\r\n])[ \t]*\[(header|column names|data)\][ \t]*(?=[\r\n]|$)")
_TITLE = re.compile(r"\[([\w ]+)\]\s*$")

ARC = "minutes of arc"  # unit of latitude and longitude
_GPS = {
    "sats": "", "time": "s", "lat": ARC, "long": ARC,
    "velocity": "km/h", "heading": "deg", "height": "m", "vertvel": "m/s",
}  # fmt: skip
"""Column of a .vbo file, without separators -> its unit, for which [channel units] has no
line. Time of day is written as HHMMSS.SS, and read as seconds since midnight."""
_MORE = {
    "longacc": "g", "latacc": "g", "event1": "", "tsample": "s", "sampleperiod": "s",
    "solutiontype": "", "velocityquality": "", "avifileindex": "", "avitime": "",
}  # fmt: skip
"""The same for columns for which some programs write a line in [channel units]."""
NO_UNIT = "not stated"
"""Unit of a column whose line in [channel units] is not known: no reader accepts it."""


def exported_by(line: str) -> tuple[str, str]:
    """The program whose CSV export begins with this line, and its delimiter; else empty."""
    export = _EXPORT.match(line)
    return (export[2], export[1]) if export else ("", "")


def is_vbo(text: str) -> bool:
    """Whether a text is a .vbo file, perhaps one that has lost its column names."""
    titles = {title.casefold() for title in _SECTION.findall(text)}
    return "data" in titles and len(titles) > 1


def vbo_table(
    text: str, file: str
) -> tuple[list[tuple[int, list[str]]], list[str], list[str], tuple[str, ...]]:
    """Line (from 1) and cells of the header and the rows of a .vbo file, units, notes, warnings;
    the time in seconds since midnight of its first day.

    Raises:
        DataError: the file has no columns or no data.
    """
    sections = _sections(re.split(r"\r\n?|\n", text))
    names = [(k, line) for k, line in sections.get("column names", []) if line]
    data = [(k, line.split()) for k, line in sections.get("data", []) if line]
    if not (names and data):
        reason = "a .vbo file without columns or data: [column names] or [data] is empty or missing"
        raise DataError(reason, "record it again, or export it as CSV", file)
    header = names[0][1].split()
    units, doubts = _units(header, sections)
    notes = []
    for k, name in enumerate(header):
        if _plain(name) == "time":
            _to_seconds([cells for _, cells in data], k)
            notes.append("time of day read as seconds since midnight")
        elif _plain(name) == "heading":
            header[k] = "course"
            notes.append(
                f"{name!r} is named 'course' and not read as a yaw: it is the way of travel"
            )
    return [(names[0][0], header), *data], units, notes, doubts


def _sections(lines: Sequence[str]) -> dict[str, list[tuple[int, str]]]:
    """Title -> numbers and texts of its lines, blank ones too."""
    sections: dict[str, list[tuple[int, str]]] = {}
    title = ""
    for number, line in enumerate(map(str.strip, lines), 1):
        if heading := _TITLE.fullmatch(line):
            title = heading[1].casefold()
        else:
            sections.setdefault(title, []).append((number, line))
    return sections


def _units(
    header: Sequence[str], sections: Mapping[str, Sequence[tuple[int, str]]]
) -> tuple[list[str], tuple[str, ...]]:
    """The unit of each column, and warnings.

    [channel units] has a line for each column beyond those of the GPS, or for each that is not
    standard at all. If its lines fit neither, they are not used.
    """
    titles = [line.casefold() for _, line in sections.get("header", [])]
    gps = dict(_GPS, velocity="knot") if "velocity knots" in titles else _GPS
    units = [(gps | _MORE).get(_plain(name), "") for name in header]
    lines = [line for _, line in sections.get("channel units", [])]
    lines = lines[:-1] if lines and not lines[-1] else lines  # a blank line ends the section
    beyond_gps, others = (
        [k for k, name in enumerate(header) if _plain(name) not in known]
        for known in (gps, gps | _MORE)
    )
    for owners in (beyond_gps, others):
        if owners and len(lines) == len(owners) and any(lines):
            for k, line in zip(owners, lines, strict=True):
                units[k] = line or units[k]
            return units, ()
    unknown = beyond_gps if any(lines) else others
    for k in unknown:
        units[k] = NO_UNIT
    listed = ", ".join(repr(header[k]) for k in unknown)
    warning = f"[channel units] has {sum(map(bool, lines))} lines for {len(unknown)} columns:"
    warning += f" not used; the units of {listed} are not known"
    return units, (warning,) if unknown else ()


def _plain(name: str) -> str:
    return re.sub(r"[-_ ]", "", name.casefold())


def _to_seconds(rows: Sequence[list[str]], column: int) -> None:
    """Rewrite times of day, HHMMSS.SS, as seconds since midnight of the first row's day.

    Another text becomes no number, so that the check of numbers reports row and column. A step
    by more than half a day is one over midnight; an error of a single row leaves the others.
    """
    known = []
    for cells in (cells for cells in rows if len(cells) > column):
        clock = re.fullmatch(r"(\d\d)(\d\d)(\d\d(?:\.\d*)?)", cells[column])
        hour, minute, second = map(float, clock.groups()) if clock else (24.0, 0.0, 0.0)
        if hour < 24 and minute < 60 and second < 61:
            known.append((cells, 3600 * hour + 60 * minute + second))
        else:
            cells[column] += " (no time of day)"
    seconds = np.unwrap([second for _, second in known], period=86_400.0)
    for (cells, _), second in zip(known, seconds, strict=True):
        cells[column] = f"{second:.10g}"
