"""Arrays -> axes: trace and profile of the parameters."""

from collections.abc import Sequence

from tirefit.fitting.result import FitResult
from tirefit.report.canvas import BLUE, COLORS, DARK, GREY, ORANGE, RED, Picture, frame, tidy
from tirefit.report.uncertainty import ProfilePanel, Trace, profile_data, trace_data


def draw_trace(left, right, trace: Trace, i: int) -> None:
    """Draws of one parameter in order (left) and their densities (right)."""
    middle = (trace.edges[i][1:] + trace.edges[i][:-1]) / 2
    for k in range(len(trace.draws)):
        color = COLORS[k % len(COLORS)]
        left.plot(trace.position, trace.draws[k, :, i], color=color, lw=0.4, alpha=0.6)
        right.plot(trace.density[k, i], middle, color=color, lw=1.0)
    tidy(left)
    tidy(right)
    left.set_title(trace.labels[i], fontsize=8.5, loc="left", color=DARK, pad=2)
    left.set_xlim(0, 1)
    for axes in (left, right):
        axes.set_ylim(trace.edges[i][0], trace.edges[i][-1])
    right.set_xlim(0, 1.1)
    right.set_xticks([])
    right.tick_params(labelleft=False)
    if trace.rhat is not None and trace.ess is not None:
        right.set_title(
            f"R-hat {trace.rhat[i]:.3f}, ESS {trace.ess[i]:.0f}", fontsize=7, color=DARK, pad=2
        )


def trace_figure(result: FitResult, parameters: Sequence[str] | None = None) -> Picture:
    """Draw one row per parameter; converged ensembles look the same everywhere."""
    trace = trace_data(result, parameters)
    count = len(trace.labels)
    picture, (bottom, top) = frame(result, 1.2 + 1.1 * count)
    height = picture.get_figheight()
    if trace.note:
        picture.text(0.98, top, trace.note, ha="right", va="top", fontsize=7.5, color=DARK)
    top -= 0.15 / height
    bottom += 0.35 / height
    step = (top - bottom) / count
    for i in range(count):
        low, tall = top - (i + 1) * step + 0.12 / height, step - 0.31 / height
        left = picture.add_axes((0.1, low, 0.65, tall))
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
            panel.density * panel.level,
            panel.edges,
            fill=True,
            color=GREY,
            alpha=0.3,
            lw=0,
            label="posterior density",
        )
    axes.plot(panel.value, panel.parabola, color=ORANGE, lw=1.2, ls="--", label="covariance")
    axes.plot(panel.value, panel.deviance, color=BLUE, lw=1.6, label="profile")
    axes.axhline(panel.level, color=DARK, lw=0.7, ls=":")
    for end in panel.interval:
        if end is not None:
            axes.plot([end, end], [0, panel.level], color=BLUE, lw=0.7)
    axes.plot(panel.best, 0, marker="o", color=RED, markersize=4, clip_on=False)
    if panel.logarithmic:
        axes.set_xscale("log")
    axes.set_ylim(0, 2.2 * panel.level)
    label = panel.label if panel.identified else f"{panel.label}\n(not identified)"
    tidy(axes, label, r"$-2\,\Delta\log L$")


def profile_figure(result: FitResult) -> Picture:
    """One panel per parameter: profile, covariance and posterior."""
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
        handles,
        labels,
        loc="upper right",
        ncols=3,
        fontsize=7.5,
        frameon=False,
        bbox_to_anchor=(0.99, top + 0.3 / height),
    )
    if len(panels) < len(result.profiles):
        text = f"{len(panels)} of {len(result.profiles)} parameters"
        picture.text(0.02, top + 0.08 / height, text, fontsize=7.5, color=DARK, va="bottom")
    return picture
