"""``tirefit demo``: run the two main commands on measured samples of the package."""

import shlex
import shutil
from filecmp import cmp
from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated

import typer

from tirefit.cli.options import path_option, say
from tirefit.cli.output import check_results
from tirefit.results import DataError, InputProblem


def demo(
    context: typer.Context,
    out: Annotated[Path, path_option("FOLDER", "samples and results")] = Path("tirefit-demo"),
) -> None:
    """Fit and diagnose measured samples that ship with tirefit."""
    samples = out / "samples"
    with as_file(files("tirefit") / "samples") as shipped:
        there = {samples / sample.name: sample for sample in shipped.iterdir()}
        check_results(there)
        changed = [p for p, s in there.items() if p.exists() and not cmp(s, p, shallow=False)]
        reason = "it would be replaced, but differs from the sample that ships with tirefit"
        remedy = "choose another folder with --out, or rename the file"
        DataError.raise_for([InputProblem(reason, remedy, str(path)) for path in changed])
        shutil.copytree(shipped, samples, dirs_exist_ok=True)
    say(
        "A car of scale 1:10 drove circles on one day and freely on another.\n"
        "First a brush model is fitted to the circles.\n"
    )
    circles, driving = samples / "circles.csv", samples / "free_driving.csv"
    _run(context, "fit", circles, "--no-posterior", "--out", out / "fit")
    say("\nThen this tire is compared with the free driving: what does it lack?\n")
    model, gap = out / "fit" / "fit.json", out / "gap"
    _run(context, "diagnose", driving, "--model", model, "--figures", "--out", gap)
    say(
        f"\nResults\n  {samples}: the samples\n"
        f"  {out / 'fit' / 'fit.png'}: the measured points and the curve\n"
        f"  {gap / 'free_driving.html'}: a page of the diagnosis\n"
        "\nTry next\n"
        f"  tirefit inspect {shlex.quote(str(driving))}\n"
        "      how the file was read, and what it can determine; then with your own\n"
        f"  tirefit export {shlex.quote(str(model))} --to c --out tire.h\n"
        "      the tire for another program\n"
        "  tirefit --help"
    )


def _run(context: typer.Context, *words: str | Path) -> None:
    """Print a command and run it; a command that fails ends the demo."""
    line = [str(word) for word in words]
    say(f"$ tirefit {shlex.join(line)}\n")
    command = context.find_root().command
    if code := command.main(line, "tirefit", standalone_mode=False):
        raise typer.Exit(code)
