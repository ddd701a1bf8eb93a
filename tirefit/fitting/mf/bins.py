"""Find the settings of a rig test in its rows, and bin the rows by setting and slip."""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from tirefit.data.rig.levels import levels
from tirefit.fitting.mf.parts import NEARLY_PURE, SLIPS_OF
from tirefit.fitting.mf.rows import ForceRows
from tirefit.models import TireInputs
from tirefit.slip import kappa_from_sigma

_DEG = np.pi / 180
_HELD = {"fz": 0.03, "pressure": 0.01, "sigma_x": 0.01}
_HELD |= {"gamma": 0.2 * _DEG, "alpha": 0.3 * _DEG}
"""Scatter of a channel that a rig holds constant, at one slip: relative for load and
pressure, rad for angles, kappa for ``sigma_x``."""
_SWEPT = 10.0  # width, in units of :data:`_HELD`, above which a level is a range
_MOST = 12  # largest number of levels of a channel; a channel with more is a range
_VALLEY = 0.5
"""Two levels are separate if the density of rows between them falls below this share of
the lower of their two peaks."""
_LEAST_SHARE = 0.01
"""Smallest share of the rows in a level; fewer rows are on the way between levels."""
_SUPPORT = 0.1
"""Smallest share of the rows that must show a number of levels for it to be used."""
_STEPS = 4  # cells of the density estimate per unit of :data:`_HELD`
_CELLS = 32  # number of slip bins between the ends of all sweeps


class Setting(NamedTuple):
    """The conditions at which a rig swept one slip: medians of their levels."""

    fz: float  # [N]
    gamma: float  # [rad]
    pressure: float  # [Pa]
    swept: str  # slip that varies, ``alpha`` or ``sigma_x``
    held: float  # median of the other slip (rad, or kappa)
    run: int  # its number

    def text(self, name: str) -> str:
        """One condition with its unit, for labels; empty for an unknown pressure."""
        value = getattr(self, name)
        if name == "held":
            pure, held = "straight", f"slip angle {value / _DEG:.2g} deg"
            if self.swept == "alpha":
                pure, held = "rolling freely", f"kappa {value:.2g}"
            return pure if abs(value) <= NEARLY_PURE else held
        return {
            "fz": f"{float(f'{value:.3g}'):g} N",
            "gamma": f"camber {round(value / _DEG, 1) + 0.0:g} deg",
            "pressure": f"{value / 1e3:.3g} kPa" if value else "",
            "run": f"run {value + 1}",
        }[name]


class SlipBins(NamedTuple):
    """The rows of one setting, of all runs, in m bins of the swept slip; arrays (m,)."""

    setting: Setting
    slip: np.ndarray  # median (rad, or kappa)
    inputs: TireInputs  # medians
    force: np.ndarray  # median
    low: np.ndarray  # ends of the central 95 % of the forces
    high: np.ndarray
    rows: np.ndarray  # number in the bin


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
    slips = _slips(rows)
    alike = _class_of(slips["alpha"]) + 5 * _class_of(slips["sigma_x"])
    values = {name: rows.column(name) for name in ("fz", "gamma", "pressure")}
    code = {name: _levels(name, column, alike)[0] for name, column in values.items()}
    is_alpha_swept, level = _held(rows.force, slips, rows.run)
    values["held"] = np.where(is_alpha_swept, slips["sigma_x"], slips["alpha"])
    # A level of alpha and a level of kappa are different settings.
    code["held"] = 2 * level + is_alpha_swept
    level_of = {}  # for each row, the median of the values of the rows with its code
    for name, codes in code.items():
        _, codes = np.unique(codes, return_inverse=True)
        medians = [np.median(values[name][codes == k]) for k in range(codes.max() + 1)]
        level_of[name] = np.array(medians)[codes]
    key = np.stack([*code.values(), rows.run], axis=1)
    _, first, of_row = np.unique(key, axis=0, return_index=True, return_inverse=True)
    settings = []
    for i in first.tolist():
        at = {name: float(column[i]) for name, column in level_of.items()}
        swept = "alpha" if is_alpha_swept[i] else "sigma_x"
        settings.append(Setting(**at, swept=swept, run=int(rows.run[i])))
    return tuple(settings), of_row.ravel()


