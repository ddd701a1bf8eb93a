"""The noise of a file: what no smooth gap explains, judged before any effect is."""

from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls

from tirefit.diagnosis.negligible import FLAT, NONZERO, ROUNDING
from tirefit.diagnosis.noise.memory import (
    FORGETFUL,
    Memory,
    likeliest,
    memory_of,
    scatter_between,
)
from tirefit.diagnosis.rows.basis import RANK, waves_within
from tirefit.diagnosis.rows.prepared import LOADS
from tirefit.fitting.noise import MAD, autocorrelation_time

_FINEST = 1e-5
"""Noise over the load, at least: a twentieth of what the best force transducers resolve
(class 0.02). Forces that a formula gave have none, and would make any gap certain."""

_OUTLIER, _OUTLIER_AMONG_MANY = 4.5, 3.5
"""Robust standard deviations that set a row aside: one in 1.5e5 of normal noise; one in
2,000 where rows are far off anyway, for then more are somewhat off."""

_MANY = 0.01
"""Share of rows set aside from which they are no chance and no sharp edge."""

_FLAGGED = 0.004
"""Share of rows set aside from which outliers are said."""

_ROUNDS = 3
"""Rounds of setting rows aside, at most; it ends where a round changes nothing."""

_MISSTATED, _MISSTATED_SIGMAS = 0.15, 4.0
"""Excess of the noise over the stated one that is let pass, and the standard errors of
that excess, which counts where rows are far off."""

_OVERSTATED = 0.6
"""Share of the stated noise below which it is said to be misstated, and kept: it may
stand for errors that no row-by-row scatter shows."""

_FINER = 0.8
"""Scatter between neighbours over that about the smooth functions, below which the gap
is finer than those functions."""

_STRONG_WAVE = 6.0
"""Log odds over the number of waves from which one of them is no noise: 400 to 1."""

_SPREAD_OF_LOAD = 0.05
"""Standard deviation of log F_z above which noise is let grow with load."""

_UNEVEN = 1.3
"""Largest over smallest standard deviation from which noise is called uneven."""

_NEIGHBOURED = 0.3
"""Share of the rows that have such neighbours, from which they speak for all."""

_WAVES = 3
"""Waves that are taken out of the noise, at most."""

_LAW_ROUNDS = 4
"""Rounds of weighting by the law of the variance itself."""

_LEAST_VARIANCE = 1e-3
"""Variance of a row over the mean one, at least: no row decides alone."""

_FOLLOWS = 4.0
"""Standard errors of the score of a variance that follows the load: one normal noise
in 15,000."""

_LONGEST, _FACTS = 1e-3, 20
"""One less the correlation of neighbours, and independent rows of a record, at least:
a longer memory cannot be told from a gap."""

_CALM = 0.1
"""Share of the rows, the calmest, whose noise over the stated one is its excess: a
noise that grows with the force is that of the sensor where there is little force."""

_CORRELATED = 2.5
"""Standard errors of the correlation at lag one that count: one white record in 160."""


class NoiseLevel(NamedTuple):
    """Standard deviation (n,) of one force, what its memory may be, rows per
    independent row, outliers (n,) bool, flags, where the level came from, and how many
    times the stated one it is where it is calm; 1 where none was stated."""

    std: np.ndarray
    memory: tuple[Memory, ...]
    inflation: float
    outlier: np.ndarray
    flags: tuple[str, ...]
    source: str
    excess: float = 1.0


