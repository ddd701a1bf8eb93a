"""``tirefit estimate``: friction while driving, from a log or a stream of rows."""

import csv
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tirefit.cli.notes import warn
from tirefit.cli.options import (
    DataOptions,
    File,
    Seed,
    Texts,
    complain,
    numbers,
    option,
    path_option,
    read_config,
    read_options,
    start_jax,
    takes_data_options,
)
from tirefit.cli.output import check_results, claimed, write_result
from tirefit.results import InputProblem, UsageError

if TYPE_CHECKING:
    from tirefit.data.table import TireData


FILES = ("estimates.csv", "summary.json", "estimates.png")


@takes_data_options
def estimate(
    log: Annotated[
        str, typer.Argument(metavar="LOG.csv|-", help="log in time order, or - (standard input)")
    ],
    options: DataOptions,
    method: Annotated[str, option("NAME[,NAME...]", "methods (see `tirefit methods`)")] = "rls",
    out: Annotated[
        File, path_option("FOLDER", "folder of the results (required without --follow)")
    ] = None,
    follow: Annotated[
        bool, option("", "read rows from standard input as they come (LOG is -)", "--follow")
    ] = False,
    setting: Annotated[Texts, option("[METHOD.]NAME=VALUE", "setting of a method", "--set")] = None,
    seed: Seed = 0,
) -> None:
    """Estimate friction and stiffness at each row, from the rows up to it."""
    values = _checked(log, out, follow, setting)
    from tirefit.online.methods import METHODS
    from tirefit.params import by_owner, check_names

    names = check_names("method", method, METHODS)
    chosen = by_owner(values, {name: METHODS[name]() for name in names})
    how = read_options(options, read_config(options.config))
    start_jax()
    if follow:
        _follow(names, chosen, how)
        return
    assert out is not None  # checked
    with claimed(out):
        _whole(Path(log), names, values, how, out, seed)


def _checked(
    log: str, out: Path | None, follow: bool, setting: list[str] | None
) -> dict[str, float]:
    """Settings; raises UsageError with all problems before the work."""
    problems: list[InputProblem] = []
    values = numbers("--set", setting, problems)
    if follow and log != "-":
        reason = f"--follow with the file {log}"
        problems.append(InputProblem(reason, "give - and rows on standard input"))
    if log == "-" and not follow:
        problems.append(InputProblem("- without --follow", "add --follow"))
    if follow and sys.stdin is None:
        problems.append(InputProblem("standard input is closed", "give rows on it, or a file"))
    if follow and out is not None:
        reason = "--follow with --out"
        problems.append(InputProblem(reason, "its rows go to standard output"))
    if not follow and out is None:
        reason = "no folder for the results"
        problems.append(InputProblem(reason, "name one with --out"))
    UsageError.raise_for(problems)
    if out is not None:
        check_results([out / name for name in FILES])
    return values


def _whole(
    log: Path,
    names: Sequence[str],
    values: dict[str, float],
    how: dict[str, Any],
    out: Path,
    seed: int,
) -> None:
    from tirefit.data.read import read
    from tirefit.online.estimate import estimate as estimate_log

    # Logs have gaps: a row that cannot be used is flagged and no error.
    table = read(log, **(how | {"mask_bad_rows": True, "curve": False}))
    warn(table)
    _say_masked(table)
    result = estimate_log(table, names, values, seed=seed)
    write_result(result, out, FILES, {FILES[2]: ""})


def _say_masked(table: "TireData") -> None:
    """Print one unusable row of each kind, and the number of all."""
    first: dict[tuple[str | None, str], InputProblem] = {}
    for problem in table.source.masked:
        if problem.row is not None:
            first.setdefault((problem.column, problem.remedy), problem)
    for problem in first.values():
        complain(f"warning: {problem}")
    if unused := len(table) - table.n:
        rows = f"{unused} of {len(table)} rows cannot be used"
        complain(f"warning: {table.source.path}: {rows}; their estimates are flagged")


def _follow(
    names: Sequence[str], chosen: Mapping[str, Mapping[str, float]], how: dict[str, Any]
) -> None:
    """Print estimates as CSV, one row at once for every row received."""
    from tirefit.data.readers.stream import RowReader
    from tirefit.online.estimate import Streams

    how = {key: value for key, value in how.items() if key != "mask_bad_rows"}
    # A row with bytes that are not text is flagged, and reading continues.
    sys.stdin.reconfigure(errors="replace")  # type: ignore[union-attr]
    rows = RowReader(sys.stdin, **how)
    for text in rows.assumptions:
        complain(text)
    streams = Streams(names, chosen, rows.columns)
    table = csv.writer(sys.stdout, lineterminator="\n")
    table.writerow(streams.header)
    sys.stdout.flush()
    for row in rows:
        if rows.bad is not None:
            line, reason = rows.bad
            complain(f"warning: row {line}: {reason}")
        table.writerow(streams.push(row))
        sys.stdout.flush()
