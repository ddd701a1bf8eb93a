"""``tirefit fit --model mf52|mf61|mf62``: a whole Magic Formula, to a ``.tir``."""

from pathlib import Path

from tirefit.cli.options import complain, say, start_jax, warn
from tirefit.cli.output import check_directories, claimed, staged
from tirefit.results import ExitCode, InputProblem, UsageError

__all__ = [
    "MAGIC_FORMULA_NAMES", "convert_whole", "fit_whole", "only_of_magic_formula",
]  # fmt: skip

MAGIC_FORMULA_NAMES = ("mf52", "mf61", "mf62")

_SHARES_OF_NOMINAL = (0.5, 0.75, 1.0, 1.25, 1.5)
"""Loads at which a file is tested to convert it."""


def only_of_magic_formula(
    model: str | None, part: str | None, unused: dict, like: Path | None = None
) -> bool:
    """Whether a whole Magic Formula is asked for.

    Args:
        unused: option -> whether it was given, of those that it does not have.

    Raises:
        UsageError: an option of the other kind of fit was given.
    """
    whole = model in MAGIC_FORMULA_NAMES
    wrong = [option for option, given in unused.items() if given] if whole else []
    problems = []
    if wrong:
        reason = f"{', '.join(wrong)} with --model {model}"
        remedy = "leave it out: a whole Magic Formula is fitted in stages of its own"
        problems.append(InputProblem(reason, remedy))
    if part is not None and not whole:
        reason = f"--part without --model {', '.join(MAGIC_FORMULA_NAMES)}"
        problems.append(InputProblem(reason, "other models are fitted as one"))
    if like is not None and not whole:
        reason = f"--like without --model {', '.join(MAGIC_FORMULA_NAMES)}"
        problems.append(InputProblem(reason, "give priors in [parameters] of fit.toml"))
    if problems:
        raise UsageError(problems)
    return whole


def fit_whole(
    files: list[Path],
    out: Path,
    settings,
    how: dict,
    part: str,
    strict: bool,
    like: Path | None = None,
) -> ExitCode:
    """Fits all files as runs of one tire; says and writes the result."""
    from tirefit.data.read import read
    from tirefit.data.tir import notes_on, read_tir

    check_directories([out])
    other = read_tir(like) if like else None
    for text in notes_on(other) if other else ():
        complain(f"warning: {like}: {text}")
    tables = [read(file, **how) for file in files]
    for table in tables:
        warn(table)
    start_jax()
    from tirefit.fitting.mf.fit import fit_magic_formula

    with claimed(out):
        result = fit_magic_formula(
            tables, settings.model, part=part, config=settings, like=other
        )
        _write(result, out)
    return _code(result, strict)


def convert_whole(file: Path, model: str, slip_max: float, loads, out: Path):
    """Fits one version of the Magic Formula to the forces of another's file."""
    from tirefit.data.table import CANONICAL
    from tirefit.data.tir import notes_on, read_tir

    tir = read_tir(file)
    check_directories([out])
    start_jax()
    from tirefit.fitting.mf.convert import converted

    loads = loads or [share * tir.numbers["FNOMIN"] for share in _SHARES_OF_NOMINAL]
    for text in notes_on(tir):
        complain(f"warning: {file}: {text}")
    with claimed(out):
        result = converted(tir, model, slip_max, loads)
        _write(result, out)
    say(f"MISFIT of the {model} to the Magic Formula {tir.version} of {file}")
    for force, (rmse, count) in result.fitted.items():
        unit = CANONICAL[force][0]
        say(f"  {force}: RMSE {rmse:.4g} {unit} over {count} points")
    return _code(result, strict=False)


def _write(result, out: Path) -> None:
    """Says the result and writes it into the folder, which is claimed."""
    from tirefit.fitting.mf.store import save_magic_formula
    from tirefit.report.draw import FIGURE_FILES

    # Figures and draws of an earlier fit would be taken for this one's.
    with staged(out, ["posterior.nc", *FIGURE_FILES], result) as folder:
        written = save_magic_formula(result, folder)
    say(str(result))
    say("wrote " + ", ".join(str(out / path.name) for path in written))


def _code(result, strict: bool) -> ExitCode:
    if not result.converged:
        return ExitCode.NOT_CONVERGED
    return ExitCode.NOT_IDENTIFIED if strict and not result.identified else ExitCode.OK
