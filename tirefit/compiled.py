"""The folder in which JAX stores compiled programs for later processes, and their release.

JAX finds an entry by the name of its file and runs the machine code in it. So the folder must
belong to the user, who alone may write to it, and an entry that was changed, renamed or planted
since it was listed is removed. A list holds the name, size and time of change of each entry.
"""

import atexit
import json
import os
import re
from contextlib import suppress
from pathlib import Path

import jax

from tirefit.files import replacing

_HAS_EMITTERS = jax.__version_info__ < (0, 11, 1)  # later versions refuse the option
BRIEF: dict[str, str | bool] = {"xla_cpu_use_fusion_emitters": False} if _HAS_EMITTERS else {}
"""``compiler_options`` of a program that takes longer to compile than to run in a process: it
compiles in 0.56 of the time (all programs of a first fit of ``carcass-beam``: 6.3 s instead of
11.1 s of processor time) and runs up to twice as long (eight searches of 400 rows: 78 instead of
65 ms for that model, 55 instead of 28 ms for ``carcass-thread``)."""

_MOST_ENTRIES = 2000
"""Largest number of stored entries: 30 models at up to 70 programs of 5 to 100 kB each."""

_MOST_MAPPINGS = 30_000
"""Number of memory mappings of a process above which its programs are released. A program
takes about 30. Linux allows 65,530; XLA ends the process at the next one."""

_ENTRY = re.compile(r".+-[0-9a-f]{64}-cache")
_LIST = "entries.json"


def why_unsafe(folder: Path) -> str | None:
    """Why another user could have written the programs in a folder; None if nobody could."""
    if not hasattr(os, "getuid"):  # Windows, where the folders of users are private
        return None
    status = folder.stat()
    if status.st_uid != os.getuid():
        return "it belongs to another user"
    return "other users can write to it" if status.st_mode & 0o022 else None


def open_entries(folder: Path) -> None:
    """Remove the entries of JAX that are not as listed; list all entries when Python ends."""
    listed = {}
    with suppress(OSError, ValueError, TypeError, RecursionError):
        listed = dict(json.loads((folder / _LIST).read_text(encoding="utf-8")))
    found = _entries(folder)
    newest = set(sorted(found, key=lambda name: found[name][1], reverse=True)[:_MOST_ENTRIES])
    for name in found:
        if found[name] != listed.get(name) or name not in newest:
            with suppress(OSError):  # another process may have removed it
                (folder / name).unlink()
    atexit.register(list_entries, folder)


def list_entries(folder: Path) -> None:
    """Write the list of the entries in a folder."""
    with suppress(OSError), replacing(folder / _LIST) as temporary:
        temporary.write_text(json.dumps(_entries(folder)), encoding="utf-8")


def _entries(folder: Path) -> dict[str, list[int]]:
    """Size [B] and time of the last change [ns] of each entry, by name."""
    found = {}
    with suppress(OSError), os.scandir(folder) as files:
        for file in files:
            with suppress(OSError):  # another process may have removed it
                if _ENTRY.fullmatch(file.name):
                    status = file.stat(follow_symlinks=False)
                    found[file.name] = [status.st_size, status.st_mtime_ns]
    return found


def release_programs(most: int = _MOST_MAPPINGS) -> bool:
    """Release all compiled programs if this process holds very many; returns whether.

    A process that fits thousands of files of many shapes and models would otherwise
    exceed a limit of the system. Programs needed later are compiled again or read from
    the folder. Call it between files only: counting takes up to 9 ms.

    Args:
        most: number of memory mappings above which programs are released. Nothing
            happens on systems that do not list them in ``/proc``.
    """
    try:
        with open("/proc/self/maps", "rb") as mappings:
            many = sum(1 for _ in mappings) > most
    except OSError:
        return False
    if many:
        jax.clear_caches()
    return many
