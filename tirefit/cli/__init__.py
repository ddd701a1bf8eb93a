"""The command line: the only place that prints, exits and switches on 64-bit floats.

Nothing heavy is imported until a command runs, so completion and ``--help`` are quick.
"""

import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from tirefit.cli.fit import fit
from tirefit.cli.options import (
    ColumnOption,
    ConfigOption,
    ConstantOption,
    ConventionOption,
    Files,
    JsonOption,
    MaskOption,
    RadiusOption,
    SlipOption,
    UnitOption,
    complain,
    data_options,
    error_text,
    errors_to_exit,
    numbers,
    read_config,
    say,
    start_jax,
)
from tirefit.results import ExitCode, Problem, TirefitError, UsageError

__all__ = ["app", "main"]

app = typer.Typer(
    name="tirefit",
    help="Fit tire models to measured force-slip data with honest uncertainty.",
    epilog="Exit codes: 0 ok, 2 usage, 3 data, 4 not converged, 5 not identified"
    " (with --strict).",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


class Axle(StrEnum):
    rear = "rear"
    front = "front"


app.command()(fit)


@app.command()
def models(json: JsonOption = False) -> None:
    """List the models: parameters, units, bounds, meaning, source equation."""
    from tirefit.models import MODELS
    from tirefit.report.model_tables import models_dict, models_table

    if json:
        from json import dumps

        say(dumps(models_dict(MODELS), indent=1))
    else:
        say(models_table(MODELS))


@app.command()
def inspect(
    files: Files,
    config: ConfigOption = None,
    column: ColumnOption = None,
    unit: UnitOption = None,
    constant: ConstantOption = None,
    convention: ConventionOption = None,
    slip: SlipOption = None,
    rolling_radius: RadiusOption = None,
    mask_bad_rows: MaskOption = False,
    json: JsonOption = False,
) -> None:
    """Say what a file holds, what was assumed, and which fits it supports."""
    from json import dumps

    from tirefit.data.inspect import inspect as look
    from tirefit.data.read import read

    with errors_to_exit():
        options = data_options(
            read_config(config), column, unit, constant, convention, slip,
            rolling_radius, mask_bad_rows,
        )  # fmt: skip
        worst = ExitCode.OK
        for file in files:
            try:
                found = look(read(file, **options))
            except TirefitError as error:
                complain(error_text(error))
                worst = max(worst, error.exit_code)
                continue
            say(dumps(found.as_dict(), indent=1) if json else found.text())
        raise typer.Exit(worst)


@app.command()
def derive(
    files: Files,
    vehicle: Annotated[
        Path, typer.Option(help="vehicle.toml: mass, geometry, inertia")
    ],
    out: Annotated[Path, typer.Option(help="CSV file to write")],
    axle: Annotated[Axle, typer.Option(help="which axle")] = Axle.rear,
) -> None:
    """Turn vehicle logs into axle slip angle and force (single-track dynamics)."""
    from tirefit.data.derive import derive_files

    with errors_to_exit():
        written = derive_files(files, vehicle, out, axle=axle.value)
        say(written.summary())


@app.command()
def predict(
    source: Annotated[str, typer.Argument(metavar="FIT.json|MODEL")],
    data: Annotated[Path, typer.Argument(metavar="DATA.csv")],
    out: Annotated[Path, typer.Option(help="CSV file to write")],
    parameter: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="parameter of a named model"),
    ] = None,
    config: ConfigOption = None,
    column: ColumnOption = None,
    unit: UnitOption = None,
    constant: ConstantOption = None,
    convention: ConventionOption = None,
    slip: SlipOption = None,
    rolling_radius: RadiusOption = None,
    mask_bad_rows: MaskOption = False,
) -> None:
    """Forces of a fit or a model, row by row, in the data file's own convention."""
    with errors_to_exit():
        start_jax()
        from tirefit.data.read import read
        from tirefit.data.write import to_convention, write_csv
        from tirefit.fitting.store import load_fit
        from tirefit.fitting.store import predict as forces_of

        options = data_options(
            read_config(config), column, unit, constant, convention, slip,
            rolling_radius, mask_bad_rows,
        )  # fmt: skip
        values = numbers("--set", parameter)
        is_file = source.endswith(".json") or Path(source).is_file()
        if is_file and values:
            raise UsageError(
                Problem("--set with a fit.json", "use it with a model name")
            )
        for given in (data, Path(source)):
            if given.exists() and out.exists() and out.samefile(given):
                raise UsageError(
                    Problem(f"--out {out} is an input file", "choose another name")
                )
        fitted = load_fit(source) if is_file else source
        if is_file and options["convention"] is None:
            options["convention"] = fitted.content["data"]["convention"]
        table = read(data, **options, forces=False)
        found = to_convention(table, forces_of(fitted, table, values))
        write_csv(out, found)
        convention_text = f"convention {table.source.convention}"
        if not is_file:
            say(f"{source} with {_values_text(source, values)}")
        say(f"wrote {out}: {len(table)} rows, {', '.join(found)} ({convention_text})")


def _values_text(name: str, values: dict[str, float]) -> str:
    """Every parameter value of a named model, so that defaults are seen."""
    from tirefit.models import MODELS
    from tirefit.params import parameter_values

    everything = parameter_values(MODELS[name]) | values
    marks = {key: "" if key in values else " (default)" for key in everything}
    return ", ".join(f"{k} = {v:g}{marks[k]}" for k, v in everything.items())


@app.command()
def version() -> None:
    """Print the version."""
    from tirefit import __version__

    say(__version__)


def main() -> None:
    """Entry point of the ``tirefit`` command."""
    try:
        app()
    except KeyboardInterrupt:
        complain("interrupted")
        sys.exit(130)


if __name__ == "__main__":
    main()
