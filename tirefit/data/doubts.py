"""Warnings on parts of a derived log that a tire hardly caused: transients of the filter,
a band that it cuts, waves that repeat along the road."""

from typing import NamedTuple

import numpy as np

from tirefit.data.faults import ALIKE
from tirefit.data.motion import Motion
from tirefit.data.vehicle import Vehicle

_CUT, _MUCH_CUT = 0.7, 0.05
"""Share of the bandwidth above which the filter attenuates, and the smallest share of a
column's variance there that causes a warning."""

_GRIP = 1.5  # largest |F_y| / F_z of racing tires on dry asphalt, without downforce
_DRY = 1.0  # largest |F_y| / F_z of road tires on dry asphalt
_SILENT = 1e-300  # variance of a column that never changes

_LONGEST = 2.0
"""Longest wave that is searched, in wheelbases. A wheel of a car turns once in 0.6 to 1,
of a model car in 1 to 1.5; a slalom is longer."""

_SMALLEST = 0.01  # smallest wave, over the strong values (95th percentile) of its column

_TURNS = 16
"""Longest waves in a window, so that wavelengths are resolved to 1 / 16."""

_WINDOWS = 4  # smallest number of windows in a log

_CHANCE = 1e-4
"""Probability that the highest of all peaks is chance, below which it is reported."""

_LEAST = 1e-12
"""Smallest probability that is printed; that of a strong wave would round to zero."""

_AROUND, _BESIDE = 8, 2
"""Wave numbers on either side from which the background is taken, without the nearest."""

_SHOWN_IN = {"alpha": ("mrad", 1e3), "fy": ("N", 1.0)}
"""Column -> unit of a wave's size, and its factor."""


class Wave(NamedTuple):
    """A wave along the road."""

    length: float  # [m]
    size: float  # half of its height
    p_value: float  # probability that it is chance


def doubts(columns, motion: Motion, kept, vehicle: Vehicle) -> tuple[str, ...]:
    """Warnings on content that a tire model should not be fitted to.

    Args:
        columns: :attr:`tirefit.data.derive.DerivedLog.columns` of every grid sample.
        kept: (n,) bool, the samples that will be written.
    """
    stretches = _stretches(motion, kept)
    way = [_way(columns["v"][rows], motion.time[rows]) for rows in stretches]
    return (
        *_beyond_grip(columns, kept, vehicle),
        *_at_edges(motion, kept, vehicle),
        *_cut_by_filter(columns, stretches, vehicle),
        *_repeating(columns, stretches, way, vehicle),
    )


def _beyond_grip(columns, kept, vehicle: Vehicle) -> list[str]:
    """A warning if the lateral force is larger than tires transmit without downforce, or
    mostly due to yaw inertia: at the limit, F_y / F_z is about |a_y| / g."""

    def high(values) -> float:
        return float(np.percentile(np.abs(values[kept]), 99))

    share = high(columns["fy"] / columns["fz"])
    level = high(columns["a_y"]) / vehicle.gravity
    by_inertia = share > max(_DRY, ALIKE * level)
    if share < _GRIP and not by_inertia:
        return []
    message = f"|fy| reaches {share:.2g} fz (99th percentile), more than a tire's friction"
    if by_inertia:
        moment = vehicle.yaw_inertia * columns["yaw_acceleration"] / vehicle.wheelbase
        message += (
            f", while |a_y| reaches {level:.2g} g: yaw_inertia dr/dt / wheelbase alone"
            f" is {high(moment / columns['fz']):.2g} fz, and yaw_inertia"
            f" {vehicle.inertia_ratio:.2g} mass l_f l_r (about 1 of cars)"
        )
    return [f"{message}: check mass, yaw_inertia and the unit of a_y or of the positions"]


def _stretches(motion: Motion, kept) -> list[np.ndarray]:
    """Index arrays of unbroken stretches of kept samples."""
    rows = np.flatnonzero(kept)
    breaks = (np.diff(rows) > 1) | (np.diff(motion.part[rows]) != 0)
    return np.split(rows, np.flatnonzero(breaks) + 1)


