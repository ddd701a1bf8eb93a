"""Generic bases: what a gap could look like that no listed effect explains."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from tirefit.data.levels import levels
from tirefit.diagnosis.negligible import FLAT, ROUNDING
from tirefit.diagnosis.rows.patterns import Patterns, patterns_gain, turns

SCALES = (2.0, 6.0, 18.0, 50.0)
"""Sizes of a basis function's coefficient that are averaged over, in z units."""

PRIORS = {"smooth": 0.4, "cells": 0.15, "waves": 0.2, "patterns": 0.25}
"""What kind of remainder it is, where there is one."""

RANK = 1e-6
"""Squared length of a direction over that of the longest, below which it is none: what
is left of columns that the fit has used up is rounding."""

_ROWS_OF_A_WAVE, _WAVES = 12, (4, 24)
_ROWS_IN_TIME, _WAVES_IN_TIME = 5, (4, 96)
"""Rows of the shortest wave, on average; fewest and most waves of a record, over the
slip and in time: a wheel turns often."""

_TO_DRAW = 4.0
"""Log odds over the number of waves from which a wave is drawn: 55 to 1."""

_MOST_WAVES = 4
"""Waves that are drawn at once, at most."""

_DRAWN_SCALES = np.geomspace(0.3, 300, 25)
"""Scales of the located remainder, in z units: from below the noise to a thousand times
that, a third apart."""

FULL_SLIDING = 3.0
"""Slip over that of full sliding beyond which nothing more depends on it."""

_FARTHEST = 3.5
"""The same where functions of it stand on both sides of that."""

_OF_EITHER_SIGN = 0.05
"""Share of the rows that each sign of the slip has, to have functions of its own."""

_OF_A_PARABOLA = 3
"""Settings through which a parabola is any function of them."""

_BUMPS, _NARROW_BUMPS = (4, 8), (4, 14)
"""Fewest and most functions of the slip, for each sign: the finest are half and a
quarter as wide as the slip of full sliding."""

_ROWS_OF_A_FUNCTION, _ROWS_OF_A_CELL = 3, 4
"""Rows for each function of a generic basis, at least."""


def bumps(values, count: int) -> np.ndarray:
    """Radial functions over the range of the values, (n, count)."""
    centers = np.linspace(values.min(), values.max(), count)
    width = max((centers[1] - centers[0]), FLAT)
    return np.exp(-0.5 * ((values[:, None] - centers) / width) ** 2)


_LEVELS = 4
"""Values of a covariate up to which each has a coefficient of its own."""


def functions_of(values, count: int) -> np.ndarray:
    """Smooth functions of a covariate, or one for each of its few levels: (n, k)."""
    settings = levels(values)
    if settings.few(_LEVELS):
        return np.eye(len(settings.center))[settings.code]
    return bumps(values, count)


def _by_side(slip_fraction, count: int) -> np.ndarray:
    """Bumps over the size of the slip, for each sign by itself: (n, 1 or 2 counts)."""
    inside = np.clip(slip_fraction, -_FARTHEST, _FARTHEST)
    shapes, positive = bumps(np.abs(inside), count), inside >= 0
    if _OF_EITHER_SIGN < positive.mean() < 1 - _OF_EITHER_SIGN:
        return np.concatenate(
            [shapes * positive[:, None], shapes * ~positive[:, None]], 1
        )
    return shapes


def _standard(values):
    spread = np.std(values)
    return (values - values.mean()) / spread if spread > FLAT else None


def _modulations(prepared) -> list[np.ndarray]:
    """What the bumps are multiplied by, the most telling first: (n,) each."""
    rows = prepared.covariates
    first, second = [np.ones(prepared.n)], []
    for values in (
        np.log(rows.fz), rows.v, rows.time, rows.temperature, rows.gamma, rows.other
    ):  # fmt: skip
        unit = _standard(values)
        if unit is not None:
            first.append(unit)
            # Through three settings a second degree is any function of them.
            if not levels(values).few(_OF_A_PARABOLA):
                second.append(unit**2 - 1)
    if "sweeps" in prepared.has:
        first.append(rows.turning)
        if (speed := _standard(rows.v)) is not None:
            first.append(rows.turning * speed)
    return first + second


_TAIL = 1e-8
"""Squared length of a direction over that of the longest that a basis may lose."""


