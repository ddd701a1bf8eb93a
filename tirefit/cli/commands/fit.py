"""``tirefit fit``: fit files and write folders of results."""

from collections.abc import Iterator, Sequence
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tirefit.cli import options as cli
from tirefit.cli.commands.fit_one import Also, fit_files, fit_one
from tirefit.cli.commands.magic_formula import MAGIC_FORMULA_NAMES, fit_whole, is_whole
from tirefit.cli.fleet import Jobs, Outcome, Piece, Scheduler, Sharing, run_pieces, worst_of
from tirefit.cli.output import check_results, is_page, names_of, write_result
from tirefit.data.readers.remote import expanded
from tirefit.names import MODEL_NAMES
from tirefit.results import ExitCode, InputProblem, UsageError, exit_code
from tirefit.results import Outcome as Verdict

if TYPE_CHECKING:  # NumPy, which completion does not wait for
    from tirefit.data.records import FileRecord

Solver = StrEnum(
    "Solver", {"optimistix": "optimistix", "jaxopt": "jaxopt", "gauss_newton": "gauss-newton"}
)
Sampler = StrEnum("Sampler", "emcee importance")

PAGE_OF_ALL = "fits.html"

_MODEL = """\
model of `tirefit models` (default: brush); mf52, mf61, mf62: a whole Magic Formula to all files; \
with --vehicle: front=NAME,rear=NAME"""
_PART = "mf52, mf61, mf62: fit this force in pure slip only (default: all that the files determine)"
_LIKE = """\
mf52, mf61, mf62: take forces and coefficients that the files do not determine from this similar \
tire"""
_LEAVE_OUT = """\
mf52, mf61, mf62: rows left out in turn to check the bands (default: the bins of three loads)"""
_VEHICLE = "the files are logs of this car: fit the tires of both axles to its trajectories"
_UNKNOWN = """\
--vehicle: also fit this (repeat for more): yaw_inertia, steering_ratio, \
steering_offset, steering_delay, sideslip_zero (default: steering_offset and steering_delay)"""


def _output_directories(files: list[Path], out: Path | None, joint: bool) -> list[Path]:
    alone = len(files) == 1 or joint
    if alone and out is not None:
        return [out]
    remedy = "rename one, or fit them one by one with different --out"
    remedy += ": their results would overwrite each other"
    names = names_of(files[:1] if alone else files, remedy)
    # The folder of a file without an ending has another name than the file.
    ends = ["" if file.suffix else ".fit" for file in files]
    return [(out or Path()) / f"{name}{end}" for name, end in zip(names, ends, strict=False)]


@cli.takes_data_options
def fit(
    files: cli.Files,
    options: cli.DataOptions,
    model: Annotated[
        cli.Text,
        cli.option("", _MODEL, autocompletion=cli.completed(*MODEL_NAMES, *MAGIC_FORMULA_NAMES)),
    ] = None,
    posterior: Annotated[
        bool, cli.option("", "sample the posterior", "--posterior/--no-posterior")
    ] = True,
    solver: Annotated[
        Solver | None, cli.option("", "least-squares solver; jaxopt is no longer maintained")
    ] = None,
    sampler: Annotated[Sampler | None, cli.option("", "posterior sampler")] = None,
    seed: cli.SeedOrNone = None,
    out: Annotated[cli.File, cli.path_option("FOLDER", "folder of the results")] = None,
    force: cli.Forces = None,
    part: Annotated[cli.Text, cli.option("fx|fy|mz|all", _PART)] = None,
    like: Annotated[cli.File, cli.option("OTHER.tir", _LIKE)] = None,
    leave_out: Annotated[cli.Text, cli.option("three|load|none", _LEAVE_OUT)] = None,
    vehicle: Annotated[cli.File, cli.option("VEHICLE.toml", _VEHICLE)] = None,
    unknown: Annotated[cli.Texts, cli.option("NAME", _UNKNOWN)] = None,
    window: Annotated[
        cli.Number, cli.option("", "--vehicle: length of a window [s] (default: 0.5)", min=0.05)
    ] = None,
    joint: Annotated[
        bool, cli.option("", "fit all files together, each file as a run", "--joint")
    ] = False,
    strict: Annotated[
        bool, cli.option("", "exit 5 if a parameter is not identified", "--strict")
    ] = False,
    resume: cli.Resume = False,
    html: cli.Html = False,
    full: cli.Full = False,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
) -> None:
    """Fit a model to measurements: parameters with intervals, figures, report."""
    sharing, files = Sharing(jobs, scheduler), expanded(files)
    from tirefit.fitting.problem.config import FitConfig

    cli.refuse_by_vehicle(vehicle, _OF_VEHICLE, ("unknown", "window"))
    if vehicle is not None:
        car = {"unknowns": unknown, "window": window}
        raise typer.Exit(_fit_vehicle(files, vehicle, model, out, html, **car))
    base = cli.read_config(options.config) or FitConfig()
    how = cli.read_options(options, base)
    changes = {
        "model": model,
        "seed": seed,
        "force": [name.value for name in force or ()] or None,
        "solver": solver.value if solver else None,
    }
    settings = base.model_copy(update={k: v for k, v in changes.items() if v is not None})
    if sampler is not None:
        chosen = settings.posterior.model_copy(update={"sampler": sampler.value})
        settings = settings.model_copy(update={"posterior": chosen})
    also = Also(html, full)
    if is_whole(settings.model, _OF_WHOLE, _NOT_OF_WHOLE):
        whole = {"part": part, "like": like, "leave_out": leave_out}
        whole = {name: value for name, value in whole.items() if value is not None}
        (directory,) = _output_directories(files, out, joint=True)
        code = fit_whole(files, directory, settings, how, whole, strict, also)
        raise typer.Exit(code)
    directories = _output_directories(files, out, joint)
    cli.start_jax()
    from tirefit.fitting.problem.build import find_model

    find_model(settings.model or "brush")
    sharing = Sharing() if joint else sharing
    made = [file for directory in directories for file in fit_files(directory)]
    made += [directories[0].parent / PAGE_OF_ALL] if len(directories) > 1 else []
    check_results([*made, *sharing.files(out or Path())], files)
    work = partial(_fit_piece, strict, (settings, how, posterior, resume, also))
    groups: list[Any] = [files] if joint else files
    pieces = [Piece(*pair) for pair in zip(groups, directories, strict=True)]
    done = _done(run_pieces("fit", pieces, work, sharing, out or Path()), pieces)
    if len(pieces) > 1:
        _report_all([outcome.record for outcome in done], directories[0].parent / PAGE_OF_ALL, html)
    raise typer.Exit(worst_of([outcome.code for outcome in done]))


