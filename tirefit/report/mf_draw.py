"""Draw the figures of a Magic Formula fit, and write its files."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tirefit.fitting.mf.result import MagicFormulaFit
from tirefit.report.canvas import GREY, Picture, panel_title, save_pictures
from tirefit.report.curves import FORCE_LABEL
from tirefit.report.draw import draw_fit
from tirefit.report.html import Section, image_of, page
from tirefit.report.labels import fit_files
from tirefit.report.magic_formula import magic_formula_report
from tirefit.report.mf_curves import Panel, panels_of
from tirefit.report.numbers import plain_text
from tirefit.report.panels import WIDE, legend_below

MAGIC_FORMULA_FILES = tuple(
    f"{name}{suffix}"
    for name in ("fit", *FORCE_LABEL, "residuals", "ellipse")
    for suffix in (".png", ".svg")
)
"""Every file that :func:`save_magic_formula` may write."""

_HEIGHT = 3.5  # height of a panel with its legend [in]


def _draw(figure: Any, panel: Panel) -> None:
    """Draw a panel with its legend below it."""
    handles = _draw_on(figure.subplots(), panel)
    legend_below(figure, handles, columns=3)


def _draw_on(axes: Any, panel: Panel) -> list:
    """Draw a panel on given axes; returns the entries of its legend."""
    handles = draw_fit(axes, panel.curve)
    panel_title(axes, panel.title, panel.curve.note)
    x = [g.slip for g in panel.curve.groups] + [c.slip for c in panel.curve.curves]
    low, high = min(v.min() for v in x), max(v.max() for v in x)
    margin = 0.02 * (high - low)
    axes.set_xlim(low - margin, high + margin)
    if panel.ticks:
        axes.set_xticks(*zip(*panel.ticks, strict=True))
    return handles


def stacked(panels: Sequence[Panel], title: str = "") -> Picture:
    """The panels one below the other, each with its legend below it."""
    picture = Picture(figsize=(WIDE, _HEIGHT * len(panels)), layout="constrained")
    if title:
        picture.suptitle(plain_text(title), fontsize=9.5, color=GREY)
    parts = picture.subfigures(len(panels), squeeze=False).ravel()
    for part, panel in zip(parts, panels, strict=True):
        _draw(part, panel)
    return picture


def _title(fit: MagicFormulaFit) -> str:
    return f"{fit.model} fitted to {fit_files(fit, 50)}"


def plot_magic_formula(fit: MagicFormulaFit, ax=None):
    """Draw every force over its slip by load, measured and fitted; returns the Figure.

    Args:
        fit: a fit of this process, which has its data.
        ax: axes to draw only the first force on.
    """
    first = _first(fit, panels_of(fit))
    if ax is None:
        return stacked(first, _title(fit))
    ax.legend(handles=_draw_on(ax, first[0]), fontsize=7, framealpha=0.85, edgecolor="none")
    return ax.figure


def _first(fit: MagicFormulaFit, panels: Mapping[str, Sequence[Panel]]) -> list[Panel]:
    """The first panel of each force."""
    return [panels[force][0] for force in fit.binned if force in panels]


def magic_formula_page(fit: MagicFormulaFit) -> str:
    """The fit as one self-contained HTML page: figures, report and record."""
    panels = [panel for named in panels_of(fit).values() for panel in named]
    sections = [
        Section("", pictures=[image_of(stacked([panel]), panel.title) for panel in panels]),
        Section("Report", text=magic_formula_report(fit, full=True)),
    ]
    return page(_title(fit), sections, record=fit.to_json())


def save_magic_formula(fit: MagicFormulaFit, folder: Path, svg: bool = False) -> list[Path]:
    """Write the figures as PNG, and as SVG if ``svg``; returns the files."""
    panels = panels_of(fit)
    named = {"fit": _first(fit, panels), **panels}.items()
    return save_pictures(((name, stacked(some, _title(fit))) for name, some in named), folder, svg)
