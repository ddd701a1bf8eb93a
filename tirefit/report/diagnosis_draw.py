"""Arrays -> axes: where a gap lies, which effect causes it, how far it shrinks."""

import textwrap
from collections.abc import Callable
from functools import partial
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from tirefit.diagnosis.summary.result import Diagnosis
from tirefit.diagnosis.summary.views import Comparison, LoadCurve, ResidualMap
from tirefit.params import check_names
from tirefit.report.canvas import (
    BLUE,
    COLORS,
    DARK,
    GREY,
    ORANGE,
    Picture,
    panel_title,
    save_picture,
    tidy,
)
from tirefit.report.curves import SlipAxis, slip_axis
from tirefit.report.diagnosis_budget import Step, channel_name, waterfall_steps
from tirefit.report.diagnosis_look import draw_look
from tirefit.report.diagnosis_panels import (
    Bar,
    ClosureBar,
    after_label,
    closure_bars,
    covariate_label,
    evidence_bars,
    level_labels,
    load_label,
)
from tirefit.report.diagnosis_text import stand_in, subject, verdict_sentence
from tirefit.report.diagnosis_words import closed_text, remaining_text
from tirefit.report.numbers import format_number, plain_text

_FORCE = {"fx": "$F_x$ [N]", "fy": "$F_y$ [N]", "mz": "$M_z$ [N m]"}
_SIZE = (11.0, 9.0)
_PANEL = (5.6, 4.4)
_NARROW = 0.035
"""Share of the width below which a column of cells has no room for a number."""

_SQUARE, _FOOT = 4, 0.36
"""Panels that stand two by two; height of one below them, of that of these."""
_BAR = {
    "verdict": BLUE, "rival": ORANGE, "other": GREY, "unknown": "#CC79A7",
    "none": "#009E73", "rest": "#cccccc",
}  # fmt: skip


_STEP = {
    "whole": GREY, "parameters": ORANGE, "effect": BLUE, "unexplained": "#CC79A7",
    "noise": "#bbbbbb",
}  # fmt: skip


def draw_where(figure, panel: ResidualMap, base: str = "base fit") -> None:
    """Mean residuals in cells, a dot where they are beyond the noise.

    Args:
        base: what the residuals are of.
    """
    axes = figure.subplots()
    rows, columns = panel.mean.shape
    reach = float(np.nanmax(np.abs(panel.mean), initial=1e-3))
    colors = mpl.colormaps["RdBu_r"].with_extremes(bad="#eeeeee")
    image = axes.pcolormesh(
        panel.edges, np.arange(rows + 1) - 0.5, np.ma.masked_invalid(panel.mean),
        cmap=colors, vmin=-reach, vmax=reach, edgecolors="white", linewidth=0.4,
    )  # fmt: skip
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
            axes.text(
                center[column], row + 0.15, f"{100 * share:.0f}", ha="center",
                va="center", fontsize=7, **style,
            )  # fmt: skip
    tidy(axes, "slip / slip of full sliding")
    axes.set_ylabel(covariate_label(panel), fontsize=8.5, color=DARK)
    axes.set_yticks(range(rows), level_labels(panel))
    bar = figure.colorbar(image, ax=axes, pad=0.02, aspect=30)
    bar.ax.tick_params(labelsize=7.5, length=3)
    bar.set_label("% of $F_z$", fontsize=8)
    bar.outline.set_visible(False)
    name = panel.channel.capitalize()
    panel_title(
        axes, f"Where: measured {name} minus {base}",
        "dot: beyond the noise (5 % false); number: % of the gap's energy",
    )  # fmt: skip


def draw_evidence(figure, bars: list[Bar]) -> None:
    """Probabilities as bars, the verdict's in blue."""
    axes = figure.subplots()
    places = np.arange(len(bars))[::-1]
    values = [bar.probability for bar in bars]
    axes.barh(places, values, 0.7, color=[_BAR[bar.kind] for bar in bars])
    for place, value in zip(places, values, strict=True):
        text = f"{value:.2f}" if value >= 0.005 else "< 0.01"
        inside = value > 0.85
        axes.text(
            value + (-0.01 if inside else 0.01), place, text, va="center",
            ha="right" if inside else "left", fontsize=8,
            color="white" if inside else DARK,
        )  # fmt: skip
    tidy(axes, "probability")
    axes.set_yticks(places, [plain_text(bar.label) for bar in bars])
    axes.set_xlim(0, 1)
    note = "by evidence, before what they leave is tested; blue: verdict"
    panel_title(axes, "Which: explanations of the gap", note)


