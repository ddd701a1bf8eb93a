"""The noise of a file: what no smooth gap explains, judged before any effect is."""

from typing import NamedTuple

import numpy as np

from tirefit.fitting.noise import autocorrelation_time

__all__ = ["NoiseLevel", "judge_noise"]


class NoiseLevel(NamedTuple):
    """Standard deviation (n,) of one force, rows per independent row, outliers (n,)
    bool, flags, and where the level came from."""

    std: np.ndarray
    inflation: float
    outlier: np.ndarray
    flags: tuple[str, ...]
    source: str


def judge_noise(
    residual, spread, fz, given, basis, time, run, outliers=True
) -> NoiseLevel:
    """Noise of one channel.

    Args:
        residual: (n,) [N] of the base fit.
        spread: (n,) variance that the slip noise gives [N^2].
        fz: (n,) load.
        given: (n,) stated standard deviation, or None.
        basis: (n, m) smooth functions that soak up any gap (unit columns, in N).
        time, run: order of the rows (time may be None).
        outliers: whether rows far off are set aside.
    """
    base = given if given is not None else np.full(len(residual), 1.0)
    std = np.sqrt(base**2 + spread) if given is not None else base
    keep = np.ones(len(residual), bool)
    smooth = _Smooth(basis / std[:, None], keep)
    clean = smooth.remainder(residual / std)
    for _ in range(3 if outliers else 0):
        level = clean
        if given is None:  # larger loads scatter more: no outliers for that
            law, _ = _variance_law(clean, spread, fz, keep, smooth.freedom)
            level = clean / law
        unit = 1.4826 * np.median(np.abs(level[keep]))
        good = np.abs(level) < 4.5 * max(unit, 1e-12)
        if np.array_equal(good, keep):
            break
        keep, smooth = good, _Smooth(basis / std[:, None], good)
        clean = smooth.remainder(residual / std)
    dof = smooth.freedom
    flags, source = [], "given"
    ratio = float(np.sqrt(np.sum(clean[keep] ** 2) / max(dof, 1.0)))
    if given is None:
        std, hetero = _variance_law(clean * std, spread, fz, keep, dof)
        source = "differences"
        if hetero:
            flags.append("heteroscedastic")
    elif ratio > 1 + max(0.15, 4 / np.sqrt(2 * dof)) or ratio < 0.6:
        std, source = std * ratio, "estimated: the given level disagrees"
        flags.append("noise_misstated")
    clean = clean * (base if given is None else 1.0)
    if given is not None and _uneven(clean, fz, keep):
        flags.append("heteroscedastic")
    expected = 2e-5 * len(residual)
    if np.count_nonzero(~keep) > max(3.0, 5 * expected, 0.004 * len(residual)):
        flags.append("outliers")
    white = np.where(keep, clean, 0.0) / (std if given is None else 1.0)
    inflation = _correlation(white, time, run)
    if inflation > 1.0:
        flags.append("autocorrelated")
    return NoiseLevel(std, inflation, ~keep, tuple(flags), source)


class _Smooth:
    """Least squares on a basis, by its normal equations."""

    def __init__(self, basis, keep):
        self.basis, self.keep = basis, keep
        part = basis * keep[:, None]
        values, vectors = np.linalg.eigh(part.T @ part)
        good = values > 1e-6 * values.max()
        self.root = vectors[:, good] / np.sqrt(values[good])
        self.freedom = max(int(keep.sum()) - int(good.sum()), 1)

    def remainder(self, residual):
        """Residual less its smooth part, (n,)."""
        score = self.root.T @ (self.basis.T @ (residual * self.keep))
        return residual - self.basis @ (self.root @ score)


def _variance_law(clean, spread, fz, keep, dof):
    """sqrt(a^2 + b^2 F_z^2 + slip noise's share), by non-negative least squares."""
    from scipy.optimize import nnls

    square = clean[keep] ** 2 * (keep.sum() / dof)
    shapes = [np.ones_like(fz)]
    if np.std(np.log(fz)) > 0.05:
        shapes.append((fz / np.mean(fz)) ** 2)
    level = np.full(keep.sum(), square.mean())
    for _ in range(4):
        columns = np.stack([s[keep] / level for s in shapes], axis=1)
        part, _ = nnls(columns, np.maximum(square - spread[keep], 0) / level)
        variance = sum(c * s for c, s in zip(part, shapes, strict=True)) + spread
        variance = np.maximum(variance, 1e-3 * square.mean())
        level = variance[keep]
    total = np.mean(square / level)
    std = np.sqrt(variance * total)
    return std, bool(np.max(std) > 1.3 * np.min(std))


def _uneven(white, fz, keep) -> bool:
    """Whether the squares follow the load (score test of the variance, 0.1 %)."""
    x = np.log(fz[keep])
    if np.std(x) < 0.03:
        return False
    square = white[keep] ** 2
    square = square / square.mean() - 1
    x = (x - x.mean()) / np.std(x)
    return abs(square @ x) / np.sqrt(2 * len(x)) > 4.0


def _correlation(white, time, run) -> float:
    """Rows per independent row, of the remainder in the order it was measured."""
    order = np.arange(len(white)) if time is None else np.lexsort((time, run))
    parts = [white[order][run[order] == code] for code in np.unique(run)]
    lag_one = sum(float(p[1:] @ p[:-1]) for p in parts) / max(
        sum(float(p @ p) for p in parts), 1e-300
    )
    # The smooth part taken out lowers the correlation slightly: no bias upwards.
    if lag_one < 4.0 / np.sqrt(len(white)):
        return 1.0
    first_order = (1 + lag_one) / max(1 - lag_one, 1e-3)
    return float(min(max(autocorrelation_time(parts), first_order), len(white) / 20))
