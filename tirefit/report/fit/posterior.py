"""Posterior, chains and profile likelihood of the parameters: arrays and panels."""

from collections.abc import Sequence
from functools import partial
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter

from tirefit.fitting.result import FitResult
from tirefit.report.canvas import BLUE, COLORS, DARK, ORANGE, RED, WIDE, Panel, tidy
from tirefit.report.fit.tables import short_label, short_run, value_text
from tirefit.report.numbers import plain_text
from tirefit.results import UsageError

_MOST = 10  # largest number of parameters of a figure that are not asked for by name
_CELL = 1.1  # width of a cell of the corner [in]


def bin_edges(draws: np.ndarray) -> np.ndarray:
    """Edges (37,) of bins over the draws, never of zero width.

    From the median they end at four times the distance to the end of the central 68.27 % on that
    side, 4 standard deviations of a Gaussian: a rare bulk far away does not stretch the axis.
    """
    low, left, median, right, high = np.quantile(draws, (0, 0.15866, 0.5, 0.84134, 1))
    low, high = max(low, 4 * left - 3 * median), min(high, 4 * right - 3 * median)
    size = abs(median) or 1.0
    if high - low < 1e-6 * size:
        low, high = low - 0.01 * size, high + 0.01 * size
    return np.linspace(low, high, 37)


def _smooth(counts: np.ndarray) -> np.ndarray:
    """Counts convolved with a Gaussian, whose standard deviation is one bin."""
    return gaussian_filter(counts.astype(float), 1.0, mode="constant")


