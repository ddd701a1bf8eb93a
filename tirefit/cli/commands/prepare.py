"""``tirefit prepare``: convert recordings of a rig to data for a fit."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tirefit import __version__
from tirefit.cli import options as cli
from tirefit.cli.fleet import Jobs, Piece, Scheduler, Sharing, run_pieces, worst_of
from tirefit.cli.notes import warn
from tirefit.cli.output import check_results, names_of, write_result
from tirefit.data.readers.remote import expanded, file_at
from tirefit.results import ExitCode

if TYPE_CHECKING:  # NumPy, which completion does not wait for
    from tirefit.data.records import FileRecord
    from tirefit.data.rig.settings import PrepareConfig

_KEPT = ("sweep", "steady", "warm-up")
_KEEP = f"kind of segment to write (repeat for more): {', '.join(_KEPT)}; default: sweep and steady"


@cli.takes_data_options
def prepare(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE", parser=file_at, help="recordings of a rig")
    ],
    *,
    out: cli.Folder,
    options: cli.DataOptions,
    bandwidth: Annotated[
        cli.Number, cli.option("HZ", "-3 dB bandwidth of the filter (default: by the sweeps)")
    ] = None,
    unfiltered: Annotated[bool, cli.option("", "do not filter", "--no-filter")] = False,
    rate: Annotated[cli.Number, cli.option("HZ", "sample rate of a file without time")] = None,
    warm_up: Annotated[
        cli.Number, cli.option("S", "duration of the warm-up [s] (default: found in the data)")
    ] = None,
    keep: Annotated[
        cli.Texts, cli.option("KIND", _KEEP, autocompletion=cli.completed(*_KEPT))
    ] = None,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
) -> None:
    """Cut the recording of a test rig into sweeps and bins, filter it, and write the rows to fit.

    For each FILE: NAME.csv (rows to fit, with run, segment, bin), NAME.segments.tsv,
    NAME.png (the whole test), NAME.prepare.json (all that was done).
    """
    sharing, files = Sharing(jobs, scheduler), expanded(files)
    changes = {
        "bandwidth": bandwidth,
        "filter": False if unfiltered else None,
        "rate": rate,
        "warm_up": warm_up,
        "keep": keep,
    }
    changes = {key: value for key, value in changes.items() if value is not None}
    base = cli.read_config(options.config)
    how = cli.read_options(options, base)
    from tirefit.data.rig.settings import PrepareConfig
    from tirefit.settings import parse_settings

    below = {} if base is None else base.prepare.model_dump()
    config = parse_settings(PrepareConfig, below | changes, "prepare")
    names = names_of(files, "prepare them into different --out")
    ends = (".csv", ".segments.tsv", ".png", ".prepare.json")
    made = [out / f"{name}{end}" for name in names for end in ends]
    check_results([*made, *sharing.files(out)], files)
    pieces = [Piece(*pair) for pair in zip(files, names, strict=True)]
    work = partial(_one, out, how, config)
    done = run_pieces("prepare", pieces, work, sharing, out)
    raise typer.Exit(worst_of([outcome.code for outcome in done]))


def _one(
    out: Path, how: dict[str, Any], config: "PrepareConfig", piece: Piece
) -> tuple[ExitCode, "FileRecord"]:
    """Prepare one file into a folder; ``how`` are arguments of ``tirefit.read``."""
    from tirefit.data.read import read
    from tirefit.data.records import FileRecord, Row
    from tirefit.data.rig.prepare import prepare as prepare_data

    file, name = piece
    # Recordings have bad rows, which are cut out.
    data = read(file, **(how | {"mask_bad_rows": True, "curve": False}))
    warn(data)
    prepared = replace(prepare_data(data, config), read=how)
    names = [f"{name}.{end}" for end in ("csv", "segments.tsv", "prepare.json", "png")]
    write_result(prepared, out, names, {names[-1]: ""}, name=name)
    counts = {"rows": prepared.kept.sum(), "segments": len(prepared.segments)}
    rows = tuple(Row("statistic", key, float(n)) for key, n in counts.items())
    record = FileRecord(str(file), str(out / names[0]), "", "prepared", rows, version=__version__)
    source = prepared.data.source
    return ExitCode.OK, replace(record, convention=source.convention, sha256=source.sha256)
