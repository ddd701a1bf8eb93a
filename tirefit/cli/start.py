"""Start JAX: 64-bit floats, variables of the environment that it refuses, stored programs."""

import os
import warnings
from pathlib import Path
from typing import Any

from tirefit.results import UsageError

_READ_BY_JAX = ("JAX_", "XLA_", "EQX_")
"""First letters of the environment variables of JAX, its compiler and Equinox."""

SET_HERE = {"EQX_ON_ERROR": "off"}
"""Variables that the command sets where the user does not. Diffrax adds checks to a
program that call Python, and JAX stores no such program: a simulated drive took 5.2
instead of 3.2 s of processor time. Without these checks, the simulations read from the
result whether the integration succeeded."""

_SETTINGS = {
    "jax_enable_x64": True,
    # For debugging JAX programs; here NaN and infinity mark missing values and open ends.
    "jax_debug_nans": False,
    "jax_debug_infs": False,
    "jax_disable_jit": False,
    "jax_check_tracer_leaks": False,
    "jax_numpy_dtype_promotion": "standard",
    "jax_transfer_guard": "allow",
}
"""Settings of JAX that commands need, whatever the environment says."""


def start() -> str | None:
    """Start JAX and open the folder of stored programs; returns a warning for the user, or
    None.

    Raises:
        UsageError: JAX does not start with variables of the environment; it names them.
    """
    try:
        import equinox  # noqa: F401  reads variables of its own
        import jax

        jax.devices()
    except Exception as error:
        raise _of_variables(error) from error
    for name, value in _SETTINGS.items():
        jax.config.update(name, value)
    # On a full disk, programs are compiled again, which is only slower.
    reason = "Error (reading|writing) persistent compilation cache"
    warnings.filterwarnings("ignore", message=reason)
    # JAX declares its options to no type checker.
    if jax.config.jax_compilation_cache_dir is None:  # type: ignore[attr-defined]
        return _store_programs(jax.config)
    return None


def _of_variables(error: Exception) -> Exception:
    """A UsageError that names the variables of the environment in the error of JAX, or all
    that JAX reads; the same error if none is set."""
    given = {k: v for k, v in os.environ.items() if k.startswith(_READ_BY_JAX)}
    given = dict(given.items() - SET_HERE.items())
    cause = " ".join(str(error).split())
    mentioned = [name for name in given if name.lower() in cause.lower()]
    # The error of JAX has no text if it knows the platform and finds no device of it.
    names = mentioned or [name for name in given if name == "JAX_PLATFORMS"] or [*given]
    named = {name: given[name] for name in names}
    if not named:
        return error
    reason = f"JAX does not start with {', '.join(f'{k}={v!r}' for k, v in named.items())}"
    cause = f": {cause[:200]}" if cause else ""
    return UsageError(reason + cause, f"correct or unset {', '.join(named)}")


def _store_programs(config: Any) -> str | None:
    """Have JAX store programs in the folder of the user; returns a warning if the folder is
    not safe, else None."""
    from tirefit.compiled import open_entries, why_unsafe

    try:
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        folder = Path(base) / "tirefit"
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        unsafe = why_unsafe(folder)
    except (OSError, RuntimeError):  # a read-only disk; a user without a home
        return None
    if unsafe:
        remedy = "make it yours alone (chmod 700), or set XDG_CACHE_HOME to another folder"
        return f"warning: {folder} is not used for compiled programs: {unsafe}: {remedy}"
    if os.access(folder, os.W_OK | os.X_OK):
        open_entries(folder)
        config.update("jax_compilation_cache_dir", str(folder))
        config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
        config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    return None
