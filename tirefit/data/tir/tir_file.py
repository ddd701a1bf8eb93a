"""The text of a tire property file, and the values in it."""

import io
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from tirefit.data.tir.tir_keys import (
    ALIASES,
    DIMENSIONS,
    FITTYP,
    KNOWN,
    NEUTRAL,
    NONZERO,
    NUMERIC,
    ONLY_IN,
    REQUIRED,
    SECTIONS,
    UNITS,
)
from tirefit.results import InputProblem, UsageError

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[EeDd][+-]?\d+)?"
_MARKS = r"[$!%;#]"
_VALUE = (
    rf"""[ \t]*(?![ \t])(?P<value>'[^']*'|"[^"]*"|{_NUMBER}(?=\s|{_MARKS}|$)"""
    rf"""|[^$!'"\t\r\n]*?(?=\s*(?:{_MARKS}|\t|\s\s|$)))"""
)
"""A quoted text, a number or other words; a following comment needs no mark."""
_SECTION = re.compile(r"\s*\[\s*([A-Za-z]\w{3}[^\]]*)\]")
"""A name has at least four letters: [N] and [rad] are units in a wrapped comment."""
INFOFILE = re.compile(r"(?m)^[ \t]*FileIdent[ \t]*=[ \t]*CarMaker-Tire-(\S+)")
"""The first key of a CarMaker infofile of a tire, and the model."""
_ENTRY = re.compile(r"\s*(?:(?P<group>[A-Za-z]\w*)\.)?(?P<key>[A-Za-z]\w*)\s*=" + _VALUE)
"""In an infofile of CarMaker the section stands before each key: ``Vertical.FNOMIN``."""
_COMMENT = re.compile(r"\s*([$!#%;/*{(]|[-+.\d]|$)")
"""A comment, a row of a table, or nothing."""
_BROKEN = re.compile(r"\s*(?:\[\s*[A-Za-z]\w{3}|(?P<key>[A-Za-z]\w*)\s*(?:=|[-+.\d]))")
"""A section that is not closed, or a key without a valid value."""


class Version(NamedTuple):
    """Version of the Magic Formula and its evidence, or the reason why it is None."""

    name: str | None
    because: str


@dataclass(frozen=True)
class Entry:
    """One ``KEY = VALUE``: its section, line (from 1), value as written, and place."""

    section: str
    key: str
    row: int
    value: str
    place: tuple[int, int]

    @property
    def text(self) -> str:
        """The value without quotes."""
        return self.value.strip("'\"").strip()

    def size_of(self, dimension: str) -> float | None:
        """Size in SI of the unit that an entry of [UNITS] names; None if it is not known."""
        from tirefit.data.units import known_unit  # NumPy, which completion of words does not need

        unit = known_unit("inch" if self.text.lower() == "in" else self.text)
        return unit.scale if unit and unit.dimension == dimension else None


