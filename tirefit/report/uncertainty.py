"""Posterior and profile of the parameters, as arrays."""

from collections.abc import Sequence
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
from tirefit.report.fit_tables import value_text
from tirefit.report.labels import short_label, short_run
from tirefit.report.numbers import plain_text
from tirefit.results import UsageError

_MOST_PAIRS = 20
_MOST_TRACES = 10
_MOST_PROFILES = 24
_TRACE_POINTS = 600


class Corner(NamedTuple):
    """Marginal and joint posterior densities of p parameters."""

    labels: tuple[str, ...]
    edges: np.ndarray  # (p, bins + 1)
    density: np.ndarray  # (p, bins), peaks at 1
    joint: dict[tuple[int, int], np.ndarray]  # (row > column) -> (bins, bins)
    levels: dict[tuple[int, int], tuple[float, float]]  # of contours with 95 %, 50 % inside
    estimate: np.ndarray  # (p,) least squares
    identified: tuple[bool, ...]
    correlation: np.ndarray  # (p, p), NaN where a draw is constant
    values: tuple[str, ...]  # texts
    note: str


class Trace(NamedTuple):
    """Draws of every ensemble in the order of the chain."""

    labels: tuple[str, ...]
    position: np.ndarray  # (m,) from 0 to 1
    draws: np.ndarray  # (ensembles, m, p)
    edges: np.ndarray  # (p, bins + 1)
    density: np.ndarray  # (ensembles, p, bins) of all draws
    rhat: np.ndarray | None  # (p,)
    ess: np.ndarray | None  # (p,)
    note: str  # parameters that are not shown


class ProfilePanel(NamedTuple):
    """Profile of one parameter: deviance (m,) over its values (m,), and 95 % level."""

    label: str
    value: np.ndarray
    deviance: np.ndarray
    parabola: np.ndarray  # (m,) deviance from the covariance alone
    level: float
    best: float
    interval: tuple[float | None, float | None]  # of the profile
    edges: np.ndarray | None  # of the posterior
    density: np.ndarray | None  # of the posterior, peaking at 1
    identified: bool
    logarithmic: bool  # scale of the axis of values


def _spec(result: FitResult, label: str) -> Spec | None:
    elements = dict(result.problem.layout.elements)
    return elements[label].spec if label in elements else None


def symbol(result: FitResult, label: str) -> str:
    """Axis label of a parameter: TeX symbol, run and unit."""
    spec = _spec(result, label)
    _, bracket, run = label.partition("[")
    name = label if spec is None else f"${spec.symbol}$"
    where = ""
    if bracket and spec is not None:
        where = f" ({plain_text(short_run(result, run[:-1]))})"
    return f"{name}{where} [{result.least_squares[label].unit}]"


def _flat(result: FitResult) -> np.ndarray:
    flat = np.asarray(result.chains, float).reshape(-1, len(result.labels))
    return flat[np.all(np.isfinite(flat), axis=1)]


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


def _chosen(result: FitResult, most: int, rank: Sequence[float]) -> tuple[str, ...]:
    """At most ``most`` labels, in order: those not identified first, then by rank."""
    if len(result.labels) <= most:
        return result.labels
    vague = np.array([not result.least_squares[k].identified for k in result.labels])
    best = np.lexsort((-np.asarray(rank, float), ~vague))[:most]
    return tuple(result.labels[i] for i in sorted(best))


def _telling_pairs(result: FitResult) -> tuple[str, ...]:
    """The labels with the strongest correlations."""
    strength = np.abs(np.asarray(result.correlation, float))
    np.fill_diagonal(strength := np.nan_to_num(strength), 0.0)
    return _chosen(result, _MOST_PAIRS, strength.max(axis=1, initial=0.0))


def _indices(result: FitResult, labels: Sequence[str]) -> list[int]:
    return [result.labels.index(label) for label in labels]


def _correlation(flat: np.ndarray) -> np.ndarray:
    centred = flat - flat.mean(axis=0)
    size = np.sqrt(np.sum(centred**2, axis=0))
    size[size < 1e-12 * np.abs(flat).max(axis=0)] = np.nan
    return (centred / size).T @ (centred / size)


