"""``tirefit explore``: a page with sliders of one tire, or of several over each other."""

import os
from pathlib import Path
from typing import Annotated
from urllib.parse import quote

import typer

from tirefit.cli import options as cli
from tirefit.cli.commands.fit_one import PAGE
from tirefit.cli.commands.magic_formula import MAGIC_FORMULA_NAMES
from tirefit.cli.output import check_results, is_page
from tirefit.data.tir.tire_file import tire_kind
from tirefit.data.write import output_problems
from tirefit.files import write_texts
from tirefit.names import MODEL_NAMES
from tirefit.results import InputProblem, UsageError, did_you_mean

_NAMES = (*MODEL_NAMES, *MAGIC_FORMULA_NAMES)
_TIRES = "fits, .tir files, names of models, or folders of them; several over each other"


@cli.takes_data_options
def explore(
    tires: Annotated[list[str], typer.Argument(metavar="FIT.json|FILE.tir|FOLDER", help=_TIRES)],
    options: cli.DataOptions,
    data: Annotated[
        Path | None, cli.path_option("DATA.csv", "measured rows to show beside the curves")
    ] = None,
    out: Annotated[Path, cli.path_option("FILE.html", "page to write")] = Path("explore.html"),
) -> None:
    """Write a page with sliders: forces, friction ellipse, stiffness and peak of tires.

    The page needs no other file and no network, and evaluates the model itself. The fit.html
    of a tire in the folder of the page is linked to it. Options
    that describe the file (--column, --unit, ...) are those of DATA.csv.
    """
    problems = output_problems(out, ".html")
    reason = "there is no such file or folder, and no model of this name"
    for name in tires:
        if not (name in _NAMES or tire_kind(name) or os.path.exists(name)):
            remedy = f"{did_you_mean(name, MODEL_NAMES)}`tirefit models` lists the models"
            problems.append(InputProblem(reason, remedy, name))
    UsageError.raise_for(problems)
    check_results([out])
    how = cli.read_options(options)
    cli.start_jax()
    from tirefit.report.fit.report import EXPLORE
    from tirefit.targets.explore import explore

    explored = explore(tires, data, **how)
    cli.warn_of(explored.warnings)
    explored.save(out)
    cli.say(explored.summary())
    cli.say(f"wrote {out}: open it in a browser")
    # The page of this fit, if it is in the same folder, gets a link.
    page = out.parent / PAGE
    paths_of_fit = {page.parent.resolve(), page.with_suffix(".json").resolve()}
    if is_page(page) and not paths_of_fit.isdisjoint(Path(tire).resolve() for tire in tires):
        text = page.read_text(encoding="utf-8")
        link = f'<a href="{quote(out.name)}">{EXPLORE.partition(":")[0]}</a>'
        if EXPLORE in text:
            write_texts({page: text.replace(EXPLORE, link)})
            cli.say(f"linked from {page}")
