"""Estimates by other libraries (dependency group ``benchmark``).

Both get the same inputs as tirefit's methods: means of ten samples, the same expected
stiffness, the same rule for samples of little excitation.
"""

from collections.abc import Callable

import numpy as np

from fits.formulas import brush
from fits.friction_benchmark.metrics import Trace
from tirefit.online.methods import STIFFNESS_OF_LOAD

__all__ = ["PEERS", "filterpy_ekf", "means", "statsmodels_rls"]

_AVERAGE = 10
_FRICTION = 0.98
_LEAST = 0.1
_FORCE, _SLIP = 0.0447, 0.00447
_RESOLVED = 0.15
_JUMP = 0.02


def means(columns):
    """(row, sigma, force over load) of every ten rows, and the load [N].

    Ten rows with a locked wheel or a jump of the slip are left out.
    """
    n = len(columns["time"]) // _AVERAGE * _AVERAGE
    parts = {k: columns[k][:n].reshape(-1, _AVERAGE) for k in ("sigma_x", "fx", "fz")}
    spread = np.ptp(parts["sigma_x"], axis=1)
    whole = np.isfinite(sum(part.sum(1) for part in parts.values()))
    # Noise of ten samples spreads over some three standard deviations.
    used = whole & (spread < _JUMP + 4 * _SLIP)
    rows = np.arange(_AVERAGE - 1, n, _AVERAGE)
    sigma, force, load = (part.mean(1) for part in parts.values())
    side = np.where(sigma < 0, -1.0, 1.0)
    used &= 2 * STIFFNESS_OF_LOAD * np.abs(sigma) > _LEAST
    return rows[used], np.abs(sigma)[used], (side * force / load)[used], load[used]


def _held(columns, rows, mu, std, alarm) -> Trace:
    """Row by row: every estimate is held until the next one."""
    n = len(columns["time"])
    last = np.searchsorted(rows, np.arange(n), side="right") - 1
    there = last >= 0
    at = np.maximum(last, 0)
    every = np.where(there, mu[at], np.nan), np.where(there, std[at], np.nan)
    alarms = np.zeros(n, bool)
    alarms[rows[alarm]] = True
    sure = there & (every[1] < _RESOLVED * every[0])
    return Trace(columns["time"], *every, sure, alarms)


def statsmodels_rls(columns) -> Trace:
    """statsmodels' RecursiveLS on y = c1 u + c2 u^2 + c3 u^3, S(49) with three free
    coefficients: mu = -c1^2 / (3 c2), without forgetting. Its alarm is its CUSUM of
    recursive residuals outside the 5 % lines."""
    import statsmodels.api as sm

    rows, sigma, y, _ = means(columns)
    u = 2 * STIFFNESS_OF_LOAD * sigma
    fit = sm.RecursiveLS(y, np.stack([u, u**2, u**3], axis=1)).fit()
    c1, c2, _ = fit.recursive_coefficients.filtered
    covariance = fit.recursive_coefficients.filtered_cov
    with np.errstate(divide="ignore", invalid="ignore"):
        mu = -(c1**2) / (3 * c2)
        slope = np.stack([2 * mu / c1, -mu / c2])
        std = np.sqrt(np.einsum("in,ijn,jn->n", slope, covariance[:2, :2], slope))
    usable = (c1 > 0) & (mu > 0) & np.isfinite(std)
    mu, std = np.where(usable, mu, np.nan), np.where(usable, std, np.nan)
    return _held(columns, rows, mu, std, _left(fit, len(rows)))


def _left(fit, n):
    """Rows (n,) at which the CUSUM of recursive residuals leaves its 5 % lines."""
    sums = np.asarray(fit.cusum)
    skipped, root = n - len(sums), np.sqrt(len(sums))
    # The lines of Brown, Durbin and Evans (1975), as RecursiveLSResults draws them.
    lines = 0.948 * (root + 2 * (np.arange(len(sums)) + 1) / root)
    beyond = np.abs(sums) > lines
    return np.r_[np.zeros(skipped, bool), beyond & ~np.r_[False, beyond[:-1]]]


def filterpy_ekf(columns) -> Trace:
    """filterpy's ExtendedKalmanFilter on (ln c_p a^2, ln mu) through the brush S(12).

    The same model, noise and random walk as tirefit's ekf, without its treatment of
    misfit and changes. The library has no change detection: the alarm is Page's test on
    the innovations at tirefit's threshold.
    """
    from filterpy.kalman import ExtendedKalmanFilter

    from fits.friction_benchmark.page import page_test

    rows, sigma, y, load = means(columns)
    interval = np.diff(columns["time"][rows], prepend=columns["time"][0])
    kalman = ExtendedKalmanFilter(dim_x=2, dim_z=1)
    kalman.x = np.log([[STIFFNESS_OF_LOAD * load[0]], [_FRICTION]])
    kalman.P = np.diag([0.4**2, 0.5**2])
    mu, std, surprise = np.empty((3, len(rows)))

    def force(x, slip, fz):
        stiffness, friction = np.exp(x[0, 0]), np.exp(x[1, 0])
        return np.array([[brush(slip, fz, 0.0, stiffness, friction) / fz]])

    def slopes(x, slip, fz, size=1e-5):
        steps = size * np.eye(2)[:, :, None]
        return np.hstack(
            [(force(x + d, slip, fz) - force(x - d, slip, fz)) / 2 / size for d in steps]
        )

    for k in range(len(rows)):
        kalman.Q = np.diag([0.005**2, 0.02**2]) * interval[k]
        kalman.predict()
        there = (sigma[k], load[k])
        step = 1e-5
        by_slip = force(kalman.x, sigma[k] + step, load[k])
        by_slip = (by_slip - force(kalman.x, sigma[k] - step, load[k])) / 2 / step
        kalman.R = (_FORCE**2 + (_SLIP * by_slip) ** 2) / _AVERAGE
        kalman.update(y[k], slopes, force, args=there, hx_args=there)
        mu[k] = np.exp(kalman.x[1, 0])
        std[k] = mu[k] * np.sqrt(kalman.P[1, 1])
        surprise[k] = (kalman.y / np.sqrt(kalman.S)).item()
    alarm = np.zeros(len(rows), bool)
    alarm[page_test(surprise, 12.0)] = True
    return _held(columns, rows, mu, std, alarm)


PEERS: dict[str, Callable] = {
    "statsmodels RecursiveLS": statsmodels_rls,
    "filterpy EKF": filterpy_ekf,
}
"""Name -> function of a log's columns."""
