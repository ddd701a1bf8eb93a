"""How far channels that say the same agree: gain, delay and offset of each pair.

A pair holds one channel, L, against what others make of it, a sum of terms R_k:

.. math:: L(t) = \\sum_k g_k R_k(t - d) + o + e(t)

Both sides are noisy, and least squares then finds gains that are too small. The terms a
while before and after, when the noise of the sensors is another, stand in for them
(instrumental variables: Durbin, Reiersol). Neighbouring errors are alike: they
count at their effective number, n over the sum of their autocorrelation.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

LATEST = 0.4  # longest delay that is looked for [s]: of the recorders of vehicles

_NO_DELAY = 0.02
"""Least gain in R² of the longest delay: half a wave late the other sign fits too."""

_GLITCH = 3.0  # multiple of the 99th percentile beyond which a sample is a glitch

_OUTLIER = 5.0
"""Standard deviations of the remainder, by its median size, that no noise reaches."""

_AROUND = (-2.0, -1.5, -1.0, 1.0, 1.5, 2.0)
"""Where the instruments lie, over the time after which noise is another."""

_ROUNDS = 4
EACH = 10  # rows that are used per correlation time of the noise

FEWEST = 50  # fewest rows that are compared: 5 s of a log with the default filter


class Term(NamedTuple):
    """A summand of the other side: values (n,), and the powers of the channels in it
    less those of the channel that it is held against."""

    values: np.ndarray
    powers: dict[str, int]
    words: str


class Pair(NamedTuple):
    """A channel (n,) and what others say of it; ``level``: the level is compared too,
    as of a speed; ``exact``: both are the same at every moment, not but for the car's
    own dynamics, which look like a delay."""

    channel: str
    words: str  # the other side, for the user
    values: np.ndarray  # (n,) on the grid, NaN where the channel is not known
    terms: tuple[Term, ...]  # summands of the other side
    zero: float  # standard deviation of a sound sensor's zero, unit of the channel
    floor: float  # rms from which either side says anything
    level: bool = False
    exact: bool = True


class Agreement(NamedTuple):
    """A pair as estimated: standard errors by the effective number of samples.

    ``seen``: share of what only this term has that is there a while before and after as
    well, so is no noise; ``delay_seen``, ``own_seen``: the same of the terms' rate,
    which shows the delay, and of the channel itself.
    """

    pair: Pair
    gains: tuple[float, ...]  # one a term, 1 where the two sides agree
    gain_stds: tuple[float, ...]
    delay: float  # [s] by which the channel is later than the others
    delay_std: float
    offset: float  # what the channel shows beyond, in its unit
    offset_std: float
    seen: tuple[float, ...]
    delay_seen: float
    own_seen: float
    size: float  # rms of the other side's variation
    own_size: float  # and of the channel's
    correlation: float  # of the two sides at that delay
    samples: int  # rows that were compared
    effective: float  # independent rows that they count as


class _Fit(NamedTuple):
    """Of the terms, the rate of their sum, and 1."""

    theta: np.ndarray  # (k + 2,) factors
    std: np.ndarray  # their standard errors
    seen: np.ndarray  # shares seen
    effective: float  # number of samples
    error: np.ndarray  # (n,) remainder


def agreement(pair: Pair, part, usable, rate: float, apart: float) -> Agreement | None:
    """The pair's gains, delay and offset; None if too few rows are usable.

    Args:
        part: (n,) int, the unbroken stretch of each grid sample.
        usable: (n,) bool, samples that may be compared.
        rate: of the grid [Hz].
        apart: time [s] after which the noise of a filtered sensor is another.
    """
    terms = np.column_stack([term.values for term in pair.terms])
    known = np.isfinite(pair.values) & np.isfinite(terms).all(axis=1)
    usable = usable & known
    for column in (pair.values, *terms.T):
        usable &= _no_glitch(column, usable)
    step, latest = max(1, round(apart * rate)), round(LATEST * rate)
    rows = surrounded(part, usable, known, max(2 * step, latest) + 1)
    rows = rows[:: max(1, step // EACH)]
    if len(rows) < FEWEST:
        return None
    # Beside the usable rows, as at standstill, anything may stand.
    terms = np.clip(terms, terms[rows].min(axis=0), terms[rows].max(axis=0))

    def zero(gains) -> float:
        return pair.zero * float(np.linalg.norm(gains[:-1]))

    shift, gains = _delay(pair.values, terms, rows, latest)
    # Wrong beside a break only, where nothing is used.
    rates, k = np.gradient(terms, 1 / rate, axis=0), terms.shape[1]
    for turn in range(_ROUNDS):
        along = gains if gains.any() else np.ones(k)  # of a dead channel
        sides = np.column_stack([terms, rates @ along])
        own = pair.values[rows + shift]
        near = around(sides, rows, step)
        fit = instrumented(own, sides[rows], near, zero)
        if fit is None:
            return None
        good, rest = _no_outlier(fit.error), round(fit.theta[k] * rate)
        if turn == _ROUNDS - 1 or (good.all() and abs(rest) < 1):
            break
        # The terms were moved by their rate, which holds for a small delay only.
        shift = int(np.clip(shift - rest, -latest, latest))
        gains, rows = fit.theta[:k], rows[good]
    assert fit is not None  # there is one round at least
    near = around(pair.values[:, None], rows + shift, step)
    return Agreement(
        pair, tuple(fit.theta[:k].tolist()), tuple(fit.std[:k].tolist()),
        float(shift / rate - fit.theta[k]), float(fit.std[k]), float(fit.theta[-1]),
        float(fit.std[-1]), tuple(fit.seen[:k].tolist()), float(fit.seen[k]),
        _seen_around(own, near), float(np.std(terms[rows].sum(axis=1))),
        float(np.std(own)), _correlation(own, own - fit.error), len(own), fit.effective,
    )  # fmt: skip


def around(values, rows, step: int) -> np.ndarray:
    """Values (n, k) before and after each row, at the times ``_AROUND``, as columns."""
    last = len(values) - 1
    places = [np.clip(rows + round(k * step), 0, last) for k in _AROUND]
    return np.nan_to_num(np.hstack([values[place] for place in places]))


def _seen_around(values, around) -> float:
    """Share of the variation of (n,) that follows from what is around it (n, m)."""
    columns = np.column_stack([around, np.ones(len(values))])
    left = values - columns @ np.linalg.lstsq(columns, values)[0]
    return float(1 - np.var(left) / max(np.var(values), 1e-300))


def _no_outlier(error: np.ndarray) -> np.ndarray:
    """Rows (n,) bool with remainders of common size; all where too few would be."""
    about = np.abs(error - np.median(error))
    good = about <= _OUTLIER * 1.4826 * np.median(about)
    return good if good.sum() >= FEWEST else np.ones(len(error), bool)


def _correlation(one, other) -> float:
    """Of two (n,); 0 where one of them is constant."""
    if np.ptp(one) == 0 or np.ptp(other) == 0:
        return 0.0
    return float(np.corrcoef(one, other)[0, 1])


def _no_glitch(values: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Samples (n,) bool that are of the size of the others."""
    if not usable.any():
        return usable
    size = np.abs(values)
    return size <= _GLITCH * np.percentile(size[usable], 99)


