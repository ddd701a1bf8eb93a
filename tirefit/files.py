"""Files out, whole or not at all, and content that JSON can hold."""

import enum
import json
import math
import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

__all__ = ["json_safe", "json_text", "replacing", "write_text_atomic", "write_texts"]


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
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    if hasattr(value, "tolist"):
        return json_safe(value.tolist())
    return value


@contextmanager
def replacing(path: str | os.PathLike) -> Iterator[Path]:
    """A file to write that becomes ``path`` at the end of the block.

    If the block fails or is interrupted, ``path`` holds what it held before.

    Raises:
        OSError: naming ``path``, where it could not be written.
    """
    path = Path(path)
    try:
        # In the same directory, so that replacing is one step of the file system.
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None
    os.close(handle)
    try:
        yield Path(name)
        os.chmod(name, _mode(path))
        os.replace(name, path)
    except OSError as error:
        if error.errno is None or error.filename not in (None, name):
            raise
        # A temporary name would mean nothing to the user.
        raise OSError(error.errno, error.strerror, str(path)) from None
    finally:
        Path(name).unlink(missing_ok=True)


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
        texts: path to content; all is on the disk before the first file is replaced.

    Raises:
        OSError: naming the path that could not be written.
    """
    with ExitStack() as waiting:
        # The last one that is entered is the first one to be replaced.
        for path, text in reversed(list(texts.items())):
            temporary = waiting.enter_context(replacing(path))
            temporary.write_text(text, encoding="utf-8", newline="")
