"""Files out, whole or not at all, and content that JSON can hold."""

import enum
import json
import math
import os
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from types import ModuleType
from typing import Any

fcntl: ModuleType | None
try:
    import fcntl
except ImportError:  # Windows has no such locks: two processes are not kept apart
    fcntl = None

PART = ".part"
"""How the name of a file ends that is not whole yet; it begins with a point."""


def json_text(content: Any) -> str:
    """``content`` as a JSON document; see :func:`json_safe`."""
    return json.dumps(json_safe(content), indent=1, allow_nan=False) + "\n"


def json_safe(value: Any) -> Any:
    """The same content in what JSON has, at any depth.

    Arrays and tuples become lists, NumPy's scalars plain ones, members of an
    enumeration their names in lower case; a number that is not finite becomes None.
    """
    if isinstance(value, Mapping):
        return {str(key): json_safe(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [json_safe(item) for item in value]
    if isinstance(value, enum.Enum):
        return value.name.lower()
    if hasattr(value, "tolist"):  # of NumPy, which writing a text does not import
        return json_safe(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


@contextmanager
def replacing(path: str | os.PathLike) -> Iterator[Path]:
    """A file to write that becomes ``path`` at the end of the block.

    If the block fails or is interrupted, ``path`` holds what it held before.

    Raises:
        OSError: naming ``path``, if not written; a note says what is there.
    """
    path = Path(path)
    try:
        # In the same directory, so that replacing is one step of the file system.
        handle, name = tempfile.mkstemp(PART, f".{path.name}.", path.parent)
    except OSError as error:
        raise _of(path, error) from None
    os.close(handle)
    try:
        yield Path(name)
        os.chmod(name, _mode(path))
        os.replace(name, path)
    except OSError as error:
        if error.errno is None or error.filename not in (None, name):
            raise
        # A temporary name would mean nothing to the user.
        raise _of(path, error) from None
    finally:
        with suppress(OSError):  # it is gone with its folder
            os.unlink(name)


def _of(path: Path, error: OSError) -> OSError:
    """The error as one of ``path``."""
    named = OSError(error.errno, error.strerror, str(path))
    there = os.path.lexists(path)
    named.add_note("it is as it was before" if there else "nothing was written")
    return named


def _mode(path: Path) -> int:
    """Permissions of the file to replace, or those that open() would give."""
    if path.exists():
        return path.stat().st_mode & 0o777
    umask = os.umask(0)
    os.umask(umask)
    return 0o666 & ~umask


def write_text_atomic(path: str | os.PathLike, text: str) -> None:
    """Writes text as UTF-8 so that ``path`` holds all of it or what it held before."""
    write_texts({path: text})


def write_texts(texts: Mapping[Any, str]) -> None:
    """As :func:`write_text_atomic`, for files that belong together.

    Args:
        texts: path to content; all is on the disk before the first file is replaced,
            and of two processes that write the same files all are one's.

    Raises:
        OSError: naming the path that could not be written.
    """
    with ExitStack() as waiting:
        if len(texts) > 1:
            waiting.enter_context(_alone({Path(path).parent for path in texts}))
        # The last one that is entered is the first one to be replaced.
        for path, text in reversed(list(texts.items())):
            temporary = waiting.enter_context(replacing(path))
            temporary.write_text(text, encoding="utf-8", newline="")


# --- two processes --------------------------------------------------------------

_PATIENCE = 2.0
"""Seconds to wait for another process to replace its files, which takes far less; a
folder may be locked for as long as another command works at it."""


def took_lock(handle: int) -> bool:
    """Whether the open folder is this process's own now, until the handle is closed.

    A file system without locks locks out nobody.
    """
    if fcntl is None:
        return True
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        pass
    return True


@contextmanager
def _alone(folders: set[Path]) -> Iterator[None]:
    """Other processes wait to replace files in these folders until the block ends."""
    handles: list[int] = []
    until = time.monotonic() + _PATIENCE
    try:
        for folder in sorted(folders) if fcntl is not None else ():
            with suppress(OSError):  # writing into it will say what is wrong
                handles.append(os.open(folder, os.O_RDONLY))
                while not took_lock(handles[-1]) and time.monotonic() < until:
                    time.sleep(0.01)
        yield
    finally:
        for handle in handles:
            os.close(handle)
