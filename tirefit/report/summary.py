"""One row per fit, where several files were fitted."""

from collections.abc import Sequence

from tirefit.data.records import FileRecord, Row
from tirefit.data.run_names import run_names
from tirefit.report.numbers import format_estimate
from tirefit.report.text import table_parts


def summary_table(fits: Sequence[FileRecord]) -> str:
    """Directory, parameters with standard deviations, RMSE and verdict of every fit."""
    if not fits:
        return "no file could be fitted"
    parameters = [fit.of_kind("parameter") for fit in fits]
    names = list(dict.fromkeys(name for one in parameters for name in one))
    rows = [["fit", *names, "RMSE", "verdict"]]
    directories = run_names([fit.result for fit in fits])
    for name, fit, known in zip(directories.short, fits, parameters, strict=True):
        cells = [_estimate(known[one]) if one in known else "" for one in names]
        rmse = f"{fit.of_kind('statistic')['rmse'].value:.4g}"
        rows.append([name, *cells, rmse, fit.status])
    of = f" of {directories.pattern}" if directories.pattern else ""
    return "\n".join(["", f"SUMMARY{of}", *table_parts(rows)])


def _estimate(row: Row) -> str:
    return "-" if row.value is None else format_estimate(row.value, row.std)
