"""Warnings on parts of a derived log that a tire hardly caused: transients of the filter, a
band that it cuts, forces beyond any friction."""

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


def doubts(columns, motion: Motion, kept, vehicle: Vehicle) -> tuple[str, ...]:
    """Warnings on content that a tire model should not be fitted to.

    Args:
        columns: :attr:`tirefit.data.derive.DerivedLog.columns` of every grid sample.
        kept: (n,) bool, the samples that will be written.
    """
    stretches = _stretches(motion, kept)
    return (
        *_beyond_grip(columns, kept, vehicle),
        *_at_edges(motion, kept, vehicle),
        *_cut_by_filter(columns, stretches, vehicle),
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
