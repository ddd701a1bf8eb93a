"""True slips that a noisy one may stand for, from the density of the file's slips."""

import numpy as np

from tirefit.diagnosis.negligible import FLAT, NONZERO
from tirefit.fitting.slip_noise import SlipDistribution, slip_distribution

_FEW, _MANY = (np.polynomial.hermite_e.hermegauss(count) for count in (3, 5))
"""Gauss-Hermite nodes of the slip noise: exact for polynomial forces of degree 5, 9."""


def _steep(slip, std) -> bool:
    """Whether the force bends within the noise: 1 % of a large slip."""
    large = max(float(np.quantile(np.abs(slip), 0.9)), FLAT)
    return float(np.median(std)) > 0.01 * large


def slip_law(slip, std) -> SlipDistribution | None:
    """Distribution of the true slips, from measured ones and their noise (n,); None
    without noise."""
    return slip_distribution(slip, np.maximum(std, FLAT)) if np.any(std > 0) else None


def slip_nodes(law: SlipDistribution | None, slip, std):
    """True slips and their probabilities, (n, k) each; measured slips without a law."""
    if law is None:
        return slip[:, None], np.ones((len(slip), 1))
    offset, mass = _MANY if _steep(slip, std) else _FEW
    mean, spread = law.moments(slip, std)
    nodes = mean[:, None] + spread[:, None] * offset
    return nodes, np.tile(mass / mass.sum(), (len(slip), 1))


def slip_doubt(law: SlipDistribution | None, slip, std, path=None) -> np.ndarray:
    """Common error of the estimated slips: columns (n, k) times independent unit normal
    numbers.

    All rows share one density of the true slips, which was estimated from the same
    noisy slips: where the slip moves steadily, rows of one phase have the same error.
    ``path`` holds slips (n,) estimated from their neighbours in time, or is None.
    """
    columns, std = [np.zeros((len(slip), 0))], np.maximum(std, FLAT)
    if law is not None and _steep(slip, std):
        columns.append(_of_density(law, slip, std))
    if law is not None and path is not None:
        offset, mass = _MANY
        believed = np.array([law.moments(path + std * e, std)[0] for e in offset]).T
        columns.append((believed @ (mass / mass.sum()) - path)[:, None])
    return np.concatenate(columns, axis=1)


def slip_proxies(slip, std, measured, path=None, past=None) -> np.ndarray:
    """Noise of the slips as other measurements predict it: columns (n, k).

    A quantity that moves with the true slip (its neighbours in time, a load that the
    cornering shifts) has none of its noise, so a regression gives it a part of the
    slip's effect. The expected noise of row i is std^2 / variance(slip - predicted) of
    (slip - predicted)_i.

    Args:
        measured: (n,) each; the slips are predicted from a cubic of each and the past.
        path: as in :func:`slip_doubt`.
        past: (n, k) slips before, at and after each row by their neighbours in time.
    """
    if not np.any(std > 0):
        return np.zeros((len(slip), 0))
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
        off = predicted - slip
        known = np.mean(std**2) / max(float(np.mean(off**2)), NONZERO)
        if known > 0.2:  # a smaller share of the noise is not worth a column
            columns.append(min(known, 1.0) * off)
    return np.array(columns).reshape(len(columns), len(slip)).T


def _of_density(law: SlipDistribution, slip, std) -> np.ndarray:
    """Error of the slips by that of the density's weights, which add up to one: maximum
    likelihood with a weak prior (each weight about as large as all on average)."""
    # Likelihood of each row under each part of the density (n, parts), and the same
    # times the true slip less the measured one.
    unit, step = np.linspace(-4, 4, 41), np.diff(law.knots)[0]
    off = std[:, None] * unit
    far = np.abs((slip[:, None] + off)[..., None] - law.knots[1:-1]) / step
    bell = np.exp(-0.5 * unit**2) * np.diff(unit)[0] / step
    hats = np.maximum(1 - far, 0) * bell[:, None]
    place = law.standing - slip[:, None]
    there = np.exp(-0.5 * (place / std[:, None]) ** 2) / std[:, None]
    likely = np.hstack([hats.sum(axis=1), there]) / np.sqrt(2 * np.pi)
    first = np.hstack([np.einsum("nqk,nq->nk", hats, off), there * place])
    first /= np.sqrt(2 * np.pi)
    weight = np.append(law.density[1:-1] * step, law.shares)
    together = np.maximum(likely @ weight, NONZERO)[:, None]
    mean = first @ weight / together[:, 0]
    moved = (first - mean[:, None] * likely) / together
    # Directions in which the weights still add up to one.
    free = np.linalg.svd(np.ones((1, len(weight))))[2][1:].T
    score = likely / together @ free
    normal = score.T @ score + len(weight) ** 2 * np.eye(free.shape[1])
    return moved @ free @ np.linalg.cholesky(np.linalg.inv(normal))
