"""``tirefit diagnose``: where a model misses, which effect causes it, how far."""

import json
import pickle
from collections.abc import Generator
from contextlib import closing, redirect_stderr, redirect_stdout
from dataclasses import asdict, dataclass
from functools import cache, partial
from io import StringIO
from pathlib import Path
from typing import Annotated, NamedTuple

import typer
from typer.core import TyperCommand

from tirefit.cli.jobs import Ended, shared
from tirefit.cli.magic_formula import MAGIC_FORMULA_NAMES
from tirefit.cli.options import (
    DataOptions,
    Files,
    complain,
    completed,
    error_text,
    errors_to_exit,
    forces_named,
    named_path,
    numbers,
    progress_bar,
    read_config,
    read_options,
    say,
    start_jax,
    takes_data_options,
    warn,
)
from tirefit.cli.output import check_directories, claimed, is_page, staged
from tirefit.names import EFFECT_NAMES, MODEL_NAMES
from tirefit.results import (
    DataError,
    ExitCode,
    InputProblem,
    TirefitError,
    UsageError,
)

__all__ = ["ManyHoldouts", "diagnose"]


class ManyHoldouts(TyperCommand):
    """``--holdout A B C``: all file names up to the next option."""

    def parse_args(self, ctx, args):
        spread, after = [], False
        for word in args:
            if word.startswith("-"):
                after = word == "--holdout"
                if not after:
                    spread.append(word)
            elif after:
                spread += ["--holdout", word]
            else:
                spread.append(word)
        return super().parse_args(ctx, spread)


def _names(files: list[Path]) -> list[str]:
    names = [Path(file.name.removesuffix(".gz")).stem for file in files]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        reason = f"several input files are named {', '.join(twice)}"
        remedy = "rename one: their results would overwrite each other"
        raise UsageError(InputProblem(reason, remedy))
    return names


@takes_data_options
def diagnose(
    files: Files,
    options: DataOptions,
    out: Annotated[
        Path,
        typer.Option(metavar="FOLDER", parser=named_path, help="folder of the results"),
    ],
    model: Annotated[
        str,
        typer.Option(
            metavar="MODEL|FIT.json|FILE.tir",
            help="base model; a file is a simulator that is taken as it is",
            autocompletion=completed(*MODEL_NAMES, *MAGIC_FORMULA_NAMES),
        ),
    ] = "brush",
    parameter: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="NAME=VALUE", help="take MODEL as it is, with this value"
        ),
    ] = None,
    sim: Annotated[
        bool,
        typer.Option(
            "--sim",
            help="the simulator's forces stand in FILE: fx_sim, fy_sim, mz_sim",
        ),
    ] = False,
    force: Annotated[
        list[str] | None,
        typer.Option(help="force that matters: fx, fy, mz (repeat; all if not given)"),
    ] = None,
    rig: Annotated[
        Path | None,
        typer.Option(metavar="RIG.TOML", help="what is known of the rig, noise too"),
    ] = None,
    holdout: Annotated[
        list[Path] | None,
        typer.Option(metavar="FILE...", help="data to check the closure on, not used"),
    ] = None,
    without: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ID",
            help="leave this effect out of the library",
            autocompletion=completed(*EFFECT_NAMES),
        ),
    ] = None,
    figures: Annotated[
        bool, typer.Option("--figures", help="write NAME.png and NAME.html")
    ] = False,
    resume: Annotated[
        bool, typer.Option("--resume", help="keep cases that are done")
    ] = False,
    jobs: Annotated[
        int, typer.Option(min=1, metavar="N", help="processes that share the files")
    ] = 1,
    seed: Annotated[
        int, typer.Option(min=0, max=2**32 - 1, help="of everything random")
    ] = 0,
) -> None:
    """Diagnose the gap between a model and data: where, which effect, how far."""
    with errors_to_exit():
        names = _names(files)
        check_directories([out])
        config = read_config(options.config)
        how = read_options(options, config)
        if config is not None:
            force = force or config.force
            asked = {"model": model, "seed": seed, "force": force}
            _warn_of_unused(config, how, asked)
        start_jax()
        settings = _settings(model, rig, without, how)
        settings["forces"] = forces_named(force)
        settings |= _simulator(model, parameter, sim, how)
        with claimed(out):
            kept = [_read(path, how) for path in holdout or []]
            task = _Task(out, settings, kept, how, figures, resume, seed)
            worst = _all(files, names, task, min(jobs, len(files)))
        raise typer.Exit(worst)