def draw_comparison(figure, panel: Comparison, after: str, base: str = "base") -> None:
    """Both fits over the data, above their residuals.

    Args:
        after: what the second fit is called.
        base: what the first is.
    """
    top, bottom = figure.subplots(2, 1, height_ratios=(2.1, 1))
    slips = np.concatenate([curve.slip for curve in panel.curves])
    axis = slip_axis(panel.slip_name, slips)
    for i, curve in enumerate(panel.curves):
        _draw_load(top, curve, axis, COLORS[i % len(COLORS)])
    tidy(top, f"{axis.label} [{axis.unit}]", _FORCE[panel.channel])
    handles: list[Line2D | Patch] = [
        Line2D(
            [], [], ls="none", marker="o", ms=3, color=color, label=load_label(curve)
        )
        for curve, color in zip(panel.curves, COLORS, strict=False)
    ]
    handles += [
        Line2D([], [], color=GREY, lw=1.2, ls=(0, (4, 2)), label=base),
        Line2D([], [], color=GREY, lw=1.4, label="after"),
        Patch(color=GREY, alpha=0.3, lw=0, label="after: 80 % of rows"),
    ]
    top.legend(
        handles=handles, fontsize=7, frameon=False, loc="upper left",
        bbox_to_anchor=(1.0, 1.02),
    )  # fmt: skip
    panel_title(top, "Before and after", f"after: {after}")
    bottom.plot(
        panel.center, panel.before, color=DARK, ls=(0, (4, 2)), marker="o", ms=2.5,
        lw=1.2, label=base,
    )  # fmt: skip
    bottom.plot(
        panel.center, panel.after, color=BLUE, marker="o", ms=2.5, lw=1.4, label="after"
    )
    bottom.set_ylim(bottom=0)
    tidy(bottom, "slip / slip of full sliding", "rms residual [N]")
    bottom.legend(
        fontsize=7, frameon=False, loc="upper left", bbox_to_anchor=(1.0, 1.05)
    )


def _draw_load(axes, curve: LoadCurve, axis: SlipAxis, color: str) -> None:
    center = axis.shown(curve.center)
    axes.plot(
        axis.shown(curve.slip), curve.force, ls="none", marker="o", ms=1.8,
        markeredgewidth=0, alpha=0.4, color=color, rasterized=True, zorder=2,
    )  # fmt: skip
    axes.fill_between(
        center, curve.low, curve.high, color=color, alpha=0.3, lw=0, zorder=1
    )
    axes.plot(center, curve.base, color=color, lw=1.2, ls=(0, (4, 2)), zorder=3)
    axes.plot(center, curve.extended, color=color, lw=1.4, zorder=4)


def draw_closure(figure, bars: list[ClosureBar], load: float) -> None:
    """Gaps before and after [N] with their shares.

    Args:
        load: mean F_z [N] of the rows, for the scale in % of it.
    """
    axes = figure.subplots()
    for k, bar in enumerate(bars):
        place = 1.0 * (len(bars) - 1 - k)
        axes.barh(place + 0.16, bar.before, 0.28, color=GREY)
        if bar.low is not None and bar.high is not None:
            axes.barh(place - 0.16, bar.after, 0.28, color=BLUE)
            axes.errorbar(
                bar.after, place - 0.16, fmt="none", ecolor=DARK, elinewidth=1.2,
                xerr=[[max(bar.after - bar.low, 0)], [max(bar.high - bar.after, 0)]],
            )  # fmt: skip
        axes.text(
            0.01, place + 0.34, _closure_text(bar), fontsize=8, color=DARK, va="bottom",
            transform=axes.get_yaxis_transform(),
        )  # fmt: skip
    tidy(axes, "gap beyond the noise, rms [N]")
    reach = 1.12 * max(max(bar.before, bar.high or 0.0) for bar in bars)
    axes.set_xlim(0, reach if reach > 0 else 1.0)
    axes.set_ylim(min(len(bars), 2) - 2.45, len(bars) - 0.25)
    axes.set_yticks([])
    share = axes.secondary_xaxis(
        -0.2, functions=(lambda x: 100 * x / load, lambda x: x * load / 100)
    )
    share.tick_params(labelsize=7.5, color=GREY, labelcolor=DARK, length=3)
    share.set_xlabel("% of mean $F_z$", fontsize=8.5, color=DARK)
    share.spines["bottom"].set_color(GREY)
    panel_title(
        axes, "How far: the gap before and after", "grey: base; blue: after, 90 %"
    )


def _closure_text(bar: ClosureBar) -> str:
    label = textwrap.shorten(bar.label, 60, placeholder=" …")
    before, after = (format_number(x, 3) for x in (bar.before, bar.after))
    if bar.low is None or bar.high is None or bar.closed is None:
        return plain_text(f"{label}: {before} N, nothing to say of a share closed")
    low, high = (1 - end / bar.before for end in (bar.high, bar.low))
    return plain_text(
        f"{label}: {before} N to {remaining_text(bar.closed, f'{after} N')}\n"
        f"closed {closed_text(bar.closed, (low, high), bar.energy)}"
    )


