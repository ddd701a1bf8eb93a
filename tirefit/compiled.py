"""The folder in which JAX stores compiled programs for later processes, and their release.

JAX finds an entry by the name of its file and runs the machine code in it. So the folder must
belong to the user, who alone may write to it.
"""

import os
from contextlib import suppress
from pathlib import Path

import jax

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


def why_unsafe(folder: Path) -> str | None:
    """Why another user could have written the programs in a folder; None if nobody could."""
    if not hasattr(os, "getuid"):  # Windows, where the folders of users are private
        return None
    status = folder.stat()
    if status.st_uid != os.getuid():
        return "it belongs to another user"
    return "other users can write to it" if status.st_mode & 0o022 else None


def remove_oldest(folder: Path) -> None:
    """Keep the newest of the programs that JAX stored in a folder."""
    with suppress(OSError):  # another process may have removed one
        entries = sorted(folder.glob("*-cache"), key=lambda path: path.stat().st_mtime_ns)
        for path in entries[:-_MOST_ENTRIES]:
            path.unlink()


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
