"""Arrays -> axes: the posterior of every parameter and of every pair."""

import re
from collections.abc import Sequence

import numpy as np
from matplotlib.colors import ListedColormap

from tirefit.fitting.result import FitResult
from tirefit.report.canvas import BLUE, DARK, GREY, RED, WIDTH, Picture, frame, tidy
from tirefit.report.uncertainty import Corner, corner_data

_MOST_PANELS = 8
"""Largest number of parameters with a panel with scales for each pair."""
_WORTH_SAYING = 0.3  # smallest correlation that is printed


def _centers(edges):
    return (edges[1:] + edges[:-1]) / 2


def draw_marginal(axes, corner: Corner, i: int) -> None:
    """Density of one parameter with its 95 % interval and the least-squares value."""
    low, high = corner.interval[i]
    axes.axvspan(low, high, color=BLUE, alpha=0.12, lw=0)
    axes.stairs(corner.density[i], corner.edges[i], color=BLUE, lw=1.2)
    axes.axvline(corner.median[i], color=BLUE, lw=0.9)
    axes.axvline(corner.estimate[i], color=RED, lw=0.9, ls="--")
    axes.set_xlim(corner.edges[i][0], corner.edges[i][-1])
    axes.set_ylim(0, 1.08)


def draw_joint(axes, corner: Corner, i: int, j: int) -> None:
    """Regions of parameter i over j that hold 50 % and 95 % of the posterior."""
    joint, (outer, inner) = corner.joint[i, j], corner.levels[i, j]
    top = float(joint.max())
    levels = np.unique([max(outer, 1e-12 * top), min(inner, 0.999 * top), 1.001 * top])
    axes.contourf(
        _centers(corner.edges[j]),
        _centers(corner.edges[i]),
        joint,
        levels=levels,
        colors=["#9ecae8", BLUE][-(len(levels) - 1) :],
    )
    axes.plot(corner.estimate[j], corner.estimate[i], marker="+", color=RED, markersize=7)
    axes.set_xlim(corner.edges[j][0], corner.edges[j][-1])
    axes.set_ylim(corner.edges[i][0], corner.edges[i][-1])


def corner_figure(result: FitResult, parameters: Sequence[str] | None = None) -> Picture:
    """Draw every parameter and every pair; many parameters in one small grid."""
    # The corner library (2.3) is not used: its rotated numbers overlap labels and
    # footnote, its lines of the estimate cover the regions, it refuses constant columns,
    # and it imports pyplot, which takes 2 s and keeps figures in global lists.
    corner = corner_data(result, parameters)
    if len(corner.labels) > _MOST_PANELS:
        return _grid_figure(result, corner)
    return _panel_figure(result, corner)


def _panel_figure(result: FitResult, corner: Corner) -> Picture:
    """A panel with scales for every pair."""
    count = len(corner.labels)
    picture, (bottom, top) = frame(result, min(2.2 + 1.15 * count, 10.5))
    height = picture.get_figheight()
    _corner_key(picture, corner, top)
    top -= (0.5 if count == 1 else 0.15) / height
    grid = picture.add_gridspec(
        count,
        count,
        left=0.11,
        right=0.98,
        bottom=bottom + 0.5 / height,
        top=top,
        wspace=0.1,
        hspace=0.1,
    )
    size = float(np.clip(10 - 0.5 * count, 5.5, 9))
    # Keep long names of runs next to their panel.
    room = 72 * min((top - bottom) * height, picture.get_figwidth()) / count
    label = min(size, room / (0.6 * max(map(_length, corner.labels))))
    for i in range(count):
        for j in range(i + 1):
            axes = picture.add_subplot(grid[i, j])
            if i == j:
                draw_marginal(axes, corner, i)
            else:
                draw_joint(axes, corner, i, j)
            _corner_labels(axes, corner, i, j, size, label)
    # Align all labels, next to the widest number.
    picture.align_labels()
    return picture


def _classes(corner: Corner) -> np.ndarray:
    """Every pair as an image over all bins of all parameters (p bins, p bins), upwards:
    1 in the 95 % region of the posterior, 2 in the 50 % region."""
    count, bins = corner.density.shape
    image = np.zeros((count * bins, count * bins))
    for (i, j), joint in corner.joint.items():
        outer, inner = corner.levels[i, j]
        cell = (joint >= outer).astype(float) + (joint >= inner)
        image[i * bins : (i + 1) * bins, j * bins : (j + 1) * bins] = cell[::-1]
    return image


