"""Find the settings of load, camber, pressure and speed of a rig over time.

A setting is a value at which a channel stays while a slip is swept or held. Candidates
are the medians of whole sweeps, and of some seconds of holds. Candidates closer than
their scatter are the same setting. A row belongs to a setting while the channel is as
near to it as during those sweeps.
"""

from collections.abc import Mapping, Sequence, Set
from typing import NamedTuple

import numpy as np

from tirefit.data.rig.series import runs_of

_LEAST = 0.03  # smallest distance of two settings, over the largest value
_SHARE = 0.02
"""Share of the range of a channel: a channel that changes by more in a second is between
settings, and two settings are further apart."""
_SCATTERS = 3.0  # smallest distance of two settings, in scatters of the channel about a setting
_ROOM = 1.3  # factor on the usual deviation of a channel from its setting while it is held


class Window(NamedTuple):
    """Rows in which a channel may have been held: one sweep, or one second."""

    begin: int
    end: int
    is_sweep: bool


class Settings(NamedTuple):
    """The settings of one channel; one that was never held has none."""

    name: str
    center: np.ndarray  # (k,) medians
    width: np.ndarray  # (k,) usual deviation of the channel
    code: np.ndarray  # (n,) setting of each row, -1 if it is at none

    @property
    def is_held(self) -> bool:
        return len(self.center) > 0


