"""Find the header of a text, its delimiter and its units; read the words of white-space tables."""

import csv
import itertools
import re
from collections.abc import Callable, Sequence

from tirefit.data.columns import IsKnown, guess, is_number
from tirefit.data.readers.cells import SPACES
from tirefit.data.units import known_unit

_BELOW = 3
"""The first row of numbers is at most this many lines below the header, after units or a ruling."""

_DELIMITERS = "\t;|,"
_LONGEST = 10  # largest number of lines of a header with quoted line ends

_TOKEN = re.compile(r'"[^"]*"|\S+')
_WIDE_GAP = re.compile(r"\s{2,}|\t")


def _header_above_numbers(
    lines: Sequence[str], searched: Sequence[int], is_known: IsKnown
) -> tuple[int, list[str]] | None:
    """Index and cells of the header: a line with as many words as the row of numbers below it. A
    title may have as many, so of the lines ``searched`` that with the most known ones is taken."""
    headers = []
    for index in searched:
        content = (line.split() for line in lines[index + 1 :] if line.strip())
        rows = (row for row in itertools.islice(content, _BELOW) if all(map(_is_cell, row)))
        width = len(next(rows, []))
        for cells in (_WIDE_GAP.split(lines[index].strip()), _words(lines[index])):
            if width > 1 and len(cells) == width and not any(map(is_number, cells)):
                headers.append((index, cells))
                break
    return max(headers, key=lambda it: sum(map(is_known, it[1])), default=None)


def _words(line: str) -> list[str]:
    return [word.strip('"').strip() for word in _TOKEN.findall(line)]


def _is_cell(word: str) -> bool:
    """Whether a word is a number with point or comma, or the text of a missing value."""
    return is_number(word.replace(",", ".", 1)) or word.casefold() == "nan"


def commented_header(lines: Sequence[str]) -> tuple[int, str] | None:
    """The header of a file whose header is a comment, as NumPy and MATLAB write it.

    Returns:
        Index and text without the mark of the last comment above the first line of
        numbers with as many cells, of which two are known; None without one.
    """
    texts = enumerate(line.lstrip() for line in lines)
    first = next((i for i, text in texts if text and text[0] not in "#%"), 0)
    marks: list[Callable[[str], list[str]]] = [re.compile(mark).split for mark in ",;\t"]
    for split in [*marks, _words] if lines else ():
        width = len(row := split(lines[first].strip()))
        for index in range(first - 1, -1, -1) if all(_is_cell(c.strip()) for c in row) else ():
            text = lines[index].strip().lstrip("#% \t")
            cells = split(text)
            if len(cells) == width > 1 and sum(guess(cell) is not None for cell in cells) >= 2:
                return index, text + "\n"
    return None


def spaced_head(lines: Sequence[str], header: list[str]) -> list[str]:
    """The first lines from the header, with each of its cells in quotation marks and each
    unit below it one word."""
    head = [" ".join(f'"{cell}"' for cell in header) + "\n"]
    for line in lines[1 : 1 + _BELOW]:
        words, joined = _TOKEN.findall(line), list[str]()
        for word in words:
            if joined and known_unit(joined[-1] + word) and len(word) < 3:  # deg C
                joined[-1] += word
            else:
                joined.append(word)
        head.append(" ".join(joined if len(joined) == len(header) else words) + "\n")
    return head


def names_of_export(lines: Sequence[str], searched: Sequence[int], delimiter: str) -> int:
    """Index of the line of names in the export of a logger: the last one above the numbers
    that is as wide as they are and no row of units; else the line below the first blank one."""
    names: dict[int, int] = {}  # number of cells -> index of the last line of names with it
    for i in searched:
        row = [cell.strip(' "') for cell in next(csv.reader([lines[i]], delimiter=delimiter))]
        filled = [cell.replace(",", ".", 1) for cell in row if cell]
        if counts_up(row):
            continue
        if len(filled) > 1 and all(map(is_number, filled)):
            if len(row) in names:
                return names[len(row)]
            break
        if row[0] and known_unit(row[0]) is None:
            names[len(row)] = i
    return lines.index("\n") + 1 if "\n" in lines else 1


def find_header(
    lines: Sequence[str], searched: Sequence[int], is_known: IsKnown
) -> tuple[int, str, list[str]]:
    """Index of the header line, the delimiter, and its words if white space separates.

    Some systems write a title first: the header is the first of the searched lines with
    two recognised columns, or else the first as wide as the rows of numbers below it.
    White space separates if no delimiter gives columns and white space gives as many as
    the rows of numbers have.
    """

    def split(index: int, delimiter: str) -> tuple[int, int]:
        """Recognised columns and all columns of a line, which quotes may extend."""
        some = lines[index : index + _LONGEST]
        try:
            names = next(csv.reader(some, delimiter=delimiter, skipinitialspace=True))
        except csv.Error:  # too long for one cell
            return 0, 0
        return sum(is_known(name.strip()) for name in names), len(names)

    first = searched[0]
    best = {}
    for index in searched:
        widths = {delimiter: split(index, delimiter) for delimiter in _DELIMITERS}
        best[index] = max(_DELIMITERS, key=widths.__getitem__)
        if widths[best[index]][0] < 2:
            continue
        is_title = split(first, best[index])[1] < widths[best[index]][1]
        header = index if is_title else first
        if best[header] == "\t" and not any(
            "\t" in x for x in lines[header + 1 : header + _LONGEST]
        ):
            if spaced := _header_above_numbers(lines, [header], is_known):
                return header, SPACES, spaced[1]
        return header, best[header], []
    below = _header_above_numbers(lines, searched, is_known)
    if below and (below[0] != first or split(first, best[first])[1] == 1):
        return below[0], SPACES, below[1]
    for delimiter in _DELIMITERS:
        columns = [split(index, delimiter)[1] for index in searched]
        header = searched[columns.index(columns[-1])]
        cells = lines[header].split(delimiter)
        if columns[-1] > columns[0] > 0 and not any(map(is_number, cells)):
            return header, delimiter, []
    return first, best[first], []


def counts_up(row: list[str]) -> bool:
    """Whether a row holds the channel numbers 1, 2, 3, ..."""
    cells = [cell.strip() for cell in row if cell.strip()]
    return len(cells) > 1 and cells == [str(k + 1) for k in range(len(cells))]


def is_units_row(row: list[str], width: int, common: float) -> bool:
    """Whether a row has no numbers and at least the share ``common`` of known units."""
    cells = [cell.strip() for cell in row]
    stated = [cell for cell in cells if cell not in ("", "-")]
    if len(row) != width or not stated or any(map(is_number, cells)):
        return False
    known = sum(known_unit(cell) is not None for cell in stated)
    return known >= common * len(stated)
