"""``tirefit fit``: from files to directories of results."""

import hashlib
import json
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tirefit import __version__
from tirefit.cli.fleet import Jobs, Piece, Scheduler, Sharing, fleet
from tirefit.cli.options import (
    DataOptions,
    Files,
    complain,
    completed,
    error_text,
    errors_to_exit,
    forces_named,
    has_terminal,
    named_path,
    progress_bar,
    read_config,
    read_options,
    say,
    start_jax,
    takes_data_options,
    warn,
)
from tirefit.cli.output import check_directories, claimed, staged
from tirefit.data.remote import expanded
from tirefit.names import MODEL_NAMES
from tirefit.results import ExitCode, InputProblem, Outcome, TirefitError, UsageError

if TYPE_CHECKING:  # NumPy, which completion does not wait for
    from tirefit.data.records import FileRecord

__all__ = ["exit_code", "fit", "fit_into", "model_names"]


class Solver(StrEnum):
    optimistix = "optimistix"
    jaxopt = "jaxopt"
    gauss_newton = "gauss-newton"


class Sampler(StrEnum):
    emcee = "emcee"
    nuts = "nuts"
    importance = "importance"


model_names = completed(*MODEL_NAMES)


def _output_directories(files: list[Path], out: Path | None, joint: bool) -> list[Path]:
    stems = [_stem(file) for file in files]
    twice = sorted(stem for stem, count in Counter(stems).items() if count > 1)
    if twice and not joint:
        raise UsageError(
            InputProblem(
                f"several input files are named {', '.join(twice)}: their results would"
                " overwrite each other",
                "rename a file, or fit them one by one with different --out",
            )
        )
    if len(files) == 1 or joint:
        return [out if out is not None else Path(stems[0])]
    return [(out or Path()) / stem for stem in stems]


def _stem(file: Path) -> str:
    name = file.name.removesuffix(".gz")
    return Path(name).stem if Path(name).suffix else f"{name}.fit"


@takes_data_options
def fit(
    files: Files,
    options: DataOptions,
    model: Annotated[
        str | None,
        typer.Option(
            help="a name of `tirefit models`; brush by default",
            autocompletion=model_names,
        ),
    ] = None,
    posterior: Annotated[
        bool, typer.Option("--posterior/--no-posterior", help="sample the posterior")
    ] = True,
    solver: Annotated[Solver | None, typer.Option(help="least-squares solver")] = None,
    sampler: Annotated[Sampler | None, typer.Option(help="posterior sampler")] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, max=2**32 - 1, help="of everything random")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER", parser=named_path, help="directory of the results"
        ),
    ] = None,
    force: Annotated[
        list[str] | None,
        typer.Option(help="force to fit: fx, fy, mz (repeat for more)"),
    ] = None,
    joint: Annotated[
        bool, typer.Option("--joint", help="one fit of all files, each file a run")
    ] = False,
    strict: Annotated[
        bool, typer.Option("--strict", help="exit 5 if a parameter is not identified")
    ] = False,
    resume: Annotated[
        bool,
        typer.Option(
            "--resume", help="keep fits that are done; continue the chain of others"
        ),
    ] = False,
    svg: Annotated[
        bool, typer.Option("--svg", help="write every figure as SVG too")
    ] = False,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
) -> None:
    """Fit a model: parameters, uncertainties, figures and a report."""
    with errors_to_exit():
        sharing, files = Sharing(jobs, scheduler), expanded(files)
        from tirefit.fitting.config import FitConfig

        base = read_config(options.config) or FitConfig()
        how = read_options(options, base)
        changes = {
            "model": model, "seed": seed, "force": forces_named(force),
            "solver": solver.value if solver else None,
        }  # fmt: skip
        settings = base.model_copy(
            update={k: v for k, v in changes.items() if v is not None}
        )
        if sampler is not None:
            chosen = settings.posterior.model_copy(update={"sampler": sampler.value})
            settings = settings.model_copy(update={"posterior": chosen})
        directories = _output_directories(files, out, joint)
        check_directories(directories)
        start_jax()
        from tirefit.fitting.problem import find_model

        find_model(settings.model or "brush")
        task = _Task(settings, how, posterior, resume, svg, strict)
        if sharing.apart and not joint:
            worst = _fit_apart(files, directories, task, sharing, out or Path())
        else:
            groups = [files] if joint else [[file] for file in files]
            worst = _fit_all(groups, directories, task)
        raise typer.Exit(worst)


@dataclass(frozen=True)
class _Task:
    """What all files share: settings of the fit, arguments of ``tirefit.read``, and
    the options."""

    settings: Any
    how: dict
    posterior: bool
    resume: bool
    svg: bool
    strict: bool

    def digest(self, tables) -> str:
        """Of all that the numbers of a fit of these tables depend on."""
        asked = [
            self.settings.model_dump(mode="json"), self.how, self.posterior,
            [table.source.sha256 for table in tables], __version__,
        ]  # fmt: skip
        return hashlib.sha256(json.dumps(asked).encode()).hexdigest()


def _fit_all(groups, directories, task: _Task) -> ExitCode:
    """Every group of files; one bad file does not stop the others."""
    codes: list[ExitCode] = []
    records = []
    for i, (group, directory) in enumerate(zip(groups, directories, strict=True)):
        if len(groups) > 1 and has_terminal():
            complain(f"file {i + 1} of {len(groups)}: {group[0]}")
        try:
            record = _fit_one(group, directory, task)
        except TirefitError as error:
            if len(groups) == 1 or error.exit_code == ExitCode.USAGE:
                raise
            complain(error_text(error))
            codes.append(error.exit_code)
            continue
        codes.append(_code_of(record, task.strict))
        records.append(record)
        if "interrupted" in record.outcomes:
            left = len(groups) - i - 1
            if left:
                complain(f"interrupted: the last {left} of {len(groups)} not fitted")
            break
    if len(groups) > 1:
        say(_summary(records))
    return _worst(codes)