@dataclass(frozen=True)
class TirFile:
    """A tire property file."""

    path: str  # named in messages
    lines: tuple[str, ...]  # of the file, with their ends
    entries: tuple[Entry, ...]  # keys in order
    notes: tuple[str, ...] = ()  # assumptions made on reading

    @property
    def text(self) -> str:
        """The whole file."""
        return "".join(self.lines)

    def find(self, key: str, section: str | None = None) -> Entry | None:
        """The first entry of a key, of any section but [UNITS] unless it is named."""
        for entry in self.entries:
            inside = entry.section == section if section else entry.section != "UNITS"
            if entry.key == key and inside:
                return entry
        return None

    def wanted(self) -> Iterator[Entry]:
        """Entries whose values must be numbers."""
        return (e for e in self.entries if e.key in NUMERIC and e.section != "UNITS")

    def number(self, entry: Entry) -> float | None:
        """The number of an entry as it is written, or None."""
        text = entry.text
        if re.fullmatch(_NUMBER, text) is None:
            return None
        number = float(text.upper().replace("D", "E"))
        return number if math.isfinite(number) else None

    @cached_property
    def _written(self) -> dict[str, float]:
        """Key -> number, in SI if the key has a dimension, else as written."""
        in_si: dict[str, float] = {}
        for entry in self.entries:
            number = self.number(entry)
            if entry.section != "UNITS" and number is not None:
                in_si.setdefault(entry.key, number * self._size(entry.key))
        return in_si

    @cached_property
    def numbers(self) -> dict[str, float]:
        """Key -> number [SI], without coefficients that the file's version lacks."""
        return {k: v for k, v in self._written.items() if k not in self.foreign}

    @cached_property
    def foreign(self) -> list[str]:
        """Coefficients that the version of the file lacks and another one has."""
        return self._acting({"5": "6", "6": "5"}.get((self.stated.name or "")[:1], ""))

    @cached_property
    def stated(self) -> Version:
        """Version by FITTYP, else by PROPERTY_FILE_FORMAT."""
        entry = self.find("FITTYP")
        if entry and entry.text:
            name = FITTYP.get(self.number(entry) or 0) or _version_in(entry.text)
            failure = "" if name else " is not a supported version"
            return Version(name, f"FITTYP = {entry.value}{failure}")
        entry = self.find("PROPERTY_FILE_FORMAT")
        if entry and (name := _version_in(entry.text)):
            return Version(name, f"{entry.key} = {entry.value}, and no FITTYP")
        return Version(None, "neither FITTYP nor PROPERTY_FILE_FORMAT states a version")

    def _acting(self, generation: str) -> list[str]:
        """Coefficients of this generation only, whose values have an effect."""
        keys = (key for key, of in ONLY_IN.items() if of == generation)
        return [k for k in keys if self._written.get(k, _neutral(k)) != _neutral(k)]

    @property
    def version(self) -> str:
        """Version of the Magic Formula: 5.2, 6.1 or 6.2; KeyError if not stated."""
        if self.stated.name is None:
            raise KeyError(self.stated.because)
        return self.stated.name

    @cached_property
    def lacks(self) -> dict[str, str]:
        """Force that the file does not describe (F_x, F_y, M_z) -> why."""
        lacks = {}
        for force, needs in REQUIRED.items():
            zero = [k for k in needs if k in NONZERO and self.numbers.get(k) == 0]
            lost = [key for key in needs if key not in self.numbers or key in zero]
            if set(lost) >= set(needs) - {"UNLOADED_RADIUS"}:
                lacks[force] = "its coefficients are missing"
            elif lost:
                how = ("= 0" if key in zero else "is missing" for key in lost)
                why = zip(lost, how, strict=True)
                lacks[force] = ", ".join(f"{k} {how} ({needs[k]})" for k, how in why)
        if "F_y" in lacks:
            lacks.setdefault("M_z", "it is computed from F_y")
        return lacks

    @property
    def side(self) -> str:
        """LEFT, RIGHT, SYMMETRIC or UNKNOWN: where the tire was mounted."""
        entry = self.find("TYRESIDE")
        return (entry.text.upper() if entry else "") or "UNKNOWN"

    @property
    def is_infofile(self) -> bool:
        """Whether it is an infofile of CarMaker, whose sections stand before each key."""
        return INFOFILE.search(self.text) is not None

    @property
    def ellipse(self) -> bool:
        """Whether combined slip is by a friction ellipse, which MF 6 does not have."""
        entry = self.find("FE_METHOD")
        asked = entry is not None and entry.text.upper() == "YES"
        return asked and self.stated.name == "5.2"

    def unit(self, quantity: str) -> float:
        """Size in SI of a quantity of [UNITS]; 1 if it is not stated, or not known."""
        entry = self.find(quantity, "UNITS")
        return (entry and entry.size_of(UNITS[quantity])) or 1.0

    def _size(self, key: str) -> float:
        """Size in SI of the unit in which a key is written."""
        dimension = DIMENSIONS.get(key)
        if dimension is None:
            return 1.0
        length, force = self.unit("LENGTH"), self.unit("FORCE")
        if dimension == "pressure" and self.find("PRESSURE", "UNITS"):
            return self.unit("PRESSURE")
        return {
            "angle": self.unit("ANGLE"),
            "length": length,
            "force": force,
            "speed": length / self.unit("TIME"),
            "pressure": force / length**2,
        }[dimension]

    def with_values(self, values: Mapping[str, float | str]) -> "TirFile":
        """The same file with other values: SI numbers, or texts such as a TYRESIDE.

        A coefficient, FITTYP or TYRESIDE that the file lacks is added to its section.

        Raises:
            UsageError: keys that are neither in the file nor such; all of them.
        """
        lines = list(self.lines)
        new: dict[str, list[str]] = {}
        problems = []
        for key, value in values.items():
            written = f"'{value}'"
            if not isinstance(value, str):
                written = shortest(float(value) / self._size(key))
            entry = self.find(key)
            if entry is not None:
                start, end = entry.place
                line = lines[entry.row - 1]
                lines[entry.row - 1] = line[:start] + written + line[end:]
            elif key in SECTIONS and not self.is_infofile:
                new.setdefault(SECTIONS[key], []).append(f"{key:<24} = {written}")
            else:
                reason, remedy = f"{key} is not a key of the file", "correct its name, or add it"
                problems.append(InputProblem(reason, remedy, self.path))
        UsageError.raise_for(problems)
        newline = "\r\n" if any(line.endswith("\r\n") for line in lines) else "\n"
        text: list[str] = []
        for line in lines:  # new lines go to the beginning of their sections, or into a new section
            text.append(line if line.endswith("\n") else line + newline)
            if header := _SECTION.match(line):
                text += [added + newline for added in new.pop(header[1].strip().upper(), ())]
        for section, added in new.items():
            text += [f"{row}{newline}" for row in (f"[{section}]", *added)]
        return parsed("".join(text), self.path)[0]


