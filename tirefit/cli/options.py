"""Options that commands share, and the output of errors and progress."""

import errno
import inspect
import math
import re
import sys
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from enum import StrEnum
from functools import wraps
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tirefit.data.readers.remote import file_at
from tirefit.names import MODEL_NAMES
from tirefit.results import ExitCode, InputProblem, TirefitError, UsageError
from tirefit.slip import CONVENTIONS, SLIP_DEFINITIONS

if TYPE_CHECKING:
    from tirefit.fitting.problem.config import FitConfig


CONTEXT: ContextVar[Any] = ContextVar("CONTEXT", default=None)
"""The command that runs, with the values of its options; None in a worker."""


def option(metavar: str, help: str, *flags: str, **how: Any) -> Any:
    """An option; its name is that of the parameter unless ``flags`` give it."""
    return typer.Option(*flags, metavar=metavar or None, help=help, **how)


def path_option(metavar: str, help: str) -> Any:
    """An option that takes the path of a file or folder; an empty name (an unset variable of the
    shell) is an error."""

    def named_path(text: str) -> Path:
        if not text:
            raise typer.BadParameter("it is empty: give a name")
        return Path(text)

    return option(metavar, help, parser=named_path)


def completed(*names: str) -> Callable[[str], list[str]]:
    """Completion of an option from its names."""

    def beginning(incomplete: str) -> list[str]:
        return [name for name in names if name.startswith(incomplete)]

    return beginning


model_names = completed(*MODEL_NAMES)

Text = str | None
Texts = list[str] | None
Number = float | None
File = Path | None
Files = Annotated[
    list[Path],
    typer.Argument(
        metavar="FILE",
        parser=file_at,
        help="measurements: CSV, TYDEX, MATLAB, Parquet, Arrow, Excel, MDF, ROS bags;"
        " paths, addresses (s3://...), or patterns of them in quotes",
    ),
]
Folder = Annotated[Path, path_option("FOLDER", "folder of the results")]
OutFile = Annotated[Path, path_option("FILE.csv", "CSV file to write")]
_SEED = typer.Option(min=0, max=2**32 - 1, help="seed of the random numbers")
Seed = Annotated[int, _SEED]
SeedOrNone = Annotated[int | None, _SEED]
Full = Annotated[bool, typer.Option("--full", help="print the report with all details")]
Html = Annotated[bool, typer.Option("--html", help="write the report as one HTML page, too")]
Force = StrEnum("Force", "fx fy mz")
_FORCES = "force to use (repeat for more; default: fit one, diagnose all of the file)"
Forces = Annotated[list[Force] | None, option("", _FORCES, "--force")]
Resume = Annotated[bool, option("", "skip finished files", "--resume")]

Side = StrEnum("Side", "left right")

SideOption = Annotated[
    Side | None, option("", "FILE.tir: side of the vehicle (default: TYRESIDE of the file)")
]
_SIGNS = "sign convention of FILE.tir, and of fx_sim, ... in diagnose; values as for --convention"
_SIGNS += " (default: iso-w)"
SignsOption = Annotated[Text, option("", _SIGNS, autocompletion=completed(*CONVENTIONS))]


_CONVENTION = """\
signs of the file: braking (slip and force positive when braking), iso-w (driving positive, z up), \
sae (driving positive, z down), adapted-sae (driving positive, F_y > 0 for alpha > 0); default: as \
the file states, else braking"""
_SLIP = "definition of the slip column: sigma_x, kappa, s, slip_ratio"


def pair(text: str) -> tuple[str, str]:
    """The name and the value of NAME=VALUE."""
    name, _, value = (part.strip() for part in text.partition("="))
    if not name or not value:
        raise typer.BadParameter(f"{text!r}: write it as NAME=VALUE")
    return name, value


def number(text: str) -> tuple[str, float]:
    """The name and the value of NAME=NUMBER."""
    name, value = pair(text)
    with suppress(ValueError):
        if math.isfinite(float(value)):
            return name, float(value)
    remedy = "give a finite value in SI units, with a point for decimals"
    raise typer.BadParameter(f"{text}: not a valid number: {remedy}")


