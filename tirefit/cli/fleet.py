"""Run a command on many files: here one by one, or by the workers of a cluster.

A file that fails stops no other file. Workers write the results; they return the output of
the command for a file, and its record for the table of all results. Each file is a task of
Dask that carries all it needs: Dask runs it again, on another worker, if the worker that had
it died; it gives the task up after four deaths.
"""

import logging
import os
import pickle
import threading
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack, chdir, closing, contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from tirefit import __version__
from tirefit.cli.notes import merged_notes
from tirefit.cli.options import (
    Text,
    Unheard,
    complain,
    error_text,
    has_terminal,
    option,
    progress_bar,
    say,
)
from tirefit.cli.output import swept
from tirefit.results import DataError, ExitCode, InputProblem, TirefitError, UsageError

if TYPE_CHECKING:  # NumPy, which completion does not wait for
    from tirefit.data.records import FileRecord

Jobs = Annotated[int | None, option("N", "number of processes that share the files", min=1)]
Scheduler = Annotated[
    Text, option("ADDRESS", "Dask scheduler whose workers share the files, e.g. tcp://host:8786")
]

TABLE, PAGE = "results.parquet", "fleet.html"


class Piece(NamedTuple):
    """A file, or files that are fitted together, and the folder or name of the results."""

    file: Any
    to: Any


Work = Callable[[Piece], tuple[ExitCode, "FileRecord"]]
"""Function of a command for one file; for workers it can be pickled."""


class Outcome(NamedTuple):
    """One file: its exit code, its record in the table of all results; of a worker also its
    standard output, error output and notes."""

    code: ExitCode
    record: "FileRecord"
    output: str = ""
    complained: str = ""
    notes: tuple[Any, ...] = ()


def worst_of(codes: Iterable[ExitCode]) -> ExitCode:
    """The smallest exit code above 0, in the order of severity."""
    return min((code for code in codes if code), default=ExitCode.OK)


def _attempted(work: Work, piece: Piece) -> tuple[ExitCode, "FileRecord"]:
    """Run one file; neither a bad file nor a fault of the program stops the others."""
    try:
        return work(piece)
    except BrokenPipeError:
        raise
    except OSError as error:  # its report was printed
        code, problem = ExitCode.USAGE, error_text(error)
    except TirefitError as error:
        if error.exit_code == ExitCode.USAGE:
            raise
        code, problem = error.exit_code, error_text(error)
    except Exception as error:
        reason = f"a fault of the program: {type(error).__name__}: {error}"
        remedy = "run the command on this file only to see where; please report it"
        code, problem = ExitCode.DATA, error_text(DataError(reason, remedy, str(piece.file)))
    complain(problem)
    return code, _failed(piece, problem)


def _failed(piece: Piece, printed: str) -> "FileRecord":
    from tirefit.data.records import FAILED, FileRecord

    problem = " ".join(printed.partition("\n")[2].split())  # without "error:"
    return FileRecord(str(piece.file), str(piece.to), "", FAILED, problem=problem)


@dataclass(frozen=True)
class Sharing:
    """Where the work is done: in this process, in several others, or on a cluster."""

    jobs: int | None = None
    scheduler: str | None = None

    def __post_init__(self) -> None:
        if self.jobs is not None and self.scheduler is not None:
            remedy = "give one: --jobs starts a cluster on this machine"
            raise UsageError("--jobs together with --scheduler", remedy)

    @property
    def apart(self) -> bool:
        return self.jobs is not None or self.scheduler is not None

    def files(self, out: Path, made: Iterable[Path]) -> list[Path]:
        """Paths of the table of all results and of its page in ``out``; empty if the files
        are not shared among processes.

        Raises:
            UsageError: one of them is also a result of one file (``made``).
        """
        ours = [out / TABLE, out / PAGE] if self.apart else []
        if both := sorted(set(ours) & set(made)):
            reason = "it would be both the result of one file and that of all"
            remedy = "rename the file, or leave out --jobs and --scheduler"
            raise UsageError(reason, remedy, str(both[0]))
        return ours


