"""``jax.jit`` with the compiled programs stored on disk, for later processes.

JAX's own cache stores compiled programs as well, but a new process still traces and lowers every
function first. The name of a file here is a digest of everything that the program depends on: the
sources of the package, the versions of its libraries, the device with the features of its
processor, the flags of XLA, the pickled static arguments, and the structure, shapes and types of
the others. An unreadable file is rewritten; the programs used least recently are removed.

``brief`` marks a program that runs a few times in a process, so that it takes longer to
compile than to run: it is compiled with fewer optimisations.

A whole process ``tirefit fit --no-posterior`` of the brush (400 rows, figures included,
caches warm) takes 1.9 s of processor time instead of 2.5 s with JAX's cache alone,
``tirefit diagnose`` of the sample that ships, with figures, 5.3 s instead of 5.9 s
(medians of seven and of three alternating pairs on two shared, busy cores).
"""

import contextlib
import hashlib
import inspect
import io
import os
import pickle
import threading
from collections.abc import Callable, Iterator
from functools import cache, update_wrapper
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
from jax._src.lax.linalg import initialize_lapack
from jax._src.lib import xla_client
from jax.experimental.compilation_cache.compilation_cache import reset_cache
from jax.experimental.serialize_executable import deserialize_and_load, serialize

from tirefit.files import replacing

_directory: Path | None = None
_loaded: dict[tuple, Callable] = {}
_one_at_a_time = threading.Lock()

_MOST_PROGRAMS = 500
"""Largest number of stored programs: 30 models at 10 to 20 programs of 100 kB each."""

_ABOVE = ("cli", "report", "targets")
"""Rooms that no program depends on: imports go down only."""

_PLAINLY: dict[str, str | bool] = {"xla_cpu_use_fusion_emitters": False}
"""A program compiles in 0.56 of the time (all programs of a first fit of ``carcass-beam``: 6.3 s
instead of 11.1 s of processor time) and runs up to twice as long (eight searches of 400 rows: 78
instead of 65 ms for that model, 55 instead of 28 ms for ``carcass-thread``)."""

_MOST_MAPPINGS = 30_000
"""Number of memory mappings of a process above which its programs are released. A program
takes about 30. Linux allows 65,530; XLA ends the process at the next one."""


def keep_programs_in(directory: str | os.PathLike | None) -> None:
    """Store compiled programs in this directory from now on; None stores none."""
    global _directory
    _directory = None if directory is None else Path(directory)


