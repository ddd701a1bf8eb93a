"""Guards: whether the curves of a fitted Magic Formula are those of a tire.

Each guard is a property of the force on a grid: loads from the smallest of the data to
twice the largest, cambers and pressures of the data, slips to lock and to 30 degrees.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from tirefit.models import TireInputs, forces
from tirefit.models.mf import MFTire
from tirefit.padding import pad_rows, padded_size

GUARDS = {
    "stiffness": "the slope at zero slip is positive to twice the largest load",
    "peak": "the largest force is at least a tenth of the load, to twice the largest",
    "sign": "no force changes its sign within a slip of 1 and 30 degrees",
    "ellipse": "combined forces stay within 1.25 times the ellipse of the pure ones",
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
_ELLIPSE = 1.25
_LEAST_PEAK = 0.1
_TURNED = 0.1  # share of the largest force by which a combined one may have the other sign


class Guard(NamedTuple):
    """A check of a fitted tire for implausible behaviour, and its result."""

    name: str
    holds: bool
    text: str  # its definition or the first failure
    holds_inside: bool  # at the loads and slips of the data


class _Grid(NamedTuple):
    """Forces over load of a tire, by fx and fy, in states of load, camber and pressure."""

    slips: Mapping[str, np.ndarray]  # (slips,) of ``pure``, ascending
    pure: Mapping[str, np.ndarray]  # (states, slips)
    both: Mapping[str, np.ndarray]  # (states, combined slips)
    signs: Mapping[str, np.ndarray]  # of the slips of ``both``
    fz: np.ndarray  # (states,), the loads of one camber and pressure in turn
    gamma: np.ndarray
    pressure: np.ndarray
    inside: np.ndarray  # (states,) whether the load is one of the data's

    def peaks(self, force: str) -> tuple[np.ndarray, np.ndarray]:
        """Largest force over load in either direction of slip, (states,) each; positive
        where the force has the sign of the slip."""
        ahead, values = self.slips[force] > 0, self.pure[force]
        return np.max(values[:, ahead], axis=1), np.max(-values[:, ~ahead], axis=1)


def _grid(tire: MFTire, ranges: Mapping[str, tuple[float, float]], within: bool) -> _Grid:
    """The grid of all states, or of those at loads and slips of the data."""
    low, high = ranges["fz"]
    loads = np.linspace(low, high, _LOADS)
    if not within:
        loads = np.unique([*loads, *np.linspace(high, _BEYOND * high, _LOADS)])
    cambers = np.unique([*ranges["gamma"], 0.0])
    pressures = np.unique(ranges.get("pressure", (0.0, 0.0)))
    states = np.meshgrid(pressures, cambers, loads, indexing="ij")
    pressure, gamma, fz = (state.ravel() for state in states)
    slips, some = {}, []
    for force, name in _SLIP_OF.items():
        low, high = ranges[name] if within else (-np.inf, np.inf)
        slip = np.concatenate([-_STEPS[name][::-1], _STEPS[name]])
        # The slips that the data reach on either side, and the small ones always.
        slips[force] = slip[(slip >= min(low, -_CLEAR)) & (slip <= max(high, _CLEAR))]
        # Every second one, from the first at which a force is clear of shifts.
        some.append(slips[force][np.isin(np.abs(slips[force]), _STEPS[name][1:8:2])])
    kappas, angles = (slip.ravel() for slip in np.meshgrid(*some))
    kappa = np.concatenate([slips["fx"], 0 * slips["fy"], kappas])
    alpha = np.concatenate([0 * slips["fx"], slips["fy"], angles])
    cells = np.broadcast_arrays(
        kappa / (1 - kappa), alpha, fz[:, None], gamma[:, None], pressure[:, None]
    )
    padded = (pad_rows(cell.ravel(), padded_size(cell.size)) for cell in cells)
    sigma_x, angle, load, camber, inflation = padded
    computed = forces(tire, TireInputs(sigma_x, angle, load, gamma=camber, pressure=inflation))
    cuts, pure, both = np.cumsum([len(slip) for slip in slips.values()]), {}, {}
    for k, force in enumerate(slips):
        values = np.asarray(getattr(computed, force))[: cells[0].size].reshape(cells[0].shape)
        parts = np.split(values / fz[:, None], cuts, axis=1)
        pure[force], both[force] = parts[k], parts[-1]
    signs = {"fx": np.sign(kappas), "fy": np.sign(angles)}
    inside = fz <= ranges["fz"][1] * (1 + 1e-9)
    return _Grid(slips, pure, both, signs, fz, gamma, pressure, inside)


def _failures(grid: _Grid, fitted: tuple[str, ...]) -> dict[str, tuple[str, np.ndarray]]:
    """Guard -> (words, which states fail it (states,)), the worst of its forces."""
    failing: dict[str, list[Any]] = {name: [] for name in GUARDS}
    for force in fitted:
        slip, largest = grid.slips[force], f"the largest {force}"
        along = grid.pure[force] * np.sign(slip)  # positive in the direction of the slip
        small, clear = np.abs(slip) <= _SMALL, np.abs(slip) >= _CLEAR
        flat = np.sum(along[:, small], axis=1) <= 0
        failing["stiffness"].append((f"the slope of {force}", flat))
        failing["peak"].append((largest, np.minimum(*grid.peaks(force)) < _LEAST_PEAK))
        failing["sign"].append((force, np.any(along[:, clear] <= 0, axis=1)))
        # Compare each state with the one before it, which has the next smaller load.
        whole = np.stack(grid.peaks(force)) * grid.fz
        falls = np.any(np.diff(whole, prepend=whole[:, :1]) < 0, axis=0)
        same_state = np.diff(grid.fz, prepend=grid.fz[:1]) > 0
        failing["load"].append((largest, falls & same_state & grid.inside))
    if len(fitted) == 2:
        failing["ellipse"].append(("the combined force", _outside(grid)))
    return {
        name: max(cases, key=lambda case: np.count_nonzero(case[1]))
        for name, cases in failing.items()
        if cases
    }


def _outside(grid: _Grid) -> np.ndarray:
    """States in which some combined force is outside the ellipse, or turned round."""
    share, turned = np.zeros_like(grid.both["fx"]), np.zeros(len(grid.fz), bool)
    for force, values in grid.both.items():
        ahead, behind = grid.peaks(force)
        largest = np.where(grid.signs[force] > 0, ahead[:, None], behind[:, None])
        share += (values / np.maximum(largest, 1e-3)) ** 2
        # Fx at a large slip angle may vanish, and what kappa induces moves F_y.
        turned |= np.any(values * grid.signs[force] < -_TURNED * largest, axis=1)
    return turned | np.any(share > _ELLIPSE**2, axis=1)


def check_guards(
    tire: MFTire, ranges: Mapping[str, tuple[float, float]], fitted: tuple[str, ...]
) -> tuple[Guard, ...]:
    """Every guard that the fitted forces can have.

    Args:
        ranges: of the data, by input.
        fitted: of fx and fy.
    """
    grid = _grid(tire, ranges, within=False)
    inside = _failures(_grid(tire, ranges, within=True), fitted)
    guards = []
    for name, (what, states) in _failures(grid, fitted).items():
        text = GUARDS[name]
        if np.any(states):
            first = np.flatnonzero(states)[np.argmin(grid.fz[states])]
            text = f"{what}, from F_z = {grid.fz[first]:.4g} N on"
            text += f", at gamma = {grid.gamma[first]:.3g} rad"
            if grid.pressure[first] > 0:
                text += f", {grid.pressure[first]:.4g} Pa"
        holds_inside = not np.any(inside[name][1])
        guards.append(Guard(name, not np.any(states), text, holds_inside))
    return tuple(guards)
