"""The command line: the only place that prints, exits and switches on 64-bit floats.

Nothing heavy is imported until a command runs, so completion and ``--help`` are quick.
"""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from tirefit.results import ExitCode, Outcome, Problem, TirefitError, UsageError

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


class Solver(StrEnum):
    optimistix = "optimistix"
    jaxopt = "jaxopt"
    gauss_newton = "gauss-newton"


class Sampler(StrEnum):
    emcee = "emcee"
    hmc = "hmc"


class Axle(StrEnum):
    rear = "rear"
    front = "front"


def _model_names() -> list[str]:
    from tirefit.models import MODELS

    return list(MODELS)


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
    typer.Option(help="signs of the file: braking, iso-w, sae, adapted-sae"),
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


def _numbers(option: str, items: list[str] | None) -> dict[str, float]:
    numbers = {}
    for name, value in _pairs(option, items).items():
        try:
            numbers[name] = float(value)
        except ValueError:
            raise UsageError(
                Problem(f"{option} {name}={value}: not a number", "give an SI value")
            ) from None
    return numbers


def _data_options(
    config, column, unit, constant, convention, slip, radius, mask
) -> dict[str, Any]:
    """Options of the command line over those of fit.toml, for ``read``."""
    base = config.data if config is not None else None
    merged = {
        "columns": (dict(base.columns) if base else {}) | _pairs("--column", column),
        "units": (dict(base.units) if base else {}) | _pairs("--unit", unit),
        "constants": (dict(base.constants) if base else {})
        | _numbers("--constant", constant),
        "convention": convention or (base.convention if base else None),
        "slip": slip or (base.slip if base else None),
        "rolling_radius": radius or (base.rolling_radius if base else None),
        "mask_bad_rows": mask or bool(base and base.mask_bad_rows),
    }
    return merged


def _start_jax() -> None:
    """64-bit floats, and a compilation cache that outlives the process."""
    import jax

    jax.config.update("jax_enable_x64", True)
    if jax.config.jax_compilation_cache_dir is None:
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        jax.config.update("jax_compilation_cache_dir", str(Path(base) / "tirefit"))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
        jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def _say(text: str) -> None:
    typer.echo(text)


def _complain(text: str) -> None:
    typer.echo(text, err=True)


@contextmanager
def _errors_to_exit() -> Iterator[None]:
    """A user's mistake becomes its message and its exit code."""
    try:
        yield
    except TirefitError as error:
        _complain(_error_text(error))
        raise typer.Exit(error.exit_code) from None
    except BrokenPipeError:
        raise typer.Exit(ExitCode.OK) from None
    except OSError as error:
        _complain(f"error: {error.filename or ''}: {error.strerror}")
        raise typer.Exit(ExitCode.USAGE) from None


def _error_text(error: TirefitError) -> str:
    count = len(error.problems)
    head = "error" if count == 1 else f"error: {count} problems"
    return "\n".join([f"{head}:"] + [f"  {problem}" for problem in error.problems])


@contextmanager
def _progress(title: str) -> Iterator[Any]:
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


@app.command()
def models(json: JsonOption = False) -> None:
    """List the models: parameters, units, bounds, meaning, source equation."""
    from tirefit.models import MODELS
    from tirefit.report import text

    if json:
        from json import dumps

        _say(dumps(text.models_dict(MODELS), indent=1))
    else:
        _say(text.models_table(MODELS))


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

    with _errors_to_exit():
        options = _data_options(
            _read_config(config), column, unit, constant, convention, slip,
            rolling_radius, mask_bad_rows,
        )  # fmt: skip
        worst = ExitCode.OK
        for file in files:
            try:
                found = look(read(file, **options))
            except TirefitError as error:
                _complain(_error_text(error))
                worst = max(worst, error.exit_code)
                continue
            _say(dumps(found.as_dict(), indent=1) if json else found.text())
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

    with _errors_to_exit():
        written = derive_files(files, vehicle, out, axle=axle.value)
        _say(written.summary())


def _read_config(path: Path | None):
    if path is None:
        return None
    from tirefit.fit.config import load_config

    return load_config(path)


