"""Fit one file, or files that are fitted together, for ``tirefit fit``."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from tirefit.cli.notes import holds_notes, warn
from tirefit.cli.options import progress_bar, say
from tirefit.cli.output import digest, done_before, say_written, write_result

if TYPE_CHECKING:  # NumPy, which completion does not wait for
    from tirefit.data.records import FileRecord
    from tirefit.data.table import TireData
    from tirefit.fitting.result import FitResult

PAGE = "fit.html"


def fit_files(directory: Path) -> list[Path]:
    """Every file that a fit may write or replace in its folder."""
    from tirefit.report.fit.figures import FIGURE_FILES

    names = ("fit.json", "posterior.nc", *FIGURE_FILES, PAGE)
    return [directory / name for name in names]


class Also(NamedTuple):
    """Options on what is written and printed in addition to result and figures."""

    html: bool = False
    full: bool = False  # the report with all details


def fit_one(
    files: Sequence[Any],
    directory: Path,
    settings: Any,
    how: dict[str, Any],
    posterior: bool,
    resume: bool,
    also: Also,
) -> "FileRecord":
    """Fit the files unless it was done before; the record of the fit.

    Args:
        settings: of the fit; how: arguments of ``tirefit.read``.
    """
    from tirefit.data.read import read
    from tirefit.data.table import join
    from tirefit.fitting.store import record_of_fit

    tables = [read(file, **how) for file in files]
    warn(*tables, assumed=tables[0].source.assumptions)
    # Everything that the result of a fit of these tables depends on.
    sources = [table.source.sha256 for table in tables]
    asked = digest(settings.model_dump(mode="json"), how, posterior, sources)
    if resume and (before := _done(directory, asked, posterior, also.html)) is not None:
        say(f"{files[0]}: done before, kept: {directory}")
        return before
    data = tables[0] if len(tables) == 1 else join(tables)
    result = fit_into(directory, data, settings, posterior, also, asked)
    return record_of_fit(result.to_dict(), str(directory))


def _done(directory: Path, asked: str, posterior: bool, html: bool) -> "FileRecord | None":
    """The record of an existing ``fit.json`` for the same data and options, with all its
    files; else None."""
    from tirefit.door import read_record
    from tirefit.fitting.result import SCHEMA
    from tirefit.fitting.store import record_of_fit

    names = ["fit.json", "fit.png", *["posterior.nc"] * posterior, *[PAGE] * html]
    files = [directory / name for name in names]

    def record_of(path: Path) -> "FileRecord":
        return record_of_fit(read_record(path, SCHEMA, ""), str(directory))

    record = done_before(files, files[0], asked, record_of)
    # A posterior that was not finished is sampled again.
    is_open = record and {"chain_too_short", "interrupted"} & {*record.outcomes}
    return None if is_open else record


def fit_into(
    directory: Path,
    data: "TireData",
    settings: Any,
    posterior: bool = False,
    also: Also = Also(),
    asked: str = "",
) -> "FitResult":
    """Fit the data, and write the result and its figures into the directory."""
    from tirefit.fitting.estimate import fit as fit_data
    from tirefit.report.fit.figures import save_figures

    known = [path.name for path in fit_files(directory)]
    result = fit_data(data, config=settings)
    if posterior:
        # Without figures, which are drawn once: half a second each.
        write_result(result, directory, known, {}, text="")
        say(f"least squares: fit.json written to {directory}; sampling the posterior\n")
        from tirefit.fitting.uncertainty.posterior import sample

        chosen = settings.posterior
        names = ("sampler", "walkers", "effective_samples", "max_steps")
        how = {name: getattr(chosen, name) for name in names}
        with progress_bar("posterior") as progress:
            result = sample(result, **how, progress=progress)
    result = replace(result, asked=asked)
    draw, page = partial(save_figures, result), PAGE if also.html else ""
    written = write_result(result, directory, known, draw, page, text="")
    # The assumptions of several files are printed once, merged, at the end.
    record = result.data | ({"assumptions": []} if holds_notes() else {})
    say(replace(result, data=record).summary(full=also.full))
    say_written(directory, written)
    return result
