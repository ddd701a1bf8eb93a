"""Noise of the forces and of the slip: its level, and its correlation in time.

All scales are Huber's proposal 2, which a few large residuals change little and a single
row does not change abruptly.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.ndimage import convolve1d, median_filter
from scipy.optimize import nnls
from scipy.special import chdtr, chdtrc

from tirefit.diagnosis.engine import NONZERO, ROUNDING, UNSEEN
from tirefit.diagnosis.rows.covariates import LOADS
from tirefit.diagnosis.rows.discrepancy import waves_within
from tirefit.diagnosis.rows.rig import LEAST_ROWS
from tirefit.fitting.problem.noise import MAD, autocorrelation_time
from tirefit.params import Values

_CLIP = 2.5
"""Residual, in standard deviations, at which squares are clipped."""

_OUTLIER = 4.5
"""Standard deviations from which a row is excluded: one normal row in 1.5e5."""

_FEW, _FLAGGED = 3, 0.004
"""Number and share of excluded rows above which outliers are reported; a sharp bend of
the force may give as many."""

_ROUNDS = 4
"""Largest number of rounds of exclusion, and of weighting by a variance law."""

_MISSTATED = 0.15  # tolerated excess over the stated noise

_CLEAR, _SIGNIFICANT = 4.0, 2.5
"""Standard errors of an excess or of a variance that follows the force: one normal noise in
15,000; and of a correlation of neighbours or a noise of the slip: one white record in 160."""

_NEIGHBOURED = 0.3
"""Smallest share of the rows with neighbours that represents all."""

_TOGETHER = 1.94
"""1 + 2 (4/9 + 1/36): squares of second differences per independent one, as they share rows."""

_FADES = np.arange(20) / 20  # correlations of neighbours that are compared


class Memory(NamedTuple):
    """A first-order autoregressive noise: the correlation of neighbours, and the probability of
    this one."""

    fade: float = 0.0
    chance: float = 1.0

    @property
    def rows_each(self) -> float:
        """Number of rows per independent row."""
        return 1 + 2 * self.fade / (1 - self.fade)


FORGETFUL = Memory()
"""Independent rows."""


def in_order(time: Values | None, run: np.ndarray) -> list[np.ndarray]:
    """Rows of each run in the order they were measured: index arrays."""
    order = np.arange(len(run)) if time is None else np.lexsort((time, run))
    return [order[run[order] == code] for code in np.unique(run)]


_LEAST_VARIANCE = 1e-3  # smallest variance of the noise of a row, over the mean


def correlation(white: np.ndarray, time: Values | None, run: np.ndarray) -> float:
    """Number of rows per independent row of a remainder (n,), at least 1 and at most that
    which leaves the rows of a diagnosis independent, as a stronger correlation is treated as a
    gap; excluded rows are zero."""
    each = autocorrelation_time([white[rows] for rows in in_order(time, run)])
    return min(each, len(white) / LEAST_ROWS)


def memory_of(
    white: np.ndarray, unit: np.ndarray, stretches: Sequence[np.ndarray], most: float = np.inf
) -> tuple[Memory, ...]:
    """Correlations of a noise of 2 % probability or more, the most probable first;
    :data:`FORGETFUL` where the correlation of neighbours is not significant, or the remainder is
    below a fifth of the noise: due to rounding, or to a stated noise that is too large.

    Smooth functions absorb slow noise, so the correlation of the remainder is biased
    downwards; the restricted likelihood corrects that.

    Args:
        white: (n,) remainder after smooth functions, zero for excluded rows.
        unit: (n, q) those functions, orthonormal.
        stretches: rows in the order of time (index arrays), which share no row.
        most: largest variance of the noise, so that a slow gap with noise of a known
            level is not treated as correlated noise.
    """
    stretches = [rows for rows in stretches if len(rows) > 2]
    if not stretches or np.sqrt(np.mean(white**2)) < 0.2:
        return (FORGETFUL,)
    rows, q = unit.shape
    variance = float(white @ white) / max(rows - q, 1)
    together = sum(float(white[s][1:] @ white[s][:-1]) for s in stretches)
    taken = sum(float(np.sum(unit[s][1:] * unit[s][:-1])) for s in stretches)
    lag_one = (together + variance * taken) / max(variance * rows, NONZERO)
    if lag_one < _SIGNIFICANT / np.sqrt(sum(len(rows) for rows in stretches)):
        return (FORGETFUL,)
    logs = _log_likelihoods(white, unit, stretches, most)
    chance = np.exp(logs - logs.max())
    chance[chance < 0.02 * chance.sum()] = 0.0
    chance /= chance.sum()
    ranked = np.argsort(-chance)[: np.count_nonzero(chance)]
    return tuple(Memory(float(_FADES[k]), float(chance[k])) for k in ranked)


def _log_likelihoods(
    white: np.ndarray, unit: np.ndarray, stretches: Sequence[np.ndarray], most: float
) -> np.ndarray:
    """Restricted log likelihood of each of the correlations.

    The innovation of a row is x_t - fade x_(t-1): the products of the innovations of
    all correlations are sums of the same three.
    """
    both = np.concatenate([unit, white[:, None]], axis=1)
    heads, tails = _pairs_of(stretches)
    starts, before, after = both[[s[0] for s in stretches]], both[heads], both[tails]
    across = after.T @ before
    starts, before, after = (x.T @ x for x in (starts, before, after))
    freedom, logs = len(heads) + len(stretches) - unit.shape[1], []
    for fade in _FADES:
        left = 1 - fade**2
        new = after - fade * (across + across.T) + fade**2 * before
        products = starts + new / left
        smooth, score = products[:-1, :-1], products[:-1, -1]
        factor = cho_factor(smooth + ROUNDING * np.eye(len(smooth)))
        rest = float(products[-1, -1] - score @ cho_solve(factor, score))
        variance = min(max(rest, NONZERO) / freedom, most)
        log = -0.5 * (freedom * np.log(variance) + rest / variance)
        log -= 0.5 * len(heads) * np.log(left)
        logs.append(log - float(np.sum(np.log(np.diag(factor[0])))))
    return np.array(logs)


class NoiseLevel(NamedTuple):
    """Noise of one force: standard deviation (n,), rows per independent row, excluded rows
    (n,) bool, flags, source of the level, and ratio to the stated noise (1 without one)."""

    std: np.ndarray
    inflation: float
    outlier: np.ndarray
    flags: tuple[str, ...]
    source: str
    excess: float = 1.0


def judge_noise(
    residual: np.ndarray, spread: np.ndarray, fz: np.ndarray, force: np.ndarray,
    given: Values | None, basis: np.ndarray, waves: Callable[[np.ndarray], np.ndarray],
    groups: Sequence[np.ndarray], time: Values | None, run: np.ndarray, refine: bool = True,
) -> NoiseLevel:  # fmt: skip
    """Noise of one channel.

    Args:
        residual: (n,) [N] of the base fit.
        spread: (n,) variance due to the slip noise [N^2].
        fz, force: (n,) load, and force of the fit.
        given: (n,) stated standard deviation, or None.
        basis: (n, m) smooth functions that represent any gap (unit columns, in N).
        waves: remainder (n,) -> (n, 2 x waves) [N], those to compare; the significant ones
            are removed too.
        groups: index arrays of rows whose neighbours differ only by noise.
        time, run: order of the rows (time may be None).
        refine: exclude rows by the smooth remainder of a fit without a gross gap.
    """
    stated = given is not None
    base = np.ones(len(residual)) if given is None else np.asarray(given)
    std = np.sqrt(base**2 + spread) if stated else base
    white, in_time = residual / std, in_order(time, run)
    keep = ~_stray(residual, groups)
    smooth = _smooth(white, basis / std[:, None], waves, std, keep, in_time)
    # A twentieth of the error of the best force transducers (class 0.02), over the load: computed
    # forces have no noise, and would make any gap certain.
    rest, floor = smooth.remainder(white) * std, 1e-5 * np.mean(fz)

    def level() -> np.ndarray:
        parts = np.stack([base**2 * share for share in shares], axis=1)
        square = rest[keep] ** 2 * (np.sum(keep) / smooth.freedom)
        law = parts @ _law(square, parts[keep], spread[keep]) + spread
        law = np.sqrt(np.maximum(law, _LEAST_VARIANCE * np.mean(law) + NONZERO))
        return law * _scale(rest / law, smooth)

    for _ in range(_ROUNDS if refine else 0):
        shares = _shares(rest / std, fz, force, keep)
        good = np.abs(rest) < _OUTLIER * np.maximum(level(), floor)
        if np.array_equal(good, keep):
            break
        keep, smooth = good, _Smooth(smooth.basis, good)
        rest = smooth.remainder(white) * std
    shares, flags = _shares(rest / std, fz, force, keep), list[str]()
    grows = stated and len(shares) > 2
    if grows:
        std, source = level(), "estimated: grows with the force, unlike the stated"
    elif stated:
        times, flags, source = _overruled(white, rest / std, smooth, groups, in_time)
        std = std * times
    else:
        std, source = np.maximum(level(), floor), "differences"
    memory = smooth.memory(rest / std, in_time)
    if not stated:
        apart = _CLEAR * max(state.rows_each for state in memory) * (memory[0].fade > 0)
        local = _between(residual / std, groups, keep, apart, in_time)
        if local < 1:
            std = np.maximum(std * local, floor)
            memory = smooth.memory(rest / std, in_time)
        most = np.sqrt(np.mean(residual[keep] ** 2) / np.mean(std[keep] ** 2))
        std = std * min(float(most), 1.0)  # the noise is a part of the residual
    std = np.maximum(std, floor)
    if np.all(std <= floor):  # forces from a formula have rounding errors but no noise
        memory, source = (FORGETFUL,), "assumed: 1e-5 of the load, as the rows show no noise"
    if grows or (not stated and np.max(std) > (1 + _MISSTATED) ** 2 * np.min(std)):
        flags.append("heteroscedastic")
    elif stated and np.std(fz) > LOADS * np.mean(fz):
        if abs(_growth(rest / std, np.log(fz), keep)) > _CLEAR:
            flags.append("heteroscedastic")
    if np.count_nonzero(~keep) > max(_FEW, _FLAGGED * len(residual)):
        flags.append("outliers")
    inflation = sum(state.chance * state.rows_each for state in memory)
    if inflation > 1:
        flags.append("autocorrelated")
        left = correlation(np.where(keep, rest, 0) / std, time, run)
        inflation = max(min(inflation, len(rest) / LEAST_ROWS), left)
    # At small forces, noise that grows with the force is that of the sensor.
    ratio = float(np.quantile(std / np.sqrt(base**2 + spread), 0.1)) if stated else 1.0
    return NoiseLevel(std, inflation, ~keep, tuple(flags), source, ratio)


def _overruled(
    white: np.ndarray, rest: np.ndarray, smooth: "_Smooth", groups: Sequence[np.ndarray],
    in_time: Sequence[np.ndarray],
) -> tuple[float, list[str], str]:  # fmt: skip
    """(factor, flags, source) of a stated noise. It is replaced if the remainder ``rest`` and
    all neighbours scatter by more; a smaller one is kept, as it may include errors without
    scatter, but flagged below 60 %."""
    scales = {
        "about smooth functions": _scale(rest, smooth),
        "between neighbours in slip": _between(white, groups, smooth.keep),
        "between neighbours in time": _between(white, in_time, smooth.keep),
    }
    name = min(scales, key=lambda name: scales[name])
    if scales[name] > 1 + max(_MISSTATED, _CLEAR / np.sqrt(2 * smooth.freedom)):
        source = f"estimated: {scales[name]:.2g} times the stated noise, {name}"
        return scales[name], ["noise_misstated"], source
    small = scales["about smooth functions"] < 0.6
    return 1.0, ["noise_misstated"] if small else [], "given"


def _stray(residual: np.ndarray, groups: Sequence[np.ndarray]) -> np.ndarray:
    """Rows (n,) bool far both from the median of their neighbours and from the line
    between the two next to them."""
    off = np.zeros((2, len(residual)))
    for group in (group for group in groups if len(group) >= 7):
        values = residual[group]
        off[0, group] = values - median_filter(values, 7, mode="mirror")
        off[1, group] = convolve1d(values, [-0.5, 1.0, -0.5], mode="mirror")
    seen = np.any(off != 0, axis=0)
    if not seen.any():
        return seen
    unit = MAD * np.median(np.abs(off[:, seen]), axis=1, keepdims=True)
    stray = np.all(np.abs(off) > _OUTLIER * unit, axis=0) & seen
    return stray & (stray.sum() > max(_FEW, 2 * _FLAGGED * len(residual)))


_CLIPPED = float(chdtr(3, _CLIP**2) + _CLIP**2 * chdtrc(1, _CLIP**2))
"""Mean square of a normal number whose square is clipped at :data:`_CLIP`."""


def _clipped(square: np.ndarray) -> np.ndarray:
    """Squares over their expectation, clipped, with the mean of normal numbers restored."""
    return np.minimum(square, _CLIP**2) / _CLIPPED


def _huber(values: np.ndarray) -> float:
    """Standard deviation with squares clipped at :data:`_CLIP` of it."""
    square = np.square(values)
    scale = max(MAD**2 * float(np.median(square)), NONZERO)
    for _ in range(5 * _ROUNDS):
        scale = float(np.mean(np.minimum(square, _CLIP**2 * scale))) / _CLIPPED
    return float(np.sqrt(scale))


def _scale(white: np.ndarray, smooth: "_Smooth") -> float:
    """Huber's scale of a remainder (n,), corrected for the degrees of freedom."""
    kept = white[smooth.keep]
    return _huber(kept) * float(np.sqrt(len(kept) / smooth.freedom))


