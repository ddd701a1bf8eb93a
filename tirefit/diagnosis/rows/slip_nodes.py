"""The slips that a noisy one may stand for, by the density of the slips of the file."""

import numpy as np

from tirefit.diagnosis.negligible import FLAT, NONZERO
from tirefit.fitting.slip_noise import SlipDistribution, slip_distribution

_COUNTS = (3, 5)
"""Gauss-Hermite nodes of the slip noise: exact for a force that is a polynomial of
degree 5 or 9 within it."""
_STEEP, _LARGE = 0.01, 0.9
"""Noise of the slip over a large slip from which the force bends within it, and the
quantile of the slips that is large."""
_NODES = {count: np.polynomial.hermite_e.hermegauss(count) for count in _COUNTS}

_TELLS = 0.2
"""Share of the noise in what slip and prediction differ by from which the prediction
knows of it."""

_SWINGS = 32
"""Rows of a stretch in which a swing is looked for, at least."""

_TUNED = 41
"""Frequencies tried about the strongest of a stretch, over two of its steps."""

_WITHIN = np.linspace(-4.0, 4.0, 41)
"""Slips that a measured one may stand for, in standard deviations of its noise."""


def _steep(slip, std) -> bool:
    large = max(float(np.quantile(np.abs(slip), _LARGE)), FLAT)
    return float(np.median(std)) > _STEEP * large


def slip_law(slip, std) -> SlipDistribution | None:
    """Distribution of the latent slips of a file; None where they have no noise.

    Args:
        slip: (n,) measured values.
        std: (n,) their noise.
    """
    return slip_distribution(slip, np.maximum(std, FLAT)) if np.any(std > 0) else None


def slip_nodes(law: SlipDistribution | None, slip, std):
    """Latent slips (n, k) and their probabilities (n, k).

    Args:
        law: :func:`slip_law` of the file; without one a row has one slip, its own.
        slip: (n,) measured values.
        std: (n,) their noise.
    """
    if law is None:
        return slip[:, None], np.ones((len(slip), 1))
    # Enough nodes for the curvature of the force within the slip noise.
    offset, mass = _NODES[_COUNTS[int(_steep(slip, std))]]
    mean, spread = law.moments(slip, std)
    nodes = mean[:, None] + spread[:, None] * offset
    return nodes, np.tile(mass / mass.sum(), (len(slip), 1))


def slip_doubt(law: SlipDistribution | None, slip, std, path=None) -> np.ndarray:
    """How far the latent slips may be off together: columns (n, k), of which
    independent unit normal numbers make the error of the slips.

    Their density is estimated from the same noisy slips, which counts where the noise
    is not small beside them. And it is one for all rows: where the slip moves steadily
    in time, all rows of one phase are off to the same side.

    Args:
        law: :func:`slip_law` of the file.
        slip, std: (n,) measured values and their noise.
        path: (n,) slips as their neighbours in time show them, None where they do not.
    """
    if law is None:
        return np.zeros((len(slip), 0))
    std = np.maximum(std, FLAT)
    steep = _steep(slip, std)
    if not steep and path is None:
        return np.zeros((len(slip), 0))
    columns = [_of_density(law, slip, std)] if steep else []
    if path is not None:
        columns.append(_of_phase(law, path, std)[:, None])
    return np.concatenate(columns, axis=1)


def slip_proxies(slip, std, measured, path=None, swing=None, past=None) -> np.ndarray:
    """How much nearer to the true slips something else is than the slips themselves:
    columns (n, k), one of each way to tell that knows of their noise.

    What moves with the true slip (its neighbours in time, a load that the cornering
    shifts) knows it without the noise of the slip. A regression then gives it a part
    of what the slip does, by no effect of its own. The noise of row i is expected to be
    std^2 / variance(slip - told) of (slip - told)_i.

    Args:
        measured: (n,) each, what else was measured and is not set to a few levels; the
            slips are predicted from a cubic of each and from the past, all together.
        path: as in :func:`slip_doubt`.
        swing: (n,) :func:`swing_of` the slips, None where there is none.
        past: (n, k) slips before, at and after each row, as their neighbours in time
            show them; None where they do not.
    """
    if not np.any(std > 0):
        return np.zeros((len(slip), 0))
    others = []
    if measured:
        # Together, and with the past, they know what none of them does by itself: the
        # motion of a vehicle follows its slip.
        powers = [_powers(np.asarray(values)) for values in measured]
        known = np.concatenate(powers if past is None else [*powers, past], axis=1)
        others = [_predicted(slip, known)]
    columns = []
    for told in [*others, *(one for one in (path, swing) if one is not None)]:
        off = told - slip
        known = np.mean(std**2) / max(float(np.mean(off**2)), NONZERO)
        if known > _TELLS:
            columns.append(min(known, 1.0) * off)
    return np.array(columns).reshape(len(columns), len(slip)).T


