"""Find the settings of a rig test in its rows, and bin the rows by setting and slip."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tirefit.data.rig.levels import levels
from tirefit.fitting.mf.parts import NEARLY_PURE
from tirefit.fitting.mf.rows import ForceRows
from tirefit.models import TireInputs
from tirefit.slip import kappa_from_sigma

_DEG = np.pi / 180
_HELD = {"fz": 0.03, "pressure": 0.01, "gamma": 0.2 * _DEG, "alpha": 0.3 * _DEG}
"""Scatter of a channel that a rig holds constant, at one slip: relative for load and
pressure, rad for angles."""
_SWEPT = 10.0  # width, in units of :data:`_HELD`, above which a level is a range
_MOST = 12  # largest number of levels of a channel; a channel with more is a range
_LEAST_SHARE = 0.01  # of the rows in a cell of a level; fewer are on the way between levels
_SUPPORT = 0.1  # smallest share of the rows that must show a number of levels for it to be used
_CELLS = 32  # number of slip bins between the ends of all sweeps


class Setting(NamedTuple):
    """The conditions at which a rig swept one slip: medians of their levels."""

    fz: float  # [N]
    gamma: float  # [rad]
    pressure: float  # [Pa]
    swept: str  # slip that varies: ``alpha``, or ``sigma_x`` at a slip angle
    held: float  # median of the other slip (rad, or kappa)
    run: int  # its number

    def text(self, name: str) -> str:
        """One condition with its unit, for labels; empty for an unknown pressure."""
        value = getattr(self, name)
        if name == "held":
            if self.swept == "alpha":
                return "rolling freely"
            turned = abs(value) > NEARLY_PURE
            return f"slip angle {value / _DEG:.2g} deg" if turned else "straight"
        return {
            "fz": f"{float(f'{value:.3g}'):g} N",
            "gamma": f"camber {round(value / _DEG, 1) + 0.0:g} deg",
            "pressure": f"{value / 1e3:.3g} kPa" if value else "",
        }[name]


class SlipBins(NamedTuple):
    """The rows of one setting, of all runs, in m bins of the swept slip; arrays (m,)."""

    setting: Setting
    slip: np.ndarray  # median (rad, or kappa)
    inputs: TireInputs  # medians
    force: np.ndarray  # median
    low: np.ndarray  # ends of the central 95 % of the forces
    high: np.ndarray


def _slips(rows: ForceRows) -> dict[str, np.ndarray]:
    """Slip angle [rad] and kappa of each row, (n,) each."""
    kappa = np.clip(kappa_from_sigma(rows.column("sigma_x")), -1.0, 1.0)
    return {"alpha": rows.column("alpha"), "sigma_x": kappa}


def rig_settings(rows: ForceRows) -> tuple[tuple[Setting, ...], np.ndarray]:
    """The settings of the rows of a force, and the setting of each row.

    Rows share a setting if they share the levels of load, camber, pressure and held
    slip, and the run. The load of a rig varies with the slip, so levels are searched
    within classes of similar slip. A channel without levels is cut into thirds.

    Args:
        rows: (n,) in the order in which they were measured.

    Returns:
        (settings, code): row i has the setting ``settings[code[i]]``; code (n,).
    """
    alpha, kappa = _slips(rows).values()
    alike = _class_of(alpha) + 5 * _class_of(kappa)
    values = {name: rows.column(name) for name in ("fz", "gamma", "pressure")}
    code = {name: _levels(name, column, alike) for name, column in values.items()}
    # A slip angle that varies while the wheel rolls freely is swept.
    is_free = np.abs(kappa) <= NEARLY_PURE
    new = np.diff(2 * rows.run + is_free, prepend=-1) != 0
    starts, stretch = np.flatnonzero(new), np.cumsum(new) - 1
    width = np.maximum.reduceat(alpha, starts) - np.minimum.reduceat(alpha, starts)
    is_alpha_swept = is_free & (width > 2 * _HELD["alpha"])[stretch]
    values["held"] = np.where(is_alpha_swept, kappa, alpha)
    code["held"] = np.where(is_alpha_swept, -1, 0)
    is_turned = ~is_alpha_swept & (np.abs(alpha) > NEARLY_PURE)
    if np.any(is_turned):
        angles = alpha[is_turned]
        code["held"][is_turned] = 1 + _levels("alpha", angles, np.zeros(len(angles), int))
    level_of = {}  # for each row, the median of the values of the rows with its code
    for name, codes in code.items():
        _, codes = np.unique(codes, return_inverse=True)
        medians = [np.median(values[name][codes == k]) for k in range(codes.max() + 1)]
        level_of[name] = np.array(medians)[codes]
    key = np.stack([*code.values(), rows.run], axis=1)
    _, first, of_row = np.unique(key, axis=0, return_index=True, return_inverse=True)
    settings = tuple(
        Setting(
            **{name: float(column[i]) for name, column in level_of.items()},
            swept="alpha" if is_alpha_swept[i] else "sigma_x",
            run=int(rows.run[i]),
        )
        for i in first
    )
    return settings, of_row.ravel()


def _class_of(slip: np.ndarray) -> np.ndarray:
    """Class (n,) of similar slip: 0 nearly zero, 1 to 4 a quarter of the other rows."""
    other = np.abs(slip) > NEARLY_PURE
    edges = np.quantile(slip[other], [0.25, 0.5, 0.75]) if other.any() else [0.0]
    return np.where(other, 1 + np.searchsorted(edges, slip), 0)


def _levels(name: str, values: np.ndarray, alike: np.ndarray) -> np.ndarray:
    """The level (n,) of each value, or the third of their range that it lies in.

    Args:
        alike: class of similar slip of each row (n,), 0 at rest, of less scatter.
    """
    known_levels = levels(values)
    if known_levels.few(_MOST):
        return known_levels.code
    x = np.log(np.maximum(values, 1.0)) if name in ("fz", "pressure") else values
    x = x / _HELD[name]
    count = np.bincount(alike)
    # Class 0 is left out: a rig moves between settings while both slips are zero.
    count[0] = 0 if len(count) > 1 else count[0]
    classes = np.flatnonzero(count >= _LEAST_SHARE * count.sum())
    modes = {k: _modes(x[alike == k]) for k in classes}
    # Take the largest number of levels that a tenth of the rows show: some classes may
    # lack a level.
    size = [len(of_class) for of_class in modes.values()]
    share = np.bincount(size, count[classes]) / count.sum()
    many = np.flatnonzero(share >= min(_SUPPORT, share.max()))[-1]
    center = np.mean([of_class for of_class in modes.values() if len(of_class) == many], axis=0)
    code = _nearest(center, x)
    for k, of_class in modes.items():
        # A class with all levels keeps its own, as the load varies with the slip.
        order = np.arange(many) if len(of_class) == many else _nearest(center, of_class)
        code[alike == k] = order[_nearest(of_class, x[alike == k])]
    width = [np.ptp(np.percentile(x[code == k], [5, 95])) for k in np.unique(code)]
    if len(width) > _MOST or max(width) > _SWEPT:
        return np.searchsorted(np.quantile(values, [1 / 3, 2 / 3]), values)
    return code


def _nearest(center: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Index (n,) of the center that is nearest to each x (n,)."""
    return np.searchsorted((center[1:] + center[:-1]) / 2, x)


