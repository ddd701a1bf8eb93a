"""What a derived file's first line states: of its vehicle, and found in the logs."""

from collections.abc import Sequence

import numpy as np

from tirefit.data.vehicle import POSE, Vehicle

_POSE_CLOCK = 0.005
"""Standard error [s] of the time between x, y and yaw, which one instrument gives."""

_DELAYED = 3.0  # standard errors from which a delay between two channels is reported


def stated_of(vehicle: Vehicle) -> dict[str, float]:
    """What the vehicle file states, and nobody has to assume, by key."""
    clock = _POSE_CLOCK if vehicle.columns.motion == POSE else None
    point = vehicle.tracked_point
    stated = dict(
        wheelbase=vehicle.wheelbase, yaw_inertia=vehicle.yaw_inertia,
        tracked_point=None if point is None else point[0],
        clock=vehicle.clock or clock, wheel_radius=vehicle.wheel_radius,
    )  # fmt: skip
    return {key: value for key, value in stated.items() if value is not None}


def found_in(logs: Sequence) -> dict[str, float]:
    """What the logs show of their own errors, as means over the logs: alpha_zero [rad],
    found_point [m ahead of the rear axle] and late_CHANNEL [s] with standard errors.

    Args:
        logs: what :func:`tirefit.data.derive.derive` found in each.
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
