"""``tirefit export``: a fitted tire as a file of another program."""

from pathlib import Path
from typing import Annotated

import typer

from tirefit.cli.options import (
    complain,
    errors_to_exit,
    named_path,
    numbers,
    say,
    start_jax,
)
from tirefit.results import InputProblem, UsageError


def export(
    source: Annotated[
        str | None, typer.Argument(metavar="[FIT.json|FILE.tir|MODEL]")
    ] = None,
    *,
    to: Annotated[str | None, typer.Option(metavar="TARGET", help="see --list")] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", parser=named_path, help="file to write"),
    ] = None,
    parameter: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="NAME=VALUE", help="parameter of a model or a .tir file"
        ),
    ] = None,
    diagnosis: Annotated[
        Path | None,
        typer.Option(
            metavar="NAME.json",
            parser=named_path,
            help="of `tirefit diagnose`: the effects that it names change the tire",
        ),
    ] = None,
    model: Annotated[
        str | None,
        typer.Option(help="version of the Magic Formula of a .tir: mf52, mf61, mf62"),
    ] = None,
    wheel: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VALUE", help="of the wheel, in SI units (--list)"),
    ] = None,
    forces: Annotated[
        str,
        typer.Option(metavar="F,F,...", help="of fx, fy, mz, mx, my; all by default"),
    ] = "",
    convention: Annotated[
        str, typer.Option(help="signs of the file: iso-w, sae, adapted-sae, braking")
    ] = "iso-w",
    name: Annotated[
        str | None, typer.Option(help="of the function; the file's name by default")
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="replace a file that is no export")
    ] = False,
    list_: Annotated[
        bool, typer.Option("--list", help="list the targets and exit")
    ] = False,
) -> None:
    """Write a fitted tire as a file of another program: C, CasADi, NumPy.

    The file holds the model operation by operation, its parameters with their standard
    errors, the range that was measured, and how the tire behaves at rest, at large
    slip and at twice the largest load.
    """
    with errors_to_exit():
        from tirefit.targets.export import TARGETS, check, export

        if list_:
            for key, target in TARGETS.items():
                say(f"{key:<10} {target.what}\n{'':<10} holds {target.holds}")
            return
        problems: list[InputProblem] = []
        values = numbers("--set", parameter, problems)
        of_wheel = numbers("--wheel", wheel, problems)
        for what, given, remedy in (
            ("a tire", source, "give a fit.json, a .tir file or the name of a model"),
            ("--to", to, f"one of {', '.join(TARGETS)}"),
            ("--out", out, "name the file to write"),
        ):
            if given is None:
                problems.append(InputProblem(f"{what} is missing", remedy))
        if problems:
            raise UsageError(problems)
        assert source and to and out
        name = out.stem if name is None else name
        check(source, to, out, convention, name, force, model, of_wheel, forces)
        start_jax()
        done = export(
            source, to, out, values=values, diagnosis=diagnosis,
            model=model, wheel=of_wheel, forces=forces, convention=convention,
            name=name, force=force,
        )  # fmt: skip
        for note in done.notes:
            complain(f"note: {note}")
        if not done.shape.sound:
            complain("warning: the tire fails a check below")
        for sentence in done.shape.sentences:
            say(sentence)
        say(f"wrote {out} for {to}, signs {convention}")
