"""Read TYDEX 1.x files of measurements as tables.

Source: H.-J. Unrau, J. Zamow, TYDEX-Format, Description and Reference Manual, Release
1.3, 1997: keywords begin with ``**``, comments with ``!``; a line of **CONSTANTS and of
**MEASURCHANNELS has a name (columns 1-10), a comment (11-40) and a unit (41-50), then
a constant's value, or a channel's conversion factor, measurement offset and physical
offset (10 columns each); **MEASURDATA holds 10 columns for each value, lines of 80.

Longitudinal slip, forces and moments are those of the axes W and H (ISO 8855).
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tirefit.data.check import BadRows
from tirefit.data.columns import is_number
from tirefit.data.readers.remote import Place
from tirefit.data.readers.text import Table, stem_of
from tirefit.data.table import Layout
from tirefit.data.units import known_unit
from tirefit.results import DataError

_KEYWORD = re.compile(r"^\s*\*\*\s*([A-Za-z]+)", re.MULTILINE)
_NAMES = {
    "FX": "fx", "FXW": "fx", "FXH": "fx", "FYW": "fy", "FYH": "fy", "FZW": "fz",
    "FZH": "fz", "MZW": "mz", "MZH": "mz", "MXW": "mx", "MYW": "my",
    "LONGSLIP": "kappa", "SLIPANGL": "alpha",
    "INCLANGL": "gamma", "LONGVEL": "v", "TRAJVELW": "v", "TRAJVELH": "v",
    "WHROTSPD": "omega", "INFLPRES": "pressure", "RUNTIME": "time", "TIME": "time",
    "TYRETEMP": "temperature",
}  # fmt: skip
"""Parameter of TYDEX -> column; of several for the same column the first is read. MXH and
MYH are moments about the wheel centre, not about the contact point."""

_OF_TIRE = (
    ("UNLOADED_RADIUS", 1.0, "length", r"RFREE|.*(unloaded|free) radius"),
    ("UNLOADED_RADIUS", 0.5, "length", r"OVALLDIA|NOMDIAME|.*(overall|outer) diameter"),
    ("FNOMIN", 1.0, "force", r"FNOMIN|NOMLOAD|.*nominal [a-z ]*(load|force)"),
    ("NOMPRES", 1.0, "pressure", r"NOMPRES|.*nominal [a-z ]*pressure"),
)
"""Key of a .tir file, factor, dimension, and pattern of the name or comment of the
constant; the first match of a key is used."""

_INCH = 0.0254
_SIZE = re.compile(r"(?<!\d)(\d{3})\s?/\s?(\d\d)\s?[A-Z]*-?\s?(\d\d)\b", re.I)
"""Nominal size such as 205/60 R15: width [mm], aspect ratio [%], rim diameter [inch]."""
_LARGEST = 2.1  # radius [m] of the largest earthmover tires: a larger value has a wrong unit

_SECTIONS = "HEADER COMMENTS CONSTANTS MEASURCHANNELS MEASURDATA END".split()
_MISSING = {"NOTAVAIL", "NOT_AVAIL", "N/A", "NA", "NAN"}
_WIDTH = 10


class _Entry(NamedTuple):
    """A line of a section: a parameter with its unit and its numbers or text."""

    name: str
    unit: str
    values: tuple[str, ...]
    line: int

    @property
    def conversion(self) -> tuple[float, float, float]:
        """Factor, measurement offset and physical offset of a channel."""
        factor, before, after = (*self.values, "", "", "")[:3]
        return float(factor or 1), float(before or 0), float(after or 0)


def is_tydex(text: str) -> bool:
    """Whether a text has the keywords of a TYDEX file of measurements or its header."""
    keywords = {match[1].upper() for match in _KEYWORD.finditer(text[:100_000])}
    return "MEASURCHANNELS" in keywords or {"HEADER", "CONSTANTS"} <= keywords


def table_of_tydex(text: str, path: Place, digest: str, notes: list[str]) -> Table:
    """Channels, and constants without a channel, as a table in their units.

    Args:
        text: of the file.
        path: of the file, named in the problems.
        digest: its SHA-256.
        notes: assumptions so far.

    Raises:
        DataError: a section is missing, or the line of a channel cannot be parsed.
    """
    sections = _sections(text)
    file = str(path)
    for keyword in ("MEASURCHANNELS", "MEASURDATA"):
        if not sections.get(keyword):
            reason = f"the TYDEX file has no **{keyword}"
            remedy = "give a file of measurements: tire models are read from .tir files"
            raise DataError(reason, remedy, file)
    channels = _channels(sections["MEASURCHANNELS"], file)
    rows, lines, faults = _records(sections["MEASURDATA"], len(channels))
    if not rows:
        reason, remedy = "there are no data rows below **MEASURDATA", "give some"
        raise DataError(reason, remedy, file)
    pairs = zip(zip(*rows, strict=True), channels, strict=True)
    cells: list[np.ndarray | list[str]] = []  # in the unit of the channel
    for texts, channel in pairs:
        factor, before, after = channel.conversion
        try:
            with np.errstate(all="ignore"):  # the reader reports rows that are not finite
                cells.append(factor * (np.array(texts, float) + before) + after)
        except ValueError:  # one of them is not a number
            numbers = (float(text) if is_number(text) else None for text in texts)
            converted = (x if x is None else factor * (x + before) + after for x in numbers)
            both = zip(texts, converted, strict=True)
            cells.append([text if x is None else repr(x) for text, x in both])
    constants, others = _constants(sections.get("CONSTANTS", []), channels)
    of_tire, origins = _of_tire(others, sections.get("HEADER", []))
    unread = [line.split()[0] for _, line in others if line not in origins]
    names = [channel.name for channel in channels]
    meant: dict[str, str] = {}  # parameter -> column; "" if another one has the same meaning
    for name, column in _NAMES.items():
        if name in names:
            meant[name] = "" if column in meant.values() else column
    meant |= {entry.name: _NAMES[entry.name] for entry in constants}
    ragged = np.zeros(len(rows), bool)
    ragged[[row for fault in faults for row in fault.rows]] = True
    moved = ", ".join(channel.name for channel in channels if channel.conversion[1])
    doubts = (
        f"the measurement offset of {moved} was added before the factor, but in some"
        " files it must be subtracted: compare a value with the report of the rig"
    )
    read = (*channels, *constants)
    return Table(
        file, stem_of(path), [entry.name for entry in read],
        cells + [np.full(len(rows), float(c.values[0])) for c in constants],
        np.array(lines), ragged, channels[0].line,
        units_row=[entry.unit for entry in read], sha256=digest,
        notes=(*notes, *_said(sections, channels, constants, unread, meant), *origins.values()),
        faults=faults, layout=Layout(meant, "unit of the channel", "iso-w"),
        doubts=(doubts,) if moved else (), constants=of_tire,
    )  # fmt: skip


# --- sections and their lines -------------------------------------------------------


def _sections(text: str) -> dict[str, list[tuple[int, str]]]:
    """Keyword -> lines with content as (number, text), without comments."""
    sections: dict[str, list[tuple[int, str]]] = {}
    current = None
    for number, line in enumerate(text.splitlines(), 1):
        keyword = _KEYWORD.match(line)
        if keyword:
            current = sections.setdefault(keyword[1].upper(), [])
        elif current is not None and line.strip() and line.lstrip()[0] != "!":
            current.append((number, line))
    return sections


def _channels(lines: Iterable[tuple[int, str]], file: str) -> list[_Entry]:
    channels: dict[str, _Entry] = {}
    for line, text in lines:
        entry = _entry(line, text)
        if entry is None:
            reason = f"this is not a channel of TYDEX: {text.strip()!r}"
            remedy = "give name, comment, unit and conversion factor in columns of 10"
            raise DataError(reason, remedy, file, line)
        if entry.name in channels:
            reason = f"the channel {entry.name} is there twice"
            raise DataError(reason, "rename one", file, line, entry.name)
        if entry.conversion[0] == 0:
            reason = f"the conversion factor of {entry.name} is 0"
            remedy = "give the factor that turns its values into its unit"
            raise DataError(reason, remedy, file, line, entry.name)
        channels[entry.name] = entry
    return [*channels.values()]


def _entry(number: int, line: str) -> _Entry | None:
    """A channel from its line, by columns, or by words if it does not keep the columns."""
    line = line.expandtabs(_WIDTH).rstrip()
    unit = line[40:50].strip()
    fields = [line[at : at + _WIDTH].strip() for at in (50, 60, 70)]
    given = [field for field in fields if field]
    is_name = len(line[:10].split()) == 1 and len(line) > 50
    is_unit = len(unit.split()) < 2 or known_unit(unit) is not None
    if is_name and fields[0] and all(map(is_number, given)) and is_unit:
        return _Entry(line[:10].strip(), unit, tuple(fields), number)
    words = line.split()
    numbers: list[str] = []
    while len(words) > 1 and len(numbers) < 3 and is_number(words[-1]):
        numbers.insert(0, words.pop())
    if len(words) < 2:
        return _Entry(words[0], "", tuple(numbers), number) if numbers else None
    unit = words[-1] if words[-1] == "-" or known_unit(words[-1]) else ""
    if len(words) > 2 and known_unit("".join(words[-2:])):
        unit = "".join(words[-2:])
    return _Entry(words[0], unit, tuple(numbers), number)


def _records(
    lines: Sequence[tuple[int, str]], width: int
) -> tuple[list[list[str]], list[int], tuple[BadRows, ...]]:
    """Rows of ``width`` texts, which may continue over lines; the first line of each row;
    and the rows with another number of values."""
    rows: list[list[str]] = []
    numbers, wrong = [], dict[int, str]()
    # Number of data lines that all have too few values if a record spans several lines.
    goes_on = all(len(_words(line, width)) < width for _, line in lines[:50])
    words: list[str] = []
    for k, (number, line) in enumerate(lines, 1):
        if not words:
            numbers.append(number)
        words = [*words, *_words(line, width - len(words))]
        if len(words) < width and goes_on and k < len(lines):
            continue
        if len(words) != width:
            wrong[len(rows)] = f"{len(words)} values"
            words = ["nan"] * width
        rows.append(words)
        words = []
    rule = f"where there are {width} channels"
    return rows, numbers, (BadRows(None, [*wrong], [*wrong.values()], rule),) if wrong else ()


def _words(line: str, missing: int) -> list[str]:
    """Values of a line: words, or columns of 10 if values touch each other."""
    words = line.split()
    text = line.rstrip().expandtabs(_WIDTH)
    columns = [text[at : at + _WIDTH].strip() for at in range(0, len(text), _WIDTH)]
    touching = len(words) < len(columns) <= missing and all(
        is_number(column) or column.upper() in _MISSING for column in columns
    )
    return columns if touching else words


# --- constants and meanings -----------------------------------------------------------


def _constants(
    lines: Iterable[tuple[int, str]], channels: Sequence[_Entry]
) -> tuple[list[_Entry], list[tuple[int, str]]]:
    """Constants that are columns without a channel, and the lines of other constants."""
    there = {_NAMES.get(channel.name, channel.name) for channel in channels}
    kept: list[_Entry] = []
    unread = []
    for number, line in lines:
        entry = _entry(number, line)
        column = None if entry is None else _NAMES.get(entry.name)
        if entry is None or not column or column in there or not entry.values:
            unread.append((number, line))
            continue
        there.add(column)
        kept.append(entry._replace(values=entry.values[:1]))
    return kept, unread


def _of_tire(
    lines: Iterable[tuple[int, str]], header: Iterable[tuple[int, str]]
) -> tuple[dict[str, float], dict[str, str]]:
    """Constants of the tire [SI] by .tir key, and a note for each line used.

    The nominal size is also read from the header.
    """
    constants: dict[str, float] = {}
    notes: dict[str, str] = {}

    def take(key: str, value: float, line: str) -> None:
        largest = _LARGEST if key == "UNLOADED_RADIUS" else np.inf
        if key not in constants and 0 < value < largest:
            constants[key] = value
            notes[line] = f"{key} = {value:.4g}: {' '.join(line.split())}"

    for key, factor, dimension, meaning in _OF_TIRE:
        for number, line in lines:
            entry = _entry(number, line)
            is_it = re.match(meaning, " ".join(line.split()), re.IGNORECASE)
            if is_it and entry and entry.values:
                value, unit = float(entry.values[0]), known_unit(entry.unit)
                if entry.unit.casefold() in ("in", "inch", '"', "zoll") and dimension == "length":
                    value *= _INCH
                elif entry.unit in ("", "-"):  # a length above 3 is in mm
                    value *= 1e-3 if dimension == "length" and value > 3 else 1.0
                else:
                    same = unit is not None and unit.dimension == dimension
                    value = float(unit.to_si(value)) if unit and same else np.nan
                take(key, factor * value, line)
    for _, line in [*lines, *header]:
        if size := _SIZE.search(line):
            width, ratio, rim = map(float, size.groups())
            take("UNLOADED_RADIUS", rim * _INCH / 2 + width * ratio * 1e-5, line)
    return constants, notes


def _said(
    sections: Mapping[str, Sequence[tuple[int, str]]],
    channels: Sequence[_Entry],
    constants: Sequence[_Entry],
    unread: Sequence[str],
    meant: Mapping[str, str],
) -> Iterator[str]:
    """Sentences on the signs, the header, and what was read how or not at all."""
    header = {line.split()[0].upper(): line.split()[-1] for _, line in sections.get("HEADER", [])}
    release = header.get("RELEASE", "of no stated release")
    yield (f"TYDEX {release}: signs read as 'iso-w' (ISO 8855), slip positive in driving")
    for channel in channels:
        factor, before, after = channel.conversion
        if channel.conversion != (1, 0, 0):
            value = f"(value + {before:g})" if before else "value"
            yield (
                f"{channel.name} = {factor:g} * {value}"
                + (f" + {after:g}" if after else "")
                + (f" [{channel.unit}]" if channel.unit else "")
            )
    for entry in constants:
        yield f"{entry.name} = {entry.values[0]} {entry.unit} in all rows (**CONSTANTS)"
    for name, column in meant.items():
        if not column:
            yield f"channel {name} not read: another has the same meaning"
        elif name.endswith("H"):
            yield f"{name} is in axes H, at the wheel centre: read as if at the road"
    if unread:
        yield f"constants not read: {', '.join(unread)}"
    others = {*sections} - {*_SECTIONS}
    if others:
        yield f"sections not read: {', '.join(sorted(others))}"
