"""Find channels of a vehicle log that contradict each other, and the wrong unit or sign."""

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from tirefit.data.units import units_of
from tirefit.data.vehicle.motion import Motion
from tirefit.data.vehicle.pairs import ALIKE, CHANGED, SIDEWAYS, STEADY, SURE, Agreement, agreements
from tirefit.data.vehicle.track import Channel, Track
from tirefit.data.vehicle.vehicle import POSE, QUANTITIES, Vehicle, unit_of
from tirefit.results import InputProblem

_LATE = 0.05
_OFFSET = 0.3
"""Smallest delay [s] and offset [m/s2] of a used a_y that cause a warning, if they are also
three standard errors."""

_SWAPPED = ("v_x", "v_y", "a_x", "a_y", "yaw_rate")  # channels that may be exchanged
_ONE_SENSOR = (("v_x", "v_y"), ("a_x", "a_y"))  # usually in the same unit
_USUAL = (None, "km/h", "mph", "g", "deg", "deg/s", "mm")  # units, None: a sign only
_RARE, _ALONE = 0.05, 0.03
"""Distance [log gain] that a rare unit adds, and a unit of one of two channels of a sensor."""
_AS_NEAR = 0.02  # difference of the distances of faults that explain the gains equally well
_FIND = "find the wrong column and correct [columns] or [units], or derive with --believe"


_Deviation = tuple[str, str, str]
"""A channel, what is wrong, and the remedy of a log that is refused; "" of a warning."""


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
    if not any(remedy for *_, remedy in deviations):
        deviations += [*direction, *_delays_and_offsets(pairs, columns, vehicle)]
    problems = tuple(
        InputProblem(f"channels contradict each other: {reason}", remedy, file, None, header)
        for channel, reason, remedy in deviations
        if remedy
        for header in [columns[channel].header]
    )
    warnings = () if problems else tuple(reason for _, reason, _ in deviations)
    return Comparison(tuple(pairs), problems, warnings, _line(pairs, vehicle))


def _direction(motion: Motion, vehicle: Vehicle) -> Iterator[_Deviation]:
    """A car that mostly drives backwards or sideways, as its axes point elsewhere."""
    pose, off = vehicle.columns.motion == POSE, _drift(motion, vehicle)
    if math.pi - abs(off) < SIDEWAYS:
        unit = f"-{vehicle.units.get('v_x', 'm/s')}".removeprefix("--")
        how = f'v_x = "{unit}" (and v_y, a_x, a_y alike) in [units]'
        how = f"yaw_offset = {vehicle.yaw_offset + math.pi:.5g}" if pose else how
        remedy = f"if it drove forward, set {how} of vehicle.toml; if not, cut this part from"
        remedy += " the log: the equations hold for driving forward only"
        yield "yaw" if pose else "v_x", "the car drives backwards", remedy
    elif pose and abs(off) > SIDEWAYS:
        reason = f"the car would drive {abs(math.degrees(off)):.0f} deg sideways: yaw is measured"
        remedy = f"set yaw_offset = {vehicle.yaw_offset + off:.3g} in vehicle.toml"
        yield "yaw", f"{reason} from another axis", remedy


def _drift(motion: Motion, vehicle: Vehicle, sign: int = 1) -> float:
    """Mean of ``sign`` x direction of travel - heading [rad], in ±pi, where the car moves in one
    direction of the ground or of its axes; 0 if it does not."""
    fast = motion.settled & (np.hypot(motion.v_x, motion.v_y) > vehicle.v_min)
    heading = np.nan_to_num(motion.heading[fast])
    course = heading + np.arctan2(motion.v_y, motion.v_x)[fast]
    mean = np.mean(np.exp(1j * (sign * course - heading))) if fast.any() else 0.0
    return float(np.angle(mean)) if abs(mean) > STEADY else 0.0


# --- the fault that explains the gains ------------------------------------------


class Fault(NamedTuple):
    """Channels that were read with a wrong factor."""

    channels: tuple[str, ...]
    factor: float  # value read over true value
    unit: str | None  # the true unit; None if only the sign is wrong
    rarity: float  # distance that is added for a rare unit [log gain]


_NONE = Fault((), 1.0, None, 0.0)


