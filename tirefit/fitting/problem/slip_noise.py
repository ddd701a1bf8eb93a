"""The distribution of the true slips of a file, from slips measured with noise.

It is the empirical-Bayes prior of the true slip of each row. A fit estimates it together with
its parameters, from slips and forces (:func:`slip_density`); a diagnosis, which compares many
models of the force, from the slips alone (:func:`slip_distribution`).
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


_HATS = 20
"""Largest number of triangular functions of a density. There are fewer if their spacing
would fall below the slip noise: the data do not resolve finer detail."""
_STEPS_AFTER = 60  # steps of expectation maximisation after each standing slip is added
_MOST_STANDING, _MOST_PEAKS = 40, 8
"""Largest number of standing slips, and of places that are tried for the next one."""


_ENOUGH = 4000
"""Rows from which a diagnosis estimates a distribution: more rows change it little."""
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


class SlipDistribution(NamedTuple):
    """A piecewise linear density, and standing slips, each the true slip of many rows.
    The density and the shares of the standing slips add up to one."""

    knots: np.ndarray
    density: np.ndarray
    standing: np.ndarray  # (k,)
    shares: np.ndarray  # (k,)

    def moments(
        self, slip: np.ndarray, std: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Mean and standard deviation (n,) of each latent slip given the measured one,
        and the share (n,) of that variance which rows of one standing slip have in common.

        The rows of a standing slip share the error of its place and do not scatter by
        it. Each row is given the variance of its own noise instead: the variance of
        their mean is then that of the place.
        """
        offset = np.linspace(-4, 4, 41)
        nodes = slip[:, None] + std[:, None] * offset
        moving = np.interp(nodes, self.knots, self.density, left=0.0, right=0.0)
        moving = (moving + 1e-6 * self.density.max()) * _gauss(offset) * np.diff(offset)[0]
        # A slip measured without noise is the true slip.
        there = _standing_likelihood(slip, np.where(std > 0, std, 1.0), self.standing)
        there = np.where(std[:, None] > 0, self.shares * there, 0.0)
        total = moving.sum(axis=1) + there.sum(axis=1)
        weight = np.concatenate([moving, there], axis=1) / total[:, None]
        places = np.broadcast_to(self.standing, there.shape)
        places = np.concatenate([nodes, places], axis=1) - slip[:, None]
        mean = np.sum(weight * places, axis=1)
        square = np.sum(weight * (places - mean[:, None]) ** 2, axis=1)
        common = std**2 * there.sum(axis=1) / total
        square = square + common
        return slip + mean, np.sqrt(square), common / np.maximum(square, 1e-300)


_NEW_SHARE = 0.05  # share that new standing slips begin with, together
_SHARES = np.array([[0.003], [0.01], [0.03], [0.1], [0.3]])  # tried of one more standing slip


