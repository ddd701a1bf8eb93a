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


def std_with_speed(plain: float, of_speed: float, v) -> np.ndarray:
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
_STEPS, _STEPS_AFTER = 200, 60
"""Steps of expectation maximisation, and those after each standing slip is added."""
_MOST_STANDING = 40


_ENOUGH = 4000  # rows that give a distribution as well as more do
_KNOTS = 30
_BESIDE = 2.0
"""Slip standard deviations from the outermost measured slips to the outermost knots."""
_WEAKEST = 0.01
"""Curvature of the log density that is always penalised: without it a step test would give a
density of single peaks, which does not change for any distance from them."""
_FLOOR = 1e-9  # density over the largest one, so that no slip is impossible


def slip_density(nodes, likelihood, std, counted):
    """Density of the true slips at possible values (n, q) of n rows, up to a factor.

    The logarithm of the density is piecewise linear over its knots. It is the most likely
    one with a penalty on its second differences, whose weight has the largest marginal
    likelihood (Wood and Fasiolo, Biometrics 73, 2017).

    Args:
        nodes: (n, q) possible true slips of each row.
        likelihood: (n, q) of each, by all that was measured in the row.
        std: (n,) slip noise; the outermost knots lie beyond the middle nodes by it.
        counted: (n,) bool, the rows that were measured; others are only evaluated.
    """
    middle = nodes[counted, nodes.shape[1] // 2]
    low = np.min(middle - _BESIDE * std[counted])
    high = np.max(middle + _BESIDE * std[counted])
    spacing = max((high - low) / (_KNOTS - 1), 1e-300)
    place = np.clip((nodes - low) / spacing + 1, 0.0, _KNOTS + 1 - 1e-9)
    below = place.astype(int)
    beyond = place - below
    some = np.flatnonzero(counted)
    some = some[:: max(len(some) // _ENOUGH, 1)]
    parts, rows = np.zeros((len(some), _KNOTS + 2)), np.arange(len(some))[:, None]
    np.add.at(parts, (rows, below[some]), (likelihood * (1 - beyond))[some])
    np.add.at(parts, (rows, below[some] + 1), (likelihood * beyond)[some])
    heights = np.pad(_smooth_weights(parts[:, 1:-1]), 1)
    density = heights[below] * (1 - beyond) + heights[below + 1] * beyond
    return density + _FLOOR * heights.max()


def _smooth_weights(parts):
    """Weights (k,) of the parts of a density, from the likelihood (n, k) of each row for
    each: penalised maximum likelihood."""
    count = parts.shape[1]
    parts = parts / np.maximum(parts.max(axis=1, keepdims=True), 1e-300) + 1e-12
    bend = np.diff(np.eye(count), 2, axis=0)
    penalty, ridge, strength = bend.T @ bend, 0.01 * np.eye(count), 1.0
    log = np.zeros(count)

    def value(log):
        fit = np.sum(np.log(parts @ _shares(log)))
        return fit - log @ (strength * penalty + ridge) @ log / 2

    for _ in range(_STEPS):
        before, total = log, strength * penalty + ridge
        share = _shares(log)
        each = parts * share
        each = each / each.sum(axis=1, keepdims=True) - share
        inverse = np.linalg.inv(each.T @ each + total + 1e-6 * np.eye(count))
        step = inverse @ (each.sum(axis=0) - total @ log)
        tries = [log + step / 2**k for k in range(6)]
        best = max([log, *tries], key=value)
        log = best
        settled = np.max(np.abs(log - before)) < 1e-3
        last = strength
        used = count - 2 - strength * np.trace(inverse @ penalty)
        strength = np.clip(used / max(log @ penalty @ log, 1e-12), _WEAKEST, 1e6)
        if settled and abs(np.log(strength / last)) < 1e-2:
            break
    return _shares(log)


def _shares(log):
    share = np.exp(log - log.max())
    return share / share.sum()


class SlipDistribution(NamedTuple):
    """A piecewise linear density, and standing slips, each the true slip of many rows.
    The density and the shares of the standing slips add up to one."""

    knots: np.ndarray
    density: np.ndarray
    standing: np.ndarray  # (k,)
    shares: np.ndarray  # (k,)

    def moments(self, slip, std):
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


def slip_distribution(slip, std):
    """Distribution of the true slips of measured ones (n,) with standard deviations
    (n,): a density and standing slips.

    A wheel that rolls freely between two pulses of the brake, or a rig that steps
    through set points, has many rows of one slip, which a smooth density cannot
    describe. Standing slips are added where the likelihood rises most, while it rises
    by more than the penalty for two parameters (the place, found by search, and the
    share): together those that exceed the penalty alone, then one by one.
    """
    slip, std = _some(slip, std)
    knots, spacing, smooth = _hats(slip, std, _HATS)
    columns, hats = smooth, smooth.shape[1]
    weight = _weights(columns, np.full(hats, 1 / hats), 3 * _STEPS_AFTER)
    noise = float(np.median(std))
    places = np.linspace(slip.min(), slip.max(), int(np.clip(2 * np.ptp(slip) / noise, 2, 2000)))
    near = _standing_likelihood(slip, std, places)
    standing, likely = np.zeros(0), _log_likelihood(columns, weight)
    worth = 1.2 * np.log(len(slip))

    def beside(more):
        """The distribution with more places; None if it gains less than the penalty."""
        wider = np.append(standing, places[more])
        found = _with_more(slip, std, smooth, wider, weight, _STEPS_AFTER)
        rise = _log_likelihood(*found[:2]) - likely
        return found if rise >= worth * len(more) else None

    while len(standing) < _MOST_STANDING:
        together = columns @ weight
        peaks = _peaks(1 / np.maximum(together, 1e-300) @ near)
        gains = np.array([_first_gain(near[:, k], together) for k in peaks])
        # These exceed the penalty by themselves; the others are tried one by one.
        sure = gains > worth
        room = _MOST_STANDING - len(standing)
        tries = [peaks[sure][:room]] if np.sum(sure) > 1 else []
        order = np.argsort(-gains, kind="stable")[:4]
        tries += [peaks[[k]] for k in order if gains[k] > 0.2 * worth]
        best = next((found for found in map(beside, tries) if found is not None), None)
        if best is None:
            break
        columns, weight, standing = best
        likely = _log_likelihood(columns, weight)
    density = np.concatenate([[0.0], weight[:hats] / spacing, [0.0]])
    return SlipDistribution(knots, density, standing, weight[hats:])


def _peaks(values, most: int = 8):
    """Indices of the highest local maxima."""
    padded = np.pad(values, 1, constant_values=-np.inf)
    tops = (values >= padded[:-2]) & (values >= padded[2:])
    tops = np.flatnonzero(tops)
    return tops[np.argsort(-values[tops])][:most]


def _first_gain(alone, together) -> float:
    """Gain in log likelihood from a share of one more part with the ratios of the others
    unchanged: a lower limit of the gain when all shares are fitted again."""
    ratio = alone / np.maximum(together, 1e-300) - 1
    shares = np.array([0.003, 0.01, 0.03, 0.1, 0.3])[:, None]
    return float(np.max(np.sum(np.log1p(shares * ratio), axis=1)))


def _with_more(slip, std, smooth, standing, weight, iterations: int):
    """(columns, weights, places) of the smooth parts and the standing slips, the last of
    which are new; all places are refined."""
    new = smooth.shape[1] + len(standing) - len(weight)
    share = np.append((1 - _NEW_SHARE) * weight, np.full(new, _NEW_SHARE / new))
    for _ in range(3):
        alone = _standing_likelihood(slip, std, standing)
        wider = np.concatenate([smooth, alone], axis=1)
        share = _weights(wider, share, iterations // 3)
        mine = alone * share[smooth.shape[1] :]
        mine /= np.maximum(wider @ share, 1e-300)[:, None] * std[:, None] ** 2
        standing = slip @ mine / np.maximum(mine.sum(axis=0), 1e-300)
    return wider, share, standing


def _standing_likelihood(slip, std, places):
    """Likelihood of each measured slip for each place, (n, k)."""
    return _gauss((slip[:, None] - places) / std[:, None]) / std[:, None]


def _log_likelihood(columns, weight) -> float:
    return float(np.sum(np.log(np.maximum(columns @ weight, 1e-300))))


def _gauss(x):
    return np.exp(-0.5 * x**2) / np.sqrt(2 * np.pi)


def _some(slip, std):
    """Every k-th slip: some thousands give the same distribution as all of them."""
    every = max(len(slip) // _ENOUGH, 1)
    return slip[::every], std[::every]


def _hats(slip, std, hats: int):
    """(knots, spacing, likelihood of each slip for each hat (n, hats))."""
    width = max(float(np.ptp(slip)), float(np.median(std)))
    count = int(np.clip(width / max(float(np.median(std)), 1e-300), 3, hats))
    spacing = width / (count - 1)
    knots = slip.min() + spacing * np.arange(-1, count + 1)
    return knots, spacing, _hat_likelihood(slip, std, knots, spacing)


def _weights(columns, weight, iterations: int):
    """Weights of the parts by expectation maximisation."""
    for _ in range(iterations):
        together = np.maximum(columns @ weight, 1e-300)
        weight = weight * (1 / together @ columns) / len(columns)
    return weight


def _hat_likelihood(slip, std, knots, spacing):
    """Likelihood of each slip for each hat of unit area, (n, hats), by quadrature."""
    offset, mass = np.polynomial.hermite_e.hermegauss(15)
    true = slip[:, None] + std[:, None] * offset
    hat = 1 - np.abs(true[..., None] - knots[1:-1]) / spacing
    return np.einsum("q,nqk->nk", mass / mass.sum(), np.maximum(hat, 0)) / spacing