def marginal_density(draws: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Smoothed density (bins,) of the draws (m,), which peaks at 1."""
    counts = _smooth(np.histogram(draws, edges)[0])
    return counts / max(float(counts.max()), 1e-300)


def joint_density(first: np.ndarray, second: np.ndarray, edges: Sequence[np.ndarray]) -> np.ndarray:
    """Smoothed counts (bins, bins) of two parameters' draws (m,), one pair of edges."""
    return _smooth(np.histogram2d(first, second, edges)[0])


def enclosing(density: np.ndarray, shares: tuple[float, float]) -> tuple[float, float]:
    """Densities whose contours enclose these shares, decreasing shares, increasing."""
    order = np.sort(density.ravel())[::-1]
    share = np.cumsum(order) / order.sum()
    outer, inner = (float(order[np.searchsorted(share, s)]) for s in shares)
    return outer, inner


def near_level(deviance: np.ndarray, level: float) -> np.ndarray:
    """Which points (m,) of a profile are drawn: those up to a margin above a level."""
    near = np.flatnonzero(deviance <= 2.5 * level)
    rows = np.zeros(len(deviance), bool)
    rows[max(near[0] - 1, 0) : near[-1] + 2] = True
    return rows & np.isfinite(deviance)


def dense_profile(
    value: np.ndarray, deviance: np.ndarray, best: float, logarithmic: bool
) -> tuple[np.ndarray, np.ndarray]:
    """A profile on a dense grid, interpolated by its signed root (linear if quadratic)."""
    value, first = np.unique(value, return_index=True)
    root = np.sign(value - best) * np.sqrt(np.maximum(deviance[first], 0.0))
    space = np.geomspace if logarithmic else np.linspace
    grid = np.clip(space(value[0], value[-1], 300), value[0], value[-1])
    return grid, np.interp(grid, value, root) ** 2


class ProfileCurve(NamedTuple):
    """Profile of one parameter: deviance (m,) over its values (m,), and 95 % level."""

    label: str
    value: np.ndarray
    deviance: np.ndarray
    parabola: np.ndarray  # (m,) deviance from the covariance alone
    level: float
    best: float
    interval: tuple[float | None, float | None]  # of the profile
    logarithmic: bool  # scale of the axis of values


def symbol(result: FitResult, label: str) -> str:
    """Axis label of a parameter: TeX symbol, run and unit."""
    elements = dict(result.problem.layout.elements)
    name, bracket, run = label.partition("[")
    if label in elements:
        where = f" ({plain_text(short_run(result, run[:-1]))})" if bracket else ""
        label = f"${elements[label].spec.symbol}$"
        return f"{label}{where} [{result.least_squares[name + bracket + run].unit}]"
    return f"{label} [{result.least_squares[label].unit}]"


def draws_of(result: FitResult, labels: Sequence[str]) -> np.ndarray:
    """The finite posterior draws (m, p) of these parameters."""
    flat = np.asarray(result.chains, float).reshape(-1, len(result.labels))
    flat = flat[np.all(np.isfinite(flat), axis=1)]
    return flat[:, [result.labels.index(label) for label in labels]]


def named_labels(result: FitResult, parameters: Sequence[str]) -> tuple[str, ...]:
    """The labels of the named parameters, in the order of the fit.

    Args:
        parameters: labels as in the report or in ``fit.json``; the name of a parameter
            per run includes all runs.

    Raises:
        UsageError: the fit has no such free parameter.
    """
    known = {
        label: {label, short_label(result, label), label.partition("[")[0]}
        for label in result.labels
    }
    wrong = [p for p in parameters if not any(p in names for names in known.values())]
    if wrong or not parameters:
        reason = f"this fit has no free parameter {', '.join(wrong) or '(none given)'}"
        shown = ", ".join(short_label(result, label) for label in result.labels)
        raise UsageError(reason, f"it has {shown}")
    return tuple(k for k, names in known.items() if names & set(parameters))


def _chosen(
    result: FitResult, rank: Sequence[float], asked: Sequence[str] | None = None
) -> tuple[tuple[str, ...], str]:
    """The labels ``asked`` for, or at most ten, in order, and a note on them: those not
    identified first, then by rank."""
    if asked is not None:
        return named_labels(result, asked), ""
    if len(result.labels) <= _MOST:
        return result.labels, ""
    known = np.array([result.least_squares[k].identified for k in result.labels])
    best = np.lexsort((-np.asarray(rank, float), known))[:_MOST]
    note = f"{_MOST} of {len(result.labels)} parameters (others: plot(..., parameters=[...]))"
    return tuple(result.labels[i] for i in sorted(best)), note


def corner_panels(result: FitResult, parameters: Sequence[str] | None = None) -> list[Panel]:
    """The posterior of every parameter and every pair as a grid of cells.

    Args:
        parameters: as in :func:`named_labels`; by default the ten most correlated.
    """
    strength = np.abs(np.nan_to_num(np.asarray(result.correlation, float)))
    np.fill_diagonal(strength, 0.0)
    labels, note = _chosen(result, strength.max(axis=1, initial=0.0), parameters)
    count = len(labels)
    size = max(_CELL * count + 0.8, WIDE), _CELL * count + 0.9
    regions = "contours: 50 and 95 % of the draws; red: least squares"
    draw, text = partial(_draw_corner, result=result, labels=labels), "Posterior of every pair"
    return [Panel(draw, text, size, "\n".join(filter(None, (regions, note))), count > 3)]


def _draw_corner(figure: Any, result: FitResult, labels: Sequence[str]) -> None:
    """Densities of single parameters on the diagonal, contours of pairs below it."""
    draws, count = draws_of(result, labels), len(labels)
    edges = [bin_edges(column) for column in draws.T]
    centers = [(edge[1:] + edge[:-1]) / 2 for edge in edges]
    names = [symbol(result, label) for label in labels]
    values = [result.least_squares[label].value for label in labels]
    cells = figure.subplots(count, count, squeeze=False, sharex="col")
    for i, (axes, label) in enumerate(zip(np.diag(cells), labels, strict=True)):
        axes.stairs(marginal_density(draws[:, i], edges[i]), edges[i], color=BLUE, fill=True)
        axes.set_yticks([])
        color = DARK if result.least_squares[label].identified else RED
        text = value_text(result.parameters[label]).replace(" ± ", "\n± ")
        axes.set_title(text, fontsize=7, color=color, pad=2)
    for j, i in combinations(range(count), 2):
        joint = joint_density(draws[:, j], draws[:, i], (edges[j], edges[i]))
        levels = [*enclosing(joint, (0.95, 0.5)), joint.max()]
        if levels[0] < levels[1] < levels[2]:
            cells[i, j].contourf(centers[j], centers[i], joint.T, levels, colors=("#9ecae8", BLUE))
        cells[i, j].set_ylim(edges[i][0], edges[i][-1])
        cells[i, j].axhline(values[i], color=RED, lw=0.7)
        cells[j, i].remove()
    for row, column in np.argwhere(np.tri(count)).tolist():
        axes, is_last, is_first = cells[row, column], row == count - 1, column == 0 < row
        tidy(axes, names[column] * is_last, names[row] * is_first, 8)
        axes.axvline(values[column], color=RED, lw=0.7)
        axes.set_xlim(edges[column][0], edges[column][-1])
        axes.locator_params(axis="x", nbins=3)
        axes.tick_params(labelsize=6, labelbottom=is_last, labelleft=is_first)
        axes.tick_params(axis="x", labelrotation=45)


def has_trace(result: FitResult) -> bool:
    """Whether the posterior comes from a chain; weighted points have no sequence."""
    chained = result.posterior is None or result.posterior.rhat
    return result.chains is not None and bool(chained)


def trace_panels(result: FitResult, parameters: Sequence[str] | None = None) -> list[Panel]:
    """Posterior draws in order, a colour for each ensemble.

    Args:
        parameters: as in :func:`named_labels`; by default the ten of largest R-hat.
    """
    rhat = {} if result.posterior is None else result.posterior.rhat
    labels, note = _chosen(result, [rhat.get(k, 0.0) for k in result.labels], parameters)
    draw, size = partial(_draw_trace, result=result, labels=labels), 0.6 + 1.1 * len(labels)
    return [Panel(draw, "Draws of every ensemble in order", (WIDE, size), note)]


def _draw_trace(figure: Any, result: FitResult, labels: Sequence[str]) -> None:
    chains = np.asarray(result.chains, float)
    length = chains.shape[1]
    some = np.linspace(0, length - 1, min(600, length)).astype(int)
    cells = figure.subplots(len(labels), 1, squeeze=False, sharex=True).ravel()
    for axes, label in zip(cells, labels, strict=True):
        for k, chain in enumerate(chains[:, some, result.labels.index(label)]):
            axes.plot(some, chain, color=COLORS[k % len(COLORS)], lw=0.4, alpha=0.6)
        tidy(axes, "step of the kept chain" * (axes is cells[-1]))
        axes.set_title(symbol(result, label), fontsize=8.5, loc="left", color=DARK, pad=2)
        axes.set_xlim(0, max(length - 1, 1))


def _profile(result: FitResult, label: str) -> ProfileCurve:
    estimate, profile = result.least_squares[label], result.profiles[label]
    value, deviance = np.asarray(profile["value"]), np.asarray(profile["deviance"])
    level = float(profile["level"])
    rows = near_level(deviance, level)
    elements = dict(result.problem.layout.elements)
    in_logs = label in elements and elements[label].spec.scale == "log"
    logarithmic = bool(in_logs and value[rows][-1] > 20 * value[rows][0])
    value, deviance = dense_profile(value[rows], deviance[rows], estimate.value, logarithmic)
    low, high = result.intervals["covariance"][label]
    assert low is not None and high is not None  # this interval is never open
    # At a bound the covariance interval has no width, so its parabola is a vertical line.
    half = max((high - low) / 2, 1e-9 * max(abs(low), abs(high), 1e-300))
    parabola = level * ((value - (low + high) / 2) / half) ** 2
    name = symbol(result, label) + "\n(not identified)" * (not estimate.identified)
    ends = result.intervals["profile"][label]
    return ProfileCurve(name, value, deviance, parabola, level, estimate.value, ends, logarithmic)


def profiles_of(result: FitResult) -> tuple[list[ProfileCurve], str]:
    """The profile likelihood of at most ten parameters, and a note on them."""
    differ = result.verdict.disagreements
    labels, note = _chosen(result, [label in differ for label in result.labels])
    return [_profile(result, label) for label in labels if label in result.profiles], note


def profile_panels(result: FitResult) -> list[Panel]:
    """Profile likelihood and covariance of the parameters."""
    curves, note = profiles_of(result)
    text, size = "Profile likelihood and covariance of parameters", 0.4 + 2.1 * -(-len(curves) // 2)
    return [Panel(partial(_draw_profiles, curves=curves), text, (WIDE, size), note)]


def _draw_profiles(figure: Any, curves: Sequence[ProfileCurve]) -> None:
    """Profile deviance, its 95 % level and the covariance's parabola, in two columns."""
    shape = -(-len(curves) // 2), min(len(curves), 2)
    cells = figure.subplots(*shape, squeeze=False).ravel()
    for i, (axes, curve) in enumerate(zip(cells, curves, strict=False)):
        axes.plot(curve.value, curve.parabola, color=ORANGE, lw=1.2, ls="--", label="covariance")
        axes.plot(curve.value, curve.deviance, color=BLUE, lw=1.6, label="profile")
        axes.axhline(curve.level, color=DARK, lw=0.7, ls=":")
        ends = [end for end in curve.interval if end is not None]
        axes.vlines(ends, 0, curve.level, color=BLUE, lw=0.7)
        axes.plot(curve.best, 0, marker="o", color=RED, markersize=4, clip_on=False)
        if curve.logarithmic:
            axes.set_xscale("log")
        else:
            axes.locator_params(axis="x", nbins=4)
        axes.locator_params(axis="y", nbins=5)
        axes.set_ylim(0, 2.2 * curve.level)
        tidy(axes, curve.label, r"$-2\,\Delta\log L$" * (i % 2 == 0))
    for axes in cells[len(curves) :]:
        axes.remove()
    handles, labels = cells[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=3, fontsize=8, frameon=False)