def _between(
    white: np.ndarray, groups: Sequence[np.ndarray], keep: np.ndarray, apart: float = 0.0,
    in_time: Sequence[np.ndarray] = (),
) -> float:  # fmt: skip
    """Standard deviation by second differences of neighbours at least ``apart`` rows of ``in_time``
    from each other, plus two of its standard errors; infinite if few rows have neighbours."""
    kept = [group[keep[group]] for group in groups]
    three = [np.stack([r[:-2], r[1:-1], r[2:]]) for r in kept if len(r) > 2]
    rows = np.concatenate([np.zeros((3, 0), int), *three], axis=1)
    if apart:
        place = np.empty(len(white))
        place[np.concatenate(in_time)] = np.arange(len(white))
        steps = np.abs(np.diff(place[rows[[0, 1, 2, 0]]], axis=0))
        rows = rows[:, steps.min(axis=0) > apart]
    if rows.shape[1] <= _NEIGHBOURED * len(white):
        return np.inf
    before, middle, after = white[rows]
    second = (middle - 0.5 * (before + after)) / np.sqrt(1.5)
    return _huber(second) * (1 + 2 * float(np.sqrt(_TOGETHER / (2 * len(second)))))


class _Smooth:
    """Least squares on a basis by its normal equations."""

    def __init__(self, basis: np.ndarray, keep: np.ndarray) -> None:
        self.basis, self.keep = basis, keep
        part = basis * keep[:, None]
        values, vectors = np.linalg.eigh(part.T @ part)
        good = values > UNSEEN * values.max()
        self.root = vectors[:, good] / np.sqrt(values[good])
        self.freedom = max(int(keep.sum()) - int(good.sum()), 1)

    def remainder(self, residual: np.ndarray) -> np.ndarray:
        """Residual less its smooth part, (n,)."""
        score = self.root.T @ (self.basis.T @ (residual * self.keep))
        return residual - self.basis @ (self.root @ score)

    def memory(self, white: np.ndarray, in_time: Sequence[np.ndarray]) -> tuple[Memory, ...]:
        """Possible correlations of a remainder (n,) of unit variance."""
        unit = (self.basis * self.keep[:, None]) @ self.root
        return memory_of(np.where(self.keep, white, 0.0), unit, in_time, (1 + _MISSTATED) ** 2)


