"""Find channels of a vehicle log that contradict each other, and the wrong unit or sign."""

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from tirefit.data.units import units_of
from tirefit.data.vehicle.motion import Motion
from tirefit.data.vehicle.pairs import (
    ALIKE,
    CHANGED,
    RELATED,
    SIDEWAYS,
    STEADY,
    SURE,
    Agreement,
    agreements,
)
from tirefit.data.vehicle.track import Channel, Track
from tirefit.data.vehicle.vehicle import POSE, QUANTITIES, Vehicle, unit_of
from tirefit.results import InputProblem

_LATE = 0.05
_OFFSET = 0.3
"""Smallest delay [s] and offset [m/s2] of a used a_y that cause a warning, if they are also
three standard errors."""

_SWAPPED = ("v_x", "v_y", "a_x", "a_y", "yaw_rate")  # channels that may be exchanged
_ONE_SENSOR = (("v_x", "v_y"), ("a_x", "a_y"))  # usually in the same unit
_USUAL = ("km/h", "mph", "g", "deg", "deg/s", "mm")  # units
_RARE, _ALONE = 0.05, 0.03
"""A rare unit is preferred if it is nearer by so much [log gain] than a usual one; so is
a unit of a single channel of a sensor."""
_UNEXPLAINED, _FAULT = 1.0, 0.5
"""Cost [log gain] of a gain that is not explained, and of a fault, which explains one or more."""
_AS_LIKELY = 0.02  # difference of the costs of faults that explain the gains equally well
_FIND = "find the wrong column and correct [columns] or [units], or derive with --believe"


class Deviation(NamedTuple):
    """What a deviation of some channels means."""

    channels: Sequence[str]
    reason: str
    remedy: str = ""
    refuses: bool = True  # whether the log is refused; else it causes a warning


@dataclass(frozen=True)
class Comparison:
    """The comparison of redundant channels of a log."""

    pairs: tuple[Agreement, ...]  # every pair that was compared
    problems: tuple[InputProblem, ...]  # contradictions: channel, unit or sign, remedy
    warnings: tuple[str, ...]  # sentences on smaller or irrelevant differences
    line: str  # for the summary


def compare(track: Track, motion: Motion, vehicle: Vehicle, file: str) -> Comparison:
    """Compare every channel with the others; the car must drive forward."""
    columns = {c.quantity: c for c in track.channels}
    columns |= {"xy": columns["x"]} if "x" in columns else {}
    pairs, direction = [], list(_direction(motion, vehicle))
    deviations = direction
    if not direction or abs(_drift(motion, vehicle)) < math.pi - SIDEWAYS:
        pairs = agreements(track, motion, vehicle)
        deviations = list(_gains(pairs, track, motion, vehicle, columns))
    if not any(_header(deviation, columns) for deviation in deviations):
        deviations += [*direction, *_delays_and_offsets(pairs, columns, vehicle)]
    problems, warnings = [], []
    for deviation in deviations:
        if header := _header(deviation, columns):
            reason = f"channels contradict each other: {deviation.reason}"
            problems.append(InputProblem(reason, deviation.remedy, file, column=header))
        elif deviation.refuses:
            reason = f"{deviation.reason}; [columns] does not name it, so it is not used here"
            warnings.append(reason)
        elif not problems:
            warnings.append(deviation.reason)
    return Comparison(tuple(pairs), tuple(problems), tuple(warnings), _line(pairs, vehicle))


def _header(deviation: Deviation, columns: Mapping[str, Channel]) -> str:
    """The header of the first column of a deviation that refuses the log and that ``[columns]``
    names; empty without one."""
    refused = [columns[name] for name in deviation.channels] if deviation.refuses else []
    return next((column.header for column in refused if column.named), "")


def _direction(motion: Motion, vehicle: Vehicle) -> Iterator[Deviation]:
    """A car that mostly drives backwards or sideways, as its axes point elsewhere."""
    pose, off = vehicle.columns.motion == POSE, _drift(motion, vehicle)
    if math.pi - abs(off) < SIDEWAYS:
        unit = f"-{vehicle.units.get('v_x', 'm/s')}".removeprefix("--")
        how = f'v_x = "{unit}" (and v_y, a_x, a_y alike) in [units]'
        how = f"yaw_offset = {vehicle.yaw_offset + math.pi:.5g}" if pose else how
        remedy = f"if it drove forward, set {how} of vehicle.toml; if not, cut this part from"
        remedy += " the log: the equations hold for driving forward only"
        yield Deviation(["yaw" if pose else "v_x"], "the car drives backwards", remedy)
    elif pose and abs(off) > SIDEWAYS:
        reason = f"the car would drive {abs(math.degrees(off)):.0f} deg sideways: yaw is measured"
        remedy = f"set yaw_offset = {vehicle.yaw_offset + off:.3g} in vehicle.toml"
        yield Deviation(["yaw"], f"{reason} from another axis", remedy)


