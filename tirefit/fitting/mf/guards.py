"""Guards: whether the curves of a fitted Magic Formula are those of a tire.

Each guard is a property of the force on a grid: loads from the smallest of the data to
twice the largest, cambers and pressures of the data, slips to lock and to 30 degrees.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tirefit.models import TireInputs, forces
from tirefit.models.mf import MFTire
from tirefit.padding import pad_rows, padded_size

GUARDS = {
    "stiffness": "the slope at zero slip is positive to twice the largest load",
    "peak": "the largest force is at least a tenth of the load, to twice the largest",
    "sign": "no force changes its sign within a slip of 1 and 30 degrees",
    "load": "the largest force grows with load where the data are",
}
"""Name -> what holds."""

_BEYOND = 2.0  # largest load of the grid over that of the data
_LOADS = 5  # number of loads within the data, and of those from there to the largest
_SMALL, _CLEAR = 0.004, 0.06
"""Slip at which the slope at zero is taken, and the smallest slip at which shifts and
camber thrust do not change the sign of the force."""

_STEPS = {
    "kappa": np.array([_SMALL, _CLEAR, 0.09, 0.13, 0.18, 0.25, 0.35, 0.5, 0.7, 0.99]),
    "alpha": np.array([_SMALL, _CLEAR, 0.09, 0.13, 0.18, 0.24, 0.31, 0.38, 0.45, 0.5236]),
}
_SLIP_OF = {"fx": "kappa", "fy": "alpha"}
_LEAST_PEAK = 0.1


class Guard(NamedTuple):
    """A check of a fitted tire for implausible behaviour, and its result."""

    name: str
    holds: bool
    text: str  # its definition or the first failure
    holds_inside: bool  # at the loads and slips of the data


def _failures(along: np.ndarray, slip: np.ndarray, fz: np.ndarray) -> dict[str, np.ndarray]:
    """Guard -> the states (s,) that fail it.

    Args:
        along: force over load (s, m), positive in the direction of the slip.
        slip: (m,).
        fz: loads (s,), those of one camber and pressure in turn.
    """
    small, clear = np.abs(slip) <= _SMALL, np.abs(slip) >= _CLEAR
    peaks = np.stack([along[:, side].max(axis=1) for side in (slip > 0, slip < 0)])
    # Compare each state with the one before it, which has the next smaller load.
    falls = np.diff(peaks * fz, prepend=np.inf) < 0
    return {
        "stiffness": np.sum(along[:, small], axis=1) <= 0,
        "peak": np.min(peaks, axis=0) < _LEAST_PEAK,
        "sign": np.any(along[:, clear] <= 0, axis=1),
        "load": np.any(falls, axis=0) & (np.diff(fz, prepend=np.inf) > 0),
    }


def check_guards(
    tire: MFTire, ranges: Mapping[str, tuple[float, float]], fitted: Sequence[str]
) -> tuple[Guard, ...]:
    """Every guard.

    Args:
        ranges: of the data, by input.
        fitted: of fx and fy; not empty.
    """
    low, high = ranges["fz"]
    within, beyond = np.linspace(low, high, _LOADS), np.linspace(high, _BEYOND * high, _LOADS)
    loads = np.unique([*within, *beyond])
    cambers, pressures = np.unique([*ranges["gamma"], 0.0]), ranges.get("pressure", (0.0, 0.0))
    states = np.meshgrid(np.unique(pressures), cambers, loads, indexing="ij")
    pressure, gamma, fz = (state.ravel() for state in states)
    inside = fz <= high
    failing: dict[str, list[tuple[str, np.ndarray, bool]]] = {name: [] for name in GUARDS}
    for force in fitted:
        name = _SLIP_OF[force]
        slip = np.concatenate([-_STEPS[name][::-1], _STEPS[name]])
        column, zero = np.broadcast_to(slip, (len(fz), len(slip))), 0 * slip
        kappa, alpha = (column, zero) if force == "fx" else (zero, column)
        given = kappa / (1 - kappa), alpha, fz[:, None], 1.0, gamma[:, None], pressure[:, None]
        cells = [cell.ravel() for cell in np.broadcast_arrays(*given)]
        inputs = TireInputs(*(pad_rows(cell, padded_size(column.size)) for cell in cells))
        values = np.asarray(getattr(forces(tire, inputs), force))[: column.size]
        along = values.reshape(column.shape) * np.sign(slip) / fz[:, None]
        least, most = ranges[name]
        # The slips that the data reach on either side, and the small ones always.
        near = (slip >= min(least, -_CLEAR)) & (slip <= max(most, _CLEAR))
        of_data = _failures(along[:, near], slip[near], fz)
        for guard, fails in _failures(along, slip, fz).items():
            fails = fails & inside if guard == "load" else fails
            failing[guard].append((force, fails, bool(np.any(of_data[guard] & inside))))
    guards = []
    for name, text in GUARDS.items():
        force, fails, _ = max(failing[name], key=lambda case: np.count_nonzero(case[1]))
        if np.any(fails):
            first = np.flatnonzero(fails)[np.argmin(fz[fails])]
            text = f"{force}, from F_z = {fz[first]:.4g} N on, at gamma = {gamma[first]:.3g} rad"
            text += f", {pressure[first]:.4g} Pa" if pressure[first] > 0 else ""
        holds_inside = not any(fails_inside for *_, fails_inside in failing[name])
        guards.append(Guard(name, not np.any(fails), text, holds_inside))
    return tuple(guards)