def _smooth(
    white: np.ndarray, basis: np.ndarray, waves: Callable[[np.ndarray], np.ndarray],
    std: np.ndarray, keep: np.ndarray, in_time: Sequence[np.ndarray],
) -> _Smooth:  # fmt: skip
    """Smooth functions and the few significant waves.

    A wave counts beyond what the correlation of the remainder without it explains.
    """
    smooth = _Smooth(basis, keep)
    least = np.log(len(white)) + 6.0  # log odds of 400 to 1: about one wave in each row
    for _ in range(_FEW):
        rest = np.where(keep, smooth.remainder(white), 0.0)
        shapes = waves(rest / std) / std[:, None]
        chi2 = waves_within(shapes * keep[:, None], smooth.basis * keep[:, None], rest)
        best = 2 * int(np.argmax(chi2))
        near = shapes[:, max(best - 2, 0) : best + 4]  # one between two of them is three
        more = _Smooth(np.concatenate([smooth.basis, near], axis=1), keep)
        left = np.where(keep, more.remainder(white), 0.0)
        unit = max(_scale(rest, smooth) ** 2, NONZERO)
        memory = more.memory(left / np.sqrt(unit), in_time)
        if np.max(chi2) / unit < 2 * least * max(state.rows_each for state in memory):
            break
        smooth = more
    return smooth


