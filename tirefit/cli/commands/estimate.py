"""``tirefit estimate``: friction while driving, from a log."""

from pathlib import Path
from typing import Annotated

import typer

from tirefit.cli.notes import warn
from tirefit.cli.options import (
    DataOptions,
    Folder,
    Texts,
    option,
    read_config,
    read_options,
    settings_of,
    start_jax,
    takes_data_options,
    warn_of,
)
from tirefit.cli.output import check_results, claimed, write_result
from tirefit.results import InputProblem

FILES = ("estimates.csv", "summary.json", "estimates.png")


@takes_data_options
def estimate(
    log: Annotated[Path, typer.Argument(metavar="LOG.csv", help="log in time order")],
    options: DataOptions,
    out: Folder,
    method: Annotated[str, option("NAME[,NAME...]", "methods (see `tirefit methods`)")] = "rls",
    setting: Annotated[Texts, option("[METHOD.]NAME=VALUE", "setting of a method", "--set")] = None,
) -> None:
    """Estimate friction and stiffness at each row, from the rows up to it."""
    (values,) = settings_of(set=setting)
    check_results([out / name for name in FILES])
    from tirefit.data.read import read
    from tirefit.online.methods import METHODS
    from tirefit.params import by_owner, check_names

    names = check_names("method", method, METHODS)
    by_owner(values, {name: METHODS[name]() for name in names})  # before the file is read
    how = read_options(options, read_config(options.config))
    start_jax()
    from tirefit.online.estimate import estimate as estimate_log

    with claimed(out):
        # Logs have gaps: a row that cannot be used is flagged and no error.
        table = read(log, **(how | {"mask_bad_rows": True, "curve": False}))
        warn(table)
        first: dict[tuple[str | None, str], InputProblem] = {}  # unusable row of each kind
        for problem in table.source.masked:
            if problem.row is not None:
                first.setdefault((problem.column, problem.remedy), problem)
        warn_of(map(str, first.values()))
        if unused := len(table) - table.n:
            rows = f"{unused} of {len(table)} rows cannot be used"
            warn_of([f"{rows}; their estimates are flagged"], table.source.path)
        write_result(estimate_log(table, names, values), out, FILES, {FILES[2]: ""})