def swing_of(slip, time, stretches) -> np.ndarray:
    """The slips (n,) as a swing of each unbroken stretch: a mean and one sine in time,
    by least squares. A rig that sweeps in sines, a slalom, is known by all its rows far
    better than by the neighbours of one.

    Args:
        stretches: rows in the order of time (index arrays), which share no row.
    """
    told = np.array(slip, float)
    for rows in stretches:
        if len(rows) >= _SWINGS:
            told[rows] = _one_swing(slip[rows], time[rows])
    return told


def _one_swing(slip, time) -> np.ndarray:
    span = max(float(np.ptp(time)), NONZERO)
    even = np.interp(np.linspace(time[0], time[-1], len(time)), time, slip)
    turns = 1 + np.argmax(np.abs(np.fft.rfft(even - even.mean())[1:]))
    periods = turns + np.linspace(-1, 1, _TUNED)[:, None]
    angle = 2 * np.pi * periods * (time - time[0]) / span
    columns = np.stack([np.ones_like(angle), np.sin(angle), np.cos(angle)], axis=1)
    normal = columns @ np.swapaxes(columns, 1, 2)
    # Without a single turn there is no sine.
    weights = np.linalg.pinv(normal, hermitian=True) @ (columns @ slip)[:, :, None]
    told = np.sum(weights * columns, axis=1)
    return told[np.argmin(np.sum((slip - told) ** 2, axis=1))]


def _powers(covariate) -> np.ndarray:
    """Cubic in something that was measured, about its mean: (n, 3)."""
    spread = max(float(np.std(covariate)), NONZERO)
    return np.vander((covariate - np.mean(covariate)) / spread, 4)[:, :3]


def _predicted(slip, columns) -> np.ndarray:
    """The slips (n,) by columns (n, k) and a constant: least squares."""
    free = np.column_stack([np.ones(len(slip)), columns])
    return free @ np.linalg.lstsq(free, slip, rcond=None)[0]


def _of_phase(law: SlipDistribution, path, std) -> np.ndarray:
    """Mean of what is believed of a row at ``path`` less the path itself: (n,)."""
    offset, mass = _NODES[_COUNTS[1]]
    believed = [law.moments(path + std * e, std)[0] for e in offset]
    return np.array(believed).T @ (mass / mass.sum()) - path


def _of_density(law: SlipDistribution, slip, std) -> np.ndarray:
    """Error of the latent slips by that of the density's weights w, which add up to
    one: maximum likelihood with a weak prior (each about as large as all on average).
    """
    likely, first = _parts(law, slip, std)
    weight = law.density[1:-1] * np.diff(law.knots)[0]
    weight = np.concatenate([weight, law.shares])
    together = np.maximum(likely @ weight, NONZERO)[:, None]
    mean = first @ weight / together[:, 0]
    moved = (first - mean[:, None] * likely) / together
    # Directions in which the weights still add up to one.
    free = np.linalg.svd(np.ones((1, len(weight))))[2][1:].T
    score = likely / together @ free
    normal = score.T @ score + len(weight) ** 2 * np.eye(free.shape[1])
    root = np.linalg.cholesky(np.linalg.inv(normal))
    return moved @ free @ root


def _parts(law: SlipDistribution, slip, std):
    """Of each part of the density, by row: its likelihood, and that times the slip it
    stands for, less the measured one: (n, parts) both."""
    nodes = slip[:, None] + std[:, None] * _WITHIN
    step = np.diff(law.knots)[0]
    bell = np.exp(-0.5 * _WITHIN**2) / np.sqrt(2 * np.pi) * np.diff(_WITHIN)[0]
    hats = [
        np.maximum(1 - np.abs(nodes - knot) / step, 0) / step * bell
        for knot in law.knots[1:-1]
    ]
    off = std[:, None] * _WITHIN
    likely = [hat.sum(axis=1) for hat in hats]
    first = [(hat * off).sum(axis=1) for hat in hats]
    for place in law.standing:
        there = np.exp(-0.5 * ((slip - place) / std) ** 2) / (std * np.sqrt(2 * np.pi))
        likely.append(there)
        first.append(there * (place - slip))
    return np.stack(likely, axis=1), np.stack(first, axis=1)