def _shares(
    white: np.ndarray, fz: np.ndarray, force: np.ndarray, keep: np.ndarray
) -> list[np.ndarray]:
    """Shapes (n,) of the variance: constant; the square of the load, if it varies; and the
    force and its square, if the variance clearly grows with the force."""
    used = np.abs(force) / np.max(np.abs(force))
    shares = [np.ones_like(fz)]
    if np.std(fz) > LOADS * np.mean(fz):
        shares.append((fz / np.mean(fz)) ** 2)
    if _growth(white, used, keep) > _CLEAR:
        shares += [used, used**2]
    return shares


def _law(square: np.ndarray, parts: np.ndarray, fixed: np.ndarray | float = 0.0) -> np.ndarray:
    """Non-negative sizes (k,) of the parts (n, k) of a variance, by least squares weighted
    by the law; squares (n,) are clipped."""
    mean = max(float(np.mean(square)), NONZERO)
    law = np.full(len(square), mean)
    for _ in range(_ROUNDS):
        sizes, _ = nnls(parts / law[:, None], _clipped(square / law) - fixed / law)
        law = np.maximum(parts @ sizes + fixed, _LEAST_VARIANCE * mean)
    return sizes


def _growth(white: np.ndarray, values: np.ndarray, keep: np.ndarray) -> float:
    """Score of a variance that follows the values (n,), in standard errors."""
    x = values[keep]
    if np.ptp(x) < ROUNDING * np.max(np.abs(x)):
        return 0.0
    square = _clipped(np.square(white[keep] / max(_huber(white[keep]), NONZERO))) - 1
    return float(square @ (x - x.mean())) / float(np.std(x) * np.sqrt(2 * len(x)))


