"""Short names of runs: the parts in which the names differ, and their common pattern.

Files of one session share most of their names: ``drum_2026-03-12_cold_run01_brake``,
``drum_2026-03-12_cold_run02_brake``. Their short names are ``run01`` and ``run02`` of
``drum_2026-03-12_cold_*_brake``.
"""

import re
from collections.abc import Sequence
from functools import lru_cache
from os.path import commonprefix
from typing import NamedTuple

LONGEST = 18
"""Largest number of characters of a short name; names up to this length are kept."""


class RunNames(NamedTuple):
    """Short names of runs, all different, in order, and the pattern with ``*`` for them.

    It is empty if the names are kept, and if their differing parts are too long: the runs
    are then numbered.
    """

    short: tuple[str, ...]
    pattern: str


def clipped(text: str, most: int) -> str:
    """A text shortened to ``most`` characters by omitting its middle."""
    if len(text) <= most:
        return text
    end = (most - 1) // 2
    return f"{text[: most - 1 - end]}…{text[len(text) - end :]}"


def _shared(pieces: list[list[str]]) -> int:
    """Number of pieces with which all names begin, leaving each at least one more."""
    return min(len(commonprefix(pieces)), *(len(piece) - 1 for piece in pieces))


def _parts(names: Sequence[str]) -> tuple[str, list[str], str]:
    """The common beginning of all names, the own part of each, and the common end."""
    pieces = [re.findall(r"[^\W_]+|[\W_]+", name) or [name] for name in names]
    # The own part begins at a word, and one earlier if it is a number.
    first = _shared(pieces)
    if any(not parts[first][:1].isalnum() for parts in pieces):
        first = max(first - 1, 0)
    if all(parts[first].isdigit() for parts in pieces):
        first = max(first - 2, 0)
    tails = [piece[first:] for piece in pieces]
    last = _shared([tail[::-1] for tail in tails])
    differing = ["".join(tail[: len(tail) - last]) for tail in tails]
    return "".join(pieces[0][:first]), differing, "".join(tails[0][len(tails[0]) - last :])


@lru_cache(maxsize=64)
def _of_names(names: tuple[str, ...]) -> RunNames:
    if len(names) < 2 or max(map(len, names)) <= LONGEST:
        return RunNames(names, "")
    head, short, tail = _parts(names)
    if max(map(len, short)) <= LONGEST and len(set(short)) == len(names):
        return RunNames(tuple(short), f"{head}*{tail}" if head or tail else "")
    numbered = (f"{i}: {text}" for i, text in enumerate(short, 1))
    return RunNames(tuple(clipped(text, LONGEST) for text in numbered), "")


def run_names(names: Sequence[str]) -> RunNames:
    """Names that distinguish the runs, of at most 18 characters."""
    return _of_names(tuple(str(name) for name in names))


def label_of_run(label: str, runs: Sequence[str]) -> str:
    """``mu[run]`` with the short name of the run; other labels unchanged."""
    name, bracket, run = label.partition("[")
    whole = [str(run) for run in runs]
    if not bracket or run[:-1] not in whole:
        return label
    return f"{name}[{run_names(whole).short[whole.index(run[:-1])]}]"


def name_pattern(names: Sequence[str]) -> str:
    """Several names as one with ``*`` for the differing part; all if none is common."""
    if len(names) < 2:
        return "".join(names)
    head, _, tail = _parts(names)
    return f"{head}*{tail}" if head or tail else ", ".join(names)
