"""What a fit foretells of bins that it did not see, and the bands that follow."""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from tirefit.data.levels import levels
from tirefit.fitting.mf.parts import own_coefficients
from tirefit.fitting.mf.rows import ForceRows
from tirefit.fitting.mf.solve import blocks_of, propagated
from tirefit.fitting.mf.stages import Search, without
from tirefit.fitting.noise_law import NoiseLaw, noise_law

LEAVE_OUT = ("three", "load", "bin", "none")
"""What is left out in turn: the bins of three loads (the smallest, a middle one, the
largest), of each load, each bin; or none."""

_ROWS = 1500
"""Rows of a force, evenly taken, that a left-out part is judged by."""

_IN_95 = 1.96

_CHANCE = 0.05
"""Probability by chance of shifts for which the standard errors are not widened."""

_TOLD = 0.1
"""Growth of a variance, without the part, from which on the part determines it."""

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
    """Some rows (n,) of one part: what they miss, their load, predicted force and the
    variance that the coefficients give it.

    ``rows``: of how many these are taken, and ``each``: how many of these count as
    one; ``shift``: see :func:`_shift`.
    """

    missed: np.ndarray
    fz: np.ndarray
    predicted: np.ndarray
    variance: np.ndarray
    rows: int
    each: float
    shift: tuple[float, int]

    @property
    def rmse(self) -> float:
        return float(np.sqrt(np.mean(self.missed**2)))


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
        What was left out, and the bands. A single part has no other to be judged by:
        its ``within`` is NaN.
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
                part = _seen(fitted, rows[force], own, _shift(fitted, work, force))
                whole = _seen(work, rows[force], own)
                seen[force].append((label, part, whole))
    found, bands = [], {}
    for force, parts in seen.items():
        fitted_rows = _seen(work, rows[force], _chosen(work, rows[force]))
        for label, part, whole in parts:
            others = [other for _, other, _ in parts if other is not part]
            band = _band(others, fitted_rows)
            within = _within(part, band) if others else float("nan")
            found.append(
                LeftOut(label, force, part.rows, part.rmse, whole.rmse, within)
            )
        bands[force] = _band([part for _, part, _ in parts], fitted_rows)
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


def _seen(work: Search, rows: ForceRows, chosen: np.ndarray, shift=(0.0, 0)) -> _Seen:
    at = np.flatnonzero(chosen)
    count = len(at)
    if count > _ROWS:
        at = at[np.linspace(0, count - 1, _ROWS).astype(int)]
    some = rows.part(at)
    one = np.full(len(at), 1.0)
    blocks = blocks_of(rows.force, some.inputs, some.observed, one)
    problem = work.problem.with_blocks(blocks)
    missed, variance = propagated(problem, work.u, work.covariance)
    each = max(work.rows_per_one(rows.force) * len(at) / count, 1.0)
    predicted = missed + some.observed
    return _Seen(missed, some.column("fz"), predicted, variance, count, each, shift)


def _shift(fitted: Search, whole: Search, force: str) -> tuple[float, int]:
    """How far the coefficients of a force move when a part is left out.

    Estimates from nested data differ with a covariance that is the difference of
    theirs (Hausman 1978).

    Returns:
        Sum of squares of the shift over its variance, and the number of directions, of
        those that the part determines.
    """
    names, moved = whole.problem.names, whole.moved - whole.held
    own = own_coefficients(whole.problem.tire.version, force)
    at = np.flatnonzero(np.isin(names, [name for name in own if name in moved]))
    root = np.linalg.cholesky(whole.covariance[np.ix_(at, at)])
    inverse = np.linalg.inv(root)
    ratio = inverse @ fitted.covariance[np.ix_(at, at)] @ inverse.T
    sizes, axes = np.linalg.eigh((ratio + ratio.T) / 2)
    variance = sizes - 1
    moves = (axes.T @ inverse @ (fitted.u - whole.u)[at])[variance > _TOLD]
    return float(np.sum(moves**2 / variance[variance > _TOLD])), len(moves)


def _band(parts: Sequence[_Seen], fitted: _Seen) -> Band:
    """The band that rows of left-out parts follow.

    Standard errors are widened to the size of the shifts, where these are larger than
    the errors at the level of 5 %. The noise is that of the left-out rows or that of
    the ``fitted`` ones, whichever is larger there: in a left-out part the errors of the
    coefficients may account for all that its rows miss.
    """
    squares = sum(part.shift[0] for part in parts)
    count = sum(part.shift[1] for part in parts)
    is_clear = count > 0 and chdtrc(count, squares) < _CHANCE
    wider = float(np.sqrt(squares / count)) if is_clear else 1.0
    laws = [_law_of(some, wider) for some in (parts, [fitted]) if some]
    sizes = [np.mean(law.variance(fitted.fz, fitted.predicted)) for law in laws]
    return Band(laws[int(np.argmax(sizes))], wider)


def _law_of(parts: Sequence[_Seen], wider: float) -> NoiseLaw:
    missed, fz, predicted, variance = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("missed", "fz", "predicted", "variance")
    )
    each = np.concatenate([np.full(len(part.fz), part.each) for part in parts])
    return noise_law(missed, fz, predicted, wider**2 * variance, each)


def _within(one: _Seen, band: Band) -> float:
    variance = band.law.variance(one.fz, one.predicted) + band.wider**2 * one.variance
    return float(np.mean(np.abs(one.missed) <= _IN_95 * np.sqrt(variance)))
