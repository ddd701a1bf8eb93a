"""``tirefit diagnose``: find the effects that a model lacks, and the gap without them."""

from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tirefit.cli import options as cli
from tirefit.cli.commands.magic_formula import MAGIC_FORMULA_NAMES, CombinationOption
from tirefit.cli.fleet import Jobs, Piece, Scheduler, Sharing, run_pieces, worst_of
from tirefit.cli.notes import merged_notes, warn
from tirefit.cli.output import check_results, digest, done_before, is_page, names_of, write_result
from tirefit.data.readers.remote import expanded
from tirefit.data.tir.tire_file import tire_kind
from tirefit.display import Record
from tirefit.names import MODEL_NAMES, effect_names
from tirefit.results import ExitCode, InputProblem, UsageError, exit_code

if TYPE_CHECKING:  # NumPy, which completion does not wait for
    from tirefit.data.records import FileRecord
    from tirefit.data.table import TireData
    from tirefit.diagnosis.rows.rig import Rig


_MODEL = """\
model to fit first (default: brush), or a file: a simulator's tire, used unchanged; with --sim: \
the model that describes the measured forces beside the simulator's"""
_SET = cli.option("NAME=VALUE", "use MODEL unchanged, with this value", "--set", parser=cli.number)
_SIM = "FILE has the forces of the simulator: fx_sim, fy_sim, mz_sim"
_SIM_LOG = """\
--vehicle: states that your simulator predicted for the inputs of FILE (one for each FILE): what \
it has wrong of the car"""


TireOption = Annotated[
    cli.Text, cli.option("FIT.json|FILE.tir|MODEL", "--vehicle: tire of this axle (default: brush)")
]


_MODELS_LIKE = cli.completed(*MODEL_NAMES, *MAGIC_FORMULA_NAMES)


def _effects_like(incomplete: str) -> list[str]:
    return cli.completed(*effect_names())(incomplete)


def _written(name: str, figures: bool) -> tuple[list[str], list[str]]:
    """Files that a case writes: always, and as figures."""
    drawn = [f"{name}.png", f"{name}.html"]
    return [f"{name}.json", f"{name}.rows.csv"], drawn if figures else []


