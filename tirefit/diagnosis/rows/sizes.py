"""Sizes of one file: what "large" means on its own scale, whatever the tire.

An effect of an expected size is one that changes a force, a friction, a stiffness or a
slip by so much over the range that the file covers: the same statement for a truck
tire at 30 m/s and for a model car whose tires slide at a tenth of a metre per second.
"""

from typing import NamedTuple

import numpy as np

from tirefit.diagnosis.negligible import FLAT, ROUNDING

_HALF = (0.4, 0.6)
"""Share of the largest force that is about half of it."""
_LEAST_RISE = 1e-3
"""Slip at half of the largest force, over the largest slip, at least."""
_LEAST = 5
"""Rows around half of the largest force from which its slip is taken."""

_GRAVITY = 9.81  # m/s^2

_TOP = 0.95
"""Quantile that stands for the largest value: rows far off do not set the scale."""


class Sizes(NamedTuple):
    """Each in the unit of an amplitude, which is expected in shares of it.

    ``plain`` is 1 [-]; ``slip`` the slip at half of the largest force over load [-];
    ``sliding`` and ``rolling`` [s/m] are one over the ranges of the sliding speed and
    of the speed; ``growth`` [s/m] and ``inverse_speed`` [m/s] change the slip by
    ``slip`` over the range of the speed and of one over the speed; ``period`` [s] and
    ``way`` [m] are how long and how far the slip takes for a change of its standard
    deviation; ``temperature`` is over the range in units of 20 K; ``lever`` [m] moves
    the slip by ``slip`` at the usual yaw rate over speed; ``inertia`` [kg m^2] is that
    of the mass that the tire carries, at its rolling radius; ``swing`` [kg m] changes
    the force by the load at the usual yaw acceleration. ``wheel`` [m] is the radius of
    the wheel, 0 where nothing tells it.
    """

    plain: float = 1.0
    slip: float = 1.0
    sliding: float = 1.0
    rolling: float = 1.0
    growth: float = 1.0
    inverse_speed: float = 1.0
    period: float = 1.0
    way: float = 1.0
    temperature: float = 1.0
    lever: float = 1.0
    inertia: float = 1.0
    swing: float = 1.0
    wheel: float = 0.0


def largest(values) -> float:
    """Typical largest size of values (n,)."""
    return float(np.quantile(np.abs(values), _TOP))


def half_force_slip(slip, share) -> float:
    """Slip at half of the largest force over load; a median, so noise averages out.

    Args:
        slip: (n,) of any sign.
        share: (n,) force over load.
    """
    size, share = np.abs(slip), np.abs(share)
    top = largest(share)
    half = (share > _HALF[0] * top) & (share < _HALF[1] * top)
    middle = np.median(size[half] if half.sum() >= _LEAST else size)
    return float(max(middle, FLAT + _LEAST_RISE * largest(size)))


def _one_over(size: float) -> float:
    """What a change of one over this range amounts to; 1 where nothing varies."""
    return 1 / size if size > ROUNDING else 1.0


def sizes_of(rows, slip, mean_load: float, radius: float | None) -> Sizes:
    """Sizes of the file whose covariates are ``rows``.

    Args:
        slip: (n,) primary slip.
        mean_load: of the file [N].
        radius: rolling radius [m], None where it is not known.
    """
    spread = float(np.std(slip))
    rate = float(np.sqrt(np.mean(rows.rate**2)))
    inverse = float(np.ptp(1 / rows.pace)) if np.ptp(rows.v) > 0 else 0.0
    per_way = float(np.sqrt(np.mean((rows.rate / rows.pace) ** 2)))
    mass = mean_load / _GRAVITY
    return Sizes(
        slip=float(rows.rise[0]),
        sliding=_one_over(largest(rows.sliding)),
        rolling=_one_over(float(np.ptp(rows.v))),
        growth=float(rows.rise[0]) * _one_over(float(np.ptp(rows.v))),
        inverse_speed=float(rows.rise[0]) * _one_over(inverse),
        period=spread * _one_over(rate),
        way=spread * _one_over(per_way),
        temperature=_one_over(float(np.ptp(rows.temperature))),
        lever=float(rows.rise[0]) * _one_over(float(np.std(rows.yaw))),
        inertia=mass * radius**2 if radius else 1.0,
        swing=mean_load * _one_over(float(np.std(rows.swing))),
    )
