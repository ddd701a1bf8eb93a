"""Write files completely or not at all, and convert content to JSON."""

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
except ImportError:  # Windows has no such locks: two processes may write at once
    fcntl = None

PART = ".part"
"""End of the name of a file that is not complete yet; the name begins with a dot."""


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
    try:
        # In the same directory, so that renaming is one step of the file system.
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
        # The user does not know the temporary name, so name ``path``.
        raise _of(path, error) from None
    finally:
        with suppress(OSError):  # its folder may have been removed
            os.unlink(name)


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


def write_texts(texts: Mapping[Any, str]) -> None:
    """Write several files that belong together, as :func:`write_text_atomic`.

    All content is on the disk before the first file is replaced. If two processes write
    the same files, all of them are from one process.

    Args:
        texts: path -> content.

    Raises:
        OSError: naming the path that could not be written.
    """
    with ExitStack() as waiting:
        if len(texts) > 1:
            waiting.enter_context(_alone({Path(path).parent for path in texts}))
        # The context entered last is left first, so its file is replaced first.
        for path, text in reversed(list(texts.items())):
            temporary = waiting.enter_context(replacing(path))
            temporary.write_text(text, encoding="utf-8", newline="")


# --- two processes --------------------------------------------------------------

_PATIENCE = 2.0
"""Seconds to wait for another process, which replaces its files in far less time. A
folder may be locked longer, while another command runs in it."""


def took_lock(handle: int) -> bool:
    """Lock an open folder until its handle is closed; returns whether it succeeded.

    On a file system without locks it always succeeds.
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
