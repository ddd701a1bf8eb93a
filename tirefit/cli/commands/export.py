"""``tirefit export``: write a fitted tire as a file of another program."""

from typing import Annotated

from typer import Argument, BadParameter, Exit

from tirefit.cli import options as cli
from tirefit.cli.output import check_inputs_kept
from tirefit.results import InputProblem, UsageError, exit_code

_OVER = "range of a refit: kappa, alpha [rad], fz [N], iso-w signs"
_FORCE = "replace any file; accept errors above 5 %, and a range not measured"
_WHEEL = "property of the wheel, SI units (--list)"
_DIAGNOSIS = "result of `tirefit diagnose`; the effects that it names change the tire"


def _range(text: str) -> tuple[str, tuple[float, float]]:
    name, ends = cli.pair(text)
    try:
        low, high = map(float, ends.split(":"))
    except ValueError:
        remedy = "give kappa, alpha or fz as NAME=LOW:HIGH"
        raise BadParameter(f"{text} is not a range: {remedy}") from None
    return name, (low, high)


def export(
    source: Annotated[
        cli.Text, Argument(metavar="FIT.json|FILE.tir|MODEL", help="the tire")
    ] = None,
    *,
    to: Annotated[cli.Text, cli.option("TARGET", "target program (--list)")] = None,
    out: Annotated[cli.File, cli.path_option("FILE", "file to write")] = None,
    front: Annotated[cli.Text, cli.option("FIT", "tire of the front axle")] = None,
    rear: Annotated[cli.Text, cli.option("FIT", "tire of the rear axle")] = None,
    vehicle: Annotated[cli.File, cli.path_option("TOML", "the car: vehicle.toml")] = None,
    over: Annotated[cli.Pairs, cli.option("NAME=LOW:HIGH", _OVER, parser=_range)] = None,
    parameter: cli.SetOption = None,
    diagnosis: Annotated[cli.File, cli.path_option("NAME.json", _DIAGNOSIS)] = None,
    model: Annotated[
        cli.Text, cli.option("", "version of a .tir to write: mf52, mf61, mf62")
    ] = None,
    wheel: Annotated[cli.Pairs, cli.option("NAME=VALUE", _WHEEL, parser=cli.number)] = None,
    forces: Annotated[
        str, cli.option("F,F,...", "forces to write: fx, fy, mz, mx, my (default: all)")
    ] = "",
    convention: Annotated[
        str, cli.option("", "signs of the file: iso-w, sae, adapted-sae, braking")
    ] = "iso-w",
    name: Annotated[
        cli.Text, cli.option("", "name of the function (default: that of the file)")
    ] = None,
    force: Annotated[bool, cli.option("", _FORCE, "--force")] = False,
    list_: Annotated[bool, cli.option("", "list the targets and exit", "--list")] = False,
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
            cli.say(f"{key:<13} {target.what}\n{'':<13} holds {target.holds}")
        return
    problems: list[InputProblem] = []
    tire = "a fit.json, a .tir file or the name of a model, or --front and --rear"
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
    cli.start_jax()
    done = export(
        source, to, out, front=front, rear=rear, vehicle=vehicle, over=cli.by_name(over),
        values=cli.by_name(parameter), diagnosis=diagnosis, model=model, wheel=cli.by_name(wheel),
        forces=forces, convention=convention, name=name, force=force,
    )  # fmt: skip
    cli.warn_of(done.warnings)
    for note in done.notes:
        if not note.startswith("warning"):
            cli.complain(f"note: {note}")
    for sentence in done.shape.sentences:
        cli.say(sentence)
    if not isinstance(TARGETS[to], Target):
        convention = "of its own"
    cli.say(f"wrote {out} for {to}, signs {convention}")
    raise Exit(exit_code(done.outcomes))
