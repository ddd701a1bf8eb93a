"""One row per fit, where several files were fitted."""

from collections.abc import Sequence

from tirefit.data.records import FileRecord
from tirefit.report.numbers import format_estimate
from tirefit.report.text import table

__all__ = ["summary_table"]


def summary_table(fits: Sequence[FileRecord]) -> str:
    """Directory, parameters with standard deviations, RMSE and verdict of every fit."""
    if not fits:
        return "no file could be fitted"
    parameters = [fit.of_kind("parameter") for fit in fits]
    names = list(dict.fromkeys(name for one in parameters for name in one))
    rows = [["fit", *names, "RMSE", "verdict"]]
    for fit, known in zip(fits, parameters, strict=True):
        cells = [
            format_estimate(known[name].value, known[name].std) if name in known else ""
            for name in names
        ]
        rmse = f"{fit.of_kind('statistic')['rmse'].value:.4g}"
        rows.append([fit.result, *cells, rmse, fit.status])
    return "\n".join(["", "SUMMARY", *table(rows)])
