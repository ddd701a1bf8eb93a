"""Options that commands share, and how mistakes and progress reach the terminal."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from tirefit.results import ExitCode, Problem, TirefitError, UsageError

__all__ = [
    "ColumnOption",
    "ConfigOption",
    "ConstantOption",
    "ConventionOption",
    "Files",
    "JsonOption",
    "MaskOption",
    "RadiusOption",
    "SlipOption",
    "UnitOption",
    "complain",
    "data_options",
    "error_text",
    "errors_to_exit",
    "numbers",
    "progress_bar",
    "read_config",
    "say",
    "start_jax",
]

Files = Annotated[list[Path], typer.Argument(metavar="FILE...", help="CSV files")]
ColumnOption = Annotated[
    list[str] | None,
    typer.Option("--column", metavar="NAME=HEADER", help="header of a column"),
]
UnitOption = Annotated[
    list[str] | None,
    typer.Option("--unit", metavar="NAME=UNIT", help="unit of a column, e.g. fx=kN"),
]
ConstantOption = Annotated[
    list[str] | None,
    typer.Option(
        "--constant", metavar="NAME=VALUE", help="column constant in SI units"
    ),
]
ConventionOption = Annotated[
    str | None,
    typer.Option(
        help="signs of the file: braking (slip and force positive when braking),"
        " iso-w (driving positive, z up), sae (driving positive, z down),"
        " adapted-sae (driving positive, F_y > 0 for alpha > 0); braking if not given"
    ),
]
SlipOption = Annotated[
    str | None,
    typer.Option("--slip", help="slip definition: sigma_x, kappa, s, slip_ratio"),
]
RadiusOption = Annotated[
    float | None, typer.Option("--rolling-radius", help="effective radius [m]")
]
MaskOption = Annotated[
    bool, typer.Option("--mask-bad-rows", help="mask and list bad rows, do not stop")
]
ConfigOption = Annotated[
    Path | None, typer.Option("--config", metavar="FIT.TOML", help="configuration")
]
JsonOption = Annotated[bool, typer.Option("--json", help="print JSON")]


def _pairs(option: str, items: list[str] | None) -> dict[str, str]:
    pairs = {}
    for item in items or []:
        name, separator, value = item.partition("=")
        if not separator or not name or not value:
            raise UsageError(
                Problem(f"{option} {item!r}", f"write it as {option} NAME=VALUE")
            )
        pairs[name.strip()] = value.strip()
    return pairs


def numbers(option: str, items: list[str] | None) -> dict[str, float]:
    numbers = {}
    for name, value in _pairs(option, items).items():
        try:
            numbers[name] = float(value)
        except ValueError:
            raise UsageError(
                Problem(f"{option} {name}={value}: not a number", "give an SI value")
            ) from None
    return numbers


def data_options(
    config, column, unit, constant, convention, slip, radius, mask
) -> dict[str, Any]:
    """Options of the command line over those of fit.toml, for ``read``."""
    base = config.data if config is not None else None
    merged = {
        "columns": (dict(base.columns) if base else {}) | _pairs("--column", column),
        "units": (dict(base.units) if base else {}) | _pairs("--unit", unit),
        "constants": (dict(base.constants) if base else {})
        | numbers("--constant", constant),
        "convention": convention or (base.convention if base else None),
        "slip": slip or (base.slip if base else None),
        "rolling_radius": radius
        if radius is not None
        else (base and base.rolling_radius),
        "mask_bad_rows": mask or bool(base and base.mask_bad_rows),
    }
    return merged


def start_jax() -> None:
    """64-bit floats, and a compilation cache that outlives the process."""
    import jax

    from tirefit.compiled import keep_programs_in

    jax.config.update("jax_enable_x64", True)
    if jax.config.jax_compilation_cache_dir is None:
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        cache = Path(base) / "tirefit"
        jax.config.update("jax_compilation_cache_dir", str(cache))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
        jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
        keep_programs_in(cache / "programs")


def say(text: str) -> None:
    typer.echo(text)


def complain(text: str) -> None:
    typer.echo(text, err=True)


@contextmanager
def errors_to_exit() -> Iterator[None]:
    """A user's mistake becomes its message and its exit code."""
    try:
        yield
    except TirefitError as error:
        complain(error_text(error))
        raise typer.Exit(error.exit_code) from None
    except BrokenPipeError:
        raise typer.Exit(ExitCode.OK) from None
    except OSError as error:
        complain(f"error: {error.filename or ''}: {error.strerror}")
        raise typer.Exit(ExitCode.USAGE) from None


def error_text(error: TirefitError) -> str:
    count = len(error.problems)
    head = "error" if count == 1 else f"error: {count} problems"
    return "\n".join([f"{head}:"] + [f"  {problem}" for problem in error.problems])


@contextmanager
def progress_bar(title: str) -> Iterator[Any]:
    """A bar on the terminal; None, and silence, where there is none."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(),
        TextColumn("{task.fields[note]}"),
    )  # fmt: skip
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(title, total=1.0, note="")
        yield lambda share, note: bar.update(task, completed=share, note=note)


def read_config(path: Path | None):
    if path is None:
        return None
    from tirefit.fitting.config import load_config

    return load_config(path)
