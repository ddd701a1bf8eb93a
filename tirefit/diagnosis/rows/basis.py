"""Generic bases for a remainder that no listed effect explains."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tirefit.data.levels import levels
from tirefit.diagnosis.negligible import FLAT, ROUNDING, UNSEEN
from tirefit.diagnosis.rows.patterns import (
    FULL_SLIDING,
    ROWS_OF_A_WAVE,
    WAVES,
    Patterns,
    patterns_gain,
    turns,
)

SCALES = 2.0 * 3.0 ** np.arange(4)
"""Standard deviations of a basis function's coefficient that are averaged over."""

_BUMPS = (4, 8)  # smallest and largest number of functions of the slip for each sign
_LEVELS = 4  # largest number of settings of a covariate with a coefficient each


def bumps(values, count: int) -> np.ndarray:
    """Radial functions over the range of the values: (n, count)."""
    centers = np.linspace(values.min(), values.max(), count)
    width = max((centers[1] - centers[0]), FLAT)
    return np.exp(-0.5 * ((values[:, None] - centers) / width) ** 2)


def functions_of(values, count: int) -> np.ndarray:
    """Smooth functions of a covariate, or one for each of its few settings: (n, k)."""
    settings = levels(values)
    if settings.few(_LEVELS):
        return np.eye(len(settings.center))[settings.code]
    return bumps(values, count)


