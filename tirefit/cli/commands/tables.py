"""Small commands: tables of models, methods, files and forces."""

from collections.abc import Mapping
from dataclasses import replace
from enum import StrEnum
from json import dumps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tirefit import __version__
from tirefit.cli import options as cli
from tirefit.cli.commands.magic_formula import CombinationOption
from tirefit.cli.fleet import Piece, Sharing, run_pieces, worst_of
from tirefit.cli.notes import warn
from tirefit.cli.output import check_inputs_kept, check_results
from tirefit.data.readers.remote import expanded
from tirefit.data.tir.tire_file import tire_kind
from tirefit.files import json_safe, write_texts
from tirefit.results import ExitCode, InputProblem, UsageError

if TYPE_CHECKING:
    import numpy as np

    from tirefit.data.table import TireData
    from tirefit.data.tir.tir import TirFile


Axle = StrEnum("Axle", "rear front")

_MODEL = """\
model whose parameters are checked (repeat for more; default: some brush models and the Magic \
Formula)"""
_VEHICLE = "mass, geometry, inertia and columns of the log (see VEHICLE.md)"
_UNIT = "unit of a quantity of the log, e.g. v_x=km/h; a minus (-rad/s) reverses the sign"
_STARRED = "FILE.tir: use tan(alpha) and sin(gamma) instead of the angles"
_BESIDE = """\
write the columns of DATA.csv and these forces as fx_sim, ..., for `tirefit diagnose --sim`"""


def models() -> None:
    """List the models: parameters, units, bounds, meaning, source equation."""
    from tirefit.models import MODELS
    from tirefit.report.model_tables import models_table

    cli.say(models_table(MODELS))


def methods() -> None:
    """List the online methods: inputs, estimates, valid range of used friction, source."""
    from tirefit.online.methods import METHODS
    from tirefit.report.model_tables import methods_table

    cli.say(methods_table(METHODS))


@cli.takes_data_options
def inspect(
    files: cli.Files,
    options: cli.DataOptions,
    model: Annotated[cli.Texts, cli.option("", _MODEL, autocompletion=cli.model_names)] = None,
    gate: Annotated[
        bool,
        cli.option("", "compute how well the file determines the parameters", "--gate/--no-gate"),
    ] = True,
    json: Annotated[bool, cli.option("", "print JSON", "--json")] = False,
) -> None:
    """Show how a file was read, and how well it determines the parameters of models."""
    from tirefit.data.inspect import inspect as look
    from tirefit.data.read import read

    def show(piece: Piece) -> tuple[ExitCode, Any]:
        data = read(piece.file, **how)
        inspection = look(data)
        identified = None
        if gate:
            cli.start_jax()
            from tirefit.fitting.verdict.identifiability import identifiability

            identified = identifiability(data, model)
        content = inspection.to_dict()
        content |= {"identifiability": identified.to_dict()} if identified else {}
        if len(files) > 1 and not json:
            warn(data, assumed=data.source.assumptions)
            inspection = replace(inspection, warnings=(), assumptions=())
        text = inspection.summary() + (identified.summary() if identified else "")
        cli.say(dumps(json_safe(content), indent=1) if json else text)
        return ExitCode.OK, None

    how, files = cli.read_options(options), expanded(files)
    pieces = [Piece(file, "") for file in files]
    done = run_pieces("inspect", pieces, show, Sharing(), Path())
    raise typer.Exit(worst_of([outcome.code for outcome in done]))


def derive(
    files: cli.Files,
    vehicle: Annotated[Path, cli.path_option("VEHICLE.TOML", _VEHICLE)],
    out: cli.OutFile,
    axle: Annotated[Axle, cli.option("", "axle to derive")] = Axle.rear,
    unit: Annotated[cli.Pairs, cli.option("NAME=UNIT", _UNIT, parser=cli.pair)] = None,
    believe: Annotated[
        bool, cli.option("", "only warn if channels contradict each other", "--believe")
    ] = False,
) -> None:
    """Compute slip angle and lateral force of an axle from vehicle logs."""
    from tirefit.data.vehicle.derive import derive_files

    if out.parent.is_dir() and not out.is_dir():  # others are refused with the CSV
        check_results([out, out.with_name(f"{out.stem}.derive.json")])
    written = derive_files(files, vehicle, out, axle.value, cli.by_name(unit), believe, cli.say)
    cli.say(written.summary())


