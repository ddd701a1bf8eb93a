"""Estimates by run or by file: estimates -> arrays -> axes."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from tirefit.data.run_names import clipped
from tirefit.fitting.derived import quantity_of
from tirefit.fitting.result import Estimate, FitResult
from tirefit.report.canvas import BLUE, DARK, GREY, RED, tidy
from tirefit.report.labels import short_run
from tirefit.report.numbers import plain_text

_SAME = 1e-6
"""Two quantities are proportional if their ratio varies by less than this (relative)."""
_MOST_NAMES = 40


class Points(NamedTuple):
    """One quantity of n runs or files: values, 95 % intervals (n,), NaN if open."""

    label: str
    names: tuple[str, ...]
    value: np.ndarray
    low: np.ndarray
    high: np.ndarray
    known: np.ndarray  # (n,) whether the data identify it


def points_of(label: str, names: Sequence[str], estimates: Sequence[Estimate | None]) -> Points:
    """One quantity of several runs or files, in order; None for those without it."""
    nothing = Estimate(np.nan, None, "", (None, None), identified=False)
    given = [nothing if one is None else one for one in estimates]
    ends = np.array([[np.nan if e is None else e for e in one.ci95] for one in given])
    return Points(
        label,
        tuple(names),
        np.array([one.value for one in given], float),
        ends[:, 0].astype(float),
        ends[:, 1].astype(float),
        np.array([one.identified for one in given]),
    )


def has_runs(result: FitResult) -> bool:
    """Whether a parameter has a value for each run."""
    return any("[" in label for label in result.labels)


def _by_run(estimates: Mapping[str, Estimate], result: FitResult) -> list[Points]:
    runs = [str(run) for run in result.data["runs"]]
    names = [short_run(result, run) for run in runs]
    panels = []
    for name in dict.fromkeys(quantity_of(k) for k in estimates if "[" in k):
        own = [estimates.get(f"{name}[{run}]") for run in runs]
        unit = next(one.unit for one in own if one is not None)
        panels.append(points_of(f"{name} [{unit}]", names, own))
    return panels


def run_points(result: FitResult) -> list[Points]:
    """Parameters and derived quantities with a value per run, without derived
    quantities that are proportional to a parameter."""
    return distinct(_by_run(result.parameters, result), _by_run(result.derived, result))


def distinct(first: Sequence[Points], others: Sequence[Points]) -> list[Points]:
    """Quantities, and those of the others that are not proportional to one of them."""
    panels = list(first)
    for points in others:
        if not any(_is_same(points.value, one.value) for one in panels):
            panels.append(points)
    return panels


def _is_same(values: np.ndarray, others: np.ndarray) -> bool:
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = values / others
    finite = ratio[np.isfinite(ratio)]
    return bool(len(finite)) and np.ptp(finite) < _SAME * np.max(np.abs(finite))


def _reach(points: Points) -> tuple[float, float]:
    """Lower and upper end of the axis, by the identified values."""
    rows = points.known & np.isfinite(points.value)
    rows = rows if rows.any() else np.isfinite(points.value)
    ends = np.concatenate([points.value[rows], points.low[rows], points.high[rows]])
    ends = ends[np.isfinite(ends)]
    if len(ends) == 0:
        return 0.0, 1.0
    low, high = float(ends.min()), float(ends.max())
    margin = 0.08 * (high - low) or 0.05 * abs(high) or 1.0
    return low - margin, high + margin


def draw_points(axes, points: Points, named: bool = True) -> None:
    """Draw values with their 95 % intervals; those not identified are open and grey."""
    low, high = _reach(points)
    at = np.arange(len(points.value))
    size = float(np.clip(60 / len(at), 2.0, 5.0))
    for rows, color, face in ((points.known, BLUE, BLUE), (~points.known, GREY, "white")):
        value = np.clip(points.value[rows], low, high)
        first = np.where(np.isnan(points.low), low, np.maximum(points.low, low))[rows]
        last = np.where(np.isnan(points.high), high, np.minimum(points.high, high))
        axes.vlines(at[rows], first, last[rows], color=color, lw=1.4)
        axes.plot(at[rows], value, "o", markersize=size, color=color, markerfacecolor=face)
    missing = np.isnan(points.value)
    if missing.any():
        axes.plot(at[missing], np.full(missing.sum(), low), "x", color=RED, clip_on=False)
    every = -(-len(at) // _MOST_NAMES)
    texts = [plain_text(clipped(name, 18)) for name in points.names[::every]]
    axes.set_xticks(at[::every], texts if named else [])
    tidy(axes)
    axes.set_title(points.label, fontsize=8.5, loc="left", color=DARK, pad=2)
    if named and sum(map(len, texts)) > 60:
        axes.tick_params(axis="x", labelrotation=90, labelsize=7)
    axes.set_xlim(-0.6, len(at) - 0.4)
    axes.set_ylim(low, high)
    axes.grid(axis="y", color=GREY, alpha=0.25, lw=0.5)


def draw_by_name(figure: Any, panels: Sequence[Points]) -> None:
    """Draw one row per quantity, the names below the last."""
    cells = figure.subplots(len(panels), 1, squeeze=False).ravel()
    for axes, points in zip(cells, panels, strict=True):
        draw_points(axes, points, named=axes is cells[-1])
