"""Draw the fitted curve and the residuals from arrays, and write all figures."""

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from textwrap import wrap

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from tirefit.fitting.result import FitResult
from tirefit.report.by_name import has_runs, runs_figure
from tirefit.report.canvas import (
    BLUE,
    COLORS,
    DARK,
    GREY,
    ORANGE,
    Picture,
    drawn,
    frame,
    save_picture,
    tidy,
)
from tirefit.report.curves import FitCurve, fit_curve
from tirefit.report.draw_corner import corner_figure
from tirefit.report.draw_uncertainty import profile_figure, trace_figure
from tirefit.report.numbers import format_number
from tirefit.report.residuals import Residuals, Scatter, residual_panels
from tirefit.report.uncertainty import has_trace

FIGURE_FILES = tuple(
    f"{name}{suffix}"
    for name in ("fit", "residuals", "runs", "profile", "corner", "trace")
    for suffix in (".png", ".svg")
)
"""Every file that :func:`save_figures` may write."""

_LIGHT, _DENSE = 0.14, 0.40


def draw_fit(axes, curve: FitCurve, beside: bool = True) -> None:
    """Draw points, fitted curves with both bands, and friction limits on given axes.

    ``beside``: whether the legend of several groups may be next to the axes.
    """
    single = len(curve.curves) == 1
    count = sum(len(group.slip) for group in curve.groups)
    size = float(np.clip(60 / np.sqrt(max(count, 1)), 1.2, 4.5))
    for i, group in enumerate(curve.groups):
        some = drawn(group.force, count)
        axes.plot(
            group.slip[some],
            group.force[some],
            linestyle="none",
            marker="o",
            markersize=size,
            markeredgewidth=0,
            alpha=0.45,
            color=_color(i),
            rasterized=True,
            zorder=2,
        )
        if group.low is not None:
            axes.vlines(group.slip, group.low, group.high, _color(i), lw=0.8, alpha=0.6)
    for i, one in enumerate(curve.curves):
        color = DARK if single else _color(i)
        axes.fill_between(
            one.slip, one.noise_low, one.noise_high, color=color, alpha=_LIGHT, lw=0, zorder=1
        )
        axes.fill_between(one.slip, one.low, one.high, color=color, alpha=_DENSE, lw=0, zorder=3)
        axes.plot(one.slip, one.force, color=color, lw=1.4, zorder=4)
    axes.axhline(0, color=GREY, lw=0.5, zorder=0)
    limit = _draw_limits(axes, curve, single)
    tidy(axes, curve.x_label, curve.y_label, 9.5)
    axes.set_xlim(curve.curves[0].slip[0], curve.curves[0].slip[-1])
    _legend(axes, curve, limit, beside)


def _color(i: int) -> str:
    return COLORS[i % len(COLORS)]


def _draw_limits(axes, curve: FitCurve, single: bool) -> str:
    """Draw the friction limits near the measurements; return their legend text."""
    lowest = min(float(np.min(group.force, initial=0.0)) for group in curve.groups)
    highest = max(float(np.max(group.force, initial=0.0)) for group in curve.groups)
    shown = False
    for i, one in enumerate(curve.curves):
        for sign, reached in ((1, highest), (-1, -lowest)):
            # A limit far above all measurements would compress them.
            if one.limit is not None and reached > 0.6 * one.limit:
                shown = True
                axes.axhline(
                    sign * one.limit,
                    color=GREY if single else _color(i),
                    lw=0.9,
                    ls=(0, (5, 3)),
                    zorder=1,
                )
    limits = [one.limit for one in curve.curves if one.limit is not None]
    if shown or not limits:
        return curve.limit_label
    return f"{curve.limit_label} = {format_number(min(limits))}, out of view"


