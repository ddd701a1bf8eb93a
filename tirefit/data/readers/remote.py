"""Files at an address (``s3://``, ``http://``, ...), used like paths."""

import glob
import os
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tirefit.data.readers.extras import extra
from tirefit.results import DataError

_ADDRESS = re.compile(r"[a-z][a-z0-9+.-]+(::[a-z][a-z0-9+.-]+)*://", re.IGNORECASE)
_PATTERN = re.compile(r"[*?\[]")
_FSSPEC = ("fsspec", "files behind an address")


@dataclass(frozen=True)
class RemoteFile:
    """An address with the methods of :class:`~pathlib.Path` that readers use.

    It may be any address of fsspec, also a chain such as ``gzip::s3://...``. Libraries
    (``s3fs``) and credentials that fsspec needs must be installed.
    """

    address: str

    def __str__(self) -> str:
        return self.address

    @property
    def name(self) -> str:
        """The last part of the path; for a chain, that of its file."""
        paths = (part.partition("://")[2] for part in self.address.split("::"))
        path = next(filter(None, paths), self.address).split("?")[0]
        return path.rstrip("/").rsplit("/", 1)[-1]

    def exists(self) -> bool:
        """False, as results cannot replace a remote file."""
        return False

    def open(self, mode: str = "rb") -> Any:
        """Open the file for reading bytes.

        Raises:
            OSError: it cannot be read; its text has the reason.
            DataError: fsspec is missing.
        """
        fsspec = extra(*_FSSPEC, self.address, "cluster")
        try:
            return fsspec.open(self.address, mode).open()
        except OSError:
            raise
        except Exception as error:  # each server has errors of its own; a library may be missing
            raise OSError(f"{type(error).__name__}: {error}") from error


Place = Path | RemoteFile
"""The place of a file: a path or an address."""


def file_at(place: str | os.PathLike[str] | RemoteFile) -> Place:
    """A path, or a file at an address."""
    if isinstance(place, RemoteFile):
        return place
    text = os.fspath(place)
    is_address = isinstance(text, str) and _ADDRESS.match(text)
    return RemoteFile(text) if is_address else Path(text)


def expanded(files: Iterable[Place]) -> list[Any]:
    """Replace patterns (``s3://rig/2024-*/*.csv``) by all files that match, sorted by name.

    Patterns serve for lists that are too long for a command line, and for addresses,
    which shells do not expand. A file with exactly that name has precedence.

    Raises:
        DataError: a pattern without a match, or a server that does not list files.
    """
    every: list[Place] = []
    for file in files:
        text, matches = str(file), [file]
        if isinstance(file, RemoteFile):
            # A question mark in an address begins a query.
            matches = _listed(text) if "*" in text else matches
        elif _PATTERN.search(text) and not file.exists():
            matches = [Path(name) for name in sorted(glob.glob(text, recursive=True))]
        if not matches:
            raise DataError("no file matches this pattern", "check the path", text)
        every += matches
    return every


def _listed(address: str) -> list[Place]:
    fsspec = extra(*_FSSPEC, address, "cluster")
    try:
        system, path = fsspec.core.url_to_fs(address)
        return [file_at(system.unstrip_protocol(name)) for name in sorted(system.glob(path))]
    except Exception as error:  # each server has errors of its own
        reason = f"the addresses cannot be listed: {type(error).__name__}: {error}"
        raise DataError(reason, "name the files", address) from error