def slip_scatter(
    residual: np.ndarray, steepness: np.ndarray, fz: np.ndarray, alike: Sequence[Any],
    in_time: Sequence[Any],
) -> float:  # fmt: skip
    """Standard deviation of the slip noise from the forces, zero if not significant.

    An error of the slip moves the force in proportion to its slope, so neighbours scatter more
    where the curve is steep. Errors that consecutive rows share are not noise.

    Args:
        residual: (n,) [N].
        steepness: (n,) squared slope of the force over the slip [N^2].
        fz: (n,) load, with which the force noise may grow.
        alike, in_time: index arrays of rows whose neighbours differ only by noise, and of
            rows in the order of time.
    """
    alike = [rows for rows in alike if len(rows) > 2]
    if sum(len(rows) - 2 for rows in alike) < _NEIGHBOURED * len(residual):
        return 0.0
    parts = np.stack([np.ones_like(fz), (fz / np.mean(fz)) ** 2, steepness], axis=1)
    parts = np.concatenate([_middle(parts[rows], 0.25) for rows in alike])
    second = np.concatenate([_middle(residual[rows], -0.5) for rows in alike])
    square = second**2
    # Score of the share of the slip, orthogonal to the other parts of the variance.
    of_force = parts[:, :-1]
    without = np.maximum(of_force @ _law(square, of_force), NONZERO)
    over = _clipped(square / without) - 1
    of_force, along = of_force / without[:, None], parts[:, -1] / without
    along = along - of_force @ np.linalg.lstsq(of_force, along, rcond=None)[0]
    chance = max(2.0, float(np.var(over))) * _TOGETHER * float(along @ along)
    if over @ along < _SIGNIFICANT * np.sqrt(max(chance, NONZERO)):
        return 0.0
    local, slope = np.zeros((2, len(residual)))
    middle = np.concatenate([rows[1:-1] for rows in alike])
    local[middle], slope[middle] = second, np.sqrt(parts[:, -1])
    # Covariance of the errors of neighbours in time.
    first, next_to = _pairs_of(in_time)
    both = slope[first] * slope[next_to]
    columns = np.stack([both > 0, both], axis=1)
    sizes, *_ = np.linalg.lstsq(columns, local[first] * local[next_to], rcond=None)
    variance = _law(square, parts)[-1] - max(float(sizes[1]), 0.0)
    return float(np.sqrt(max(variance, 0.0)))


