"""A line on standard error while a command works for long without output.

Commands with parts of known number show them by a progress bar. The other parts, such as
reading a large file, report nothing while they last.
"""

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

_MOST = 30.0
"""Seconds without output until a line is printed, and between two lines."""

_LATEST = [0.0]
"""Time of the latest output."""

_OVER = threading.Event()
"""Whether no more lines are printed."""


def broken() -> None:
    """Record that the command prints something now."""
    _LATEST[0] = time.monotonic()


def expected() -> None:
    """Print no more lines: from now on the command waits for its input."""
    _OVER.set()


@contextmanager
def reported(most: float = _MOST) -> Iterator[None]:
    """Context manager: print a line after every ``most`` seconds without output."""
    begun = time.monotonic()
    _OVER.clear()
    broken()

    def watch() -> None:
        while not _OVER.wait(max(_LATEST[0] + most - time.monotonic(), 0.0)):
            if time.monotonic() - _LATEST[0] >= most:
                broken()
                with suppress(OSError):
                    passed = time.monotonic() - begun
                    print(f"still at work, for {passed:.0f} s", file=sys.stderr, flush=True)

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield
    finally:
        _OVER.set()
        watcher.join()  # its line would meet the end of the interpreter
