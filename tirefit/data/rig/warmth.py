"""Find the sweeps before the tire was warm."""

from dataclasses import replace

import numpy as np

from tirefit.data.rig.segments import Segment

_RISE = 5.0  # smallest rise of temperature [K] by which a warm-up is found
_WARM = 0.8  # share of the rise of temperature above which the tire is warm
_STILL_WARMING = 0.1
"""Share of the rise above which a tire that still warms in the last third is not warm."""


def with_warmth(
    parts: list[Segment], time: np.ndarray, temperature: np.ndarray | None, declared: float | None
) -> tuple[list[Segment], str]:
    """The segments with ``warm-up`` marked, and a note on how.

    Args:
        time: (n,) [s].
        temperature: (n,) of the tire [degC], smoothed, if it was measured.
        declared: seconds from the start for which the tire was not warm, if given.
    """
    if declared is not None:
        until = time[0] + declared
        message = f"warm-up: the first {declared:g} s, as declared"
        return _cut(parts, time, until), message
    if temperature is not None:
        return _by_temperature(parts, time, temperature)
    return parts, "warm-up: not searched, as there is no temperature; give its end with --warm-up"


def _cut(parts: list[Segment], time: np.ndarray, until: float) -> list[Segment]:
    """The segments with those that begin before ``until`` marked ``warm-up``."""
    return [
        replace(part, kind="warm-up") if part.is_held and time[part.begin] < until else part
        for part in parts
    ]


def _by_temperature(
    parts: list[Segment], time: np.ndarray, temperature: np.ndarray
) -> tuple[list[Segment], str]:
    held = [part for part in parts if part.is_held]
    if not held:
        return parts, "warm-up: none, as no condition is held"
    late = [part for part in held if part.begin >= held[len(held) // 2].begin]
    hot = float(np.median(np.concatenate([temperature[p.begin : p.end] for p in late])))
    begin = held[0].begin
    start = float(np.median(temperature[begin : begin + max(len(time) // 200, 3)]))
    rise = hot - start
    if rise < _RISE:
        message = f"{start:.0f} degC at the start, {hot:.0f} degC later"
        return parts, f"warm-up: none, as the tire was warm at the start ({message})"
    last = max(len(time) // 3, 1)
    still = float(np.median(temperature[-last // 10 :]) - temperature[-last])
    if still > _STILL_WARMING * rise:
        message = f"{still:.0f} K in the last third of the test"
        return parts, (
            f"warm-up: none cut, as the tire was warming all the time ({message}); if part"
            " of it was warm-up, give its end with --warm-up"
        )
    levels = (temperature - start) / rise
    warm = int(np.argmax(levels >= _WARM))
    message = (
        f"warm-up: until {time[warm]:.4g} s, when the tire was at"
        f" {temperature[warm]:.0f} degC, {_WARM:.0%} of the way from"
        f" {start:.0f} to {hot:.0f} degC"
    )
    return _cut(parts, time, time[warm]), message
