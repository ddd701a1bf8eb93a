"""Figures and comparisons for notebooks and scripts."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from tirefit.fitting.result import FitResult, information
from tirefit.params import check_names
from tirefit.report.curves import fit_curve
from tirefit.report.draw import draw_fit
from tirefit.report.fit_panels import PANELS, figure_of, missing_of
from tirefit.report.fit_tables import FORCE_UNIT, value_text
from tirefit.report.html import Section, fragment
from tirefit.report.numbers import format_number
from tirefit.report.text import table
from tirefit.results import UsageError


def plot_fit(result: FitResult, what: str = "fit", ax: Any = None, **how: Any) -> Any:
    """The matplotlib figure of a fit that :meth:`FitResult.plot` returns.

    Args:
        result: a fit from this process.
        what: ``fit``, ``residuals``, ``runs``, ``profile``, ``corner`` or ``trace``.
        ax: axes of your own figure, on which only the first force of ``fit`` is drawn.
        how: ``parameters`` of the corner and the trace: those to draw, by label or by name
            (for all runs); by default all, or those that are correlated or disagree most.

    Raises:
        UsageError: no such figure, or the fit does not have what it shows.
    """
    check_names("figure", [what], PANELS)
    if what in (missing := missing_of(result)):
        raise UsageError(f"this fit has no {missing[what]}")
    if ax is None:
        return figure_of(result, what, **how)
    curve = fit_curve(result)
    handles = draw_fit(ax, curve)
    ax.legend(handles=handles, fontsize=7, framealpha=0.85, edgecolor="none", title=curve.note)
    return ax.figure


@dataclass(frozen=True)
class Comparison:
    """Several models on the same data, lowest AICc first; prints as a table."""

    rows: tuple[tuple[str, ...], ...]  # cells, header first
    notes: tuple[str, ...]  # remarks printed below the table

    def __str__(self) -> str:
        right = tuple(range(1, len(self.rows[0]) - 1))
        lines = table([list(row) for row in self.rows], right)
        return "\n".join([*lines, *(f"  {note}" for note in self.notes)])

    def _repr_html_(self) -> str:
        return fragment("", [Section("", self.notes, self.rows)])


def _comparable(results: Sequence[FitResult]) -> None:
    if not results:
        raise UsageError("nothing to compare: give a list of fits")
    keys = {(r.data["file"], r.data["sha256"], r.statistics.n, r.forces) for r in results}
    if len(keys) > 1:
        raise UsageError(
            "these fits are of different rows or forces, so AICc, BIC and RMSE do not"
            " tell which model is better: fit all models to the same data"
        )


def compare(results: Sequence[FitResult]) -> Comparison:
    """Compare models fitted to the same data, with the same effective number of rows.

    Args:
        results: fits of the same rows and forces.

    Returns:
        A table for ``print`` and for notebooks.

    Raises:
        UsageError: no fits, or fits of different data.

    Example:
        >>> data = read(samples / "circles.csv")
        >>> table = compare([fit(data, model) for model in ("brush", "elliptic")])
        >>> [row[0] for row in table.rows]
        ['model', 'elliptic', 'brush']
    """
    _comparable(results)
    best = min(results, key=lambda r: r.statistics.rmse).statistics
    criteria = {
        id(r): information(
            r.statistics.minus_two_log_likelihood,
            best.n * len(r.forces),
            best.n_effective,
            r.statistics.unknowns,
        )
        for r in results
    }
    ordered = sorted(results, key=lambda r: criteria[id(r)][0])
    best_aicc = criteria[id(ordered[0])][0]
    best_bic = min(bic for _, bic in criteria.values())
    unit = FORCE_UNIT[ordered[0].forces[0]]
    rows = [("model", "k", f"RMSE [{unit}]", "AICc", "Δ AICc", "Δ BIC", "n_eff", "verdict")]
    for r in ordered:
        s, (aicc, bic) = r.statistics, criteria[id(r)]
        rows.append(
            (
                r.model,
                str(len(r.labels)),
                format_number(s.rmse),
                f"{aicc:.1f}",
                f"{aicc - best_aicc:.1f}",
                f"{bic - best_bic:.1f}",
                f"{s.n_effective:.0f}",
                str(r.status),
            )
        )
    notes = [_parameters(r) for r in ordered]
    effective = [r.statistics.n_effective for r in ordered]
    if max(effective) > 1.1 * min(effective):
        notes.append(
            "AICc and BIC count the rows of every model as"
            f" {best.n_effective:.0f}, the effective number of the closest fit"
        )
    return Comparison(tuple(rows), tuple(notes))


def _parameters(result: FitResult) -> str:
    parts = []
    for name, estimate in result.parameters.items():
        if not estimate.fixed:
            unit = "" if estimate.unit == "-" else f" {estimate.unit}"
            parts.append(f"{name} = {value_text(estimate)}{unit}")
    return f"{result.model}: {', '.join(parts)}"
