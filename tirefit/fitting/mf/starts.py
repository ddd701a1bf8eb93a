"""First values of a search: read off the measured curve, with several shapes."""

import numpy as np

from tirefit.fitting.mf.cells import Group

_SHAPES: dict[str, tuple[dict[str, float], ...]] = {
    "fx": ({}, {"PCX1": 1.2}, {"PCX1": 1.8}),
    "fy": ({}, {"PCY1": 1.1}, {"PCY1": 1.8}),
    "mz": ({"QEZ1": -0.5}, {"QCZ1": 1.1, "QEZ1": -3.0}, {"QCZ1": 1.5, "QEZ1": -1.0}),
    "mx": (
        {},
        {"QSX2": -1.0, "QSX3": 0.5, "QSX4": -1.0},
        {"QSX2": 1.0, "QSX3": -0.5, "QSX4": 1.0},
    ),
}
"""Shapes of the curves to start from. Curves with a peak, without a peak and with a
sharp peak belong to different local minima."""


def first_values(group: Group) -> list[dict[str, float]]:
    """Coefficients to start from, one set per shape."""
    return [_look(group) | shape for shape in _SHAPES.get(group.force, ({},))]


def _look(group: Group) -> dict[str, float]:
    """Friction from the largest forces, and stiffness from the slope at small slips."""
    if group.force not in ("fx", "fy"):
        return {}
    inputs, force = group.cells.inputs, group.cells.observed
    slip = np.asarray(inputs.sigma_x if group.force == "fx" else inputs.alpha)
    fz, size = np.asarray(inputs.fz), np.abs(slip)
    low = size <= max(np.quantile(size, 0.2), 0.1 * size.max())
    peak = float(np.clip(np.quantile(np.abs(force) / fz, 0.98), 0.1, 3.0))
    share = slip[low] * fz[low]
    slope = 1.2 * float(share @ force[low] / max(share @ share, 1e-12))
    slope = max(slope, peak / max(size.max(), 1e-6))
    if group.force == "fx":
        return {"PDX1": peak, "PKX1": slope}
    # K = PKY1 F_z0 sin(2 arctan(F_z / (PKY2 F_z0))) at F_z = F_z0.
    at_nominal = np.sin(2 * np.arctan(1 / 2.5))
    return {"PDY1": peak, "PKY1": -slope / at_nominal, "PKY2": 2.5}
