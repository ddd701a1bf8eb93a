"""Directories of results: one process at a time, and all of a result or none of it."""

import os
import shutil
import signal
import threading
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import ModuleType

from tirefit.results import InputProblem, UsageError

fcntl: ModuleType | None
try:
    import fcntl
except ImportError:  # Windows has no such locks: two processes are not kept apart
    fcntl = None

__all__ = ["check_directories", "claimed", "is_page", "staged"]


def check_directories(directories: Sequence[Path]) -> None:
    """Raises UsageError for those that cannot be made or written to; before the work.

    They are made later, with the folders above them.
    """
    problems = []
    for directory in directories:
        there = next(p for p in (directory, *directory.absolute().parents) if _is(p))
        reason, remedy = "", "choose another folder with --out"
        if not there.is_dir():
            what = "it is" if there == directory else f"{there} is"
            reason = f"no folder for the results: {what} a file"
        elif not os.access(there, os.W_OK | os.X_OK):
            reason = f"no permission to write into the folder {there.absolute()}"
        if reason:
            problems.append(InputProblem(reason, remedy, str(directory)))
    if problems:
        raise UsageError(problems)


def _is(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:  # no permission to look
        return False


@contextmanager
def claimed(directory: Path) -> Iterator[None]:
    """Makes the directory and keeps other processes out of it until the block ends.

    What was made is removed again if nothing came into it.

    Raises:
        UsageError: another process has claimed it.
    """
    made = [path for path in (directory, *directory.parents) if not path.exists()]
    directory.mkdir(parents=True, exist_ok=True)
    # A lock on the directory itself ends with the process, however that ends, and
    # leaves no file behind.
    handle = None if fcntl is None else os.open(directory, os.O_RDONLY)
    try:
        if handle is not None:
            _lock(handle, directory)
        for left in directory.glob(f"{_WRITING}*"):  # of a process that was killed
            shutil.rmtree(left, ignore_errors=True)
        yield
    finally:
        for path in made:
            with suppress(OSError):  # not empty
                path.rmdir()
        if handle is not None:
            os.close(handle)


def _lock(handle: int, directory: Path) -> None:
    assert fcntl is not None  # else there is no handle
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise UsageError(
            InputProblem(
                "another tirefit is writing its results into this folder",
                "wait until it has ended, or choose another folder with --out",
                str(directory),
            )
        ) from None
    except OSError:
        pass  # a file system without locks


_WRITING = ".writing"
"""How the folder begins that a result is written to, before it is whole."""


@contextmanager
def staged(directory: Path, known: Collection[str], apart: str = "") -> Iterator[Path]:
    """A folder to write a result to; its files move to ``directory`` at the end.

    If the block fails or is interrupted, ``directory`` holds what it held before.

    Args:
        directory: claimed by this process, or by the one that shares its work.
        known: files of an earlier result: those that are not written again are
            removed, as they would be taken for this one's.
        apart: end of the folder's name, where processes write at the same time.
    """
    folder = directory / f"{_WRITING}{apart}"
    shutil.rmtree(folder, ignore_errors=True)  # of a process that was killed
    folder.mkdir()
    try:
        yield folder
        with _interrupts_held():
            for name in known:
                if not (folder / name).exists():
                    (directory / name).unlink(missing_ok=True)
            for path in folder.iterdir():
                os.replace(path, directory / path.name)
    except OSError as error:
        # A temporary name would mean nothing to the user.
        error.filename, error.filename2 = str(directory), None
        raise
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def is_page(path: Path, schema: str) -> bool:
    """Whether an earlier command wrote this page: a file of the same name may be the
    user's own, as beside the data."""
    try:
        return schema in path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return False


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Ctrl-C and a request to end wait for the end of the block: they cannot come
    between two files."""
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread is interrupted
        return
    came: list[int] = []
    before = {
        number: signal.signal(number, lambda number, _: came.append(number))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if came:
        signal.raise_signal(came[0])