def _output_directories(files: list[Path], out: Path | None, joint: bool) -> list[Path]:
    stems = [_stem(file) for file in files]
    twice = sorted({stem for stem in stems if stems.count(stem) > 1})
    if twice and not joint:
        raise UsageError(
            Problem(
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


@app.command()
def fit(
    files: Files,
    model: Annotated[
        str | None,
        typer.Option(
            help="a name of `tirefit models`; brush by default",
            autocompletion=_model_names,
        ),
    ] = None,
    config: ConfigOption = None,
    posterior: Annotated[
        bool, typer.Option("--posterior/--no-posterior", help="sample the posterior")
    ] = True,
    solver: Annotated[Solver | None, typer.Option(help="least-squares solver")] = None,
    sampler: Annotated[Sampler | None, typer.Option(help="posterior sampler")] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="of everything random")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="directory of the results")] = None,
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
        bool, typer.Option("--resume", help="continue the chain kept in the directory")
    ] = False,
    svg: Annotated[
        bool, typer.Option("--svg", help="write every figure as SVG too")
    ] = False,
    column: ColumnOption = None,
    unit: UnitOption = None,
    constant: ConstantOption = None,
    convention: ConventionOption = None,
    slip: SlipOption = None,
    rolling_radius: RadiusOption = None,
    mask_bad_rows: MaskOption = False,
) -> None:
    """Fit a model: parameters, uncertainties, figures and a report."""
    with _errors_to_exit():
        from tirefit.fit.config import FitConfig

        base = _read_config(config) or FitConfig()
        options = _data_options(
            base,
            column,
            unit,
            constant,
            convention,
            slip,
            rolling_radius,
            mask_bad_rows,
        )
        changes = {
            "model": model, "seed": seed, "force": _forces(force),
            "solver": solver.value if solver else None,
        }  # fmt: skip
        settings = base.model_copy(
            update={k: v for k, v in changes.items() if v is not None}
        )
        if sampler is not None:
            chosen = settings.posterior.model_copy(update={"sampler": sampler.value})
            settings = settings.model_copy(update={"posterior": chosen})
        directories = _output_directories(files, out, joint)
        _start_jax()
        from tirefit.fit.problem import find_model

        find_model(settings.model or "brush")
        groups = [files] if joint else [[file] for file in files]
        worst = _fit_all(
            groups, directories, settings, options, posterior, resume, svg, strict
        )
        raise typer.Exit(worst)


def _forces(force: list[str] | None) -> list[str] | None:
    wrong = [name for name in force or [] if name not in ("fx", "fy", "mz")]
    if wrong:
        raise UsageError(Problem(f"--force {wrong[0]!r}", "one of fx, fy, mz"))
    return force or None


def _fit_all(
    groups, directories, settings, options, posterior, resume, svg, strict
) -> ExitCode:
    """Every group of files; one bad file does not stop the others."""
    codes, rows = [], []
    for group, directory in zip(groups, directories, strict=True):
        try:
            result = _fit_one(
                group, directory, settings, options, posterior, resume, svg
            )
        except TirefitError as error:
            if len(groups) == 1 or error.exit_code == ExitCode.USAGE:
                raise
            _complain(_error_text(error))
            codes.append(error.exit_code)
            continue
        codes.append(_exit_code(result, strict))
        rows.append((directory, result))
        if Outcome.INTERRUPTED in result.outcomes:
            break
    if len(groups) > 1:
        _say(_summary(rows))
    # Bad data first, then convergence, then identification.
    order = (ExitCode.DATA, ExitCode.NOT_CONVERGED, ExitCode.NOT_IDENTIFIED)
    return next((code for code in order if code in codes), ExitCode.OK)


def _fit_one(files, directory: Path, settings, options, posterior, resume, svg):
    from tirefit.data.read import read
    from tirefit.data.table import join
    from tirefit.fit.estimate import fit as fit_data
    from tirefit.fit.store import save_fit
    from tirefit.report.draw import save_figures

    tables = [read(file, **options) for file in files]
    data = tables[0] if len(tables) == 1 else join(tables)
    result = fit_data(data, config=settings)
    directory.mkdir(parents=True, exist_ok=True)
    if posterior:
        result = _sampled(result, directory, settings, resume)
    written = save_fit(result, directory)
    written += save_figures(result, directory, svg=svg)
    _say(str(result))
    _say("wrote " + ", ".join(str(path) for path in written))
    return result


def _sampled(result, directory: Path, settings, resume: bool):
    from tirefit.fit.posterior import sample

    chosen = settings.posterior
    with _progress("posterior") as progress:
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


def _exit_code(result, strict: bool) -> ExitCode:
    broken = {Outcome.NOT_CONVERGED, Outcome.CHAIN_TOO_SHORT, Outcome.INTERRUPTED}
    if broken & set(result.outcomes):
        return ExitCode.NOT_CONVERGED
    if strict and not result.identified:
        return ExitCode.NOT_IDENTIFIED
    return ExitCode.OK


def _summary(rows) -> str:
    from tirefit.report.text import summary_table

    return summary_table([(str(directory), result) for directory, result in rows])


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
    with _errors_to_exit():
        _start_jax()
        from tirefit.data.read import read
        from tirefit.data.write import to_convention, write_csv
        from tirefit.fit.store import load_fit
        from tirefit.fit.store import predict as forces_of

        options = _data_options(
            _read_config(config), column, unit, constant, convention, slip,
            rolling_radius, mask_bad_rows,
        )  # fmt: skip
        values = _numbers("--set", parameter)
        is_file = source.endswith(".json") or Path(source).is_file()
        if is_file and values:
            raise UsageError(
                Problem("--set with a fit.json", "use it with a model name")
            )
        table = read(data, **options, forces=False)
        fitted = load_fit(source) if is_file else source
        found = to_convention(table, forces_of(fitted, table, values))
        write_csv(out, found)
        convention_text = f"convention {table.source.convention}"
        _say(f"wrote {out}: {len(table)} rows, {', '.join(found)} ({convention_text})")


@app.command()
def version() -> None:
    """Print the version."""
    from tirefit import __version__

    _say(__version__)


def main() -> None:
    """Entry point of the ``tirefit`` command."""
    try:
        app()
    except KeyboardInterrupt:
        _complain("interrupted")
        sys.exit(130)


if __name__ == "__main__":
    main()