def _drift(motion: Motion, vehicle: Vehicle, sign: int = 1) -> float:
    """Mean of ``sign`` x direction of travel - heading [rad], in ±pi, where the car moves in one
    direction of the ground or of its axes; 0 if it does not."""
    fast = motion.settled & (np.hypot(motion.v_x, motion.v_y) > vehicle.v_min)
    heading = np.nan_to_num(motion.heading[fast])
    course = heading + np.arctan2(motion.v_y, motion.v_x)[fast]
    mean = np.mean(np.exp(1j * (sign * course - heading))) if fast.any() else 0.0
    return float(np.angle(mean)) if abs(mean) > STEADY else 0.0


# --- the faults that explain the gains ------------------------------------------


class Fault(NamedTuple):
    """Channels that were read with a wrong factor."""

    channels: tuple[str, ...]
    factor: float  # value read over true value
    unit: str | None  # the true unit; None if only the sign is wrong
    rarity: float  # penalty of a rare unit [log gain]


Gain = tuple[Agreement, int]
"""A pair, and the number of one of its gains."""


def _not_explained(pairs: Iterable[Agreement], faults: Sequence[Fault] = ()) -> list[Gain]:
    """The judged gains that the faults do not explain."""
    gains = ((a, k) for a in pairs for k, judged in enumerate(a.judged) if judged)
    return [gain for gain in gains if _cost(gain, faults) >= _UNEXPLAINED]


def _cost(gain: Gain, faults: Sequence[Fault]) -> float:
    """|log| of a gain over that which the faults cause; ``_UNEXPLAINED`` if the signs differ
    or it is too large: a unit must agree closely, a deviation from 1 must be significant."""
    a, k = gain
    caused = 1.0
    for fault in faults:
        caused *= fault.factor ** sum(a.pair.terms[k].powers.get(c, 0) for c in fault.channels)
    ratio = a.gains[k] / caused
    if a.pair.channel == "steering":  # over that of a slowly rolling car: understeer needs more
        return 0.0 if 0.4 < ratio < 8.0 else _UNEXPLAINED
    relative = a.gain_stds[k] / abs(a.gains[k])
    limit = max(math.log(ALIKE), SURE * relative)
    if caused != 1:
        limit = max(math.log(1.2), min(2.5 * relative, 0.4))
    off = abs(math.log(ratio)) if ratio > 0 else math.inf
    return min(off, _UNEXPLAINED) if off <= limit else _UNEXPLAINED


def _possible(pairs: Sequence[Agreement], columns: Mapping[str, Channel]) -> Iterator[Fault]:
    """All faults of units and signs that the channels of the pairs may have."""
    named = sorted({name for a in pairs for term in a.pair.terms for name in term.powers})
    shared = [pair for pair in _ONE_SENSOR if set(pair) <= set(named)]
    for channels in (*((name,) for name in named), *shared):
        alone = _ALONE * any(set(channels) < set(pair) for pair in shared)
        units: dict[float, str | None] = {1.0: None}
        if channels != ("y",):
            units |= _units(columns[channels[0]])
        for factor, unit in units.items():
            rare = alone + _RARE * (unit not in (None, *_USUAL))
            if unit:
                yield Fault(channels, factor, unit, rare)
            if channels != ("xy",) and len(channels) == 1:
                yield Fault(channels, -factor, unit, rare + _RARE * bool(unit))


def _units(channel: Channel) -> dict[float, str | None]:
    """Factor by which values were read too large -> the unit that they are in."""
    if channel.quantity not in QUANTITIES:
        return {180 / math.pi: "deg"}
    factors: dict[float, str | None] = {}
    for text in units_of(QUANTITIES[channel.quantity]):
        unit = unit_of(text, channel.quantity)
        assert unit is not None  # it is from the list of this quantity
        factor = abs(channel.factor) / unit.scale
        if abs(math.log(factor)) > math.log(ALIKE):
            factors.setdefault(factor, text)
    return factors


def _explained(
    pairs: Sequence[Agreement], columns: Mapping[str, Channel]
) -> tuple[tuple[Fault, ...], tuple[Fault, ...]]:
    """The one or two faults that explain the gains at the lowest cost, none if there are
    none, and single faults that explain them as well."""
    possible = list(_possible(pairs, columns))
    usual = [fault for fault in possible if fault.rarity < _RARE]
    twos = itertools.combinations(usual, 2)
    sets: list[tuple[Fault, ...]] = [(), *((fault,) for fault in possible)]
    sets += [two for two in twos if not {*two[0].channels} & {*two[1].channels}]

    def cost(faults: tuple[Fault, ...]) -> float:
        total = sum(_FAULT + fault.rarity for fault in faults)
        for a in pairs:
            each = [_cost((a, k), faults) for k, judged in enumerate(a.judged) if judged]
            # Two faults could explain any gain, so a pair is explained as a whole or not.
            explains = max(each, default=0.0) < _UNEXPLAINED
            total += sum(each) if explains else _UNEXPLAINED * len(each)
        return total

    costs = {faults: cost(faults) for faults in sets}
    best = min(costs, key=lambda faults: costs[faults])
    limit = costs[best] + _AS_LIKELY
    alike = [f[0] for f in costs if len(f) == 1 == len(best) and f != best and costs[f] < limit]
    return best, tuple(alike)


