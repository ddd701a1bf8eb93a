"""Run a command on many files: here one by one, or by the workers of Dask.

A file that fails stops no other file. Workers write the results; they return the output of
the command for a file, and its record for the table of all results. Dask runs a file again, on
another worker, if the worker that had it died; it gives the file up after four deaths.
"""

import logging
import os
import pickle
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import chdir, contextmanager, redirect_stderr, redirect_stdout
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from tirefit import __version__
from tirefit.cli import options as cli
from tirefit.cli.notes import merged_notes
from tirefit.data.readers.extras import extra
from tirefit.results import DataError, ExitCode, TirefitError, UsageError

if TYPE_CHECKING:  # NumPy, which completion does not wait for
    from tirefit.data.records import FileRecord

Jobs = Annotated[int | None, cli.option("N", "number of processes that share the files", min=1)]
Scheduler = Annotated[
    cli.Text,
    cli.option("ADDRESS", "Dask scheduler whose workers share the files, e.g. tcp://host:8786"),
]


class Piece(NamedTuple):
    """A file, or files that are fitted together, and the folder or name of the results."""

    file: Any
    to: Any


class Outcome(NamedTuple):
    """Exit code and record of a file; of a worker also its output, error output and notes."""

    code: ExitCode
    record: "FileRecord"
    output: str = ""
    complained: str = ""
    notes: tuple[Any, ...] = ()


def worst_of(codes: Iterable[ExitCode]) -> ExitCode:
    """The smallest exit code above 0, in the order of severity."""
    return min((code for code in codes if code), default=ExitCode.OK)


Work = Callable[[Piece], tuple[ExitCode, "FileRecord"]]  # for workers it can be pickled


def _attempted(work: Work, piece: Piece) -> tuple[ExitCode, "FileRecord"]:
    """Run one file; neither a bad file nor a fault of the program stops the others."""
    try:
        return work(piece)
    except (TirefitError, OSError) as error:  # of OSError, the report was printed
        if isinstance(error, BrokenPipeError | UsageError):
            raise
        return _failed(piece, error)
    except Exception as error:
        reason = f"a fault of the program: {type(error).__name__}: {error}"
        remedy = "run the command on this file only to see where; please report it"
        return _failed(piece, DataError(reason, remedy, str(piece.file)))


def _failed(piece: Piece, error: TirefitError | OSError) -> tuple[ExitCode, "FileRecord"]:
    """Print the error; the exit code and the record of the file."""
    from tirefit.data.records import FAILED, FileRecord

    cli.complain(text := cli.error_text(error))
    problem = " ".join(text.partition("\n")[2].split())  # without "error:"
    code = error.exit_code if isinstance(error, TirefitError) else ExitCode.USAGE
    return code, FileRecord(str(piece.file), str(piece.to), "", FAILED, problem=problem)


class Sharing(NamedTuple):
    """Where the work is done: in this process, in several others, or on a cluster."""

    jobs: int | None = None
    scheduler: str | None = None

    @property
    def apart(self) -> bool:
        return self.jobs is not None or self.scheduler is not None

    def files(self, out: Path) -> list[Path]:
        """The table of all results and its page in ``out``, if processes share the files."""
        return [out / "results.parquet", out / "fleet.html"] if self.apart else []


def run_pieces(
    title: str, pieces: Sequence[Piece], work: Work, sharing: Sharing, out: Path
) -> Iterator[Outcome]:
    """Process every file, here or by workers; yield each outcome, in the order of the files.

    With one file, processed here, a fault of the program shows its traceback. Files that are
    shared among processes also get the table of all results and its page, in ``out``.
    """
    count = len(pieces)
    if not sharing.apart:
        with merged_notes(count > 1):
            for number, piece in enumerate(pieces, 1):
                if count > 1 and cli.has_terminal():
                    cli.complain(f"file {number} of {count}: {piece.file}")
                yield Outcome(*(work(piece) if count == 1 else _attempted(work, piece)))
        return
    from tirefit.data.records import FileRecord, records_into
    from tirefit.report.many_files import write_fleet_page

    there = partial(_apart, (os.getcwd(), __version__), pickle.dumps(work))
    out.mkdir(parents=True, exist_ok=True)
    records, (table_file, page) = list[FileRecord](), sharing.files(out)
    reason = "the workers that had this file died, each time that it was tried"
    remedy = "free memory if it is short, or run the command on this file only, without workers"
    with (
        merged_notes(count > 1) as notes,
        records_into(table_file) as table,
        cli.progress_bar(title) as progress,
        cluster(sharing.jobs and min(sharing.jobs, count), sharing.scheduler) as client,
    ):
        for piece, result in zip(pieces, shared(there, pieces, client), strict=True):
            lost = DataError(reason, remedy, str(piece.file))
            outcome = result or Outcome(*_failed(piece, lost))
            typer.echo(outcome.output, nl=False)
            typer.echo(outcome.complained, nl=False, err=True)
            notes += outcome.notes
            table.add(outcome.record)
            records.append(outcome.record)
            progress(len(records) / count, f"{len(records)} of {count} files")
            yield outcome
    write_fleet_page(records, page, title)
    cli.say(f"all results: {table_file}, {page}")