_INSTEAD = {"model": "--model", "seed": "--seed", "noise": "[noise] in --rig"}
"""Key or section of fit.toml -> where a diagnosis takes it from."""


def _warn_of_unused(config, how: dict, asked: dict) -> None:
    """One warning of the keys that only a fit uses; not of those that say what is
    ``asked`` for anyway. ``how`` has the keys of ``[data]`` that reading uses."""
    used = {f"data.{key}" for key in how}
    used |= {key for key, value in asked.items() if getattr(config, key) == value}
    unused = [key for key in _keys(config) if key not in used]
    if not unused:
        return
    sections = dict.fromkeys(key.split(".")[0] for key in unused)
    instead = [f"{k} by {_INSTEAD[k]}" for k in sections if k in _INSTEAD]
    rest = f"; give {', '.join(instead)}" if instead else ""
    text = f"{', '.join(unused)}: used by `tirefit fit` alone, not by diagnose{rest}"
    complain(f"warning: {config.source}: {text}")


def _keys(config) -> list[str]:
    """What a configuration sets: ``force``, ``noise.fx``, ``parameters.mu``."""
    keys = []
    for name, value in config:
        if name in config.model_fields_set:
            inner = getattr(value, "model_fields_set", value)
            section = isinstance(inner, dict | set)
            keys += [f"{name}.{key}" for key in sorted(inner)] if section else [name]
    return keys


def _read(path: Path, how: dict):
    from tirefit.data.read import read

    table = read(path, **how)
    warn(table)
    return table


def _settings(model: str, rig: Path | None, without, how: dict) -> dict:
    """Arguments of ``tirefit.diagnose`` that all files share."""
    from tirefit.diagnosis.rig import load_rig
    from tirefit.fitting.problem import find_model

    if not _is_file(model) and model not in MAGIC_FORMULA_NAMES:
        find_model(model)
    known = load_rig(rig)
    if how["rolling_radius"] is None and known.rolling_radius is not None:
        how["rolling_radius"] = known.rolling_radius
    return {"model": model, "rig": known, "without": tuple(without or [])}


def _is_file(model: str) -> bool:
    return model.lower().endswith((".json", ".tir"))


def _simulator(model: str, parameter, sim: bool, how: dict) -> dict:
    """Arguments of ``tirefit.diagnose`` for a simulator that is taken as it is.

    None where a form is fitted. Of a file, the data are in its convention unless they
    are said to be in another.
    """
    problems: list[InputProblem] = []
    values = numbers("--set", parameter, problems)
    if sim and (values or _is_file(model)):
        reason = f"--sim with {'--set' if values else f'--model {model}'}"
        remedy = "with --sim, --model names the form that stands in for the simulator"
        problems.append(InputProblem(reason, remedy))
    if problems:
        raise UsageError(problems)
    if sim:
        return {"sim": True}
    if not values and not _is_file(model):
        return {}
    from tirefit.diagnosis.simulator import simulator_at

    given = simulator_at(model, values)
    if how["convention"] is None:
        how["convention"] = given.convention
    return {"model": "brush", "sim": given}


@dataclass(frozen=True)
class _Task:
    """What all files share: the folder of the results, arguments of
    ``tirefit.diagnose`` and of ``tirefit.read``, tables held out, and the options."""

    out: Path
    settings: dict
    kept: list
    how: dict
    figures: bool
    resume: bool
    seed: int


class _Outcome(NamedTuple):
    """One file: its exit code, whether that ends the command, and, where another
    process worked at it, what it said and complained of."""

    code: ExitCode
    last: bool = False
    said: str = ""
    complained: str = ""


def _all(files, names, task: _Task, jobs: int) -> ExitCode:
    """Every file; one bad file does not stop the others."""
    worst, done = ExitCode.OK, 0
    pieces = list(zip(files, names, strict=True))
    with (
        progress_bar("diagnose") as progress,
        closing(_outcomes(pieces, task, jobs)) as outcomes,
    ):
        for number, file in enumerate(files):
            progress(number / len(files), f"{number + 1} of {len(files)}: {file}")
            outcome = next(outcomes)
            typer.echo(outcome.said, nl=False)
            typer.echo(outcome.complained, nl=False, err=True)
            if outcome.last:
                raise typer.Exit(outcome.code)
            worst = outcome.code if outcome.code != ExitCode.OK else worst
            done += outcome.code == ExitCode.OK
    if len(files) > 1:
        say(f"{done} of {len(files)} files diagnosed, results in {task.out}")
    return worst


