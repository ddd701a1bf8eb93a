"""Contents of the figure of a diagnosis: bars, labels, remainder."""

import math
import textwrap
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tirefit.diagnosis.engine.left_out import AS_GIVEN, NOISE, SMOOTH, Step
from tirefit.diagnosis.summary.result import Diagnosis
from tirefit.diagnosis.summary.views import LoadCurve, LookCurve, ResidualMap
from tirefit.report.canvas import BLUE, DARK, GREY, boxed, panel_title, tidy
from tirefit.report.diagnosis_sections import step_label
from tirefit.report.diagnosis_words import (
    NAMED_VALUES,
    covariate_text,
    covariate_unit,
    look_text,
    name_of,
)
from tirefit.report.numbers import format_number


class LadderBar(NamedTuple):
    """A step of the ladder."""

    label: str
    rms: float  # [N] on data left out
    error: float | None  # standard error; None for the first
    closed: float | None
    kind: str  # base, effect, smooth or noise
    held_out: float | None = None  # rms on the files held out


class ChanceBar(NamedTuple):
    """The probability that an effect is present."""

    label: str
    probability: float
    kind: str  # verdict, other or unknown (an unlisted effect)


def _error(step: Step, steps: Sequence[Step]) -> float:
    """Standard error of the rms of a step from that of the closed share: with the gap g
    beyond the noise n, rms^2 = n^2 + g^2 (1 - closed)^2."""
    gap = max(steps[0].rms_left_out ** 2 - steps[-1].rms_left_out ** 2, 0.0)
    return gap * abs(1 - step.closed) * step.closed_std / step.rms_left_out


def ladder_bars(result: Diagnosis) -> list[LadderBar]:
    """The steps of the ladder, in order; if no data could be left out, the model without
    effects and the noise on the fitted rows."""
    kinds = {AS_GIVEN: "base", (): "base", SMOOTH: "smooth", NOISE: "noise"}
    if not result.ladder.steps:
        noise = result.noise.forces.get(result.data.channels[0], 1.0)
        before = math.hypot(result.gap.rms, noise)
        alone = LadderBar("no effect", before, None, None, "base")
        return [alone, LadderBar("noise floor", noise, None, None, "noise")]
    return [
        LadderBar(
            step_label(result, k),
            step.rms_left_out,
            _error(step, result.ladder.steps) if k else None,
            step.closed if k else None,
            kinds.get(step.effects, "effect"),
            step.rms_held_out,
        )
        for k, step in enumerate(result.ladder.steps)
    ]


def chance_bars(result: Diagnosis) -> list[ChanceBar]:
    """Probability of every effect of the verdict, named ones first, unlisted last."""
    verdict = result.verdict
    kinds = dict.fromkeys(verdict.also_possible, "other")
    kinds |= dict.fromkeys(verdict.acts_like, "other")
    kinds |= dict.fromkeys(verdict.effects, "verdict")
    named_first = sorted(verdict.each, key=lambda e: e not in verdict.effects)
    bars = [
        ChanceBar(name_of(e), verdict.each[e].probability, kinds.get(e, "other"))
        for e in named_first
    ]
    return [*bars, ChanceBar("an unlisted effect", verdict.left.unlisted, "unknown")]


def covariate_label(panel: ResidualMap) -> str:
    """Label of the second axis of the map (the first one is the slip)."""
    unit = covariate_unit(panel.covariate)
    return covariate_text(panel.covariate) + f" [{unit}]" * bool(unit)


def level_labels(panel: ResidualMap) -> tuple[str, ...]:
    """Names of the levels of the map: a value or a range."""
    named = NAMED_VALUES.get(panel.covariate, {})
    return tuple(named.get(low) or _range(low, high) for low, high in panel.levels)


def _range(low: float, high: float) -> str:
    if low == high:
        return format_number(float(low))
    return f"{format_number(float(low), 3)}-{format_number(float(high), 3)}"


def load_label(curve: LoadCurve) -> str:
    """Name of the load of a curve."""
    return f"$F_z$ = {_range(*curve.load)} N"


