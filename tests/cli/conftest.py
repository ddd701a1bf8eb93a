"""The command line in this process, with separate caches in a directory of the tests.

A command keeps its traced programs beside the compiled ones where nobody chose a cache
for JAX, as a user's does; so do those that tests start and the workers of a cluster,
which then have the programs of the commands before them, and those of the last run.
"""

import os
from contextlib import ExitStack, contextmanager
from pathlib import Path

import jax
import pytest
from typer.testing import CliRunner

from tirefit.cli.cluster import cluster
from tirefit.cli.commands import app


@contextmanager
def commands_cache():
    """No cache for JAX is set, and the cache of commands is in a test directory."""
    from tirefit.compiled import keep_programs_in

    names = (
        "jax_compilation_cache_dir",
        "jax_persistent_cache_min_compile_time_secs",
        "jax_persistent_cache_min_entry_size_bytes",
    )
    before = {name: getattr(jax.config, name) for name in names}
    commands = Path(os.environ["TIREFIT_TESTS_COMPILED"], "commands")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(commands))
        patch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
        jax.config.update("jax_compilation_cache_dir", None)
        yield
    for name, value in before.items():
        jax.config.update(name, value)
    keep_programs_in(None)


@pytest.fixture(scope="module", autouse=True)
def own_cache():
    """File by file: what has the scope of a package, which this folder is none, ends
    with the session. Tests of other folders would run the traced programs of commands,
    unchecked, and find nothing of what the other worker or the last run compiled."""
    with commands_cache():
        yield


_SHARED = ExitStack()


@pytest.fixture(scope="session")
def two():
    """A client of a cluster of two workers, which end with the tests of this folder:
    even idle, they use a twentieth of the processor time of an xdist worker."""
    with commands_cache():
        return _SHARED.enter_context(cluster(2))


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown(item, nextitem):
    if nextitem is None or Path(__file__).parent not in nextitem.path.parents:
        _SHARED.close()


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Runs a command in an empty directory and checks its exit code."""
    monkeypatch.chdir(tmp_path)

    def command(*arguments, exit_code=0):
        result = CliRunner().invoke(app, [str(item) for item in arguments])
        if result.exception and not isinstance(result.exception, SystemExit):
            raise result.exception
        assert result.exit_code == exit_code, result.stdout + result.stderr
        return result

    return command