def draw_corner(axes, corner: Corner) -> None:
    """Draw all pairs as cells of one axes, without scales, with the larger correlations
    in the upper triangle."""
    count = len(corner.labels)
    axes.imshow(
        _classes(corner),
        extent=(0, count, count, 0),
        aspect="auto",
        vmin=0,
        vmax=2,
        cmap=ListedColormap(["white", "#9ecae8", BLUE]),
        interpolation="nearest",
    )
    for i in range(count):
        share = np.linspace(i, i + 1, corner.density.shape[1])
        axes.fill_between(
            share, i + 1, i + 1 - 0.9 * corner.density[i], color=BLUE, alpha=0.45, lw=0
        )
        first, last = corner.edges[i][[0, -1]]
        at = i + (corner.estimate[i] - first) / (last - first)
        if i < at < i + 1:
            axes.plot([at, at], [i + 0.1, i + 1], color=RED, lw=0.9)
        axes.plot([0, i + 1, i + 1], [i, i, count], color=GREY, lw=0.3)
        for j in range(i):
            value = corner.correlation[i, j]
            if abs(value) >= _WORTH_SAYING:
                axes.text(
                    i + 0.5,
                    j + 0.5,
                    f"{value:+.2f}".replace("-", "−"),
                    ha="center",
                    va="center",
                    fontsize=6,
                    color=DARK,
                )
    axes.set_xlim(0, count)
    axes.set_ylim(count, 0)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    middles = np.arange(count) + 0.5
    axes.set_xticks(middles, corner.labels, rotation=90, fontsize=7, color=DARK)
    axes.set_yticks(middles, corner.labels, fontsize=7, color=DARK)
    axes.tick_params(length=0, pad=3)


def _length(label: str) -> int:
    """Number of characters of a label when drawn."""
    return len(re.sub(r"[${}_^]", "", re.sub(r"\\[A-Za-z]+", "x", label)))


def _grid_figure(result: FitResult, corner: Corner) -> Picture:
    """Draw one grid of small cells, with the values next to it."""
    count = len(corner.labels)
    cell = float(np.clip(5.4 / count, 0.34, 0.6))
    left = 0.3 + 0.055 * max(map(_length, corner.labels))
    width = left + cell * count + 0.3 + 0.065 * max(map(len, corner.values))
    width = max(width, WIDTH)
    picture, (_, top) = frame(result, 1.4 + left + cell * count, width)
    height = picture.get_figheight()
    _grid_key(picture, corner, top)
    top -= 0.52 / height
    axes = picture.add_axes(
        (left / width, top - cell * count / height, cell * count / width, cell * count / height)
    )
    draw_corner(axes, corner)
    for i, value in enumerate(corner.values):
        color = DARK if corner.identified[i] else RED
        axes.text(count + 0.25, i + 0.5, value, va="center", fontsize=7, color=color, clip_on=False)
    return picture


def _grid_key(picture: Picture, corner: Corner, top: float) -> None:
    lines = [
        "dark, light: 50 %, 95 % regions over 99.8 % of the draws of each parameter;"
        " red: least squares",
        f"upper triangle: correlations of {_WORTH_SAYING:g} or more; right: posterior"
        " median ± half the central 68.27 %",
        corner.note,
    ]
    picture.text(0.02, top, "\n".join(filter(None, lines)), va="top", fontsize=7.5, color=DARK)


def _corner_labels(axes, corner: Corner, i, j, size: float, label: float) -> None:
    """Numbers in one size, names in another."""
    last = i == len(corner.labels) - 1
    tidy(axes, corner.labels[j] if last else "", corner.labels[i] if j == 0 != i else "", size)
    for axis in (axes.xaxis, axes.yaxis):
        axis.label.set_fontsize(label)
    axes.locator_params(axis="x", nbins=3)
    # In many narrow panels, horizontal numbers would overlap.
    angle = 0 if len(corner.labels) < 4 else 30
    axes.tick_params(axis="x", labelbottom=last, labelrotation=angle, labelsize=size - 1.5)
    if i == j:
        axes.set_yticks([])
        if not last:
            axes.set_title(corner.labels[i], fontsize=label, color=DARK, pad=2)
    else:
        axes.locator_params(axis="y", nbins=3)
        axes.tick_params(axis="y", labelleft=j == 0, labelsize=size - 1.5)
    for axis in (axes.xaxis, axes.yaxis):
        axis.get_offset_text().set_fontsize(size - 2)


def _corner_key(picture: Picture, corner: Corner, top: float) -> None:
    """Explain the colours, in the empty upper corner."""
    lines = ["line, shade: posterior median, 95 %", "dark, light: 50 %, 95 % regions"]
    lines.append("red: least squares")
    vague = [
        name for name, known in zip(corner.labels, corner.identified, strict=True) if not known
    ]
    if vague:
        lines.append("not identified: " + ", ".join(vague))
    lines += [corner.note] if corner.note else []
    picture.text(0.98, top, "\n".join(lines), ha="right", va="top", fontsize=7.5, color=DARK)
