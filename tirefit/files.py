"""Write files completely or not at all, and convert content to JSON."""

import enum
import errno
import json
import math
import os
import shutil
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

PART = ".tirefit-part"
"""End of the name of a file that is not complete yet, or of a folder with earlier files; the
name begins with a dot."""

_EARLIER = f".earlier{PART}"


def listed(given: Any) -> list[Any]:
    """A single name or path as a list of one; else all of them."""
    return [given] if isinstance(given, str | os.PathLike) else list(given)


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
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
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
    name = ""
    try:
        # In the same directory, so that renaming is one step of the file system.
        handle, name = tempfile.mkstemp(PART, f".{path.name}.", path.parent)
        os.close(handle)
        yield Path(name)
    except OSError as error:
        if name and (error.errno is None or str(error.filename or name) != name):
            raise
        # The user does not know the temporary name, so name ``path``.
        raise _of(path, error) from None
    finally:
        with suppress(OSError):  # it was renamed, or its folder was removed
            os.unlink(name)


@contextmanager
def _locked(folder: Path, wait: bool = True) -> Iterator[bool]:
    """Context manager: whether no other command replaces files of the folder meanwhile.

    The system ends the lock with its process. Where folders cannot be locked (Windows, some
    network drives), the value is always True.
    """
    handle, free = None, True
    try:
        handle = os.open(folder, os.O_RDONLY)
        import fcntl  # not on Windows, where a folder cannot be opened

        fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except BlockingIOError:
        free = False
    except (ImportError, OSError):
        pass
    try:
        yield free
    finally:
        if handle is not None:
            os.close(handle)


def replace_together(made: Mapping[Path, Path], gone: Iterable[Path] = ()) -> None:
    """Replace files that belong together, so that a killed process leaves no mixture.

    Earlier files wait in a folder beside them until all new ones are in place. The last of
    ``made``, their document, is moved there first and written last: whoever finds it, finds
    the others of the same result. After a kill, :func:`remove_left` or the next replacement
    restores the earlier files. Another replacement in the same folder is waited for.

    Args:
        made: path -> the new file that is renamed to it.
        gone: earlier files that have no successor.

    Raises:
        OSError: a file could not be renamed; then all are as before.
    """
    for path in made:
        if path.is_dir():  # found before the first file is replaced
            raise IsADirectoryError(errno.EISDIR, "there is a folder", str(path))
    places = [*(path for path in gone if os.path.lexists(path) and not path.is_dir()), *made]
    lasts = {path.parent: path for path in places} if len(places) > 1 else {}
    with ExitStack() as locks:
        for folder in sorted(lasts):  # in one order, so that no two commands wait for each other
            locks.enter_context(_locked(folder))
        _replace_all(made, places, lasts)


def _replace_all(
    made: Mapping[Path, Path], places: Sequence[Path], lasts: Mapping[Path, Path]
) -> None:
    """Move the files of ``places`` aside and ``made`` to their paths, or restore all.

    Args:
        lasts: folder -> the last path in it; empty for a single file.
    """
    try:
        for last in lasts.values():
            _end(last, undo=not os.path.lexists(last))  # of a process that was killed
            _aside(last).mkdir()
        for path in reversed(places if lasts else []):
            kept = _aside(lasts[path.parent]) / path.name
            if os.path.lexists(path):
                os.replace(path, kept)
            else:
                kept.mkdir()  # states that there was no such file
        for path, new in made.items():
            os.replace(new, path)
    except BaseException as error:  # Ctrl-C too
        for last in lasts.values():
            _end(last, undo=True)
        if lasts and isinstance(error, OSError):  # the user does not know the names in the folder
            raise _of(places[-1], error) from None
        raise
    for last in lasts.values():
        _end(last, undo=False)


def _aside(last: Path) -> Path:
    """The folder in which earlier files wait until all new ones, ``last`` too, are in place."""
    return last.with_name(f".{last.name}{_EARLIER}")


def _end(last: Path, undo: bool) -> None:
    """Remove the folder of earlier files, after they are moved back if ``undo``: ``last`` at
    the end, and none over a file that was written since."""
    aside = _aside(last)
    if undo and aside.is_dir():
        moved = aside.stat().st_mtime_ns
        for kept in sorted(aside.iterdir(), key=lambda kept: kept.name == last.name):
            path = last.with_name(kept.name)
            if os.path.lexists(path) and path.lstat().st_mtime_ns > moved:
                continue
            if kept.is_dir():
                path.unlink(missing_ok=True)
            else:
                os.replace(kept, path)
    shutil.rmtree(aside, ignore_errors=True)


WRITING = ".tirefit-writing"
"""Beginning of the name of the folder to which a result is written until complete."""


def remove_left(folder: Path) -> None:
    """Remove what killed processes left in a folder.

    Earlier files whose replacement did not end are restored. Temporary files and folders that
    were last written more than a day ago are removed: no living process needs them. While
    another command replaces files of the folder, nothing is done.
    """
    with _locked(folder, wait=False) as free:
        for path in (*folder.glob(f".*{PART}"), *folder.glob(f"{WRITING}*")) if free else ():
            with suppress(OSError):
                if path.name.endswith(_EARLIER):
                    last = path.with_name(path.name[1:].removesuffix(_EARLIER))
                    _end(last, undo=not os.path.lexists(last))
                elif time.time() - path.lstat().st_mtime > 86_400.0:
                    if path.is_dir():
                        shutil.rmtree(path)
                    else:
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


def write_texts(texts: Mapping[Any, str | bytes], gone: Iterable[Path] = ()) -> None:
    """Write files that belong together as UTF-8, by :func:`replace_together`.

    All content is on the disk before the first file is replaced.

    Args:
        texts: path -> content; the document that the others belong to is the last.
        gone: earlier files of a result, which have no successor.

    Raises:
        OSError: naming the path that could not be written.
    """
    made: dict[Path, Path] = {}
    with ExitStack() as waiting:
        for path, text in [(Path(path), text) for path, text in texts.items()]:
            temporary = waiting.enter_context(_temporary(path))
            temporary.write_bytes(text if isinstance(text, bytes) else text.encode())
            os.chmod(temporary, _mode(path))
            made[path] = temporary
        replace_together(made, gone)