def _distances(pairs: Iterable[Agreement], fault: Fault) -> dict[tuple[Agreement, int], float]:
    """Judged gains (a pair, the number of its gain) -> |log| of a gain over that which the fault
    causes; infinite if the signs differ or it is too large: a unit must agree closely, a
    deviation from 1 must be significant."""
    distances = {}
    for a in pairs:
        for k in np.flatnonzero(a.judged).tolist():
            power = sum(a.pair.terms[k].powers.get(c, 0) for c in fault.channels)
            ratio = a.gains[k] / fault.factor**power
            relative = a.gain_stds[k] / abs(a.gains[k])
            limit = max(math.log(ALIKE), SURE * relative)
            if power and fault.factor != 1:
                limit = max(math.log(1.2), min(2.5 * relative, 0.4))
            distance = abs(math.log(ratio)) if ratio > 0 else math.inf
            if a.pair.channel == "steering":  # over that of a slow car: understeer needs more
                limit, distance = 1.0, 0.0 if 0.4 < ratio < 8.0 else math.inf
            distances[a, k] = distance if distance <= limit else math.inf
    return distances


def _unexplained(pairs: Iterable[Agreement], fault: Fault = _NONE) -> list[tuple[Agreement, int]]:
    """The judged gains that a fault does not explain."""
    return [gain for gain, off in _distances(pairs, fault).items() if off == math.inf]


def _nearest(pairs: Sequence[Agreement], columns: Mapping[str, Channel]) -> list[Fault]:
    """The unit or sign that explains most gains, nearest to them, and those that are as near;
    empty if none explains more than no fault."""
    named = sorted({name for a in pairs for term in a.pair.terms for name in term.powers})
    shared = [sensor for sensor in _ONE_SENSOR if set(sensor) <= set(named)]
    faults = [_NONE]
    for channels in (*((name,) for name in named), *shared):
        alone = _ALONE * any(set(channels) < set(sensor) for sensor in shared)
        units: dict[float, str | None] = {1.0: None}
        if channels != ("y",):
            units |= _units(columns[channels[0]])
        for factor, unit in units.items():
            rare = alone + _RARE * (unit not in _USUAL)
            if unit:
                faults.append(Fault(channels, factor, unit, rare))
            if channels != ("xy",) and len(channels) == 1:
                faults.append(Fault(channels, -factor, unit, rare + _RARE * bool(unit)))

    def distance_of(fault: Fault) -> tuple[int, float]:
        distances = _distances(pairs, fault)
        wrong = {a for (a, _), off in distances.items() if off == math.inf}
        near = [off for (a, _), off in distances.items() if a not in wrong]
        return len(distances) - len(near), sum(near) + fault.rarity

    order = {fault: distance_of(fault) for fault in faults}
    left, distance = min(order.values())
    if left == order[_NONE][0]:
        return []
    near = [f for f in faults if order[f] <= (left, distance + _AS_NEAR)]
    return sorted(near, key=lambda fault: order[fault][1] > distance)


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


def _gains(
    pairs: Sequence[Agreement],
    track: Track,
    motion: Motion,
    vehicle: Vehicle,
    columns: Mapping[str, Channel],
) -> Iterator[_Deviation]:
    """Gains that are not 1: a wrong unit or sign, exchanged channels, or neither."""
    off, stray = _unexplained(pairs), [a for a in pairs if a.strays]
    if not off and not stray:
        return
    faults = _nearest(pairs, columns)
    left = _unexplained(pairs, faults[0]) if faults else off
    if (left or stray) and (pair := _exchanged(off, stray, track, motion, vehicle)):
        first, second = pair
        remedy = f'{first} = "{columns[second].header}", {second} = "{columns[first].header}"'
        remedy = f"exchange them in [columns]: {remedy}"
        yield (first, f"{first} and {second} are exchanged", remedy)
        return
    if faults:
        solved = [gain for gain in off if gain not in left]
        # Gains of a wrong channel itself show the fault clearest.
        clearest = max(
            solved,
            key=lambda gain: (
                gain[0].pair.channel in faults[0].channels,
                abs(gain[0].gains[gain[1]]) / max(gain[0].gain_stds[gain[1]], 1e-300),
            ),
        )
        total = _drift(motion, vehicle, -1)
        means = (_fault_words(fault, columns, vehicle, total) for fault in faults)
        reason, remedy = (", or ".join(dict.fromkeys(each)) for each in zip(*means, strict=True))
        yield (faults[0].channels[0], f"{_gain_words(*clearest)}: {reason}", remedy)
    used = {*vehicle.columns.motion, "steering", *(["xy"] if "x" in vehicle.columns.motion else [])}
    for a, k in {a: (a, k) for a, k in reversed(left)}.values():  # one of each pair
        channel, reason = a.pair.channel, f"{_gain_words(a, k)}, which no unit explains"
        counts = not used.isdisjoint(a.pair.terms[k].powers)
        if counts and not 0.5 < a.gains[k] < 2 and channel != "steering":
            yield channel, reason, _FIND
        elif k == 0:
            yield channel, f"{reason}: one of the sensors has a wrong scale or mounting", ""
    for a in stray:
        channel = a.pair.channel
        reason = f"{channel} does not follow {a.pair.words} (correlation {a.correlation:.2f})"
        yield channel, reason, _FIND


