"""Draw the figures of a diagnosis from arrays: ladder, effects, location of the gap."""

import textwrap
from collections.abc import Sequence
from functools import partial

import matplotlib as mpl
import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from tirefit.diagnosis.summary.result import UNITS, Diagnosis
from tirefit.diagnosis.summary.views import Comparison, LoadCurve, ResidualMap
from tirefit.params import check_names
from tirefit.report.canvas import (
    BLUE,
    COLORS,
    DARK,
    GREY,
    ORANGE,
    PURPLE,
    Panel,
    Picture,
    alone,
    boxed,
    dots,
    frame,
    panel_title,
    tidy,
)
from tirefit.report.curves import SlipAxis, slip_axis
from tirefit.report.diagnosis_answer import answer
from tirefit.report.diagnosis_budget import WaterfallBar, channel_name, waterfall_steps
from tirefit.report.diagnosis_panels import (
    ChanceBar,
    LadderBar,
    after_label,
    chance_bars,
    covariate_label,
    draw_look,
    draw_sizes,
    ladder_bars,
    level_labels,
    load_label,
)
from tirefit.report.diagnosis_sections import subject
from tirefit.report.numbers import format_number, plain_text

_SIZE = (11.0, 9.0)
_PANEL = (5.6, 4.4)
_NARROW = 0.035
"""Share of the width below which a column of cells has no room for a number."""

_SQUARE, _FOOT = 4, 0.36
"""Number of panels in pairs; relative height of a panel below them."""
_PHONE = (4.2, 3.4)
"""Size of the pictures of ladder and sizes: letters of 10 pixels and more at a width of 400."""

_KIND = {
    "base": GREY,
    "effect": BLUE,
    "smooth": ORANGE,
    "noise": "#bbbbbb",
    "verdict": BLUE,
    "other": ORANGE,
    "unknown": PURPLE,
    "whole": GREY,
    "parameters": ORANGE,
    "unexplained": PURPLE,
}
"""Colours of the bars of all panels by their kind."""


def draw_ladder(figure, bars: Sequence[LadderBar], unit: str, on: str) -> None:
    """Draw the rms on data left out for each step, down to the noise.

    Args:
        unit: of the rms.
        on: what is left out; empty where the rms is that of the rows fitted.
    """
    axes = figure.subplots()
    longest = [max(b.rms + (b.error or 0.0), b.held_out or 0.0) for b in bars]
    reach = 1.05 * max(longest, default=1.0)
    for place, bar in zip(range(len(bars))[::-1], bars, strict=True):
        axes.barh(place, bar.rms, 0.34, color=_KIND[bar.kind])
        if bar.error is not None and bar.kind != "noise":
            axes.errorbar(bar.rms, place, xerr=bar.error, fmt="none", ecolor=DARK, capsize=2)
        if bar.held_out is not None:
            axes.plot(bar.held_out, place, "D", ms=6, mfc="white", mec=DARK)
        if bar.kind in ("smooth", "noise"):
            axes.axvline(bar.rms, color=_KIND[bar.kind], lw=1.2, ls=(0, (4, 2)), zorder=0)
        text = f"{bar.label}: {format_number(bar.rms, 3)} {unit}"
        if bar.closed is not None and bar.kind != "noise":
            text += f", {100 * bar.closed:.0f} % closed"
        boxed(axes, 0.01 * reach, place + 0.24, text, 9)
    rows = "data left out" if on else "the rows fitted"
    tidy(axes, f"rms on {rows} [{unit}]", size=9.5)
    axes.set_xlim(0, reach)
    axes.set_ylim(-0.4, max(len(bars), 1) - 0.3)
    axes.set_yticks([])
    note = "no part of these rows can be left out"
    if on:
        note = f"{on}; bar: standard error"
        note += "; diamond: files held out" * any(b.held_out is not None for b in bars)
    panel_title(axes, "How far the gap shrinks", note)


def draw_chances(figure, bars: Sequence[ChanceBar]) -> None:
    """Draw the probability that each effect is a cause, named ones in blue."""
    axes = figure.subplots()
    top = max(len(bars), 3)
    places = top - 1 - np.arange(len(bars))
    for place, bar in zip(places, bars, strict=True):
        axes.barh(place, bar.probability, 0.6, color=_KIND[bar.kind])
        inside = bar.probability > 0.85
        side, color, shift = ("right", "white", -0.01) if inside else ("left", DARK, 0.01)
        style = {"va": "center", "ha": side, "color": color, "fontsize": 8.5}
        axes.text(bar.probability + shift, place, f"{bar.probability:.2f}", **style)
    tidy(axes, "probability that it (or a twin) is a cause")
    axes.set_yticks(places, [textwrap.fill(bar.label, 18) for bar in bars])
    axes.set_ylim(-0.6, top - 0.4)
    axes.set_xlim(0, 1)
    panel_title(axes, "Which effects are causes", "blue: named; orange: only acts like a cause")