def _pairs_of(stretches: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """The rows before and after each step of some stretches."""
    return (
        np.concatenate([rows[:-1] for rows in stretches]),
        np.concatenate([rows[1:] for rows in stretches]),
    )


def noise_in_motion(
    residual: np.ndarray, slope: np.ndarray, off: np.ndarray, scatter: float
) -> float | None:
    """Standard deviation of the noise of a slip whose ``scatter`` about its path is mostly
    motion, zero if not significant; None if most may be noise.

    The force follows the true slip: a residual at the measured slip contains minus the slope
    times the noise of its own row, and ``off`` contains the same noise.

    Args:
        residual: (n,) [N] at the measured slips.
        slope: (n,) of the force over the slip [N].
        off: (n,) slips minus the mean of the two neighbours in time, see :func:`between`.
    """
    # The residual scatters more where the force is steep.
    size = np.hypot(MAD * np.median(np.abs(residual)), slope * scatter)
    near = np.abs(residual) <= _OUTLIER * size
    kept = near & (np.abs(off) <= _OUTLIER * MAD * np.median(np.abs(off))) & (off != 0)
    weight = max(float(slope[kept] @ slope[kept]), NONZERO)
    parts = -slope[kept] * residual[kept] * off[kept]
    variance, error = float(np.sum(parts)) / weight, float(np.sqrt(np.sum(parts**2))) / weight
    # Above half of the scatter the estimate is not used: in two measured logs the share is .55 and
    # .58 (standard errors .05 and .09), and there the noise by the scatter gives effects that hold
    # on other logs, and the estimate does not.
    if variance + _CLEAR * error >= 0.5 * scatter**2:
        return None
    return float(np.sqrt(variance)) if variance > _SIGNIFICANT * error else 0.0


def between(values: np.ndarray, in_time: Sequence[np.ndarray]) -> np.ndarray:
    """Values (n,) minus the mean of the two neighbours in time; zero at both ends."""
    off = np.zeros(len(values))
    for rows in (rows for rows in in_time if len(rows) > 2):
        off[rows[1:-1]] = _middle(values[rows], -0.5)
    return off


def _middle(values: np.ndarray, weight: float) -> np.ndarray:
    """Each row, except the first and the last, plus ``weight`` times its neighbours."""
    return values[1:-1] + weight * (values[2:] + values[:-2])
