"""Search for the wrong units and signs that explain the gains between channels of a log."""

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from tirefit.data.units import units_of
from tirefit.data.vehicle.agreement import LATEST, Agreement
from tirefit.data.vehicle.track import Channel, Track
from tirefit.data.vehicle.vehicle import QUANTITIES, unit_of

ALIKE = 1.3
"""Largest gain (or inverse gain) of channels that agree. Body roll, lever arms and
encoders cause 0.9 to 1.2; the closest pair of units causes 1.9 (knots for m/s)."""

CHANGED = 1 - 1 / ALIKE
"""Smallest relative change (rms) of a channel by a delay, or of the slip angle by a wrong
point, that is a fault: the change by a gain of ``ALIKE``."""

_NEAR_UNIT, _NEAR, _FARTHEST = math.log(1.2), 2.5, 0.4
"""Largest |log gain| off a unit: this, or some standard errors, with a limit."""

SURE = 4.0  # standard errors above which an estimate differs from its stated value

_STEERING = (0.4, 8.0)
"""Range of the steering over that of a slowly rolling car; understeer needs more."""

_CLEAR = 5.0  # a gain is known if it is this many standard errors from 0

SEEN = 0.5
"""A gain is judged if at least this share of the term's variation is not noise."""

RELATED = 0.6  # correlation above which two channels follow each other

_SHARED = 0.9  # correlation above which two sensors share more than noise

_UNRELATED, _SURELY = 0.7, 2.5
"""Channels are unrelated if correlation plus some standard errors is below this."""

_MUCH = 3.0
"""Multiple of its floor above which a channel moves by more than a hill or a bank causes."""

_NO_CLOCK = 1.5
"""Multiple of the longest delay above which two channels are not the same quantity."""

_USUAL = ("km/h", "mph", "g", "deg", "deg/s", "mm")
_RARE, _ALONE = 0.05, 0.03
"""A rare unit is preferred if it is nearer by so much [log gain] than a usual one; so is
a unit of a single channel of a sensor."""

_UNEXPLAINED, _FAULT = 1.0, 0.5
"""Cost [log gain] of a gain that is not explained, and of a fault, which explains one or more."""

_ONE_SENSOR = (("v_x", "v_y"), ("a_x", "a_y"))
"""Channels that are usually of the same sensor, in the same unit."""

_AS_LIKELY = 0.02  # difference of the costs of faults that explain the gains equally well


class Fault(NamedTuple):
    """Channels that were read with a wrong factor."""

    channels: tuple[str, ...]
    factor: float  # value read over true value
    unit: str | None  # the true unit; None if only the sign is wrong
    rarity: float  # penalty of a rare unit [log gain]


Gain = tuple[Agreement, int]
"""A pair, and the number of one of its gains."""


# --- what is judged -------------------------------------------------------------


def judged(a: Agreement) -> list[bool]:
    """Which gains of a pair are known well enough to be compared with 1."""
    related = a.pair.level or not (
        abs(a.correlation) < RELATED
        or max(a.size, a.own_size) < a.pair.floor
        or abs(a.delay) > _NO_CLOCK * LATEST + 2 * a.delay_std
        or strays(a)
    )
    return [
        related and (a.pair.level or _no_noise(a, k)) and abs(gain) > _CLEAR * std
        for k, (gain, std) in enumerate(zip(a.gains, a.gain_stds, strict=True))
    ]


def _no_noise(a: Agreement, k: int) -> bool:
    """Whether a term is signal: the instruments explain it, which they cannot do with
    noise, or another sensor confirms it."""
    return a.seen[k] > SEEN or (k == 0 and abs(a.correlation) > _SHARED)


def strays(a: Agreement) -> bool:
    """Whether a channel certainly does not follow the others, in any unit."""
    if a.pair.level:
        return False
    turns = a.pair.channel in ("a_y", "yaw_rate", "yaw")
    if turns and a.own_seen > SEEN and not _no_noise(a, 0):
        return a.own_size > _MUCH * a.pair.floor  # the others are noise
    highest = abs(a.correlation) + _SURELY / math.sqrt(a.effective)
    return a.size > a.pair.floor and a.seen[0] > SEEN and highest < _UNRELATED


def not_explained(pairs: Sequence[Agreement], faults: Sequence[Fault] = ()) -> list[Gain]:
    """The judged gains that the faults do not explain."""
    return [gain for gain in _known(pairs) if _cost(gain, faults) >= _UNEXPLAINED]


