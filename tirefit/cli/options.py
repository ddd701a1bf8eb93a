"""Options that commands share, and the output of errors and progress."""

import errno
import inspect
import math
import re
import sys
import time
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, fields
from enum import StrEnum
from functools import wraps
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tirefit.cli import silence
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
        metavar="FILE...",
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
SetOption = Annotated[Texts, option("NAME=VALUE", "parameter of the model", "--set")]
Html = Annotated[bool, typer.Option("--html", help="write the report as one HTML page, too")]
_FORCES = "fx, fy or mz (repeat for more; default: fit one, diagnose all of the file)"
Forces = Annotated[Texts, option("", _FORCES, "--force")]
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


@dataclass(frozen=True, kw_only=True)
class DataOptions:
    """Options that describe the data files; every field is an option."""

    config: Annotated[File, path_option("FIT.TOML", "settings file")] = None
    column: Annotated[Texts, option("NAME=HEADER", "header of a quantity, e.g. fx=Force")] = None
    unit: Annotated[Texts, option("NAME=UNIT", "unit of a quantity, e.g. fx=kN")] = None
    constant: Annotated[Texts, option("NAME=VALUE", "a quantity without a column, in SI units")] = (
        None
    )
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
    names = [field.name for field in fields(DataOptions)]

    @wraps(command)
    def with_options(**given: Any) -> Any:
        options = DataOptions(**{name: given.pop(name) for name in names})
        return command(**given, options=options)

    signature = inspect.signature(command)
    of_data = [
        inspect.Parameter(
            field.name, inspect.Parameter.KEYWORD_ONLY, default=field.default, annotation=field.type
        )
        for field in fields(DataOptions)
    ]
    parameters = [
        parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)
        for parameter in signature.parameters.values()
        if parameter.name != "options"
    ]
    whole = signature.replace(parameters=[*parameters, *of_data])
    # inspect.signature uses this attribute first.
    with_options.__signature__ = whole  # type: ignore[attr-defined]
    return with_options


def given_options() -> dict[str, str]:
    """Arguments and options on the command line: name -> text, as "--set" or "FILE.tir"."""
    context = CONTEXT.get()
    return {
        param.name: param.opts[0]
        if param.param_type_name == "option"
        else param.metavar.strip("[]")
        for param in context.command.params
        if context.get_parameter_source(param.name).name == "COMMANDLINE"
    }


def refuse(names: Collection[str], where: str, remedy: str) -> None:
    """Refuse arguments and options that have no effect.

    Args:
        where: what makes them useless, as ``with --vehicle``.

    Raises:
        UsageError: some of them are given; it names all of these.
    """
    if wrong := [text for name, text in given_options().items() if name in names]:
        raise UsageError(f"{', '.join(wrong)} {where}", remedy)


def refuse_besides(used: Collection[str]) -> None:
    """Refuse all but these arguments and options, where the files are logs of a vehicle."""
    remedy = "leave it out: vehicle.toml says how logs are read"
    refuse(given_options().keys() - {*used}, "with --vehicle", remedy)


def refuse_of_vehicle(*names: str) -> None:
    """Refuse options that only logs of a vehicle have."""
    refuse(names, "without --vehicle", "name the vehicle.toml of the logs")


def _pairs(option: str, items: list[str] | None, problems: list[InputProblem]) -> dict[str, str]:
    pairs: dict[str, str] = {}
    for item in items or []:
        name, _, value = (part.strip() for part in item.partition("="))
        if not name or not value:
            remedy = f"write it as {option} NAME=VALUE"
            problems.append(InputProblem(f"{option} {item!r}", remedy))
        elif name in pairs:
            reason = f"{option} {name} is given twice: {pairs[name]!r} and {value!r}"
            problems.append(InputProblem(reason, "give it once"))
        else:
            pairs[name] = value
    return pairs


def pairs(option: str, items: list[str] | None) -> dict[str, str]:
    """NAME=VALUE options.

    Raises:
        UsageError: options that are not pairs; it lists all of them.
    """
    problems: list[InputProblem] = []
    given = _pairs(option, items, problems)
    UsageError.raise_for(problems)
    return given


