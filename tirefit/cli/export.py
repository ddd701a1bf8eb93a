"""``tirefit export``: a fitted tire as a file of another program."""

from pathlib import Path
from typing import Annotated

import typer

from tirefit.cli.options import (
    complain,
    errors_to_exit,
    named_path,
    numbers,
    pairs,
    say,
    start_jax,
)
from tirefit.results import InputProblem, UsageError

RANGES = ("kappa", "alpha", "fz")
"""Inputs of a tire whose range --over states."""


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
    front: Annotated[
        str | None, typer.Option(metavar="FIT", help="tire of the front axle")
    ] = None,
    rear: Annotated[
        str | None, typer.Option(metavar="FIT", help="tire of the rear axle")
    ] = None,
    vehicle: Annotated[
        Path | None,
        typer.Option(metavar="TOML", parser=named_path, help="the car: vehicle.toml"),
    ] = None,
    over: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=LOW:HIGH",
            help="range of a refit: kappa, alpha [rad], fz [N]; signs of iso-w",
        ),
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
        bool, typer.Option("--force", help="replace any file; accept a large miss")
    ] = False,
    list_: Annotated[
        bool, typer.Option("--list", help="list the targets and exit")
    ] = False,
) -> None:
    """Write a fitted tire as a file of another program.

    C, CasADi and NumPy hold the model operation by operation. A simulator with a
    formula of its own gets its parameters, refitted where the formula does not hold the
    model, and the largest miss. Each file holds the parameters with their standard
    errors, the range that was measured, and how the tire behaves at rest, at large
    slip and at twice the largest load.
    """
    with errors_to_exit():
        from tirefit.targets.export import TARGETS, Target, export

        if list_:
            for key, target in TARGETS.items():
                say(f"{key:<13} {target.what}\n{'':<13} holds {target.holds}")
            return
        problems: list[InputProblem] = []
        values = numbers("--set", parameter, problems)
        ranges = _ranges(over, problems)
        tire = "a fit.json, a .tir file or the name of a model, or --front and --rear"
        of_wheel = numbers("--wheel", wheel, problems)
        for what, given, remedy in (
            ("a tire", source or front or rear, f"give {tire}"),
            ("--to", to, f"one of {', '.join(TARGETS)}"),
            ("--out", out, "name the file to write"),
        ):
            if given is None:
                problems.append(InputProblem(f"{what} is missing", remedy))
        if problems:
            raise UsageError(problems)
        assert to and out
        start_jax()
        done = export(
            source, to, out, front=front, rear=rear, vehicle=vehicle, over=ranges,
            values=values, diagnosis=diagnosis, model=model, wheel=of_wheel,
            forces=forces, convention=convention, name=name, force=force,
        )  # fmt: skip
        for note in done.notes:
            complain(note if note.startswith("warning") else f"note: {note}")
        if not done.shape.sound:
            complain("warning: the tire fails a check below")
        for sentence in done.shape.sentences:
            say(sentence)
        if not isinstance(TARGETS[to], Target):
            convention = "of its own"
        say(f"wrote {out} for {to}, signs {convention}")


def _ranges(items: list[str] | None, problems: list[InputProblem]):
    """Ranges of --over; what is wrong with them goes into ``problems``."""
    found: dict[str, tuple[float, float]] = {}
    for name, text in pairs("--over", items).items():
        low, _, high = text.partition(":")
        try:
            ends = float(low), float(high)
            usable = name in RANGES and ends[0] <= ends[1]
        except ValueError:
            usable = False
        if usable:
            found[name] = ends
        else:
            remedy = f"give {', '.join(RANGES)} as NAME=LOW:HIGH"
            problems.append(InputProblem(f"--over {name}={text}", remedy))
    return found
