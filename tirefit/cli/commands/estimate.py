"""``tirefit estimate``: friction while driving, from a log."""

from pathlib import Path
from typing import Annotated

import typer

from tirefit.cli import options as cli
from tirefit.cli.notes import warn
from tirefit.cli.output import check_results, write_result

_SET = cli.option("[METHOD.]NAME=VALUE", "setting of a method", "--set", parser=cli.number)
FILES = ("estimates.csv", "summary.json", "estimates.png")


@cli.takes_data_options
def estimate(
    log: Annotated[Path, typer.Argument(metavar="LOG.csv", help="log in time order")],
    options: cli.DataOptions,
    out: cli.Folder,
    method: Annotated[str, cli.option("NAME[,NAME...]", "methods (see `tirefit methods`)")] = "rls",
    setting: Annotated[cli.Pairs, _SET] = None,
) -> None:
    """Estimate friction and stiffness at each row, from the rows up to it."""
    values = cli.by_name(setting)
    check_results([out / name for name in FILES])
    from tirefit.data.read import read
    from tirefit.online.methods import METHODS
    from tirefit.params import by_owner, check_names

    names = check_names("method", method, METHODS)
    by_owner(values, {name: METHODS[name]() for name in names})  # before the file is read
    how = cli.read_options(options)
    cli.start_jax()
    from tirefit.online.estimate import estimate as estimate_log

    # Logs have gaps: a row that cannot be used is flagged and no error.
    table = read(log, **(how | {"mask_bad_rows": True, "curve": False}))
    warn(table)
    if unused := len(table) - table.n:
        said = f"{unused} of {len(table)} rows cannot be used; their estimates are flagged: "
        rows = "; ".join(table.first_masked()[:3])
        cli.warn_of([said + rows], table.source.path)
    write_result(estimate_log(table, names, values), out, FILES, {FILES[2]: ""})