def shortest(number: float) -> str:
    """The number with 15 digits, as far as it has them: 0.3, not 0.30000000000000004"""
    return f"{number:.15g}"


def _key(match: re.Match[str]) -> str:
    return ALIASES.get(key := match["key"].upper(), key)


def _neutral(key: str) -> float:
    """Value of a coefficient at which it has no effect."""
    return NEUTRAL.get(key, 1.0 if key.startswith("L") else 0.0)


def _version_in(text: str) -> str | None:
    """Version that a text such as MF52, MF-Tyre 6.1, MF_05 or PAC2002 names."""
    if "PAC2002" in text.upper():
        return "5.2"
    version = re.search(r"(?<![\d.])(?:0?(5)[._]?[012]?|6[._]?([012]))(?!\d)", text)
    if version is None:
        return None
    return "5.2" if version[1] else "6.2" if version[2] == "2" else "6.1"


def parsed(text: str, path: str, notes: Iterable[str] = ()) -> tuple[TirFile, list[InputProblem]]:
    """The file, unchecked, and errors of lines that cannot be parsed."""
    lines = tuple(io.StringIO(text, newline=""))
    entries: list[Entry] = []
    problems, words, section = [], [], ""
    infofile = INFOFILE.search(text) is not None
    for row, line in enumerate(lines, 1):
        if infofile and line[:1] in "\t ":  # a text or a table below its key
            continue
        if header := _SECTION.match(line):
            section = header[1].strip().upper()
        elif match := _ENTRY.match(line):
            inside = (match["group"] or section).upper()
            entries.append(Entry(inside, _key(match), row, match["value"], match.span("value")))
        elif (broken := _BROKEN.match(line)) and (not broken["key"] or _key(broken) in KNOWN):
            reason = f"{line.strip()[:40]!r} is not a section, KEY = VALUE or comment"
            remedy = "close its quotes or brackets, or begin the comment with $"
            problems.append(InputProblem(reason, remedy, path, row))
        elif not _COMMENT.match(line):
            words.append(row)
    messages = list(notes)
    if words:
        some = ", ".join(map(str, words[:5])) + (", ..." if len(words) > 5 else "")
        messages.append(f"{len(words)} lines without KEY = VALUE are read as comments: rows {some}")
    return TirFile(path, lines, tuple(entries), tuple(messages)), problems
