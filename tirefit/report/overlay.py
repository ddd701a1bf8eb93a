"""Draw the fitted curves of several files in one figure: results -> arrays -> axes."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import matplotlib as mpl
import numpy as np

from tirefit.fitting.bands import force_band
from tirefit.fitting.likelihood import CHANNEL_SLIP
from tirefit.fitting.result import FitResult
from tirefit.models import TireInputs
from tirefit.report.canvas import COLORS, GREY, dots, tidy
from tirefit.report.curves import FORCE_LABEL, Curve, FitCurve, Group, SlipAxis, slip_axis
from tirefit.report.numbers import plain_text
from tirefit.report.panels import legend_below

_POINTS = 160
_MOST_POINTS = 300
_MOST_NAMED = 12  # most files in the legend; with more, it has the first and the last
_OTHER = {"sigma_x": "alpha", "alpha": "sigma_x"}
_NEAR_LOAD, _NEAR_SLIP = 0.1, 0.01
"""A point is drawn with a curve if its load (relative) and other slip differ by less."""
_SAME_LOAD = 0.02  # relative spread of the loads up to which forces are drawn in newtons


def _slips(result: FitResult, channel: str) -> np.ndarray:
    problem = result.problem
    return problem.used(getattr(problem.rows.inputs, CHANNEL_SLIP[channel]))


def _conditions(result: FitResult, slip: str) -> dict[str, float]:
    """Medians of the inputs; the other slip is zero if the rows include zero."""
    problem = result.problem
    columns = {k: problem.used(v) for k, v in problem.rows.inputs._asdict().items() if k != slip}
    middle = {k: float(np.median(v)) for k, v in columns.items()}
    other = _OTHER[slip]
    if columns[other].min() <= 0 <= columns[other].max():
        middle[other] = 0.0
    return middle


def _drawn(
    result: FitResult, name: str, channel: str, axis: SlipAxis, over_load: bool
) -> tuple[Group, Curve]:
    """Some measured points of one file, and its curve over the range of slip of its rows."""
    problem, slip = result.problem, CHANNEL_SLIP[channel]
    slips, middle = _slips(result, channel), _conditions(result, slip)
    first, last = axis.shown(np.array([min(slips.min(), 0.0), max(slips.max(), 0.0)]))
    grid = np.asarray(axis.canonical(np.linspace(first, last, _POINTS)), float)
    columns = {k: np.full(_POINTS, v) for k, v in middle.items()} | {slip: grid}
    inputs = TireInputs(**{k: jnp.asarray(v) for k, v in columns.items()})
    band = force_band(result, channel, inputs, np.zeros(_POINTS, int), np.zeros(_POINTS))
    unit = middle["fz"] if over_load else 1.0
    near = _near(result, slip, middle)
    near = near[:: -(-len(near) // _MOST_POINTS) or 1]
    load = problem.used(problem.rows.inputs.fz) if over_load else 1.0
    measured = problem.used(problem.rows.observed[channel]) / load
    ends = band.low / unit, band.high / unit
    group = Group(name, axis.shown(slips)[near], measured[near])
    return group, Curve(name, axis.shown(grid), band.force / unit, *ends, *ends, None)


def _near(result: FitResult, slip: str, middle: Mapping[str, float]) -> np.ndarray:
    """The rows (n,) at about the load and the other slip of the curve."""
    problem = result.problem
    inputs, other = problem.rows.inputs, _OTHER[slip]
    load, aside = problem.used(inputs.fz), problem.used(getattr(inputs, other))
    near = np.abs(load - middle["fz"]) <= _NEAR_LOAD * middle["fz"]
    return np.flatnonzero(near & (np.abs(aside - middle[other]) <= _NEAR_SLIP))


def overlay_of(fits: Mapping[str, FitResult], channel: str) -> FitCurve:
    """The curves of all fits that have this force, each at the median load of its rows.

    If the loads differ by more than 2 %, forces are divided by the load. A parameter per
    run has its value in the first run.
    """
    given = {k: r for k, r in fits.items() if channel in r.forces}
    slips = np.concatenate([_slips(r, channel) for r in given.values()])
    axis = slip_axis(CHANNEL_SLIP[channel], slips)
    loads = [r.reference["fz"] for r in given.values()]
    over_load = np.ptp(loads) > _SAME_LOAD * np.median(loads)
    name, unit, ratio = FORCE_LABEL[channel]
    y_label = f"{name} [{unit}]"
    note = f"at $F_z$ = {np.median(loads):.4g} N"
    if over_load:
        y_label = f"{ratio} [{'m' if channel == 'mz' else '-'}]"
        note = f"each at its own median load, {min(loads):.4g} to {max(loads):.4g} N"
    each = [_drawn(one, name, channel, axis, bool(over_load)) for name, one in given.items()]
    groups, curves = zip(*each, strict=True)
    return FitCurve(channel, f"{axis.label} [{axis.unit}]", y_label, groups, curves, "", note)


def _colors(count: int) -> Sequence:
    if count <= len(COLORS):
        return COLORS[:count]
    return list(mpl.colormaps["viridis"](np.linspace(0, 0.92, count)))


def draw_overlay(figure: Any, overlay: FitCurve) -> None:
    """Draw each curve in its colour; with many files, colours follow their order."""
    axes, count = figure.subplots(), len(overlay.curves)
    for i, (group, one, color) in enumerate(
        zip(overlay.groups, overlay.curves, _colors(count), strict=True)
    ):
        if count <= len(COLORS):
            dots(axes, group.slip, group.force, 2, color, 0.3)
        named = count <= _MOST_NAMED or i in (0, count - 1)
        label = plain_text(one.label) if named else None
        axes.fill_between(one.slip, one.low, one.high, color=color, alpha=0.3, lw=0)
        axes.plot(one.slip, one.force, color=color, lw=1.3, label=label)
    axes.axhline(0, color=GREY, lw=0.5, zorder=0)
    tidy(axes, overlay.x_label, overlay.y_label)
    title = overlay.note if count <= _MOST_NAMED else f"{overlay.note}; first and last"
    legend_below(figure, axes.get_legend_handles_labels()[0], title, 3)
