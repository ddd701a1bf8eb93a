"""``tirefit fit``: from files to directories of results."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated, NamedTuple

import typer

from tirefit.cli.magic_formula import (
    MAGIC_FORMULA_NAMES,
    fit_whole,
    only_of_magic_formula,
)
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
from tirefit.cli.output import check_directories, claimed, is_page, staged
from tirefit.names import MODEL_NAMES
from tirefit.results import ExitCode, InputProblem, Outcome, TirefitError, UsageError

__all__ = ["exit_code", "fit", "fit_into", "model_names"]


class Solver(StrEnum):
    optimistix = "optimistix"
    jaxopt = "jaxopt"
    gauss_newton = "gauss-newton"


class Sampler(StrEnum):
    emcee = "emcee"
    nuts = "nuts"
    importance = "importance"


PAGE, PAGE_OF_ALL = "fit.html", "fits.html"

model_names = completed(*MODEL_NAMES)

CHAIN = "chain.npz"


def _output_directories(files: list[Path], out: Path | None, joint: bool) -> list[Path]:
    stems = [_stem(file) for file in files]
    twice = sorted({stem for stem in stems if stems.count(stem) > 1})
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
            help="a name of `tirefit models`, brush by default; mf52, mf61 or mf62 is a"
            " whole Magic Formula, of all files together",
            autocompletion=completed(*MODEL_NAMES, *MAGIC_FORMULA_NAMES),
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
    part: Annotated[
        str | None,
        typer.Option(
            metavar="fx|fy|mz|combined|all",
            help="of mf52, mf61, mf62: this part, or all that the files tell",
        ),
    ] = None,
    joint: Annotated[
        bool, typer.Option("--joint", help="one fit of all files, each file a run")
    ] = False,
    strict: Annotated[
        bool, typer.Option("--strict", help="exit 5 if a parameter is not identified")
    ] = False,
    resume: Annotated[
        bool, typer.Option("--resume", help="continue the chain kept in the directory")
    ] = False,
    svg: Annotated[
        bool, typer.Option("--svg", help="write every figure as SVG too")
    ] = False,
    html: Annotated[
        bool,
        typer.Option(
            "--html", help="write fit.html, one page of all; of several files fits.html"
        ),
    ] = False,
) -> None:
    """Fit a model: parameters, uncertainties, figures and a report."""
    with errors_to_exit():
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
        unused = {
            "--solver": solver, "--sampler": sampler, "--force": force,
            "--resume": resume, "--svg": svg, "--html": html,
        }  # fmt: skip
        if only_of_magic_formula(settings.model, part, unused):
            (directory,) = _output_directories(files, out, joint=True)
            code = fit_whole(files, directory, settings, how, part or "all", strict)
            raise typer.Exit(code)
        directories = _output_directories(files, out, joint)
        check_directories(directories)
        start_jax()
        from tirefit.fitting.problem import find_model

        find_model(settings.model or "brush")
        groups = [files] if joint else [[file] for file in files]
        also = Also(svg, html)
        worst = _fit_all(
            groups, directories, settings, how, posterior, resume, also, strict
        )
        raise typer.Exit(worst)


class Also(NamedTuple):
    """What is written beside the result and its figures."""

    svg: bool = False
    html: bool = False


def _fit_all(
    groups, directories, settings, how, posterior, resume, also, strict
) -> ExitCode:
    """Every group of files; one bad file does not stop the others."""
    codes: list[ExitCode] = []
    rows, failed = [], {}
    for i, (group, directory) in enumerate(zip(groups, directories, strict=True)):
        if len(groups) > 1 and has_terminal():
            complain(f"file {i + 1} of {len(groups)}: {group[0]}")
        try:
            result = _fit_one(group, directory, settings, how, posterior, resume, also)
        except TirefitError as error:
            if len(groups) == 1 or error.exit_code == ExitCode.USAGE:
                raise
            complain(error_text(error))
            codes.append(error.exit_code)
            failed[str(group[0])] = "; ".join(p.reason for p in error.problems)
            continue
        except OSError as error:  # its report was said
            if len(groups) == 1 or isinstance(error, BrokenPipeError):
                raise
            complain(error_text(error))
            codes.append(ExitCode.USAGE)
            continue
        codes.append(exit_code(result, strict))
        rows.append((directory, result))
        if Outcome.INTERRUPTED in result.outcomes:
            left = len(groups) - i - 1
            if left:
                complain(f"interrupted: the last {left} of {len(groups)} not fitted")
            break
    if len(groups) > 1:
        say(_summary(rows))
        _page_of_all(directories[0].parent, rows, failed, also.html)
    # The least is the worst: files not written, bad data, convergence, identification.
    return min((code for code in codes if code), default=ExitCode.OK)


def _page_of_all(folder: Path, rows, failed: dict[str, str], asked: bool) -> None:
    """Writes the page over all fits; removes that of an earlier command."""
    from tirefit.fitting.result import SCHEMA

    page = folder / PAGE_OF_ALL
    if asked and rows:
        from tirefit.report.fits_html import write_fits_page

        write_fits_page({path.name: result for path, result in rows}, page, failed)
        say(f"wrote {page}")
    elif is_page(page, SCHEMA):
        page.unlink()


def _fit_one(files, directory: Path, settings, how, posterior, resume, also):
    from tirefit.data.read import read
    from tirefit.data.table import join

    tables = [read(file, **how) for file in files]
    for table in tables:
        warn(table)
    data = tables[0] if len(tables) == 1 else join(tables)
    return fit_into(directory, data, settings, posterior, resume, also)


def fit_into(directory, data, settings, posterior=False, resume=False, also=Also()):
    """Fits the data, and leaves the result and its figures in the directory."""
    from tirefit.fitting.estimate import fit as fit_data

    with claimed(directory):
        result = fit_data(data, config=settings)
        if posterior:
            # Whatever becomes of the sampling; a posterior to go on with stays.
            if not (resume and (directory / "fit.json").exists()):
                _save(result, directory, also)
                say(_first_words(result, directory))
            result = _sampled(result, directory, settings, resume)
        try:
            written = _save(result, directory, also)
        except OSError as error:
            if posterior and (directory / CHAIN).exists():
                error.add_note("--resume goes on from its chain")
            raise
    say(str(result))
    say("wrote " + ", ".join(str(path) for path in written))
    return result


def _first_words(result, directory: Path) -> str:
    """Of the least squares, which are there before the posterior is."""
    from tirefit.report.text import parameter_lines

    said = f"written to {directory}; now the posterior is sampled\n"
    return "\n".join([*parameter_lines(result)[1:], said])


def _save(result, directory: Path, also: Also) -> list[Path]:
    from tirefit.fitting.result import SCHEMA
    from tirefit.fitting.store import save_fit
    from tirefit.report.draw import FIGURE_FILES, save_figures

    earlier = [PAGE] if is_page(directory / PAGE, SCHEMA) else []
    with staged(directory, ["posterior.nc", *FIGURE_FILES, *earlier], result) as folder:
        written = save_fit(result, folder) + save_figures(result, folder, svg=also.svg)
        if also.html:
            from tirefit.report.fit_html import write_fit_page

            write_fit_page(result, folder / PAGE)
            written.append(folder / PAGE)
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
            checkpoint=directory / CHAIN,
            resume=resume,
            progress=progress,
        )


def exit_code(result, strict: bool = False) -> ExitCode:
    broken = {Outcome.NOT_CONVERGED, Outcome.CHAIN_TOO_SHORT, Outcome.INTERRUPTED}
    if broken & set(result.outcomes):
        return ExitCode.NOT_CONVERGED
    if strict and not result.identified:
        return ExitCode.NOT_IDENTIFIED
    return ExitCode.OK


def _summary(rows) -> str:
    from tirefit.report.summary import summary_table

    return summary_table([(str(directory), result) for directory, result in rows])