def settings_of(
    name: str, values: np.ndarray, windows: list[Window], pieces: Sequence[slice], shortest: int
) -> Settings:
    """The settings of a channel, and the rows at each.

    Args:
        values: (n,) smoothed, finite.
        windows: in which settings are searched.
        pieces: slices of consecutive rows.
        shortest: smallest number of rows for which a setting is held.
    """
    least = _LEAST * float(np.max(np.abs(values)))
    if np.ptp(values) <= least:  # a single setting in all rows
        middle = np.array([np.median(values)])
        return Settings(name, middle, np.array([np.inf]), np.zeros(len(values), int))
    middle, stray, windows = _candidates(values, windows)
    nowhere = Settings(name, np.zeros(0), np.zeros(0), np.full(len(values), -1))
    if not windows:
        return nowhere
    # Groups of candidates, and the deviation of the channel in each.
    order = np.argsort(middle)
    middle, stray = middle[order], stray[order]
    usual = float(np.median(stray))
    near = np.clip(stray, usual, 2 * usual)
    apart = _SCATTERS / 2 * np.maximum(near[1:], near[:-1])
    distance = np.maximum(apart, max(least, _SHARE * float(np.ptp(values))))
    groups = np.split(np.arange(len(middle)), np.flatnonzero(np.diff(middle) > distance) + 1)
    center = np.array([np.median(middle[group]) for group in groups])
    width = np.array(
        [
            _ROOM * np.percentile(stray[g] + np.abs(middle[g] - c), 90)
            for g, c in zip(groups, center, strict=True)
        ]
    )
    width = np.maximum(width, max(_ROOM * usual, 0.2 * least))
    width = np.minimum(width, np.minimum(*_room(center)))
    calm = np.zeros(len(values), int)
    calm[[(begin + end) // 2 for begin, end, _ in windows]] = 1
    held_until = np.concatenate([[0], np.cumsum(calm)])
    code = _assigned(values, center, width, pieces, shortest, held_until)
    used = np.unique(code[code >= 0])
    if not len(used):
        return nowhere
    if len(used) < len(center):  # some settings were passed but never held
        center, width = center[used], width[used]
        code = _assigned(values, center, width, pieces, shortest, held_until)
    return Settings(name, center, width, code)


def _candidates(
    values: np.ndarray, windows: list[Window]
) -> tuple[np.ndarray, np.ndarray, list[Window]]:
    """Medians and deviations of the channel in windows in which it is held; the windows."""
    middle, stray, scatter, trend = [], [], [], []
    for begin, end, _ in windows:
        part = values[begin:end]
        low, half, high = np.percentile(part, [2, 50, 98])
        third = max(len(part) // 3, 1)
        middle.append(half)
        stray.append(max(high - half, half - low))
        scatter.append(high - low)
        trend.append(abs(np.median(part[-third:]) - np.median(part[:third])))
    if not middle:
        return np.zeros(0), np.zeros(0), []
    sweep = np.array([window.is_sweep for window in windows])
    # Sweeps are longer and change the load: compare windows of the same kind only.
    calm = np.array(scatter) <= _SHARE * float(np.ptp(values))
    for kind in (sweep, ~sweep):
        if kind.any():
            usual = float(np.median(np.array(scatter)[kind]))
            # A window with this multiple of the usual movement has no setting.
            calm |= kind & (np.array(scatter) <= 3.0 * usual)
    at_rest = np.array(trend) <= max(_SHARE * float(np.ptp(values)), 2 * float(np.median(trend)))
    held = calm & (sweep | at_rest)
    still = [window for window, is_held in zip(windows, held, strict=True) if is_held]
    return np.array(middle)[held], np.array(stray)[held], still


def _room(center: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Largest deviations from each setting, downward and upward, given its neighbours."""
    # Largest deviation from a setting, over the distance of two settings.
    gaps = 0.25 * np.diff(center)
    return np.append(np.inf, gaps), np.append(gaps, np.inf)


def _assigned(
    values: np.ndarray,
    center: np.ndarray,
    width: np.ndarray,
    pieces: Sequence[slice],
    shortest: int,
    held_until: np.ndarray,
) -> np.ndarray:
    """The setting of each row; the channel must stay near it for long enough.

    ``sure`` (n + 1,) counts the windows in which it is held, up to each row.
    """
    between = (center[1:] + center[:-1]) / 2
    nearest = np.searchsorted(between, values)
    above = values - center[nearest]
    # Factor by which a deviation may be larger for a short time if no other setting is near and the
    # channel returns.
    down, up = (np.minimum(2.5 * width, room)[nearest] for room in _room(center))
    code = np.where((-down <= above) & (above <= up), nearest, -1)
    half = max(shortest // 2, 1)
    row = np.arange(len(values))
    later, before = np.minimum(row + half, row[-1]), np.maximum(row - half, 0)
    change = np.abs(values[later] - values[before])
    for piece in pieces:
        part = code[piece]
        runs = runs_of(part)
        # Fill short absences from a setting to which the channel returns.
        for (_, a), (b, c), (d, _) in zip(runs, runs[1:], runs[2:], strict=False):
            if part[b] < 0 and c - b <= half and part[a - 1] == part[d]:
                part[b:c] = part[d]
        for begin, end in runs_of(part):
            if part[begin] < 0:
                continue
            rows = slice(piece.start + begin, piece.start + end)
            usual = width[part[begin]]
            goes = (np.abs(above[rows]) > usual) & (change[rows] > usual)
            first = begin + (_end_of_way(goes, half) if begin else 0)
            last = end - (_end_of_way(goes[::-1], half) if end < len(part) else 0)
            held = last - first >= min(shortest, len(part))
            held &= bool(held_until[piece.start + last] > held_until[piece.start + first])
            if not held:
                first, last = end, end
            part[begin:first] = part[last:end] = -1
    return code


def _end_of_way(goes: np.ndarray, longest: int) -> int:
    """Number of rows at the beginning during which the channel moves, with pauses up to
    ``longest``; later, single movements are noise."""
    rows = 0
    for row in np.flatnonzero(goes).tolist():
        if row - rows > longest:
            break
        rows = row + 1
    return rows


SHOWN = {
    "fz": (1.0, "N"),
    "gamma": (180 / np.pi, "deg"),
    "alpha": (180 / np.pi, "deg"),
    "pressure": (1e-3, "kPa"),
    "v": (1.0, "m/s"),
    "sigma_x": (100.0, "%"),
}
"""Channel -> factor from SI and unit in the names of bins."""

_ANGLES = {"gamma": " camber", "alpha": " slip angle"}

_FINE = 0.02
"""Rounding of a name: relative to the setting, relative to the distance of settings, and
in the unit of the name, as no rig is set to a hundredth of a degree or newton."""


def setting_names(settings: Settings) -> list[str]:
    """Each setting with its unit, in the fewest digits that distinguish settings."""
    scale, unit = SHOWN[settings.name]
    center = settings.center * scale
    apart = np.diff(center).min() if len(center) > 1 else np.max(np.abs(center))
    # A value below a twentieth of a step is zero.
    size = min([apart, *(abs(c) for c in center if abs(c) > 0.05 * apart)])
    for places in range(-5, 7):
        # + 0.0 turns -0.0 into 0.0.
        rounded = [round(float(value), places) + 0.0 for value in center]
        off = float(np.max(np.abs(np.array(rounded) - center)))
        if off <= _FINE * max(size, 1.0) and len(set(rounded)) == len(rounded):
            break
    return [f"{value:.{max(places, 0)}f} {unit}" for value in rounded]


def bin_name(level: Mapping[str, int], names: Mapping[str, list[str]], varied: Set[str]) -> str:
    """The name of a bin: its settings of the channels that ``varied``.

    If camber and slip angle both varied, their names follow the values in degrees.
    """
    words = _ANGLES if varied >= _ANGLES.keys() else {}
    shown = ((c, k) for c, k in level.items() if c in varied and k >= 0)
    return " ".join(names[c][k] + words.get(c, "") for c, k in shown) or "all"
