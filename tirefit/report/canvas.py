"""Parts of all figures: colours, axes with units, points, bands, legends, panels, files.

Only matplotlib's object API is used: pyplot imports slowly and keeps global lists.
"""

import io
import textwrap
import warnings
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from tirefit.files import replacing
from tirefit.report.numbers import plain_text
from tirefit.report.page import image_of

BLUE, ORANGE, GREEN = "#0072B2", "#E69F00", "#009E73"
RED, SKY, PURPLE = "#D55E00", "#56B4E9", "#CC79A7"
COLORS = (BLUE, RED, GREEN, ORANGE, PURPLE, SKY)
"""Okabe and Ito's palette, distinct for any colour vision."""
DARK, GREY = "#222222", "#8a8a8a"

MOST_DRAWN = 20_000  # largest number of points of a panel; more overlap and are slow
_FARTHEST = 20

WIDE = 4.6
"""Width [in] of a picture of a page: on a screen of 375 pixels, 8.5 points are then 9.6
pixels high."""


class Picture(Figure):
    """A figure that notebooks display with any matplotlib backend."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        settings: dict[str, Any] = {"dpi": 130, "facecolor": "white"} | kwargs
        super().__init__(*args, **settings)
        FigureCanvasAgg(self)

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.write(buffer, "png", dpi=self.dpi)
        return buffer.getvalue()

    def write(self, target: Any, kind: str, **how: Any) -> None:
        """Save to a path or buffer, without warnings on letters that the font lacks."""
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="Glyph .* missing from font")
            self.savefig(target, format=kind, **how)


def frame(
    title: str, text: str, foot: str, size: tuple[float, float], note: str = "", color: str = DARK
) -> Picture:
    """An empty picture with title, text, note and footnote, and a layout between them.

    Args:
        size: width of the picture, and height of the space for axes, in inches.
        note: below the text in small print, may hold mathematics.
        color: of the text.
    """
    width, height = size
    heads = textwrap.wrap(title, int(9.5 * width), max_lines=2, placeholder=" …")
    # Of the text below the title of a figure.
    lines = textwrap.wrap(text, int(14.3 * width))
    feet = textwrap.wrap(foot, int(18.5 * width))
    below, above = 0.06 + 0.12 * len(feet), 0.2 + 0.2 * len(heads)
    head = above + 0.15 * len(lines) + 0.14 * (len(note.splitlines()) + bool(note))
    height += head + below
    picture = Picture(figsize=(width, height))
    box = (0, below / height, 1, 1 - (head + below) / height)
    picture.set_layout_engine("constrained", rect=box)
    for y, said, letters, weight, shade in (
        (height - 0.10, plain_text("\n".join(heads)), 10.5, "bold", DARK),
        (height - above + 0.09, plain_text("\n".join(lines)), 8.5, "normal", color),
        (below - 0.03, plain_text("\n".join(feet)), 6.5, "normal", GREY),
        (height - head + 0.14 * len(note.splitlines()), note, 7.5, "normal", DARK),
    ):
        picture.text(
            0.02, y / height, said, va="top", fontsize=letters, fontweight=weight, color=shade
        )
    return picture


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


def axes_panel(
    draw: Callable[[Any], None], title: str, x_label: str, y_label: str, note: str = ""
) -> Panel:
    """A panel of one axes with title, labels, and a legend if lines have labels."""

    def on_figure(figure: Any) -> None:
        axes = figure.subplots()
        draw(axes)
        tidy(axes, x_label, y_label)
        panel_title(axes, title, note)
        if axes.get_legend_handles_labels()[1]:
            axes.legend(framealpha=0.85, edgecolor="none", fontsize=7.5)

    return Panel(on_figure, title, (WIDE, 3.0))


def images_of(panels: Iterable[Panel]) -> list[dict[str, Any]]:
    """The panels for the templates of pages."""
    return [
        image_of(
            alone(panel),
            panel.alternative,
            # Pixels of the page: 100 per inch of a panel that scrolls.
            round(100 * panel.size[0]) if panel.scrolls else 0,
        )
        for panel in panels
    ]


def together(
    panels: Sequence[Panel], title: str, text: str, foot: str, color: str = DARK
) -> Picture:
    """The panels one below the other, with title, text and footnote.

    Args:
        color: of the text.
    """
    heights = [panel.size[1] for panel in panels]
    width = max(WIDE, *(panel.size[0] for panel in panels))
    picture = frame(title, text, foot, (width, sum(heights)), panels[0].note, color)
    parts = picture.subfigures(len(panels), 1, squeeze=False, height_ratios=heights)
    for part, panel in zip(parts.ravel(), panels, strict=True):
        panel.draw(part)
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


def colors_of(count: int) -> Sequence[Any]:
    """Distinct colours; of many groups, in their order."""
    if count <= len(COLORS):
        return COLORS[:count]
    return list(mpl.colormaps["viridis"](np.linspace(0, 0.92, count)))


def drawn(values: np.ndarray, among: int | None = None) -> np.ndarray:
    """The points to draw (m,), in order; of very many, random and extreme ones.

    Args:
        values: (n,) of the points.
        among: number of points in the panel, those of other groups too.
    """
    count = len(values)
    share = min(MOST_DRAWN / max(among or count, 1), 1.0)
    if share == 1.0 or count <= _FARTHEST:
        return np.arange(count)
    extreme = np.argpartition(np.abs(values - np.median(values)), -_FARTHEST)[-_FARTHEST:]
    rest = np.random.default_rng(0).integers(0, count, int(share * count))
    return np.unique(np.concatenate([extreme, rest]))


def dots(
    axes: Any, x: np.ndarray, y: np.ndarray, size: float, color: Any, alpha: float = 1.0, **how: Any
) -> None:
    """Draw many points without edges, as an image in vector graphics."""
    style = {"marker": "o", "ms": size, "mew": 0, "color": color, "alpha": alpha}
    axes.plot(x, y, linestyle="none", rasterized=True, zorder=2, **style, **how)


def boxed(axes: Any, x: float, y: float, text: str, size: float, **how: Any) -> None:
    """Write a text on white, which lines do not cross."""
    box = {"color": "white", "pad": 0.5}
    axes.text(x, y, plain_text(text), fontsize=size, color=DARK, bbox=box, **how)


def tidy(axes: Any, x_label: str = "", y_label: str = "", size: float = 8.5) -> None:
    """Open frame, small ticks, labels."""
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(GREY)
    axes.tick_params(labelsize=size - 1, color=GREY, labelcolor=DARK, length=3)
    axes.set_xlabel(x_label, fontsize=size, color=DARK)
    axes.set_ylabel(y_label, fontsize=size, color=DARK)


def panel_title(axes: Any, text: str, note: str = "") -> None:
    """Title of a panel, with a note in small print."""
    lines = textwrap.wrap(note, 66)  # largest number of characters in a line of a panel's note
    style: dict[str, Any] = {"loc": "left", "fontsize": 9.5, "fontweight": "bold", "color": DARK}
    axes.set_title(plain_text(text), pad=6 + 11 * len(lines), **style)
    if note:
        small: dict[str, Any] = {"fontsize": 7.5, "color": GREY, "va": "bottom"}
        axes.text(0, 1.02, plain_text("\n".join(lines)), transform=axes.transAxes, **small)


def save_pictures(pictures: Iterable[tuple[str, Picture]], folder: Path) -> list[Path]:
    """Write named pictures as PNG; returns the files."""
    return [save_picture(picture, folder / f"{name}.png") for name, picture in pictures]


def save_picture(picture: Picture, path: Path) -> Path:
    """Write a picture, PNG or SVG by the suffix, completely or not at all."""
    # By its name in the file a later command knows that tirefit drew the figure.
    metadata = (
        {"Date": None, "Creator": "tirefit"} if path.suffix == ".svg" else {"Software": "tirefit"}
    )
    with replacing(path) as temporary:
        picture.write(temporary, path.suffix[1:], metadata=metadata)
    return path
