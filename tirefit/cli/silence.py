"""A line on standard error while a command works for long without output.

Commands with parts of known number show them by a progress bar. The other parts, such as
reading a large file, report nothing while they last.
"""

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

_LATEST = [0.0]
"""Time of the latest output."""


def broken() -> None:
    """Record that the command prints something now."""
    _LATEST[0] = time.monotonic()


@contextmanager
def reported(most: float = 30.0) -> Iterator[None]:
    """Context manager: print a line after every ``most`` seconds without output."""
    begun, over = time.monotonic(), threading.Event()
    broken()

    def watch() -> None:
        while not over.wait(max(_LATEST[0] + most - time.monotonic(), 0.0)):
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
        over.set()
        watcher.join()  # its line would meet the end of the interpreter