def by_name(pairs: Sequence[tuple[str, Any]] | None) -> dict[str, Any]:
    """The values of an option with pairs, by name.

    Raises:
        UsageError: a name is given twice.
    """
    values: dict[str, Any] = {}
    for name, value in pairs or ():
        if name in values:
            reason = f"{name} is given twice: {values[name]!r} and {value!r}"
            raise UsageError(reason, "give it once")
        values[name] = value
    return values


Pairs = list[Any] | None  # of a parser: typer knows no list of pairs
_SET = option("NAME=VALUE", "parameter of the model", "--set", parser=number)
SetOption = Annotated[Pairs, _SET]
_HEADER = option("NAME=HEADER", "header of a quantity, e.g. fx=Force", parser=pair)
_UNIT = option("NAME=UNIT", "unit of a quantity, e.g. fx=kN", parser=pair)
_GIVEN = option("NAME=VALUE", "a quantity without a column, in SI units", parser=number)


@dataclass(frozen=True, kw_only=True)
class DataOptions:
    """Options that describe the data files; every field is an option."""

    config: Annotated[File, path_option("FIT.TOML", "settings file")] = None
    column: Annotated[Pairs, _HEADER] = None
    unit: Annotated[Pairs, _UNIT] = None
    constant: Annotated[Pairs, _GIVEN] = None
    convention: Annotated[Text, option("", _CONVENTION, autocompletion=completed(*CONVENTIONS))] = (
        None
    )
    slip: Annotated[Text, option("", _SLIP, autocompletion=completed(*SLIP_DEFINITIONS))] = None
    rolling_radius: Annotated[Number, option("", "effective rolling radius [m]")] = None
    mask_bad_rows: Annotated[
        bool, option("", "exclude and list invalid rows, and continue", "--mask-bad-rows")
    ] = False


def takes_data_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """The command with the fields of :class:`DataOptions` as options.

    They replace its parameter ``options``, which receives them as one object.
    """
    signature, of_data = inspect.signature(command), inspect.signature(DataOptions).parameters

    @wraps(command)
    def with_options(**given: Any) -> Any:
        options = DataOptions(**{name: given.pop(name) for name in of_data})
        return command(**given, options=options)

    of_command = [p for p in signature.parameters.values() if p.name != "options"]
    whole = [p.replace(kind=p.KEYWORD_ONLY) for p in (*of_command, *of_data.values())]
    # inspect.signature uses this attribute first.
    with_options.__signature__ = signature.replace(parameters=whole)  # type: ignore[attr-defined]
    return with_options


def refuse(names: Collection[str], where: str, remedy: str) -> None:
    """Refuse arguments and options that have no effect.

    Args:
        where: what makes them useless, as ``with --vehicle``.

    Raises:
        UsageError: some of them are on the command line; it names all of these.
    """
    context = CONTEXT.get()
    wrong = [
        param.opts[0] if param.param_type_name == "option" else param.metavar.strip("[]")
        for param in context.command.params
        if param.name in names and context.get_parameter_source(param.name).name == "COMMANDLINE"
    ]
    if wrong:
        raise UsageError(f"{', '.join(wrong)} {where}", remedy)


def refuse_by_vehicle(vehicle: Path | None, used: Collection[str], only: Collection[str]) -> None:
    """Refuse options that logs of a vehicle do not use, or that ``only`` these have.

    Args:
        vehicle: of ``--vehicle``.
        used: arguments and options for logs, those of ``only`` included.
    """
    if vehicle is None:
        refuse(only, "without --vehicle", "name the vehicle.toml of the logs")
        return
    unused = {param.name for param in CONTEXT.get().command.params} - {*used}
    remedy = "leave it out: logs have no such option (vehicle.toml says how they are read)"
    refuse(unused, "with --vehicle", remedy)


def read_options(given: DataOptions, config: "FitConfig | None" = None) -> dict[str, Any]:
    """Arguments of ``tirefit.read``: those of fit.toml, overridden by options.

    Args:
        config: the content of fit.toml, if it was read before.
    """
    config = config or read_config(given.config)
    below = {} if config is None else config.data.model_dump()
    how: dict[str, Any] = {
        "columns": below.get("columns", {}) | by_name(given.column),
        "units": below.get("units", {}) | by_name(given.unit),
        "constants": below.get("constants", {}) | by_name(given.constant),
    }
    for name in ("convention", "slip", "rolling_radius"):
        chosen, stated = getattr(given, name), below.get(name)
        how[name] = stated if chosen is None else chosen
        if None not in (chosen, stated) and chosen != stated:
            unused = f"[data] {name} = {stated!r} is not used"
            where = "" if config is None else config.source
            warn_of([f"{unused}: --{name.replace('_', '-')} {chosen} is given"], where)
    how["mask_bad_rows"] = given.mask_bad_rows or below.get("mask_bad_rows", False)
    return how