def _way(v, time) -> np.ndarray:
    """Distance travelled [m], (n,)."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(time))])


def _at_edges(motion: Motion, kept, vehicle: Vehicle) -> list[str]:
    reach = vehicle.filter.settling
    inside = np.count_nonzero(kept & (motion.within < reach * (1 - 1e-9)))
    if not inside:
        return []
    return [
        f"{inside} samples are within {reach:.2g} s of an edge or a gap, where the"
        " filter has not settled: raise keep.margin, or omit it"
    ]


def _cut_by_filter(columns, stretches, vehicle: Vehicle) -> list[str]:
    """Warnings on columns with much variance just below the bandwidth, and so above it."""
    from scipy.signal import welch

    band, messages = vehicle.filter.bandwidth, []
    window = int(10 * vehicle.filter.sample_rate / band)
    long = [rows for rows in stretches if len(rows) >= window]
    rate, every = vehicle.filter.sample_rate, np.concatenate(stretches)
    for name in ("alpha", "fy") if long else ():
        power, frequency = np.zeros(window // 2 + 1), np.zeros(window // 2 + 1)
        for rows in long:
            frequency, density = welch(columns[name][rows], rate, nperseg=window)
            power = power + len(rows) / sum(map(len, long)) * density
        beyond = frequency > _CUT * band
        cut = float(np.sum(power[beyond]) * (frequency[1] - frequency[0]))
        share = cut / max(float(np.var(columns[name][every])), _SILENT)
        if share > _MUCH_CUT:
            messages.append(
                f"{100 * share:.0f} % of the variance of {name} lies above"
                f" {_CUT * band:.2g} Hz, where the filter ({band:.3g} Hz) cuts: raise"
                " filter.cutoff, unless that is noise"
            )
    return messages


def _repeating(columns, stretches, way, vehicle: Vehicle) -> list[str]:
    messages = []
    speed = np.concatenate([columns["v"][rows] for rows in stretches])
    shortest = float(np.median(speed)) / vehicle.filter.bandwidth
    longest = _LONGEST * vehicle.wheelbase
    steady = np.std(speed) < 0.03 * np.mean(speed)
    for name, (unit, factor) in _SHOWN_IN.items():
        parts = [columns[name][rows] for rows in stretches]
        wave = repeats_with_distance(parts, way, shortest, longest)
        strong = float(np.percentile(np.abs(np.concatenate(parts)), 95))
        if wave is None or wave.size < _SMALLEST * strong:
            continue
        as_well = ", or in time: the speed hardly varies" if steady else ""
        least = wave.p_value < _LEAST
        chance = f"< {_LEAST:.0e}" if least else f"{wave.p_value:.0e}"
        messages.append(
            f"{name} repeats every {wave.length:.3g} m of the road (a wave of"
            f" {factor * wave.size:.2g} {unit}, p {chance}){as_well}: a wheel"
            f" of {1e3 * wave.length / (2 * np.pi):.3g} mm turns once in that; look for"
            " run-out, imbalance or a worn patch"
        )
    return messages


def repeats_with_distance(values, way, shortest: float, longest: float) -> Wave | None:
    """The wave that exceeds its background most, if one does significantly.

    Periodograms over the distance are averaged without overlap (Welch's method). A peak
    is compared with a parabola through the logarithms around it.

    Args:
        values: (n,) of each unbroken stretch.
        way: distance travelled [m], (n,) of each stretch.
        shortest, longest: range of wavelengths [m].
    """
    from scipy.signal import periodogram
    from scipy.special import digamma, gammaincc, polygamma

    if not shortest < longest:
        return None
    step, count = shortest / 6, int(_TURNS * longest / (shortest / 6))
    windows = []
    for part, distance in zip(values, way, strict=True):
        even = np.interp(np.arange(0.0, distance[-1], step), distance, part)
        full = len(even) // count * count
        windows += list(even[:full].reshape(-1, count))
    if len(windows) < _WINDOWS:
        return None
    number, power = periodogram(
        np.array(windows), 1 / step, window="hann", detrend="linear", axis=1
    )
    power, k = power.mean(axis=0), len(windows)
    places = np.flatnonzero((number >= 1 / longest) & (number <= 1 / shortest))
    best = None
    for at in places:
        first, last = max(int(at) - _AROUND, 1), int(at) + _AROUND + 1
        around = np.arange(first, min(last, len(number)))
        around = around[np.abs(around - at) > _BESIDE]
        place = np.log(number[around] / number[at])
        rows = np.stack([np.ones(len(place)), place, place**2], axis=1)
        log = np.log(power[around]) - digamma(k) + np.log(k)
        level = np.linalg.lstsq(rows, log)[0][0]
        # The background has this standard error: assume a higher one.
        unsure = np.linalg.inv(rows.T @ rows)[0, 0] * polygamma(1, k)
        ratio = power[at] / np.exp(level + 2 * np.sqrt(unsure))
        p_value = float(gammaincc(k, k * ratio)) * len(places)
        if best is None or p_value < best[0]:
            best = p_value, at, np.exp(level)
    if best is None or best[0] > _CHANCE:
        return None
    p_value, at, level = best
    near = slice(max(at - 1, 0), at + 2)
    energy = np.sum(np.maximum(power[near] - level, 0.0)) * (number[1] - number[0])
    return Wave(1 / float(number[at]), float(np.sqrt(2 * energy)), p_value)
