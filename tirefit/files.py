"""Write files completely or not at all, and convert content to JSON."""

import enum
import errno
import json
import math
import os
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from types import ModuleType
from typing import Any

fcntl: ModuleType | None
try:
    import fcntl
except ImportError:  # Windows has no such locks: two processes may write at once
    fcntl = None

PART = ".tirefit-part"
"""End of the name of a file that is not complete yet, or that is replaced now; the name
begins with a dot."""

_MOVES = ".tirefit-moves"
"""End of the name of the journal of files that are being replaced together."""


def json_text(content: Any) -> str:
    """``content`` as a JSON document; see :func:`json_safe`."""
    return json.dumps(json_safe(content), indent=1, allow_nan=False) + "\n"


def json_safe(value: Any) -> Any:
    """The same content in the types of JSON, at any depth.

    Arrays and tuples become lists, NumPy scalars Python numbers, members of an
    enumeration their names in lower case; a number that is not finite becomes None.
    """
    if isinstance(value, Mapping):
        return {str(key): json_safe(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [json_safe(item) for item in value]
    if isinstance(value, enum.Enum):
        return value.name.lower()
    if hasattr(value, "tolist"):  # a NumPy value, recognised without importing NumPy
        return json_safe(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


@contextmanager
def replacing(path: str | os.PathLike) -> Iterator[Path]:
    """Context manager: a temporary file that is renamed to ``path`` at the end.

    If the block fails or is interrupted, ``path`` is not changed.

    Raises:
        OSError: naming ``path``, if it was not written; a note tells what it holds.
    """
    path = Path(path)
    with _temporary(path) as temporary:
        yield temporary
        os.chmod(temporary, _mode(path))
        os.replace(temporary, path)


@contextmanager
def _temporary(path: Path) -> Iterator[Path]:
    """Context manager: a temporary file beside ``path``, which errors name instead of it."""
    try:
        handle, name = _locked_file(path, PART)
    except OSError as error:
        raise _of(path, error) from None
    if fcntl is None:  # Windows renames no open file
        os.close(handle)
    try:
        yield Path(name)
    except OSError as error:
        if error.errno is None or str(error.filename or name) != name:
            raise
        # The user does not know the temporary name, so name ``path``.
        raise _of(path, error) from None
    finally:
        try:
            with suppress(OSError):  # its folder may have been removed
                os.unlink(name)
        finally:
            if fcntl is not None:
                os.close(handle)


def _locked_file(path: Path, end: str) -> tuple[int, str]:
    """Handle and name of a new file beside ``path``; its lock ends with this process."""
    while True:
        # In the same directory, so that renaming is one step of the file system.
        handle, name = tempfile.mkstemp(end, f".{path.name}.", path.parent)
        if took_lock(handle) and os.path.lexists(name):
            return handle, name
        os.close(handle)  # another process removes it, as it was not locked yet


@contextmanager
def _left(path: Path, without_locks: bool) -> Iterator[bool]:
    """Context manager: whether the process that wrote the file has ended; if so, no other
    process finds that within the block.

    Args:
        without_locks: the answer where the file system has no locks.
    """
    try:
        handle = os.open(path, os.O_RDONLY)
    except OSError:
        yield False
        return
    try:
        yield took_lock(handle, without_locks)
    finally:
        os.close(handle)


def replace_together(made: Mapping[Path, Path], gone: Iterable[Path] = ()) -> None:
    """Replace files that belong together, so that a killed process leaves no mixture.

    All earlier files are renamed before the first new one takes its place, the last of
    ``made`` first. Whoever finds the last file, finds the others of the same result. A
    journal tells :func:`remove_left` how to undo the work of a killed process.

    Args:
        made: path -> the new file that is renamed to it.
        gone: earlier files that have no successor.

    Raises:
        OSError: a file could not be renamed; then all are as before.
    """
    for path in made:
        if path.is_dir():  # found before the first file is replaced
            raise IsADirectoryError(errno.EISDIR, "there is a folder", str(path))
    places = list(dict.fromkeys([*gone, *made]))
    folders = {path.parent for path in places}
    for folder in folders:
        _undo_left(folder)
    for path in places:
        _aside(path).unlink(missing_ok=True)
    earlier = [path for path in reversed(places) if os.path.lexists(path)]
    moves = [*((path, _aside(path)) for path in earlier), *((made[path], path) for path in made)]
    journals: dict[Path, str] = {}
    with ExitStack() as handles:
        for folder in folders:
            handle, journals[folder] = _locked_file(folder / places[-1].name, _MOVES)
            handles.callback(os.close, handle)
            there = {p.name: p in earlier for p in places if p.parent == folder}
            Path(journals[folder]).write_text(json.dumps(there), encoding="utf-8")
        try:
            for one, other in moves:
                os.replace(one, other)
        except BaseException:  # Ctrl-C too
            for folder, journal in journals.items():
                _undo(folder, Path(journal))
            raise
        for journal in journals.values():
            os.unlink(journal)
    for path in earlier:
        with suppress(OSError):  # the next command in this folder removes it
            _aside(path).unlink()


def _aside(path: Path) -> Path:
    """The name of an earlier file while its successor takes its place."""
    return path.with_name(f".{path.name}.old{PART}")


def _undo(folder: Path, journal: Path) -> None:
    """Put the earlier files of a journal back, then remove it; may be repeated.

    The journal holds for each name, the last of a result last, whether there was a file.
    """
    try:
        known = json.loads(journal.read_text(encoding="utf-8"))
        there = {str(name): bool(was) for name, was in known.items() if Path(name).name == name}
    except (ValueError, AttributeError):  # it was not complete: nothing was moved
        there = {}
    replaced = {name: os.path.lexists(_aside(folder / name)) for name in there}
    for name, was in reversed(there.items()):
        if replaced[name] or not was:
            (folder / name).unlink(missing_ok=True)
    for name in there:
        if replaced[name]:
            os.replace(_aside(folder / name), folder / name)
    journal.unlink()


def _undo_left(folder: Path) -> None:
    for journal in folder.glob(f".*{_MOVES}"):
        with _left(journal, without_locks=True) as left:
            if left:
                _undo(folder, journal)


def remove_left(folder: Path) -> None:
    """Undo replacements that a killed process began, and remove its temporary files; those
    of living processes stay.

    Raises:
        OSError: an earlier file could not be put back; then nothing is removed.
    """
    _undo_left(folder)
    for path in folder.glob(f".*{PART}"):
        with _left(path, without_locks=False) as left, suppress(OSError):
            if left and not any(folder.glob(f".*{_MOVES}")):
                path.unlink()


def _of(path: Path, error: OSError) -> OSError:
    """The same error, naming ``path``."""
    named = OSError(error.errno, error.strerror, str(path))
    there = os.path.lexists(path)
    named.add_note("it is as it was before" if there else "nothing was written")
    return named


def _mode(path: Path) -> int:
    """Permissions of the file to replace, or those of a new file."""
    if path.exists():
        return path.stat().st_mode & 0o777
    umask = os.umask(0)
    os.umask(umask)
    return 0o666 & ~umask


def write_text_atomic(path: str | os.PathLike, text: str) -> None:
    """Write text as UTF-8; if that fails, ``path`` is not changed."""
    write_texts({path: text})


def write_texts(texts: Mapping[Any, str | bytes], gone: Iterable[Path] = ()) -> None:
    """Write several files that belong together, as :func:`write_text_atomic`.

    All content is on the disk before the first file is replaced. If two processes write
    the same files, or one is killed, all of them are from one process.

    Args:
        texts: path -> content; the document that the others belong to is the last.
        gone: earlier files of a result, which have no successor.

    Raises:
        OSError: naming the path that could not be written.
    """
    made: dict[Path, Path] = {}
    with ExitStack() as waiting:
        if len(texts) > 1:
            waiting.enter_context(_alone({Path(path).parent for path in texts}))
        for path, text in reversed([(Path(path), text) for path, text in texts.items()]):
            temporary = waiting.enter_context(_temporary(path))
            temporary.write_bytes(text if isinstance(text, bytes) else text.encode())
            os.chmod(temporary, _mode(path))
            made[path] = temporary
        gone = [path for path in gone if os.path.lexists(path)]
        if len(made) + len(gone) > 1:
            replace_together(dict(reversed(made.items())), gone)
        for path, temporary in made.items() if len(made) + len(gone) == 1 else ():
            os.replace(temporary, path)


# --- two processes --------------------------------------------------------------

_PATIENCE = 2.0
"""Seconds to wait for another process, which replaces its files in far less time. A
folder may be locked longer, while another command runs in it."""


def took_lock(handle: int, without_locks: bool = True) -> bool:
    """Lock an open file or folder until its handle is closed; returns whether it succeeded.

    Args:
        without_locks: the answer where the file system has no locks.
    """
    if fcntl is None:
        return without_locks
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return without_locks
    return True


@contextmanager
def _alone(folders: set[Path]) -> Iterator[None]:
    """Context manager: hold the locks of these folders, for which other processes wait."""
    handles: list[int] = []
    until = time.monotonic() + _PATIENCE
    try:
        for folder in sorted(folders) if fcntl is not None else ():
            with suppress(OSError):  # writing into the folder will raise the error
                handles.append(os.open(folder, os.O_RDONLY))
                while not took_lock(handles[-1]) and time.monotonic() < until:
                    time.sleep(0.01)
        yield
    finally:
        for handle in handles:
            os.close(handle)
