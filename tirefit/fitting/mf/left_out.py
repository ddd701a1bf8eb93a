"""Cross-validate a fit on parts of the data, and set its prediction bands by them."""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tirefit.data.levels import levels
from tirefit.fitting.mf.rows import ForceRows
from tirefit.fitting.mf.solve import blocks_of, row_gradients
from tirefit.fitting.mf.stages import Search, without
from tirefit.fitting.noise_law import NoiseLaw, noise_law

LEAVE_OUT = ("three", "load", "bin", "none")
"""What is left out in turn: the bins of three loads (the smallest, a middle one, the
largest), the bins of each load, each bin, or nothing."""

_ROWS = 1500
"""Largest number of rows of a force, evenly taken, that a part is judged by."""

_IN_95 = 1.96

_LEAST = 1e-9
"""Smallest noise relative to the root mean square of the force, for noise-free data."""

_CLEAR = 3.84
"""Deviance of one degree of freedom at the level of 5 %."""

_WIDEST, _TRIED = 30.0, 69
"""Largest factor of the standard errors, and the number of factors (5 % apart) that are
tried."""

_FEWEST_LOADS = 3
"""Smallest number of loads for one to be left out: two others predict it."""


class LeftOut(NamedTuple):
    """One part of the data of a force, predicted by a fit to the other parts.

    ``rmse`` [N, N m] is the root mean square residual of its ``rows`` under that fit,
    ``rmse_of_all`` under the fit to all rows. ``within`` is the share of its rows in
    the 95 % band, which is made without this part.
    """

    label: str
    force: str
    rows: int
    rmse: float
    rmse_of_all: float
    within: float


class Band(NamedTuple):
    """The band of a measurement: its noise law, and the factor by which the standard
    errors of the coefficients are widened."""

    law: NoiseLaw
    wider: float


class _Sample(NamedTuple):
    """A sample of n rows of one part under one fit.

    ``residual`` (n,) is predicted - measured, ``slope`` (n, p) the change of the force
    by one standard deviation along each principal axis of the coefficients' posterior.
    The sample was taken from ``rows`` rows; ``each`` of its rows count as one.
    """

    residual: np.ndarray
    fz: np.ndarray
    predicted: np.ndarray
    slope: np.ndarray
    rows: int
    each: float

    @property
    def rmse(self) -> float:
        return float(np.sqrt(np.mean(self.residual**2)))

    @property
    def variance(self) -> np.ndarray:
        """Variance (n,) of the predicted force from the errors of the coefficients."""
        return np.sum(self.slope**2, axis=1)


def cross_validated(
    work: Search,
    rows: Mapping[str, ForceRows],
    settings: Mapping[str, tuple[Sequence[str], np.ndarray]],
    which: str,
    progress: Callable[[str], None] = lambda text: None,
) -> tuple[tuple[LeftOut, ...], dict[str, Band]]:
    """Leave each part out in turn and predict it; the band of each force follows.

    Args:
        settings: by force, the labels of the settings and the setting (n,) of each row.
        which: of :data:`LEAVE_OUT`.

    Returns:
        The parts, and by force the band. If nothing is left out, the bands are those of
        the fitted rows.
    """
    samples: dict[str, list[tuple[str, _Sample, _Sample]]] = {f: [] for f in rows}
    for label, gone in _parts(rows, settings, which).items():
        progress(f"left out: {label}")
        keeps = {
            force: [~np.isin(group.cells.setting, gone[force]) for group in groups]
            for force, groups in work.groups.items()
        }
        fitted = without(work, keeps)
        for force in fitted.groups:
            own = _chosen(work, rows[force]) & np.isin(settings[force][1], gone[force])
            if np.any(own):
                part, whole = (_sample(fit, rows[force], own) for fit in (fitted, work))
                samples[force].append((label, part, whole))
    found, bands = [], {}
    for force, parts in samples.items():
        for label, part, whole in parts:
            others = [other for _, other, _ in parts if other is not part]
            within = _within(part, _band(others)) if others else float("nan")
            sizes = part.rmse, whole.rmse
            found.append(LeftOut(label, force, part.rows, *sizes, within))
        fitted_rows = [_sample(work, rows[force], _chosen(work, rows[force]))]
        bands[force] = _band([part for _, part, _ in parts] or fitted_rows)
    return tuple(found), bands