def surrounded(part, usable, known, reach: int) -> np.ndarray:
    """Usable rows with ``reach`` known samples of their own stretch to either side."""
    rows = np.flatnonzero(usable)
    rows = rows[(rows >= reach) & (rows < len(part) - reach)]
    blanks = np.concatenate([[0], np.cumsum(~known)])
    whole = blanks[rows + reach + 1] == blanks[rows - reach]
    return rows[whole & (part[rows - reach] == part[rows + reach])]


def _delay(values, terms, rows, latest: int) -> tuple[int, np.ndarray]:
    """The delay [samples] at which the terms explain most, and their gains there."""
    columns = np.column_stack([terms[rows], np.ones(len(rows))])
    basis, triangle = np.linalg.qr(columns)
    scores, shifts = [], range(-latest, latest + 1)
    for shift in shifts:
        late = values[rows + shift]
        about = late - late.mean()
        explained = np.sum((basis.T @ about) ** 2) / max(np.sum(about**2), 1e-300)
        scores.append(explained - _NO_DELAY * (shift / latest) ** 2)
    best = shifts[int(np.argmax(scores))]
    projected = basis.T @ values[rows + best]
    return best, np.linalg.lstsq(triangle, projected)[0][:-1]


def instrumented(values, sides, near, zero: Callable) -> _Fit | None:
    """Two-stage least squares with a prior on the offset; None if not determined.

    Args:
        values: (n,); sides: (n, k).
        near: (n, m), the instruments.
        zero: function of the (k,) factors of the sides that returns the standard
            deviation of the offset, in the unit of the values.
    """
    one, tiny = np.ones((len(values), 1)), 1e-300
    scale = np.concatenate([np.std(sides, axis=0), [1.0]])
    scale[scale == 0] = 1.0
    columns = np.hstack([sides, one]) / scale
    instruments = np.hstack([near / np.maximum(np.std(near, axis=0), tiny), one])
    seen = instruments @ np.linalg.lstsq(instruments, columns)[0]
    curvature, slope = seen.T @ columns, seen.T @ values
    prior = np.zeros_like(curvature)
    theta = np.linalg.lstsq(curvature, slope)[0]
    count, noise = 1.0, 0.0
    try:
        for _ in range(2):
            error = values - columns @ theta
            count = effective(error)
            noise = float(np.var(error)) * len(values) / count
            level = zero((theta / scale)[:-1])
            prior[-1, -1] = noise / max(level, 1e-9) ** 2
            theta = np.linalg.solve(curvature + prior, slope)
        # What the instruments do not show is not known, whatever the columns say.
        spread = np.linalg.inv(seen.T @ seen + prior)
    except np.linalg.LinAlgError:
        return None
    std = np.sqrt(np.maximum(noise * np.diag(spread), 0.0))
    share = np.array([_share(columns, seen, k) for k in range(sides.shape[1])])
    return _Fit(theta / scale, std / scale, share, count, values - columns @ theta)