def slip_distribution(slip: np.ndarray, std: np.ndarray) -> SlipDistribution:
    """Distribution of the true slips of measured ones (n,) with standard deviations
    (n,): a density and standing slips.

    A wheel that rolls freely between two pulses of the brake, or a rig that steps
    through set points, has many rows of one slip, which a smooth density cannot
    describe. Standing slips are added where the likelihood rises most, while it rises
    by more than the penalty for two parameters (the place, found by search, and the
    share): together those that exceed the penalty alone, then one by one.
    """
    every = max(len(slip) // _ENOUGH, 1)
    slip, std = slip[::every], std[::every]
    noise = float(np.median(std))
    width = max(float(np.ptp(slip)), noise)
    hats = int(np.clip(width / max(noise, 1e-300), 3, _HATS))
    spacing = width / (hats - 1)
    knots = slip.min() + spacing * np.arange(-1, hats + 1)
    # Likelihood of each slip for each hat of unit area, (n, hats), by quadrature.
    offset, mass = np.polynomial.hermite_e.hermegauss(15)
    true = slip[:, None] + std[:, None] * offset
    hat = np.maximum(1 - np.abs(true[..., None] - knots[1:-1]) / spacing, 0)
    columns = smooth = np.einsum("q,nqk->nk", mass / mass.sum(), hat) / spacing
    weight = _weights(columns, np.full(hats, 1 / hats), 3 * _STEPS_AFTER)
    places = np.linspace(slip.min(), slip.max(), int(np.clip(2 * np.ptp(slip) / noise, 2, 2000)))
    near = _standing_likelihood(slip, std, places)
    standing, likely = np.zeros(0), _log_likelihood(columns, weight)
    worth = 1.2 * np.log(len(slip))

    def beside(more: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """The distribution with more places; None if it gains less than the penalty."""
        wider = np.append(standing, places[more])
        fitted = _with_more(slip, std, smooth, wider, weight)
        rise = _log_likelihood(*fitted[:2]) - likely
        return fitted if rise >= worth * len(more) else None

    while len(standing) < _MOST_STANDING:
        together = columns @ weight
        rises = np.pad(1 / np.maximum(together, 1e-300) @ near, 1, constant_values=-np.inf)
        peaks = np.flatnonzero((rises[1:-1] >= rises[:-2]) & (rises[1:-1] >= rises[2:]))
        peaks = peaks[np.argsort(-rises[1:-1][peaks])][:_MOST_PEAKS]
        # From a share of one more part with the ratios of the others unchanged: a lower limit
        # of the gain in log likelihood when all shares are fitted again.
        ratios = near[:, peaks].T / np.maximum(together, 1e-300) - 1
        gains = np.array([np.max(np.log1p(_SHARES * ratio).sum(axis=1)) for ratio in ratios])
        # These exceed the penalty by themselves; the others are tried one by one.
        large = gains > worth
        room = _MOST_STANDING - len(standing)
        tries = [peaks[large][:room]] if np.sum(large) > 1 else []
        order = np.argsort(-gains, kind="stable")[:4]
        tries += [peaks[[k]] for k in order if gains[k] > 0.2 * worth]
        best = next((fitted for fitted in map(beside, tries) if fitted is not None), None)
        if best is None:
            break
        columns, weight, standing = best
        likely = _log_likelihood(columns, weight)
    density = np.concatenate([[0.0], weight[:hats] / spacing, [0.0]])
    return SlipDistribution(knots, density, standing, weight[hats:])


def _with_more(
    slip: np.ndarray, std: np.ndarray, smooth: np.ndarray, standing: np.ndarray, weight: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(columns, weights, places) of the smooth parts and the standing slips, the last of
    which are new; all places are refined."""
    new = smooth.shape[1] + len(standing) - len(weight)
    share = np.append((1 - _NEW_SHARE) * weight, np.full(new, _NEW_SHARE / new))
    for _ in range(3):
        alone = _standing_likelihood(slip, std, standing)
        wider = np.concatenate([smooth, alone], axis=1)
        share = _weights(wider, share, _STEPS_AFTER // 3)
        mine = alone * share[smooth.shape[1] :]
        mine /= np.maximum(wider @ share, 1e-300)[:, None] * std[:, None] ** 2
        standing = slip @ mine / np.maximum(mine.sum(axis=0), 1e-300)
    return wider, share, standing


def _standing_likelihood(slip: np.ndarray, std: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Likelihood of each measured slip for each place, (n, k)."""
    return _gauss((slip[:, None] - places) / std[:, None]) / std[:, None]


def _log_likelihood(columns: np.ndarray, weight: np.ndarray) -> float:
    return float(np.sum(np.log(np.maximum(columns @ weight, 1e-300))))


def _gauss(x: np.ndarray) -> np.ndarray:
    return np.exp(-0.5 * x**2) / np.sqrt(2 * np.pi)


def _weights(columns: np.ndarray, weight: np.ndarray, iterations: int) -> np.ndarray:
    """Weights of the parts by expectation maximisation."""
    for _ in range(iterations):
        together = np.maximum(columns @ weight, 1e-300)
        weight = weight * (1 / together @ columns) / len(columns)
    return weight