def settings_of(**items: list[str] | None) -> list[dict[str, float]]:
    """Values of several NAME=VALUE options, given by their names without the hyphens.

    Raises:
        UsageError: options that are not pairs, or without a number; it lists all of them.
    """
    problems: list[InputProblem] = []
    values = [numbers(f"--{name}", texts, problems) for name, texts in items.items()]
    UsageError.raise_for(problems)
    return values


def numbers(option: str, items: list[str] | None, problems: list[InputProblem]) -> dict[str, float]:
    """Values of NAME=VALUE options; faults are added to ``problems``."""
    value_of = {}
    for name, value in _pairs(option, items, problems).items():
        try:
            value_of[name] = float(value)
            usable = math.isfinite(value_of[name])
        except ValueError:
            usable = False
        if not usable:
            reason = f"{option} {name}={value}: not a valid number"
            remedy = "give a finite value in SI units, with a point for decimals"
            problems.append(InputProblem(reason, remedy))
    return value_of


def forces_named(force: list[str] | None) -> list[str] | None:
    """The forces of ``--force``; None if it is not given.

    Raises:
        UsageError: of something that is not a force.
    """
    wrong = [name for name in force or [] if name not in ("fx", "fy", "mz")]
    if wrong:
        raise UsageError(f"--force {wrong[0]!r} is not a force", "one of fx, fy, mz")
    return force or None


_COMMANDS = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")
_SOON, _NOW_AND_THEN = 5.0, 10.0
"""Seconds until the first line of progress without a terminal, and between others."""


def read_options(given: DataOptions, config: "FitConfig | None") -> dict[str, Any]:
    """Arguments of ``tirefit.read``: those of fit.toml, overridden by options.

    Raises:
        UsageError: options that are not pairs, or without a number; it lists all.
    """
    problems: list[InputProblem] = []
    named = {
        "columns": _pairs("--column", given.column, problems),
        "units": _pairs("--unit", given.unit, problems),
        "constants": numbers("--constant", given.constant, problems),
    }
    UsageError.raise_for(problems)
    below = {} if config is None else config.data.model_dump()
    single = {}
    for name in ("convention", "slip", "rolling_radius"):
        chosen, stated = getattr(given, name), below.get(name)
        single[name] = stated if chosen is None else chosen
        if None not in (chosen, stated) and chosen != stated:
            unused = f"[data] {name} = {stated!r} is not used"
            option = f"--{name.replace('_', '-')} {chosen}"
            where = "" if config is None else config.source
            complain(f"warning: {where}: {unused}: {option} is given")
    return {
        **{name: below.get(name, {}) | pairs for name, pairs in named.items()},
        **single,
        "mask_bad_rows": given.mask_bad_rows or below.get("mask_bad_rows", False),
    }


def start_jax() -> None:
    """Start JAX as all commands use it; see :func:`tirefit.cli.start.start`."""
    from tirefit.cli.start import start

    if warning := start():
        complain(warning)


class Unheard(StringIO):
    """Replacement of standard error whose text is shown at the end; without progress."""


def say(text: str) -> None:
    """Print a text on standard output.

    Raises:
        OSError: it cannot be written, for example to a file on a full disk.
    """
    silence.broken()
    try:
        typer.echo(_printable(text))
    except BrokenPipeError:
        raise
    except OSError as error:
        raise OSError(error.errno, error.strerror, "standard output") from None


def complain(text: str) -> None:
    """Print a text on standard error; if that fails, the exit code is enough."""
    silence.broken()
    with suppress(OSError):
        typer.echo(_printable(text), err=True)


def warn_of(warnings: Iterable[str], source: object = "") -> None:
    """Print warnings, after the name of the file that they are about."""
    for text in warnings:
        complain(f"warning: {source}: {text}" if source else f"warning: {text}")


def _printable(text: str) -> str:
    """Replace characters of a file that would control the terminal."""
    return _COMMANDS.sub("\N{REPLACEMENT CHARACTER}", text)


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
def progress_bar(title: str, soon: float = _SOON) -> Iterator[Callable[[float, str], None]]:
    """Show a bar on a terminal, else print a line from time to time.

    Args:
        soon: seconds until the first line.

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
                due = time.monotonic() + _NOW_AND_THEN
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
            silence.broken()
            bar.update(task, completed=share, note=note)

        yield show


def read_config(path: Path | None) -> "FitConfig | None":
    if path is None:
        return None
    from tirefit.fitting.problem.config import load_config

    return load_config(path)
