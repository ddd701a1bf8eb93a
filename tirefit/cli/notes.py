"""Notes on the reading of files: printed with each file, or merged for many."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from textwrap import fill

from tirefit.cli.options import complain, say

_held: list[tuple[str, list[str], list[str]]] | None = None
"""Notes that wait for those of other files: name, warnings, assumptions."""


def holds_notes() -> bool:
    """Whether notes wait for those of other files."""
    return _held is not None


def warn(*tables, assumed: Sequence[str] = (), beside: Sequence[str] = ()) -> None:
    """Print what may mean something else, now or with :func:`told_together`.

    Args:
        tables: what was read.
        assumed: assumptions of one table, which are printed together only.
        beside: warnings of one table that are not of its reading.
    """
    said = [*assumed] if holds_notes() else []
    notes = [(t.source.path, [*t.source.warnings, *beside], said) for t in tables]
    if _held is None:
        _tell(notes)
    else:
        _held.extend(notes)


def _tell(notes) -> None:
    from tirefit.data.merged import merged

    alone = f"{notes[0][0]}: " if len(notes) == 1 else ""
    for text in merged((name, doubts) for name, doubts, _ in notes):
        complain(f"warning: {alone}{text}")
    for text in merged((name, said) for name, _, said in notes):
        say(fill(f"assumed: {alone}{text}", 88, subsequent_indent=" " * 9))


@contextmanager
def told_together(many: bool = True) -> Iterator[list]:
    """Hold the notes on ``many`` files; print them merged at the end of the block.

    Yields:
        The notes that are printed then.
    """
    global _held
    before, held = _held, list[tuple[str, list[str], list[str]]]()
    _held = held if many else None
    try:
        yield held
    finally:
        _held = before
        if held:
            _tell(held)