def draw_where(figure, panel: ResidualMap, base: str = "base fit") -> None:
    """Draw mean residuals in cells, with a dot if they are significant.

    Args:
        base: what the residuals are of.
    """
    axes = figure.subplots()
    rows, columns = panel.mean.shape
    reach = float(np.nanmax(np.abs(panel.mean), initial=1e-3))
    colors = mpl.colormaps["RdBu_r"].with_extremes(bad="#eeeeee")
    style = {"cmap": colors, "vmin": -reach, "vmax": reach, "edgecolors": "white"}
    mean = np.ma.masked_invalid(panel.mean)
    image = axes.pcolormesh(panel.edges, np.arange(rows + 1) - 0.5, mean, lw=0.4, **style)
    axes.set_facecolor("#eeeeee")
    center = (panel.edges[:-1] + panel.edges[1:]) / 2
    width = np.diff(panel.edges) / np.ptp(panel.edges)
    for row, column in np.ndindex(panel.mean.shape):
        if width[column] < _NARROW:
            continue
        dark = abs(panel.mean[row, column]) > 0.6 * reach
        style = {"color": "white" if dark else DARK}
        if panel.beyond[row, column]:
            axes.plot(center[column], row - 0.2, marker="o", ms=3, **style)
        if (share := panel.energy[row, column]) >= 0.03:
            middle = {"ha": "center", "va": "center", "fontsize": 7}
            axes.text(center[column], row + 0.15, f"{100 * share:.0f}", **middle, **style)
    tidy(axes, "slip / slip of full sliding")
    axes.set_ylabel(covariate_label(panel), fontsize=8.5, color=DARK)
    axes.set_yticks(range(rows), level_labels(panel))
    bar = figure.colorbar(image, ax=axes, pad=0.02, aspect=30)
    bar.ax.tick_params(labelsize=7.5, length=3)
    bar.set_label("% of $F_z$", fontsize=8)
    bar.outline.set_visible(False)
    note = "dot: beyond the noise (5 % false); number: % of the gap's energy"
    panel_title(axes, f"Where: measured {panel.channel.capitalize()} minus {base}", note)


def draw_comparison(figure, panel: Comparison, after: str, base: str = "base") -> None:
    """Draw both fits over the data, and their residuals below.

    Args:
        after: what the second fit is called.
        base: what the first is.
    """
    top, bottom = figure.subplots(2, 1, height_ratios=(2.1, 1))
    slips = np.concatenate([curve.slip for curve in panel.curves])
    axis = slip_axis(panel.slip_name, slips)
    for i, curve in enumerate(panel.curves):
        _draw_load(top, curve, axis, COLORS[i % len(COLORS)])
    force = f"${channel_name(panel.channel)}$ [{UNITS[panel.channel]}]"
    tidy(top, f"{axis.label} [{axis.unit}]", force)
    handles: list[Line2D | Patch] = [
        Line2D([], [], ls="none", marker="o", ms=3, color=color, label=load_label(curve))
        for curve, color in zip(panel.curves, COLORS, strict=False)
    ]
    handles += [
        Line2D([], [], color=GREY, lw=1.2, ls=(0, (4, 2)), label=base),
        Line2D([], [], color=GREY, lw=1.4, label="after"),
        Patch(color=GREY, alpha=0.3, lw=0, label="after: 80 % of rows"),
    ]
    beside = {"fontsize": 7, "frameon": False, "loc": "upper left", "bbox_to_anchor": (1.0, 1.04)}
    top.legend(handles=handles, **beside)
    panel_title(top, "Before and after", f"after: {after}")
    points = {"marker": "o", "ms": 2.5, "lw": 1.3}
    bottom.plot(panel.center, panel.before, color=DARK, ls=(0, (4, 2)), label=base, **points)
    bottom.plot(panel.center, panel.after, color=BLUE, label="after", **points)
    bottom.set_ylim(bottom=0)
    tidy(bottom, "slip / slip of full sliding", "rms residual [N]")
    bottom.legend(**beside)


def _draw_load(axes, curve: LoadCurve, axis: SlipAxis, color: str) -> None:
    center = axis.shown(curve.center)
    dots(axes, axis.shown(curve.slip), curve.force, 1.8, color, 0.4)
    axes.fill_between(center, curve.low, curve.high, color=color, alpha=0.3, lw=0, zorder=1)
    axes.plot(center, curve.base, color=color, lw=1.2, ls=(0, (4, 2)), zorder=3)
    axes.plot(center, curve.extended, color=color, lw=1.4, zorder=4)


