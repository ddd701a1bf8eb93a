"""The command line: the only package that prints, exits and switches on 64-bit floats.

Heavy imports are made by the commands only, so completion and ``--help`` are fast.
"""

import atexit
import gc
import os
import signal
import sys
from contextlib import suppress
from typing import NoReturn

__all__ = ["main"]


def main() -> None:
    """Run the ``tirefit`` command; Ctrl-C or SIGTERM ends it with exit code 130."""
    came = []

    def interrupt(number: int, _: object) -> NoReturn:
        came.append(number)
        raise KeyboardInterrupt

    # Set before NumPy is imported. For small matrices a second thread of OpenBLAS is no
    # gain, and spins while it waits (on two busy cores, a diagnosis of 900 rows took
    # 3.6 s of processor time with two threads, 0.5 s with one).
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # it would look for them
    # Diffrax adds checks to a program that call Python, and JAX stores no such program: a
    # simulated drive took 5.2 instead of 3.2 s of processor time. Without these checks, the
    # simulations read from the result whether the integration succeeded.
    os.environ.setdefault("EQX_ON_ERROR", "off")
    os.environ["MPLBACKEND"] = "agg"  # figures are only written to files
    # New objects after which Python looks for garbage. Imports make 370,000 that stay; at Python's
    # own 700, looking through them took 0.3 of the 2.6 s of a fit with figures. At 500,000 a loop
    # over files held 595 MiB, at this number and at 700 it held 357 MiB.
    gc.set_threshold(100_000)
    atexit.register(gc.freeze)  # at the end, a search for garbage would take 0.4 s
    # A job that a shell starts in the background ignores Ctrl-C: do not change that.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, interrupt)
    signal.signal(signal.SIGTERM, interrupt)
    try:
        # Imported here, so that Ctrl-C is answered during the imports as well.
        from tirefit.cli.commands import app

        app()
    except OSError as error:
        # The command could not print; it handles its own errors otherwise.
        if came:
            _end_interrupted()
        cause = error.strerror or error
        with suppress(OSError):
            print(f"error: {error.filename or 'output'}: {cause}", file=sys.stderr)
        sys.exit(2)
    except BaseException as end:
        # Some libraries turn an interrupt during their import into another error.
        if not came or (isinstance(end, SystemExit) and end.code != 130):
            raise
        _end_interrupted()
    finally:
        _drop_unwritten()


def _drop_unwritten() -> None:
    """Discard output that could not be written, for example to a full disk: Python would
    try again at its end, print a traceback and change the exit code to 120."""
    for stream in (sys.stdout, sys.stderr):
        try:
            if stream is not None:  # closed before Python began
                stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _end_interrupted() -> NoReturn:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    with suppress(OSError):
        print("interrupted: files written before are complete", file=sys.stderr)
    sys.exit(130)
