"""``tirefit export``: write a fitted tire as a file of another program."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Exit, Option

from tirefit.cli.options import complain, numbers, pairs, path_option, say, start_jax
from tirefit.cli.output import check_inputs_kept
from tirefit.results import InputProblem, UsageError, exit_code

_OVER = "range of a refit: kappa, alpha [rad], fz [N], iso-w signs"
_DIAGNOSIS = "result of `tirefit diagnose`; the effects that it names change the tire"


Text = str | None
Texts = list[str] | None
File = Path | None


def export(
    source: Annotated[Text, Argument(metavar="[FIT.json|FILE.tir|MODEL]", help="the tire")] = None,
    *,
    to: Annotated[Text, Option(metavar="TARGET", help="target program (--list)")] = None,
    out: Annotated[File, path_option("FILE", "file to write")] = None,
    front: Annotated[Text, Option(metavar="FIT", help="tire of the front axle")] = None,
    rear: Annotated[Text, Option(metavar="FIT", help="tire of the rear axle")] = None,
    vehicle: Annotated[File, path_option("TOML", "the car: vehicle.toml")] = None,
    over: Annotated[Texts, Option(metavar="NAME=LOW:HIGH", help=_OVER)] = None,
    parameter: Annotated[
        Texts, Option("--set", metavar="NAME=VALUE", help="parameter of a model or .tir")
    ] = None,
    diagnosis: Annotated[File, path_option("NAME.json", _DIAGNOSIS)] = None,
    model: Annotated[Text, Option(help="version of a .tir to write: mf52, mf61, mf62")] = None,
    wheel: Annotated[
        Texts, Option(metavar="NAME=VALUE", help="property of the wheel, SI units (--list)")
    ] = None,
    forces: Annotated[
        str, Option(metavar="F,F,...", help="forces to write: fx, fy, mz, mx, my (default: all)")
    ] = "",
    convention: Annotated[
        str, Option(help="signs of the file: iso-w, sae, adapted-sae, braking")
    ] = "iso-w",
    name: Annotated[Text, Option(help="name of the function (default: that of the file)")] = None,
    force: Annotated[
        bool,
        Option(
            "--force", help="replace any file; accept errors above 5 %, and a range not measured"
        ),
    ] = False,
    list_: Annotated[bool, Option("--list", help="list the targets and exit")] = False,
) -> None:
    """Write a tire as source code or as a file of another program.

    Source code contains the model itself. A simulator with its own formula gets its
    parameters, refitted if the formula cannot represent the model, and the largest
    error. Each file states the parameters with standard errors, the measured range, and
    checks of the tire at standstill, at large slip and at twice the largest load.
    """
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
    check_inputs_kept([out])
    start_jax()
    done = export(
        source, to, out, front=front, rear=rear, vehicle=vehicle, over=ranges,
        values=values, diagnosis=diagnosis, model=model, wheel=of_wheel,
        forces=forces, convention=convention, name=name, force=force,
    )  # fmt: skip
    for text in done.warnings:
        complain(f"warning: {text}")
    for note in done.notes:
        if not note.startswith("warning"):
            complain(f"note: {note}")
    for sentence in done.shape.sentences:
        say(sentence)
    if not isinstance(TARGETS[to], Target):
        convention = "of its own"
    say(f"wrote {out} for {to}, signs {convention}")
    raise Exit(exit_code(done.outcomes))


def _ranges(
    items: list[str] | None, problems: list[InputProblem]
) -> dict[str, tuple[float, float]]:
    """Ranges of --over; faults are added to ``problems``."""
    ranges: dict[str, tuple[float, float]] = {}
    for name, text in pairs("--over", items).items():
        low, _, high = text.partition(":")
        try:
            ranges[name] = float(low), float(high)
        except ValueError:
            remedy = "give kappa, alpha or fz as NAME=LOW:HIGH"
            problems.append(InputProblem(f"--over {name}={text} is not a range", remedy))
    return ranges
