"""Which unit or sign makes of 1 the gains that a log's channels show: the search."""

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from tirefit.data.agreement import LATEST, Agreement
from tirefit.data.track import Track
from tirefit.data.units import units_of
from tirefit.data.vehicle import QUANTITIES, unit_of

ALIKE = 1.3
"""Largest gain (or inverse gain) of channels that agree: body roll, lever arms and
encoders cause 0.9 to 1.2; the closest pair of units causes 1.9 (knots for m/s)."""

CHANGED = 1 - 1 / ALIKE
"""Smallest relative change (rms) of a channel by a delay, or of the slip angle by a
wrong point, that is a fault: as large as that by a gain of ``ALIKE``."""

_NEAR_UNIT, _NEAR, _FARTHEST = math.log(1.2), 2.5, 0.4
"""Largest |log gain| off a unit: this, or so many standard errors, but never more."""

SURE = 4.0  # standard errors from which an estimate differs from its stated value

_STEERING = (0.4, 8.0)
"""Steering over that of a car that rolls: understeer makes it up to some times more."""

_CLEAR = 5.0  # A gain is known where it is so many standard errors from 0

SEEN = 0.5
"""Share of a term's variation that must be no noise for its gain to be judged."""

RELATED = 0.6  # correlation from which two channels follow each other

_SHARED = 0.9  # correlation that noise of two sensors does not have

_UNRELATED, _SURELY = 0.7, 2.5
"""They do not where the correlation and so many of its standard errors stay below."""

_MUCH = 3.0
"""Multiple of its floor from which a channel moves for more than a hill or a bank."""

_NO_CLOCK = 1.5
"""Multiple of the longest delay beyond which two channels are not the same any more."""

_USUAL = ("km/h", "mph", "g", "deg", "deg/s", "mm")
_RARE, _ALONE = 0.05, 0.03
"""By how much [log gain] a rare unit must be nearer than a usual one to be preferred;
likewise one channel of a sensor in a unit of its own."""

_ONE_SENSOR = (("v_x", "v_y"), ("a_x", "a_y"))
"""Channels that mostly come from one sensor, in one unit."""

_AS_LIKELY = 0.02


class Fault(NamedTuple):
    """Channels that were read with a wrong factor."""

    channels: tuple[str, ...]
    factor: float  # what was read over what is true
    unit: str | None  # what it is in, None where only the sign is wrong
    rarity: float  # as a distance [log gain]


# --- what is judged -------------------------------------------------------------


def judged(a: Agreement) -> list[bool]:
    """Which of the pair's gains are known well enough to be held against 1."""
    if not a.pair.level and (
        abs(a.correlation) < RELATED
        or max(a.size, a.own_size) < a.pair.floor
        or abs(a.delay) > _NO_CLOCK * LATEST + 2 * a.delay_std
        or strays(a)
    ):
        return [False] * len(a.gains)
    return [
        (a.pair.level or signal) and abs(gain) > _CLEAR * std
        for gain, std, signal in zip(a.gains, a.gain_stds, no_noise(a), strict=True)
    ]


def no_noise(a: Agreement) -> list[bool]:
    """Which terms are signal: those there a while before as well, as noise is not, and
    one that another sensor says the same of."""
    shared = abs(a.correlation) > _SHARED
    return [seen > SEEN or (k == 0 and shared) for k, seen in enumerate(a.seen)]


def strays(a: Agreement) -> bool:
    """Whether a channel surely does not follow what the others say, at any unit."""
    if a.pair.level:
        return False
    turns = a.pair.channel in ("a_y", "yaw_rate", "yaw")
    if turns and a.own_seen > SEEN and not no_noise(a)[0]:
        return a.own_size > _MUCH * a.pair.floor  # the others are noise
    highest = abs(a.correlation) + _SURELY / math.sqrt(a.effective)
    return a.size > a.pair.floor and a.seen[0] > SEEN and highest < _UNRELATED


def _predicted(powers: Mapping[str, int], faults: Iterable[Fault]) -> float:
    """The gain that the faults make of 1."""
    gain = 1.0
    for fault in faults:
        power = sum(powers.get(channel, 0) for channel in fault.channels)
        gain *= fault.factor**power
    return gain


def _distance(a: Agreement, k: int, faults: Sequence[Fault]) -> float:
    """|log| of a gain over the predicted one; infinite where the signs differ, nothing
    where it is as near as it can be said."""
    expected = _predicted(a.pair.terms[k].powers, faults)
    ratio = a.gains[k] / expected
    if ratio <= 0:
        return math.inf
    if a.pair.channel == "steering":
        low, high = _STEERING
        return 0.0 if low < ratio < high else math.inf
    return abs(math.log(ratio))


