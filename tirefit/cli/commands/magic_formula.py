"""``tirefit fit --model mf52|mf61|mf62``: fit a whole Magic Formula, write a ``.tir``."""

from collections.abc import Collection, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tirefit.cli.commands.fit_one import PAGE, Also, fit_files
from tirefit.cli.notes import warn
from tirefit.cli.options import option, progress_bar, refuse, say, start_jax, warn_of
from tirefit.cli.output import check_results, claimed, write_result
from tirefit.results import ExitCode, exit_code

if TYPE_CHECKING:
    from tirefit.fitting.mf.result import MagicFormulaFit


MAGIC_FORMULA_NAMES = ("mf52", "mf61", "mf62")

Combination = StrEnum("Combination", "none similarity ellipse")

_COMBINATION = """\
FILE.tir, combined slip: by its weighting functions only (none), by the method of similarity or by \
the friction ellipse of PAC2002 (default: ellipse if the file says FE_METHOD = YES, else \
similarity for forces without coefficients of combined slip)"""
CombinationOption = Annotated[Combination | None, option("", _COMBINATION, "--combination")]


def is_whole(model: str | None, of_whole: Collection[str], unused: Collection[str]) -> bool:
    """Whether the model is a whole Magic Formula.

    Args:
        of_whole: options that only a whole Magic Formula has.
        unused: options that it does not have.

    Raises:
        UsageError: an option of the other kind of fit was given.
    """
    whole = model in MAGIC_FORMULA_NAMES
    if whole:
        remedy = "leave it out: a whole Magic Formula is fitted in fixed stages"
        refuse(unused, f"with --model {model}", remedy)
    else:
        remedy = "leave it out: other models have no such stages"
        refuse(of_whole, f"without --model {', '.join(MAGIC_FORMULA_NAMES)}", remedy)
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

    check_results(_files(out), files)
    if like := options.get("like"):
        options = options | {"like": read_tir(like)}
        warn_of(notes_on(options["like"]), like)
    tables = [read(file, **how) for file in files]
    warn(*tables)
    start_jax()
    from tirefit.fitting.mf.fit import fit_magic_formula

    with claimed(out):
        with progress_bar("fit") as progress:
            result = fit_magic_formula(
                tables, settings.model, config=settings, progress=progress, **options
            )
        _write(result, out, also)
    return exit_code(result.outcomes, strict)


def convert_whole(
    file: Path,
    model: str,
    slip_max: float,
    loads: Sequence[float] | None,
    out: Path,
    of_file: dict[str, Any],
) -> ExitCode:
    """Fit a version of the Magic Formula to the forces of a file of another version."""
    from tirefit.data.table import CANONICAL
    from tirefit.data.tir.tir import read_tir

    check_results(_files(out))
    tir = read_tir(file)
    start_jax()
    from tirefit.fitting.mf.convert import converted
    from tirefit.fitting.tir import USUAL_SHARES

    loads = loads or [share * tir.numbers["FNOMIN"] for share in USUAL_SHARES]
    with claimed(out):
        result = converted(tir, model, slip_max, loads, **of_file)
        _write(result, out, advice="try other --loads or a smaller --slip-max")
    signs = of_file["signs"]
    in_signs = f" in signs {signs}" if signs else ""
    say(f"MISFIT of the {model} to the Magic Formula {tir.version} of {file}{in_signs}")
    for force, (rmse, count) in result.fitted.items():
        unit = CANONICAL[force][0]
        say(f"  {force}: RMSE {rmse:.4g} {unit} over {count} points")
    return exit_code(result.outcomes)


_ADVICE = "give starting values in fit.toml or fix a parameter"
"""Advice in the report of a fit that does not converge; `convert` has no fit.toml."""


def _files(out: Path) -> list[Path]:
    """Every file that a fit of a whole Magic Formula may write or replace."""
    from tirefit.report.fit.mf_figures import MAGIC_FORMULA_FILES

    return [*fit_files(out), *(out / name for name in ("fit.tir", *MAGIC_FORMULA_FILES))]


def _write(
    result: "MagicFormulaFit", out: Path, also: Also | None = None, advice: str = _ADVICE
) -> None:
    """Print the result and write it into the claimed folder; ``also``: figures."""
    from tirefit.report.fit.mf_figures import save_magic_formula

    def draw(folder: Path) -> None:
        if also is not None:
            save_magic_formula(result, folder)

    # Figures and draws of an earlier fit would be mistaken for those of this one.
    known = [*dict.fromkeys(path.name for path in _files(out))]
    text = result.summary(full=also is not None and also.full).replace(_ADVICE, advice)
    write_result(result, out, known, draw, PAGE if also and also.html else "", text=text)