@cli.takes_data_options
def diagnose(
    files: cli.Files,
    options: cli.DataOptions,
    out: cli.Folder,
    model: Annotated[
        cli.Text, cli.option("MODEL|FIT.json|FILE.tir", _MODEL, autocompletion=_MODELS_LIKE)
    ] = None,
    parameter: Annotated[cli.Pairs, _SET] = None,
    sim: Annotated[bool, cli.option("", _SIM, "--sim")] = False,
    side: cli.SideOption = None,
    signs: cli.SignsOption = None,
    combination: CombinationOption = None,
    force: cli.Forces = None,
    rig: Annotated[
        cli.File, cli.option("RIG.TOML", "known noise and properties of the rig")
    ] = None,
    holdout: Annotated[
        list[Path] | None,
        cli.option("FILE", "file that is only used to check the result (repeat for more)"),
    ] = None,
    without: Annotated[
        cli.Texts, cli.option("ID", "do not search for this effect", autocompletion=_effects_like)
    ] = None,
    vehicle: Annotated[
        cli.File,
        cli.option(
            "VEHICLE.TOML", "FILE are logs of this car: find the effects that its model lacks"
        ),
    ] = None,
    front: TireOption = None,
    rear: TireOption = None,
    sim_log: Annotated[list[Path] | None, cli.option("SIM.CSV", _SIM_LOG)] = None,
    figures: Annotated[
        bool, cli.option("", "write NAME.png and NAME.html", "--figures", "--html")
    ] = False,
    full: cli.Full = False,
    resume: cli.Resume = False,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    seed: cli.Seed = 0,
) -> None:
    """Find the effects that explain the gap between a model or simulator and data."""
    sharing, files = Sharing(jobs, scheduler), expanded(files)
    cli.refuse_by_vehicle(vehicle, _OF_VEHICLE, ("front", "rear", "sim_log"))
    if vehicle is not None:
        if sim_log:
            cli.refuse(
                _NOT_COMPARED, "with --sim-log", "leave it out: the car itself is not diagnosed"
            )
        of_car = {"without": without or (), "holdout": holdout or (), "seed": seed}
        tires = front or "brush", rear or "brush"
        return _diagnose_car(files, vehicle, tires, out, sim_log or [], figures, full, of_car)
    names = names_of(files, "rename one: their results would overwrite each other")
    parts = [part for name in names for part in _written(name, figures)]
    made = [out / file for part in parts for file in part]
    check_results([*made, *sharing.files(out)], files)
    config = cli.read_config(options.config)
    how, plain = cli.read_options(options, config), _PLAIN if model is None else model
    forces = [name.value for name in force or ()]
    if config is not None:
        forces = forces or [*(config.force or ())]
        if unused := sorted(config.model_fields_set - {"data", "force", "source"}):
            text = f"{', '.join(unused)}: used only by `tirefit fit`, not by diagnose"
            cli.warn_of([text], config.source)
    cli.start_jax()
    from tirefit.diagnosis.rows.rig import load_rig
    from tirefit.fitting.problem.build import find_model

    base, known = model if sim else plain, load_rig(rig)
    if base and not tire_kind(base) and base not in MAGIC_FORMULA_NAMES:
        find_model(base)
    if how["rolling_radius"] is None:
        how["rolling_radius"] = known.rolling_radius
    settings = {
        "model": base,
        "rig": known,
        "without": tuple(without or ()),
        "forces": forces or None,
    }
    of_tir = {"side": side, "signs": signs, "combination": combination}
    settings |= _simulator(base, cli.by_name(parameter), sim, how, of_tir)
    with merged_notes(len(files) + len(holdout or []) > 1):
        kept = [_read(path, how) for path in holdout or []]
        written = {"figures": figures, "resume": resume, "full": full}
        pieces = [Piece(*pair) for pair in zip(files, names, strict=True)]
        work = partial(_one, out, settings, kept, how, written, seed)
        codes = [outcome.code for outcome in run_pieces("diagnose", pieces, work, sharing, out)]
        if len(pieces) > 1:
            done = codes.count(ExitCode.OK)
            cli.say(f"{done} of {len(pieces)} files diagnosed, results in {out}")
    raise typer.Exit(worst_of(codes))


_OF_VEHICLE = "files vehicle front rear sim_log out holdout without figures full seed".split()
"""Arguments and options that ``--vehicle`` uses."""
_NOT_COMPARED = "holdout", "full", "seed"
"""Those that ``--sim-log`` does not use."""
_PLAIN = "brush"  # the default base model


def _read(path: Path, how: dict[str, Any], rig: "Rig | None" = None) -> "TireData":
    from tirefit.data.read import read

    table = read(path, **how)
    warn(table, beside=rig.beside(table) if rig else ())
    return table


def _simulator(
    model: str | None,
    values: dict[str, float],
    sim: bool,
    how: dict[str, Any],
    of_tir: dict[str, Any],
) -> dict[str, Any]:
    """Arguments of ``tirefit.diagnose`` for a given simulator; none if a model is
    fitted. Data without a declared convention are read in that of the simulator.

    Args:
        of_tir: ``side``, ``signs`` and ``combination`` of a ``.tir`` file.
    """
    problems: list[InputProblem] = []
    kind = tire_kind(model) if model else ""
    if sim and (values or kind):
        other = "--set" if values else f"--model {model}"
        reason = f"--sim together with {other}"
        remedy = "with --sim, --model names the model that describes the measured forces"
        problems.append(InputProblem(reason, remedy))
    of_columns = {"side", "combination"} if sim else set(of_tir)
    wrong = [f"--{name}" for name in of_columns if of_tir[name] is not None]
    if wrong and kind != "tir":
        reason = f"{' and '.join(sorted(wrong))} without --model FILE.tir"
        problems.append(InputProblem(reason, "leave it out"))
    UsageError.raise_for(problems)
    if sim:
        return {"sim": True, "signs": of_tir["signs"]}
    assert model is not None, "it has a default if no simulated forces are given"
    if not (values or kind):
        return {}
    from tirefit.diagnosis.rows.simulator import simulator_at

    given = simulator_at(model, values, **of_tir)
    how["otherwise"] = given.otherwise
    return {"model": _PLAIN, "sim": given}