def after_label(result: Diagnosis) -> str:
    """Name of the curves after the diagnosis."""
    if result.comparison and not result.comparison.named:
        return "base + located gap"
    named = map(name_of, result.verdict.helping)
    return " + ".join((*(["parameters"] if result.simulator else []), *named))


_CHANGES = {
    "stiffness": "change of stiffness [%]",
    "friction": "change of friction [%]",
    "slip": "added slip [-]",
    "force": "added force [% of $F_z$]",
}
_ALONG = {
    "slip": "added slip, in its own direction [-]",
    "force": "added force, towards the slip [% of $F_z$]",
}
_LETTERS = 66  # largest number of characters in a line of the title


def look_title(panel: LookCurve) -> str:
    """``What is left: friction steps at a load F_z of 5000 N by -4.9 %``."""
    return f"What is left: {look_text(panel.look)}"


def _axis_label(panel: LookCurve) -> str:
    look = panel.look
    unit = covariate_unit(look.covariate)
    tail = f" [{unit}]" if unit else ""
    words = covariate_text(look.covariate)
    return f"{words}, within a period{tail}" if look.is_wave else f"{words}{tail}"


def draw_look(figure, panel: LookCurve, beside: str) -> None:
    """Draw the change of a parameter over a covariate ± standard error.

    Args:
        beside: the model to which the change is added.
    """
    axes = figure.subplots()
    scale = 1.0 if panel.look.parameter == "slip" else 100.0
    change, std = scale * panel.change, scale * panel.std
    axes.axhline(0.0, color=GREY, lw=0.8, zorder=1)
    if panel.at_settings:
        # There are no measurements between settings.
        axes.errorbar(panel.x, change, std, fmt="o", ms=4, color=BLUE, ecolor=GREY, zorder=3)
        axes.set_xticks(panel.x)
    else:
        axes.fill_between(panel.x, change - std, change + std, color=BLUE, alpha=0.2, lw=0)
        axes.plot(panel.x, change, color=BLUE, lw=1.6, zorder=2)
    labels = _ALONG if panel.is_mirrored else _CHANGES
    tidy(axes, _axis_label(panel), labels[panel.look.parameter])
    panel_title(
        axes,
        textwrap.fill(look_title(panel).replace(" %", "\u00a0%"), _LETTERS),
        f"most probable function ± standard error; on top of {beside}",
    )


def draw_sizes(figure, result: Diagnosis) -> None:
    """Draw the size of each effect that helps by groups of the covariate in which it is most
    unequal, over the size that fits all."""
    axes, row, ticks, labels = figure.subplots(), 0.0, [], []
    axes.axvline(1.0, color=DARK, lw=0.8, zorder=1)
    for effect in result.verdict.helping:
        for one in result.verdict.sizes.get(effect, ())[:1]:
            size, std = (np.asarray(x) / whole_size(result, effect) for x in (one.size, one.std))
            places, error = row - np.arange(len(size)), np.abs(std)
            known = error < _READABLE
            axes.errorbar(
                size[known], places[known], xerr=error[known], fmt="o", ms=4.5, color=BLUE,
                ecolor=GREY, zorder=3,
            )  # fmt: skip
            ticks += places.tolist()
            unit = covariate_unit(one.covariate)
            labels += [f"{format_number(at, 3)} {unit}".rstrip() for at in one.at]
            text = f"{name_of(effect)}, by {covariate_text(one.covariate)}"
            boxed(axes, 0.01, row + 0.5, text, 8.5, transform=axes.get_yaxis_transform())
            row -= len(size) + 1.2
    axes.set_yticks(ticks, labels)
    axes.set_ylim(row + 1.5, 1.4)
    left, right = axes.get_xlim()
    axes.set_xlim(min(left, 0.0), max(right, 2.0))  # nearly equal sizes look so
    tidy(axes, "size over the size that fits all [-]", size=9)
    note = "equal sizes speak for a cause; bar: standard error"
    panel_title(axes, "Is each effect of one size everywhere?", note)


_READABLE = 3.0
"""A group with a larger error, over the size that fits all, is not drawn."""


def whole_size(result: Diagnosis, effect: str) -> float:
    """The amplitude of a named effect."""
    return next(v.value for k, v in result.amplitudes.items() if k.startswith(f"{effect}: "))
