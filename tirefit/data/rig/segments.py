"""Segments of a rig test: stretches of one kind, such as a sweep or a hold."""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from tirefit.data.rig.series import Series, runs_of
from tirefit.data.rig.set_points import Settings
from tirefit.data.rig.slips import MOVED, SWEPT, Leg, number_of

_PART = 0.25  # smallest share of a sweep that is kept if a change cuts into it

_WARM = 0.8  # share of the rise of temperature above which the tire is warm


@dataclass(frozen=True)
class Segment:
    """Rows ``begin`` to ``end`` (exclusive) of one kind."""

    kind: str  # a key of ``settings.KINDS``
    begin: int
    end: int
    channel: str = ""  # the channel that was swept or changed
    direction: str = ""  # of a sweep: "up" or "down"
    level: Mapping[str, int] = field(default_factory=dict)  # settings of held conditions
    first: int = 0  # to ``last`` (exclusive): rows without settling times at the ends
    last: int = 0
    bin: str = ""  # name of the settings

    @property
    def is_held(self) -> bool:
        """Whether its conditions are held."""
        return self.kind in ("sweep", "steady", "warm-up")


def segments_of(
    series: Series,
    bad: np.ndarray,
    conditions: Mapping[str, Settings],
    legs: Mapping[str, list[Leg]],
    slips: Mapping[str, np.ndarray],
    shortest: int,
) -> list[Segment]:
    """All rows of the file as segments, in order.

    Args:
        series: clock and pieces.
        bad: (n,) bool, rows that cannot be read.
        conditions: settings of the channels that are held, by name.
        legs: legs of each slip, by name.
        slips: (n,) smoothed, by name.
        shortest: smallest number of rows of a hold.
    """
    names = list(conditions)
    codes = np.stack([conditions[c].code for c in names], axis=1) if names else None
    moving = np.zeros(len(bad), int)
    if codes is not None:
        moving = (codes < 0) @ (1 << np.arange(len(names)))
    piece = np.repeat(np.arange(len(series.pieces)), [p.stop - p.start for p in series.pieces])
    lasting = np.zeros(len(bad), int)  # bad rows, except those that only interrupt a segment
    for begin, end in runs_of(bad):
        lasting[begin:end] = bad[begin] and end - begin >= shortest
    key = [piece, lasting, moving]
    still = moving == 0
    if codes is not None:
        key += list((codes * still[:, None]).T)
    number = {name: number_of(its) for name, its in legs.items()}
    key += [(code + 1) * still for code in number.values()]
    here = []
    for begin, end in runs_of(np.stack(key, axis=1)):
        level = {name: int(conditions[name].code[begin]) for name in names}
        if key[1][begin]:
            here.append(Segment("unusable", begin, end))
        elif moving[begin]:
            ways = [name for name in names if conditions[name].code[begin] < 0]
            here.append(Segment("transition", begin, end, "+".join(ways)))
        else:
            leg_of = {name: its[number[name][begin]] for name, its in legs.items()}
            here.append(_held(begin, end, level, leg_of, slips, shortest))
    out = here[:1]  # with consecutive transitions joined
    for last, part in itertools.pairwise(here):
        if last.kind == part.kind == "transition" and piece[last.begin] == piece[part.begin]:
            channels = dict.fromkeys([*out[-1].channel.split("+"), *part.channel.split("+")])
            channel = "+".join(name for name in channels if name)
            out[-1] = replace(out[-1], end=part.end, channel=channel)
        else:
            out.append(part)
    return out


def _held(
    begin: int,
    end: int,
    level: Mapping[str, int],
    leg_of: Mapping[str, Leg],
    slips: Mapping[str, np.ndarray],
    shortest: int,
) -> Segment:
    """A sweep or a steady state, or a transition if it is too short."""
    swept = {name: leg for name, leg in leg_of.items() if leg.how == SWEPT}
    for name, leg in leg_of.items():
        if leg.how == MOVED:
            return Segment("transition", begin, end, name)
    if not swept:
        kind = "steady" if end - begin >= shortest else "transition"
        return Segment(kind, begin, end, level=level if kind == "steady" else {})
    parts = []
    for name, leg in swept.items():
        slip = slips[name]
        there = abs(slip[end - 1] - slip[begin])
        parts.append(there / max(abs(slip[leg.end - 1] - slip[leg.begin]), 1e-300))
    if max(parts) < _PART or end - begin < 3:
        return Segment("transition", begin, end, "+".join(swept))
    leg = next(iter(swept.values()))
    direction = "up" if leg.direction > 0 else "down"
    return Segment("sweep", begin, end, "+".join(swept), direction, level)


def trimmed(parts: list[Segment], margin: int, piece_ends: set[int]) -> list[Segment]:
    """The segments with ``first`` and ``last``: ``margin`` rows next to a change settle,
    but not at the end of a series or where only the slip turns."""
    out = []
    for k, part in enumerate(parts):
        first, last = part.begin, part.end
        if part.is_held:
            if first not in piece_ends and k and not parts[k - 1].is_held:
                first = min(first + margin, last)
            if last not in piece_ends and k + 1 < len(parts):
                if not parts[k + 1].is_held:
                    last = max(last - margin, first)
        out.append(replace(part, first=first, last=last))
    return out


def with_warmth(
    parts: list[Segment], time: np.ndarray, temperature: np.ndarray | None, declared: float | None
) -> tuple[list[Segment], str]:
    """The segments with ``warm-up`` marked, and a note on how.

    Args:
        time: (n,) [s].
        temperature: (n,) of the tire [degC], smoothed, if it was measured.
        declared: seconds from the start for which the tire was not warm, if given.
    """
    held = [part for part in parts if part.is_held]

    def cut(until: float) -> list[Segment]:
        """The segments with those that begin before ``until`` marked ``warm-up``."""
        return [
            replace(part, kind="warm-up") if part.is_held and time[part.begin] < until else part
            for part in parts
        ]

    if declared is not None:
        return cut(time[0] + declared), f"warm-up: the first {declared:g} s, as declared"
    if temperature is None:
        how = "not searched, as there is no temperature; give its end with --warm-up"
        return parts, f"warm-up: {how}"
    if not held:
        return parts, "warm-up: none, as no condition is held"
    late = [part for part in held if part.begin >= held[len(held) // 2].begin]
    hot = float(np.median(np.concatenate([temperature[p.begin : p.end] for p in late])))
    begin = held[0].begin
    start = float(np.median(temperature[begin : begin + max(len(time) // 200, 3)]))
    rise = hot - start
    # Smallest rise of temperature [K] by which a warm-up is found.
    if rise < 5.0:
        message = f"{start:.0f} degC at the start, {hot:.0f} degC later"
        return parts, f"warm-up: none, as the tire was warm at the start ({message})"
    last = max(len(time) // 3, 1)
    still = float(np.median(temperature[-last // 10 :]) - temperature[-last])
    # Share of the rise above which a tire that still warms in the last third is not warm.
    if still > 0.1 * rise:
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
    return cut(time[warm]), message