def _exchanged(
    off: Sequence[tuple[Agreement, int]],
    stray: Sequence[Agreement],
    track: Track,
    motion: Motion,
    vehicle: Vehicle,
) -> tuple[str, str] | None:
    """Two channels after whose exchange all pairs agree, those that do not now among them."""
    wrong = {(a.pair.channel, a.pair.words) for a in (*(a for a, k in off if k == 0), *stray)}
    present = {c.quantity for c in track.channels}
    swappable = [name for name in _SWAPPED if name in present]
    for pair in itertools.combinations(swappable, 2) if wrong else ():
        other = dict(zip(pair, reversed(pair), strict=True))
        channels = (replace(c, quantity=other.get(c.quantity, c.quantity)) for c in track.channels)
        turned = agreements(replace(track, channels=tuple(channels)), motion, vehicle)
        right = {(a.pair.channel, a.pair.words) for a in turned if a.judged[0]}
        if wrong <= right and not any(a.strays for a in turned) and not _unexplained(turned):
            return pair
    return None


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
    return f"{what} is {a.gains[k]:.3g} ± {a.gain_stds[k]:.1g} times {_other_side(a, k)}"


def _other_side(a: Agreement, k: int) -> str:
    return a.pair.words if len(a.gains) == 1 else a.pair.terms[k].words


# --- delays and offsets ---------------------------------------------------------


def _delays_and_offsets(
    pairs: Iterable[Agreement], columns: Mapping[str, Channel], vehicle: Vehicle
) -> Iterator[_Deviation]:
    """Delays that change a channel by more than ``CHANGED``; delays and zero errors of the a_y
    from which forces are computed."""
    reported = set()
    for a in pairs:
        channel, values, against = a.pair.channel, a.pair.values, a.pair.words
        forces = channel == "a_y" and "a_y" in vehicle.columns.motion and any(a.judged)
        size = f"{abs(a.delay):.2g} ± {a.delay_std:.1g} s"
        rows = round((abs(a.delay) - SURE * a.delay_std) * vehicle.filter.sample_rate)
        changed = 0.0
        if rows > 0 and a.has_delay:
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
                yield channel, f"{reason} {100 * changed:.0f} % (rms)", remedy
            reported.add(late)
        elif forces and a.has_delay and abs(a.delay) > max(_LATE, 3 * a.delay_std):
            reason = f"a_y is {size} {'late' if a.delay > 0 else 'early'} against {against}"
            reason += ": fy and alpha are not simultaneous; shift it in the log"
            yield channel, reason, ""
        if forces and abs(a.offset) > max(_OFFSET, 3 * a.offset_std):
            reason = f"a_y is {a.offset:+.2g} ± {a.offset_std:.1g} m/s2 where it is 0 by speeds"
            reason += f" and yaw rate: fy is wrong by {vehicle.mass * a.offset:.2g} N in total,"
            yield channel, f"{reason} unless the road is banked", ""


def _line(pairs: Sequence[Agreement], vehicle: Vehicle) -> str:
    """One line for the summary on the agreement of the channels."""
    judged = [(a, k) for a in pairs for k in np.flatnonzero(a.judged).tolist()]
    message = "channels: not compared, too little motion or too few channels"
    if judged:
        gains = [f"{a.pair.channel} {a.gains[k]:.2f} of {_other_side(a, k)}" for a, k in judged]
        steers = any(a.pair.channel == "steering" for a, _ in judged)
        message = f"channels compared: {', '.join(gains)} (1: they agree"
        message += "; steering: above 1 if the car understeers)" if steers else ")"
        timed = [a for a in pairs if a.has_delay and a.delay_std < _LATE / 3]
        latest = max(timed, key=lambda a: abs(a.delay), default=None)
        if latest and abs(latest.delay) >= 0.005:
            message += f", delays up to {abs(latest.delay):.2f} s"
            message += f" ({latest.pair.channel} against {latest.pair.words})"
    follows = "; a_y is computed from the speeds and checks no other channel"
    return message + (follows if vehicle.columns.a_y_follows else "")
