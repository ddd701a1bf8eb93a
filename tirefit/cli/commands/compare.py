"""``tirefit compare``: fits, tires and diagnoses side by side."""

from pathlib import Path
from typing import Annotated

import typer

from tirefit.cli.options import Folder, Html, start_jax
from tirefit.cli.output import check_results, write_result

FIGURE, PAGE = "comparison.png", "comparison.html"
FILES = ("comparison.json", FIGURE, PAGE)


def compare(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE",
            help="two or more of fit.json, trajectory.json, NAME.json or vehicle_diagnosis.json"
            " of diagnose, FILE.tir",
        ),
    ],
    *,
    out: Folder,
    html: Html = False,
) -> None:
    """Compare fits, .tir files or diagnoses: what differs beyond its error.

    Parameters with the standard error of their difference, forces over the common range of
    slip and load, and effects that some or all diagnoses name. Fits of the same rows are
    ranked by AICc.
    """
    check_results([out / name for name in FILES])
    start_jax()
    from tirefit.diagnosis.summary.compare import compare as compared

    result = compared(files)
    figures = {FIGURE: ""} if result.forces else {}
    write_result(result, out, FILES, figures, PAGE if html else "")