def not_explained(pairs, faults) -> list[tuple[Agreement, int]]:
    """The judged gains that the faults do not explain."""
    return [
        (a, k)
        for a in pairs
        for k, known in enumerate(judged(a))
        if known and _distance(a, k, faults) > _limit(a, k, bool(faults))
    ]


def _limit(a: Agreement, k: int, faulty: bool) -> float:
    """Distance up to which a gain is explained: a unit must be met, but for 1 to be
    wrong takes more than chance."""
    if faulty:
        return max(_NEAR_UNIT, min(_NEAR * _relative(a, k), _FARTHEST))
    return max(math.log(ALIKE), SURE * _relative(a, k))


def _relative(a: Agreement, k: int) -> float:
    return a.gain_stds[k] / abs(a.gains[k])


# --- the search -----------------------------------------------------------------


def _possible(pairs: Sequence[Agreement], track: Track) -> list[Fault]:
    """Every unit and sign that a channel of the pairs may have instead."""
    read = {c.quantity: c for c in track.channels}
    named = {name for a in pairs for term in a.pair.terms for name in term.powers}
    faults = []
    groups: list[tuple[str, ...]] = [(name,) for name in sorted(named)]
    groups += [pair for pair in _ONE_SENSOR if set(pair) <= named]
    for channels in groups:
        name = "x" if channels[0] in ("xy", "y") else channels[0]
        several = any(set(channels) < set(pair) <= named for pair in _ONE_SENSOR)
        alone = _ALONE if several else 0.0
        factors = {1.0: None} | ({} if channels == ("y",) else _units(read[name]))
        flips = (1.0,) if channels == ("xy",) or len(channels) > 1 else (1.0, -1.0)
        for (factor, unit), sign in itertools.product(factors.items(), flips):
            rare = 0.0 if unit in (None, *_USUAL) else _RARE
            twice = _RARE if unit and sign < 0 else 0.0
            if unit or sign < 0:
                rarity = alone + rare + twice
                faults.append(Fault(channels, sign * factor, unit, rarity))
    return faults


def _units(channel) -> dict[float, str]:
    """Factor by which values were read too large -> the unit that they are in."""
    factors: dict[float, str] = {}
    if channel.quantity not in QUANTITIES:
        return {180 / math.pi: "deg"}
    for text in units_of(QUANTITIES[channel.quantity]):
        unit = unit_of(text, channel.quantity)
        assert unit is not None  # it is of this quantity's own list
        factor = abs(channel.factor) / unit.scale
        if abs(math.log(factor)) > math.log(ALIKE) and factor not in factors:
            factors[factor] = text
    return factors


def _halves(off, left) -> bool:
    """Whether of one pair a gain is explained and another is not."""
    pairs_left = {id(a) for a, _ in left}
    gains_left = {(id(a), k) for a, k in left}
    return any(id(a) in pairs_left and (id(a), k) not in gains_left for a, k in off)


def explained(pairs, off, track) -> tuple[tuple[Fault, ...], list[Fault]]:
    """The fewest faults that explain most of what is off, and what may be instead.

    Each must explain a gain of its own: two may make any gain of one.
    """
    possible = _possible(pairs, track)
    best: tuple[tuple, tuple[Fault, ...]] | None = None
    ranked = []
    for count in (1, 2):
        usual = [f for f in possible if count == 1 or f.rarity < _RARE]
        for faults in itertools.combinations(usual, count):
            if len({c for f in faults for c in f.channels}) < sum(len(f.channels) for f in faults):
                continue
            left = not_explained(pairs, faults)
            if len(off) - len(left) < count or _halves(off, left):
                continue
            near = sum(
                min(_distance(a, k, faults), 1.0)
                for a in pairs
                for k, known in enumerate(judged(a))
                if known
            )
            rank = (len(left), count, near + sum(f.rarity for f in faults))
            ranked.append((rank, faults))
    if not ranked:
        return (), []
    best = min(ranked, key=lambda item: item[0])
    others = [
        faults[0]
        for rank, faults in ranked
        if rank[:2] == best[0][:2]
        and len(faults) == 1
        and faults != best[1]
        and rank[2] < best[0][2] + _AS_LIKELY
    ]
    return best[1], others