def corner_data(result: FitResult, parameters: Sequence[str] | None = None) -> Corner:
    """Marginal and pairwise posterior densities.

    Args:
        parameters: as in :func:`named_labels`; by default the twenty most correlated.
    """
    if parameters is None:
        labels = _telling_pairs(result)
    else:
        labels = named_labels(result, parameters)
    flat = _flat(result)[:, _indices(result, labels)]
    notes = []
    if parameters is None and len(labels) < len(result.labels):
        text = f"{len(labels)} of {len(result.labels)} parameters: not identified"
        notes.append(f"{text}, or correlated most")
    edges = np.array([bin_edges(column) for column in flat.T])
    beyond = np.any((flat < edges[:, 0]) | (flat > edges[:, -1]), axis=1).mean()
    # The axes omit the outermost 0.2 % of the draws of each parameter.
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
    return Corner(
        tuple(symbol(result, label) for label in labels),
        edges,
        density,
        joint,
        levels,
        np.array([result.least_squares[label].value for label in labels]),
        tuple(result.least_squares[label].identified for label in labels),
        _correlation(flat),
        tuple(value_text(result.parameters[label]) for label in labels),
        "; ".join(notes),
    )


def has_trace(result: FitResult) -> bool:
    """Whether the posterior comes from a chain; weighted points have no sequence."""
    chained = result.posterior is None or result.posterior.rhat
    return result.chains is not None and bool(chained)


def _least_mixed(result: FitResult) -> tuple[str, ...]:
    """The labels of largest R-hat."""
    rhat = {} if result.posterior is None else result.posterior.rhat
    ess = {} if result.posterior is None else result.posterior.ess
    rank = [rhat.get(k, 0.0) - 1e-9 * ess.get(k, 0.0) for k in result.labels]
    return _chosen(result, _MOST_TRACES, rank)


def _of_others(result: FitResult, labels: Sequence[str]) -> str:
    """Largest R-hat and smallest ESS of the parameters that are not shown."""
    others = [k for k in result.labels if k not in labels]
    if not others:
        return ""
    text = f"{len(labels)} of {len(result.labels)} parameters"
    summary = result.posterior
    known = [] if summary is None else [k for k in others if k in summary.rhat]
    if summary is None or not known:
        return text
    rhat, ess = max(summary.rhat[k] for k in known), min(summary.ess[k] for k in known)
    return f"{text}; the others: R-hat at most {rhat:.3f}, ESS at least {ess:.0f}"


def trace_data(result: FitResult, parameters: Sequence[str] | None = None) -> Trace:
    """Draws of every ensemble in order, thinned for drawing, and their densities.

    Args:
        parameters: as in :func:`named_labels`; by default the ten of largest R-hat.
    """
    if parameters is None:
        labels = _least_mixed(result)
    else:
        labels = named_labels(result, parameters)
    columns = _indices(result, labels)
    chains = np.asarray(result.chains, float)[..., columns]
    length = chains.shape[1]
    chosen = np.linspace(0, length - 1, min(_TRACE_POINTS, length)).astype(int)
    edges = np.array([bin_edges(column) for column in _flat(result)[:, columns].T])
    density = np.array(
        [
            [marginal_density(ensemble[:, i], edges[i]) for i in range(len(labels))]
            for ensemble in chains
        ]
    )
    rhat = ess = None
    if result.posterior is not None:
        rhat, ess = (
            np.array([record.get(label, np.nan) for label in labels])
            for record in (result.posterior.rhat, result.posterior.ess)
        )
    return Trace(
        tuple(symbol(result, label) for label in labels),
        chosen / max(length - 1, 1),
        chains[:, chosen],
        edges,
        density,
        rhat,
        ess,
        _of_others(result, labels),
    )


def _profile_panel(result: FitResult, label: str, profile) -> ProfilePanel:
    estimate = result.least_squares[label]
    value, deviance = np.asarray(profile["value"]), np.asarray(profile["deviance"])
    level = float(profile["level"])
    rows = near_level(deviance, level)
    spec = _spec(result, label)
    wide = value[rows][-1] > 20 * value[rows][0]
    logarithmic = bool(spec is not None and spec.scale == "log" and wide)
    value, deviance = dense_profile(value[rows], deviance[rows], estimate.value, logarithmic)
    low, high = result.intervals["covariance"][label]
    assert low is not None and high is not None  # this interval is never open
    # At a bound the covariance interval has no width, so its parabola is a vertical line.
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
    """The profile likelihood of at most 24 parameters, with covariance and posterior."""
    differ = result.verdict.disagreements
    shown = _chosen(result, _MOST_PROFILES, [label in differ for label in result.labels])
    return tuple(
        _profile_panel(result, label, result.profiles[label])
        for label in shown
        if label in result.profiles
    )
