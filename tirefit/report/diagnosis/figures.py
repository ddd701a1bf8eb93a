"""The figures of a diagnosis: ladder, before and after, location of the gap."""

import math
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from tirefit.diagnosis.engine.left_out import AS_GIVEN, NOISE, SMOOTH
from tirefit.diagnosis.summary.result import UNITS, Diagnosis
from tirefit.diagnosis.summary.views import SIGNIFICANT, Comparison
from tirefit.params import check_names
from tirefit.report import canvas
from tirefit.report.diagnosis import words
from tirefit.report.diagnosis.answer import answer
from tirefit.report.diagnosis.sections import foot_line, step_label, subject
from tirefit.report.fit.curves import slip_axis
from tirefit.report.numbers import format_number, plain_text

_HALF = 0.17  # half of the height of a bar, whose label needs the rest
_KIND = {"base": canvas.GREY, "effect": canvas.BLUE, "smooth": canvas.ORANGE, "noise": "#bbbbbb"}
"""Colours of the bars by their kind."""


class Bar(NamedTuple):
    """A step of the ladder, or a region."""

    label: str
    length: float
    kind: str
    text: str  # its size
    error: float = 0.0  # standard error of the length
    mark: float | None = None  # the same on the files held out


def ladder_bars(result: Diagnosis) -> list[Bar]:
    """The rms on data left out of each step of the ladder, in order; if no data could be left
    out, that of the model without effects and of the noise on the fitted rows."""
    unit, steps, bars = result.unit, result.ladder.steps, []
    if not steps:
        noise = result.noise.forces.get(result.data.channels[0], 1.0)
        sizes = ("no effect", math.hypot(result.gap.rms, noise)), ("noise floor", noise)
        return [Bar(k, x, "base", f"{format_number(x, 3)} {unit}") for k, x in sizes]
    kinds = {AS_GIVEN: "base", (): "base", SMOOTH: "smooth", NOISE: "noise"}
    gap = max(steps[0].rms_left_out ** 2 - steps[-1].rms_left_out ** 2, 0.0)
    for k, step in enumerate(steps):
        rms, kind, error = step.rms_left_out, kinds.get(step.effects, "effect"), 0.0
        text = f"{format_number(rms, 3)} {unit}"
        if k and kind != "noise":
            text += f", {100 * step.closed:.0f} % closed"
            # With the gap g beyond the noise n, rms^2 = n^2 + g^2 (1 - closed)^2.
            error = gap * abs(1 - step.closed) * step.closed_std / rms
        bars.append(Bar(step_label(result, k), rms, kind, text, error, step.rms_held_out))
    return bars


def draw_bars(figure: Any, bars: Sequence[Bar], x_label: str, title: str, note: str) -> None:
    """Draw bars one below the other, each below its text."""
    axes = figure.subplots()
    reach = 1.05 * max(max(bar.length + bar.error, bar.mark or 0.0) for bar in bars)
    places = np.arange(len(bars))[::-1]
    for place, bar in zip(places, bars, strict=True):
        axes.barh(place, bar.length, 2 * _HALF, color=_KIND[bar.kind])
        if bar.error:
            axes.errorbar(
                bar.length, place, xerr=bar.error, fmt="none", ecolor=canvas.DARK, capsize=2
            )
        if bar.mark is not None:
            axes.plot(bar.mark, place, "D", ms=6, mfc="white", mec=canvas.DARK)
        if bar.kind in ("smooth", "noise"):  # at every bar, and not across the labels between them
            ends = places - _HALF, places + _HALF
            at = np.full(len(bars), bar.length)
            axes.vlines(at, *ends, color=_KIND[bar.kind], lw=1.2, ls=(0, (2, 1)), zorder=0)
        label = plain_text(f"{bar.label}: {bar.text}")
        axes.text(0.01 * reach, place + _HALF + 0.1, label, fontsize=9, color=canvas.DARK)
    canvas.tidy(axes, x_label, size=9.5)
    axes.set_xlim(0, reach)
    axes.set_ylim(-0.4, len(bars) - 0.25)
    axes.set_yticks([])
    canvas.panel_title(axes, title, note)


def where_bars(result: Diagnosis) -> list[Bar]:
    """The regions in which the gap is beyond the noise, at most six, and their shares [%] of its
    energy."""
    bars = []
    for region in [part for part in result.where if part.p_value <= SIGNIFICANT][:6]:
        label = f"{words.covariate_text(region.covariate)} {words.range_text(region)}"
        share = 100 * region.share
        bars.append(Bar(label, share, "effect", f"{share:.0f} %"))
    return bars