def release_programs(most: int = _MOST_MAPPINGS) -> bool:
    """Release all compiled programs if this process holds very many; returns whether.

    A process that fits thousands of files of many shapes and models would otherwise
    exceed a limit of the system. Programs needed later are compiled again or read from
    the caches on disk. Call it between files only: counting takes up to 9 ms.

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
        _loaded.clear()
        jax.clear_caches()
    return many


@cache
def _sources() -> bytes:
    """Digest of the sources of the package and of the libraries that it traces."""
    digest, package = hashlib.sha256(), Path(__file__).parent
    for file in sorted(package.rglob("*.py")):
        if file.relative_to(package).parts[0] not in _ABOVE:
            digest.update(file.read_bytes())
    for library in ("jax", "jaxlib", "equinox", "optimistix", "jaxopt"):
        digest.update(version(library).encode())
    return digest.digest()


def _device() -> str:
    """The device that programs are compiled for, the features of its processor, and the
    flags of XLA."""
    device = jax.devices()[0]
    features = xla_client.get_topology_for_devices([device]).fingerprint()
    flags = os.environ.get("XLA_FLAGS")
    return f"{device.platform} {device.device_kind} {features} {flags}"


class Compiled:
    """A function jitted by ``jax.jit``, with its compiled programs stored on disk."""

    def __init__(self, function: Callable, static: tuple[str, ...], brief: bool):
        update_wrapper(self, function)
        self._options = _PLAINLY if brief else None
        self._function, self._static = function, static
        self._signature = inspect.signature(function)
        self._jitted = jax.jit(function, static_argnames=static)

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        if _directory is None:
            return self._jitted(*args, **kwargs)
        bound = self._signature.bind(*args, **kwargs)
        bound.apply_defaults()
        static = {name: bound.arguments[name] for name in self._static}
        dynamic = {k: v for k, v in bound.arguments.items() if k not in static}
        leaves, structure = jax.tree.flatten(dynamic)
        if any(isinstance(leaf, jax.core.Tracer) for leaf in leaves):
            return self._jitted(*args, **kwargs)
        # A Magic Formula has a hundred numbers, whose types cost as much as its forces.
        scalars = {type(one): jax.typeof(one).str_short() for one in (0.0, 0, False)}
        shapes = [scalars.get(type(one)) or jax.typeof(one).str_short() for one in leaves]
        key = (self, *static.values(), structure, *shapes)
        if key not in _loaded:
            _loaded[key] = self._program(static, structure, leaves, shapes)
        return _loaded[key](leaves)

    def _program(self, static: dict, structure, leaves: list, shapes) -> Callable:
        def flat(leaves):
            return self._function(**jax.tree.unflatten(structure, leaves), **static)

        try:
            given = jax.tree.unflatten(structure, shapes), static, self._options
            path = _path(self._function, given)
        except (pickle.PicklingError, AttributeError):
            # Arguments that cannot be pickled: only the cache of JAX stores the program.
            return jax.jit(flat, compiler_options=self._options)
        program = _kept(path)
        if program is None:
            lowered = jax.jit(flat).lower(leaves)
            with _without_cache_of_jax():
                program = lowered.compile(compiler_options=self._options)
            _write(path, program, "lapack_" in lowered.as_text())
        return program


def _path(function: Callable, given: Any) -> Path:
    """The file of a function's program for these arguments."""
    assert _directory is not None  # the caller checks it
    content = io.BytesIO(_sources())
    content.seek(0, io.SEEK_END)
    pickler = pickle.Pickler(content)
    pickler.fast = True  # equal arguments give equal bytes, even if they share objects
    pickler.dump((_device(), function.__qualname__, given))
    key = hashlib.sha256(content.getvalue()).hexdigest()
    return _directory / f"{function.__name__}-{key[:32]}.program"


def _kept(path: Path) -> Callable | None:
    """The program in a file; None if it is absent or damaged."""
    try:
        (program, given, found), calls_lapack = pickle.loads(path.read_bytes())
        if calls_lapack:  # JAX does so where it traces; without, the process would crash
            initialize_lapack()
        kept = deserialize_and_load(program, given, found, execution_devices=jax.devices()[:1])
    except Exception:
        return None
    with contextlib.suppress(OSError):  # in a directory of another user
        os.utime(path)  # mark it as used now
    return kept


def _evict(directory: Path) -> None:
    """If there are too many programs, remove those used least recently."""

    def used(path: Path) -> float:
        with contextlib.suppress(OSError):  # another process may have removed it
            return path.stat().st_mtime
        return 0.0

    programs = sorted(directory.glob("*.program"), key=used, reverse=True)
    for path in programs[_MOST_PROGRAMS:]:
        path.unlink(missing_ok=True)


def _write(path: Path, program: jax.stages.Compiled, calls_lapack: bool) -> None:
    """Write a program completely or not at all. A program that cannot be stored, as one that
    calls Python or in a directory without permission, still runs."""
    with contextlib.suppress(Exception):
        content = pickle.dumps((serialize(program), calls_lapack))
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as temporary:
            temporary.write_bytes(content)
        _evict(path.parent)


@contextlib.contextmanager
def _without_cache_of_jax() -> Iterator[None]:
    """A program that JAX read from its own cache cannot be written again: it would lack
    its code, and fail where it is used."""
    with _one_at_a_time:
        jax.config.update("jax_enable_compilation_cache", False)
        reset_cache()
        try:
            yield
        finally:
            jax.config.update("jax_enable_compilation_cache", True)
            reset_cache()


def compiled(
    *, static: tuple[str, ...] = (), brief: bool = False
) -> Callable[[Callable], Compiled]:
    """Decorator: compile a function of arrays, and store its programs between runs.

    Args:
        static: names of hashable arguments that are part of the program.
        brief: whether the program takes longer to compile than to run in a process.
    """
    return lambda function: Compiled(function, static, brief)