def draw_waterfall(figure, steps: list[Step], channel: str = "") -> None:
    """From a simulator's error down to the noise, in shares of its mean square.

    Args:
        channel: name of what is simulated, where there are several.
    """
    axes = figure.subplots()
    places = np.arange(len(steps))[::-1]
    whole = 100.0
    for place, step in zip(places, steps, strict=True):
        left, right = sorted((whole * step.before, whole * step.after))
        axes.barh(place, right - left, 0.62, left=left, color=_STEP[step.kind])
        # Beside the bar, on the side with room for it.
        inside = right > 0.6 * whole
        room = right - left > 0.45 * whole
        at = left + 0.012 * whole if room else left if inside else right
        axes.text(
            at + (0 if room else -0.012 * whole if inside else 0.012 * whole), place,
            plain_text(step.text), va="center", fontsize=8,
            ha="right" if inside and not room else "left",
            color="white" if room and step.kind in ("whole", "effect") else DARK,
        )  # fmt: skip
    for place, step in zip(places[1:-1], steps[1:-1], strict=True):
        axes.plot(
            [whole * step.after] * 2, [place - 0.69, place + 0.31], color=GREY, lw=0.8
        )
    tidy(axes, "share of the squared error [%]")
    axes.set_yticks(places, [plain_text(step.label) for step in steps])
    axes.set_xlim(0, 1.02 * whole)
    panel_title(
        axes,
        f"Budget{f' of {channel}' * bool(channel)}: from the simulator's error to the"
        " noise",
        "parts add in squares; a bar is a share of their sum [90 % interval]",
    )  # fmt: skip


def _panels(result: Diagnosis) -> dict[str, Callable]:
    """Name -> what draws that panel on a figure."""
    panels: dict[str, Callable] = {
        "where": partial(
            draw_where,
            panel=result.residual_map,
            base="simulator" if result.simulator else "base fit",
        ),  # fmt: skip
        "which": partial(draw_evidence, bars=evidence_bars(result)),
        "before and after": partial(
            draw_comparison,
            panel=result.comparison,
            after=after_label(result),
            base="simulator" if result.simulator else "base",
        ),  # fmt: skip
        "how far": partial(
            draw_closure, bars=closure_bars(result), load=result.mean_load
        ),
    }
    if result.look is not None:
        beside = after_label(result) if result.comparison.named else "the base fit"
        panels["what is left"] = partial(draw_look, panel=result.look, beside=beside)
    return panels | _budgets(result)


def _budgets(result: Diagnosis) -> dict[str, Callable]:
    if result.simulator is None:
        return {}
    several = len(result.budgets) > 1
    return {
        f"budget of {channel_name(channel)}" if several else "budget": partial(
            draw_waterfall,
            steps=waterfall_steps(result, channel),
            channel=channel_name(channel) if several else "",
        )
        for channel in result.budgets
    }


def panel_names(result: Diagnosis) -> tuple[str, ...]:
    """What is drawn, in order."""
    return tuple(_panels(result))


def panel_pictures(result: Diagnosis) -> dict[str, Picture]:
    """Each panel as a picture of its own: on a phone they stand below each other."""
    pictures = {}
    for name, draw in _panels(result).items():
        pictures[name] = Picture(figsize=_PANEL, layout="constrained")
        draw(pictures[name])
    return pictures


def diagnosis_figure(result: Diagnosis) -> Picture:
    """All four panels, under the verdict; below them what is left, where it has a
    shape, and the budget of a simulator, channel by channel."""
    panels = _panels(result)
    feet = (_FOOT,) * (len(panels) - _SQUARE)
    width, height = _SIZE
    picture = Picture(figsize=(width, height * (1 + sum(feet))), layout="constrained")
    heights = (0.065, 1, *feet)
    parts = picture.subfigures(len(heights), 1, squeeze=False, height_ratios=heights)
    head, body, *foot = parts.ravel()
    cells = [*body.subfigures(2, 2).ravel(), *foot]
    for cell, draw in zip(cells, panels.values(), strict=True):
        draw(cell)
    head.text(
        0.01, 0.95, plain_text(subject(result)),
        va="top", fontsize=12, fontweight="bold", color=DARK,
    )  # fmt: skip
    small = f"\n{stand_in(result)}" if stand_in(result) else ""
    sentence = textwrap.fill(
        verdict_sentence(result), 150, max_lines=2, placeholder=" …"
    )
    head.text(0.01, 0.42, plain_text(sentence), va="top", fontsize=9, color=DARK)
    head.text(
        0.99, 0.95, f"tirefit {result.version} · braking positive, SI · seed"
        f" {result.seed} · {format_number(result.n)} rows{small}",
        va="top", ha="right", fontsize=7, color=GREY,
    )  # fmt: skip
    return picture


def plot_diagnosis(result: Diagnosis, panel: str | None = None):
    """What a diagnosis saw: where, which effect, before and after, how far; the Figure.

    ``plot_diagnosis(result).savefig("why.pdf")`` saves it.

    Args:
        result: of ``tirefit.diagnose``.
        panel: one of them alone, such as ``where``; all if None.

    Raises:
        UsageError: no such panel; names those of this diagnosis.
    """
    if panel is None:
        return diagnosis_figure(result)
    check_names("panel", [panel], panel_names(result))
    return panel_pictures(result)[panel]


def write_figure(result: Diagnosis, path) -> Path:
    """Write the figure of a diagnosis, whole or not at all; its suffix says the kind.

    Raises:
        OSError: the file cannot be written.
    """
    return save_picture(diagnosis_figure(result), Path(path))
