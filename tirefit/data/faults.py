"""Search for the wrong units and signs that explain the gains between channels of a log."""

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from tirefit.data.agreement import LATEST, Agreement
from tirefit.data.track import Track
from tirefit.data.units import units_of
from tirefit.data.vehicle import QUANTITIES, unit_of

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

_ONE_SENSOR = (("v_x", "v_y"), ("a_x", "a_y"))
"""Channels that are usually of the same sensor, in the same unit."""

_AS_LIKELY = 0.02


class Fault(NamedTuple):
    """Channels that were read with a wrong factor."""

    channels: tuple[str, ...]
    factor: float  # value read over true value
    unit: str | None  # the true unit; None if only the sign is wrong
    rarity: float  # penalty of a rare unit [log gain]


# --- what is judged -------------------------------------------------------------


def judged(a: Agreement) -> list[bool]:
    """Which gains of a pair are known well enough to be compared with 1."""
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
    """Which terms are signal: terms that the instruments explain, which they cannot do
    with noise, and a single term that another sensor confirms."""
    shared = abs(a.correlation) > _SHARED
    return [seen > SEEN or (k == 0 and shared) for k, seen in enumerate(a.seen)]


def strays(a: Agreement) -> bool:
    """Whether a channel certainly does not follow the others, in any unit."""
    if a.pair.level:
        return False
    turns = a.pair.channel in ("a_y", "yaw_rate", "yaw")
    if turns and a.own_seen > SEEN and not no_noise(a)[0]:
        return a.own_size > _MUCH * a.pair.floor  # the others are noise
    highest = abs(a.correlation) + _SURELY / math.sqrt(a.effective)
    return a.size > a.pair.floor and a.seen[0] > SEEN and highest < _UNRELATED


def _predicted(powers: Mapping[str, int], faults: Iterable[Fault]) -> float:
    """The gain that the faults cause if the true gain is 1."""
    gain = 1.0
    for fault in faults:
        power = sum(powers.get(channel, 0) for channel in fault.channels)
        gain *= fault.factor**power
    return gain


def _distance(a: Agreement, k: int, faults: Sequence[Fault]) -> float:
    """|log| of a gain over the predicted one; infinite if the signs differ, zero if they
    differ by less than the standard error."""
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
    """Largest distance of a gain from the predicted one: a unit must agree closely, but
    a deviation from 1 must be significant."""
    if faulty:
        return max(_NEAR_UNIT, min(_NEAR * _relative(a, k), _FARTHEST))
    return max(math.log(ALIKE), SURE * _relative(a, k))


def _relative(a: Agreement, k: int) -> float:
    return a.gain_stds[k] / abs(a.gains[k])


# --- the search -----------------------------------------------------------------


def _possible(pairs: Sequence[Agreement], track: Track) -> list[Fault]:
    """All faults of units and signs that the channels of the pairs may have."""
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
        assert unit is not None  # it is from the list of this quantity
        factor = abs(channel.factor) / unit.scale
        if abs(math.log(factor)) > math.log(ALIKE) and factor not in factors:
            factors[factor] = text
    return factors


def _halves(off, left) -> bool:
    """Whether some pair has one gain explained and another not."""
    pairs_left = {id(a) for a, _ in left}
    gains_left = {(id(a), k) for a, k in left}
    return any(id(a) in pairs_left and (id(a), k) not in gains_left for a, k in off)


def explained(pairs, off, track) -> tuple[tuple[Fault, ...], list[Fault]]:
    """The fewest faults that explain most of the wrong gains, and alternatives to them.

    Each fault must explain a gain of its own, as two faults together can cause any gain.
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