def after_label(result: Diagnosis) -> str:
    """Name of the curves after the diagnosis."""
    if result.comparison and not result.comparison.named:
        return "base + located gap"
    first = ["parameters"] if result.simulator else []
    return " + ".join([*first, *map(words.name_of, result.verdict.helping)])


def draw_comparison(figure: Any, panel: Comparison, after: str, base: str = "base") -> None:
    """Draw both fits over the data, and their residuals below.

    Args:
        after: what the second fit is called.
        base: what the first is.
    """
    top, bottom = figure.subplots(2, 1, height_ratios=(2.1, 1))
    axis = slip_axis(panel.slip_name, np.concatenate([curve.slip for curve in panel.curves]))
    dashed, handles = dict[str, Any](lw=1.2, ls=(0, (4, 2))), list[Line2D | Patch]()
    for curve, color in zip(panel.curves, canvas.COLORS, strict=False):
        center = axis.shown(curve.center)
        canvas.dots(top, axis.shown(curve.slip), curve.force, 1.8, color, 0.4)
        top.fill_between(center, curve.low, curve.high, color=color, alpha=0.3, lw=0, zorder=1)
        top.plot(center, curve.base, color=color, zorder=3, **dashed)
        top.plot(center, curve.extended, color=color, lw=1.4, zorder=4)
        ends = dict.fromkeys(format_number(float(x), 3) for x in curve.load)
        load = f"$F_z$ = {'-'.join(ends)} N"
        handles.append(Line2D([], [], ls="none", marker="o", ms=3, color=color, label=load))
    force = f"${words.channel_name(panel.channel)}$ [{UNITS[panel.channel]}]"
    canvas.tidy(top, f"{axis.label} [{axis.unit}]", force)
    handles += [
        Line2D([], [], color=canvas.GREY, label=base, **dashed),
        Line2D([], [], color=canvas.GREY, lw=1.4, label="after"),
        Patch(color=canvas.GREY, alpha=0.3, lw=0, label="80 % of rows"),
    ]
    beside = {"fontsize": 7, "frameon": False, "loc": "upper left", "bbox_to_anchor": (1.0, 1.04)}
    top.legend(handles=handles, **beside)
    canvas.panel_title(top, "Before and after", f"after: {after}")
    points = {"marker": "o", "ms": 2.5}
    bottom.plot(panel.center, panel.before, color=canvas.DARK, label=base, **points, **dashed)
    bottom.plot(panel.center, panel.after, color=canvas.BLUE, label="after", **points)
    bottom.set_ylim(bottom=0)
    canvas.tidy(bottom, "slip / slip of full sliding", "rms residual [N]")
    bottom.legend(**beside)


def _bars_panel(bars: Sequence[Bar], text: str, **titles: str) -> canvas.Panel:
    height = 1.1 + 0.42 * len(bars)  # of the title and the axis, and of each bar with its label
    return canvas.Panel(partial(draw_bars, bars=bars, **titles), text, (canvas.WIDE, height))


def panels_of(result: Diagnosis) -> dict[str, canvas.Panel]:
    """Name of a panel -> the panel."""
    base = "simulator" if result.simulator else "base fit"
    after, on = after_label(result), result.ladder.on
    bars, note = ladder_bars(result), "no part of these rows can be left out"
    if on:
        note = f"{on}; bar: standard error"
        note += "; diamond: files held out" * any(b.mark is not None for b in bars)
    x_label = f"rms on {'data left out' if on else 'the rows fitted'} [{result.unit}]"
    titles = {"x_label": x_label, "title": "How far the gap shrinks", "note": note}
    text = "Rms on data left out, step by step, down to the noise"
    panels = {"ladder": _bars_panel(bars, text, **titles)}
    if (compared := result.comparison) is not None:
        text = "Force over slip and residuals, of the base fit and after it"
        draw = partial(draw_comparison, panel=compared, after=after, base=base)
        panels["before and after"] = canvas.Panel(draw, text, (canvas.WIDE, 4.4))
    if regions := where_bars(result):
        titles = {"x_label": "share of the gap's energy [%]", "title": "Where the gap lies"}
        titles |= {"note": f"measured minus {base}: regions beyond the noise (5 % false)"}
        text = "Regions of load, speed, slip or time with their shares of the gap"
        panels["where"] = _bars_panel(regions, text, **titles)
    return panels


def diagnosis_figure(result: Diagnosis) -> canvas.Picture:
    """All panels one below the other, below the answer."""
    foot = f"{foot_line(result)} · {format_number(result.n)} rows"
    panels = [*panels_of(result).values()]
    return canvas.together(panels, subject(result), answer(result), foot)


def plot_diagnosis(result: Diagnosis, panel: str | None = None) -> canvas.Picture:
    """The figure of a diagnosis: ladder, before and after, location of the gap.

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
    return canvas.alone(panels[panel])
