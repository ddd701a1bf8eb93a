"""Start JAX: 64-bit floats, variables of the environment that it refuses, stored programs."""

import os
import warnings
from pathlib import Path
from typing import Any

from tirefit.results import UsageError

_READ_BY_JAX = ("JAX_", "XLA_", "EQX_")
"""First letters of the environment variables of JAX, its compiler and Equinox."""


def start() -> str | None:
    """Start JAX and open the folder of stored programs; returns a warning for the user, or
    None.

    Raises:
        UsageError: JAX does not start with the variables of the environment.
    """
    try:
        import equinox  # noqa: F401  reads variables of its own
        import jax

        jax.devices()
    except Exception as error:
        given = [name for name in os.environ if name.startswith(_READ_BY_JAX)]
        if not given:
            raise
        reason = f"JAX does not start: {' '.join(str(error).split())[:200]}"
        raise UsageError(reason, f"correct or unset {', '.join(given)}") from error
    jax.config.update("jax_enable_x64", True)
    # On a full disk, programs are compiled again, which is only slower.
    reason = "Error (reading|writing) persistent compilation cache"
    warnings.filterwarnings("ignore", message=reason)
    # JAX declares its options to no type checker.
    if jax.config.jax_compilation_cache_dir is None:  # type: ignore[attr-defined]
        return _store_programs(jax.config)
    return None


def _store_programs(config: Any) -> str | None:
    """Have JAX store programs in the folder of the user; returns a warning if the folder is
    not safe, else None."""
    from tirefit.compiled import remove_oldest, why_unsafe

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
        remove_oldest(folder)
        config.update("jax_compilation_cache_dir", str(folder))
        config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
        config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    return None
