"""Arrays -> axes: corner, trace and profile of the parameters."""

import numpy as np

from tirefit.fitting.result import FitResult
from tirefit.report.canvas import (
    BLUE,
    COLORS,
    DARK,
    GREY,
    ORANGE,
    RED,
    Picture,
    frame,
    tidy,
)
from tirefit.report.uncertainty import (
    Corner,
    ProfilePanel,
    Trace,
    corner_data,
    profile_data,
    trace_data,
)

__all__ = [
    "corner_figure",
    "draw_joint",
    "draw_marginal",
    "draw_profile",
    "draw_trace",
    "profile_figure",
    "trace_figure",
]


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
        _centers(corner.edges[j]), _centers(corner.edges[i]), joint, levels=levels,
        colors=["#9ecae8", BLUE][-(len(levels) - 1) :],
    )  # fmt: skip
    axes.plot(
        corner.estimate[j], corner.estimate[i], marker="+", color=RED, markersize=7
    )
    axes.set_xlim(corner.edges[j][0], corner.edges[j][-1])
    axes.set_ylim(corner.edges[i][0], corner.edges[i][-1])


def corner_figure(result: FitResult) -> Picture:
    """Every parameter, and every pair of them."""
    # Not by the corner library (2.3 was tried): its turned numbers run into labels and
    # footnote, its lines of the estimate cover the regions, a column that is constant
    # is refused, and it imports pyplot, with 2 s and figures in global lists.
    corner = corner_data(result)
    count = len(corner.labels)
    picture, (bottom, top) = frame(result, min(2.2 + 1.15 * count, 10.5))
    height = picture.get_figheight()
    _corner_key(picture, corner, top)
    top -= (0.5 if count == 1 else 0.15) / height
    grid = picture.add_gridspec(
        count, count, left=0.11, right=0.98, bottom=bottom + 0.5 / height, top=top,
        wspace=0.1, hspace=0.1,
    )  # fmt: skip
    size = float(np.clip(10 - 0.5 * count, 5.5, 9))
    for i in range(count):
        for j in range(i + 1):
            axes = picture.add_subplot(grid[i, j])
            if i == j:
                draw_marginal(axes, corner, i)
            else:
                draw_joint(axes, corner, i, j)
            _corner_labels(axes, corner, i, j, size)
    # One line for all labels, beside the widest of the numbers.
    picture.align_labels()
    return picture


def _corner_labels(axes, corner: Corner, i: int, j: int, size: float) -> None:
    last = i == len(corner.labels) - 1
    tidy(
        axes, corner.labels[j] if last else "", corner.labels[i] if j == 0 != i else "",
        size,
    )  # fmt: skip
    axes.locator_params(axis="x", nbins=3)
    # Many narrow panels: level numbers would run into each other.
    angle = 0 if len(corner.labels) < 4 else 30
    axes.tick_params(
        axis="x", labelbottom=last, labelrotation=angle, labelsize=size - 1.5
    )
    if i == j:
        axes.set_yticks([])
        if not last:
            axes.set_title(corner.labels[i], fontsize=size, color=DARK, pad=2)
    else:
        axes.locator_params(axis="y", nbins=3)
        axes.tick_params(axis="y", labelleft=j == 0, labelsize=size - 1.5)
    for axis in (axes.xaxis, axes.yaxis):
        axis.get_offset_text().set_fontsize(size - 2)


def _corner_key(picture: Picture, corner: Corner, top: float) -> None:
    """What the colours mean, in the empty upper corner."""
    lines = ["line, shade: posterior median, 95 %", "dark, light: 50 %, 95 % regions"]
    lines.append("red: least squares")
    vague = [
        name
        for name, known in zip(corner.labels, corner.identified, strict=True)
        if not known
    ]
    if vague:
        lines.append("not identified: " + ", ".join(vague))
    lines += [corner.note] if corner.note else []
    picture.text(
        0.98, top, "\n".join(lines), ha="right", va="top", fontsize=7.5, color=DARK
    )