def _outcomes(pieces, task: _Task, jobs: int) -> Generator[_Outcome, None, None]:
    """Of every file (file, name), in order."""
    if jobs == 1:
        for piece in pieces:
            yield _Outcome(_attempt(piece, task))
        return
    # As bytes: JAX's arrays are of 64 bits only once it has been told.
    work = partial(_apart, pickle.dumps(task))
    with closing(shared(work, pieces, jobs)) as results:
        for (file, _), result in zip(pieces, results, strict=True):
            yield _gone(file, result) if isinstance(result, Ended) else result


def _gone(file: Path, ended: Ended) -> _Outcome:
    reason = f"the process that worked at it ended with code {ended.exit_code}"
    remedy = "where memory is short, give fewer --jobs; then --resume"
    problem = InputProblem(reason, remedy, str(file))
    return _Outcome(ExitCode.DATA, complained=error_text(DataError(problem)) + "\n")


def _attempt(piece: tuple[Path, str], task: _Task) -> ExitCode:
    """One file; its error is told, unless it is that of the command."""
    try:
        _one(*piece, task)
    except TirefitError as error:
        if error.exit_code == ExitCode.USAGE:
            raise
        complain(error_text(error))
        return error.exit_code
    except BrokenPipeError:
        raise
    except OSError as error:  # its report was said
        complain(error_text(error))
        return ExitCode.USAGE
    return ExitCode.OK


def _apart(packed: bytes, piece: tuple[Path, str]) -> _Outcome:
    """One file in another process, which keeps silent."""
    said, complained, last = StringIO(), StringIO(), False
    with redirect_stdout(said), redirect_stderr(complained):
        try:
            with errors_to_exit():
                code = _attempt(piece, _unpacked(packed))
        except typer.Exit as end:
            code, last = ExitCode(end.exit_code), True
    return _Outcome(code, last, said.getvalue(), complained.getvalue())


@cache
def _unpacked(packed: bytes) -> _Task:
    start_jax()
    return pickle.loads(packed)


def _one(file: Path, name: str, task: _Task) -> None:
    from tirefit.diagnosis.engine import diagnose as study
    from tirefit.diagnosis.result import SCHEMA
    from tirefit.diagnosis.store import save_diagnosis

    out, seed, kept, figures = task.out, task.seed, task.kept, task.figures
    table = _read(file, task.how)
    written = [f"{name}.json", f"{name}.rows.csv"]
    drawn = [f"{name}.png", f"{name}.html"]
    expected = written + drawn if figures else written
    if task.resume and all((out / one).exists() for one in expected):
        if _is_done(out / f"{name}.json", table, task.settings, kept, seed):
            say(f"{file}: done before, kept: {out / name}.json")
            return
    result = study(table, holdout=kept, seed=seed, **task.settings)
    earlier = drawn if is_page(out / f"{name}.html", SCHEMA) else []
    with staged(out, written + earlier, result, f".{name}") as folder:
        save_diagnosis(result, folder, name)
        if figures:
            from tirefit.report.diagnosis_draw import write_figure
            from tirefit.report.diagnosis_html import write_page

            write_figure(result, folder / f"{name}.png")
            write_page(result, folder / f"{name}.html")
    say(str(result))


def _base_of(content: dict) -> list:
    """Model and simulator of a document."""
    there = content["simulator"]
    keys = ("kind", "source", "sha256")
    return [content["model"], there and [there[key] for key in keys]]


def _is_done(path: Path, table, settings: dict, kept, seed: int) -> bool:
    """Whether the document there is of this file as read now, of these settings, this
    seed and version."""
    from importlib.metadata import version

    from tirefit.diagnosis.effects import EFFECTS

    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        data = content["data"]
        there = [
            data["sha256"], data["convention"], data["assumptions"],
            *_base_of(content), content["seed"], content["version"],
            content["settings"],
        ]  # fmt: skip
    except (OSError, ValueError, KeyError, TypeError):
        return False
    source, rig, given = table.source, settings["rig"], settings.get("sim")
    base = [settings["model"], given and ["columns", "columns", None]]
    if given not in (None, True):
        base = [given.source, [given.kind, given.source, given.sha256]]
    asked = [
        source.sha256, source.convention, [*source.notes, *rig.notes],
        *base, seed, version("tirefit"),
        {
            "rig": asdict(rig),
            "effects": [e.id for e in EFFECTS if e.id not in settings["without"]],
            "holdout": [other.source.sha256 for other in kept],
            "forces": settings["forces"],
        },
    ]  # fmt: skip
    # As the document has it: tuples are lists there.
    return there == json.loads(json.dumps(asked))