_OF_VEHICLE = "files vehicle model out unknown window posterior full html".split()
"""What ``--vehicle`` uses, or may be given with it."""
_OF_WHOLE = ("part", "like", "leave_out")
_NOT_OF_WHOLE = ("solver", "sampler", "force", "resume", "jobs", "scheduler")
"""Options of a whole Magic Formula only, and of other models only."""


def _fit_piece(strict: bool, task: tuple[Any, ...], piece: Piece) -> tuple[ExitCode, "FileRecord"]:
    files = piece.file if isinstance(piece.file, list) else [piece.file]
    record = fit_one(files, piece.to, *task)
    return exit_code([Verdict[name.upper()] for name in record.outcomes], strict), record


def _done(outcomes: Iterator[Outcome], pieces: list[Piece]) -> list[Outcome]:
    """The outcomes up to an interrupt."""
    done = []
    for outcome in outcomes:
        done.append(outcome)
        if "interrupted" in outcome.record.outcomes and (left := len(pieces) - len(done)):
            cli.complain(f"interrupted: the last {left} of {len(pieces)} not fitted")
            break
    return done


def _report_all(records: Sequence["FileRecord"], page: Path, html: bool) -> None:
    """Print the summary of several fits and write their page, or remove an earlier one."""
    from tirefit.report.many_files import summary_table, write_fleet_page

    cli.say(summary_table([record for record in records if record.rows]))
    if html and any(record.rows for record in records):
        write_fleet_page(records, page, "fit")
        cli.say(f"wrote {page}")
    elif is_page(page):  # of an earlier command
        page.unlink()


# --- logs of a vehicle ---------------------------------------------------------------

_DRAWN, _PAGE = "trajectory.png", "trajectory.html"
_OF_TRAJECTORY = ("trajectory.json", "front.json", "rear.json", "vehicle.toml", _DRAWN, _PAGE)


def _models_of(text: str | None) -> dict[str, Any]:
    """The models in ``front=brush,rear=brush``, or in a single name for both axles."""
    if text is None or "=" not in text:
        return dict.fromkeys(("front", "rear"), text or "brush")
    by_axle = dict(part.strip().partition("=")[::2] for part in text.split(","))
    if set(by_axle) != {"front", "rear"}:
        reason = f"--model {text} with --vehicle"
        raise UsageError(InputProblem(reason, "write front=brush,rear=brush"))
    return by_axle


def _fit_vehicle(
    logs: list[Path], vehicle: Path, model: str | None, out: Path | None, html: bool, **how: Any
) -> ExitCode:
    """Fit the car, print the report and write the files.

    Args:
        how: keywords of :func:`~tirefit.vehicle.trajectory.fit_trajectory`; None for its defaults.
    """
    models, out = _models_of(model), out or Path(f"{vehicle.stem}.fit")
    check_results([out / name for name in _OF_TRAJECTORY], logs)
    how = {k: v for k, v in how.items() if v is not None}
    with cli.progress_bar("fit", soon=0.0) as progress:
        progress(0.01, "loading")
        cli.start_jax()
        from tirefit.vehicle.trajectory import fit_trajectory

        result = fit_trajectory(logs, vehicle, progress=progress, **(models | how))
    write_result(result, out, _OF_TRAJECTORY, {_DRAWN: ""}, _PAGE if html else "")
    return exit_code(result.outcomes)