def _fit_apart(files, directories, task: _Task, sharing: Sharing, out: Path):
    """The same by the workers of a cluster."""
    pieces = [Piece(*pair) for pair in zip(files, directories, strict=True)]
    codes: set[ExitCode] = set()
    records = []
    for outcome in fleet("fit", pieces, _attempt, task, sharing, out):
        codes.add(outcome.code)
        if outcome.record is not None and outcome.record.rows:
            records.append(outcome.record)
    if len(files) > 1:
        say(_summary(records))
    return _worst(codes)


def _attempt(piece: Piece, task: _Task) -> tuple[ExitCode, "FileRecord"]:
    record = _fit_one([piece.file], piece.to, task)
    return _code_of(record, task.strict), record


def _worst(codes: Collection[ExitCode]) -> ExitCode:
    # Bad data first, then convergence, then identification.
    order = (ExitCode.DATA, ExitCode.NOT_CONVERGED, ExitCode.NOT_IDENTIFIED)
    return next((code for code in order if code in codes), ExitCode.OK)


def _fit_one(files, directory: Path, task: _Task) -> "FileRecord":
    from tirefit.data.read import read
    from tirefit.data.table import join
    from tirefit.fitting.store import record_of_fit

    tables = [read(file, **task.how) for file in files]
    for table in tables:
        warn(table)
    asked = task.digest(tables)
    content = _done(directory, asked, task) if task.resume else None
    if content is None:
        data = tables[0] if len(tables) == 1 else join(tables)
        result = fit_into(
            directory, data, task.settings, task.posterior, task.resume, task.svg, asked
        )
        content = result.to_dict()
    else:
        say(f"{files[0]}: done before, kept: {directory}")
    return record_of_fit(content, str(directory))


def _done(directory: Path, asked: str, task: _Task) -> dict | None:
    """Content of the ``fit.json`` there, if it answers what is asked, and whole."""
    from tirefit.door import read_record
    from tirefit.fitting.result import SCHEMA

    expected = ["fit.json", "fit.png"]
    expected += ["posterior.nc"] if task.posterior else []
    expected += ["fit.svg"] if task.svg else []
    if not all((directory / name).exists() for name in expected):
        return None
    try:
        content = read_record(directory / "fit.json", SCHEMA, "")
    except TirefitError:
        return None
    # A chain that can go on is not done.
    open_ended = {"chain_too_short", "interrupted"} & set(content["outcomes"])
    return None if open_ended or content.get("asked") != asked else content


def fit_into(
    directory, data, settings, posterior=False, resume=False, svg=False, asked=""
):
    """Fits the data, and leaves the result and its figures in the directory."""
    from tirefit.fitting.estimate import fit as fit_data

    with claimed(directory):
        result = fit_data(data, config=settings)
        if posterior:
            # Whatever becomes of the sampling; a posterior to go on with stays.
            if not (resume and (directory / "fit.json").exists()):
                _save(result, directory, svg)
                say(_first_words(result, directory))
            result = _sampled(result, directory, settings, resume)
        written = _save(replace(result, asked=asked), directory, svg)
    say(str(result))
    say("wrote " + ", ".join(str(path) for path in written))
    return result


def _first_words(result, directory: Path) -> str:
    """Of the least squares, which are there before the posterior is."""
    from tirefit.report.text import parameter_lines

    said = f"written to {directory}; now the posterior is sampled\n"
    return "\n".join([*parameter_lines(result)[1:], said])


def _save(result, directory: Path, svg: bool) -> list[Path]:
    from tirefit.fitting.store import save_fit
    from tirefit.report.draw import FIGURE_FILES, save_figures

    with staged(directory, known=["posterior.nc", *FIGURE_FILES]) as folder:
        written = save_fit(result, folder) + save_figures(result, folder, svg=svg)
    return [directory / path.name for path in written]


def _sampled(result, directory: Path, settings, resume: bool):
    from tirefit.fitting.posterior import sample

    chosen = settings.posterior
    with progress_bar("posterior") as progress:
        return sample(
            result,
            sampler=chosen.sampler,
            ensembles=chosen.ensembles,
            walkers=chosen.walkers,
            effective_samples=chosen.effective_samples,
            max_steps=chosen.max_steps,
            checkpoint=directory / "chain.npz",
            resume=resume,
            progress=progress,
        )


def exit_code(result, strict: bool = False) -> ExitCode:
    return _code(result.outcomes, strict)


def _code(outcomes: Collection[Outcome], strict: bool) -> ExitCode:
    broken = {Outcome.NOT_CONVERGED, Outcome.CHAIN_TOO_SHORT, Outcome.INTERRUPTED}
    if broken & set(outcomes):
        return ExitCode.NOT_CONVERGED
    if strict and Outcome.NOT_IDENTIFIED in outcomes:
        return ExitCode.NOT_IDENTIFIED
    return ExitCode.OK


def _code_of(record: "FileRecord", strict: bool) -> ExitCode:
    return _code([Outcome[name.upper()] for name in record.outcomes], strict)


def _summary(records: list["FileRecord"]) -> str:
    from tirefit.report.summary import summary_table

    return summary_table(records)
