"""Posterior and profile of the parameters, as arrays."""

from typing import NamedTuple

import numpy as np

from tirefit.fitting.marginals import (
    bin_edges,
    dense_profile,
    enclosing,
    joint_density,
    marginal_density,
    near_level,
)
from tirefit.fitting.result import FitResult
from tirefit.params import Spec
from tirefit.report.numbers import plain_text

__all__ = [
    "Corner",
    "ProfilePanel",
    "Trace",
    "corner_data",
    "has_trace",
    "profile_data",
    "symbol",
    "trace_data",
]

_MOST = 12
_TRACE_POINTS = 600


class Corner(NamedTuple):
    """Marginal and joint posterior densities of p parameters.

    ``edges`` (p, bins + 1); ``density`` (p, bins) peaks at 1; ``joint`` maps (row,
    column), row > column, to a density (bins, bins) over (row, column), and ``levels``
    the same key to the densities that enclose 95 % and 50 %. ``interval`` (p, 2) and
    ``median`` (p,) are of the posterior, ``estimate`` (p,) is least squares.
    """

    labels: tuple[str, ...]
    edges: np.ndarray
    density: np.ndarray
    joint: dict[tuple[int, int], np.ndarray]
    levels: dict[tuple[int, int], tuple[float, float]]
    interval: np.ndarray
    median: np.ndarray
    estimate: np.ndarray
    identified: tuple[bool, ...]
    note: str


class Trace(NamedTuple):
    """Draws of every ensemble over the length of the chain.

    ``position`` (m,) from 0 to 1; ``draws`` (ensembles, m, p); ``edges``
    (p, bins + 1) and ``density`` (ensembles, p, bins) of all draws; ``rhat`` and
    ``ess`` (p,) or None.
    """

    labels: tuple[str, ...]
    position: np.ndarray
    draws: np.ndarray
    edges: np.ndarray
    density: np.ndarray
    rhat: np.ndarray | None
    ess: np.ndarray | None


class ProfilePanel(NamedTuple):
    """Profile of one parameter: deviance (m,) over its values (m,), and 95 % level.

    ``parabola`` (m,) is what the covariance alone would give; ``edges`` and
    ``density`` are the posterior's, peaking at 1, or None; ``interval`` is the
    profile's; ``logarithmic`` says how the values are to be drawn.
    """

    label: str
    value: np.ndarray
    deviance: np.ndarray
    parabola: np.ndarray
    level: float
    best: float
    interval: tuple[float | None, float | None]
    edges: np.ndarray | None
    density: np.ndarray | None
    identified: bool
    logarithmic: bool


def _spec(result: FitResult, label: str) -> Spec | None:
    if result.problem is None:
        return None
    elements = dict(result.problem.layout.elements)
    return elements[label].spec if label in elements else None


def symbol(result: FitResult, label: str) -> str:
    """Axis label of a parameter: TeX symbol, run and unit."""
    spec = _spec(result, label)
    _, bracket, run = label.partition("[")
    name = label if spec is None else f"${spec.symbol}$"
    where = f" ({plain_text(run.rstrip(']'))})" if bracket and spec is not None else ""
    return f"{name}{where} [{result.least_squares[label].unit}]"


def _flat(result: FitResult) -> np.ndarray:
    flat = np.asarray(result.chains, float).reshape(-1, len(result.labels))
    return flat[np.all(np.isfinite(flat), axis=1)]


def corner_data(result: FitResult) -> Corner:
    """Marginal and pairwise posterior densities of at most twelve parameters."""
    flat, labels = _flat(result)[:, :_MOST], result.labels[:_MOST]
    left_out = len(result.labels) - len(labels)
    notes = [f"{_MOST} of {len(result.labels)} parameters shown"] if left_out else []
    edges = np.array([bin_edges(column) for column in flat.T])
    beyond = np.any((flat < edges[:, 0]) | (flat > edges[:, -1]), axis=1).mean()
    # The outermost 0.2 % of each parameter are never drawn.
    if beyond > 0.002 * (len(labels) + 1):
        notes.append(f"{100 * beyond:.1f} % of the draws lie beyond the axes")
    density = np.array(
        [marginal_density(column, e) for column, e in zip(flat.T, edges, strict=True)]
    )
    joint, levels = {}, {}
    for i in range(len(labels)):
        for j in range(i):
            pair = edges[i], edges[j]
            joint[i, j] = joint_density(flat[:, i], flat[:, j], pair)
            levels[i, j] = enclosing(joint[i, j], (0.95, 0.5))
    low, median, high = np.quantile(flat, [0.025, 0.5, 0.975], axis=0)
    return Corner(
        tuple(symbol(result, label) for label in labels), edges, density, joint, levels,
        np.stack([low, high], axis=1), median,
        np.array([result.least_squares[label].value for label in labels]),
        tuple(result.least_squares[label].identified for label in labels),
        "; ".join(notes),
    )  # fmt: skip


def has_trace(result: FitResult) -> bool:
    """Whether the posterior comes from a chain: weighted points have no order."""
    chained = result.posterior is None or result.posterior.rhat
    return result.chains is not None and bool(chained)


def trace_data(result: FitResult) -> Trace:
    """Draws of every ensemble in order, thinned for drawing, and their densities."""
    chains = np.asarray(result.chains, float)[..., :_MOST]
    labels = result.labels[:_MOST]
    length = chains.shape[1]
    chosen = np.linspace(0, length - 1, min(_TRACE_POINTS, length)).astype(int)
    edges = np.array([bin_edges(column) for column in _flat(result)[:, :_MOST].T])
    density = np.array(
        [
            [marginal_density(ensemble[:, i], edges[i]) for i in range(len(labels))]
            for ensemble in chains
        ]
    )
    summary = result.posterior
    rhat, ess = (
        (None, None)
        if summary is None
        else (
            np.array([record.get(label, np.nan) for label in labels])
            for record in (summary.rhat, summary.ess)
        )
    )
    return Trace(
        tuple(symbol(result, label) for label in labels), chosen / max(length - 1, 1),
        chains[:, chosen], edges, density, rhat, ess,
    )  # fmt: skip


def _profile_panel(result: FitResult, label: str, profile) -> ProfilePanel:
    estimate = result.least_squares[label]
    value, deviance = np.asarray(profile["value"]), np.asarray(profile["deviance"])
    level = float(profile["level"])
    rows = near_level(deviance, level)
    spec = _spec(result, label)
    wide = value[rows][-1] > 20 * value[rows][0]
    logarithmic = bool(spec is not None and spec.scale == "log" and wide)
    value, deviance = dense_profile(
        value[rows], deviance[rows], estimate.value, logarithmic
    )
    low, high = result.intervals["covariance"][label]
    assert low is not None and high is not None  # it is never open
    # At a bound the covariance interval has no width, and its parabola is a line up.
    half = max((high - low) / 2, 1e-9 * max(abs(low), abs(high), 1e-300))
    parabola = level * ((value - (low + high) / 2) / half) ** 2
    edges = density = None
    if result.chains is not None:
        draws = _flat(result)[:, result.labels.index(label)]
        edges = bin_edges(draws)
        density = marginal_density(draws, edges)
    return ProfilePanel(
        symbol(result, label), value, deviance, parabola, level, estimate.value,
        result.intervals["profile"][label], edges, density, estimate.identified,
        logarithmic,
    )  # fmt: skip


def profile_data(result: FitResult) -> tuple[ProfilePanel, ...]:
    """Profile likelihood of at most twelve parameters beside the other two routes."""
    return tuple(
        _profile_panel(result, label, result.profiles[label])
        for label in list(result.profiles)[:_MOST]
    )