def draw_trace(left, right, trace: Trace, i: int) -> None:
    """Draws of one parameter in order (left) and their densities (right)."""
    middle = (trace.edges[i][1:] + trace.edges[i][:-1]) / 2
    for k in range(len(trace.draws)):
        color = COLORS[k % len(COLORS)]
        left.plot(trace.position, trace.draws[k, :, i], color=color, lw=0.4, alpha=0.6)
        right.plot(trace.density[k, i], middle, color=color, lw=1.0)
    tidy(left, "", trace.labels[i])
    tidy(right)
    left.set_xlim(0, 1)
    for axes in (left, right):
        axes.set_ylim(trace.edges[i][0], trace.edges[i][-1])
    right.set_xlim(0, 1.1)
    right.set_xticks([])
    right.tick_params(labelleft=False)
    if trace.rhat is not None and trace.ess is not None:
        right.set_title(
            f"R-hat {trace.rhat[i]:.3f}, ESS {trace.ess[i]:.0f}",
            fontsize=7, color=DARK, pad=2,
        )  # fmt: skip


def trace_figure(result: FitResult) -> Picture:
    """One row per parameter: the ensembles must look alike from end to end."""
    trace = trace_data(result)
    count = len(trace.labels)
    picture, (bottom, top) = frame(result, 1.1 + 1.1 * count)
    height = picture.get_figheight()
    bottom += 0.35 / height
    step = (top - bottom) / count
    for i in range(count):
        low, tall = top - (i + 1) * step + 0.12 / height, step - 0.28 / height
        left = picture.add_axes((0.13, low, 0.62, tall))
        right = picture.add_axes((0.77, low, 0.21, tall))
        draw_trace(left, right, trace, i)
        last = i == count - 1
        left.tick_params(labelbottom=last)
        if last:
            left.set_xlabel("share of the kept chain", fontsize=8.5, color=DARK)
            right.set_xlabel("density by ensemble", fontsize=8.5, color=DARK)
    return picture


def draw_profile(axes, panel: ProfilePanel) -> None:
    """Profile deviance, its 95 % level, the covariance's parabola, the posterior."""
    if panel.density is not None:
        axes.stairs(
            panel.density * panel.level, panel.edges, fill=True, color=GREY, alpha=0.3,
            lw=0, label="posterior density",
        )  # fmt: skip
    axes.plot(
        panel.value, panel.parabola, color=ORANGE, lw=1.2, ls="--", label="covariance"
    )
    axes.plot(panel.value, panel.deviance, color=BLUE, lw=1.6, label="profile")
    axes.axhline(panel.level, color=DARK, lw=0.7, ls=":")
    for end in panel.interval:
        if end is not None:
            axes.plot([end, end], [0, panel.level], color=BLUE, lw=0.7)
    axes.plot(panel.best, 0, marker="o", color=RED, markersize=4, clip_on=False)
    if panel.logarithmic:
        axes.set_xscale("log")
    axes.set_ylim(0, 2.2 * panel.level)
    label = panel.label if panel.identified else f"{panel.label}  (not identified)"
    tidy(axes, label, r"$-2\,\Delta\log L$")


def profile_figure(result: FitResult) -> Picture:
    """One panel per parameter; where the three routes agree, any of them will do."""
    panels = profile_data(result)
    columns = len(panels) if len(panels) < 4 else 2 if len(panels) == 4 else 3
    rows = -(-len(panels) // columns)
    picture, (bottom, top) = frame(result, 1.0 + 2.2 * rows)
    height = picture.get_figheight()
    top -= 0.22 / height
    step, wide = (top - bottom) / rows, 0.95 / columns
    for i, panel in enumerate(panels):
        row, column = divmod(i, columns)
        low = top - (row + 1) * step + 0.42 / height
        axes = picture.add_axes(
            (0.02 + column * wide + 0.07, low, wide - 0.09, step - 0.5 / height)
        )
        draw_profile(axes, panel)
        axes.locator_params(axis="y", nbins=5)
        if column:
            axes.set_ylabel("")
        if not panel.logarithmic:
            axes.locator_params(axis="x", nbins=4)
    handles, labels = picture.axes[0].get_legend_handles_labels()
    picture.legend(
        handles, labels, loc="upper right", ncols=3, fontsize=7.5, frameon=False,
        bbox_to_anchor=(0.99, top + 0.3 / height),
    )  # fmt: skip
    return picture
