"""Statements of a derived file on its vehicle, and assumptions."""

from tirefit.data.vehicle.track import Track
from tirefit.data.vehicle.vehicle import POSE, Vehicle

_POSE_CLOCK = 0.005
"""Standard error [s] of the time between x, y and yaw, which are from one instrument."""


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
