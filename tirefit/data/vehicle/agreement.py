"""Estimate gain, delay and offset of a channel against its prediction from others.

A channel L is compared with a sum of terms R_k:

.. math:: L(t) = \\sum_k g_k R_k(t - d) + o + e(t)

Both sides are noisy, and least squares would find gains that are too small. The terms
some time before and after, when the noise of the sensors is independent, are therefore
used as instrumental variables (Durbin, Reiersol). Neighbouring errors are correlated;
their effective number is n over the sum of the autocorrelation.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

LATEST = 0.4  # longest delay [s] that is searched, as recorders of vehicles have

_NO_DELAY = 0.02
"""Least gain in R² of the longest delay; half a wave late, the opposite sign fits too."""

_GLITCH = 3.0  # multiple of the 99th percentile beyond which a sample is a glitch

_OUTLIER = 5.0
"""Residuals above this many standard deviations (from their median size) are outliers."""

AROUND = (-2.0, -1.5, -1.0, 1.0, 1.5, 2.0)
"""Times of the instruments, over the time after which the noise is independent."""

_ROUNDS = 4
EACH = 10  # rows that are used per correlation time of the noise

FEWEST = 50  # fewest rows that are compared: 5 s of a log with the default filter
_TINY = 1e-300  # divisor in place of zero


class Term(NamedTuple):
    """A term of the other side: values (n,), and the powers of the channels in it minus
    those of the channel that it is compared with."""

    values: np.ndarray
    powers: dict[str, int]
    words: str


class Pair(NamedTuple):
    """A channel (n,) and its prediction from others. ``level``: the level is compared
    too, as for a speed; ``exact``: both agree at every time, without dynamics of the car
    between them, which would resemble a delay."""

    channel: str
    words: str  # the other side, for the user
    values: np.ndarray  # (n,) on the grid, NaN where the channel is not known
    terms: tuple[Term, ...]  # summands of the other side
    zero: float  # standard deviation of the zero error of a good sensor [channel's unit]
    floor: float  # smallest rms of either side that can be compared
    level: bool = False
    exact: bool = True


class Agreement(NamedTuple):
    """The estimate of a pair; standard errors use the effective number of samples.

    ``seen``: share of the variation of a term, beyond the other terms, that the
    instruments explain, so that it is not noise; ``delay_seen``, ``own_seen``: the same
    for the rate of the terms, which determines the delay, and for the channel itself.
    """

    pair: Pair
    gains: tuple[float, ...]  # one for each term, 1 if the two sides agree
    gain_stds: tuple[float, ...]
    delay: float  # [s] of the channel behind the others
    delay_std: float
    offset: float  # of the channel, in its unit
    offset_std: float
    seen: tuple[float, ...]
    delay_seen: float
    own_seen: float
    size: float  # rms of the other side's variation
    own_size: float  # rms of the channel's variation
    correlation: float  # of the two sides at that delay
    samples: int  # number of rows that were compared
    effective: float  # number of independent rows


class Fit(NamedTuple):
    """A fit of factors of the sides and of a constant."""

    theta: np.ndarray  # (k + 1,) factors
    std: np.ndarray  # their standard errors
    seen: np.ndarray  # (k,) see :class:`Agreement`
    effective: float  # number of independent samples
    error: np.ndarray  # (n,) residuals


def agreement(
    pair: Pair, part: np.ndarray, usable: np.ndarray, rate: float, apart: float
) -> Agreement | None:
    """The pair's gains, delay and offset; None if too few rows are usable.

    Args:
        part: (n,) int, the unbroken stretch of each grid sample.
        usable: (n,) bool, samples that may be compared.
        rate: of the grid [Hz].
        apart: time [s] after which the noise of a filtered sensor is independent.
    """
    terms = np.column_stack([term.values for term in pair.terms])
    known = np.isfinite(pair.values) & np.isfinite(terms).all(axis=1)
    usable = usable & known
    for column in (pair.values, *terms.T) if usable.any() else ():
        usable &= np.abs(column) <= _GLITCH * np.percentile(np.abs(column[usable]), 99)
    step, latest = max(1, round(apart * rate)), round(LATEST * rate)
    rows = surrounded(part, usable, known, max(2 * step, latest) + 1)
    rows = rows[:: max(1, step // EACH)]
    if len(rows) < FEWEST:
        return None
    # Values of rows that are not usable, as at standstill, are arbitrary.
    terms = np.clip(terms, terms[rows].min(axis=0), terms[rows].max(axis=0))

    def zero(gains: np.ndarray) -> float:
        return pair.zero * float(np.linalg.norm(gains[:-1]))

    shift, gains = _delay(pair.values, terms, rows, latest)
    # This is wrong only next to a break, where no row is used.
    rates, k = np.gradient(terms, 1 / rate, axis=0), terms.shape[1]
    for turn in range(_ROUNDS):
        along = gains if gains.any() else np.ones(k)  # the gains of a dead channel are 0
        sides = np.column_stack([terms, rates @ along])
        own = pair.values[rows + shift]
        fit = instrumented(own, sides[rows], around(sides, rows, step), zero)
        if fit is None:
            return None
        good, rest = _no_outlier(fit.error), round(fit.theta[k] * rate)
        if turn == _ROUNDS - 1 or (good.all() and abs(rest) < 1):
            break
        # The terms were shifted by their rate, which is valid for a small delay only.
        shift = int(np.clip(shift - rest, -latest, latest))
        gains, rows = fit.theta[:k], rows[good]
    assert fit is not None  # the loop has at least one round
    near = np.hstack([around(pair.values[:, None], rows + shift, step), np.ones((len(own), 1))])
    unseen = np.var(own - near @ np.linalg.lstsq(near, own)[0]) / max(np.var(own), _TINY)
    moves = np.ptp(own) > 0 and np.ptp(own - fit.error) > 0
    return Agreement(
        pair, tuple(fit.theta[:k].tolist()), tuple(fit.std[:k].tolist()),
        float(shift / rate - fit.theta[k]), float(fit.std[k]), float(fit.theta[-1]),
        float(fit.std[-1]), tuple(fit.seen[:k].tolist()), float(fit.seen[k]),
        float(1 - unseen), float(np.std(terms[rows].sum(axis=1))), float(np.std(own)),
        float(np.corrcoef(own, own - fit.error)[0, 1]) if moves else 0.0, len(own), fit.effective,
    )  # fmt: skip


def around(values: np.ndarray, rows: np.ndarray, step: int) -> np.ndarray:
    """Values (n, k) before and after each row, at the times ``AROUND``, as columns."""
    last = len(values) - 1
    places = [np.clip(rows + round(k * step), 0, last) for k in AROUND]
    return np.nan_to_num(np.hstack([values[place] for place in places]))


def _no_outlier(error: np.ndarray) -> np.ndarray:
    """Rows (n,) bool without outlying residuals; all rows if too few would remain."""
    about = np.abs(error - np.median(error))
    good = about <= _OUTLIER * 1.4826 * np.median(about)
    return good if good.sum() >= FEWEST else np.ones(len(error), bool)


def surrounded(part: np.ndarray, usable: np.ndarray, known: np.ndarray, reach: int) -> np.ndarray:
    """Usable rows with ``reach`` known samples of their stretch on either side."""
    rows = np.flatnonzero(usable)
    rows = rows[(rows >= reach) & (rows < len(part) - reach)]
    blanks = np.concatenate([[0], np.cumsum(~known)])
    whole = blanks[rows + reach + 1] == blanks[rows - reach]
    return rows[whole & (part[rows - reach] == part[rows + reach])]


def _delay(
    values: np.ndarray, terms: np.ndarray, rows: np.ndarray, latest: int
) -> tuple[int, np.ndarray]:
    """The delay [samples] at which the terms explain most variance, and their gains."""
    columns = np.column_stack([terms[rows], np.ones(len(rows))])
    basis, triangle = np.linalg.qr(columns)
    scores, shifts = [], range(-latest, latest + 1)
    for shift in shifts:
        late = values[rows + shift]
        about = late - late.mean()
        explained = np.sum((basis.T @ about) ** 2) / max(np.sum(about**2), _TINY)
        scores.append(explained - _NO_DELAY * (shift / latest) ** 2)
    best = shifts[int(np.argmax(scores))]
    projected = basis.T @ values[rows + best]
    return best, np.linalg.lstsq(triangle, projected)[0][:-1]


def instrumented(
    values: np.ndarray, sides: np.ndarray, near: np.ndarray, zero: Callable[[np.ndarray], float]
) -> Fit | None:
    """Two-stage least squares with a prior on the offset; None if not determined.

    Args:
        values: (n,); sides: (n, k).
        near: (n, m), the instruments.
        zero: function of the (k,) factors of the sides that returns the standard
            deviation of the offset, in the unit of the values.
    """
    one = np.ones((len(values), 1))
    scale = np.concatenate([np.std(sides, axis=0), [1.0]])
    scale[scale == 0] = 1.0
    columns = np.hstack([sides, one]) / scale
    instruments = np.hstack([near / np.maximum(np.std(near, axis=0), _TINY), one])
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
        # The instruments do not determine the factors, even if the columns would.
        spread = np.linalg.inv(seen.T @ seen + prior)
    except np.linalg.LinAlgError:
        return None
    std = np.sqrt(np.maximum(noise * np.diag(spread), 0.0))
    share = np.array([_share(columns, seen, k) for k in range(sides.shape[1])])
    return Fit(theta / scale, std / scale, share, count, values - columns @ theta)


def _share(columns: np.ndarray, seen: np.ndarray, k: int) -> float:
    """Share of the variation of the k-th column, beyond the other columns, that the instruments
    explain: small for noise and for a combination of the other columns (Sanderson, Windmeijer).

    Args:
        columns: (n, m); seen: their prediction from the instruments.
    """
    part = np.linalg.lstsq(np.delete(seen, k, axis=1), seen[:, k])[0]
    own, whole = (one[:, k] - np.delete(one, k, axis=1) @ part for one in (seen, columns))
    return float(np.mean(own**2) / max(np.mean(whole**2), _TINY))


def effective(error: np.ndarray) -> float:
    """Effective number of independent residuals (n,): the autocorrelation is summed as
    long as pairs of neighbouring lags are positive (Geyer)."""
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
