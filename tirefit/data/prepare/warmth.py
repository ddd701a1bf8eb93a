"""Find the sweeps before the tire was warm."""

from collections.abc import Collection
from dataclasses import replace
from itertools import takewhile

import numpy as np

from tirefit.data.prepare.segments import Segment

_RISE = 5.0  # smallest rise of temperature [K] by which a warm-up is found
_WARM, _COLD = 0.8, 0.33
"""Shares of the rise of temperature: above the first the tire is warm; a sweep below the
second is cold."""
_STILL_WARMING = 0.1
"""Share of the rise above which a tire that still warms in the last third is not warm."""
_AGREE = 0.03
"""Relative change of the force from one sweep to the next ones above which the tire is
still warming: twice the difference between sweeps of a warm tire."""
_SHARED = 0.8
"""Share of the range of the widest sweep over which forces are compared."""
_REPEATS = 4
"""Smallest number of consecutive sweeps of one bin and direction whose change shows a warm-up."""


def with_warmth(
    parts: list[Segment],
    time: np.ndarray,
    temperature: np.ndarray | None,
    declared: float | None,
    slip: np.ndarray,
    force: np.ndarray | None,
) -> tuple[list[Segment], str]:
    """The segments with ``cold`` and ``warm-up`` marked, and a note on how.

    Args:
        time: (n,) [s].
        temperature: (n,) of the tire [degC], smoothed, if it was measured.
        declared: seconds from the start for which the tire was not warm, if given.
        slip, force: (n,) the slip that was swept, and its force, smoothed.
    """
    if declared is not None:
        until = time[0] + declared
        message = f"warm-up: the first {declared:g} s, as declared"
        return _cut(parts, time, until, None), message
    if temperature is not None:
        return _by_temperature(parts, time, temperature)
    if force is not None:
        return _by_repeats(parts, slip, force, time)
    return parts, "warm-up: cannot be found without temperature or force"


def last_sweeps_kept(
    before: list[Segment], after: list[Segment], keep: Collection[str]
) -> list[Segment]:
    """``after``, with the last sweeps of each condition that has no later ones.

    A condition is the set of all settings and the swept channel. Its last sweep in each
    direction becomes a sweep again and is marked ``early``.

    Args:
        before, after: the same segments before and after the cut of the warm-up.
        keep: kinds of segments that are written.
    """
    if "sweep" not in keep:
        return after
    last: dict[tuple, dict[str, int]] = {}
    left = set()
    for number, (was, part) in enumerate(zip(before, after, strict=True)):
        if was.kind == "sweep":
            held = sorted((name, k) for name, k in was.level.items() if k >= 0)
            condition = (was.channel, *held)
            last.setdefault(condition, {})[was.direction] = number
            if part.kind in keep:
                left.add(condition)
    back = {k for one, ks in last.items() if one not in left for k in ks.values()}
    return [
        replace(part, kind="sweep", early=True) if k in back else part
        for k, part in enumerate(after)
    ]


def _cut(parts, time, until: float, cold_until: float | None) -> list[Segment]:
    """Mark segments before ``until`` warm-up, sweeps before ``cold_until`` cold."""
    out = []
    for part in parts:
        if part.is_held and time[part.begin] < until:
            early = cold_until is not None and time[part.end - 1] <= cold_until
            cold = early and part.kind == "sweep"
            part = replace(part, kind="cold" if cold else "warm-up")
        out.append(part)
    return out


def _by_temperature(parts, time, temperature):
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
    cold = int(np.argmax(levels >= _COLD))
    message = (
        f"warm-up: until {time[warm]:.4g} s, when the tire was at"
        f" {temperature[warm]:.0f} degC, {_WARM:.0%} of the way from"
        f" {start:.0f} to {hot:.0f} degC; sweeps below {_COLD:.0%} of it are cold"
    )
    return _cut(parts, time, time[warm], time[cold]), message


def _by_repeats(parts, slip, force, time):
    """The warm-up by the first sweeps of one bin and direction, if their force changes."""
    sweeps = [part for part in parts if part.kind == "sweep"]
    for direction in ("up", "down"):
        ways = [part for part in sweeps if part.direction == direction]
        first = _of_one_range(_of_one_bin(ways), slip)
        if len(first) < _REPEATS:
            continue
        sizes = _sizes(first, slip, force)
        late = np.median(sizes[len(sizes) // 2 :])
        settled = np.abs(sizes / late - 1) <= _AGREE
        count = int(np.argmax(settled))
        if count:
            until = time[first[count - 1].end - 1]
            message = f"warm-up: until {time[first[count].begin]:.4g} s, as the force of"
            message += f" {count} repeated sweeps was still changing (no temperature)"
            return _cut(parts, time, until, None), message
    return parts, "warm-up: none seen in repeated sweeps (there is no temperature)"


def _of_one_bin(sweeps: list[Segment]) -> list[Segment]:
    """The first sweeps, up to a change of settings."""
    return list(takewhile(lambda part: part.level == sweeps[0].level, sweeps))


def _of_one_range(sweeps: list[Segment], slip) -> list[Segment]:
    """The sweeps that cover most of the range of the widest one."""
    if not sweeps:
        return []
    ends = [np.sort(slip[[part.begin, part.end - 1]]) for part in sweeps]
    low, high = max(ends, key=lambda pair: pair[1] - pair[0])
    return [
        part
        for part, (a, b) in zip(sweeps, ends, strict=True)
        if min(b, high) - max(a, low) > _SHARED * (high - low)
    ]


def _sizes(sweeps: list[Segment], slip, force) -> np.ndarray:
    """Force of each sweep over that of the last one, at slips that both have."""
    last = sweeps[-1]
    order = np.argsort(slip[last.begin : last.end])
    x, y = slip[last.begin : last.end][order], force[last.begin : last.end][order]
    sizes = []
    for part in sweeps:
        at = slip[part.begin : part.end]
        inside = (at >= x[0]) & (at <= x[-1])
        model = np.interp(at[inside], x, y)
        power = float(model @ model)
        here = force[part.begin : part.end][inside]
        sizes.append(model @ here / power if power else 1.0)
    return np.array(sizes)