def run_pieces(
    title: str, pieces: Sequence[Piece], work: Work, sharing: Sharing, out: Path
) -> Iterator[Outcome]:
    """Process every file, here or by workers; yield each outcome, in the order of the files.

    With one file, processed here, a fault of the program shows its traceback. Files that are
    shared among processes also get the table of all results and its page, in ``out``.
    """
    count = len(pieces)
    with merged_notes(count > 1) as notes:
        if sharing.apart:
            yield from _shared_outcomes(title, pieces, work, sharing, out, notes)
            return
        for number, piece in enumerate(pieces, 1):
            if count > 1 and has_terminal():
                complain(f"file {number} of {count}: {piece.file}")
            yield Outcome(*(work(piece) if count == 1 else _attempted(work, piece)))


def _shared_outcomes(
    title: str, pieces: Sequence[Piece], work: Work, sharing: Sharing, out: Path, notes: list[Any]
) -> Iterator[Outcome]:
    """Process every file by the workers; print and yield results in the order of files."""
    from tirefit.data.records import FileRecord, records_into
    from tirefit.report.many_files import write_fleet_page

    there = partial(_apart, (os.getcwd(), __version__), pickle.dumps(work))
    out.mkdir(parents=True, exist_ok=True)
    left, early = dict(enumerate(pieces)), dict[int, Outcome]()
    count, records = len(pieces), list[FileRecord]()
    try:
        with (
            records_into(out / TABLE) as table,
            progress_bar(title) as progress,
            cluster(min(sharing.jobs or 1, count), sharing.scheduler) as client,
            closing(shared(there, pieces, client)) as results,
        ):
            for number, result in results:
                piece = left.pop(number)
                progress(1 - len(left) / count, f"{count - len(left)} of {count} files")
                early[number] = result or _lost(piece)
                while outcome := early.pop(len(records), None):
                    typer.echo(outcome.output, nl=False)
                    typer.echo(outcome.complained, nl=False, err=True)
                    notes += outcome.notes
                    table.add(outcome.record)
                    records.append(outcome.record)
                    yield outcome
    finally:
        for piece in left.values():  # after an interrupt: remove half-written results
            swept(piece.to)
    write_fleet_page(records, out / PAGE, title)
    say(f"all results: {out / TABLE}, {out / PAGE}")


def _lost(piece: Piece) -> Outcome:
    swept(piece.to)
    reason = "the workers that had this file died, each time that it was tried"
    remedy = "free memory if it is short, or run the command on this file only, without workers"
    problem = error_text(DataError(reason, remedy, str(piece.file)))
    return Outcome(ExitCode.DATA, _failed(piece, problem), complained=problem + "\n")


_CONNECT = 30.0  # seconds to wait for a scheduler and its first worker

_LOCAL = {
    # Other tasks wait at the scheduler, not at a worker, whose death would fail them too.
    "distributed.scheduler.worker-saturation": 1.0,
    # Without any worker for so long, the tasks fail instead of waiting. On a machine with
    # six times as many busy processes as cores, a worker was restarted in 10 s.
    "distributed.scheduler.no-workers-timeout": "300s",
    # A worker's nanny restarts it. Dask would end the nanny if the worker had died and was
    # just restarting so long after an earlier death, 15 s by default.
    "distributed.deploy.lost-worker-timeout": "1 day",
    # A fit needs all of its memory at once: spilling or pausing would not help it.
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    "distributed.worker.profile.enabled": False,
}
"""Settings of the workers on this machine."""