def _legend(axes, curve: FitCurve, limit: str, beside: bool) -> None:
    """The legend of groups, line and bands, next to the axes or in an empty corner."""
    handles: list[Line2D | Patch] = [
        Line2D([], [], ls="none", marker="o", ms=4, color=_color(i), label=group.label)
        for i, group in enumerate(curve.groups)
    ]
    handles += [Line2D([], [], color=DARK, lw=1.4, label="fit")]
    fitted = any(np.any(c.high > c.low) for c in curve.curves)
    noisy = any(np.any(c.noise_high > c.noise_low) for c in curve.curves)
    bands = ((fitted, _DENSE, "95 % band of the fit"), (noisy, _LIGHT, "95 % of measurements"))
    handles += [Patch(color=DARK, alpha=a, lw=0, label=t) for on, a, t in bands if on]
    if limit:
        drawn = limit == curve.limit_label and curve.curves[0].limit is not None
        style = (0, (5, 3)) if drawn else "none"
        handles.append(Line2D([], [], color=GREY, lw=0.9, ls=style, label=limit))
    several = len(curve.groups) > 1
    if several:
        for handle in handles[: len(curve.groups)]:
            text = wrap(str(handle.get_label()), 24, max_lines=3, placeholder=" …")
            handle.set_label("\n".join(text))
        if limit:
            handles[-1].set_label(limit.replace(": ", ":\n").replace(", ", ",\n"))
    if several and beside:
        axes.legend(
            handles=handles,
            fontsize=7.5,
            loc="upper left",
            bbox_to_anchor=(1.0, 1.0),
            frameon=False,
            title=_wrapped(curve.note) or None,
            title_fontsize=7.5,
        )
        return
    slip = curve.curves[0].slip
    place = "lower right" if slip[-1] > -slip[0] / 10 else "upper left"
    if curve.channel == "mz" and slip[0] < 0:
        place = "upper right"
    size = 6 if several else 8
    axes.legend(
        handles=handles,
        fontsize=size,
        loc=place,
        frameon=True,
        framealpha=0.85,
        edgecolor="none",
        title=_wrapped(curve.note) or None,
        title_fontsize=size,
        ncols=2 if len(handles) > 6 else 1,
    )


def _wrapped(note: str) -> str:
    return "\n".join(part for line in note.splitlines() for part in wrap(line, 26))


def fit_figure(result: FitResult) -> Picture:
    """One panel per fitted force."""
    count = len(result.forces)
    picture, (bottom, top) = frame(result, 0.9 + 3.5 * count)
    height = picture.get_figheight()
    step = (top - bottom) / count
    for i, channel in enumerate(result.forces):
        low = top - (i + 1) * step + 0.45 / height
        curve = fit_curve(result, channel)
        wide = 0.87 if len(curve.groups) == 1 else 0.635
        axes = picture.add_axes((0.105, low, wide, step - 0.5 / height))
        draw_fit(axes, curve)
    return picture


def draw_scatter(axes, panel: Scatter, force: str = "") -> None:
    """Residuals against one input, and their means over bins with 95 % intervals."""
    size = float(np.clip(40 / np.sqrt(max(len(panel.x), 1)), 1.0, 3.5))
    some = drawn(panel.residual)
    axes.axhline(0, color=DARK, lw=0.7, zorder=1)
    axes.plot(
        panel.x[some],
        panel.residual[some],
        linestyle="none",
        marker="o",
        markersize=size,
        markeredgewidth=0,
        alpha=0.35,
        color=BLUE,
        rasterized=True,
        zorder=2,
    )
    axes.errorbar(
        panel.center, panel.mean, panel.half, fmt="o", color=ORANGE, markersize=4,
        markeredgecolor=DARK, markeredgewidth=0.5, elinewidth=1.6, ecolor=ORANGE,
        zorder=3,
    )  # fmt: skip
    tidy(axes, panel.label, f"{force} residual / std".strip())
    axes.set_ylim(*_symmetric(panel.residual))
    if panel.ticks:
        texts = list(panel.ticks)
        angle = 0 if sum(map(len, texts)) < 40 else 60
        every = 1 if len(texts) <= 16 else 2
        axes.set_xticks(
            range(0, len(texts), every),
            texts[::every],
            rotation=angle,
            ha="center" if angle == 0 else "right",
            rotation_mode="anchor",
            fontsize=7.5 if angle == 0 else 6.5,
        )


def _symmetric(values) -> tuple[float, float]:
    reach = max(3.5, 1.05 * float(np.max(np.abs(values), initial=0.0)))
    return -reach, reach


def draw_histogram(axes, residuals: Residuals) -> None:
    """Distribution of the residuals, with the normal one."""
    axes.stairs(residuals.density, residuals.edges, fill=True, color=BLUE, alpha=0.35, lw=0)
    x = np.linspace(residuals.edges[0], residuals.edges[-1], 200)
    axes.plot(x, np.exp(-(x**2) / 2) / np.sqrt(2 * np.pi), color=DARK, lw=1.1)
    tidy(axes, "residual / std", "density (line: normal)")