_CONNECT = 30.0  # seconds to wait for a scheduler and its first worker


@contextmanager
def cluster(jobs: int | None, scheduler: str | None = None) -> Iterator[Any]:
    """Open a client of the cluster at an address, or of a new one on this machine.

    Args:
        jobs: number of workers of a new cluster, which end with the block.

    Raises:
        DataError: Dask is not installed.
        UsageError: both are given, or no scheduler with a worker answers at the address.
    """
    if jobs and scheduler:
        remedy = "give one: --jobs starts a cluster on this machine"
        raise UsageError("--jobs together with --scheduler", remedy)
    dask = extra("dask", "files by several processes", "", "cluster")
    distributed = extra("distributed", "files by several processes", "", "cluster")
    # Its messages are for the administrator of a cluster; the errors below are for users.
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    of_new: dict[str, Any] = {
        "n_workers": jobs,
        "threads_per_worker": 1,
        "host": "127.0.0.1",
        "dashboard_address": "127.0.0.1:0",
        "silence_logs": logging.CRITICAL,
    }
    settings = {
        # Other files wait at the scheduler, not at a worker, whose death would fail them.
        "distributed.scheduler.worker-saturation": 1.0,
        # A worker's nanny restarts it. Dask would end the nanny if the worker had died and
        # was just restarting so long after an earlier death, 15 s by default.
        "distributed.deploy.lost-worker-timeout": "1 day",
    }
    how = {"timeout": _CONNECT, "set_as_default": False} | ({} if scheduler else of_new)
    with dask.config.set(settings):
        try:
            client = distributed.Client(scheduler, **how)
            client.wait_for_workers(1, timeout=_CONNECT)
        except (OSError, ValueError, TypeError) as error:
            reason = f"--scheduler: no scheduler with a worker answers at {scheduler}"
            remedy = "start `dask scheduler`, which prints its address, and `dask worker ADDRESS"
            raise UsageError(reason, f"{remedy} --nthreads 1 --nworkers auto`") from error
        with client:
            yield client


def shared(work: Callable[..., Any], pieces: Sequence[Any], client: Any) -> Iterator[Any]:
    """Yield ``work(piece)`` of every piece, in their order; None of one whose workers died.

    When the iteration stops early, or is interrupted, pieces that have not begun are cancelled.

    Raises:
        UsageError: the scheduler is gone.
    """
    from distributed.scheduler import KilledWorker

    futures = client.map(work, pieces, pure=False)
    try:
        for future in futures:
            try:
                result = future.result()
            except KilledWorker:
                result = None
            yield result
    except CancelledError:
        reason, remedy = "the connection to the scheduler is lost", "start it again, then --resume"
        raise UsageError(reason, remedy) from None
    finally:
        if client.status == "running":
            client.cancel(futures, force=True)


# --- In a worker ----------------------------------------------------------------------

_ALONE = threading.Lock()  # output is redirected for the whole process


def _apart(of_command: tuple[str, str], content: bytes, piece: Piece) -> Outcome:
    """Process one file in a worker without output. Errors of use are raised; Dask raises them
    again in the command.

    Args:
        of_command: working directory and version of the command.
        content: the work with what all files share, as bytes.
    """
    from tirefit.cli.start import start

    folder, version = of_command
    if version != __version__ or not os.path.isdir(folder):
        reason = f"a worker runs tirefit {__version__}; it needs {version} and the folder {folder}"
        raise UsageError(reason, "install the same for all workers, where the folder is mounted")
    start()  # before: JAX arrays of the work have 64 bits only then
    output, complained = cli.Unheard(), cli.Unheard()
    with _ALONE, redirect_stdout(output), redirect_stderr(complained), merged_notes() as held:
        with chdir(folder):
            code, record = _attempted(pickle.loads(content), piece)
        notes = tuple(held)
        held.clear()
    return Outcome(code, record, output.getvalue(), complained.getvalue(), notes)
