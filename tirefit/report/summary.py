"""One row per fit, where several files were fitted."""

from collections.abc import Sequence

from tirefit.data.run_names import run_names
from tirefit.fitting.result import FitResult
from tirefit.report.numbers import format_estimate
from tirefit.report.text import table_parts

__all__ = ["summary_table"]


def summary_table(fits: Sequence[tuple[str, FitResult]]) -> str:
    """Directory, parameters with standard deviations, RMSE and verdict of every fit."""
    if not fits:
        return "no file could be fitted"
    names = list(dict.fromkeys(name for _, fit in fits for name in fit.least_squares))
    rows = [["fit", *names, "RMSE", "verdict"]]
    directories = run_names([directory for directory, _ in fits])
    for directory, (_, fit) in zip(directories.short, fits, strict=True):
        cells = [
            format_estimate(fit.parameters[name].value, fit.parameters[name].std)
            if name in fit.parameters
            else ""
            for name in names
        ]
        rmse = f"{fit.statistics.rmse:.4g}"
        rows.append([directory, *cells, rmse, fit.verdict["status"]])
    of = f" of {directories.pattern}" if directories.pattern else ""
    return "\n".join(["", f"SUMMARY{of}", *table_parts(rows)])