def _modes(x: np.ndarray) -> np.ndarray:
    """The modes (k,) of x (n,): the median of the rows of each stretch of neighbouring cells,
    one unit wide, that hold enough rows."""
    cell = (x - x.min()).astype(int)
    count = np.bincount(cell)
    filled = count >= min(_LEAST_SHARE * len(x), count.max())
    stretch = np.where(filled, np.cumsum(np.diff(filled, prepend=False) & filled), 0)[cell]
    return np.array([np.median(x[stretch == k]) for k in range(1, stretch.max() + 1)])


def binned(rows: ForceRows) -> tuple[SlipBins, ...]:
    """The rows of a force binned by setting and slip, for figures."""
    settings, code = rig_settings(replace(rows, run=0 * rows.run))
    columns, slips, table = np.stack(rows.inputs), _slips(rows), []
    for k, setting in enumerate(settings):
        slip, in_setting = slips[setting.swept], np.flatnonzero(code == k)
        edges = np.linspace(slip.min(), slip.max(), _CELLS + 1)[1:-1]
        cell = np.searchsorted(edges, slip[in_setting])
        members = [in_setting[cell == c] for c in np.unique(cell)]
        low, force, high = np.transpose(
            [np.percentile(rows.observed[at], [2.5, 50, 97.5]) for at in members]
        )
        inputs = np.transpose([np.median(columns[:, at], axis=1) for at in members])
        middle = np.array([np.median(slip[at]) for at in members])
        table.append(SlipBins(setting, middle, TireInputs(*inputs), force, low, high))
    return tuple(table)
