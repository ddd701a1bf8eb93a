"""What a fit foretells of bins that it did not see, and the bands that follow."""

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
largest), of each load, each bin; or none."""

_ROWS = 1500
"""Rows of a force, evenly taken, that a left-out part is judged by."""

_IN_95 = 1.96

_LEAST = 1e-9
"""Noise over the root mean square of the force, at least: of data without any."""

_CLEAR = 3.84
"""Deviance of one degree of freedom at the level of 5 %."""

_WIDEST, _TRIED = 30.0, 69
"""Largest factor of the standard errors that is tried, and how many, 5 % apart."""

_FEWEST_LOADS = 3
"""Loads of a test, at least, of which one is left out: two others foretell it."""


class LeftOut(NamedTuple):
    """One part of the data that a fit of the others foretells: root mean square of what
    its rows miss [N, N m], that of the fit of all, and the share of rows within the
    95 % band, which is made without this part."""

    label: str
    force: str
    rows: int
    rmse: float
    rmse_of_all: float
    within: float


class Band(NamedTuple):
    """Band of a measurement: its noise law, and by how much the standard errors of the
    coefficients are widened."""

    law: NoiseLaw
    wider: float


class _Seen(NamedTuple):
    """Some rows (n,) of one part: what they miss, their load and predicted force.

    ``slope`` (n, p): what one standard deviation along each axis of the coefficients'
    posterior adds to the force; ``rows``: of how many these are taken, and ``each``:
    how many of these count as one.
    """

    missed: np.ndarray
    fz: np.ndarray
    predicted: np.ndarray
    slope: np.ndarray
    rows: int
    each: float

    @property
    def rmse(self) -> float:
        return float(np.sqrt(np.mean(self.missed**2)))

    @property
    def variance(self) -> np.ndarray:
        """That the coefficients give each row, (n,)."""
        return np.sum(self.slope**2, axis=1)


def foretold(
    work: Search,
    rows: Mapping[str, ForceRows],
    settings: Mapping[str, tuple[Sequence[str], np.ndarray]],
    which: str,
    progress: Callable[[str], None] = lambda text: None,
) -> tuple[tuple[LeftOut, ...], dict[str, Band]]:
    """Each part left out in turn, and the band of each force that this gives.

    Args:
        settings: by force, the labels of the settings and the setting (n,) of each row.
        which: of :data:`LEAVE_OUT`.

    Returns:
        What was left out, and the bands. Their noise is at least that of the fitted
        rows, which make the band too where fewer than two parts were left out; a
        single part has no other to be judged by: ``within`` is NaN.
    """
    seen: dict[str, list[tuple[str, _Seen, _Seen]]] = {force: [] for force in rows}
    for label, gone in _parts(rows, settings, which):
        progress(f"left out: {label}")
        keeps = {
            force: [~np.isin(group.cells.setting, gone[force]) for group in groups]
            for force, groups in work.groups.items()
        }
        fitted = without(work, keeps)
        for force in fitted.groups:
            own = _chosen(work, rows[force]) & np.isin(settings[force][1], gone[force])
            if np.any(own):
                part, whole = (_seen(one, rows[force], own) for one in (fitted, work))
                seen[force].append((label, part, whole))
    found, bands = [], {}
    for force, parts in seen.items():
        for label, part, whole in parts:
            others = [other for _, other, _ in parts if other is not part]
            within = _within(part, _band(others)) if others else float("nan")
            found.append(
                LeftOut(label, force, part.rows, part.rmse, whole.rmse, within)
            )
        of_band = [part for _, part, _ in parts]
        fitted_rows = _seen(work, rows[force], _chosen(work, rows[force]))
        if len(of_band) < 2:
            of_band.append(fitted_rows)
        # What others' coefficients made of a part, its noise makes where it is fitted.
        least = _band([fitted_rows]).law
        law = NoiseLaw(*map(max, least, _band(of_band).law))
        bands[force] = Band(law, _wider(of_band, law))
    return tuple(found), bands


def _chosen(work: Search, rows: ForceRows) -> np.ndarray:
    """Rows (n,) of a force that were fitted."""
    return rows.chosen([group.pure for group in work.groups[rows.force]])


def _parts(rows, settings, which: str) -> list[tuple[str, dict[str, list[int]]]]:
    """Label -> by force, the settings that are left out together."""
    if which == "none":
        return []
    if which == "bin":
        labels = dict.fromkeys(label for own, _ in settings.values() for label in own)
        return [
            (
                label,
                {
                    force: [k for k, name in enumerate(own) if name == label]
                    for force, (own, _) in settings.items()
                },
            )
            for label in labels
        ]
    loads = {
        force: np.array(
            [np.median(rows[force].column("fz")[code == k]) for k in range(len(own))]
        )
        for force, (own, code) in settings.items()
    }
    # Each twice: to `levels` a value that stands alone is no level.
    center = levels(np.repeat(np.concatenate(list(loads.values())), 2)).center
    if len(center) < _FEWEST_LOADS:
        return []
    chosen = list(range(len(center)))
    if which == "three":
        chosen = sorted({0, len(center) // 2, len(center) - 1})
    edges = (center[1:] + center[:-1]) / 2
    return [
        (
            f"F_z = {center[k]:.0f} N",
            {
                force: np.flatnonzero(np.searchsorted(edges, own) == k).tolist()
                for force, own in loads.items()
            },
        )
        for k in chosen
    ]


def _seen(work: Search, rows: ForceRows, chosen: np.ndarray) -> _Seen:
    at = np.flatnonzero(chosen)
    count = len(at)
    if count > _ROWS:
        at = at[np.linspace(0, count - 1, _ROWS).astype(int)]
    some = rows.part(at)
    one = np.full(len(at), 1.0)
    blocks = blocks_of(rows.force, some.inputs, some.observed, one)
    missed, slope = row_gradients(work.problem.with_blocks(blocks), work.u)
    sizes, axes = np.linalg.eigh(work.covariance)
    return _Seen(
        missed=missed,
        fz=some.column("fz"),
        predicted=missed + some.observed,
        slope=slope @ (axes * np.sqrt(np.maximum(sizes, 0.0))),
        rows=count,
        each=max(work.rows_per_one(rows.force) * len(at) / count, 1.0),
    )


def _band(parts: Sequence[_Seen]) -> Band:
    """The band that rows of left-out parts follow."""
    fz, predicted = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("fz", "predicted")
    )
    missed = np.concatenate([part.missed for part in parts])
    variance = np.concatenate([part.variance for part in parts])
    each = np.concatenate([np.full(len(part.fz), part.each) for part in parts])
    law = noise_law(missed, fz, predicted, variance, each)
    return Band(law, _wider(parts, law))


def _wider(parts: Sequence[_Seen], law: NoiseLaw) -> float:
    """Factor of the standard errors that makes left-out parts most likely.

    What the coefficients' errors do to a part is common to its rows: only as many
    directions count as stand out of the noise. One, where the likelihood does not rise
    at the level of 5 %.
    """
    sizes, squares = [], []
    for part in parts:
        least = _LEAST**2 * np.mean(part.predicted**2)
        variance = np.maximum(law.variance(part.fz, part.predicted), least)
        std = np.sqrt(part.each * variance)
        axes, spread, _ = np.linalg.svd(part.slope / std[:, None], full_matrices=False)
        sizes.append(spread**2)
        squares.append((axes.T @ (part.missed / std)) ** 2)
    size, square = np.concatenate(sizes), np.concatenate(squares)

    def deviance(factor):
        variance = 1 + factor * size
        return float(np.sum(np.log(variance) + square / variance))

    factors = np.geomspace(1.0, _WIDEST**2, _TRIED)
    deviances = np.array([deviance(factor) for factor in factors])
    best = int(np.argmin(deviances))
    is_clear = deviances[0] - deviances[best] > _CLEAR
    return float(np.sqrt(factors[best])) if is_clear else 1.0


def _within(one: _Seen, band: Band) -> float:
    variance = band.law.variance(one.fz, one.predicted) + band.wider**2 * one.variance
    return float(np.mean(np.abs(one.missed) <= _IN_95 * np.sqrt(variance)))
