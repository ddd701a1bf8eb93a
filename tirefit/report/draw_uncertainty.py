"""Arrays -> axes: posterior, trace and profile of the parameters."""

import re
from typing import Any

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.ticker import MaxNLocator

from tirefit.report.canvas import BLUE, COLORS, DARK, GREY, ORANGE, RED, tidy
from tirefit.report.uncertainty import Corner, ProfilePanel, Trace

MOST_SCALED = 8  # largest number of parameters whose cells are wide and have numbers
_SHORT = 15  # number of characters of a name that fits below a cell
_WORTH_SAYING = 0.3  # smallest correlation that is printed

CORNER_NOTE = f"""\
dark, light: 50 %, 95 % regions over 99.8 % of the draws of each parameter; red: least squares
upper triangle: correlations of {_WORTH_SAYING:g} or more; right: posterior median ± half the\
 central 68.27 %"""


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


def draw_corner(axes: Any, corner: Corner) -> None:
    """Draw all pairs as cells of one axes, the densities on the diagonal, with the larger
    correlations in the upper triangle and the values at the right."""
    count = len(corner.labels)
    colors = ListedColormap(["white", "#9ecae8", BLUE])
    axes.imshow(
        _classes(corner), colors, extent=(0, count, count, 0), aspect="auto", vmin=0, vmax=2
    )
    text: dict[str, Any] = {"va": "center", "fontsize": 7}
    for i, (edges, value) in enumerate(zip(corner.edges, corner.values, strict=True)):
        share = np.linspace(i, i + 1, corner.density.shape[1])
        axes.fill_between(
            share, i + 1, i + 1 - 0.9 * corner.density[i], color=BLUE, alpha=0.45, lw=0
        )
        at = i + (corner.estimate[i] - edges[0]) / (edges[-1] - edges[0])
        if i < at < i + 1:
            axes.plot([at, at], [i + 0.1, i + 1], color=RED, lw=0.9)
        axes.plot([0, i + 1, i + 1], [i, i, count], color=GREY, lw=0.3)
        for j in range(i):
            value_of = corner.correlation[i, j]
            if abs(value_of) >= _WORTH_SAYING:
                shown = f"{value_of:+.2f}".replace("-", "−")
                axes.text(
                    i + 0.5, j + 0.5, shown, ha="center", color=DARK, **(text | {"fontsize": 6})
                )
        color = DARK if corner.identified[i] else RED
        axes.text(count + 0.1, i + 0.5, value, color=color, clip_on=False, **text)
    axes.set_xlim(0, count)
    axes.set_ylim(count, 0)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    _label_corner(axes, corner)


def _label_corner(axes: Any, corner: Corner) -> None:
    """Names of the rows and columns; of a few parameters also numbers along their cells."""
    count = len(corner.labels)
    scaled, middles = count <= MOST_SCALED, np.arange(count) + 0.5
    style: dict[str, Any] = {"minor": scaled, "fontsize": 8 if scaled else 7, "color": DARK}
    for axis in (axes.xaxis, axes.yaxis):
        axis.remove_overlapping_locs = False  # a number may be in the middle of a cell
    short = count < 4 and max(map(drawn_length, corner.labels)) < _SHORT
    axes.set_xticks(middles, corner.labels, rotation=0 if short else 90, **style)
    axes.set_yticks(middles, corner.labels, **style)
    axes.tick_params(which="both", length=0, pad=3)
    if not scaled:
        return
    places, numbers = [], []
    for i, edges in enumerate(corner.edges):
        ticks = MaxNLocator(3, prune="both").tick_values(edges[0], edges[-1])
        for tick in ticks[(ticks > edges[0]) & (ticks < edges[-1])]:
            places.append((tick - edges[0]) / (edges[-1] - edges[0]))
            numbers.append((i, f"{tick:.6g}"))
    starts, texts = zip(*numbers, strict=True) if numbers else ((), ())
    axes.set_xticks(np.add(starts, places), texts, rotation=90)
    axes.set_yticks(np.add(starts, 1.0) - places, texts)
    axes.tick_params(which="major", length=2, labelsize=6, color=GREY, labelcolor=DARK)
    longest = 4.5 * max(map(len, texts), default=0)  # points
    axes.tick_params(which="minor", pad=8 + longest)


