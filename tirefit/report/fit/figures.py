"""The figures of a fit: for its folder, its page, notebooks and given axes."""

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from tirefit.data.run_names import clipped
from tirefit.fitting.result import Estimate, FitResult
from tirefit.params import check_names
from tirefit.report import canvas
from tirefit.report.fit.curves import FitCurve, fit_curve
from tirefit.report.fit.posterior import corner_panels, has_trace, profile_panels, trace_panels
from tirefit.report.fit.report import verdict_line
from tirefit.report.fit.residuals import residual_panels
from tirefit.report.fit.tables import fit_files, short_run
from tirefit.report.fit.values import Points, points_panel
from tirefit.report.numbers import bracketed
from tirefit.results import UsageError

_LIGHT, _DENSE = 0.14, 0.40


def draw_fit(axes: Any, curve: FitCurve) -> list[Line2D | Patch]:
    """Draw points and fitted curves with both bands on given axes.

    Returns:
        the entries of its legend.
    """
    colors = canvas.colors_of(len(curve.groups))
    single = len(curve.curves) == 1
    count = sum(len(group.slip) for group in curve.groups)
    size = float(np.clip(60 / np.sqrt(max(count, 1)), 1.2, 4.5))
    for group, color in zip(curve.groups, colors, strict=True):
        some = canvas.drawn(group.force, count)
        canvas.dots(axes, group.slip[some], group.force[some], size, color, 0.45)
        if group.low is not None:
            axes.vlines(group.slip, group.low, group.high, color, lw=0.8, alpha=0.6)
    for fitted, color in zip(curve.curves, [canvas.DARK] if single else colors, strict=True):
        for low, high, alpha, order in (
            (fitted.noise_low, fitted.noise_high, _LIGHT, 1),
            (fitted.low, fitted.high, _DENSE, 3),
        ):
            axes.fill_between(fitted.slip, low, high, color=color, alpha=alpha, lw=0, zorder=order)
        axes.plot(fitted.slip, fitted.force, color=color, lw=1.4, zorder=4)
    axes.axhline(0, color=canvas.GREY, lw=0.5, zorder=0)
    canvas.tidy(axes, curve.x_label, curve.y_label, 9.5)
    slips = [*(part.slip for part in curve.groups), *(part.slip for part in curve.curves)]
    x = [slip for slip in slips if len(slip)]
    axes.set_xlim(min(v.min() for v in x), max(v.max() for v in x))
    if curve.title:
        canvas.panel_title(axes, curve.title, curve.note)
    if curve.ticks:
        axes.set_xticks(*zip(*curve.ticks, strict=True))
    return _handles(curve, colors)


def _handles(curve: FitCurve, colors: Sequence[Any]) -> list[Line2D | Patch]:
    """The legend of groups, line and bands."""
    handles: list[Line2D | Patch] = [
        Line2D([], [], ls="none", marker="o", ms=4, color=color, label=clipped(group.label, 40))
        for group, color in zip(curve.groups, colors, strict=True)
    ]
    handles.append(Line2D([], [], color=canvas.DARK, lw=1.4, label="fit"))
    fitted = any(np.any(c.high > c.low) for c in curve.curves)
    noisy = any(np.any(c.noise_high > c.noise_low) for c in curve.curves)
    bands = ((fitted, _DENSE, "95 % band of the fit"), (noisy, _LIGHT, "95 % of measurements"))
    return handles + [Patch(color=canvas.DARK, alpha=a, lw=0, label=t) for on, a, t in bands if on]


def curve_panel(curve: FitCurve, alternative: str) -> canvas.Panel:
    """A force over its slip, with its legend below."""

    def draw(figure: Any) -> None:
        handles = draw_fit(figure.subplots(), curve)
        style = {"loc": "outside lower left", "ncols": 2, "fontsize": 8, "frameon": False}
        if curve.note and not curve.title:
            style |= {"title": curve.note, "title_fontsize": 8, "alignment": "left"}
        figure.legend(handles=handles, **style)

    return canvas.Panel(draw, alternative, (canvas.WIDE, 3.3 + 0.1 * len(curve.groups)))


def _curve_panels(result: FitResult) -> list[canvas.Panel]:
    """Points, curve and bands of every fitted force."""
    text = "Measured points and fitted curve of {} over slip, with bands"
    return [curve_panel(fit_curve(result, name), text.format(name)) for name in result.forces]


