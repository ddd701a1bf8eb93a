"""Merge and count the notes on many files: :func:`merged`."""

import re
from collections.abc import Iterable

_VALUE = re.compile(r"([\w.+-]*\d[\w.+-]*)")
"""A word with a digit. Notes that differ in such words only are merged."""

_NAMED = 3
"""Largest number of files, or of values that are not numbers, that are listed."""


def merged(messages: Iterable[tuple[str, Iterable[str]]]) -> list[str]:
    """Each sentence once, with the files that it holds for.

    Sentences that differ in values only are merged, with the range of each value.

    Args:
        messages: name and sentences of each file.

    Returns:
        The sentences of a single file unchanged. Those of several files, in order of
        appearance: ``72 files: ...`` if all have it, ``a, b: ...`` if up to three have
        it, else ``5 of 72 files: ...``.
    """
    files = [(name, list(sentences)) for name, sentences in messages]
    if len(files) == 1:
        return files[0][1]
    kinds: dict[tuple[str, ...], tuple[dict[int, str], list[list[str]]]] = {}
    for number, (name, sentences) in enumerate(files):
        for sentence in sentences:
            parts = _VALUE.split(sentence)
            whose, values = kinds.setdefault(tuple(parts[::2]), ({}, []))
            whose[number] = name
            values.append(parts[1::2])
    return [
        f"{_files(list(whose.values()), len(files))}: {_sentence(words, values)}"
        for words, (whose, values) in kinds.items()
    ]


def _files(names: list[str], count: int) -> str:
    if len(names) == count:
        return f"{count} files"
    return ", ".join(names) if len(names) <= _NAMED else f"{len(names)} of {count} files"


def _sentence(words: tuple[str, ...], values: list[list[str]]) -> str:
    columns = zip(*values, strict=True)
    ranges = [_range(list(dict.fromkeys(column))) for column in columns]
    between = [text for pair in zip(words, [*ranges, ""], strict=True) for text in pair]
    return "".join(between)


def _range(values: list[str]) -> str:
    """One value, the list of up to ``_NAMED`` words, or the ends of the range."""
    if len(values) > 1:
        try:
            values = sorted(values, key=float)
        except ValueError:
            if len(values) <= _NAMED:
                return ", ".join(values)
        return f"{values[0]} to {values[-1]}"
    return values[0]