def _known(pairs: Sequence[Agreement]) -> list[Gain]:
    return [(a, k) for a in pairs for k, known in enumerate(judged(a)) if known]


def _cost(gain: Gain, faults: Sequence[Fault]) -> float:
    """|log| of a gain over that which the faults cause; ``_UNEXPLAINED`` if the signs differ
    or it is too large: a unit must agree closely, a deviation from 1 must be significant."""
    a, k = gain
    caused = 1.0
    for fault in faults:
        caused *= fault.factor ** sum(a.pair.terms[k].powers.get(c, 0) for c in fault.channels)
    ratio = a.gains[k] / caused
    if a.pair.channel == "steering":
        return 0.0 if _STEERING[0] < ratio < _STEERING[1] else _UNEXPLAINED
    relative = a.gain_stds[k] / abs(a.gains[k])
    limit = max(math.log(ALIKE), SURE * relative)
    if caused != 1:
        limit = max(_NEAR_UNIT, min(_NEAR * relative, _FARTHEST))
    off = abs(math.log(ratio)) if ratio > 0 else math.inf
    return min(off, _UNEXPLAINED) if off <= limit else _UNEXPLAINED


# --- the search -----------------------------------------------------------------


def _possible(pairs: Sequence[Agreement], track: Track) -> Iterator[Fault]:
    """All faults of units and signs that the channels of the pairs may have."""
    read = {c.quantity: c for c in track.channels}
    named = sorted({name for a in pairs for term in a.pair.terms for name in term.powers})
    shared = [pair for pair in _ONE_SENSOR if set(pair) <= set(named)]
    for channels in (*((name,) for name in named), *shared):
        alone = _ALONE * any(set(channels) < set(pair) for pair in shared)
        units = {} if channels == ("y",) else _units(read[_header_of(channels[0])])
        for factor, unit in ({1.0: None} | units).items():
            rare = alone + _RARE * (unit not in (None, *_USUAL))
            if unit:
                yield Fault(channels, factor, unit, rare)
            if channels != ("xy",) and len(channels) == 1:
                yield Fault(channels, -factor, unit, rare + _RARE * bool(unit))


def _header_of(name: str) -> str:
    """The quantity of the column of a channel: ``x`` of ``xy``, which stands for x and y."""
    return {"xy": "x", "y": "x"}.get(name, name)


def _units(channel: Channel) -> dict[float, str]:
    """Factor by which values were read too large -> the unit that they are in."""
    factors: dict[float, str] = {}
    if channel.quantity not in QUANTITIES:
        return {180 / math.pi: "deg"}
    for text in units_of(QUANTITIES[channel.quantity]):
        unit = unit_of(text, channel.quantity)
        assert unit is not None  # it is from the list of this quantity
        factor = abs(channel.factor) / unit.scale
        if abs(math.log(factor)) > math.log(ALIKE):
            factors.setdefault(factor, text)
    return factors


def explained(
    pairs: Sequence[Agreement], track: Track
) -> tuple[tuple[Fault, ...], tuple[Fault, ...]]:
    """The one or two faults that explain the gains at the lowest cost, none if there are
    none, and single faults that explain them as well."""
    gains = _known(pairs)
    possible = list(_possible(pairs, track))
    sets: list[tuple[Fault, ...]] = [(), *((one,) for one in possible)]
    usual = [fault for fault in possible if fault.rarity < _RARE]
    twos = itertools.combinations(usual, 2)
    sets += [(one, two) for one, two in twos if not {*one.channels} & {*two.channels}]
    by_pair = [[gain for gain in gains if gain[0] is a] for a in pairs]

    def cost(faults: tuple[Fault, ...]) -> float:
        total = sum(_FAULT + fault.rarity for fault in faults)
        for some in by_pair:
            each = [_cost(gain, faults) for gain in some]
            # Two faults could explain any gain, so a pair is explained as a whole or not.
            explains = max(each, default=0.0) < _UNEXPLAINED
            total += sum(each) if explains else _UNEXPLAINED * len(each)
        return total

    costs = {faults: cost(faults) for faults in sets}
    best = min(costs, key=lambda faults: costs[faults])
    limit = costs[best] + _AS_LIKELY
    alike = [f[0] for f in costs if len(f) == 1 == len(best) and f != best and costs[f] < limit]
    return best, tuple(alike)