def run_points(result: FitResult) -> list[Points]:
    """Every parameter that has a value per run, with its 95 % intervals."""
    runs = [str(run) for run in result.data["runs"]]
    names = [short_run(result, run) for run in runs]
    nothing = Estimate(np.nan, None, "", (None, None), identified=False)
    points = []
    for name in dict.fromkeys(k.partition("[")[0] for k in result.parameters if "[" in k):
        each = [result.parameters.get(f"{name}[{run}]", nothing) for run in runs]
        unit = next(estimate.unit for estimate in each if estimate.unit)
        value = np.array([estimate.value for estimate in each], float)
        ends = np.array([estimate.ci95 for estimate in each], float)  # NaN for None
        known = np.array([estimate.identified for estimate in each])
        label, at, near = name + bracketed(unit), np.arange(len(runs)), np.zeros(len(runs), bool)
        points.append(Points(label, names, at, value, ends[:, 0], ends[:, 1], known, near))
    return points


def _run_panels(result: FitResult) -> list[canvas.Panel]:
    """Every parameter that differs by run."""
    panels = []
    for points in run_points(result):
        note = "values and 95 % intervals by run"
        note += "; grey: not identified" * bool((~points.known).any())
        panels.append(points_panel(points, f"{points.label} run by run", note))
    return panels


PANELS: Mapping[str, Callable[..., list[canvas.Panel]]] = {
    "fit": _curve_panels,
    "residuals": residual_panels,
    "runs": _run_panels,
    "profile": profile_panels,
    "corner": corner_panels,
    "trace": trace_panels,
}
"""Name of a figure -> function of a fit that gives its panels."""

FIGURE_FILES = tuple(f"{name}.png" for name in PANELS)
"""Every file that :func:`save_figures` may write."""


def missing_of(result: FitResult) -> dict[str, str]:
    """Name of a figure that the fit does not have -> what is missing."""
    sampled, missing = result.chains is not None, {}
    if not any("[" in label for label in result.labels):
        missing["runs"] = "parameter for each run (per_run = true under [parameters.NAME])"
    if not result.profiles:
        missing["profile"] = "profile likelihood"
    if not sampled:
        posterior = "posterior: tirefit.sample(fit) adds it"
        missing |= {"corner": posterior, "trace": posterior}
    elif not has_trace(result):
        missing["trace"] = "chain: its posterior is of independent points (plot('corner'))"
    return missing


def page_pictures(result: FitResult) -> dict[str, list[dict[str, Any]]]:
    """Name of a figure -> its pictures for a page, as far as the fit has the content."""
    missing = missing_of(result)
    return {n: canvas.images_of(panels(result)) for n, panels in PANELS.items() if n not in missing}


def figure_of(result: FitResult, name: str, **how: Any) -> canvas.Picture:
    """The figure of this name with title and footnote.

    Args:
        how: ``parameters`` of the corner and the trace.
    """
    count = result.statistics.n
    foot = f"tirefit {result.version} · braking positive, SI · seed {result.seed} · {count} rows"
    if count > canvas.MOST_DRAWN:
        foot += f", {canvas.MOST_DRAWN} of them drawn"
    title = f"{result.model} fitted to {fit_files(result, 68)}"
    panels, color = PANELS[name](result, **how), canvas.RED if result.outcomes else canvas.DARK
    return canvas.together(panels, title, verdict_line(result), foot, color)


def plot_fit(result: FitResult, what: str = "fit", ax: Any = None, **how: Any) -> Any:
    """The matplotlib figure of a fit that :meth:`FitResult.plot` returns.

    Args:
        result: a fit from this process.
        what: ``fit``, ``residuals``, ``runs``, ``profile``, ``corner`` or ``trace``.
        ax: axes of your own figure, on which only the first force of ``fit`` is drawn.
        how: ``parameters`` of the corner and the trace: those to draw, by label or by name
            (for all runs); by default all, or those that are correlated or disagree most.

    Raises:
        UsageError: no such figure, or the fit does not have what it shows.
    """
    check_names("figure", [what], PANELS)
    if what in (missing := missing_of(result)):
        raise UsageError(f"this fit has no {missing[what]}")
    if ax is None:
        return figure_of(result, what, **how)
    curve = fit_curve(result)
    handles = draw_fit(ax, curve)
    ax.legend(handles=handles, fontsize=7, framealpha=0.85, edgecolor="none", title=curve.note)
    return ax.figure


def save_figures(result: FitResult, directory: str | os.PathLike[str]) -> list[Path]:
    """Write fit.png and residuals.png; runs.png if runs have separate parameters;
    profile.png, corner.png, trace.png if available.

    Args:
        result: a fit with its problem.
        directory: made if it is not there.

    Returns:
        the files written.
    """
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    names = [name for name in PANELS if name not in missing_of(result)]
    written = canvas.save_pictures(((name, figure_of(result, name)) for name in names), directory)
    # Remove figures of an earlier fit, which would be mistaken for new ones.
    for name in FIGURE_FILES:
        if directory / name not in written:
            (directory / name).unlink(missing_ok=True)
    return written