def _by_side(slip_fraction, factors, scale, most: int) -> np.ndarray:
    """Bumps over the size of the slip times each factor (n,), separately by sign if each
    sign has a twentieth of the rows: about ``most`` whitened columns."""
    inside = np.clip(slip_fraction, -FULL_SLIDING, FULL_SLIDING)
    sides = [inside >= 0, inside < 0]
    if min(np.mean(side) for side in sides) <= 0.05:
        sides = [np.ones(len(inside), bool)]
    count = int(np.clip(most // (len(sides) * len(factors)), *_BUMPS))
    shapes = bumps(np.abs(inside), count)
    chosen = factors[: max(most // (len(sides) * count), 1)]
    columns = [shapes * (side * one)[:, None] for one in chosen for side in sides]
    return _scaled(np.concatenate(columns, axis=1), scale)


def _standard(values):
    spread = np.std(values)
    return (values - values.mean()) / spread if spread > UNSEEN else None


def _modulations(prepared) -> list[np.ndarray]:
    """Factors of the bumps in the order of importance: (n,) each."""
    rows = prepared.covariates
    first, second = [np.ones(prepared.n)], []
    plain = (rows.v, rows.time, rows.temperature, rows.gamma, rows.other)
    for values in (np.log(rows.fz), *plain):
        if (unit := _standard(values)) is not None:
            first.append(unit)
            if not levels(values).few(_LEVELS - 1):
                second.append(unit**2 - 1)
    if "sweeps" in prepared.has:
        first.append(rows.turning)
        if (speed := _standard(rows.v)) is not None:
            first.append(rows.turning * speed)
    return first + second


def _scaled(columns, scale):
    """Whitened unit columns, reduced to a basis with the same covariance."""
    basis = columns * scale[:, None]
    size = np.linalg.norm(basis, axis=0)
    basis = basis[:, size > FLAT] / size[size > FLAT]
    if not basis.shape[1]:
        return basis
    values, vectors = np.linalg.eigh(basis.T @ basis)
    return basis @ vectors[:, values > UNSEEN * values.max()]


def smooth_basis(prepared, slip_fraction, scale, most: int, runs: bool = False) -> np.ndarray:
    """Smooth functions of slip, times load, speed, time and direction (n, b).

    Args:
        slip_fraction: signed slip over that of full sliding, (n,).
        scale: (n,) typical force over the noise of each row.
        most: approximate number of columns.
        runs: whether each run has functions of its own too.
    """
    factors = _modulations(prepared)
    if runs and "runs" in prepared.has:
        own = [_standard(prepared.run == k) for k in np.unique(prepared.run)[1:]]
        factors[1:1] = [unit for unit in own[:_LEVELS] if unit is not None]
    return _by_side(slip_fraction, factors, scale, most)


def wave_basis(prepared, scale) -> np.ndarray:
    """Sine and cosine of slip and of time, side by side: (n, 2 x waves)."""
    slip = prepared.slip
    span = max(np.ptp(slip), FLAT)
    most = int(np.clip(prepared.n // ROWS_OF_A_WAVE, 2 * _BUMPS[0], WAVES))
    most_over_slip = min(most // 2, WAVES // 4)
    waves = [turns((slip - slip.min()) / span, np.arange(1.0, most_over_slip + 1))]
    if "time" in prepared.has:
        # With half waves: between two whole numbers of waves a third of the energy is lost.
        counts = np.arange(1, most + 0.1, 0.5)
        waves.append(turns(prepared.covariates.time, counts))
    columns = np.concatenate(waves, axis=1) * scale[:, None]
    size = np.sqrt(np.einsum("nk,nk->k", columns, columns))
    return columns / np.maximum(size, ROUNDING)


def orthogonal(basis, against) -> tuple[np.ndarray, np.ndarray]:
    """Orthonormal directions (n, q) of a basis orthogonal to ``against`` (n, p), and their
    sizes (q,)."""
    left = without(basis, against)
    turned, size = _principal(left.T @ left)
    return left @ turned, size


def _principal(gram) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients (b, q) of orthonormal combinations of columns with these products,
    and their singular values (q,)."""
    values, vectors = np.linalg.eigh(gram)
    good = values > UNSEEN * max(values.max(), ROUNDING)
    size = np.sqrt(values[good])
    return vectors[:, good] / size, size


def without(basis, against):
    """Part of columns, or one (m,), that is orthogonal to ``against`` (m, p)."""
    unit, _ = np.linalg.qr(against)
    return basis - unit @ (unit.T @ basis)


def taken_out(against, expected=None) -> np.ndarray:
    """Columns Q (m, q): ``1 - Q Q'`` is the precision of the rows after a fit of
    columns ``against`` (m, p) with free coefficients and ``expected`` (m, k) with
    coefficients of unit standard deviation."""
    unit, _ = np.linalg.qr(against)
    if expected is None or not expected.shape[1]:
        return unit
    left, size = orthogonal(expected, against)
    return np.concatenate([unit, left * (size / np.hypot(1.0, size))], axis=1)


def gain(score, size) -> float:
    """Log evidence of coefficients over none: scores (q,) of orthonormal directions,
    prior standard deviations ``size`` (q,)."""
    t = size**2
    return float(0.5 * np.sum(score**2 * t / (1 + t) - np.log1p(t)))


def mean_gain(score, size, scales=SCALES) -> float:
    """Log evidence of a basis over none, averaged over its scales; see :func:`gain`."""
    gains = [gain(score, scale * size) for scale in scales]
    return float(np.logaddexp.reduce(gains) - np.log(len(scales)))


def _in_pairs(gram, score, ridge):
    """chi-squared and determinant of each wave, from the products ``gram`` (K, 3) of
    :func:`_pairs` and ``score`` (K, 2) with the residual; ``ridge`` adds to squares."""
    a, b, c = gram[:, 0] + ridge, gram[:, 1], gram[:, 2] + ridge
    sine, cosine = score.T
    size = a * c - b * b
    return (c * sine**2 - 2 * b * sine * cosine + a * cosine**2) / size, size


def _pairs(columns) -> np.ndarray:
    """Products sine-sine, sine-cosine, cosine-cosine of waves (m, 2 K): (K, 3)."""
    sine, cosine = columns[:, ::2], columns[:, 1::2]
    each = ((sine, sine), (sine, cosine), (cosine, cosine))
    return np.stack([np.einsum("mk,mk->k", *pair) for pair in each], axis=1)


def waves_within(waves, against, residual):
    """chi-squared (K,), two degrees of freedom each, of every wave."""
    unit, _ = np.linalg.qr(against)
    rest = residual - unit @ (unit.T @ residual)
    gram, score = _pairs(waves) - _pairs(unit.T @ waves), waves.T @ rest
    return _in_pairs(gram, score.reshape(-1, 2), FLAT)[0]


@dataclass(frozen=True, eq=False)
class Generic:
    """Whitened: smooth functions (m, b), many waves (m, 2 x waves), many patterns."""

    smooth: np.ndarray
    waves: np.ndarray
    patterns: Patterns

    @cached_property
    def columns(self) -> np.ndarray:
        """All but the patterns, side by side."""
        return np.concatenate([self.smooth, self.waves], axis=1)

    @cached_property
    def _grams(self) -> tuple[np.ndarray, np.ndarray]:
        return self.smooth.T @ self.smooth, _pairs(self.waves)

    def left(self, against, residual, expected=None):
        """For the remainder of a fit, see :func:`taken_out`: scores and sizes (q,) of
        orthonormal smooth directions, products (K, 3) and scores (K, 2) of waves."""
        unit = taken_out(against, expected)
        rest = residual - unit @ (unit.T @ residual)
        both = np.concatenate([unit, rest[:, None]], axis=1).T @ self.columns
        ends = self.smooth.shape[1]
        used, score = np.split(both[:-1], [ends], axis=1), np.split(both[-1], [ends])
        gram, waves = self._grams
        turned, size = _principal(gram - used[0].T @ used[0])
        left = score[0] @ turned, size
        return left, waves - _pairs(used[1]), score[1].reshape(-1, 2)


def gains(bases: Generic, against, residual, expected=None) -> dict[str, float]:
    """Log evidence of each kind of remainder over none, see :meth:`Generic.left`."""
    smooth, gram, score = bases.left(against, residual, expected)
    waves = []
    for scale in SCALES:
        chi2, size = _in_pairs(gram, score, scale**-2)
        waves.append(0.5 * chi2 - 0.5 * np.log(scale**4 * size))
    unit = taken_out(against, expected)
    return {
        "smooth": mean_gain(*smooth),
        "waves": float(np.logaddexp.reduce(waves, axis=None) - np.log(np.size(waves))),
        "patterns": patterns_gain(bases.patterns, unit, residual),
    }


def of_any_kind(kinds: Mapping[str, float]) -> float:
    """Log evidence of a remainder of any kind, from :func:`gains`."""
    return float(np.logaddexp.reduce(list(kinds.values())) - np.log(len(kinds)))


def located(bases: Generic, against, residual):
    """Smooth part of the residual, by smooth functions and waves; its variance (m,)."""
    _, gram, of_waves = bases.left(against, residual)
    chi2, _ = _in_pairs(gram, of_waves, FLAT)
    # 8 over the largest of as many waves of noise: 55 to 1.
    strong = np.flatnonzero(chi2 > 2 * np.log(len(chi2)) + 8)
    strong = strong[np.argsort(-chi2[strong])][:4]
    waves = bases.waves[:, np.ravel(strong[:, None] * 2 + [0, 1])]
    left, size = orthogonal(np.concatenate([bases.smooth, waves], axis=1), against)
    score = left.T @ residual
    # Empirical Bayes: the scale with the largest evidence, from 0.3 of the noise on.
    scale = max(np.geomspace(0.3, 300, 25), key=lambda one: gain(score, one * size))
    t = (scale * size) ** 2
    shrink = t / (1 + t)
    return left @ (shrink * score), np.einsum("mq,q,mq->m", left, shrink, left)
