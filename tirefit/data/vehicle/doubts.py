"""Warnings on parts of a derived log that a tire hardly caused: transients of the filter, a
band that it cuts, forces beyond any friction."""

from collections.abc import Iterator, Mapping

import numpy as np

from tirefit.data.vehicle.motion import Motion, slowed
from tirefit.data.vehicle.pairs import ALIKE
from tirefit.data.vehicle.vehicle import Vehicle

_CUT, _MUCH_CUT = 0.7, 0.05
"""Share of the bandwidth above which the filter attenuates, and the smallest share of a
column's variance there that causes a warning."""

_GRIP = 1.5  # largest |F_y| / F_z of racing tires on dry asphalt, without downforce
_DRY = 1.0  # largest |F_y| / F_z of road tires on dry asphalt


def doubts(
    columns: Mapping[str, np.ndarray], motion: Motion, kept: np.ndarray, vehicle: Vehicle
) -> Iterator[str]:
    """Warnings on content that a tire model should not be fitted to: forces larger than tires
    transmit without downforce or mostly due to yaw inertia (at the limit, F_y / F_z is about
    |a_y| / g), samples next to an edge, and much variance just below the bandwidth, and so above.

    Args:
        columns: :attr:`tirefit.data.vehicle.derive.DerivedLog.columns` of every grid sample.
        kept: (n,) bool, the samples that will be written.
    """

    def high(values: np.ndarray) -> float:
        return float(np.percentile(np.abs(values[kept]), 99))

    share = high(columns["fy"] / columns["fz"])
    level = high(columns["a_y"]) / vehicle.gravity
    by_inertia = share > max(_DRY, ALIKE * level)
    if share >= _GRIP or by_inertia:
        message = f"|fy| reaches {share:.2g} fz (99th percentile), more than a tire's friction"
        if by_inertia:
            moment = vehicle.yaw_inertia * columns["yaw_acceleration"] / vehicle.wheelbase
            message += (
                f", while |a_y| reaches {level:.2g} g: yaw_inertia dr/dt / wheelbase alone"
                f" is {high(moment / columns['fz']):.2g} fz, and yaw_inertia"
                f" {vehicle.inertia_ratio:.2g} mass l_f l_r (about 1 of cars)"
            )
        yield f"{message}: check mass, yaw_inertia and the unit of a_y or of the positions"
    reach = vehicle.filter.settling
    if inside := np.count_nonzero(kept & (motion.within < reach * (1 - 1e-9))):
        yield (
            f"{inside} samples are within {reach:.2g} s of an edge or a gap, where the"
            " filter has not settled: raise keep.margin, or omit it"
        )
    band = vehicle.filter.bandwidth
    signals = np.stack([columns["alpha"], columns["fy"]], axis=1)
    slow = slowed(signals, motion, vehicle, vehicle.filter.cutoff / (_CUT * band))
    there = kept & np.isfinite(slow).all(axis=1)
    if not there.any():
        return
    cut = np.mean((signals - slow)[there] ** 2, axis=0)
    shares = cut / np.maximum(np.var(signals[there], axis=0), 1e-300)  # 0 if it never changes
    for name, share in zip(("alpha", "fy"), shares, strict=True):
        if share > _MUCH_CUT:
            yield (
                f"{100 * share:.0f} % of the variance of {name} lies above"
                f" {_CUT * band:.2g} Hz, where the filter ({band:.3g} Hz) cuts: raise"
                " filter.cutoff, unless that is noise"
            )
