"""The command line in this process, with separate caches in a directory of the tests.

Nobody chose a cache for JAX, as for a user; the commands that tests start and the workers of a
cluster have the programs of the commands before them, and those of the last run.
"""

import os
import pickle
from contextlib import contextmanager, nullcontext
from pathlib import Path

import jax
import pytest
from jax.experimental.compilation_cache.compilation_cache import reset_cache
from typer.testing import CliRunner

from tirefit.cli import fleet
from tirefit.cli.commands import app


@contextmanager
def commands_cache():
    """No cache for JAX is set, and the cache of commands is in a test directory."""
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
        reset_cache()  # JAX would use the directory that it opened first
        yield
    for name, value in before.items():
        jax.config.update(name, value)
    reset_cache()


@pytest.fixture(scope="module", autouse=True)
def own_cache():
    """File by file: what has the scope of a package, which this folder is none, ends
    with the session. Tests of other folders would run the kept programs of commands,
    unchecked, and find nothing of what the other worker or the last run compiled."""
    with commands_cache():
        yield


@pytest.fixture(scope="module")
def two():
    """A client of a cluster of two workers. Even idle, they use a twentieth of the
    processor time, so one file holds all tests of them."""
    with fleet.cluster(2) as client:
        yield client


@pytest.fixture
def workers_here(monkeypatch):
    """The work of ``--jobs`` in this process, sent and returned as bytes: the workers of
    ``test_cli_fleet.py`` are real."""

    def here(work, pieces, client):
        for piece in pieces:
            taken, given = pickle.loads(pickle.dumps((work, piece)))
            yield pickle.loads(pickle.dumps(taken(given)))

    monkeypatch.setattr(fleet, "shared", here)
    monkeypatch.setattr(fleet, "cluster", lambda *how: nullcontext())


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


@pytest.fixture(scope="session")
def rendered_only():
    """A context: pictures are put together, but they hold no more than their kind, except
    in files with this word in their name."""

    @contextmanager
    def only(word):
        from tirefit.report.canvas import Picture

        render = Picture.write

        def written(picture, target, kind, **how):
            if not isinstance(target, Path):
                target.write(kind.encode())
            elif word in target.name:
                render(picture, target, kind, **how)
            else:
                target.write_bytes(kind.encode())

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(Picture, "write", written)
            yield

    return only


@pytest.fixture
def unrendered(rendered_only):
    with rendered_only("no file"):
        yield


@pytest.fixture
def no_figures(monkeypatch):
    """Fits write a ``fit.png`` without a picture: figures take half of the time of a command."""

    def figures(result, folder):
        (folder / "fit.png").write_text("no picture")
        return [folder / "fit.png"]

    monkeypatch.setattr("tirefit.report.fit.figures.save_figures", figures)
    monkeypatch.setattr("tirefit.report.fit.mf_figures.save_magic_formula", figures)