def draw_waterfall(figure, steps: list[WaterfallBar], channel: str = "") -> None:
    """Draw the parts from a simulator's error down to the noise, as shares of its mean square.

    Args:
        channel: " of F_x", where several are simulated.
    """
    axes = figure.subplots()
    places = np.arange(len(steps))[::-1]
    whole = 100.0
    for place, step in zip(places, steps, strict=True):
        left, right = sorted((whole * step.before, whole * step.after))
        axes.barh(place, right - left, 0.62, left=left, color=_KIND[step.kind])
        # Next to the bar, on the side with space for it.
        inside = right > 0.6 * whole
        room = right - left > 0.45 * whole
        at = left + 0.012 * whole if room else left if inside else right
        at += 0 if room else -0.012 * whole if inside else 0.012 * whole
        color = "white" if room and step.kind in ("whole", "effect") else DARK
        style = {"va": "center", "ha": "right" if inside and not room else "left", "color": color}
        small = inside and not room and left < 0.45 * whole  # little space on the left
        axes.text(at, place, plain_text(step.text), fontsize=7 if small else 8, **style)
    for place, step in zip(places[1:-1], steps[1:-1], strict=True):
        axes.plot([whole * step.after] * 2, [place - 0.69, place + 0.31], color=GREY, lw=0.8)
    tidy(axes, "share of the squared error [%]")
    axes.set_yticks(places, [plain_text(step.label) for step in steps])
    axes.set_xlim(0, 1.02 * whole)
    note = "parts add in squares; a bar is a share of their sum [90 % interval]"
    panel_title(axes, f"Budget{channel}: from the simulator's error to noise", note)


def panels_of(result: Diagnosis) -> dict[str, Panel]:
    """Name of a panel -> the panel."""
    base, after = "simulator" if result.simulator else "base fit", after_label(result)
    ladder = partial(draw_ladder, bars=ladder_bars(result), on=result.ladder.on, unit=result.unit)
    panels = {
        "ladder": Panel(ladder, "Rms on data left out, step by step, down to the noise", _PHONE),
        "which": Panel(
            partial(draw_chances, bars=chance_bars(result)),
            "Probability that each effect is a cause, as bars",
            _PANEL,
        ),
    }
    if result.comparison is not None:
        compared = partial(draw_comparison, panel=result.comparison, after=after, base=base)
        text = "Force over slip and residuals, of the base fit and after it"
        panels["before and after"] = Panel(compared, text, _PANEL)
    if result.residual_map is not None:
        where = partial(draw_where, panel=result.residual_map, base=base)
        text = "Map of measured minus fitted force over slip and another quantity"
        panels["where"] = Panel(where, text, _PANEL)
    if result.look is not None:
        beside = after if result.comparison and result.comparison.named else "the base fit"
        look = partial(draw_look, panel=result.look, beside=beside)
        text = "Remainder: change of a parameter over the quantity that it depends on"
        panels["what is left"] = Panel(look, text, _PANEL)
    if any(result.verdict.sizes.get(effect) for effect in result.verdict.helping):
        text = "Size of each effect that helps, in groups of the rows"
        panels["sizes"] = Panel(partial(draw_sizes, result=result), text, _PHONE)
    for channel in result.budgets if result.simulator else ():
        of = f" of {channel_name(channel)}" * (len(result.budgets) > 1)
        bars = partial(draw_waterfall, steps=waterfall_steps(result, channel), channel=of)
        text = f"Waterfall from the simulator's error, part by part, to the noise{of}"
        panels[f"budget{of}"] = Panel(bars, text, _PANEL)
    return panels


def diagnosis_figure(result: Diagnosis) -> Picture:
    """All panels below the answer, the ladder first; below the first four the remainder,
    if it has a shape, and the budget of a simulator for each channel."""
    panels = panels_of(result)
    heights = (1, *(_FOOT,) * (len(panels) - _SQUARE))
    signs = "braking positive, " * bool(result.data.convention)
    foot = f"tirefit {result.version} · {signs}SI · seed {result.seed}"
    foot += f" · {format_number(result.n)} rows"
    size = _SIZE[0], _SIZE[1] * sum(heights)
    picture = frame(subject(result), answer(result), foot, size)
    body, *more = picture.subfigures(len(heights), 1, squeeze=False, height_ratios=heights).ravel()
    cells = [*body.subfigures(2, 2).ravel(), *more]
    for cell, panel in zip(cells, panels.values(), strict=True):
        panel.draw(cell)
    return picture


def plot_diagnosis(result: Diagnosis, panel: str | None = None):
    """The figure of a diagnosis: ladder, effects, before and after, location of the gap.

    ``result.plot().savefig("why.pdf")`` saves it.

    Args:
        result: a result of ``tirefit.diagnose``.
        panel: a single panel, such as ``ladder``; all if None.

    Raises:
        UsageError: no such panel; the error lists those of this diagnosis.
    """
    if panel is None:
        return diagnosis_figure(result)
    check_names("panel", [panel], panels := panels_of(result))
    return alone(panels[panel])