def drawn_length(label: str) -> int:
    """Number of characters of a label when drawn."""
    return len(re.sub(r"[${}_^]", "", re.sub(r"\\[A-Za-z]+", "x", label)))


def draw_trace(figure: Any, trace: Trace) -> None:
    """Draws of each parameter in order (left) and their densities (right): converged
    ensembles look the same everywhere."""
    cells = figure.subplots(len(trace.labels), 2, squeeze=False, width_ratios=(3, 1))
    for i, (left, right) in enumerate(cells):
        middle = (trace.edges[i][1:] + trace.edges[i][:-1]) / 2
        for k in range(len(trace.draws)):
            color = COLORS[k % len(COLORS)]
            left.plot(trace.position, trace.draws[k, :, i], color=color, lw=0.4, alpha=0.6)
            right.plot(trace.density[k, i], middle, color=color, lw=1.0)
        last = i == len(cells) - 1
        tidy(left, "share of the kept chain" * last)
        tidy(right, "density by ensemble" * last)
        left.set_title(trace.labels[i], fontsize=8.5, loc="left", color=DARK, pad=2)
        left.set_xlim(0, 1)
        left.tick_params(labelbottom=last)
        for axes in (left, right):
            axes.set_ylim(trace.edges[i][0], trace.edges[i][-1])
        right.set_xlim(0, 1.1)
        right.set_xticks([])
        right.tick_params(labelleft=False)
        if trace.rhat is not None and trace.ess is not None:
            text = f"R-hat {trace.rhat[i]:.3f}, ESS {trace.ess[i]:.0f}"
            right.set_title(text, fontsize=7, color=DARK, pad=2)


def draw_profile(axes: Any, panel: ProfilePanel) -> None:
    """Profile deviance, its 95 % level, the covariance's parabola, the posterior."""
    if panel.density is not None:
        label = "posterior density"
        density = panel.density * panel.level
        axes.stairs(density, panel.edges, fill=True, color=GREY, alpha=0.3, lw=0, label=label)
    axes.plot(panel.value, panel.parabola, color=ORANGE, lw=1.2, ls="--", label="covariance")
    axes.plot(panel.value, panel.deviance, color=BLUE, lw=1.6, label="profile")
    axes.axhline(panel.level, color=DARK, lw=0.7, ls=":")
    for end in panel.interval:
        if end is not None:
            axes.plot([end, end], [0, panel.level], color=BLUE, lw=0.7)
    axes.plot(panel.best, 0, marker="o", color=RED, markersize=4, clip_on=False)
    if panel.logarithmic:
        axes.set_xscale("log")
    else:
        axes.locator_params(axis="x", nbins=4)
    axes.locator_params(axis="y", nbins=5)
    axes.set_ylim(0, 2.2 * panel.level)
    label = panel.label if panel.identified else f"{panel.label}\n(not identified)"
    tidy(axes, label, r"$-2\,\Delta\log L$")


def draw_profiles(figure: Any, panels: tuple[ProfilePanel, ...]) -> None:
    """One panel per parameter in two columns."""
    rows = -(-len(panels) // 2)
    cells = figure.subplots(rows, min(len(panels), 2), squeeze=False).ravel()
    for i, (axes, panel) in enumerate(zip(cells, panels, strict=False)):
        draw_profile(axes, panel)
        if i % 2:
            axes.set_ylabel("")
    for axes in cells[len(panels) :]:
        axes.remove()
    handles, labels = cells[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=3, fontsize=8, frameon=False)
