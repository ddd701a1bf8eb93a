"""Values of one quantity by run, by file or over time: an array of points, drawn on axes."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from tirefit.data.run_names import clipped
from tirefit.report.canvas import BLUE, DARK, GREY, RED, WIDE, Panel, panel_title, tidy
from tirefit.report.numbers import plain_text

_MOST_NAMES = 40


class Points(NamedTuple):
    """One quantity of n runs or files: values and ends of their bars (n,), NaN if open."""

    label: str
    names: Sequence[str]  # empty: the axis has dates
    at: np.ndarray
    value: np.ndarray
    low: np.ndarray
    high: np.ndarray
    known: np.ndarray  # (n,) whether the data identify it
    outlying: np.ndarray  # (n,) whether it differs from the others
    line: tuple[np.ndarray, float] | None = None  # values (n,), half-width


def reach(points: Points) -> tuple[float, float]:
    """Lower and upper end of the axis, by the identified values."""
    rows = points.known & np.isfinite(points.value)
    rows = rows if rows.any() else np.isfinite(points.value)
    ends = np.concatenate([points.value[rows], points.low[rows], points.high[rows]])
    ends = ends[np.isfinite(ends)]
    if len(ends) == 0:
        return 0.0, 1.0
    low, high = float(ends.min()), float(ends.max())
    margin = 0.08 * (high - low) or 0.05 * abs(high) or 1.0
    return low - margin, high + margin


def points_panel(points: Points, alternative: str, note: str) -> Panel:
    """The points as a panel, with their names or dates below."""

    def draw(figure: Any) -> None:
        axes = figure.subplots()
        draw_points(axes, points)
        panel_title(axes, points.label, note)

    longest = max(map(len, names_below(points.names)), default=6)
    return Panel(draw, alternative, (WIDE, 2.0 + 0.05 * longest))


def draw_points(axes: Any, points: Points) -> None:
    """Draw values with their bars; those not identified are open and grey, those that differ
    red crosses."""
    dated, (low, high) = not len(points.names), reach(points)
    at = (points.at * 86400).astype("datetime64[s]") if dated else points.at
    size = float(np.clip(60 / len(at), 1.0, 5.0))
    first = np.where(np.isnan(points.low), low, np.maximum(points.low, low))
    last = np.where(np.isnan(points.high), high, np.minimum(points.high, high))
    there = np.isfinite(points.value)
    value = np.where(there, np.clip(points.value, low, high), low)
    cross = ~there | points.known & points.outlying
    for rows, color, mark, face in (
        (points.known & ~cross, BLUE, "o", BLUE),
        (cross, RED, "x", RED),
        (~points.known & ~cross, GREY, "o", "white"),
    ):
        bars = rows & there
        axes.vlines(at[bars], first[bars], last[bars], color=color, lw=1.2)
        axes.plot(at[rows], value[rows], mark, markersize=size, color=color, markerfacecolor=face)
    if points.line is not None:
        line, half = points.line
        order = np.argsort(at)[points.known[np.argsort(at)]]
        axes.plot(at[order], line[order], color=DARK, lw=0.8)
        ends = (line - half)[order], (line + half)[order]
        axes.fill_between(at[order], *ends, color=GREY, alpha=0.25, lw=0)
    tidy(axes)
    axes.set_ylim(low, high)
    axes.grid(axis="y", color=GREY, alpha=0.25, lw=0.5)
    if dated:
        axes.set_xlabel("date in the file's name", fontsize=8.5)
    else:
        _name_places(axes, points.names)


def names_below(names: Sequence[str]) -> list[str]:
    """The names as drawn below an axis; of many, some of them."""
    return [plain_text(clipped(name, 18)) for name in names[:: -(-len(names) // _MOST_NAMES) or 1]]


def _name_places(axes: Any, names: Sequence[str]) -> None:
    """Names below the places 0, 1, ..."""
    texts = names_below(names)
    axes.set_xticks(np.arange(len(texts)) * (-(-len(names) // _MOST_NAMES) or 1), texts)
    if sum(map(len, texts)) > 40:
        axes.tick_params(axis="x", labelrotation=90, labelsize=7)
    axes.set_xlim(-0.6, len(names) - 0.4)