def _one(
    out: Path,
    settings: dict[str, Any],
    kept: list["TireData"],
    how: dict[str, Any],
    written: dict[str, bool],
    seed: int,
    piece: Piece,
) -> tuple[ExitCode, "FileRecord"]:
    """Diagnose one file, unless its result exists.

    Args:
        settings: arguments of ``tirefit.diagnose``; how: of ``tirefit.read``.
        kept: tables held out.
        written: the options ``figures``, ``resume`` and ``full``.
    """
    from tirefit.diagnosis.diagnose import diagnose as study
    from tirefit.diagnosis.summary.result import record_of_document

    file, name = piece
    figures = written["figures"]
    table = _read(file, how, settings["rig"])
    always, drawn = _written(name, True)
    # Everything that the diagnosis of this table depends on.
    rig, simulator = settings["rig"], settings.get("sim")
    if simulator not in (None, True):
        simulator = [simulator.kind, simulator.source, simulator.sha256]
    stated = settings | {"rig": [asdict(rig), rig.beside(table)], "sim": simulator}
    asked = digest(stated, [data.source.sha256 for data in (table, *kept)], how, seed)
    document = out / f"{name}.json"
    files = [out / part for part in (always + drawn if figures else always)]
    if written["resume"] and (record := done_before(files, document, asked, record_of_document)):
        cli.say(f"{file}: done before, kept: {document}")
        return ExitCode.OK, record
    result = replace(study(table, holdout=kept, seed=seed, **settings), asked=asked)
    pictures, page = ({drawn[0]: ""}, drawn[1]) if figures else ({}, "")
    # A figure without an earlier page beside it is the user's own.
    known = always + drawn if figures or is_page(out / drawn[1]) else always
    write_result(result, out, known, pictures, page, name, full=written["full"])
    return exit_code(result.outcomes), record_of_document(document)


# --- logs of a vehicle ---------------------------------------------------------------


def _diagnose_car(
    logs: list[Path],
    vehicle: Path,
    tires: tuple[str, str],
    out: Path,
    sim_logs: list[Path],
    figures: bool,
    full: bool,
    how: dict[str, Any],
) -> None:
    """Diagnose the car, or compare it with its simulator; print the report, write the files.

    Args:
        tires: of the front and of the rear axle.
        sim_logs: what the simulator predicted for each log; empty: diagnose the car itself.
        how: ``without``, ``holdout`` and ``seed``.
    """
    name = "comparison" if sim_logs else "vehicle_diagnosis"
    names = [f"{name}.{end}" for end in ("json", "png", "html")]
    check_results([out / name for name in names], [*logs, *sim_logs])
    # The first line of progress at once, as JAX takes seconds to load and to compile.
    with cli.progress_bar("diagnose", soon=0.0) as progress:
        progress(0.01, "loading")
        cli.start_jax()
        from tirefit.vehicle.diagnose import diagnose_vehicle
        from tirefit.vehicle.simulated import compare_with_simulator

        if sim_logs:
            of_both = {"without": how["without"], "progress": progress}
            result: Record = compare_with_simulator(logs, sim_logs, vehicle, *tires, **of_both)
        else:
            result = diagnose_vehicle(logs, vehicle, *tires, **how, progress=progress)
    drawn, page = ({names[1]: ""}, names[2]) if figures else ({}, "")
    text = result.summary() if sim_logs else result.summary(full=full)
    write_result(result, out, names, drawn, page, text=text)
