"""A generic basis: what a gap could look like that no listed effect explains."""

import numpy as np

__all__ = ["generic_basis", "log_evidence_gain", "orthogonal"]

_SCALES = (2.0, 6.0, 18.0, 50.0)
"""Sizes of a basis function's coefficient that are averaged over, in z units."""


def _bumps(values, count: int) -> np.ndarray:
    """Radial functions at quantiles of the values, (n, count)."""
    centers = np.linspace(values.min(), values.max(), count)
    width = max((centers[1] - centers[0]), 1e-9)
    return np.exp(-0.5 * ((values[:, None] - centers) / width) ** 2)


def _standard(values):
    spread = np.std(values)
    return (values - values.mean()) / spread if spread > 1e-9 else None


def generic_basis(prepared, slip_fraction, scale) -> np.ndarray:
    """Smooth functions of slip, times load, speed, time and direction: (n, m).

    Args:
        prepared: the rows.
        slip_fraction: signed slip over that of full sliding, (n,).
        scale: typical force over the noise of each row (n,): whitens the columns.
    """
    rows = prepared.covariates
    inside = np.clip(slip_fraction, -2.5, 2.5)
    positive = inside >= 0
    parts = [_bumps(np.abs(inside), 8)]
    if 0.05 < positive.mean() < 0.95:
        parts = [parts[0] * positive[:, None], parts[0] * ~positive[:, None]]
    bumps = np.concatenate(parts, axis=1)
    modulations = [None]
    for values in (
        np.log(rows.fz), rows.v, rows.time, rows.temperature, rows.gamma, rows.other
    ):  # fmt: skip
        unit = _standard(values)
        if unit is not None:
            modulations.append(unit)
            # A second degree only where there are more than two settings.
            if len(np.unique(np.round(unit, 2))) > 3:
                modulations.append(unit**2 - 1)
    if "sweeps" in prepared.has:
        modulations.append(rows.turning)
        if (speed := _standard(rows.v)) is not None:
            modulations.append(rows.turning * speed)
    columns = [bumps if m is None else bumps * m[:, None] for m in modulations]
    if "time" in prepared.has:
        phase = 2 * np.pi * (rows.time[:, None] + 0.5) * np.arange(1, 9)
        columns.append(np.concatenate([np.sin(phase), np.cos(phase)], axis=1))
    basis = np.concatenate(columns, axis=1) * scale[:, None]
    size = np.linalg.norm(basis, axis=0)
    return basis[:, size > 1e-9] / size[size > 1e-9]


def orthogonal(basis, against):
    """(left (n, q), singular values (q,)) of the basis with ``against`` (n, p) out."""
    unit, _ = np.linalg.qr(against)
    left = basis - unit @ (unit.T @ basis)
    gram = left.T @ left
    values, vectors = np.linalg.eigh(gram)
    good = values > 1e-6 * max(values.max(), 1e-12)
    size = np.sqrt(values[good])
    return left @ (vectors[:, good] / size), size


def log_evidence_gain(left, size, residual) -> float:
    """Log evidence of the basis on top of the residual, averaged over its scales."""
    score = left.T @ residual
    gains = []
    for scale in _SCALES:
        t = (scale * size) ** 2
        gains.append(0.5 * np.sum(score**2 * t / (1 + t) - np.log1p(t)))
    return float(np.logaddexp.reduce(gains) - np.log(len(_SCALES)))