def judge_noise(
    residual, spread, fz, force, given, basis, waves, groups, time, run, refine=True
) -> NoiseLevel:
    """Noise of one channel.

    Args:
        residual: (n,) [N] of the base fit.
        spread: (n,) variance that the slip noise gives [N^2].
        fz, force: (n,) load, and force of the fit.
        given: (n,) stated standard deviation, or None.
        basis: (n, m) smooth functions that soak up any gap (unit columns, in N).
        waves: (n, 2 x waves) of which the strong ones do so too.
        groups: rows whose neighbours differ by noise alone: index arrays.
        time, run: order of the rows (time may be None).
        refine: whether the rows set aside are judged by the smooth remainder as well;
            only a fit without a gross gap can tell them.
    """
    base = given if given is not None else np.full(len(residual), 1.0)
    std = np.sqrt(base**2 + spread) if given is not None else base
    level = residual / (std if given is not None else np.maximum(fz, FLAT))
    keep = ~_stray(level, groups)
    in_time = in_order(time, run)
    most = np.inf if given is None else (1 + _MISSTATED) ** 2
    smooth = _soaked(
        residual / std, basis / std[:, None], waves / std[:, None], keep, in_time, most
    )
    clean = smooth.remainder(residual / std)
    for _ in range(_ROUNDS if refine else 0):
        level = clean
        rest = _Rest(clean, smooth.freedom, keep, base, std)
        grows = rest.grows_with(np.abs(force)) > _FOLLOWS
        if given is None or grows:  # larger forces scatter more: no outliers for that
            level = clean * std / rest.law(spread, fz, force, given is not None)
        unit = MAD * np.median(np.abs(level[keep]))
        many = np.count_nonzero(~keep) > _MANY * len(keep)
        far = _OUTLIER_AMONG_MANY if many else _OUTLIER
        good = np.abs(level) < far * max(unit, ROUNDING)
        good |= np.abs(clean * std) < far * _FINEST * np.mean(fz)
        if np.array_equal(good, keep):
            break
        keep = good
        smooth = _Smooth(smooth.basis, good)
        clean = smooth.remainder(residual / std)
    rest = _Rest(clean, smooth.freedom, keep, base, std)
    if given is None:
        level = rest.law(spread, fz, force, False)
        # Gap and noise together are no smaller than the noise alone.
        whole = float(np.mean((residual / level)[keep] ** 2))
        memory = rest.memory(
            smooth, level, spread, in_time, (1 + _MISSTATED) ** 2 * whole
        )
        local = _between_neighbours(residual / std, groups, keep, memory, in_time)
        rest = rest.under(memory)
        level, flags, source = _levelled(rest, local, spread, fz, force, False)
        if local < _FINER * rest.ratio:  # a gap, which no noise of that level is
            memory = rest.memory(smooth, level, spread, in_time, (1 + _MISSTATED) ** 2)
    else:  # a gap may lie between neighbours in slip, or in time
        local = min(
            _between_neighbours(residual / std, order, keep)
            for order in (groups, in_time)
        )
        level, flags, source = _levelled(rest, local, spread, fz, force, True)
        memory = rest.memory(smooth, level, spread, in_time, most)
    if np.count_nonzero(~keep) > max(_FEW, _FLAGGED * len(residual)):
        flags.append("outliers")
    inflation = 1.0
    each = sum(one.chance * float(np.mean(one.rows_each)) for one in memory)
    if each > 1:
        white = np.where(keep, clean, 0.0) * std / level
        inflation = max(each, correlation(white, time, run))
        inflation = min(inflation, len(white) / _FACTS)
        flags.append("autocorrelated")
    excess = 1.0 if given is None else float(np.quantile(level / std, _CALM))
    return NoiseLevel(level, memory, inflation, ~keep, tuple(flags), source, excess)


class _Rest(NamedTuple):
    """What smooth functions leave: ``clean`` (n,) over ``std`` (n,), its degrees of
    freedom, the rows that count, and ``base`` (n,), ``std`` without the slip noise."""

    clean: np.ndarray
    freedom: float
    keep: np.ndarray
    base: np.ndarray
    std: np.ndarray

    def law(self, spread, fz, force, stated: bool) -> np.ndarray:
        """Standard deviation (n,) by load and force; see :func:`_variance_law`."""
        shapes = _shapes(self.clean, fz, force, self.base, self.keep)
        values = self.clean * self.std
        return _variance_law(values, spread, shapes, self.keep, self.freedom, stated)

    def memory(self, smooth: "_Smooth", level, spread, in_time, most=np.inf):
        """What it may be; of the force, as far as a row's variance is its own.

        Args:
            level: standard deviation (n,).
            most: mean square of the noise over it, at most.
        """
        scale = level / self.std
        white = np.where(self.keep, self.clean, 0.0) / scale
        unit, _ = np.linalg.qr(smooth.columns / scale[:, None])
        own = np.clip(1 - spread / level**2, 0.0, 1.0)
        return memory_of(white, unit, in_time, own, most)

    @property
    def ratio(self) -> float:
        """Its standard deviation over ``std``."""
        square = float(np.sum(self.clean[self.keep] ** 2))
        return float(np.sqrt(square / max(self.freedom, 1.0)))

    def under(self, memory) -> "_Rest":
        """The same, counting that smooth functions take more of a slow noise."""
        variance = sum(one.chance * one.variance for one in memory)
        return self._replace(freedom=self.freedom / variance)

    def grows_with(self, values) -> float:
        """How the squares follow the values (n,): see :func:`_growth`."""
        return _growth(self.clean, values, self.keep)


