"""``tirefit simulate``: vehicle logs and rig sweeps of a tire that is known."""

import inspect
from collections.abc import Callable
from dataclasses import MISSING, Field, fields
from pathlib import Path
from typing import Annotated, Any

import typer

from tirefit.cli import options as cli
from tirefit.files import write_texts
from tirefit.results import InputProblem, UsageError
from tirefit.sim.settings import KINDS

simulate = typer.Typer(
    help="Simulate logs and rig sweeps whose true tire is known.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)

Truth = Annotated[Path | None, cli.path_option("FILE.csv", "CSV file of the true values")]


def _drop(text: str) -> tuple[float, float]:
    try:
        time, friction = map(float, text.split("="))
    except ValueError:
        raise typer.BadParameter(f"{text!r} is not TIME=FRICTION, as in --drop 5=0.4") from None
    return time, friction


def _option(setting: Field[Any]) -> inspect.Parameter:
    """The option of a setting; the user gives a pair or a mapping as text."""
    kind, default, metavar = setting.type, setting.default, None
    how: dict[str, Any] = {}
    flags = [f"--{setting.name}"] if isinstance(default, bool) else []
    if setting.name == "drop":
        kind, metavar, how = cli.Text, "TIME=FRICTION", {"parser": _drop}
    elif default is MISSING:
        kind, default, flags, metavar = cli.Pairs, None, ["--set"], "NAME=VALUE"
        how = {"parser": cli.number}
    elif isinstance(default, tuple):
        kind, default = list[float], list(default)
    option = typer.Option(*flags, metavar=metavar, help=setting.metadata["meaning"], **how)
    return inspect.Parameter(
        setting.name,
        inspect.Parameter.KEYWORD_ONLY,
        default=default,
        annotation=Annotated[kind, option],
    )


def _command(kind: str) -> Callable[..., Any]:
    """The command of one kind of simulation, with its settings as options."""

    def run(*, out: cli.OutFile, truth: Truth = None, **given: Any) -> None:
        from tirefit.data.write import csv_text, output_problems

        problems: list[InputProblem] = []
        if "values" in given:
            given["values"] = cli.by_name(given["values"])
        for path in filter(None, (out, truth)):
            problems += output_problems(path, ".csv")
        if truth is not None and truth.absolute() == out.absolute():
            reason = "--truth is the same file as --out"
            problems.append(InputProblem(reason, "give another name"))
        UsageError.raise_for(problems + KINDS[kind](**given).problems())
        cli.start_jax()
        from tirefit.sim.simulate import simulate as simulated

        made = simulated(kind, **given)
        tables = {out: made.columns} | ({} if truth is None else {truth: made.truth})
        write_texts({path: csv_text(table) for path, table in tables.items()})
        columns = f"{len(made.columns['time'])} rows, {', '.join(made.columns)}"
        cli.say(f"wrote {out}: {columns} (braking positive, SI), seed {given['seed']}")
        if truth is not None:
            cli.say(f"wrote {truth}: the true values without noise, {', '.join(made.truth)}")

    fixed = list(inspect.signature(run).parameters.values())[:2]
    parameters = [*fixed, *map(_option, fields(KINDS[kind]))]
    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    run.__doc__ = KINDS[kind].__doc__
    return run


for _kind in KINDS:
    _help = KINDS[_kind].__doc__ or ""
    # One sentence in the list of the kinds, which typer would cut.
    _first = f"{_help.partition('. ')[0].rstrip('.')}."
    simulate.command(_kind, short_help=_first)(cli.errors_to_exit()(_command(_kind)))
