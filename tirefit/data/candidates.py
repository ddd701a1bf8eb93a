"""Correlation of the rear axle's force and slip with the points that a log may describe.

The force of an axle acts against its slip, so the two are correlated only with the right
point. Both are compared below a fifth of the filter's cutoff, as redundant channels are:
noise of a point differentiated twice would hide the relation.
"""

import math
from typing import NamedTuple

import numpy as np

from tirefit.data.faults import RELATED
from tirefit.data.motion import SLOWER, Motion, further_ahead, slip_and_force, slowed
from tirefit.data.vehicle import Vehicle


class Candidates(NamedTuple):
    """Result of :func:`candidates_of`."""

    words: str = ""  # the correlations in brackets; empty if unknown or in ``other``
    other: tuple[str, str] | None = None  # reason and remedy if another point fits


def candidates_of(motion: Motion, vehicle: Vehicle, kept: np.ndarray) -> Candidates:
    """Compare force and slip at the axles, the centre of gravity and the stated point.

    Args:
        kept: (n,) bool, the samples that will be written.
    """
    kept = kept & (motion.within >= SLOWER * vehicle.filter.settling)
    stated = vehicle.l_r - vehicle.cg_from_tracked[0]

    def correlation(at: float) -> float:
        moved, _ = further_ahead(motion, vehicle, at - stated)
        slow = slowed(np.stack(slip_and_force(moved, vehicle)[:2], axis=1), motion, vehicle)
        there = slow[kept & np.isfinite(slow).all(axis=1)]
        if len(there) < 3 or not np.all(np.ptp(there, axis=0)):
            return math.nan
        return float(np.corrcoef(there.T)[0, 1])

    own = correlation(stated)
    if math.isnan(own):
        return Candidates()
    points = {
        "the rear axle": 0.0,
        "the centre of gravity": vehicle.l_r,
        "the front axle": vehicle.wheelbase,
    }
    given = "the centre of gravity"
    if vehicle.tracked_point is not None:
        given = f"the stated point, {stated:.3g} m ahead of the rear axle"
        points[given] = stated
    each = {name: correlation(at) for name, at in points.items()}
    words = ", ".join(f"{r:+.2f} with {name}" for name, r in each.items())
    words = f"force and slip correlate by {words}"
    best = max(each, key=lambda name: each[name])
    if not own < RELATED <= each[best]:
        return Candidates(f" ({words})")
    assumed = "" if vehicle.tracked_point else ", which is assumed, as tracked_point is not stated"
    left = (vehicle.tracked_point or (0.0, 0.0))[1]
    return Candidates(
        "",
        (
            f"{words}: this fits {best}, not {given}{assumed}",
            f"if the log describes {best}, set tracked_point = [{points[best]:.3g}, {left:g}] in"
            " vehicle.toml",
        ),
    )
