"""Short names of parameters, runs and files in reports and figures.

``fit.json`` keeps the whole names; reports use the shortest names that are distinct.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING

from tirefit.data.run_names import clipped, label_of_run, name_pattern, run_names
from tirefit.fitting.result import FitResult

if TYPE_CHECKING:  # which imports much that other fits do not need
    from tirefit.fitting.mf.result import MagicFormulaFit


def _short(result: FitResult) -> Mapping[str, str]:
    runs = [str(run) for run in result.data["runs"]]
    return dict(zip(runs, run_names(runs).short, strict=True))


def short_run(result: FitResult, run: str) -> str:
    """The part of a run's name that differs from the others."""
    return _short(result).get(run, run)


def short_label(result: FitResult, label: str) -> str:
    """``mu[run01]``: a parameter or derived quantity, with its run's short name."""
    return label_of_run(label, result.data["runs"])


def run_lines(result: FitResult) -> list[str]:
    """Lines that explain the short names; empty if they are the full names."""
    runs = [str(run) for run in result.data["runs"]]
    names = run_names(runs)
    if names.short == tuple(runs):
        return []
    if names.pattern:
        between = ", " if len(runs) == 2 else " ... "
        return [f"{names.short[0]}{between}{names.short[-1]} of {names.pattern}"]
    return [f"{i}: {run}" for i, run in enumerate(runs, 1)]


def fit_files(result: "FitResult | MagicFormulaFit", most: int = 1000) -> str:
    """The file of a fit without its folder; of several their number and pattern."""
    files = result.data["file"].replace("\\", "/").split(", ")
    if not 1 < len(files) <= len(result.data["runs"]):
        return clipped(result.data["file"].replace("\\", "/").rsplit("/", 1)[-1], most)
    pattern = name_pattern([file.rsplit("/", 1)[-1] for file in files])
    return clipped(f"{len(files)} files, {pattern}", most)