def _gains(
    pairs: Sequence[Agreement],
    track: Track,
    motion: Motion,
    vehicle: Vehicle,
    columns: Mapping[str, Channel],
) -> Iterator[Deviation]:
    """Gains that are not 1: exchanged channels, wrong units and signs, or neither."""
    off, stray = _not_explained(pairs), [a for a in pairs if a.strays]
    if not off and not stray:
        return
    faults, alternatives = _explained(pairs, columns)
    left = _not_explained(pairs, faults)
    wrong = {(a.pair.channel, a.pair.words) for a in (*(a for a, k in off if k == 0), *stray)}
    if wrong and (left or stray or len(faults) > 1):
        swappable = [name for name in _SWAPPED if name in columns]
        for pair in itertools.combinations(swappable, 2):
            other = dict(zip(pair, reversed(pair), strict=True))
            channels = (
                replace(c, quantity=other.get(c.quantity, c.quantity)) for c in track.channels
            )
            turned = agreements(replace(track, channels=tuple(channels)), motion, vehicle)
            right = {(a.pair.channel, a.pair.words) for a in turned if a.judged[0]}
            if wrong <= right and not any(a.strays or _not_explained([a]) for a in turned):
                exchanged = ", ".join(f'{a} = "{columns[b].header}"' for a, b in other.items())
                remedy = f"exchange them in [columns]: {exchanged}"
                yield Deviation(pair, f"{pair[0]} and {pair[1]} are exchanged", remedy)
                return
    if faults:
        wrong_channels = [name for fault in faults for name in fault.channels]
        solved = [gain for gain in off if gain not in left] or off
        # Gains of a wrong channel itself show the fault clearest.
        clearest = max(
            solved,
            key=lambda gain: (
                gain[0].pair.channel in wrong_channels,
                abs(gain[0].gains[gain[1]]) / max(gain[0].gain_stds[gain[1]], 1e-300),
            ),
        )
        total = _drift(motion, vehicle, -1)
        means = [_fault_words(fault, columns, vehicle, total) for fault in (*faults, *alternatives)]
        word = " and " if len(faults) > 1 else ", or "
        reason, remedy = (word.join(dict.fromkeys(each)) for each in zip(*means, strict=True))
        yield Deviation(wrong_channels, f"{_gain_words(*clearest)}: {reason}", remedy)
    used = {*vehicle.columns.motion, "steering", *(["xy"] if "x" in vehicle.columns.motion else [])}
    for a, k in {id(a): (a, k) for a, k in reversed(left)}.values():  # one of each pair
        channel, reason = a.pair.channel, f"{_gain_words(a, k)}, which no unit explains"
        counts = columns[channel].named and not used.isdisjoint(a.pair.terms[k].powers)
        if counts and not 0.5 < a.gains[k] < 2 and channel != "steering":
            yield Deviation([channel], reason, _FIND)
        elif k == 0:
            reason += ": one of the sensors has a wrong scale or mounting"
            yield Deviation((), reason, refuses=False)
    for a in stray:
        channel, reason = a.pair.channel, f"{a.pair.channel} does not follow {a.pair.words}"
        if abs(a.correlation) < RELATED:
            reason += f" (correlation {a.correlation:.2f})"
        yield Deviation([channel], reason, _FIND, columns[channel].named and channel in used)


