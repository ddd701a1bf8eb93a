"""Errors of vehicle logs that ``derive`` found, and the words in which they are reported."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

_DELAYED = 3.0  # standard errors from which a delay between two channels is reported

_LAGS = {
    "yaw": ("the yaw rate changes", "the rate of the direction of travel"),
    "steering": ("the steering changes", "the path's curvature"),
}
"""Channel that differs from its prediction by the car's own motion (sideslip, response) ->
the words for its lag. Simulated drives without a delay show lags of 0.03 to 0.3 s."""


def found_in(logs: Sequence[Any]) -> dict[str, float]:
    """Errors that the logs show, as means over the logs: alpha_zero [rad], found_point
    [m ahead of the rear axle] and late_CHANNEL [s], with standard errors.

    A standard error grows by the scatter between the logs (Birge ratio) if that is larger.

    Args:
        logs: results of :func:`tirefit.data.vehicle.derive.derive`.
    """
    means, zeros = {}, [log.zero for log in logs if log.zero is not None]
    if zeros:
        means["alpha_zero"] = float(np.mean(zeros))
    estimates = {"found_point": [log.point.estimate for log in logs]}
    for compared in (compared for log in logs for compared in log.compared.pairs):
        if compared.is_exact or compared.channel in _LAGS:
            late = estimates.setdefault(f"late_{compared.channel}", [])
            late.append((compared.delay, compared.delay_std))
    for name, each in estimates.items():
        known = np.array([value for value in each if value and 0 < value[1] < np.inf])
        if len(known):
            weight = known[:, 1] ** -2
            mean = weight @ known[:, 0] / weight.sum()
            scatter = weight @ (known[:, 0] - mean) ** 2 / max(len(known) - 1, 1)
            if name == "found_point" or np.any(abs(known[:, 0]) > _DELAYED * known[:, 1]):
                std = (max(scatter, 1.0) / weight.sum()) ** 0.5
                means |= {name: float(mean), f"{name}_std": float(std)}
    return means


def findings(constants: Mapping[str, float]) -> tuple[str, ...]:
    """One sentence on the errors that ``derive`` found, from the constants of the derived file;
    empty without a finding. ``derive``, ``fit`` and ``diagnose`` report it in these words."""
    sentences = []
    if "alpha_zero" in constants:
        sentences.append(f"alpha is {constants['alpha_zero']:+.4f} rad where fy = 0")
    known = error_of_point(constants)
    if known is not None:
        advice = ": correct it"
        if point_confirmed(constants):
            advice = f", less than {_DELAYED:g} standard errors: keep the stated point"
        sentences.append(f"the tracked point is {point_words(-known[0], known[1])}{advice}")
    elif "found_point" in constants:
        place, std = constants["found_point"], constants["found_point_std"]
        sentences.append(f"the tracked point is {place:.3g} ± {std:.1g} m ahead of the rear axle")
    sentences += delays(constants)
    what = "found by tirefit derive, without a tire model"
    return (f"{what}: {'; '.join(sentences)}",) if sentences else ()


def delays(constants: Mapping[str, float]) -> list[str]:
    """Sentences on the delays among the constants of a derived file."""
    sentences = []
    for key, late in constants.items():
        if not key.startswith("late_") or key.endswith("_std"):
            continue
        channel, size = key[5:], f"{abs(late):.2g} ± {constants[f'{key}_std']:.1g} s"
        if channel not in _LAGS:
            sentences.append(f"{channel} is {size} {'late' if late > 0 else 'early'}")
            continue
        what, other = _LAGS[channel]
        sentences.append(
            f"{what} {size} {'after' if late > 0 else 'before'} {other} (the motion of a car causes"
            " such a lag: it is not by itself a delay of the log)"
        )
    return sentences


def point_words(ahead: float, std: float) -> str:
    """An estimate of the tracked point against the stated one [m]."""
    side = "ahead of" if ahead > 0 else "behind"
    return f"by force against slip {abs(ahead):.2g} ± {std:.1g} m {side} the stated one"


def error_of_point(constants: Mapping[str, float]) -> tuple[float, float] | None:
    """Stated minus found position of the tracked point [m], ahead positive, and its standard
    error; None if unknown."""
    if not {"tracked_point", "found_point", "found_point_std"} <= constants.keys():
        return None
    return constants["tracked_point"] - constants["found_point"], constants["found_point_std"]


def point_confirmed(constants: Mapping[str, float]) -> bool:
    """Whether the found tracked point is within 3 standard errors of the stated one, so that a
    diagnosis does not search for an error of it."""
    known = error_of_point(constants)
    return known is not None and abs(known[0]) < _DELAYED * known[1]
