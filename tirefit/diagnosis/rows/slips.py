"""The path of the slip in time, and the distribution of the true slip of a noisy one."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.special import comb, softmax

from tirefit.diagnosis.engine import FLAT, NONZERO, ROUNDING
from tirefit.diagnosis.rows.rig import LEAST_ROWS
from tirefit.fitting.problem.noise import MAD
from tirefit.fitting.problem.slip_noise import SlipDistribution, slip_distribution
from tirefit.params import Values

_WINDOWS = (5, 9, 13, 19, 27, 41)  # rows of the local parabolas

_REACH, _PIECE = _WINDOWS[-1] - 1, 4_000
"""Neighbours of a row that its path uses; rows computed at once, to limit the memory."""

AHEAD = 4  # number of columns of the past that are after their row

AGES = np.append(np.arange(-AHEAD, 7), np.geomspace(8, 34, 6).round().astype(int))
"""Age of each column in intervals: every row first, then each a third older."""

_SPAN = 0.0375
"""Smallest interval, over the time in which the slip changes by its standard deviation;
linear interpolation over it is accurate to 2e-4 of that deviation."""

_MORE = 1.25
"""Ratio of two estimates of the noise above which they disagree."""


def segments(time: Values, run: np.ndarray) -> list[np.ndarray]:
    """Index arrays of stretches without a pause of 5 usual intervals."""
    order = np.lexsort((time, run))
    step = np.diff(time[order])
    same = np.diff(run[order]) == 0
    usual = np.median(step[same & (step > 0)]) if np.any(same & (step > 0)) else 1.0
    breaks = np.flatnonzero(~same | (step > 5 * usual) | (step <= 0)) + 1
    return np.split(order, breaks)


def shown_runs(run: np.ndarray, names: tuple[str, ...]) -> list[int]:
    """Codes of the runs ``names`` with enough rows for an offset of their own."""
    return [k for k in range(len(names)) if np.sum(run == k) >= LEAST_ROWS]


def _parabolas(values: np.ndarray, time: Values, window: int) -> tuple[np.ndarray, ...]:
    """Parabolas through every window of one width: rows (a, w, 3) of the fit, matrix
    (a, 3, w) from values to coefficients, sum of squares (a,), unit of time (a,)."""
    view = np.lib.stride_tricks.sliding_window_view
    x, t = view(values, window), view(time, window)
    unit = np.maximum((t[:, -1] - t[:, 0]) / 2, ROUNDING)
    u = (t - t[:, [window // 2]]) / unit[:, None]
    rows = np.stack([np.ones_like(u), u, u * u], axis=2)
    across = np.swapaxes(rows, 1, 2)
    normal = across @ rows
    try:
        fit = np.linalg.inv(normal) @ across
    except np.linalg.LinAlgError:  # times that differ only in their last digits
        fit = np.linalg.pinv(normal, hermitian=True) @ across
    left = x - (rows @ (fit @ x[:, :, None]))[:, :, 0]
    return rows, fit, np.sum(left**2, axis=1), unit


def _scatter(slip: np.ndarray, parts: Sequence[np.ndarray], order: int) -> float:
    """Standard deviation of white noise from differences of this order."""
    each = np.concatenate([np.diff(slip[part], order) for part in parts])
    return MAD * float(np.median(np.abs(each))) / float(np.sqrt(comb(2 * order, order)))


class _Path(NamedTuple):
    """Slip and its rate (n,), error of the rate (n,), and weights (n, 2 _REACH + 1) of the
    surrounding values."""

    value: np.ndarray
    slope: np.ndarray
    slope_error: np.ndarray
    reach: np.ndarray


def _averaged(values: np.ndarray, time: np.ndarray, noise: float) -> _Path:
    """The path of one unbroken stretch, whose values scatter by ``noise``."""
    size, row = len(values), np.arange(len(values))
    logs, parts = [], []
    # A parabola through 3 rows is exact: keep the measured values.
    for window in (w for w in (3, *_WINDOWS) if w <= size):
        rows, fit, misfit, unit = _parabolas(values, time, window)
        # Each row explained is worth .7 of log probability, by saw-tooth and sine sweeps.
        log = 0.7 * (window - 3) - 0.5 * misfit / noise**2
        for first in (row - window // 2, row, row - window + 1):
            start = np.clip(first, 0, size - window)
            at = rows[start, row - start]
            slope = np.stack([np.zeros(size), np.ones(size), 2 * at[:, 1]], axis=1)
            of_value, of_slope = (
                np.einsum("ni,niw->nw", form, fit[start])
                for form in (at, slope / unit[start, None])
            )
            logs.append(log[start])
            parts.append((start[:, None] + np.arange(window), of_value, of_slope))
    value, slope, square = np.zeros((3, size))
    reach = np.zeros((size, 2 * _REACH + 1))
    for chance, (near, of_value, of_slope) in zip(softmax(logs, 0), parts, strict=True):
        rate = np.einsum("nw,nw->n", of_slope, values[near])
        value += chance * np.einsum("nw,nw->n", of_value, values[near])
        slope += chance * rate
        square += chance * (rate**2 + noise**2 * np.sum(of_slope**2, axis=1))
        reach[row[:, None], near - row[:, None] + _REACH] += chance[:, None] * of_value
    return _Path(value, slope, np.sqrt(np.maximum(square - slope**2, 0.0)), reach)


def _path_of(values: np.ndarray, time: Values, noise: float) -> _Path:
    """:func:`_averaged` of a stretch, in overlapping pieces."""
    pieces = []
    for first in range(0, len(values), _PIECE):
        start, end = max(first - _REACH, 0), first + _PIECE
        near, kept = slice(start, end + _REACH), slice(first - start, end - start)
        path = _averaged(values[near], np.asarray(time)[near], noise)
        pieces.append([column[kept] for column in path])
    return _Path(*map(np.concatenate, zip(*pieces, strict=True)))


class Past(NamedTuple):
    """The slip at :data:`AGES` times ``interval`` [s] before each row; column
    :data:`AHEAD` is the row itself. Times beyond the sweep have the value of its end.

    ``path`` is estimated without the value of the row itself, so its noise enters neither
    its path nor that of its neighbours.
    """

    path: np.ndarray  # (n, k)
    rows: np.ndarray  # (n, k) rows before each time
    others: np.ndarray  # (n, k) rows after it
    share: np.ndarray  # (n, k) of the step between them
    interval: float

    def of(self, values: Any, rate: Values | None = None, time: Values | None = None) -> np.ndarray:
        """Values (n,) at these times (n, k): linear, or cubic with their rate (n,)."""
        first, last, share = values[self.rows], values[self.others], self.share
        if rate is None or time is None:
            return (1 - share) * first + share * last
        step, rest = time[self.others] - time[self.rows], share - 1
        out, back = step * rate[self.rows], step * rate[self.others]
        moved = share**2 * (3 - 2 * share) * (last - first)
        return first + moved + share * rest**2 * out + share**2 * rest * back

    def place(self, part: np.ndarray, time: Values) -> tuple[np.ndarray, np.ndarray]:
        """Write the rows of the stretch ``part`` around each time. Returns the index of
        the row before, within the part, and the share: (n, k) each."""
        when = np.clip(time[:, None] - self.interval * AGES, time[0], time[-1])
        low = np.clip(np.searchsorted(time, when, side="right") - 1, 0, len(part) - 2)
        share = (when - time[low]) / (time[low + 1] - time[low])
        self.rows[part], self.others[part], self.share[part] = part[low], part[low + 1], share
        return low, share

    def fill(self, part: np.ndarray, values: np.ndarray, time: Values, path: _Path) -> None:
        """Write the past of the rows ``part`` of one unbroken stretch."""
        low, share = self.place(part, time)
        row = np.arange(len(part))[:, None]

        def own_weight(at: np.ndarray) -> np.ndarray:
            """Weight of the value of each row in the path at that row."""
            weight = path.reach[at, np.clip(row - at, -_REACH, _REACH) + _REACH]
            return np.where(np.abs(row - at) > _REACH, 0.0, weight)

        alone = np.maximum(1 - path.reach[:, _REACH], 0.05)
        noise = ((values - path.value) / alone)[:, None]
        mean = (1 - share) * path.value[low] + share * path.value[low + 1]
        self.path[part] = (
            mean - ((1 - share) * own_weight(low) + share * own_weight(low + 1)) * noise
        )


class Sweeps(NamedTuple):
    """Motion of a slip in time."""

    rate: np.ndarray  # (n,) [1/s]
    turning: np.ndarray  # (n,) from -1 (its size shrinks) to 1 (it grows)
    past: Past
    present: bool  # whether the rows are sweeps
    noise: float  # scatter of the slip about its path, 0 where unknown


def slip_rate(
    slip: np.ndarray, time: Values | None, run: np.ndarray, noise: float = 0.0,
    rate: np.ndarray | None = None, shown: float | None = None,
) -> Sweeps:  # fmt: skip
    """Rate of change of slips (n,) at times (n,) [s], or None, of runs (n,).

    Args:
        noise: stated noise of the slip; 0 where unknown.
        rate: (n,) [1/s] measured rate, for rows too far apart to show it, or None.
        shown: noise of the slip by the forces, in place of a white scatter about its path.
    """
    count = len(slip)
    none = np.repeat(np.arange(count)[:, None], len(AGES), axis=1)
    past = Past(np.zeros(none.shape), none, none.copy(), np.zeros(none.shape), 1.0)
    still = Sweeps(np.zeros(count), np.zeros(count), past, False, 0.0)
    if time is None:
        return still
    parts = [part for part in segments(time, run) if len(part) >= _WINDOWS[0] + 2]
    if sum(len(part) for part in parts) < 0.5 * count:
        return still
    if rate is not None and np.any(rate):  # cubics through values and measured rates
        size = float(np.sqrt(np.mean(rate**2)))
        past = past._replace(interval=_SPAN * float(np.std(slip)) / size)
        for part in parts:
            past.place(part, time[part])
        past.path[:] = past.of(slip, rate, time)
        # The error of a measured rate is a twentieth of it.
        turning = np.clip(np.sign(slip) * rate / (2 * (0.05 * size)), -1, 1)
        return Sweeps(rate, turning, past, True, 0.0)
    curved, seen = _scatter(slip, parts, 2), _scatter(slip, parts, 6)
    if curved > 0.4 * np.std(slip):  # neighbours in time scatter: no sweep
        return still
    # For noise all estimates agree; a curve raises those of low order or wide parabolas. A well
    # sampled slip is a parabola over 17 rows.
    wide = 17
    long = [part for part in parts if len(part) >= wide]
    left = [_parabolas(slip[p], time[p], wide)[2] for p in long] or [np.array([np.inf])]
    about = np.sqrt(np.median(np.concatenate(left)) / (wide - 3))
    most = max(curved, float(about))
    scatter = seen if FLAT * np.std(slip) < most < _MORE * seen else 0.0
    seen = max(seen, FLAT * np.std(slip))
    level = max(noise, scatter if scatter > _MORE * noise else 0.0) or seen
    if shown is not None and scatter and not noise:
        level = max(shown, FLAT * np.std(slip))
    paths = [_path_of(slip[part], time[part], level) for part in parts]
    usual = float(np.median(np.concatenate([np.diff(time[part]) for part in parts])))
    rate = np.sqrt(np.mean(np.concatenate([path.slope for path in paths]) ** 2))
    period = float(np.std(slip) / rate) if rate > 0 else 0.0
    past = past._replace(interval=max(usual, _SPAN * period))
    past.path[:] = past.of(slip)
    for part, path in zip(parts, paths, strict=True):
        past.fill(part, slip[part], time[part], path)
        still.rate[part] = path.slope
        # Slips from a formula have no error.
        finest = FLAT * float(np.max(np.abs(path.slope)))
        error = np.maximum(path.slope_error, max(finest, NONZERO))
        certain = np.sign(slip[part]) * path.slope / (2 * error)
        still.turning[part] = np.clip(certain, -1, 1)
    return still._replace(present=True, noise=scatter, past=past)


_FEW, _MANY = (np.polynomial.hermite_e.hermegauss(count) for count in (3, 5))
"""Gauss-Hermite nodes of the slip noise: exact for polynomial forces of degree 5, 9."""


def _steep(slip: np.ndarray, std: np.ndarray) -> bool:
    """Whether the force bends within the noise, which is above 1 % of a large slip."""
    large = max(float(np.quantile(np.abs(slip), 0.9)), FLAT)
    return float(np.median(std)) > 0.01 * large


def slip_law(slip: np.ndarray, std: np.ndarray) -> SlipDistribution | None:
    """Distribution of the true slips from measured ones and noise (n,); None if zero."""
    return slip_distribution(slip, np.maximum(std, FLAT)) if np.any(std > 0) else None


def slip_nodes(
    law: SlipDistribution | None, slip: np.ndarray, std: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """True slips and their probabilities (n, k); without a law, the measured slips."""
    if law is None:
        return slip[:, None], np.ones((len(slip), 1))
    offset, mass = _MANY if _steep(slip, std) else _FEW
    mean, spread, _ = law.moments(slip, std)
    nodes = mean[:, None] + spread[:, None] * offset
    return nodes, np.tile(mass / mass.sum(), (len(slip), 1))


def slip_doubt(
    law: SlipDistribution | None, slip: np.ndarray, std: np.ndarray, path: np.ndarray | None = None
) -> np.ndarray:
    """Common error of the estimated slips: columns (n, k) times independent unit normal numbers.
    The density of the true slips is estimated from the same noisy slips, so rows with equal slips
    share its error. ``path`` (n,) holds slips estimated from their neighbours in time, or is None.
    """
    columns, std = [np.zeros((len(slip), 0))], np.maximum(std, FLAT)
    if law is not None and _steep(slip, std):
        columns.append(_of_density(law, slip, std))
    if law is not None and path is not None:
        offset, mass = _MANY
        believed = np.array([law.moments(path + std * e, std)[0] for e in offset]).T
        columns.append((believed @ (mass / mass.sum()) - path)[:, None])
    return np.concatenate(columns, axis=1)


def slip_proxies(
    law: SlipDistribution | None, slip: np.ndarray, std: np.ndarray,
    measured: Sequence[np.ndarray], path: np.ndarray | None = None, past: np.ndarray | None = None,
) -> np.ndarray:  # fmt: skip
    """Error of the estimated slips as predicted from other measurements: columns (n, k).

    A quantity that follows the true slip, such as a load that cornering shifts, does not
    have its noise, so a regression attributes a part of the slip's effect to it. For a
    slip estimated with variance s^2, the expected error is (predicted - estimated) s^2 /
    variance(predicted - estimated). With the measured slip instead of the estimated one,
    this would be a function of the slip that the law of the slips already includes.

    Args:
        measured: (n,) each; a cubic in each, and the past, predict the slips.
        path: as in :func:`slip_doubt`.
        past: (n, k) slips before, at and after each row by their neighbours in time.
    """
    if law is None:
        return np.zeros((len(slip), 0))
    believed, unsure, common = law.moments(slip, std)
    variance = np.mean(unsure**2 * (1 - common))
    predictions = [] if path is None else [path]
    if measured:
        free = [np.ones((len(slip), 1)), *([] if past is None else [past])]
        for values in measured:
            spread = max(float(np.std(values)), NONZERO)
            free.append(np.vander((values - np.mean(values)) / spread, 4)[:, :3])
        known = np.concatenate(free, axis=1)
        predictions.append(known @ np.linalg.lstsq(known, slip, rcond=None)[0])
    columns = []
    for predicted in predictions:
        off = predicted - believed
        known = variance / max(float(np.mean(off**2)), NONZERO)
        if known > 0.2:  # a smaller share of the noise is not worth a column
            columns.append(min(known, 1.0) * off)
    return np.array(columns).reshape(len(columns), len(slip)).T


def _of_density(law: SlipDistribution, slip: np.ndarray, std: np.ndarray) -> np.ndarray:
    """Error of the slips due to the error of the weights of the density, which add up to
    one: by maximum likelihood, each weight with a prior as wide as the mean weight."""
    # Likelihood of each row for each part of the density (n, parts), and the same times
    # the true slip minus the measured one.
    unit, step = np.linspace(-4, 4, 41), np.diff(law.knots)[0]
    off = std[:, None] * unit
    distance = np.abs((slip[:, None] + off)[..., None] - law.knots[1:-1]) / step
    bell = np.exp(-0.5 * unit**2) * np.diff(unit)[0] / step
    hats = np.maximum(1 - distance, 0) * bell[:, None]
    place = law.standing - slip[:, None]
    there = np.exp(-0.5 * (place / std[:, None]) ** 2) / std[:, None]
    likely = np.hstack([hats.sum(axis=1), there]) / np.sqrt(2 * np.pi)
    first = np.hstack([np.einsum("nqk,nq->nk", hats, off), there * place])
    first /= np.sqrt(2 * np.pi)
    weight = np.append(law.density[1:-1] * step, law.shares)
    together = np.maximum(likely @ weight, NONZERO)[:, None]
    mean = first @ weight / together[:, 0]
    moved = (first - mean[:, None] * likely) / together
    # Directions that keep the sum of the weights.
    free = np.linalg.svd(np.ones((1, len(weight))))[2][1:].T
    score = likely / together @ free
    normal = score.T @ score + len(weight) ** 2 * np.eye(free.shape[1])
    return moved @ free @ np.linalg.cholesky(np.linalg.inv(normal))
