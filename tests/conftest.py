"""What holds for every test: strict numerics, one compilation cache, an order of work.

64-bit floats, no silent rank promotion, shapes checked where the package states them.
Most of a test's time is compilation, so what one process compiled serves all others:
the workers of xdist, the commands that tests start, the kernels of notebooks, and the
next run. ``TIREFIT_TESTS_COMPILED`` names another directory for it. What is left to
compile is compiled the quicker of two ways.
"""

import gc
import os
import shutil
from importlib.metadata import version
from pathlib import Path

# Two workers have the cores: a second thread of linear algebra would only spin while it
# waits. The libraries read it when NumPy is first imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# As the command does: without checks that call Python, JAX stores the programs of the
# simulations. Equinox reads the variable when it is first imported.
os.environ.setdefault("EQX_ON_ERROR", "off")

import jax
import pytest
from jaxtyping import install_import_hook

if not hasattr(jax, "enable_x64"):  # JAX before 0.8 has it elsewhere
    from jax.experimental import enable_x64

    jax.enable_x64 = enable_x64

ROOT = Path(__file__).parents[1]
COMPILED = Path(
    os.environ.setdefault(
        "TIREFIT_TESTS_COMPILED", str(ROOT / "build" / f"tests-jax-{version('jax')}")
    )
)
_SETTINGS = {
    "jax_numpy_rank_promotion": "raise",
    "jax_compilation_cache_dir": str(COMPILED),
    "jax_persistent_cache_min_compile_time_secs": 0,
    "jax_persistent_cache_min_entry_size_bytes": -1,
    # What XLA would keep of its own, of GPUs alone: it names this directory in what an
    # entry is found by, so that nobody finds what a command compiled, or a copy holds.
    "jax_persistent_cache_enable_xla_caches": "none",
    # Where in the sources an operation comes from, which takes 1 % of the time to note.
    "jax_traceback_in_locations_limit": 0,
}
for _name, _value in _SETTINGS.items():
    jax.config.update(_name, _value)
    # The commands and kernels that tests start inherit it.
    os.environ[_name.upper()] = str(_value)
# XLA's older way to write loops compiles in 60 % of the time what runs as long (5.8
# instead of 9.3 s for the programs of a brush-d with slip noise), and most programs of
# a test run once. A program in one piece is the same code in 0.85 to 0.9 of the time,
# and takes 24 instead of 39 mappings (see below): pieces are for cores that idle. XLA
# reads them when the first program is compiled. Without optimisation, a quarter of the
# files took 305 instead of 383 s, all programs compiled anew; `make test-long`, whose
# programs run for longer, optimises them as for users.
_QUICKER = ["--xla_cpu_parallel_codegen_split_count=1"]
if jax.__version_info__ < (0, 11, 1):  # later ones know no older way, and stop at the name
    _QUICKER += ["--xla_cpu_use_fusion_emitters=false"]
_FLAGS = os.environ.get("XLA_FLAGS", "").split()
if not any("xla_backend_optimization_level" in flag for flag in _FLAGS):
    _QUICKER += ["--xla_backend_optimization_level=0", "--xla_llvm_disable_expensive_passes=true"]
os.environ["XLA_FLAGS"] = " ".join(dict.fromkeys([*_FLAGS, *_QUICKER]))
# Commands and kernels choose their precision themselves, which is tested.
jax.config.update("jax_enable_x64", True)

# Tracing makes objects by the million that live as long as the worker: at the usual
# thresholds a tenth of the suite's time (142 of 1,365 s) goes into looking at them.
gc.set_threshold(100_000, 20, 20)

# Annotations are checked at run time in the packages that state shapes. In `diagnosis`,
# which states none, the checks took 40 % of the time.
install_import_hook([f"tirefit.{room}" for room in ("fitting", "models", "sim")], "shapes.checked")

from tirefit.compiled import release_programs  # noqa: E402  after the hook

_MOST = 50_000
"""Entries from which on the cache is begun anew: one run writes a tenth of it, and of
none the size is asked, which takes seconds."""

_APART = ("test_fits.py", "test_notebooks.py")
"""Files of a few long tests: begun first, each test a piece of work of its own."""


def pytest_configure(config):
    """Begins the cache anew where it is large, or a run was cut short.

    JAX writes its entries in place, so an interrupted run may leave half an entry.
    """
    if hasattr(config, "workerinput"):
        return
    names = [name for _, _, files in os.walk(COMPILED) for name in files]
    marks = [name for name in names if name.startswith("running.")]
    alive = [_alive(int(mark.removeprefix("running."))) for mark in marks]
    if len(names) > _MOST or not all(alive):
        shutil.rmtree(COMPILED)
    COMPILED.mkdir(parents=True, exist_ok=True)
    _mark().touch()
    # In an empty home it lists the fonts, and says so to stderr where that takes 5 s:
    # here, before tests look at what commands print.
    import matplotlib.font_manager  # noqa: F401


def pytest_unconfigure(config):
    if not hasattr(config, "workerinput"):
        _mark().unlink(missing_ok=True)


def _mark() -> Path:
    return COMPILED / f"running.{os.getpid()}"


def _alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except OSError:
        return False
    return True


def pytest_runtest_teardown(item, nextitem):
    """Between files: a worker that keeps every program of 4,000 tests holds 7 GB in
    65,000 mappings, which is where Linux ends it."""
    if nextitem is not None and nextitem.path != item.path:
        release_programs(most=25_000)


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items):
    items.sort(key=lambda item: item.path.name not in _APART)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Whole files to one worker, which then has their fixtures and programs."""
    from xdist.scheduler import LoadScopeScheduling

    class ByFile(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file = nodeid.split("::")[0]
            return nodeid if file.endswith(_APART) else file

    config.option.loadscopereorder = False
    return ByFile(config, log)