def _held(
    force: str, slips: Mapping[str, np.ndarray], run: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """For each row (n,): whether the slip angle is swept, and the level of the other
    slip, 0 where that slip is nearly zero."""
    own_slip = SLIPS_OF[force][-1]
    other = "alpha" if own_slip == "sigma_x" else "sigma_x"
    none = {name: np.abs(slip) <= NEARLY_PURE for name, slip in slips.items()}
    both = ~none["alpha"] & ~none["sigma_x"]
    same_class = np.zeros(np.count_nonzero(both), int)
    levels_of = {n: _levels(n, slips[n][both], same_class) for n in slips} if both.any() else {}
    held, swept = other, own_slip
    if levels_of and levels_of[other][1] and not levels_of[own_slip][1]:
        held, swept = own_slip, other
    level = np.where(none[held], 0, -1)
    if levels_of:
        level[both] = levels_of[held][0] + 1
        for k in np.unique(level[both]):
            low, high = np.percentile(slips[held][both & (level == k)], [2, 98])
            beyond = np.maximum(low - slips[held], slips[held] - high)
            level[(level < 0) & (beyond <= _HELD[held])] = k
    # A sweep keeps its level of the held slip while the swept slip passes zero.
    new = np.diff(2 * run + none[swept], prepend=-1) != 0
    starts, block = np.flatnonzero(new), np.cumsum(new) - 1
    least = np.minimum.reduceat(level, starts)
    stays = (least == np.maximum.reduceat(level, starts)) & (least >= 0)
    is_held = ~none[swept] | stays[block]
    return is_held == (swept == "alpha"), np.where(is_held, level, 0)


def _class_of(slip: np.ndarray) -> np.ndarray:
    """Class (n,) of similar slip: 0 nearly zero, 1 to 4 a quarter of the other rows."""
    other = np.abs(slip) > NEARLY_PURE
    edges = np.quantile(slip[other], [0.25, 0.5, 0.75]) if other.any() else [0.0]
    return np.where(other, 1 + np.searchsorted(edges, slip), 0)


def _levels(name: str, values: np.ndarray, alike: np.ndarray) -> tuple[np.ndarray, bool]:
    """The level of each value (n,), and whether the levels are thirds of a range.

    Args:
        alike: class of similar slip of each row (n,), 0 at rest, of less scatter.
    """
    known_levels = levels(values)
    if known_levels.few(_MOST):
        return known_levels.code, False
    is_relative = name in ("fz", "pressure")
    x = np.log(np.maximum(values, 1.0)) if is_relative else values
    x = x / _HELD[name]
    count = np.bincount(alike)
    # Class 0 is left out: a rig moves between settings while both slips are zero.
    count[0] = 0 if len(count) > 1 else count[0]
    classes = np.flatnonzero(count >= _LEAST_SHARE * count.sum())
    modes = {k: _modes(x[alike == k]) for k in classes}
    # Take the largest number of levels that a tenth of the rows show: some classes may
    # lack a level.
    size = [len(modes_of_class) for modes_of_class in modes.values()]
    share = np.bincount(size, count[classes]) / count.sum()
    many = np.flatnonzero(share >= min(_SUPPORT, share.max()))[-1]
    center = np.mean(
        [modes_of_class for modes_of_class in modes.values() if len(modes_of_class) == many], axis=0
    )
    code = _nearest(center, x)
    for k, modes_of_class in modes.items():
        # A class with all levels keeps its own, as the load varies with the slip.
        order = np.arange(many) if len(modes_of_class) == many else _nearest(center, modes_of_class)
        code[alike == k] = order[_nearest(modes_of_class, x[alike == k])]
    width = [np.ptp(np.percentile(x[code == k], [5, 95])) for k in np.unique(code)]
    if len(width) > _MOST or max(width) > _SWEPT:
        return np.searchsorted(np.quantile(values, [1 / 3, 2 / 3]), values), True
    return code, False


def _nearest(center: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Index (n,) of the center that is nearest to each x (n,)."""
    return np.searchsorted((center[1:] + center[:-1]) / 2, x)


def _modes(x: np.ndarray) -> np.ndarray:
    """The modes (k,) of x (n,): the median of the rows about each peak of the density,
    which is smoothed over one unit."""
    from scipy.signal import find_peaks  # 1 s, and other fits need the records here

    cell = ((x - x.min() + 4) * _STEPS).astype(int)
    rows = np.bincount(cell, minlength=cell.max() + 4 * _STEPS).astype(float)
    density = np.log(gaussian_filter1d(rows, _STEPS) + 1e-9)
    # A small slope, so that of two equal peaks one is the higher.
    density += 1e-6 * np.arange(len(density))
    lowest = np.log(_LEAST_SHARE * len(x) / (_STEPS * np.sqrt(2 * np.pi)))
    peaks, _ = find_peaks(density, lowest, prominence=-np.log(_VALLEY))
    pairs = zip(peaks, peaks[1:], strict=False)
    cuts = [a + int(np.argmin(density[a:b])) for a, b in pairs]
    part = np.searchsorted(cuts, cell, "right")
    return np.array([np.median(x[part == k]) for k in range(len(cuts) + 1)])


def binned(rows: ForceRows) -> tuple[SlipBins, ...]:
    """The rows of a force binned by setting and slip, for figures."""
    settings, code = rig_settings(replace(rows, run=0 * rows.run))
    columns, slips = np.stack(rows.inputs), _slips(rows)
    table = []
    for k, setting in enumerate(settings):
        slip, in_setting = slips[setting.swept], np.flatnonzero(code == k)
        edges = np.linspace(slip.min(), slip.max(), _CELLS + 1)[1:-1]
        cell = np.searchsorted(edges, slip[in_setting])
        members = [in_setting[cell == c] for c in np.unique(cell)]
        spread = [np.percentile(rows.observed[at], [2.5, 50, 97.5]) for at in members]
        inputs = np.transpose([np.median(columns[:, at], axis=1) for at in members])
        middle = np.array([np.median(slip[at]) for at in members])
        count = np.array([len(at) for at in members])
        low, force, high = np.transpose(spread)
        table.append(SlipBins(setting, middle, TireInputs(*inputs), force, low, high, count))
    return tuple(table)