def _fault_words(
    fault: Fault, columns: Mapping[str, Channel], vehicle: Vehicle, total: float
) -> tuple[str, str]:
    """Reason and remedy of a fault.

    Args:
        total: mean sum of the directions of path and heading, negative: a compass heading and
            the path add up to 90 deg; with a mirrored axis, to 0.
    """
    if fault.channels[0] in ("y", "yaw") and not fault.unit:
        if abs(abs(total) - math.pi / 2) < SIDEWAYS:
            if fault.channels[0] == "y":
                return "x and y are exchanged", "exchange x and y in [columns]"
            unit = columns["yaw"].unit.removeprefix("-")
            turn = f"yaw_offset = {-vehicle.yaw_offset - total:.3g}"
            clockwise = "yaw is measured clockwise, from the y axis"
            return clockwise, f'set yaw = "-{unit}" in [units] and {turn}'
    names = [n for c in fault.channels for n in (("x", "y") if c == "xy" else (c,))]
    column, several = columns[names[0]], len(names) > 1
    text = fault.unit or column.unit.removeprefix("-")
    if (fault.factor < 0) != column.unit.startswith("-"):
        text = f"-{text}"
    reasons = []
    if fault.unit:
        read_in = column.unit or "rad by the map"
        reasons.append(f"{'are' if several else 'is'} in {fault.unit}, but read in {read_in}")
    if fault.factor < 0:
        reasons.append(f"{'have' if several else 'has'} the wrong sign")
    reason = " and ".join(f"{' and '.join(names)} {each}" for each in reasons)
    if column.quantity == "steering":
        turn = ": reverse the signs of angle" * (not fault.unit)
        return reason, f"correct [steering] of vehicle.toml{turn}"
    lines = ", ".join(f'{name} = "{text}"' for name in names)
    options = " ".join(f"--unit {name}={text}" for name in names)
    return reason, f"set {lines} in [units] of vehicle.toml, or {options}"


def _gain_words(a: Agreement, k: int) -> str:
    what = "the yaw rate" if a.pair.channel == "yaw" else a.pair.channel
    other = a.pair.words if len(a.gains) == 1 else a.pair.terms[k].words
    return f"{what} is {a.gains[k]:.3g} ± {a.gain_stds[k]:.1g} times {other}"


# --- delays and offsets ---------------------------------------------------------


def _delays_and_offsets(
    pairs: Iterable[Agreement], columns: Mapping[str, Channel], vehicle: Vehicle
) -> Iterator[Deviation]:
    """Delays that change a channel by more than ``CHANGED``; delays and zero errors of the a_y
    from which forces are computed."""
    reported = set()
    for a in pairs:
        channel, values, against = a.pair.channel, a.pair.values, a.pair.words
        forces = channel == "a_y" and "a_y" in vehicle.columns.motion and any(a.judged)
        size = f"{abs(a.delay):.2g} ± {a.delay_std:.1g} s"
        rows = round((abs(a.delay) - SURE * a.delay_std) * vehicle.filter.sample_rate)
        changed = 0.0
        if rows > 0 and a.has_delay and columns[channel].named:
            moved = values[rows:] - values[:-rows]
            changed = math.sqrt(np.nanmean(moved**2) / np.nanmean(values**2))
        if changed > CHANGED:
            pose = {"xy", "yaw"} & set(a.pair.terms[0].powers)
            two = (channel, "the pose" if pose else against)
            late, other = two if a.delay > 0 else two[::-1]
            reason = f"{late} is {size} later than {other}, which changes {channel} by"
            remedy = f"shift {late} in the log, or name columns of the same clock in [columns]"
            if "a_y" in two:
                remedy += "; leave a_y out of them if its sensor is not at the tracked point"
            if late not in reported:
                yield Deviation([channel], f"{reason} {100 * changed:.0f} % (rms)", remedy)
            reported.add(late)
        elif forces and a.has_delay and abs(a.delay) > max(_LATE, 3 * a.delay_std):
            reason = f"a_y is {size} {'late' if a.delay > 0 else 'early'} against {against}"
            reason += ": fy and alpha are not simultaneous; shift it in the log"
            yield Deviation((), reason, refuses=False)
        if forces and abs(a.offset) > max(_OFFSET, 3 * a.offset_std):
            reason = f"a_y is {a.offset:+.2g} ± {a.offset_std:.1g} m/s2 where it is 0 by speeds"
            reason += f" and yaw rate: fy is wrong by {vehicle.mass * a.offset:.2g} N in total,"
            yield Deviation((), f"{reason} unless the road is banked", refuses=False)


def _line(pairs: Iterable[Agreement], vehicle: Vehicle) -> str:
    """One line for the summary on the agreement of the channels."""
    gains, late = [], [(0.0, "")]
    for a in pairs:
        for gain, term, judged in zip(a.gains, a.pair.terms, a.judged, strict=True):
            words = term.words if len(a.gains) > 1 else a.pair.words
            gains += [f"{a.pair.channel} {gain:.2f} of {words}"] * judged
        if a.has_delay and a.delay_std < _LATE / 3:
            late.append((abs(a.delay), f"{a.pair.channel} against {a.pair.words}"))
    message = "channels: not compared, too little motion or too few channels"
    if gains:
        message = f"channels compared: {', '.join(gains)} (1: they agree"
        steers = any(gain.startswith("steering") for gain in gains)
        message += "; steering: above 1 if the car understeers)" if steers else ")"
        longest, where = max(late)
        message += f", delays up to {longest:.2f} s ({where})" if longest >= 0.005 else ""
    follows = "; a_y is computed from the speeds and checks no other channel"
    return message + (follows if vehicle.columns.a_y_follows else "")
