"""What is left of a gap: which quantity of the tire changes, with what, in what shape,
in words and as a panel."""

import textwrap

import numpy as np

from tirefit.diagnosis.summary.views import LookCurve
from tirefit.report.canvas import BLUE, DARK, GREY, panel_title, tidy
from tirefit.report.diagnosis_words import (
    covariate_text,
    covariate_unit,
    look_place,
    look_text,
)

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
_LETTERS = 66
"""Of a line of the title."""


def look_title(panel: LookCurve) -> str:
    """What is left as a sentence: ``What is left: friction steps at a load F_z of 5000
    N by -4.9 %``."""
    return f"What is left: {look_text(panel.look)}"


def _axis_label(panel: LookCurve) -> str:
    look = panel.look
    unit = covariate_unit(look.covariate)
    tail = f" [{unit}]" if unit else ""
    words = covariate_text(look.covariate)
    if panel.is_folded:
        return f"{words}, folded over the period of {look_place(look)}{tail}"
    return f"{words}{tail}"


def draw_look(figure, panel: LookCurve, beside: str) -> None:
    """The local change of a parameter in bins ± standard error, and the fitted shape.

    Args:
        beside: what the change comes on top of.
    """
    axes = figure.subplots()
    scale = 1.0 if panel.look.parameter == "slip" else 100.0
    axes.axhline(0.0, color=GREY, lw=0.8, zorder=1)
    if panel.at_settings:
        # Between settings nothing was measured.
        half = 0.25 * np.min(np.diff(np.sort(panel.x)))
        axes.hlines(
            scale * panel.shape, panel.x - half, panel.x + half, color=BLUE, lw=2.0,
            zorder=2,
        )  # fmt: skip
        axes.set_xticks(panel.x)
    else:
        axes.plot(panel.x, scale * panel.shape, color=BLUE, lw=1.6, zorder=2)
    axes.errorbar(
        panel.center, scale * panel.change, scale * panel.std, fmt="o", ms=3.5,
        color=DARK, ecolor=GREY, elinewidth=1.0, zorder=3,
    )  # fmt: skip
    labels = _ALONG if panel.is_mirrored else _CHANGES
    tidy(axes, _axis_label(panel), labels[panel.look.parameter])
    panel_title(
        axes, textwrap.fill(look_title(panel).replace(" %", "\u00a0%"), _LETTERS),
        f"points: bins of the data ± standard error; line: fitted; on top of {beside}",
    )  # fmt: skip
