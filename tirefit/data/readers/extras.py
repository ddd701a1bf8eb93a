"""Import libraries that only some kinds of files need, when such a file is read."""

import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType

from tirefit.results import DataError


def extra(
    module: str, kind: str, file: str, group: str = "files", doing: str = "reading"
) -> ModuleType:
    """The module that reads ``kind`` of files, of the extra ``tirefit[group]``.

    Raises:
        DataError: it is not installed; the remedy is the command that installs it.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        library = module.split(".")[0]
        reason = f"{doing} {kind} needs {library}, which is not installed"
        remedy = f"pip install 'tirefit[{group}]' (or: pip install {library})"
        raise DataError(reason, remedy, file) from error


@contextmanager
def readable(kind: str, file: str, remedy: str) -> Iterator[None]:
    """Context manager: an error of the library that reads a damaged file becomes a DataError."""
    try:
        yield
    except DataError:
        raise
    except Exception as error:  # libraries raise many kinds
        reason = f"the {kind} cannot be read: {type(error).__name__}: {error}"
        raise DataError(reason, remedy, file) from error