def start_jax() -> None:
    """Start JAX as all commands use it; see :func:`tirefit.cli.start.start`."""
    from tirefit.cli.start import start

    if warning := start():
        complain(warning)


class Unheard(StringIO):
    """Replacement of standard error whose text is shown at the end; without progress."""


_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")
"""Characters that would control the terminal; a text may have them from a file."""


def _print(text: str, *, err: bool = False) -> None:
    """Print a text without control characters."""
    typer.echo(_CONTROL.sub("\N{REPLACEMENT CHARACTER}", text), err=err)


def say(text: str) -> None:
    """Print a text on standard output.

    Raises:
        OSError: it cannot be written, for example to a file on a full disk.
    """
    try:
        _print(text)
    except BrokenPipeError:
        raise
    except OSError as error:
        raise OSError(error.errno, error.strerror, "standard output") from None


def complain(text: str) -> None:
    """Print a text on standard error; if that fails, the exit code is enough."""
    with suppress(OSError):
        _print(text, err=True)


def warn_of(warnings: Iterable[str], source: object = "") -> None:
    """Print warnings, after the name of the file that they are about."""
    for text in warnings:
        complain(f"warning: {source}: {text}" if source else f"warning: {text}")


@contextmanager
def errors_to_exit() -> Iterator[None]:
    """Print the message of a user's error and exit with its code."""
    try:
        yield
    except BrokenPipeError:
        raise typer.Exit(ExitCode.OK) from None
    except (TirefitError, OSError) as error:
        complain(error_text(error))
        code = error.exit_code if isinstance(error, TirefitError) else ExitCode.USAGE
        raise typer.Exit(code) from None


def error_text(error: TirefitError | OSError) -> str:
    """All problems, each with its place and remedy; of a file that could not be written, also
    what it holds now."""
    if isinstance(error, OSError):
        cause = " ".join((error.strerror or str(error)).split())[:200]
        notes = "".join(f"; {note}" for note in getattr(error, "__notes__", ()))
        is_full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
        remedy = "make room" if is_full else "check that it can be written to"
        file = str(error.filename or "a file or the output")
        reason = f"cannot be written: {cause}{notes}"
        return f"error:\n  {InputProblem(reason, f'{remedy}, or choose another place', file)}"
    count = len(error.problems)
    head = "error" if count == 1 else f"error: {count} problems"
    return "\n".join([f"{head}:"] + [f"  {problem}" for problem in error.problems])


def has_terminal() -> bool:
    """Whether standard error is a terminal, on which progress is shown."""
    return sys.stderr.isatty()


@contextmanager
def progress_bar(title: str, soon: float = 5.0) -> Iterator[Callable[[float, str], None]]:
    """Show a bar on a terminal, else print a line from time to time.

    Args:
        soon: seconds until the first line, without a terminal.

    Yields:
        A function of the share that is done, and of a note.
    """
    if isinstance(sys.stderr, Unheard):
        yield lambda share, note: None
        return
    if not has_terminal():
        due = time.monotonic() + soon

        def tell(share: float, note: str) -> None:
            nonlocal due
            if share and time.monotonic() >= due:
                due = time.monotonic() + 10.0  # seconds between lines
                complain(f"{title}: {100 * share:.0f} %, {note}")

        yield tell
        return
    # Slow to import, and used only on a terminal.
    from rich.console import Console
    from rich.progress import Progress, TextColumn

    columns = (*Progress.get_default_columns(), TextColumn("{task.fields[note]}"))
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=1.0, note="")

        def show(share: float, note: str) -> None:
            bar.update(task, completed=share, note=note)

        yield show


def read_config(path: Path | None) -> "FitConfig | None":
    """The settings in a fit.toml; None of no file."""
    if path is None:
        return None
    from tirefit.fitting.problem.config import load_config

    return load_config(path)
