"""The slip angle's zero: offsets of the heading or the sideslip that are left."""

import numpy as np

from tirefit.data.vehicle import POSE, Vehicle


def zero_of_alpha(
    vehicle: Vehicle, axle: str, alpha: np.ndarray, fy: np.ndarray
) -> tuple[str, float | None]:
    """What was done about the zero of the slip angle, and what is left by the result:
    a sentence, and alpha at no side force [rad], None where that is not known.

    A symmetric axle has no side force at no slip angle, so alpha where fy = 0 is what
    the heading exceeds the yaw that was used; at the front the steering adds its own.
    """
    pose = vehicle.columns.motion == POSE
    key = "yaw_offset" if pose else "sideslip_offset"
    given = getattr(vehicle, key)
    if given and pose:
        said = (
            f"heading offset: {given:g} rad were added to the logged yaw, as declared,"
            " which lowers alpha by as much"
        )
    elif given:
        said = (
            f"sideslip offset: {given:g} rad were added to the logged sideslip, as"
            " declared, which raises alpha by as much"
        )
    elif pose:
        said = (
            "heading offset: none assumed, the logged yaw is the car's heading; alpha"
            " is too large by as much as the heading exceeds it"
        )
    else:
        said = (
            "sideslip offset: none assumed, the speeds are along the car's axes; alpha"
            " is too large by as much as their sensor is turned to the right"
        )
    left = _alpha_at_rest(alpha, fy) if axle == "rear" else None
    if left is None:
        return said, None
    takes_out = given + left if pose else given - left
    return (
        f"{said}; estimated from these data: alpha is {left:+.4f} rad where fy = 0,"
        f" which for a symmetric tire {key} = {takes_out:.4f} takes out"
    ), left


def _alpha_at_rest(alpha: np.ndarray, fy: np.ndarray) -> float | None:
    """Slip angle [rad] at no side force, by an odd cubic through the weak half of fy.

    None unless left and right turns both hold a tenth of those samples.
    """
    strong = np.percentile(abs(fy), 95)
    weak = abs(fy) < 0.5 * strong
    share = fy[weak] / strong
    if not turns_both_ways(share):
        return None
    terms = np.column_stack([np.ones(len(share)), share, share**3])
    return float(np.linalg.lstsq(terms, alpha[weak])[0][0])


def turns_both_ways(share: np.ndarray) -> bool:
    """Whether more than a tenth of the samples turns to the rarer side.

    Args:
        share: (n,) lateral force over the strong force.
    """
    rarer = min(np.count_nonzero(share > 0.05), np.count_nonzero(share < -0.05))
    return bool(rarer > 0.1 * len(share))
