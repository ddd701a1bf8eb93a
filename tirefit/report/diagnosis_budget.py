"""The budget of a simulator's error as a table and as the bars of a waterfall."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tirefit.diagnosis.summary.result import UNITS, Change, Diagnosis, Part
from tirefit.report.diagnosis_words import name_of, share_text
from tirefit.report.numbers import format_estimate, format_number

_LEFT = ("unexplained", "noise")
_KINDS = ("parameters", *_LEFT)  # parts of a budget that are not effects

_SHORT = {"mu": "friction", "cpa2": "stiffness", "mu_peak": "peak friction"}
"""Short names of parameters for sentences."""


_MANY_TIMES = 3.0
"""Ratio of simulated to measured value above which its number says nothing: the rows hardly
determine it."""

_FRICTION = ("mu", "LMUX", "LMUY", "mu_peak")


class WaterfallBar(NamedTuple):
    """One bar of the waterfall, a part of the simulator's squared error."""

    label: str
    before: float  # remaining share before the part
    after: float  # remaining share after the part
    kind: str  # whole, parameters, effect, unexplained or noise
    text: str  # size of the part


def change_texts(result: Diagnosis) -> list[str]:
    """Errors of the simulator's parameters, such as ``friction 9 ± 1 % too high``, most
    significant first; only those that differ from the measurement."""
    wrong = [(k, c) for k, c in result.verdict.parameters.items() if c.differs]
    wrong.sort(key=lambda kc: kc[1].std / abs(kc[1].simulated - kc[1].measured))
    words = {**result.meanings, **_SHORT}
    both = result.simulator.readings if result.simulator else None
    lacks = {one.id for one in both.structure} if both else set()
    if "no_saturation" in lacks:
        wrong = [(name, change) for name, change in wrong if name not in _FRICTION]
    used = _used_friction(result) if wrong else 0.0
    return [_change_text(name, words.get(name, name), change, used) for name, change in wrong]


def _used_friction(result: Diagnosis) -> float:
    """The largest force of the simulator, which is the base of the gap, over the load."""
    if result.table is None:
        return 0.0
    load = np.asarray(result.table["fz"])
    every = [rows["base"] for channel, rows in result.rows.items() if channel != "mz"]
    return max((float(np.nanmax(np.abs(force) / load)) for force in every), default=0.0)


def _change_text(name: str, meaning: str, change: Change, used: float) -> str:
    off = change.simulated - change.measured
    side = f"{'high' if off > 0 else 'low'} (set {name} to {format_number(change.measured, 3)})"
    if min(change.simulated, change.measured) > 0:
        ratio = change.simulated / change.measured
        error = ratio * change.std / change.measured
        if ratio > _MANY_TIMES and name in _FRICTION:
            return f"no friction limit below {format_number(used, 2)} F_z in these rows"
        if ratio > _MANY_TIMES:
            return f"{meaning} more than {_MANY_TIMES:.0f} times too {side}"
        share = format_estimate(100 * abs(ratio - 1), 100 * error)
        return f"{meaning} {share} % too {side}"
    return f"{meaning} {format_estimate(abs(off), change.std)} too {side}"


_OF_CAR = {"all": "the motion", "v_y": "lateral speed", "yaw_rate": "yaw rate"}
_OF_CAR |= {name: name for name in ("heading", "x", "y")}


def channel_name(channel: str) -> str:
    """``F_x``, ``F_y`` or ``M_z``; a channel of a car in words."""
    return _OF_CAR.get(channel) or f"{channel[0].upper()}_{channel[1:]}"


def _rms(parts: Sequence[Part]) -> str:
    """Rms error of the simulator, noise included."""
    sure = max(parts, key=lambda part: part.share)
    return format_number(sure.rms / np.sqrt(sure.share), 3)


def in_order(budget: Sequence[Part]) -> list[Part]:
    """The parts that are explained, the largest first, then what is left."""
    return sorted(budget, key=lambda part: -part.share * (part.part not in _LEFT))


def budget_table(result: Diagnosis, channel: str) -> list[tuple[str, ...]]:
    """The error of a simulator or model and its parts, one per row, with a header."""
    budget, what = result.budgets[channel], "simulator" if result.simulator else "model"
    if not budget:
        return []
    return [
        (
            f"{channel_name(channel)}, part of the error",
            f"rms [{UNITS[channel]}]",
            "share of the mean square [90 % interval]",
        ),
        (f"whole error of the {what}", _rms(budget), "100 %"),
        *(
            (_label(part), format_number(part.rms, 3), share_text(part.share, part.closed_ci))
            for part in in_order(budget)
        ),
    ]


_ROUGH = 0.5
"""Largest error of a stand-in over the gap for an accurate budget: of twelve simulators of other
tires, four were diagnosed correctly with a brush, eleven with a tire that followed them."""


def stand_in_line(result: Diagnosis) -> str:
    """A line on the error of the stand-in of a simulator; empty if there is none."""
    if result.simulator is None or result.simulator.surrogate.of_force <= 1e-6:
        return ""
    followed, resolvable = result.simulator.surrogate, result.gap.resolvable
    line = (
        f"{followed.model} stands in for the simulator and differs from it by"
        f" {format_number(followed.rms, 3)} N rms,"
        f" {share_text(followed.of_force)} of its force"
    )
    line += f" and {share_text(followed.of_gap)} of the gap" * resolvable
    if resolvable and followed.of_gap > _ROUGH:
        line += (
            "; the parts are rough: without --model, a tire that follows it more closely is chosen"
        )
    return line


def _label(part: Part) -> str:
    return "its parameters" if part.part == "parameters" else name_of(part.part)


def waterfall_steps(result: Diagnosis, channel: str | None = None) -> list[WaterfallBar]:
    """The bars from the simulator's error down to the noise.

    Args:
        channel: the first if None.
    """
    channel = channel or next(iter(result.budgets))
    unit = UNITS[channel]
    message = f"{_rms(result.budgets[channel])} {unit} (rms), 100 %"
    left, steps = 1.0, [WaterfallBar("simulator's error", 1.0, 0.0, "whole", message)]
    for part in in_order(result.budgets[channel]):
        rest = max(left - part.share, 0.0) if part.part != "noise" else 0.0
        kind = part.part if part.part in _KINDS else "effect"
        low, high = part.closed_ci
        text = (
            f"{format_number(part.rms, 3)} {unit} (rms), {100 * part.share:.0f} %"
            f" [{100 * low:.0f}, {100 * high:.0f}]"
        )
        steps.append(WaterfallBar(_label(part), float(left), float(rest), kind, text))
        left = rest
    return steps