@cli.takes_data_options
def predict(
    source: Annotated[str, typer.Argument(metavar="FIT.json|FILE.tir|MODEL", help="the tire")],
    data: Annotated[Path, typer.Argument(metavar="DATA.csv", help="rows with slips and load")],
    out: cli.OutFile,
    options: cli.DataOptions,
    parameter: cli.SetOption = None,
    starred_angles: Annotated[bool, cli.option("", _STARRED, "--starred-angles")] = False,
    side: cli.SideOption = None,
    signs: cli.SignsOption = None,
    combination: CombinationOption = None,
    beside: Annotated[bool, cli.option("", _BESIDE, "--beside")] = False,
) -> None:
    """Compute the forces of a fit or a model for each row of a data file."""
    how, values = cli.read_options(options), cli.by_name(parameter)
    of_file: dict[str, Any] = {"side": side, "signs": signs, "combination": combination}
    kind = tire_kind(source)
    if kind != "tir":
        remedy = "leave it out: it applies to .tir files only"
        cli.refuse((*of_file, "starred_angles"), f"with {source}", remedy)
    of_file["starred"] = starred_angles
    from tirefit.data.tir.tir import read_tir
    from tirefit.data.write import output_problems

    problems = output_problems(out, ".csv")
    if kind == "fit" and values:
        problems.append(InputProblem("--set with a fit.json", "use it with a model name"))
    UsageError.raise_for(problems)
    check_inputs_kept([out])

    tir = read_tir(source) if kind == "tir" else None
    cli.start_jax()
    from tirefit.data.read import read
    from tirefit.fitting import tir as of_tir
    from tirefit.fitting.predict import outside_fit
    from tirefit.fitting.predict import predict as forces_of
    from tirefit.fitting.store import load_fit
    from tirefit.models import MODELS
    from tirefit.params import parameter_values

    tire: Any = source
    if tir is not None:
        tire = of_tir.tire_of(tir, values=values, **of_file)
        how["otherwise"] = of_tir.TIR_SIGNS, ".tir files"
    elif kind == "fit":
        tire = load_fit(source)
        how["otherwise"] = tire.content["data"]["convention"], source
    table = read(data, **how, forces=False)
    warn(table)
    noted = outside_fit(tire, table) if kind == "fit" else []
    if tir is not None:
        noted = of_tir.remarks(tir, tire, table, signs)
    cli.warn_of(noted, source)
    forces = forces_of(tire, table, values)
    if tir is not None:
        cli.say(_tir_text(source, tir, of_file, values))
    elif kind != "fit":
        everything = parameter_values(MODELS[source])
        texts = (
            f"{key} = {values.get(key, value):g}" + " (default)" * (key not in values)
            for key, value in everything.items()
        )
        cli.say(f"{source} with {', '.join(texts)}")
    _write(out, table, forces, source, beside)


def _write(
    out: Path, table: "TireData", forces: "Mapping[str, np.ndarray]", source: str, beside: bool
) -> None:
    """Write the forces in the convention of the file and list the written columns.

    The first line of a table for `diagnose --sim` states the convention.
    """
    from tirefit.data.write import csv_text, prediction_table, simulated_table

    convention = f"convention {table.source.convention}"
    columns = (simulated_table if beside else prediction_table)(table, forces)
    first = f"# tirefit {__version__}: {source} beside, {convention}\n"
    write_texts({out: (first if beside else "") + csv_text(columns)})
    cli.warn_of(f"excluded, no force: {row}" for row in table.first_masked())
    signs = f"({convention}, {table.source.convention_from})"
    cli.say(f"wrote {out}: {len(table)} rows, {', '.join(columns)} {signs}")


def _tir_text(
    source: str, tir: "TirFile", of_file: dict[str, Any], values: dict[str, float]
) -> str:
    """How a ``.tir`` file is used; ``of_file`` are arguments of ``tire_of``."""
    parts = [f"{source}: Magic Formula {tir.version}", f"TYRESIDE {tir.side}"]
    parts += [f"mounted {of_file['side']}"] if of_file["side"] else []
    parts += [f"in signs {of_file['signs']}"] if of_file["signs"] else []
    parts += ["tan(alpha) and sin(gamma)" if of_file["starred"] else "raw angles"]
    parts += [f"{key} = {value:g}" for key, value in values.items()]
    return ", ".join(parts)
