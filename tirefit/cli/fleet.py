"""Distribute the files of a command to the workers of a cluster, and report in order.

The workers write the results; they return the output of the command for a file, and its
record for the table of all results.
"""

import os
import pickle
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import chdir, closing, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from tirefit import __version__
from tirefit.cli.cluster import Ended, cluster, shared
from tirefit.cli.notes import merged_notes
from tirefit.cli.options import (
    Unheard,
    complain,
    error_text,
    errors_to_exit,
    progress_bar,
    say,
    start_jax,
)
from tirefit.cli.output import swept
from tirefit.results import DataError, ExitCode, TirefitError, UsageError

if TYPE_CHECKING:  # NumPy, which completion does not wait for
    from tirefit.data.records import FileRecord

Jobs = Annotated[
    int | None, typer.Option(min=1, metavar="N", help="number of processes that share the files")
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS", help="Dask scheduler whose workers share the files, e.g. tcp://host:8786"
    ),
]

TABLE, PAGE = "results.parquet", "fleet.html"


@dataclass(frozen=True)
class Sharing:
    """Where the work is done: in this process, in several others, or on a cluster."""

    jobs: int | None
    scheduler: str | None

    def __post_init__(self):
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
        if not self.apart:
            return []
        ours = [out / TABLE, out / PAGE]
        if both := sorted(set(ours) & set(made)):
            reason = "it would be both the result of one file and that of all"
            remedy = "rename the file, or leave out --jobs and --scheduler"
            raise UsageError(reason, remedy, str(both[0]))
        return ours


class Piece(NamedTuple):
    """A file, and the folder or name of its results."""

    file: Any
    to: Any


class Outcome(NamedTuple):
    """One file: its exit code, whether that ends the command, its standard output and
    error output, its record in the table of all results, and its notes."""

    code: ExitCode
    last: bool = False
    output: str = ""
    complained: str = ""
    record: "FileRecord | None" = None
    notes: tuple = ()


Attempt = Callable[[Piece, Any], tuple[ExitCode, "FileRecord"]]
"""Function of a command for one file; the second argument is shared by all files."""


def fleet(
    title: str, pieces: Sequence[Piece], attempt: Attempt, task: Any, sharing: Sharing, out: Path
) -> Generator[Outcome, None, None]:
    """Process every file by the workers; print and yield results in the order of files.

    At the end ``out`` holds the table of all results and its page.
    """
    from tirefit.data.records import records_into

    packed = _Packed(os.getcwd(), __version__, pickle.dumps((attempt, task)))
    work = partial(_apart, packed)
    out.mkdir(parents=True, exist_ok=True)
    left = set(range(len(pieces)))
    try:
        with (
            records_into(out / TABLE) as table,
            progress_bar(title) as progress,
            cluster(min(sharing.jobs or 1, len(pieces)), sharing.scheduler) as client,
            closing(shared(work, pieces, client)) as results,
            merged_notes(len(pieces) > 1) as notes,
        ):
            for outcome in _in_order(results, pieces, progress, left):
                typer.echo(outcome.output, nl=False)
                typer.echo(outcome.complained, nl=False, err=True)
                if outcome.last:
                    raise typer.Exit(outcome.code)
                notes += outcome.notes
                table.add(outcome.record)
                yield outcome
    finally:
        for number in left:  # after an interrupt: remove half-written results
            _sweep(pieces[number])
    from tirefit.report.fleet_html import write_fleet_page

    write_fleet_page(out / TABLE, out / PAGE, title)
    say(f"all results: {out / TABLE}, {out / PAGE}")


def _in_order(results, pieces, progress, left) -> Iterator[Outcome]:
    """Outcomes in the order of the pieces; shows the progress."""
    waiting: dict[int, Outcome] = {}
    following, n = 0, len(pieces)
    for number, result in results:
        left.discard(number)
        progress(1 - len(left) / n, f"{n - len(left)} of {n} files")
        if isinstance(result, Ended):
            _sweep(pieces[number])
            result = _lost(pieces[number], result)
        waiting[number] = result
        while following in waiting:
            yield waiting.pop(following)
            following += 1


def _sweep(piece: Piece) -> None:
    if isinstance(piece.to, Path):  # a folder for this file
        swept(piece.to)


def _lost(piece: Piece, ended: Ended) -> Outcome:
    reason = f"each of {ended.workers} workers that ran only this file died"
    remedy = "if memory is short, give fewer --jobs; then --resume"
    error = DataError(reason, remedy, str(piece.file))
    return _failed(piece, ExitCode.DATA, error_text(error) + "\n")


def _failed(piece: Piece, code: ExitCode, complained: str, **more) -> Outcome:
    from tirefit.data.records import FAILED, FileRecord

    record = FileRecord(str(piece.file), str(piece.to), "", FAILED, problem=complained.strip())
    return Outcome(code, complained=complained, record=record, **more)


# --- In a worker ----------------------------------------------------------------------


class _Packed(NamedTuple):
    """The data of a worker in addition to the file, as bytes, as JAX arrays have 64 bits
    only after JAX has been configured."""

    folder: str  # working directory of the command
    version: str  # of the command
    content: bytes  # the attempt with what all files share


@lru_cache(maxsize=2)
def _unpacked(content: bytes) -> tuple[Attempt, Any]:
    start_jax()
    return pickle.loads(content)


def _apart(packed: _Packed, piece: Piece) -> Outcome:
    """Process one file in a worker without output; errors become its outcome."""
    output, complained = Unheard(), Unheard()
    with redirect_stdout(output), redirect_stderr(complained), merged_notes() as held:
        try:
            with errors_to_exit(), _where_the_command_runs(packed):
                code, record = attempted(*_unpacked(packed.content), piece)
        except typer.Exit as end:
            code = ExitCode(end.exit_code)
            return _failed(piece, code, complained.getvalue(), last=True)
        notes = tuple(held)
        held.clear()
    text = complained.getvalue()
    if record is None:
        return _failed(piece, code, text)._replace(output=output.getvalue())
    return Outcome(code, False, output.getvalue(), text, record, notes)


def _where_the_command_runs(packed: _Packed) -> chdir:
    if packed.version != __version__:
        reason = f"a worker runs tirefit {__version__}, the command {packed.version}"
        raise UsageError(reason, "install the same for all workers")
    if not os.path.isdir(packed.folder):
        reason = f"a worker does not see the folder of the command, {packed.folder}"
        remedy = "run workers where it is mounted: they read files and write results"
        raise UsageError(reason, remedy)
    return chdir(packed.folder)


def attempted(attempt: Callable, task: Any, piece: Piece) -> tuple[ExitCode, "FileRecord | None"]:
    """Run one file; neither a bad file nor a fault of the program stops the others."""
    try:
        return attempt(piece, task)
    except TirefitError as error:
        if error.exit_code == ExitCode.USAGE:
            raise
        complain(error_text(error))
        return error.exit_code, None
    except BrokenPipeError:
        raise
    except OSError as error:  # its report was printed
        complain(error_text(error))
        return ExitCode.USAGE, None
    except Exception as error:
        reason = f"a fault of the program: {type(error).__name__}: {error}"
        remedy = "run the command on this file only to see where; please report it"
        complain(error_text(DataError(reason, remedy, str(piece.file))))
        return ExitCode.DATA, None