def _scaled(columns, scale):
    """Whitened, of unit length, and as few as say the same: random coefficients of
    equal spread on the columns given and on those returned draw the same functions."""
    basis = columns * scale[:, None]
    size = np.linalg.norm(basis, axis=0)
    basis = basis[:, size > FLAT] / size[size > FLAT]
    if not basis.shape[1]:
        return basis
    # Smooth functions overlap: of hundreds, a fraction is independent.
    values, vectors = np.linalg.eigh(basis.T @ basis)
    return basis @ vectors[:, values > _TAIL * values.max()]


def smooth_basis(prepared, slip_fraction, scale, most: int) -> np.ndarray:
    """Smooth functions of slip, times load, speed, time and direction: (n, b).

    Args:
        prepared: the rows.
        slip_fraction: signed slip over that of full sliding, (n,).
        scale: typical force over the noise of each row (n,): whitens the columns.
        most: columns that are wanted, about.
    """
    modulations = _modulations(prepared)
    sides = _by_side(slip_fraction, 2).shape[1] // 2
    count = int(np.clip(most // (sides * len(modulations)), *_BUMPS))
    modulations = modulations[: max(most // (sides * count), 1)]
    shapes = _by_side(slip_fraction, count)
    columns = np.concatenate([shapes * m[:, None] for m in modulations], axis=1)
    return _scaled(columns, scale)


def _cell_basis(prepared, slip_fraction, scale, most: int) -> np.ndarray:
    """Narrow bumps of the slip, for each load by itself: (n, b)."""
    loads = levels(prepared.covariates.fz)
    cells = (
        [loads.code == code for code in range(len(loads.center))]
        if loads.few()
        else [np.ones(prepared.n, bool)]
    )
    sides = _by_side(slip_fraction, 2).shape[1] // 2
    count = int(np.clip(most // (sides * len(cells)), *_NARROW_BUMPS))
    shapes = _by_side(slip_fraction, count)
    columns = np.concatenate([shapes * cell[:, None] for cell in cells], axis=1)
    return _scaled(columns, scale)


def wave_basis(prepared, scale) -> np.ndarray:
    """Sine and cosine of slip and of time, side by side: (n, 2 x waves)."""
    slip = prepared.slip
    span = max(np.ptp(slip), FLAT)
    most = int(np.clip(prepared.n // _ROWS_OF_A_WAVE, *_WAVES))
    waves = [turns((slip - slip.min()) / span, np.arange(1.0, most + 1))]
    if "time" in prepared.has:
        most = int(np.clip(prepared.n // _ROWS_IN_TIME, *_WAVES_IN_TIME))
        # Halves: between two whole numbers of waves a third of the energy is lost.
        counts = np.arange(1, most + 0.1, 0.5)
        waves.append(turns(prepared.covariates.time, counts))
    columns = np.concatenate(waves, axis=1) * scale[:, None]
    size = np.sqrt(np.einsum("nk,nk->k", columns, columns))
    return columns / np.maximum(size, ROUNDING)


def orthogonal(basis, against) -> tuple[np.ndarray, np.ndarray]:
    """(left (n, q), singular values (q,)) of the basis with ``against`` (n, p) out."""
    left = without(basis, against)
    turned, size = _principal(left.T @ left)
    return left @ turned, size


def _principal(gram) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients (b, q) that make columns with these products orthonormal, and their
    singular values (q,)."""
    values, vectors = np.linalg.eigh(gram)
    good = values > RANK * max(values.max(), ROUNDING)
    size = np.sqrt(values[good])
    return vectors[:, good] / size, size


def without(basis, against):
    """Columns, or one (m,), with those of ``against`` (m, p) taken out."""
    unit, _ = np.linalg.qr(against)
    return basis - unit @ (unit.T @ basis)


def taken_out(against, expected=None) -> np.ndarray:
    """Columns Q (m, q) of which ``1 - Q Q'`` is the precision of whitened rows that a
    fit leaves: orthonormal where it is free, shorter where the data know a direction no
    better than its prior.

    Args:
        against: (m, p) columns of free coefficients.
        expected: (m, k) of coefficients with a standard deviation of one, or none.
    """
    unit, _ = np.linalg.qr(against)
    if expected is None or not expected.shape[1]:
        return unit
    left, size = orthogonal(expected, against)
    return np.concatenate([unit, left * (size / np.hypot(1.0, size))], axis=1)


def gain(score, size) -> float:
    """Log evidence of coefficients of standard deviation ``size`` (q,), over none.

    Args:
        score: (q,) of orthonormal directions.
    """
    t = size**2
    return float(0.5 * np.sum(score**2 * t / (1 + t) - np.log1p(t)))


def mean_gain(score, size, scales=SCALES) -> float:
    """Log evidence of a basis, averaged over its scales.

    Args:
        score: (q,) of its orthonormal directions.
        size: (q,) their singular values.
    """
    gains = [gain(score, scale * size) for scale in scales]
    return float(np.logaddexp.reduce(gains) - np.log(len(scales)))


def _in_pairs(gram, score, ridge):
    """score gram^-1 score and the determinant of each of the waves, of which ``gram``
    (K, 3) holds the products of sine and sine, sine and cosine, cosine and cosine, and
    ``score`` (K, 2) those with the residual; ``ridge`` is added to the squares."""
    a, b, c = gram[:, 0] + ridge, gram[:, 1], gram[:, 2] + ridge
    sine, cosine = score.T
    size = a * c - b * b
    return (c * sine**2 - 2 * b * sine * cosine + a * cosine**2) / size, size


def _gains_of_waves(gram, score) -> np.ndarray:
    """Log evidence of each wave over none at each of the scales: (S, K)."""
    each = []
    for scale in SCALES:
        chi2, size = _in_pairs(gram, score, scale**-2)
        each.append(0.5 * chi2 - 0.5 * np.log(scale**4 * size))
    return np.array(each)


def _gain_of_waves(gram, score) -> float:
    """Log evidence of one wave, whichever, averaged over waves and scales."""
    gains = np.ravel(_gains_of_waves(gram, score))
    return float(np.logaddexp.reduce(gains) - np.log(len(gains)))


class WavesOfResidual(NamedTuple):
    """Each of K waves given a residual, at each of S scales: log evidence over none
    (S, K), mean (S, K, 2) and covariance (S, K, 2, 2) of its two coefficients."""

    gain: np.ndarray
    mean: np.ndarray
    covariance: np.ndarray


def worth_of_waves(waves, against, residual) -> WavesOfResidual:
    """One wave at a time, with ``against`` (m, p) out."""
    left = without(waves, against)
    gram, score = _pairs(left), (left.T @ residual).reshape(-1, 2)
    full = (
        gram[:, [[0, 1], [1, 2]]] + np.eye(2) / np.square(SCALES)[:, None, None, None]
    )
    covariance = np.linalg.inv(full)
    mean = np.einsum("skab,kb->ska", covariance, score)
    return WavesOfResidual(_gains_of_waves(gram, score), mean, covariance)


def _pairs(columns) -> np.ndarray:
    """Products (K, 3) of sine and cosine of waves (m, 2 K): :func:`_in_pairs`."""
    sine, cosine = columns[:, ::2], columns[:, 1::2]
    each = ((sine, sine), (sine, cosine), (cosine, cosine))
    return np.stack([np.einsum("mk,mk->k", *pair) for pair in each], axis=1)


def waves_within(waves, against, residual):
    """chi-squared (K,), two degrees each, of every wave in the residual."""
    unit, _ = np.linalg.qr(against)
    rest = residual - unit @ (unit.T @ residual)
    gram, score = _pairs(waves) - _pairs(unit.T @ waves), waves.T @ rest
    return _in_pairs(gram, score.reshape(-1, 2), FLAT)[0]


@dataclass(frozen=True, eq=False)
class Generic:
    """Kinds of remainder, whitened: many smooth functions at once (m, b), many narrow
    bumps at once (m, c), one of many waves (m, 2 x waves), or one of many patterns."""

    smooth: np.ndarray
    cells: np.ndarray
    waves: np.ndarray
    patterns: Patterns

    @cached_property
    def columns(self) -> np.ndarray:
        """All but the patterns, side by side."""
        return np.concatenate([self.smooth, self.cells, self.waves], axis=1)

    @cached_property
    def _grams(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        smooth, cells = self.smooth, self.cells
        return smooth.T @ smooth, cells.T @ cells, _pairs(self.waves)

    def left(self, against, residual, expected=None) -> "Left":
        """What a fit leaves of them, and their products with its residual.

        From products of the whole columns, formed once: a fit takes a few directions
        out of hundreds.

        Args:
            against, expected: columns that the fit has used up, see :func:`taken_out`.
            residual: (m,) whitened.
        """
        unit = taken_out(against, expected)
        rest = residual - unit @ (unit.T @ residual)
        both = np.concatenate([unit, rest[:, None]], axis=1).T @ self.columns
        ends = np.cumsum([self.smooth.shape[1], self.cells.shape[1]])
        used, score = np.split(both[:-1], ends, axis=1), np.split(both[-1], ends)
        smooth, cells, waves = self._grams
        return Left(
            {
                "smooth": (smooth - used[0].T @ used[0], score[0]),
                "cells": (cells - used[1].T @ used[1], score[1]),
            },
            waves - _pairs(used[2]), score[2].reshape(-1, 2),
        )  # fmt: skip


class Left(NamedTuple):
    """What a fit leaves of generic columns: ``wide`` holds (products with one another
    (b, b), with the residual (b,)) of smooth functions and cells; ``waves`` (K, 3) and
    ``score`` (K, 2) see :func:`_in_pairs`."""

    wide: Mapping[str, tuple[np.ndarray, np.ndarray]]
    waves: np.ndarray
    score: np.ndarray

    def principal(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Scores (q,) of the orthonormal directions of a basis, and their sizes."""
        gram, score = self.wide[name]
        turned, size = _principal(gram)
        return score @ turned, size

    def wide_gains(self) -> dict[str, float]:
        """Log evidence of the smooth functions and of the cells."""
        return {name: mean_gain(*self.principal(name)) for name in self.wide}

    @property
    def chi2(self) -> np.ndarray:
        """:func:`waves_within`."""
        return _in_pairs(self.waves, self.score, FLAT)[0]


def wide_bases(prepared, slip_fraction, scale) -> tuple[np.ndarray, ...]:
    """Smooth functions, cells and waves of one channel."""
    return (
        smooth_basis(prepared, slip_fraction, scale, prepared.n // _ROWS_OF_A_FUNCTION),
        _cell_basis(prepared, slip_fraction, scale, prepared.n // _ROWS_OF_A_CELL),
        wave_basis(prepared, scale),
    )


def gains(bases: Generic, against, residual, expected=None) -> dict[str, float]:
    """Log evidence of each kind of remainder that no listed effect explains, over none.

    Args:
        against, expected: columns that the fit has used up, see :func:`taken_out`.
        residual: (m,) whitened.
    """
    left = bases.left(against, residual, expected)
    return left.wide_gains() | {
        "waves": _gain_of_waves(left.waves, left.score),
        "patterns": patterns_gain(
            bases.patterns, taken_out(against, expected), residual
        ),
    }


def of_any_kind(kinds: Mapping[str, float]) -> float:
    """Log evidence of a remainder of whichever kind, from :func:`gains`."""
    each = [value + np.log(PRIORS[kind]) for kind, value in kinds.items()]
    return float(np.logaddexp.reduce(each))


def misfit_p_value(bases: Generic, against, residual, generator, draws: int) -> float:
    """Whether the residual is more than noise, by any of the bases (Bonferroni)."""
    values, left = [], bases.left(against, residual)
    for name in left.wide:
        score, size = left.principal(name)
        total = np.sum(size**2 * score**2)
        noise = generator.standard_normal((draws, len(size))) ** 2 @ size**2
        values.append((1 + np.sum(noise >= total)) / (1 + draws))
    chi2 = left.chi2
    # A residual without any wave has a chance of one, whose complement has no log.
    chance = min(np.exp(-0.5 * chi2.max()), 1 - ROUNDING)
    values.append(-np.expm1(len(chi2) * np.log1p(-chance)))
    return float(min(1.0, len(values) * min(values)))


def located(bases: Generic, against, residual):
    """Smooth part of the residual and its variance, (m,) each, by the basis that the
    residual supports best."""
    rest = bases.left(against, residual)
    gains, chi2 = rest.wide_gains(), rest.chi2
    chosen = getattr(bases, max(gains, key=lambda name: gains[name]))
    strong = np.flatnonzero(chi2 > 2 * (np.log(len(chi2)) + _TO_DRAW))
    strong = strong[np.argsort(-chi2[strong])][:_MOST_WAVES]
    waves = bases.waves[:, np.ravel(strong[:, None] * 2 + [0, 1])]
    left, size = orthogonal(np.concatenate([chosen, waves], axis=1), against)
    score = left.T @ residual
    # Empirical Bayes: the scale of the basis that the scores themselves suggest.
    fits = [gain(score, scale * size) for scale in _DRAWN_SCALES]
    t = (_DRAWN_SCALES[int(np.argmax(fits))] * size) ** 2
    shrink = t / (1 + t)
    return left @ (shrink * score), np.einsum("mq,q,mq->m", left, shrink, left)
