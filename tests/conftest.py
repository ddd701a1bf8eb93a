"""Strict numerics for every test: 64-bit floats, no silent rank promotion."""

import os
import shutil
import tempfile

import jax

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")

# What one process compiled serves the others; made by the first, which the workers of
# xdist inherit it from.
_OWNER = "TIREFIT_TESTS_COMPILED" not in os.environ
if _OWNER:
    os.environ["TIREFIT_TESTS_COMPILED"] = tempfile.mkdtemp(prefix="tirefit-tests-")
_COMPILED = os.environ["TIREFIT_TESTS_COMPILED"]
jax.config.update("jax_compilation_cache_dir", _COMPILED)
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)


def pytest_unconfigure():
    if _OWNER:
        shutil.rmtree(_COMPILED, ignore_errors=True)