@contextmanager
def cluster(jobs: int, scheduler: str | None = None) -> Iterator[Any]:
    """Open a client of the cluster at an address, or of a new one on this machine.

    Args:
        jobs: number of workers of a new cluster, which end with the block.
        scheduler: address of a running scheduler; None starts a cluster.

    Raises:
        UsageError: no ``distributed``, or no scheduler or worker at the address.
    """
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError as error:
        reason = "--jobs and --scheduler need distributed, which is not installed"
        raise UsageError(InputProblem(reason, "pip install 'tirefit[cluster]'")) from error
    # Its messages are for the administrator of a cluster; the errors below are for users.
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    with ExitStack() as opened:
        address: Any = scheduler
        if scheduler is None:
            opened.enter_context(dask.config.set(_LOCAL))
            one_thread = {"n_workers": jobs, "threads_per_worker": 1}
            here = {"host": "127.0.0.1", "dashboard_address": "127.0.0.1:0"}
            address = LocalCluster(**one_thread, **here, silence_logs=logging.CRITICAL)
            opened.enter_context(address)
        try:
            client = Client(address, timeout=_CONNECT, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            reason = f"--scheduler: no scheduler answers at {address}"
            remedy = "start one with `dask scheduler`; it prints its address"
            raise UsageError(reason, remedy) from error
        opened.enter_context(client)
        try:
            if scheduler is not None:
                client.wait_for_workers(1, timeout=_CONNECT)
        except TimeoutError:
            reason = f"--scheduler: the scheduler at {address} has no worker"
            remedy = f"start some: dask worker {address} --nthreads 1 --nworkers auto"
            raise UsageError(reason, remedy) from None
        yield client


def shared(
    work: Callable[..., Any], pieces: Sequence[Any], client: Any
) -> Generator[tuple[int, Any]]:
    """Yield (number, ``work(piece)``) of every piece, in the order of completion; None of one
    whose workers died.

    When the iteration stops early, or is interrupted, pieces that have not begun are cancelled.

    Args:
        work: a function that can be pickled, as its arguments and results can; it never
            returns None.
        pieces: the arguments.
        client: of :func:`cluster`.

    Raises:
        UsageError: the scheduler, or every worker, is gone.
    """
    from distributed import as_completed
    from distributed.scheduler import KilledWorker, NoValidWorkerError, NoWorkerError

    futures: dict[Any, int] = {}
    try:
        futures = dict(zip(client.map(work, pieces, pure=False), count()))
        for future in as_completed(list(futures), loop=client.loop):
            number = futures.pop(future)
            try:
                result = future.result()
            except KilledWorker:
                result = None
            yield number, result
    except (CancelledError, NoWorkerError, NoValidWorkerError) as error:
        lost = "connection to the scheduler is lost"
        reason = lost if isinstance(error, CancelledError) else "workers are all gone"
        raise UsageError(f"the {reason}", "start it again, then --resume") from None
    finally:
        if futures and client.status == "running":
            client.cancel(list(futures), force=True)


# --- In a worker ----------------------------------------------------------------------

_ALONE = threading.Lock()  # output is redirected for the whole process


@lru_cache(maxsize=2)
def _unpacked(content: bytes) -> Work:
    """The work with what all files share; JAX arrays have 64 bits only after the start."""
    from tirefit.cli.start import start

    start()
    return pickle.loads(content)


def _apart(of_command: tuple[str, str], content: bytes, piece: Piece) -> Outcome:
    """Process one file in a worker without output. Errors of use are raised; Dask raises them
    again in the command.

    Args:
        of_command: working directory and version of the command.
        content: the work with what all files share, as bytes.
    """
    folder, version = of_command
    if version != __version__:
        reason = f"a worker runs tirefit {__version__}, the command {version}"
        raise UsageError(reason, "install the same for all workers")
    if not os.path.isdir(folder):
        reason = f"a worker does not see the folder of the command, {folder}"
        remedy = "run workers where it is mounted: they read files and write results"
        raise UsageError(reason, remedy)
    output, complained = Unheard(), Unheard()
    with _ALONE, redirect_stdout(output), redirect_stderr(complained), merged_notes() as held:
        with chdir(folder):
            code, record = _attempted(_unpacked(content), piece)
        notes = tuple(held)
        held.clear()
    return Outcome(code, record, output.getvalue(), complained.getvalue(), notes)
