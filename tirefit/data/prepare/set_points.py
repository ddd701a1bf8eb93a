"""What a rig was set to: the settings of load, camber, pressure and speed, in time.

A setting is where a channel stays while a slip is swept or held, not a bin of equal
width: candidates are the medians of whole sweeps, and of a second here and there where
all is held, not on the way. Candidates closer than their own scatter are one setting. A
row belongs to a setting while the channel is as near it as during those sweeps.
"""

from collections.abc import Mapping, Set
from typing import NamedTuple

import numpy as np

from tirefit.data.prepare.series import runs_of

_LEAST = 0.03  # of the largest value: settings are further apart than that
_SHARE = 0.02
"""Of the range of a channel: what moves by so much in a second is on its way, and
settings are further apart than that."""
_SCATTERS = 3.0
"""Scatters of a channel about a setting that two settings are apart at least."""
_RESTLESS = 3.0  # A window so many times as restless as the usual one holds no setting
_ROOM = 1.3
"""Of how far a channel strays from its setting in most windows, while it is held."""
_WIDER = 2.5
"""Times as far it may stray now and then, where no other setting is near: a row is at
a setting rather than on its way, as long as it goes nowhere."""
_MOST = 0.25  # of the distance of two settings that one of them may take


class Window(NamedTuple):
    """Rows over which a channel may have been held: one sweep, or a second."""

    begin: int
    end: int
    is_sweep: bool


class Settings(NamedTuple):
    """The settings of one channel; one that was never held has none."""

    name: str
    center: np.ndarray  # (k,) medians
    width: np.ndarray  # (k,) how far the channel usually strays
    code: np.ndarray  # (n,) setting of each row, -1 where it is at none

    @property
    def is_held(self) -> bool:
        return len(self.center) > 0


def whole(name: str, values: np.ndarray) -> Settings:
    """A channel of one setting throughout."""
    center = np.array([np.median(values)])
    return Settings(name, center, np.array([np.inf]), np.zeros(len(values), int))


