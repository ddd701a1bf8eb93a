"""Damaged inputs of every kind that is read: an error with a remedy or a result.

``make fuzz`` tries 100,000 (``python -m fits.fuzz --inputs 100000 --seed 1``), the
suite 500. Sound files are damaged at random, by a seed: bits flip, spans vanish or
repeat, tokens are replaced by such as no reader expects; records of our own are changed
under a new checksum as well. A share of the inputs goes to whole commands, the others
to what reads them. Never a traceback, never more than 60 s or 2 GiB; what fails is
written beside its traceback.
"""

import signal
import tempfile
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tirefit.results import TirefitError

from .commands import COMMANDS
from .damage import changed_record, damaged
from .kinds import KINDS, Kind

__all__ = ["COMMANDS", "KINDS", "Failure", "damaged", "failures"]

SECONDS, GIGABYTES = 60, 2.0


class Failure(NamedTuple):
    """An input that gave neither a result nor a clean error."""

    kind: str
    number: int
    content: bytes
    text: str


class TooLong(BaseException):
    """An exception that no reader may catch."""


def _alarm(*_):
    raise TooLong(f"more than {SECONDS} s")


@contextmanager
def _bounded() -> Iterator[None]:
    """Limits the processor time in seconds; other processes may use it as well."""
    signal.signal(signal.SIGPROF, _alarm)
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)


def _tried(kind: Kind, path: Path) -> str:
    """The error while the file was read; empty if there was none."""
    try:
        with _bounded(), warnings.catch_warnings():
            warnings.simplefilter("error")
            kind.read(path)
    except TirefitError as error:
        whole = all(p.reason for p in error.problems) and error.problems
        return "" if whole else f"an error without a reason: {error!r}"
    except (Exception, TooLong):
        return traceback.format_exc()
    return ""


def _forget_peak() -> None:
    """Resets the largest memory in use, if the system allows it."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def _peak() -> float:
    """Largest memory in use since [GiB]."""
    with suppress(OSError):
        status = Path("/proc/self/status").read_text()
        return float(status.partition("VmHWM:")[2].split()[0]) / 2**20
    return 0.0


@cache
def _sound(kind: Kind) -> list[bytes]:
    return kind.sound()


def failures(inputs: int, seed: int, kinds=tuple(KINDS), whole: float = 0.0) -> Iterator[Failure]:
    """Every damaged input that failed; kinds take turns.

    Args:
        kinds: of :data:`KINDS` or :data:`COMMANDS`.
        whole: share of the inputs that go to a whole command.
    """
    with tempfile.TemporaryDirectory() as folder:
        for number in range(inputs):
            random = np.random.default_rng([seed, number])
            name = kinds[number % len(kinds)]
            if whole and random.random() < whole:
                name = list(COMMANDS)[int(random.integers(len(COMMANDS)))]
            kind = COMMANDS.get(name) or KINDS[name]
            sound = _sound(kind)
            one = sound[int(random.integers(len(sound)))]
            forged = kind.suffix == ".json" and random.random() < 0.5
            content = (changed_record if forged else damaged)(one, random)
            path = Path(folder, f"input{kind.suffix}")
            path.write_bytes(content)
            _forget_peak()
            before = _peak()
            text = _tried(kind, path)
            taken = _peak() - before
            if not text and taken > GIGABYTES:
                text = f"{taken:.1f} GiB taken"
            if text:
                yield Failure(name, number, content, text)
