"""The settings of a rig's test, found in its rows, and the rows by setting and slip."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from tirefit.data.levels import levels
from tirefit.fitting.mf.parts import NEARLY_PURE, SLIPS_OF
from tirefit.fitting.mf.rows import ForceRows
from tirefit.models import TireInputs
from tirefit.slip import kappa_from_sigma

__all__ = ["Setting", "SlipBins", "binned", "rig_settings", "settings_of"]

_HELD = {
    "fz": 0.03,
    "pressure": 0.01,
    "gamma": np.radians(0.2),
    "alpha": np.radians(0.3),
    "sigma_x": 0.01,
}
"""How closely a rig holds a channel at one slip: load and pressure relative to
themselves, angles in rad, kappa. Rigs with public data stay within."""

_SWEPT = 10.0
"""A level wider than this, in these units, is a range and no setting."""

_VALLEY = 0.5
"""Two levels are told apart where the density of rows between them is below this part
of that of the sparser one."""

_LEAST_SHARE = 0.01
"""Of the rows, in a level: fewer are on their way between two settings."""

_SUPPORT = 0.1
"""Share of the rows that must show a number of levels."""

_MOST = 12
"""Levels of a channel; more are a range."""

_STEPS = 4
"""Cells of the density in one of the units of :data:`_HELD`."""


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
        if name != "held":
            return {
                "fz": f"{float(f'{value:.3g}'):g} N",
                "gamma": f"camber {np.round(np.degrees(value), 1) + 0.0:g} deg",
                "pressure": f"{value / 1e3:.3g} kPa" if value else "",
                "run": f"run {value + 1}",
            }[name]
        if self.swept == "alpha":
            rolls = abs(value) <= NEARLY_PURE["sigma_x"]
            return "rolling freely" if rolls else f"kappa {value:.2g}"
        is_straight = abs(value) <= NEARLY_PURE["alpha"]
        return "straight" if is_straight else f"slip angle {np.degrees(value):.2g} deg"


def settings_of(rows: ForceRows) -> tuple[tuple[str, ...], np.ndarray]:
    """The settings of :func:`rig_settings` in words, and the setting of each row:
    (labels, code (n,)). What all rows share is not in the labels, but for the load."""
    found, code = rig_settings(rows)
    names = [
        name
        for name in ("fz", "gamma", "pressure", "held", "run")
        if name in ("fz", "held") or len({getattr(one, name) for one in found}) > 1
    ]
    return tuple(", ".join(one.text(name) for name in names) for one in found), code


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
    alpha = rows.column("alpha")
    kappa = np.clip(kappa_from_sigma(rows.column("sigma_x")), -1.0, 1.0)
    slips = {"alpha": alpha, "sigma_x": kappa}
    alike = 5 * _class_of("alpha", alpha) + _class_of("sigma_x", kappa)
    values = {name: rows.column(name) for name in ("fz", "gamma", "pressure")}
    code = {name: _levels(name, column, alike)[0] for name, column in values.items()}
    is_alpha_swept, level = _held(rows.force, slips, rows.run)
    values["held"] = np.where(is_alpha_swept, kappa, alpha)
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
    for *level, turns, run in unique.tolist():
        at = {k: float(middle[k][i]) for k, i in zip(code, level, strict=True)}
        swept = "alpha" if turns else "sigma_x"
        settings.append(Setting(**at, swept=swept, run=run))
    return tuple(settings), of_row.ravel()


# --- the slip that is held ------------------------------------------------------------


def _held(force: str, slips, run) -> tuple[np.ndarray, np.ndarray]:
    """Whether the slip angle is the one that is swept, and the level of the other slip,
    0 where it is next to nothing; of each row (n,).

    Args:
        slips: slip angle [rad] and kappa, (n,) each.
        run: of each row (n,).
    """
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
        _assign(level, slips[held], both, found[held][0], _HELD[held])
    # A sweep passes zero at the level at which it was before and is thereafter.
    block = np.cumsum(
        np.diff(none[swept], prepend=none[swept][:1])
        | (np.diff(run, prepend=run[:1]) != 0)
    )
    size = int(block[-1]) + 1
    least, most = np.full(size, len(level)), np.full(size, -1)
    np.minimum.at(least, block, level)
    np.maximum.at(most, block, level)
    is_held = ~none[swept] | ((least == most) & (least >= 0))[block]
    level = np.where(is_held, level, 0)
    return (is_held if swept == "alpha" else ~is_held), level


def _assign(level, values, both, codes, width: float) -> None:
    """Gives the rows in combined slip their level, from one on, and rows in pure slip
    whose slip lies within such a level that level; in place."""
    level[both] = codes + 1
    for code in np.unique(codes):
        low, high = np.percentile(values[both][codes == code], [2, 98])
        near = (values >= low - width) & (values <= high + width)
        level[near & (level < 0)] = code + 1


# --- levels ---------------------------------------------------------------------------


def _class_of(name: str, slip: np.ndarray) -> np.ndarray:
    """Rows of like slips: next to nothing, or a quarter of the others; (n,)."""
    other = np.abs(slip) > NEARLY_PURE[name]
    code = np.zeros(len(slip), int)
    if other.any():
        edges = np.quantile(slip[other], [0.25, 0.5, 0.75])
        code[other] = 1 + np.searchsorted(edges, slip[other])
    return code


def _thirds(values: np.ndarray) -> np.ndarray:
    """Third (n,) in which each value lies."""
    return np.searchsorted(np.quantile(values, [1 / 3, 2 / 3]), values)


def _levels(name: str, values: np.ndarray, alike) -> tuple[np.ndarray, bool]:
    """Level of each value (n,), and whether they are thirds of a range.

    Args:
        alike: class of each row (n,), within which a level is sharper, 0 at rest; None
            for one class.
    """
    found = levels(values)
    if found.few(_MOST):
        return found.code, False
    x = values
    if name in ("fz", "pressure"):
        x = np.log(np.maximum(values, 1.0))
    x = x / _HELD[name]
    alike = np.zeros(len(x), int) if alike is None else alike
    count = np.bincount(alike)
    # At rest, class 0, a rig moves from one setting to the next.
    count[0] = 0 if len(count) > 1 else count[0]
    classes = np.flatnonzero(count >= _LEAST_SHARE * count.sum())
    modes = {k: _modes(x[alike == k]) for k in classes}
    # As many levels as a tenth of the rows show: a class may lack some of them.
    sizes = np.array([len(own) for own in modes.values()])
    supported = [
        size
        for size in sizes
        if np.sum(count[classes[sizes == size]]) >= _SUPPORT * count.sum()
    ]
    many = max(supported or sizes)
    center = np.mean([own for own in modes.values() if len(own) == many], axis=0)
    code = _nearest(center, x)
    for k, own in modes.items():
        rows = alike == k
        # Of as many levels, each class has its own: the load follows the slip.
        order = np.arange(many) if len(own) == many else _nearest(center, own)
        code[rows] = order[_nearest(own, x[rows])]
    width = [np.ptp(np.percentile(x[code == k], [5, 95])) for k in np.unique(code)]
    if len(width) > _MOST or max(width) > _SWEPT:
        return _thirds(values), True
    return code, False


def _nearest(center: np.ndarray, x: np.ndarray) -> np.ndarray:
    return np.searchsorted((center[1:] + center[:-1]) / 2, x)


def _modes(x: np.ndarray) -> np.ndarray:
    """Values (k,) that x (n,) gathers at: the medians about the peaks of its density,
    smoothed over one unit."""
    low = x.min() - 4
    cell = ((x - low) * _STEPS).astype(int)
    density = gaussian_filter1d(
        np.bincount(cell, minlength=cell.max() + 4 * _STEPS).astype(float), _STEPS
    )
    inside = density[1:-1]
    is_peak = (inside > density[:-2]) & (inside >= density[2:])
    peaks = (np.flatnonzero(is_peak) + 1).tolist()
    while len(peaks) > 1:
        cuts = [
            a + int(np.argmin(density[a:b]))
            for a, b in zip(peaks, peaks[1:], strict=False)
        ]
        rows = np.bincount(np.searchsorted(cuts, cell, "right"), minlength=len(peaks))
        few = int(np.argmin(rows))
        depth = [
            density[cut] / min(density[a], density[b])
            for cut, a, b in zip(cuts, peaks, peaks[1:], strict=False)
        ]
        shallow = int(np.argmax(depth))
        if depth[shallow] > _VALLEY:
            lower = density[peaks[shallow]] > density[peaks[shallow + 1]]
            peaks.pop(shallow + lower)
        elif rows[few] < _LEAST_SHARE * len(x):
            peaks.pop(few)
        else:
            part = np.searchsorted(cuts, cell, "right")
            return np.array([np.median(x[part == k]) for k in range(len(peaks))])
    return np.array([np.median(x)])


# --- rows by bin ----------------------------------------------------------------------

_CELLS = 32
"""Bins of the slip between the ends of all sweeps."""


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


def binned(rows: ForceRows) -> tuple[SlipBins, ...]:
    """The rows of a force by setting and slip: what its figures show."""
    settings, code = rig_settings(replace(rows, run=0 * rows.run))
    columns = np.stack([rows.column(name) for name in TireInputs._fields])
    kappa = np.clip(kappa_from_sigma(rows.column("sigma_x")), -1.0, 1.0)
    table = []
    for k, setting in enumerate(settings):
        slip = rows.column("alpha") if setting.swept == "alpha" else kappa
        own = np.flatnonzero(code == k)
        edges = np.linspace(slip.min(), slip.max(), _CELLS + 1)[1:-1]
        cell = np.searchsorted(edges, slip[own])
        members = [own[cell == c] for c in np.unique(cell)]
        low, force, high = np.transpose(
            [np.percentile(rows.observed[at], [2.5, 50, 97.5]) for at in members]
        )
        inputs = np.transpose([np.median(columns[:, at], axis=1) for at in members])
        middle = np.array([np.median(slip[at]) for at in members])
        count = np.array([len(at) for at in members])
        of_all = TireInputs(*inputs)
        table.append(SlipBins(setting, middle, of_all, force, low, high, count))
    return tuple(table)
