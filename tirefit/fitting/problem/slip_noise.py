"""The density of the true slips of a file, from slips measured with noise.

It is the empirical-Bayes prior of the true slip of each row. A fit estimates it together with
its parameters, from slips and forces; a diagnosis, which compares many models of the force, from
the slips alone.
"""

from typing import NamedTuple

import numpy as np

from tirefit.data.table import TireData
from tirefit.results import DataError

_STANDS = 0.03
"""Share of the median speed below which the slip noise no longer grows: the noise of a
standing wheel would be infinite."""


def speed_of(data: TireData) -> np.ndarray:
    """Speeds (n_used,) [m/s], for a slip noise that is given as one of a speed.

    Raises:
        DataError: no column v.
    """
    if "v" in data:
        return data.usable("v")
    reason = "the slip noise is given as noise of a speed, but the data have no column v"
    remedy = "name its column with --column v=HEADER, or --constant v=10"
    raise DataError(reason, remedy, data.file)


def std_with_speed(plain: float, of_speed: float, v: np.ndarray) -> np.ndarray:
    """Standard deviations (n,) of slips that come from positions or wheel speeds.

    Args:
        plain: the part that does not depend on speed [-].
        of_speed: standard deviation of the slip velocity of the patch [m/s].
        v: (n,) speeds [m/s].
    """
    size = np.abs(v)
    return np.hypot(plain, of_speed / np.maximum(size, _STANDS * np.median(size)))


_KNOTS = 30
"""Knots of a density. In 24 files each of 400 rows with five levels of noise, estimates with
them scattered by 0.93 to 1.03 of those with the true density."""
_BESIDE, _BESIDE_STEEP = 2.0, 0.01
"""Slip standard deviations from the outermost measured slips to the outermost knots. Where slips
are judged for the forces, a density beyond them extends to sliding, and raises the friction; it
is not needed, as a force states its slip. Not 0: knots of equal slips would coincide."""
SMOOTH, SMOOTH_STEEP = 10.0, 0.1
"""Weights of the squared second differences of the log density, where it is profiled and
where slips are judged for the forces. A weight estimated for each file falls to nothing where
a rig holds set points, and the profiled estimates then scatter by twice as much. For steep
forces only the part matters where the curve saturates, into which a smooth density extends.
Expected errors of friction [0.001] with 1 and knots 2 beside, 0.1 and 2, 0.1 and 0: set points
(20 N, 0.03 rad) 4.7, 4.1, 1.3; sine (20 N, 0.02 rad) 3.2, 2.2, 1.2; uniform 2.4, 1.5, 0.6. With
60 knots and 0.1, estimates for set points scatter by 0.009 instead of 0.005."""
_WEAK = 0.01
"""Weight of the squared log density, so that it is finite where there are no slips."""
_FLOOR = 1e-9
"""Density over its largest value, so that no slip is impossible."""
_SETTLED = 1e-6  # gain in log likelihood of the last step
_MOST_STEPS, _HALVINGS = 50, 8


def slip_knots(slip: np.ndarray, std: np.ndarray, steep: bool = False) -> np.ndarray:
    """Knots (k,) of the density of the true slips of measured ones (n,).

    Args:
        steep: whether slips are judged for the forces, see :mod:`latent_slip`.
    """
    beside = (_BESIDE_STEEP if steep else _BESIDE) * std
    return np.linspace(np.min(slip - beside), np.max(slip + beside), _KNOTS)


class SlipDensity(NamedTuple):
    """A density over knots, and the slopes (n, k) of the log likelihood of each row over the
    logarithms of its heights; ``penalty`` (k, k) is half the curvature of their prior."""

    knots: np.ndarray
    heights: np.ndarray
    scores: np.ndarray
    penalty: np.ndarray

    def at(self, slips: np.ndarray) -> np.ndarray:
        """Density at slips of any shape."""
        density = np.interp(slips, self.knots, self.heights, left=0.0, right=0.0)
        return density + _FLOOR * self.heights.max()

    def profiled(self, scores: np.ndarray) -> np.ndarray:
        """Information (p, p) on parameters that is left if the density is unknown, from the
        slopes (n, p) of the log likelihood of the rows over these parameters."""
        mixed = self.scores.T @ scores
        inner = self.scores.T @ self.scores + self.penalty
        return scores.T @ scores - mixed.T @ np.linalg.solve(inner, mixed)


def slip_density(
    knots: np.ndarray, nodes: np.ndarray, weights: np.ndarray, smooth: float = SMOOTH
) -> SlipDensity:
    """The density of the true slips of a file: penalised maximum likelihood.

    Args:
        knots: (k,) rising, equally spaced. The density is linear between them.
        nodes: (n, q) possible true slips of each row.
        weights: (n, q) of each, by the force and the measured slip of the row.
        smooth: weight of the penalty on a log density that is not straight.
    """
    count, spacing = len(knots), knots[1] - knots[0]
    place = np.clip((nodes - knots[0]) / spacing + 1, 0.0, count + 1 - 1e-9)
    below, rows = place.astype(int), np.arange(len(nodes))[:, None]
    parts = np.zeros((len(nodes), count + 2))
    np.add.at(parts, (rows, below), weights * (below + 1 - place))
    np.add.at(parts, (rows, below + 1), weights * (place - below))
    parts = parts[:, 1:-1]
    # A row without likelihood at any knot (an outlier) says nothing of the density.
    parts = parts / np.maximum(parts.max(axis=1, keepdims=True), 1e-300) + 1e-12
    bend = np.diff(np.eye(count), 2, axis=0)
    penalty = smooth * bend.T @ bend + _WEAK * np.eye(count)
    log = np.zeros(count)

    def value(log: np.ndarray) -> float:
        return np.sum(np.log(parts @ _shares(log))) - log @ penalty @ log / 2

    best = value(log)
    for _ in range(_MOST_STEPS):
        scores = _scores(parts, log)
        step = np.linalg.solve(scores.T @ scores + penalty, scores.sum(axis=0) - penalty @ log)
        before, tries = best, [log + step / 2**k for k in range(_HALVINGS)]
        log = next((new for new in tries if value(new) > before), log)
        best = value(log)
        if best - before < _SETTLED:
            break
    return SlipDensity(knots, _shares(log), _scores(parts, log), penalty)


def _scores(parts: np.ndarray, log: np.ndarray) -> np.ndarray:
    """Slopes (n, k) of the log likelihood of the rows over the logarithms of the shares."""
    share = _shares(log)
    each = parts * share
    return each / each.sum(axis=1, keepdims=True) - share


def _shares(log: np.ndarray) -> np.ndarray:
    share = np.exp(log - log.max())
    return share / share.sum()
