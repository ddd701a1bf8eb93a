"""Draw the fitted curve and the residuals from arrays."""

from typing import Any

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from tirefit.data.run_names import clipped
from tirefit.report.canvas import BLUE, COLORS, DARK, GREY, ORANGE, dots, drawn, tidy
from tirefit.report.curves import FitCurve
from tirefit.report.numbers import format_number
from tirefit.report.residuals import Residuals, Scatter

_LIGHT, _DENSE = 0.14, 0.40


def draw_fit(axes: Any, curve: FitCurve) -> list[Line2D | Patch]:
    """Draw points, fitted curves with both bands, and friction limits on given axes.

    Returns:
        the entries of its legend.
    """
    single = len(curve.curves) == 1
    count = sum(len(group.slip) for group in curve.groups)
    size = float(np.clip(60 / np.sqrt(max(count, 1)), 1.2, 4.5))
    for i, group in enumerate(curve.groups):
        some = drawn(group.force, count)
        dots(axes, group.slip[some], group.force[some], size, _color(i), 0.45)
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
    return _handles(curve, limit)


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


def _handles(curve: FitCurve, limit: str) -> list[Line2D | Patch]:
    """The legend of groups, line, bands and friction limit."""
    handles: list[Line2D | Patch] = [
        Line2D([], [], ls="none", marker="o", ms=4, color=_color(i), label=clipped(group.label, 40))
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
    return handles


def draw_scatter(axes, panel: Scatter, force: str = "") -> None:
    """Residuals against one input, and their means over bins with 95 % intervals."""
    size = float(np.clip(40 / np.sqrt(max(len(panel.x), 1)), 1.0, 3.5))
    some = drawn(panel.residual)
    axes.axhline(0, color=DARK, lw=0.7, zorder=1)
    dots(axes, panel.x[some], panel.residual[some], size, BLUE, 0.35)
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
    dots(axes, residuals.normal[some], residuals.ordered[some], 2.2, BLUE)
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
