"""Guards: whether the curves of a fitted Magic Formula are those of a tire.

Each guard is a property of the force on a grid: loads from the smallest of the data to
twice the largest, cambers and pressures of the data, slips to lock and to 30 degrees.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

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

_LOADS = 9
_SMALL, _CLEAR = 0.004, 0.06
"""Slip at which the slope at zero is taken, and the smallest slip at which shifts and
camber thrust do not change the sign of the force."""

_KAPPA = np.array([_SMALL, _CLEAR, 0.09, 0.13, 0.18, 0.25, 0.35, 0.5, 0.7, 0.99])
_ALPHA = np.array([_SMALL, _CLEAR, 0.09, 0.13, 0.18, 0.24, 0.31, 0.38, 0.45, 0.5236])
_ELLIPSE = 1.25
_LEAST_PEAK = 0.1


class Guard(NamedTuple):
    """A check of a fitted tire for implausible behaviour, and its result."""

    name: str
    holds: bool
    text: str  # its definition or the first failure
    holds_inside: bool  # at the loads and slips of the data


@dataclass(frozen=True)
class _Grid:
    """Forces per load of a tire."""

    pure: Mapping[str, np.ndarray]  # (states, slips)
    slips: Mapping[str, np.ndarray]  # of ``pure``, ascending
    both: Mapping[str, np.ndarray]  # (states, slips)
    signs: Mapping[str, np.ndarray]
    fz: np.ndarray  # (states,)
    gamma: np.ndarray
    pressure: np.ndarray
    inside: np.ndarray  # (states,) whether the load is one of the data's


def _states(ranges: Mapping[str, tuple[float, float]], inside: bool):
    """Loads, cambers and pressures of the grid, each (states,), loads fastest."""
    low, high = ranges["fz"]
    loads = np.linspace(low, high, 5)
    if not inside:
        beyond = np.linspace(high, _BEYOND * high, _LOADS - 4)
        loads = np.unique(np.concatenate([loads, beyond]))
    cambers = np.unique([*ranges["gamma"], 0.0])
    pressures = np.unique(ranges.get("pressure", (0.0, 0.0)))
    shape = np.meshgrid(pressures, cambers, loads, indexing="ij")
    pressure, gamma, fz = (part.ravel() for part in shape)
    return fz, gamma, pressure


def _evaluated(tire: MFTire, fz, gamma, pressure, kappa, alpha):
    """fx and fy over the load, (states, slips), kappa and alpha (slips,)."""
    shape = len(fz), len(kappa)
    sigma_x = np.where(kappa < 1, kappa / (1 - kappa), 0.0)
    cells = np.broadcast_arrays(
        sigma_x[None], alpha[None], fz[:, None], gamma[:, None], pressure[:, None]
    )
    slip, angle, load, camber, inflation = (
        pad_rows(cell.ravel(), padded_size(cell.size)) for cell in cells
    )
    inputs = TireInputs(slip, angle, load, gamma=camber, pressure=inflation)
    given = forces(tire, inputs)
    size = shape[0] * shape[1]
    return {
        name: np.asarray(getattr(given, name))[:size].reshape(shape) / fz[:, None]
        for name in ("fx", "fy")
    }


def _within(slips: np.ndarray, limits: tuple[float, float]) -> np.ndarray:
    """The slips that the data reach on either side, and the small ones always."""
    low, high = limits
    kept = (slips >= min(low, -_CLEAR)) & (slips <= max(high, _CLEAR))
    return slips[kept]


def _grid(tire: MFTire, ranges, within: bool) -> _Grid:
    """The grid of all states, or of those at loads and slips of the data."""
    fz, gamma, pressure = _states(ranges, within)
    kappa = np.concatenate([-_KAPPA[::-1], _KAPPA])
    alpha = np.concatenate([-_ALPHA[::-1], _ALPHA])
    if within:
        kappa, alpha = (_within(kappa, ranges["kappa"]), _within(alpha, ranges["alpha"]))
    # Every second slip, from the ones at which a force is clear of shifts.
    one, other = (
        np.array([slip for slip in slips if abs(slip) in steps[1:8:2]])
        for slips, steps in ((kappa, _KAPPA), (alpha, _ALPHA))
    )
    one, other = (slips.ravel() for slips in np.meshgrid(one, other))
    along, across = np.r_[kappa, 0 * alpha, one], np.r_[0 * kappa, alpha, other]
    found = _evaluated(tire, fz, gamma, pressure, along, across)
    cuts = np.cumsum([len(kappa), len(alpha)])
    (fx, _, fx_both), (_, fy, fy_both) = (np.split(found[k], cuts, axis=1) for k in ("fx", "fy"))
    pure, both = {"fx": fx, "fy": fy}, {"fx": fx_both, "fy": fy_both}
    signs = {"fx": np.sign(one), "fy": np.sign(other)}
    inside = fz <= ranges["fz"][1] * (1 + 1e-9)
    slips = {"fx": kappa, "fy": alpha}
    return _Grid(pure, slips, both, signs, fz, gamma, pressure, inside)


def _peaks(grid: _Grid, force: str) -> tuple[np.ndarray, np.ndarray]:
    """Largest force over load in either direction of slip, (states,) each; positive
    where the force has the sign of the slip."""
    towards = grid.slips[force] > 0
    return (
        np.max(grid.pure[force][:, towards], axis=1),
        np.max(-grid.pure[force][:, ~towards], axis=1),
    )


def _failures(grid: _Grid, fitted: tuple[str, ...]) -> dict[str, tuple[str, np.ndarray]]:
    """Guard -> (words, which states fail it (states,)), the worst of its forces."""
    failing: dict[str, list] = {name: [] for name in GUARDS}
    for force in fitted:
        slip, values = grid.slips[force], grid.pure[force]
        small, clear = np.abs(slip) <= _SMALL, np.abs(slip) >= _CLEAR
        slope = np.sum(values[:, small] * np.sign(slip[small]), axis=1)
        failing["stiffness"].append((f"the slope of {force}", slope <= 0))
        peaks = np.minimum(*_peaks(grid, force))
        failing["peak"].append((f"the largest {force}", peaks < _LEAST_PEAK))
        against = np.any(values[:, clear] * np.sign(slip[clear]) <= 0, axis=1)
        failing["sign"].append((force, against))
        failing["load"].append((f"the largest {force}", _falls(grid, force)))
    if len(fitted) == 2:
        failing["ellipse"].append(("the combined force", _outside(grid)))
    return {
        name: max(cases, key=lambda case: np.count_nonzero(case[1]))
        for name, cases in failing.items()
        if cases
    }


def _falls(grid: _Grid, force: str) -> np.ndarray:
    """States within the data whose largest force is below that at a smaller load."""
    falls = np.zeros(len(grid.fz), bool)
    for peak in _peaks(grid, force):
        # Compare each state with the one before it, which has the next smaller load.
        whole = peak * grid.fz
        down = np.diff(whole, prepend=whole[:1]) < 0
        same_state = np.diff(grid.fz, prepend=grid.fz[:1]) > 0
        falls |= down & same_state & grid.inside
    return falls


def _outside(grid: _Grid) -> np.ndarray:
    """States in which some combined force is outside the ellipse, or turned round."""
    share = np.zeros_like(grid.both["fx"])
    turned = np.zeros(len(grid.fz), bool)
    for force, values in grid.both.items():
        towards = grid.signs[force] > 0
        ahead, behind = _peaks(grid, force)
        largest = np.where(towards[None], ahead[:, None], behind[:, None])
        share += (values / np.maximum(largest, 1e-3)) ** 2
        # Fx at a large slip angle may vanish, and what kappa induces moves F_y.
        turned |= np.any(values * grid.signs[force] < -0.1 * largest, axis=1)
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