def _levelled(rest: _Rest, local: float, spread, fz, force, stated: bool):
    """(standard deviation (n,), flags, source) of a noise.

    Args:
        local: standard deviation between neighbours, which bounds the noise where a
            gap is finer than the smooth functions.
        stated: whether a level was given.
    """
    std, dof, flags, source = rest.std, rest.freedom, [], "given"
    many = np.count_nonzero(~rest.keep) >= _MANY * len(rest.keep)
    ratio = rest.ratio
    grows = stated and rest.grows_with(np.abs(force)) > _FOLLOWS
    if grows or not stated:
        std = rest.law(spread, fz, force, stated)
        source = "estimated: the given level disagrees" if stated else "differences"
        if local < _FINER * ratio:
            std = std * local / ratio
        if grows or np.max(std) > _UNEVEN * np.min(std):
            flags.append("heteroscedastic")
    else:
        spare = 0.0 if many else _MISSTATED
        if min(ratio, local) > 1 + max(spare, _MISSTATED_SIGMAS / np.sqrt(2 * dof)):
            std, source = (
                std * min(ratio, local),
                "estimated: the given level disagrees",
            )
            flags.append("noise_misstated")
        elif ratio < _OVERSTATED:
            flags.append("noise_misstated")
        loads = np.std(np.log(fz)) > LOADS
        if loads and abs(rest.grows_with(np.log(fz))) > _FOLLOWS:
            flags.append("heteroscedastic")
    return np.maximum(std, _FINEST * np.mean(fz)), flags, source


_FEW = 3
"""Rows far off that an edge of the force may give."""

_WINDOW = 7
"""Neighbours of a row whose median an outlier does not move, nor do two."""
_STRAY = 5.0
"""Deviations from its neighbours, in robust standard deviations, that set a row aside
before anything is known of the gap."""


