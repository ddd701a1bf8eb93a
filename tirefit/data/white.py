"""Text with columns separated by white space: find its header, and put tabs between."""

import itertools
import re
from collections.abc import Callable, Sequence

from tirefit.data.columns import is_number
from tirefit.data.units import known_unit

_BELOW = 3
"""The first row of numbers is at most this many lines below the header, after units or a ruling."""

_TOKEN = re.compile(r'"[^"]*"|\S+')
_WIDE_GAP = re.compile(r"\s{2,}|\t")

Header = tuple[int, list[str]]
"""Index of a header's line, and its cells."""


def header_above_numbers(
    lines: Sequence[str], searched: Sequence[int], is_known: Callable[[str], bool]
) -> Header | None:
    """The header: a line with as many words as the row of numbers below it has numbers.

    Args:
        lines: of the file; a blank line is only a line end.
        searched: indices of the lines with content to search, in order.
        is_known: whether a word is the name of a known column. A title may have as many
            words as a row has numbers, so the line with the most known ones is taken.
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
    """Number of values in the first row below that has only numbers; 0 without one."""
    content = (line for line in lines[index + 1 :] if line.strip())
    for line in itertools.islice(content, _BELOW):
        words = line.split()
        if all(map(_is_cell, words)):
            return len(words)
    return 0


def _is_cell(word: str) -> bool:
    """Whether a word is a number with point or comma, or the text of a missing value."""
    return is_number(word.replace(",", ".", 1)) or word.casefold() == "nan"


def commented_header(
    lines: Sequence[str], is_known: Callable[[str], bool]
) -> tuple[int, str] | None:
    """The header of a file whose header is a comment, as NumPy and MATLAB write it.

    Args:
        lines: of the file.
        is_known: whether a word is the name of a known column.

    Returns:
        Index and text without the mark of the last comment above the first line of
        numbers with as many cells, of which two are known; None without one.
    """
    first = next((i for i, line in enumerate(lines) if not _is_comment(line)), 0)
    splits: list[Callable[[str], list[str]]] = [
        *(re.compile(mark).split for mark in ",;\t"),
        _words,
    ]
    for split in splits:
        width = len(split(lines[first].strip())) if lines else 0
        if width < 2 or not all(_is_cell(c.strip()) for c in split(lines[first])):
            continue
        for index in range(first - 1, -1, -1):
            text = lines[index].strip().lstrip("#%").strip()
            cells = [cell.strip() for cell in split(text)]
            if len(cells) != width or any(map(is_number, cells)):
                continue
            if sum(map(is_known, cells)) >= 2:
                return index, text + "\n"
    return None


def _is_comment(line: str) -> bool:
    return not line.strip() or line.lstrip()[0] in "#%"


def tabbed(lines: Sequence[str], header: list[str]) -> list[str]:
    """The lines from the header, with a tab between columns; blank lines are kept."""
    rows = ["\t".join(f'"{cell}"' for cell in header) + "\n"]
    for number, line in enumerate(lines[1:]):
        words = _TOKEN.findall(line)
        if number < _BELOW and len(words) > len(header):
            words = _joined_units(words, len(header))
        rows.append("\t".join(words) + "\n" if words else "\n")
    return rows


def _joined_units(words: list[str], width: int) -> list[str]:
    """Words of a row of units; ``deg C`` counts as one word if that gives ``width``."""
    joined: list[str] = []
    for word in words:
        if joined and known_unit(joined[-1] + word) and len(word) < 3:
            joined[-1] += word
        else:
            joined.append(word)
    return joined if len(joined) == width else words
