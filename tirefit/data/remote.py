"""Files behind an address (``s3://``, ``http://``, ...), in the place of paths."""

import glob
import os
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from tirefit.data.extras import extra
from tirefit.results import DataError

_ADDRESS = re.compile(r"[a-z][a-z0-9+.-]+(::[a-z][a-z0-9+.-]+)*://", re.IGNORECASE)
_PATTERN = re.compile(r"[*?\[]")


@dataclass(frozen=True)
class RemoteFile:
    """What reading asks of a :class:`~pathlib.Path`, of an address.

    Any that fsspec knows, chains as ``gzip::s3://...`` too; what it needs beyond itself
    (``s3fs``, credentials) is its own.
    """

    address: str

    def __str__(self) -> str:
        return self.address

    @property
    def name(self) -> str:
        """The end of the path; of a chain, of the file that it comes to."""
        paths = (part.partition("://")[2] for part in self.address.split("::"))
        path = next(filter(None, paths), self.address).split("?")[0]
        return path.rstrip("/").rsplit("/", 1)[-1]

    @property
    def parent(self) -> "RemoteFile":
        return RemoteFile(self.address.rstrip("/").rsplit("/", 1)[0])

    def exists(self) -> bool:
        """Never on the disk, where results could replace it."""
        return False

    def iterdir(self) -> Iterable["RemoteFile"]:
        """Nothing: what else is there would be one more question to the server."""
        return ()

    def open(self, mode: str = "rb") -> Any:
        """The file, opened; bytes as they are.

        Raises:
            OSError: it cannot be read; its text says why.
            DataError: fsspec, or what it needs for this address, is not installed.
        """
        fsspec = _fsspec(self.address)
        try:
            return fsspec.open(self.address, mode).open()
        except ImportError as error:
            raise _lacks(self.address, error) from error
        except (OSError, DataError):
            raise
        except Exception as error:  # each server has errors of its own
            raise OSError(f"{type(error).__name__}: {error}") from error


Place = Path | RemoteFile
"""Where a file lies."""


def file_at(place: str | os.PathLike | RemoteFile) -> Place:
    """A path, or a file behind an address."""
    if isinstance(place, RemoteFile):
        return place
    text = os.fspath(place)
    is_address = isinstance(text, str) and _ADDRESS.match(text)
    return RemoteFile(text) if is_address else Path(text)


def expanded(files: Iterable[Place]) -> list[Any]:
    """Files whose names are patterns (``s3://rig/2024-*/*.csv``) as all that fit them,
    in the order of their names.

    A pattern is for what is longer than a command line may be, and for addresses, which
    no shell looks through. A file of exactly that name goes before.

    Raises:
        DataError: a pattern that nothing fits, or a server that does not list.
    """
    every: list[Place] = []
    for file in files:
        text = str(file)
        is_pattern = bool(_PATTERN.search(text))
        if isinstance(file, RemoteFile):
            # A question mark in an address asks the server for something.
            every += _listed(file) if "*" in text else [file]
        elif is_pattern and not file.exists():
            fitting = [Path(name) for name in sorted(glob.glob(text, recursive=True))]
            every += _some(fitting, text)
        else:
            every.append(file)
    return every


def _listed(file: RemoteFile) -> list[Place]:
    fsspec = _fsspec(file.address)
    try:
        system, path = fsspec.core.url_to_fs(file.address)
        names = sorted(system.glob(path))
    except ImportError as error:
        raise _lacks(file.address, error) from error
    except Exception as error:  # each server has errors of its own
        reason = f"the addresses cannot be listed: {type(error).__name__}: {error}"
        raise DataError(reason, "name the files", file.address) from error
    return _some([file_at(system.unstrip_protocol(n)) for n in names], file.address)


def _some(files: Sequence[Place], pattern: str) -> list[Place]:
    if not files:
        reason, remedy = "no file fits this pattern", "check the path"
        raise DataError(reason, remedy, pattern)
    return list(files)


def _fsspec(address: str) -> ModuleType:
    return extra("fsspec", "files behind an address", address, "cluster")


def _lacks(address: str, error: ImportError) -> DataError:
    scheme = address.split("://")[0]
    reason = f"files at {scheme}:// need a library that is not installed: {error}"
    return DataError(reason, "install it beside fsspec", address)
