"""``tirefit fit --model mf52|mf61|mf62``: fit a whole Magic Formula, write a ``.tir``."""

from collections.abc import Collection
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from tirefit.cli.commands.fit_one import PAGE, Also, fit_files
from tirefit.cli.notes import warn
from tirefit.cli.options import option, progress_bar, refuse, start_jax, warn_of
from tirefit.cli.output import check_results, write_result
from tirefit.results import ExitCode, exit_code

MAGIC_FORMULA_NAMES = ("mf52", "mf61", "mf62")

Combination = StrEnum("Combination", "none similarity ellipse")

_COMBINATION = """\
FILE.tir, combined slip: by its weighting functions only (none), by the method of similarity or by \
the friction ellipse of PAC2002 (default: ellipse if the file says FE_METHOD = YES, else \
similarity for forces without coefficients of combined slip)"""
CombinationOption = Annotated[Combination | None, option("", _COMBINATION, "--combination")]


def is_whole(model: str | None, of_whole: Collection[str], unused: Collection[str]) -> bool:
    """Whether the model is a whole Magic Formula; raises UsageError for an option of the other
    kind of fit, of those ``of_whole`` or those that it leaves ``unused``."""
    whole = model in MAGIC_FORMULA_NAMES
    wrong, word = (unused, "with") if whole else (of_whole, "without")
    names = model if whole else ", ".join(MAGIC_FORMULA_NAMES)
    remedy = "leave it out: only a whole Magic Formula is fitted in fixed stages"
    refuse(wrong, f"{word} --model {names}", remedy)
    return whole


def fit_whole(
    files: list[Path],
    out: Path,
    settings: Any,
    how: dict[str, Any],
    options: dict[str, Any],
    strict: bool,
    also: Also,
) -> ExitCode:
    """Fit all files as runs of one tire; print and write the result with figures.

    ``options`` are arguments of :func:`~tirefit.fitting.mf.fit.fit_magic_formula`.
    """
    from tirefit.data.read import read
    from tirefit.data.tir.tir import notes_on, read_tir
    from tirefit.report.fit.mf_figures import MAGIC_FORMULA_FILES, save_magic_formula

    also_made = [out / name for name in ("fit.tir", *MAGIC_FORMULA_FILES)]
    made = dict.fromkeys([*fit_files(out), *also_made])
    check_results(made, files)
    if like := options.get("like"):
        options = options | {"like": read_tir(like)}
        warn_of(notes_on(options["like"]), like)
    tables = [read(file, **how) for file in files]
    warn(*tables)
    start_jax()
    from tirefit.fitting.mf.fit import fit_magic_formula

    with progress_bar("fit") as progress:
        result = fit_magic_formula(
            tables, settings.model, config=settings, progress=progress, **options
        )
    # Figures and draws of an earlier fit would be mistaken for those of this one.
    known = [path.name for path in made]
    figures, page = partial(save_magic_formula, result), PAGE if also.html else ""
    write_result(result, out, known, figures, page, full=also.full)
    return exit_code(result.outcomes, strict)
