"""One row per fit, where several files were fitted."""

from collections.abc import Sequence

from tirefit.fitting.result import FitResult
from tirefit.report.numbers import format_estimate
from tirefit.report.text import table

__all__ = ["summary_table"]


def summary_table(fits: Sequence[tuple[str, FitResult]]) -> str:
    """Directory, parameters with standard deviations, RMSE and verdict of every fit."""
    if not fits:
        return "no file could be fitted"
    names = list(dict.fromkeys(name for _, fit in fits for name in fit.least_squares))
    rows = [["fit", *names, "RMSE", "verdict"]]
    for directory, fit in fits:
        cells = [
            format_estimate(fit.parameters[name].value, fit.parameters[name].std)
            if name in fit.parameters
            else ""
            for name in names
        ]
        rmse = f"{fit.statistics.rmse:.4g}"
        rows.append([directory, *cells, rmse, fit.verdict["status"]])
    return "\n".join(["", "SUMMARY", *table(rows)])
