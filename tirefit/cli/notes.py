"""Notes on the reading of files: printed with each file, or merged for many."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from textwrap import fill
from typing import TYPE_CHECKING

from tirefit.cli.options import complain, say

if TYPE_CHECKING:
    from tirefit.data.table import TireData


_held: list[tuple[str, list[str], list[str]]] | None = None
"""Notes of an open :func:`merged_notes`: file name, warnings, assumptions."""


def holds_notes() -> bool:
    """Whether notes are held until the end of :func:`merged_notes`."""
    return _held is not None


def warn(*tables: "TireData", assumed: Sequence[str] = (), beside: Sequence[str] = ()) -> None:
    """Print the warnings on tables, now or at the end of :func:`merged_notes`.

    Args:
        tables: data that were read.
        assumed: assumptions of one table, printed at the end of the block only.
        beside: further warnings on one table.
    """
    messages = [*assumed] if holds_notes() else []
    notes = [(t.source.path, [*t.source.warnings, *beside], messages) for t in tables]
    if _held is None:
        _print(notes)
    else:
        _held.extend(notes)


def _print(notes: Sequence[tuple[str, list[str], list[str]]]) -> None:
    from tirefit.data.merged import merged

    alone = f"{notes[0][0]}: " if len(notes) == 1 else ""
    for text in merged((name, doubts) for name, doubts, _ in notes):
        complain(f"warning: {alone}{text}")
    for text in merged((name, messages) for name, _, messages in notes):
        say(fill(f"assumed: {alone}{text}", 88, subsequent_indent=" " * 9))


@contextmanager
def merged_notes(many: bool = True) -> Iterator[list[tuple[str, list[str], list[str]]]]:
    """Hold the notes on files if they are ``many``; print them merged at the end.

    Yields:
        The notes that are held.
    """
    global _held
    before, held = _held, list[tuple[str, list[str], list[str]]]()
    _held = held if many else before
    try:
        yield held
    finally:
        _held = before
        if held:
            _print(held)
