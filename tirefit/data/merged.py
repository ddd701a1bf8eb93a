"""Sentences on the reading of many files, merged and counted: :func:`merged`."""

import re
from collections.abc import Iterable

_VALUE = re.compile(r"([\w.+-]*\d[\w.+-]*)")
"""A word with a digit: files differ in these where they say the same."""

_NAMED = 3
"""Files, or values that are no numbers, up to which each is listed."""


def merged(said: Iterable[tuple[str, Iterable[str]]]) -> list[str]:
    """Each sentence once, with how many files it holds for.

    Sentences that differ in values alone become one, with the range of each value.

    Args:
        said: name and sentences of each file.

    Returns:
        The sentences of a single file as they are; of several ``72 files: ...`` where
        all have it, ``a, b: ...`` where up to three have it, else ``5 of 72 files:
        ...``, in order of appearance.
    """
    files = [(name, list(sentences)) for name, sentences in said]
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
    return (
        ", ".join(names) if len(names) <= _NAMED else f"{len(names)} of {count} files"
    )


def _sentence(words: tuple[str, ...], values: list[list[str]]) -> str:
    columns = zip(*values, strict=True)
    ranges = [_range(list(dict.fromkeys(column))) for column in columns]
    between = [text for pair in zip(words, [*ranges, ""], strict=True) for text in pair]
    return "".join(between)


def _range(values: list[str]) -> str:
    """A value, all of few, or the ends of their range."""
    if len(values) > 1:
        try:
            values = sorted(values, key=float)
        except ValueError:
            if len(values) <= _NAMED:
                return ", ".join(values)
        return f"{values[0]} to {values[-1]}"
    return values[0]
