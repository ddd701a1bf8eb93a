"""Text in columns that white space parts: where the header is, and as tabbed lines."""

import itertools
import re
from collections.abc import Callable, Sequence

from tirefit.data.columns import is_number
from tirefit.data.units import known_unit

__all__ = ["Header", "header_above_numbers", "tabbed"]

_BELOW = 3
"""Lines below a header in which the first row of numbers must stand: units, a rule."""

_TOKEN = re.compile(r'"[^"]*"|\S+')
_WIDE_GAP = re.compile(r"\s{2,}|\t")

Header = tuple[int, list[str]]
"""Index of a header's line, and its cells."""


def header_above_numbers(
    lines: Sequence[str], searched: Sequence[int], is_known: Callable[[str], bool]
) -> Header | None:
    """A line with as many words as the row of numbers below it has numbers.

    Args:
        lines: of the file, a blank one as a line end alone.
        searched: indices of the lines with content to look at, in order.
        is_known: whether a word is a column's name; a title may have as many words as
            a row has numbers, so the line with the most known ones is taken.
    """
    headers = []
    for index in searched:
        width = _numbers_below(lines, index)
        for cells in (_WIDE_GAP.split(lines[index].strip()), _words(lines[index])):
            if width > 1 and len(cells) == width and not any(map(is_number, cells)):
                headers.append((index, cells))
                break
    return max(headers, key=lambda it: sum(map(is_known, it[1])), default=None)


def _words(line: str) -> list[str]:
    return [word.strip('"').strip() for word in _TOKEN.findall(line)]


def _numbers_below(lines: Sequence[str], index: int) -> int:
    """How many numbers the first row of nothing else has, just below; 0 without one."""
    content = (line for line in lines[index + 1 :] if line.strip())
    for line in itertools.islice(content, _BELOW):
        words = line.split()
        if all(is_number(word) or word.casefold() == "nan" for word in words):
            return len(words)
    return 0


def tabbed(lines: Sequence[str], header: list[str]) -> list[str]:
    """The lines from the header on, with a tab between columns; blank ones stay."""
    rows = ["\t".join(f'"{cell}"' for cell in header) + "\n"]
    for number, line in enumerate(lines[1:]):
        words = _TOKEN.findall(line)
        if number < _BELOW and len(words) > len(header):
            words = _joined_units(words, len(header))
        rows.append("\t".join(words) + "\n" if words else "\n")
    return rows


def _joined_units(words: list[str], width: int) -> list[str]:
    """Words of a row of units, ``deg C`` as one of them where that fits ``width``."""
    joined: list[str] = []
    for word in words:
        if joined and known_unit(joined[-1] + word) and len(word) < 3:
            joined[-1] += word
        else:
            joined.append(word)
    return joined if len(joined) == width else words
