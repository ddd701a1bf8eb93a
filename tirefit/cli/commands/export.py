"""``tirefit export``: write a fitted tire as a file of another program."""

from typing import Annotated

from typer import Argument, Exit

from tirefit.cli.options import (
    File,
    Text,
    Texts,
    complain,
    numbers,
    option,
    pairs,
    path_option,
    say,
    start_jax,
    warn_of,
)
from tirefit.cli.output import check_inputs_kept
from tirefit.results import InputProblem, UsageError, exit_code

_OVER = "range of a refit: kappa, alpha [rad], fz [N], iso-w signs"
_FORCE = "replace any file; accept errors above 5 %, and a range not measured"
_DIAGNOSIS = "result of `tirefit diagnose`; the effects that it names change the tire"


def export(
    source: Annotated[Text, Argument(metavar="[FIT.json|FILE.tir|MODEL]", help="the tire")] = None,
    *,
    to: Annotated[Text, option("TARGET", "target program (--list)")] = None,
    out: Annotated[File, path_option("FILE", "file to write")] = None,
    front: Annotated[Text, option("FIT", "tire of the front axle")] = None,
    rear: Annotated[Text, option("FIT", "tire of the rear axle")] = None,
    vehicle: Annotated[File, path_option("TOML", "the car: vehicle.toml")] = None,
    over: Annotated[Texts, option("NAME=LOW:HIGH", _OVER)] = None,
    parameter: Annotated[
        Texts, option("NAME=VALUE", "parameter of a model or .tir", "--set")
    ] = None,
    diagnosis: Annotated[File, path_option("NAME.json", _DIAGNOSIS)] = None,
    model: Annotated[Text, option("", "version of a .tir to write: mf52, mf61, mf62")] = None,
    wheel: Annotated[
        Texts, option("NAME=VALUE", "property of the wheel, SI units (--list)")
    ] = None,
    forces: Annotated[
        str, option("F,F,...", "forces to write: fx, fy, mz, mx, my (default: all)")
    ] = "",
    convention: Annotated[
        str, option("", "signs of the file: iso-w, sae, adapted-sae, braking")
    ] = "iso-w",
    name: Annotated[Text, option("", "name of the function (default: that of the file)")] = None,
    force: Annotated[bool, option("", _FORCE, "--force")] = False,
    list_: Annotated[bool, option("", "list the targets and exit", "--list")] = False,
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
    warn_of(done.warnings)
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