def settings_of(
    name: str, values: np.ndarray, windows: list[Window], pieces, shortest: int
) -> Settings:
    """The settings of a channel, and the rows at each.

    Args:
        values: (n,) smoothed, finite.
        windows: where to look for settings.
        pieces: slices of rows that follow each other in time.
        shortest: rows for which a setting is held at least.
    """
    least = _LEAST * float(np.max(np.abs(values)))
    if np.ptp(values) <= least:
        return whole(name, values)
    middle, stray, windows = _candidates(values, windows)
    nowhere = Settings(name, np.zeros(0), np.zeros(0), np.full(len(values), -1))
    if not windows:
        return nowhere
    center, width = _clustered(middle, stray, least, float(np.ptp(values)))
    calm = np.zeros(len(values), int)
    calm[[(begin + end) // 2 for begin, end, _ in windows]] = 1
    sure = np.concatenate([[0], np.cumsum(calm)])
    code = _assigned(values, center, width, pieces, shortest, sure)
    used = np.unique(code[code >= 0])
    if not len(used):
        return nowhere
    if len(used) < len(center):  # a setting that was passed, and never held
        center, width = center[used], width[used]
        code = _assigned(values, center, width, pieces, shortest, sure)
    return Settings(name, center, width, code)


def _candidates(values, windows: list[Window]):
    """Medians of the channel in windows where it is held, its strays, the windows."""
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
    # A sweep is longer, and the load answers to it: each kind by its own measure.
    calm = np.array(scatter) <= _SHARE * float(np.ptp(values))
    for kind in (sweep, ~sweep):
        if kind.any():
            usual = float(np.median(np.array(scatter)[kind]))
            calm |= kind & (np.array(scatter) <= _RESTLESS * usual)
    at_rest = np.array(trend) <= max(_SHARE * float(np.ptp(values)), 2 * float(np.median(trend)))
    held = calm & (sweep | at_rest)
    still = [window for window, is_held in zip(windows, held, strict=True) if is_held]
    return np.array(middle)[held], np.array(stray)[held], still


def _clustered(middle, stray, least: float, size: float):
    """Centers of the candidates that lie together, and how far the channel strays."""
    order = np.argsort(middle)
    middle, stray = middle[order], stray[order]
    usual = float(np.median(stray))
    near = np.clip(stray, usual, 2 * usual)
    apart = _SCATTERS / 2 * np.maximum(near[1:], near[:-1])
    cuts = np.flatnonzero(np.diff(middle) > np.maximum(apart, max(least, _SHARE * size)))
    groups = np.split(np.arange(len(middle)), cuts + 1)
    center = np.array([np.median(middle[group]) for group in groups])
    width = np.array(
        [
            _ROOM * np.percentile(stray[g] + np.abs(middle[g] - c), 90)
            for g, c in zip(groups, center, strict=True)
        ]
    )
    width = np.maximum(width, max(_ROOM * usual, 0.2 * least))
    return center, np.minimum(width, np.minimum(*_room(center)))


def _room(center: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far each setting may reach down and up, for the sake of its neighbours."""
    gaps = _MOST * np.diff(center)
    return np.append(np.inf, gaps), np.append(gaps, np.inf)


def _assigned(values, center, width, pieces, shortest: int, sure) -> np.ndarray:
    """The setting of each row: near it, and for long enough, and not passing it.

    ``sure`` (n + 1,) counts the windows in which it is held, up to each row.
    """
    between = (center[1:] + center[:-1]) / 2
    nearest = np.searchsorted(between, values)
    above = values - center[nearest]
    down, up = (np.minimum(_WIDER * width, room)[nearest] for room in _room(center))
    code = np.where((-down <= above) & (above <= up), nearest, -1)
    half = max(shortest // 2, 1)
    row = np.arange(len(values))
    later, before = np.minimum(row + half, row[-1]), np.maximum(row - half, 0)
    change = np.abs(values[later] - values[before])
    for piece in pieces:
        part = code[piece]
        _fill(part, half)
        for begin, end in runs_of(part):
            if part[begin] < 0:
                continue
            rows = slice(piece.start + begin, piece.start + end)
            usual = width[part[begin]]
            goes = (np.abs(above[rows]) > usual) & (change[rows] > usual)
            first = begin + (_end_of_way(goes, half) if begin else 0)
            last = end - (_end_of_way(goes[::-1], half) if end < len(part) else 0)
            held = last - first >= min(shortest, len(part))
            held &= bool(sure[piece.start + last] > sure[piece.start + first])
            if not held:
                first, last = end, end
            part[begin:first] = part[last:end] = -1
    return code


def _end_of_way(goes: np.ndarray, longest: int) -> int:
    """Rows at the beginning that are on their way, pauses up to ``longest`` included;
    what only noise calls so comes later, and alone."""
    rows = 0
    for row in np.flatnonzero(goes).tolist():
        if row - rows > longest:
            break
        rows = row + 1
    return rows


def _fill(code: np.ndarray, longest: int) -> None:
    """Closes, in place, short absences from a setting that it returns to."""
    runs = runs_of(code)
    for (_, a), (b, c), (d, _) in zip(runs, runs[1:], runs[2:], strict=False):
        if code[b] < 0 and c - b <= longest and code[a - 1] == code[d]:
            code[b:c] = code[d]


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
"""Of a setting, and of its distance to others, by which its name may be off; and in the
unit of the name: nothing is set to a hundredth of a degree or of a newton."""


def setting_names(settings: Settings) -> list[str]:
    """Each setting with its unit, in as few digits as tell it from its neighbours."""
    scale, unit = SHOWN[settings.name]
    center = settings.center * scale
    apart = np.diff(center).min() if len(center) > 1 else np.max(np.abs(center))
    # Nothing is set to a twentieth of a step: that is zero.
    size = min([apart, *(abs(c) for c in center if abs(c) > 0.05 * apart)])
    for places in range(-5, 7):
        # + 0.0: no setting is called -0.
        rounded = [round(float(value), places) + 0.0 for value in center]
        off = float(np.max(np.abs(np.array(rounded) - center)))
        if off <= _FINE * max(size, 1.0) and len(set(rounded)) == len(rounded):
            break
    return [f"{value:.{max(places, 0)}f} {unit}" for value in rounded]


def bin_name(level: Mapping[str, int], names: Mapping[str, list[str]], varied: Set[str]) -> str:
    """The name of a bin: its settings of the channels ``varied``.

    If camber and slip angle both varied, their names follow the values in degrees.
    """
    words = _ANGLES if varied >= _ANGLES.keys() else {}
    shown = ((c, k) for c, k in level.items() if c in varied and k >= 0)
    return " ".join(names[c][k] + words.get(c, "") for c, k in shown) or "all"
