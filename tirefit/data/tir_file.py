"""The text of a tire property file, and the values in it."""

import io
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

from tirefit.data.columns import is_number
from tirefit.data.tir_keys import DIMENSIONS, FITTYP, SECTIONS, UNITS
from tirefit.results import InputProblem, UsageError

__all__ = ["Entry", "TirFile", "parsed", "shortest"]

_SECTION = re.compile(r"\s*\[([^\]]*)\]\s*([$!].*)?$")
_ENTRY = re.compile(
    r"""\s*(?P<key>\w+)\s*=[ \t]*"""
    r"""(?P<value>'[^']*'|"[^"]*"|[^$!'"\r\n]*?)\s*([$!].*)?$"""
)
_COMMENT = re.compile(r"\s*([$!#].*)?$")
_TABLE = re.compile(r"\s*([{(]|[-+.\d])")


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


@dataclass(frozen=True)
class TirFile:
    """A tire property file.

    ``lines`` are those of the file with their ends, ``entries`` its keys in order;
    ``path`` names it in messages.
    """

    path: str
    lines: tuple[str, ...]
    entries: tuple[Entry, ...]

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

    @cached_property
    def numbers(self) -> dict[str, float]:
        """Key -> number, in SI where the key has a dimension, else as it is written."""
        in_si: dict[str, float] = {}
        for entry in self.entries:
            if entry.section != "UNITS" and is_number(entry.value):
                in_si.setdefault(entry.key, float(entry.value) * self._size(entry.key))
        return in_si

    @property
    def version(self) -> str:
        """Version of the Magic Formula: 5.2, 6.1 or 6.2; KeyError if not stated."""
        return FITTYP[self.numbers["FITTYP"]]

    @property
    def side(self) -> str:
        """LEFT, RIGHT, SYMMETRIC or UNKNOWN: where the tire was mounted."""
        entry = self.find("TYRESIDE")
        return entry.text.upper() if entry else "UNKNOWN"

    def unit(self, quantity: str) -> float:
        """Size in SI of a quantity of [UNITS]; SI where it is not stated."""
        entry = self.find(quantity, "UNITS")
        return UNITS[quantity].get(entry.text.lower(), 1.0) if entry else 1.0

    def _size(self, key: str) -> float:
        """Size in SI of the unit in which a key is written."""
        dimension = DIMENSIONS.get(key)
        length, force = self.unit("LENGTH"), self.unit("FORCE")
        if dimension == "pressure" and self.find("PRESSURE", "UNITS"):
            return self.unit("PRESSURE")
        return {
            None: 1.0,
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
            elif key in SECTIONS:
                new.setdefault(SECTIONS[key], []).append(f"{key:<24} = {written}")
            else:
                reason = f"{key} is no key of the file and no coefficient"
                problems.append(InputProblem(reason, "correct its name", self.path))
        if problems:
            raise UsageError(problems)
        return parsed("".join(_with_new(lines, new)), self.path)[0]


def shortest(number: float) -> str:
    """The number with 15 digits, as far as it has them: 0.3, not 0.30000000000000004"""
    return f"{number:.15g}"


def _with_new(lines: list[str], new: Mapping[str, list[str]]) -> Iterator[str]:
    """The lines with new ones at the end of their sections, or in a new section."""
    end = "\r\n" if any(line.endswith("\r\n") for line in lines) else "\n"
    waiting = dict(new)
    section = ""
    for line in lines:
        header = _SECTION.match(line)
        if header:
            for added in waiting.pop(section, ()):
                yield added + end
            section = header[1].strip().upper()
        yield line if line.endswith("\n") else line + end
    for added in waiting.pop(section, ()):
        yield added + end
    for section, entries in waiting.items():
        yield f"[{section}]{end}"
        for added in entries:
            yield added + end


def parsed(text: str, path: str) -> tuple[TirFile, list[InputProblem]]:
    """The file as it is, unchecked, and the lines that cannot be understood."""
    lines = tuple(io.StringIO(text, newline=""))
    entries, problems, section = [], [], ""
    for row, line in enumerate(lines, 1):
        if header := _SECTION.match(line):
            section = header[1].strip().upper()
        elif entry := _ENTRY.match(line):
            key, value = entry["key"].upper(), entry["value"]
            entries.append(Entry(section, key, row, value, entry.span("value")))
        elif not _COMMENT.match(line) and not _TABLE.match(line):
            reason = f"{line.strip()[:40]!r} is no section, KEY = VALUE or comment"
            remedy = "close its quotes or brackets, or begin the comment with $"
            problems.append(InputProblem(reason, remedy, path, row))
    return TirFile(path, lines, tuple(entries)), problems