def _chosen(work: Search, rows: ForceRows) -> np.ndarray:
    """Which rows (n,) of a force were fitted."""
    return rows.chosen([group.pure for group in work.groups[rows.force]])


def _parts(rows, settings, which: str) -> dict[str, dict[str, list[int]]]:
    """Label of each part -> by force, the settings that are left out together."""
    if which == "none":
        return {}
    labels = {force: list(own) for force, (own, _) in settings.items()}
    chosen = list(dict.fromkeys(label for own in labels.values() for label in own))
    if which != "bin":
        loads = {
            force: [
                np.median(rows[force].column("fz")[code == k]) for k in range(len(own))
            ]
            for force, (own, code) in settings.items()
        }
        center = levels(np.sort(np.concatenate(list(loads.values())))).center
        if len(center) < _FEWEST_LOADS:
            return {}
        edges, names = (
            (center[1:] + center[:-1]) / 2,
            [f"F_z = {c:.0f} N" for c in center],
        )
        labels = {
            force: [names[k] for k in np.searchsorted(edges, own)]
            for force, own in loads.items()
        }
        chosen = names
        if which == "three":
            chosen = [names[k] for k in sorted({0, len(names) // 2, len(names) - 1})]
    return {
        label: {
            force: [k for k, name in enumerate(own) if name == label]
            for force, own in labels.items()
        }
        for label in chosen
    }


def _sample(work: Search, rows: ForceRows, chosen: np.ndarray) -> _Sample:
    """A sample of the ``chosen`` rows, (n,) bool, under the fit ``work``."""
    at = np.flatnonzero(chosen)
    count = len(at)
    if count > _ROWS:
        at = at[np.linspace(0, count - 1, _ROWS).astype(int)]
    some = rows.part(at)
    one = np.full(len(at), 1.0)
    blocks = blocks_of(rows.force, some.inputs, some.observed, one)
    residual, slope = row_gradients(work.problem.with_blocks(blocks), work.u)
    sizes, axes = np.linalg.eigh(work.covariance)
    return _Sample(
        residual=residual,
        fz=some.column("fz"),
        predicted=residual + some.observed,
        slope=slope @ (axes * np.sqrt(np.maximum(sizes, 0.0))),
        rows=count,
        each=max(work.rows_per_one(rows.force) * len(at) / count, 1.0),
    )


def _band(parts: Sequence[_Sample]) -> Band:
    """The band that fits the residuals of the parts best."""
    fz, predicted = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("fz", "predicted")
    )
    residual = np.concatenate([part.residual for part in parts])
    variance = np.concatenate([part.variance for part in parts])
    each = np.concatenate([np.full(len(part.fz), part.each) for part in parts])
    law = noise_law(residual, fz, predicted, variance, each)
    return Band(law, _wider(parts, law))


def _wider(parts: Sequence[_Sample], law: NoiseLaw) -> float:
    """Factor of the standard errors at which the left-out parts are most likely.

    The errors of the coefficients shift the rows of a part together, so the likelihood
    is that of the residuals along the principal directions of each part. The factor is
    one unless it raises the likelihood at the level of 5 %.
    """
    sizes, squares = [], []
    for part in parts:
        least = _LEAST**2 * np.mean(part.predicted**2)
        variance = np.maximum(law.variance(part.fz, part.predicted), least)
        std = np.sqrt(part.each * variance)
        axes, spread, _ = np.linalg.svd(part.slope / std[:, None], full_matrices=False)
        sizes.append(spread**2)
        squares.append((axes.T @ (part.residual / std)) ** 2)
    size, square = np.concatenate(sizes), np.concatenate(squares)

    def deviance(factor):
        variance = 1 + factor * size
        return float(np.sum(np.log(variance) + square / variance))

    factors = np.geomspace(1.0, _WIDEST**2, _TRIED)
    deviances = np.array([deviance(factor) for factor in factors])
    best = int(np.argmin(deviances))
    is_clear = deviances[0] - deviances[best] > _CLEAR
    return float(np.sqrt(factors[best])) if is_clear else 1.0


def _within(one: _Sample, band: Band) -> float:
    """Share of the rows of a sample in the 95 % band."""
    variance = band.law.variance(one.fz, one.predicted) + band.wider**2 * one.variance
    return float(np.mean(np.abs(one.residual) <= _IN_95 * np.sqrt(variance)))
