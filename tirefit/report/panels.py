"""Panels, of which figures and pages consist: each is drawn by itself or beside others."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from tirefit.fitting.result import FitResult
from tirefit.report import canvas
from tirefit.report.canvas import DARK, RED, WIDTH, Picture, frame
from tirefit.report.html import image_of
from tirefit.report.labels import fit_files
from tirefit.report.text import verdict_line

WIDE = 4.6
"""Width [in] of a picture of a page: on a screen of 375 pixels, 8.5 points are then 9.6
pixels high."""


_PIXELS = 100  # of the page per inch of a panel that scrolls


class Panel(NamedTuple):
    """One panel: the function that draws it on a figure, a description in words, its size
    [in], a note in small print, and whether it may not shrink to the width of a phone."""

    draw: Callable[[Any], None]
    alternative: str
    size: tuple[float, float] = (WIDE, 2.3)
    note: str = ""
    scrolls: bool = False


def alone(panel: Panel) -> Picture:
    """The panel as a picture."""
    picture = Picture(figsize=panel.size, layout="constrained")
    panel.draw(picture)
    if panel.note:
        picture.suptitle(panel.note, x=0.02, ha="left", fontsize=7.5, color=DARK)
    return picture


def images_of(panels: Sequence[Panel]) -> list[dict]:
    """The panels for the templates of pages."""
    return [
        image_of(alone(one), one.alternative, round(_PIXELS * one.size[0]) if one.scrolls else 0)
        for one in panels
    ]


def together(result: FitResult, panels: Sequence[Panel], columns: int = 1) -> Picture:
    """The panels of a fit in rows, with title and footnote; the first row has the first
    panel alone if the rows would not be full otherwise."""
    first = (len(panels) - 1) % columns + 1
    rows = [panels[:first], *(panels[i : i + columns] for i in range(first, len(panels), columns))]
    heights = [max(panel.size[1] for panel in row) for row in rows]
    size = max(WIDTH, *(panel.size[0] for panel in panels)), sum(heights)
    count = result.statistics.n
    foot = f"tirefit {result.version} · braking positive, SI · seed {result.seed} · {count} rows"
    if count > canvas.MOST_DRAWN:
        foot += f", {canvas.MOST_DRAWN} of them drawn"
    title = f"{result.model} fitted to {fit_files(result, 68)}"
    color = RED if result.outcomes else DARK
    picture = frame(title, verdict_line(result), foot, size, panels[0].note, color)
    parts = picture.subfigures(len(rows), 1, squeeze=False, height_ratios=heights)
    for part, row in zip(parts.ravel(), rows, strict=True):
        for cell, panel in zip(part.subfigures(1, len(row), squeeze=False)[0], row, strict=True):
            panel.draw(cell)
    return picture


def legend_below(figure: Any, handles: Sequence[Any], title: str = "", columns: int = 2) -> None:
    """Draw the legend of a panel below its axes."""
    figure.legend(
        handles=handles,
        loc="outside lower left",
        ncols=columns,
        fontsize=8,
        frameon=False,
        title=title or None,
        title_fontsize=8,
        alignment="left",
    )
