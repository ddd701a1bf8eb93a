"""Statements of a derived file on its vehicle, on errors of the logs, and assumptions."""

from collections.abc import Sequence

import numpy as np

from tirefit.data.track import Track
from tirefit.data.vehicle import POSE, Vehicle

_POSE_CLOCK = 0.005
"""Standard error [s] of the time between x, y and yaw, which are from one instrument."""

_DELAYED = 3.0  # standard errors from which a delay between two channels is reported

_SIGNS = (
    "alpha > 0 where the axle slides to the left; fy > 0 to the right, as the force"
    " then acts: alpha and fy are negative in a left turn (the canonical convention)"
)


def stated_of(vehicle: Vehicle) -> dict[str, float]:
    """Values that the vehicle file states, so that they need not be assumed, by key."""
    clock = _POSE_CLOCK if vehicle.columns.motion == POSE else None
    point = vehicle.tracked_point
    stated = dict(
        wheelbase=vehicle.wheelbase,
        yaw_inertia=vehicle.yaw_inertia,
        tracked_point=None if point is None else point[0],
        clock=vehicle.clock or clock,
        wheel_radius=vehicle.wheel_radius,
    )
    return {key: value for key, value in stated.items() if value is not None}


def found_in(logs: Sequence) -> dict[str, float]:
    """Errors that the logs show, as means over the logs: alpha_zero [rad], found_point
    [m ahead of the rear axle] and late_CHANNEL [s], with standard errors.

    Args:
        logs: results of :func:`tirefit.data.derive.derive`.
    """
    found, zeros = {}, [log.zero for log in logs if log.zero is not None]
    if zeros:
        found["alpha_zero"] = float(np.mean(zeros))
    estimates = {"found_point": [log.point.estimate for log in logs]}
    for pair in (pair for log in logs for pair in log.compared.pairs):
        late = estimates.setdefault(f"late_{pair.pair.channel}", [])
        late.append((pair.delay, pair.delay_std))
    for name, each in estimates.items():
        known = np.array([one for one in each if one and 0 < one[1] < np.inf])
        if len(known):
            weight = known[:, 1] ** -2
            mean, std = weight @ known[:, 0] / weight.sum(), weight.sum() ** -0.5
            if name == "found_point" or abs(mean) > _DELAYED * std:
                found |= {name: float(mean), f"{name}_std": float(std)}
    return found


def assumptions_of(track: Track, vehicle: Vehicle, axle: str) -> tuple[str, ...]:
    """Sentences on bandwidth, model and all assumptions of a log."""
    settings = vehicle.filter
    messages = [
        f"bandwidth {settings.bandwidth:.3g} Hz (-3 dB): Butterworth of order"
        f" {settings.order}, {settings.cutoff:g} Hz, run both ways, then central"
        f" differences at {settings.sample_rate:g} Hz; neighbouring samples are"
        " correlated and do not count as independent",
        f"gaps over {track.max_gap:.3g} s are not interpolated; shorter ones and uneven"
        " sampling are bridged by a cubic spline",
        "one rigid body on a flat floor, one wheel per axle: no roll, pitch, lateral"
        " load transfer or drag, and no yaw moment but that of the axles' side forces",
        _SIGNS,
    ]
    if vehicle.h_cg is None:
        messages.append("fz is the static axle load (h_cg is not given)")
    else:
        messages.append("fz is the axle load with the load transfer m a_x h_cg / L")
    if vehicle.tracked_point is None:
        messages.append("the log describes the centre of gravity (no tracked_point)")
    if axle == "front":
        assert vehicle.steering is not None
        delay = vehicle.steering.delay
        late = f"{delay:g} s later" if delay else "at once"
        messages.append(f"the road wheels follow the steering command {late}")
    if vehicle.driven not in (axle, "all"):
        messages.append(f"the {axle} axle neither drives nor brakes")
    elif vehicle.driven == "all" and vehicle.rear_share is None:
        messages.append("the rear axle has half of the drive force (no rear_share)")
    return (*messages, *vehicle.columns.notes, *track.notes)
