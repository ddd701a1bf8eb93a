"""Merge and count the notes on many files: :func:`merged`."""

import re
from collections.abc import Iterable

_VALUE = re.compile(r"([\w.+-]*\d[\w.+-]*)")
"""A word with a digit. Notes that differ in such words only are merged."""

_NAMED = 3  # largest number of files, or of values that are not numbers, that are listed


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
    out = []
    for words, (whose, values) in kinds.items():
        where = ", ".join(whose.values())
        if len(whose) == len(files):
            where = f"{len(files)} files"
        elif len(whose) > _NAMED:
            where = f"{len(whose)} of {len(files)} files"
        ranges = [_range(list(dict.fromkeys(column))) for column in zip(*values, strict=True)]
        between = [text for pair in zip(words, [*ranges, ""], strict=True) for text in pair]
        out.append(f"{where}: {''.join(between)}")
    return out


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
