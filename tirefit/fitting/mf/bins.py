"""The settings of a rig's test, found in its rows, and the rows by setting and slip."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import find_peaks

from tirefit.data.levels import levels
from tirefit.fitting.mf.parts import NEARLY_PURE, SLIPS_OF
from tirefit.fitting.mf.rows import ForceRows
from tirefit.models import TireInputs
from tirefit.slip import kappa_from_sigma

_DEG = np.pi / 180
_HELD = {"fz": 0.03, "pressure": 0.01, "sigma_x": 0.01}
_HELD |= {"gamma": 0.2 * _DEG, "alpha": 0.3 * _DEG}
"""How closely a rig holds a channel at one slip: load and pressure relative to
themselves, angles in rad, kappa."""
_SWEPT = 10.0
"""A level wider than this, in these units, is a range and no setting."""
_MOST = 12
"""Levels of a channel; more are a range."""
_VALLEY = 0.5
"""Two levels are told apart where the density of rows between them is below this part
of that of the sparser one."""
_LEAST_SHARE, _SUPPORT = 0.01, 0.1
"""Of the rows: in a level, for fewer are on their way; and that show so many levels."""
_STEPS = 4
"""Cells of the density in one of the units of :data:`_HELD`."""
_CELLS = 32
"""Bins of the slip between the ends of all sweeps."""


class Setting(NamedTuple):
    """What a rig was set to while it swept one slip.

    ``fz`` [N], ``gamma`` [rad] and ``pressure`` [Pa] are the medians of their levels;
    ``swept`` is the slip that varies, ``alpha`` or ``sigma_x``, and ``held`` the median
    of the other one (rad, or kappa); ``run`` is the number of the run.
    """

    fz: float
    gamma: float
    pressure: float
    swept: str
    held: float
    run: int

    def text(self, name: str) -> str:
        """One of the conditions in words."""
        value = getattr(self, name)
        if name == "held" and self.swept == "alpha":
            rolls = abs(value) <= NEARLY_PURE["sigma_x"]
            return "rolling freely" if rolls else f"kappa {value:.2g}"
        if name == "held":
            is_straight = abs(value) <= NEARLY_PURE["alpha"]
            return "straight" if is_straight else f"slip angle {value / _DEG:.2g} deg"
        return {
            "fz": f"{float(f'{value:.3g}'):g} N",
            "gamma": f"camber {round(value / _DEG, 1) + 0.0:g} deg",
            "pressure": f"{value / 1e3:.3g} kPa" if value else "",
            "run": f"run {value + 1}",
        }[name]


class SlipBins(NamedTuple):
    """The rows of one setting, of all runs, in bins of the slip that was swept, (m,).

    ``slip`` (rad, or kappa), ``inputs`` and ``force`` are medians, ``low`` to ``high``
    holds 95 % of the forces, ``rows`` is their number.
    """

    setting: Setting
    slip: np.ndarray
    inputs: TireInputs
    force: np.ndarray
    low: np.ndarray
    high: np.ndarray
    rows: np.ndarray


def settings_of(rows: ForceRows) -> tuple[tuple[str, ...], np.ndarray]:
    """The settings of :func:`rig_settings` in words, and the setting of each row:
    (labels, code (n,)). What all rows share is not in the labels, but for the load."""
    found, code = rig_settings(rows)
    several = {k for k in Setting._fields if len({getattr(s, k) for s in found}) > 1}
    several |= {"fz", "held"}
    names = [k for k in ("fz", "gamma", "pressure", "held", "run") if k in several]
    return tuple(", ".join(one.text(name) for name in names) for one in found), code


def _slips(rows: ForceRows) -> dict[str, np.ndarray]:
    """Slip angle [rad] and kappa of each row, (n,) each."""
    kappa = np.clip(kappa_from_sigma(rows.column("sigma_x")), -1.0, 1.0)
    return {"alpha": rows.column("alpha"), "sigma_x": kappa}


def rig_settings(rows: ForceRows) -> tuple[tuple[Setting, ...], np.ndarray]:
    """The settings of the rows of a force, and the setting of each row.

    Rows share a setting if load, camber, pressure, the slip that is held and the run
    are the same. The load of a rig follows the slip, so that its levels are looked for
    among rows of like slips. A channel without levels is cut into thirds of its rows.

    Args:
        rows: (n,) in the order in which they were measured.

    Returns:
        (settings, code): ``settings[code[i]]`` is that of row i; code (n,).
    """
    slips = _slips(rows)
    alike = sum(5**i * _class_of(*one) for i, one in enumerate(slips.items()))
    values = {name: rows.column(name) for name in ("fz", "gamma", "pressure")}
    code = {name: _levels(name, column, alike)[0] for name, column in values.items()}
    is_alpha_swept, level = _held(rows.force, slips, rows.run)
    values["held"] = np.where(is_alpha_swept, slips["sigma_x"], slips["alpha"])
    # Levels of the two slips are different levels.
    code["held"] = 2 * level + is_alpha_swept
    middle = {}
    for name, codes in code.items():
        found, code[name] = np.unique(codes, return_inverse=True)
        each = [np.median(values[name][code[name] == k]) for k in range(len(found))]
        middle[name] = np.array(each)
    key = np.stack([*code.values(), is_alpha_swept, rows.run], axis=1)
    unique, of_row = np.unique(key, axis=0, return_inverse=True)
    settings = []
    for *places, turns, run in unique.tolist():
        at = {k: float(middle[k][i]) for k, i in zip(code, places, strict=True)}
        swept = "alpha" if turns else "sigma_x"
        settings.append(Setting(**at, swept=swept, run=run))
    return tuple(settings), of_row.ravel()


def _held(force: str, slips, run) -> tuple[np.ndarray, np.ndarray]:
    """Whether the slip angle is the one that is swept, and the level of the other slip,
    0 where it is next to nothing; of each row (n,)."""
    own = SLIPS_OF[force][-1]
    other = "alpha" if own == "sigma_x" else "sigma_x"
    none = {name: np.abs(slips[name]) <= NEARLY_PURE[name] for name in slips}
    both = ~none["alpha"] & ~none["sigma_x"]
    found = {n: _levels(n, slips[n][both], None) for n in slips} if both.any() else {}
    held, swept = other, own
    if found and found[other][1] and not found[own][1]:
        held, swept = own, other
    level = np.where(none[held], 0, -1)
    if found:
        level[both] = found[held][0] + 1
        for k in np.unique(level[both]):
            low, high = np.percentile(slips[held][both & (level == k)], [2, 98])
            beyond = np.maximum(low - slips[held], slips[held] - high)
            level[(level < 0) & (beyond <= _HELD[held])] = k
    # A sweep passes zero at the level at which it was before and is thereafter.
    new = np.diff(2 * run + none[swept], prepend=-1) != 0
    starts, block = np.flatnonzero(new), np.cumsum(new) - 1
    least = np.minimum.reduceat(level, starts)
    stays = (least == np.maximum.reduceat(level, starts)) & (least >= 0)
    is_held = ~none[swept] | stays[block]
    return is_held == (swept == "alpha"), np.where(is_held, level, 0)


def _class_of(name: str, slip: np.ndarray) -> np.ndarray:
    """Rows of like slips: 0 next to nothing, 1 to 4 a quarter of the others; (n,)."""
    other = np.abs(slip) > NEARLY_PURE[name]
    edges = np.quantile(slip[other], [0.25, 0.5, 0.75]) if other.any() else [0.0]
    return np.where(other, 1 + np.searchsorted(edges, slip), 0)


def _levels(name: str, values: np.ndarray, alike) -> tuple[np.ndarray, bool]:
    """Level of each value (n,), and whether they are thirds of a range.

    Args:
        alike: class of each row (n,), within which a level is sharper, 0 at rest; None
            for one class.
    """
    found = levels(values)
    if found.few(_MOST):
        return found.code, False
    is_relative = name in ("fz", "pressure")
    x = np.log(np.maximum(values, 1.0)) if is_relative else values
    x = x / _HELD[name]
    alike = np.zeros(len(x), int) if alike is None else alike
    count = np.bincount(alike)
    # At rest, class 0, a rig moves from one setting to the next.
    count[0] = 0 if len(count) > 1 else count[0]
    classes = np.flatnonzero(count >= _LEAST_SHARE * count.sum())
    modes = {k: _modes(x[alike == k]) for k in classes}
    # As many levels as a tenth of the rows show: a class may lack some of them.
    size = [len(own) for own in modes.values()]
    share = np.bincount(size, count[classes]) / count.sum()
    many = np.flatnonzero(share >= min(_SUPPORT, share.max()))[-1]
    center = np.mean([own for own in modes.values() if len(own) == many], axis=0)
    code = _nearest(center, x)
    for k, own in modes.items():
        # Of as many levels, each class has its own: the load follows the slip.
        order = np.arange(many) if len(own) == many else _nearest(center, own)
        code[alike == k] = order[_nearest(own, x[alike == k])]
    width = [np.ptp(np.percentile(x[code == k], [5, 95])) for k in np.unique(code)]
    if len(width) > _MOST or max(width) > _SWEPT:
        return np.searchsorted(np.quantile(values, [1 / 3, 2 / 3]), values), True
    return code, False


def _nearest(center: np.ndarray, x: np.ndarray) -> np.ndarray:
    return np.searchsorted((center[1:] + center[:-1]) / 2, x)


def _modes(x: np.ndarray) -> np.ndarray:
    """Values (k,) that x (n,) gathers at: the medians about the peaks of its density,
    smoothed over one unit."""
    cell = ((x - x.min() + 4) * _STEPS).astype(int)
    rows = np.bincount(cell, minlength=cell.max() + 4 * _STEPS).astype(float)
    density = np.log(gaussian_filter1d(rows, _STEPS) + 1e-9)
    # Peaks of one height would each stand alone.
    density += 1e-6 * np.arange(len(density))
    lowest = np.log(_LEAST_SHARE * len(x) / (_STEPS * np.sqrt(2 * np.pi)))
    peaks, _ = find_peaks(density, lowest, prominence=-np.log(_VALLEY))
    pairs = zip(peaks, peaks[1:], strict=False)
    cuts = [a + int(np.argmin(density[a:b])) for a, b in pairs]
    part = np.searchsorted(cuts, cell, "right")
    return np.array([np.median(x[part == k]) for k in range(len(cuts) + 1)])


def binned(rows: ForceRows) -> tuple[SlipBins, ...]:
    """The rows of a force by setting and slip: what its figures show."""
    settings, code = rig_settings(replace(rows, run=0 * rows.run))
    columns, slips = np.stack(rows.inputs), _slips(rows)
    table = []
    for k, setting in enumerate(settings):
        slip, own = slips[setting.swept], np.flatnonzero(code == k)
        edges = np.linspace(slip.min(), slip.max(), _CELLS + 1)[1:-1]
        cell = np.searchsorted(edges, slip[own])
        members = [own[cell == c] for c in np.unique(cell)]
        spread = [np.percentile(rows.observed[at], [2.5, 50, 97.5]) for at in members]
        inputs = np.transpose([np.median(columns[:, at], axis=1) for at in members])
        middle = np.array([np.median(slip[at]) for at in members])
        low, force, high = np.transpose(spread)
        count = np.array([len(at) for at in members])
        of_all = TireInputs(*inputs)
        table.append(SlipBins(setting, middle, of_all, force, low, high, count))
    return tuple(table)
