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
_LARGEST = 2.1  # radius [m] of the largest earthmover tires: a larger value has a wrong unit

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
    of_tire, origins = _of_tire(others)
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
    """A channel or constant from the columns of its line."""
    line = line.expandtabs(_WIDTH).rstrip()
    fields = [line[at : at + _WIDTH].strip() for at in (50, 60, 70)]
    given = [field for field in fields if field]
    if len(line[:10].split()) == 1 and fields[0] and all(map(is_number, given)):
        return _Entry(line[:10].strip(), line[40:50].strip(), tuple(fields), number)
    return None


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
    are_values = (is_number(column) or column.upper() in _MISSING for column in columns)
    return columns if len(words) < len(columns) <= missing and all(are_values) else words


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


def _of_tire(lines: Iterable[tuple[int, str]]) -> tuple[dict[str, float], dict[str, str]]:
    """Constants of the tire [SI] by .tir key, and a note for each line used."""
    constants: dict[str, float] = {}
    notes: dict[str, str] = {}
    for key, factor, dimension, meaning in _OF_TIRE:
        for number, line in lines:
            words, entry = " ".join(line.split()), _entry(number, line)
            unit = known_unit(entry.unit) if entry else None
            if not entry or not unit or not re.match(meaning, words, re.IGNORECASE):
                continue
            value = float(factor * unit.to_si(float(entry.values[0])))
            is_size = unit.dimension == dimension and 0 < value
            if is_size and key not in constants and (dimension != "length" or value < _LARGEST):
                constants[key] = value
                notes[line] = f"{key} = {value:.4g}: {words}"
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
            converted = f"{factor:g} * (value + {before:g}) + {after:g}"
            yield f"{channel.name} = {converted} [{channel.unit or '-'}]"
    for entry in constants:
        yield f"{entry.name} = {entry.values[0]} {entry.unit} in all rows (**CONSTANTS)"
    for name, column in meant.items():
        if not column:
            yield f"channel {name} not read: another has the same meaning"
        elif name.endswith("H"):
            yield f"{name} is in axes H, at the wheel centre: read as if at the road"
    if unread:
        yield f"constants not read: {', '.join(unread)}"