def draw_quantiles(axes, residuals: Residuals) -> None:
    """Sorted residuals against normal quantiles: on the line if they are normal."""
    reach = max(3.0, float(np.max(np.abs(residuals.normal))))
    axes.plot([-reach, reach], [-reach, reach], color=DARK, lw=0.8)
    some = drawn(residuals.ordered)
    axes.plot(
        residuals.normal[some],
        residuals.ordered[some],
        linestyle="none",
        marker="o",
        markersize=2.2,
        markeredgewidth=0,
        color=BLUE,
        rasterized=True,
    )
    tidy(axes, "quantile of a normal", "residual / std")


def draw_autocorrelation(axes, residuals: Residuals) -> None:
    """Autocorrelation over lags in rows, with the 95 % range of independent rows."""
    assert residuals.lags is not None  # the caller checks it
    assert residuals.correlation is not None
    limit = residuals.limit
    axes.axhspan(-limit, limit, color=GREY, alpha=0.25, lw=0)
    axes.axhline(0, color=DARK, lw=0.7)
    axes.vlines(residuals.lags[1:], 0, residuals.correlation[1:], color=BLUE, lw=2)
    lowest = min(-3 * limit, float(residuals.correlation.min()) * 1.1)
    highest = float(np.max(residuals.correlation[1:], initial=0.0))
    axes.set_ylim(lowest, max(3 * limit, 1.1 * highest))
    tidy(axes, "lag [rows in time order]", "autocorrelation")


def residual_figure(result: FitResult) -> Picture:
    """Residuals of the first force over each input, their distribution and sequence.

    Further forces of a joint fit are shown against their slip.
    """
    data = residual_panels(result)
    first, *others = result.forces
    name = first if others else ""
    scatter = partial(draw_scatter, force=name)
    jobs: list[tuple[Callable, Scatter | Residuals]]
    jobs = [(scatter, panel) for panel in data.scatters]
    for force in others:
        further = residual_panels(result, force).scatters[0]
        jobs.insert(1, (partial(draw_scatter, force=force), further))
    jobs += [(draw_histogram, data), (draw_quantiles, data)]
    if data.lags is not None:
        jobs.append((draw_autocorrelation, data))
    wide_first = len(jobs) % 2 == 1
    rows = (len(jobs) + 1) // 2
    picture, (bottom, top) = frame(result, 0.75 + 2.15 * rows)
    height = picture.get_figheight()
    step = (top - bottom) / rows
    cells = [(i // 2, i % 2, False) for i in range(len(jobs))]
    if wide_first:
        rest = [((i + 1) // 2, (i + 1) % 2, False) for i in range(1, len(jobs))]
        cells = [(0, 0, True), *rest]
    for (draw, panel), (row, column, wide) in zip(jobs, cells, strict=True):
        low = top - (row + 1) * step + 0.45 / height
        box = (0.09 + 0.5 * column, low, 0.89 if wide else 0.39, step - 0.57 / height)
        draw(picture.add_axes(box), panel)
    return picture


def save_figures(result: FitResult, directory: str | os.PathLike, svg: bool = False) -> list[Path]:
    """Write fit.png and residuals.png; runs.png if runs have separate parameters;
    profile.png, corner.png, trace.png if available.

    Args:
        result: a fit with its problem.
        directory: made if it is not there.
        svg: write every figure as SVG too.

    Returns:
        the files written.
    """
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    figures = {"fit": fit_figure, "residuals": residual_figure}
    if has_runs(result):
        figures["runs"] = runs_figure
    if result.profiles:
        figures["profile"] = profile_figure
    if result.chains is not None:
        figures["corner"] = corner_figure
        if has_trace(result):
            figures["trace"] = trace_figure
    written = []
    for name, figure in figures.items():
        picture = figure(result)
        for suffix in (".png", ".svg") if svg else (".png",):
            written.append(save_picture(picture, directory / f"{name}{suffix}"))
    # Remove figures of an earlier fit, which would be mistaken for new ones.
    for name in FIGURE_FILES:
        if directory / name not in written:
            (directory / name).unlink(missing_ok=True)
    return written