def _stray(level, groups) -> np.ndarray:
    """Rows far both from the median of their neighbours and from the line between the
    two next to them, which a sharp curve is not: (n,) bool."""
    off = np.zeros((2, len(level)))
    for group in groups:
        if len(group) >= _WINDOW:
            values = level[group]
            padded = np.pad(values, _WINDOW // 2, mode="reflect")
            windows = np.lib.stride_tricks.sliding_window_view(padded, _WINDOW)
            off[0, group] = values - np.median(windows, axis=1)
            ends = np.pad(values, 1, mode="reflect")
            off[1, group] = values - 0.5 * (ends[2:] + ends[:-2])
    seen = np.any(off != 0, axis=0)
    if not seen.any():
        return seen
    unit = MAD * np.median(np.abs(off[:, seen]), axis=1, keepdims=True)
    stray = np.all(np.abs(off) > _STRAY * unit, axis=0) & seen
    # A sharp edge of the force has few such rows, and is no outlier.
    return (
        stray if stray.sum() > max(_FEW, _MANY * len(level)) else np.zeros_like(stray)
    )


def _between_neighbours(white, groups, keep, memory=(FORGETFUL,), in_time=()) -> float:
    """Standard deviation from second differences of neighbours; inf without any.

    Args:
        memory: what that of the noise may be: neighbours in slip that are neighbours
            in time differ by less than independent ones.
        in_time: rows in the order of time (index arrays).
    """
    kept = [group[keep[group]] for group in groups]
    outer = [np.stack([r[1:-1], r[2:], r[:-2]]) for r in kept if len(r) > 2]
    if sum(triple.shape[1] for triple in outer) <= _NEIGHBOURED * len(white):
        return np.inf
    triples = np.concatenate(outer, axis=1)
    middle, after, before = white[triples]
    second = middle - 0.5 * (after + before)
    expected = scatter_between(triples, memory, in_time, len(white))
    return float(np.sqrt(np.mean(second**2) / expected))


def _soaked(white, basis, waves, keep, in_time, most: float):
    """Smooth functions and the few waves that clearly show, one after the other: those
    that a memory of the noise does not explain as well."""
    smooth, kept = _Smooth(basis, keep), waves * keep[:, None]
    least = np.log(waves.shape[1] // 2) + _STRONG_WAVE
    if most == np.inf:
        white = white / max(np.std(smooth.remainder(white)[keep]), NONZERO)
    clean, fits = _left(smooth, white, keep, in_time, most)
    for _ in range(_WAVES):
        chi2 = waves_within(kept, smooth.basis * keep[:, None], clean)
        unit = max(np.sum(clean**2) / smooth.freedom, NONZERO)
        best = int(np.argmax(chi2))
        if chi2[best] / unit < 2 * least:
            break
        wave = waves[:, 2 * best : 2 * best + 2]
        more = _Smooth(np.concatenate([smooth.basis, wave], axis=1), keep)
        before, (clean, fits) = fits, _left(more, white, keep, in_time, most)
        if fits - before < least:
            break
        smooth = more
    return smooth


def _left(smooth, white, keep, in_time, most: float):
    """What a smooth function leaves (n,), and how likely that is as noise: the log."""
    clean = np.where(keep, smooth.remainder(white), 0.0)
    return clean, likeliest(clean, smooth.columns, in_time, most)


class _Smooth:
    """Least squares on a basis, by its normal equations."""

    def __init__(self, basis, keep):
        self.basis, self.keep = basis, keep
        part = basis * keep[:, None]
        values, vectors = np.linalg.eigh(part.T @ part)
        good = values > RANK * values.max()
        self.root = vectors[:, good] / np.sqrt(values[good])
        self.freedom = max(int(keep.sum()) - int(good.sum()), 1)

    @property
    def columns(self) -> np.ndarray:
        """Orthonormal on the rows that are kept, zero on the others: (n, q)."""
        return (self.basis * self.keep[:, None]) @ self.root

    def remainder(self, residual):
        """Residual less its smooth part, (n,)."""
        score = self.root.T @ (self.basis.T @ (residual * self.keep))
        return residual - self.basis @ (self.root @ score)


def _shapes(clean, fz, force, base, keep) -> list[np.ndarray]:
    """What the variance of the force is made of: a part of its own (``base``, its
    standard deviation), one that grows with the load where that varies, and parts that
    grow with the force where they clearly do."""
    used = np.abs(force) / np.max(np.abs(force))
    shares = [np.ones_like(fz)]
    if np.std(np.log(fz)) > _SPREAD_OF_LOAD:
        shares.append((fz / np.mean(fz)) ** 2)
    if _growth(clean, used, keep) > _FOLLOWS:
        shares += [used, used**2]
    return [base**2 * share for share in shares]


def _variance_law(clean, spread, shapes, keep, dof, stated=False) -> np.ndarray:
    """sqrt of the shapes and the slip noise's share, by non-negative least squares.

    Args:
        stated: whether the slip noise's share holds as it is; else all of the variance
            is scaled to that of the rows, as the share may be too large.
    """
    square = np.maximum(clean[keep] ** 2 * (keep.sum() / dof), NONZERO)
    level = np.full(keep.sum(), square.mean())
    own = square - spread[keep]
    own = own if stated else np.maximum(own, 0)
    for _ in range(_LAW_ROUNDS):
        columns = np.stack([s[keep] / level for s in shapes], axis=1)
        part, _ = nnls(columns, own / level)
        variance = sum(c * s for c, s in zip(part, shapes, strict=True)) + spread
        variance = np.maximum(variance, _LEAST_VARIANCE * square.mean())
        level = variance[keep]
    return np.sqrt(variance * (1.0 if stated else np.mean(square / level)))


def _growth(clean, values, keep) -> float:
    """How the squares follow the values, in standard errors (score of the variance)."""
    x = values[keep]
    if np.ptp(x) < ROUNDING * np.max(np.abs(x)):
        return 0.0
    square = clean[keep] ** 2
    square = square / max(square.mean(), NONZERO) - 1
    x = (x - x.mean()) / np.std(x)
    return float(square @ x) / np.sqrt(2 * len(x))


def in_order(time, run) -> list[np.ndarray]:
    """Rows of each run in the order they were measured: index arrays."""
    order = np.arange(len(run)) if time is None else np.lexsort((time, run))
    return [order[run[order] == code] for code in np.unique(run)]


def correlation(white, time, run) -> float:
    """Rows per independent row, of the remainder in the order it was measured."""
    parts = [white[rows] for rows in in_order(time, run)]
    lag_one = sum(float(p[1:] @ p[:-1]) for p in parts) / max(
        sum(float(p @ p) for p in parts), NONZERO
    )
    # The smooth part taken out lowers the correlation slightly: no bias upwards.
    if lag_one < _CORRELATED / np.sqrt(len(white)):
        return 1.0
    first_order = (1 + lag_one) / max(1 - lag_one, _LONGEST)
    return float(
        min(max(autocorrelation_time(parts), first_order), len(white) / _FACTS)
    )
