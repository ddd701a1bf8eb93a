"""Write files completely or not at all, and convert content to JSON."""

import enum
import errno
import json
import math
import os
import shutil
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

PART = ".tirefit-part"
"""End of the name of a file that is not complete yet; the name begins with a dot."""


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


def replace_together(made: Mapping[Path, Path], gone: Iterable[Path] = ()) -> None:
    """Replace files that belong together, so that a killed process leaves no mixture.

    The last of ``made``, their document, is removed first and written last: whoever finds it,
    finds the others of the same result.

    Args:
        made: path -> the new file that is renamed to it.
        gone: earlier files that have no successor.

    Raises:
        OSError: a file could not be renamed; where a folder has its name, nothing is changed.
    """
    for path in made:
        if path.is_dir():  # found before the first file is replaced
            raise IsADirectoryError(errno.EISDIR, "there is a folder", str(path))
    earlier = [path for path in gone if os.path.lexists(path) and not path.is_dir()]
    if len(made) + len(earlier) > 1:
        [*made][-1].unlink(missing_ok=True)
    for path in earlier:
        path.unlink()
    for path, new in made.items():
        os.replace(new, path)


WRITING = ".tirefit-writing"
"""Beginning of the name of the folder to which a result is written until complete."""


def remove_left(folder: Path) -> None:
    """Remove temporary files and folders that killed processes left in a folder: those that
    were last written more than a day ago, which no living process needs."""
    for path in (*folder.glob(f".*{PART}"), *folder.glob(f"{WRITING}*")):
        with suppress(OSError):
            if time.time() - path.lstat().st_mtime > 86_400.0:
                shutil.rmtree(path) if path.is_dir() else path.unlink()


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