def _share(columns, seen, k: int) -> float:
    """Share of what only the k-th column has, beyond the others, that the instruments
    see: little of noise, and of a term that the others make up (Sanderson, Windmeijer).

    Args:
        columns: (n, m); seen: the same by the instruments.
    """
    others = [j for j in range(columns.shape[1]) if j != k]
    part = np.linalg.lstsq(seen[:, others], seen[:, k])[0]
    own = seen[:, k] - seen[:, others] @ part
    whole = columns[:, k] - columns[:, others] @ part
    return float(np.mean(own**2) / max(np.mean(whole**2), 1e-300))


def effective(error: np.ndarray) -> float:
    """How many independent values the (n,) remainder counts as: its autocorrelation
    summed as far as pairs of neighbouring lags are positive (Geyer)."""
    n = len(error)
    about = error - error.mean()
    power = np.abs(np.fft.rfft(about, 2 * n)) ** 2
    covariance = np.fft.irfft(power)[: n // 2]
    if covariance[0] <= 0:
        return float(n)
    pairs = covariance[: len(covariance) // 2 * 2].reshape(-1, 2).sum(axis=1)
    negative = np.flatnonzero(pairs <= 0)
    until = negative[0] if len(negative) else len(pairs)
    total = 2 * float(np.sum(pairs[:until])) / float(covariance[0]) - 1
    return n / max(total, 1.0)
