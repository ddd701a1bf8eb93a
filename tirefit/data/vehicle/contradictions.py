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
    Gain,
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


@dataclass(frozen=True)
class Comparison:
    """The comparison of redundant channels of a log."""

    pairs: tuple[Agreement, ...]  # every pair that was compared
    problems: tuple[InputProblem, ...]  # contradictions: channel, unit or sign, remedy
    warnings: tuple[str, ...]  # sentences on smaller or irrelevant differences
    line: str  # for the summary


class Fault(NamedTuple):
    """Channels that were read with a wrong factor."""

    channels: tuple[str, ...]
    factor: float  # value read over true value
    unit: str | None  # the true unit; None if only the sign is wrong
    rarity: float  # penalty of a rare unit [log gain]


def compare(track: Track, motion: Motion, vehicle: Vehicle, file: str) -> Comparison:
    """Compare every channel with the others; the car must drive forward."""
    log = _Log(track, motion, vehicle, file)
    direction = [*log.direction()]
    backwards = bool(direction) and abs(log.drift()) > math.pi - SIDEWAYS
    pairs = [] if backwards else agreements(track, motion, vehicle)
    found = [*log.gains(pairs)]
    if not any(isinstance(each, InputProblem) for each in found):
        found += [*direction, *log.delays_and_offsets(pairs)]
    problems = tuple(each for each in found if isinstance(each, InputProblem))
    warnings = tuple(each for each in found if isinstance(each, str))
    return Comparison(tuple(pairs), problems, warnings, _line(pairs, vehicle))


# --- the faults that explain the gains ------------------------------------------


def _wrong_gains(pairs: Iterable[Agreement], faults: Sequence[Fault] = ()) -> list[Gain]:
    """The judged gains that differ from those that the faults cause."""
    return [g for a in pairs for g in a.judged if _cost(g, faults) >= _UNEXPLAINED]


def _cost(gain: Gain, faults: Sequence[Fault]) -> float:
    """|log| of a gain over that which the faults cause; ``_UNEXPLAINED`` if the signs differ
    or it is too large: a unit must agree closely, a deviation from 1 must be significant."""
    caused = math.prod(f.factor ** sum(gain.powers[c] for c in f.channels) for f in faults)
    ratio = gain.value / caused
    if gain.channel == "steering":  # over that of a slowly rolling car: understeer needs more
        return 0.0 if 0.4 < ratio < 8.0 else _UNEXPLAINED
    relative = gain.std / abs(gain.value)
    limit = max(math.log(ALIKE), SURE * relative)
    if caused != 1:
        limit = max(math.log(1.2), min(2.5 * relative, 0.4))
    off = abs(math.log(ratio)) if ratio > 0 else math.inf
    return min(off, _UNEXPLAINED) if off <= limit else _UNEXPLAINED


def _possible(pairs: Sequence[Agreement], columns: Mapping[str, Channel]) -> Iterator[Fault]:
    """All faults of units and signs that the channels of the pairs may have."""
    named = sorted({name for a in pairs for gain in a.gains for name in gain.powers})
    shared = [pair for pair in _ONE_SENSOR if set(pair) <= set(named)]
    for channels in (*((name,) for name in named), *shared):
        alone = _ALONE * any(set(channels) < set(pair) for pair in shared)
        units = {} if channels == ("y",) else _units(columns[channels[0]])
        for factor, unit in units.items():
            yield Fault(channels, factor, unit, alone + _RARE * (unit not in _USUAL))
        if channels != ("xy",) and len(channels) == 1:
            yield Fault(channels, -1.0, None, alone)
            for factor, unit in units.items():
                yield Fault(channels, -factor, unit, alone + _RARE * (1 + (unit not in _USUAL)))


def _units(channel: Channel) -> dict[float, str]:
    """Factor by which values were read too large -> the unit that they are in."""
    if channel.quantity == "steering":
        return {180 / math.pi: "deg"}
    units = (
        (unit_of(text, channel.quantity), text) for text in units_of(QUANTITIES[channel.quantity])
    )
    factors = ((abs(channel.factor) / unit.scale, text) for unit, text in units if unit)
    return {factor: text for factor, text in factors if abs(math.log(factor)) > math.log(ALIKE)}


def _explained(
    pairs: Sequence[Agreement], columns: Mapping[str, Channel]
) -> tuple[tuple[Fault, ...], list[Fault]]:
    """The one or two faults that explain the gains at the lowest cost, none if there are
    none, and single faults that explain them as well."""
    possible = list(_possible(pairs, columns))
    usual = [fault for fault in possible if fault.rarity < _RARE]
    sets: list[tuple[Fault, ...]] = [(), *((fault,) for fault in possible)]
    twos = itertools.combinations(usual, 2)
    sets += [two for two in twos if not {*two[0].channels} & {*two[1].channels}]

    def cost(faults: tuple[Fault, ...]) -> float:
        total = sum(_FAULT + fault.rarity for fault in faults)
        for a in pairs:
            each = [_cost(gain, faults) for gain in a.judged]
            # Two faults could explain any gain, so a pair is explained as a whole or not.
            explains = max(each, default=0.0) < _UNEXPLAINED
            total += sum(each) if explains else _UNEXPLAINED * len(each)
        return total

    costs = {faults: cost(faults) for faults in sets}
    best = min(costs, key=lambda faults: costs[faults])
    limit = costs[best] + _AS_LIKELY
    alike = [f[0] for f in costs if len(f) == 1 == len(best) and f != best and costs[f] < limit]
    return best, alike


class _Log:
    """A log whose channels are compared. Its methods yield problems of channels that ``[columns]``
    names, and warnings on others and on differences that do not matter."""

    def __init__(self, track: Track, motion: Motion, vehicle: Vehicle, file: str):
        self.track, self.motion, self.vehicle, self.file = track, motion, vehicle, file
        self.columns = {channel.quantity: channel for channel in track.channels}
        self.columns |= {"xy": self.columns["x"]} if "x" in self.columns else {}

    def refusal(self, channels: Sequence[str], reason: str, remedy: str) -> InputProblem | str:
        """A problem of the first of the channels that ``[columns]`` names, else a warning."""
        for column in (self.columns[name] for name in channels):
            if column.named:
                reason = f"channels contradict each other: {reason}"
                return InputProblem(reason, remedy, self.file, column=column.header)
        return f"{reason}; [columns] does not name it, so it is not used here"

    def drift(self, sign: int = 1) -> float:
        """Mean of ``sign`` x direction of travel - heading [rad], in ±pi, where the car moves in
        one direction of the ground or of its axes; 0 if it does not."""
        motion = self.motion
        fast = motion.settled & (np.hypot(motion.v_x, motion.v_y) > self.vehicle.v_min)
        heading = np.nan_to_num(motion.heading[fast])
        course = heading + np.arctan2(motion.v_y, motion.v_x)[fast]
        mean = np.mean(np.exp(1j * (sign * course - heading))) if fast.any() else 0.0
        return float(np.angle(mean)) if abs(mean) > STEADY else 0.0

    def direction(self) -> Iterator[InputProblem | str]:
        """A car that mostly drives backwards or sideways, as its axes point elsewhere."""
        vehicle, off = self.vehicle, self.drift()
        pose = vehicle.columns.motion == POSE
        if math.pi - abs(off) < SIDEWAYS:
            unit = f"-{vehicle.units.get('v_x', 'm/s')}".removeprefix("--")
            how = f'v_x = "{unit}" (and v_y, a_x, a_y alike) in [units]'
            how = f"yaw_offset = {vehicle.yaw_offset + math.pi:.5g}" if pose else how
            remedy = f"if it drove forward, set {how} of vehicle.toml; if not, cut this part from"
            remedy += " the log: the equations hold for driving forward only"
            yield self.refusal(["yaw" if pose else "v_x"], "the car drives backwards", remedy)
        elif pose and abs(off) > SIDEWAYS:
            reason = f"the car would drive {abs(math.degrees(off)):.0f} deg sideways: yaw is"
            remedy = f"set yaw_offset = {vehicle.yaw_offset + off:.3g} in vehicle.toml"
            yield self.refusal(["yaw"], f"{reason} measured from another axis", remedy)

    def gains(self, pairs: Sequence[Agreement]) -> Iterator[InputProblem | str]:
        """Gains that are not 1: exchanged channels, wrong units and signs, or neither."""
        off, stray = _wrong_gains(pairs), [a for a in pairs if a.strays]
        if not off and not stray:
            return
        faults, alternatives = _explained(pairs, self.columns)
        left = _wrong_gains(pairs, faults)
        # A pair by its first term, which it always has.
        firsts = [a.gains[0] for a in pairs if a.strays or a.gains[0] in off]
        wrong = {(gain.channel, gain.of) for gain in firsts}
        if wrong and (left or stray or len(faults) > 1):
            if exchanged := self.exchanged(wrong):
                yield exchanged
                return
        if faults:
            channels = [name for fault in faults for name in fault.channels]
            # Gains of a wrong channel itself show the fault clearest.
            clearest = max(
                [gain for gain in off if gain not in left] or off,
                key=lambda g: (g.channel in channels, abs(g.value) / max(g.std, 1e-300)),
            )
            means = [self.fault_words(fault) for fault in (*faults, *alternatives)]
            word = " and " if len(faults) > 1 else ", or "
            reason, remedy = (word.join(dict.fromkeys(each)) for each in zip(*means, strict=True))
            yield self.refusal(channels, f"{_gain_words(clearest)}: {reason}", remedy)
        used = {*self.vehicle.columns.motion, "steering"}
        used |= {"xy"} if "x" in used else set()
        for a in pairs:
            gain = next((gain for gain in a.gains if gain in left), None)
            if gain is None:
                continue
            reason = f"{_gain_words(gain)}, which no unit explains"
            counts = self.columns[a.channel].named and not used.isdisjoint(gain.powers)
            if counts and not 0.5 < gain.value < 2 and a.channel != "steering":
                yield self.refusal([a.channel], reason, _FIND)
            elif gain is a.gains[0]:
                yield f"{reason}: one of the sensors has a wrong scale or mounting"
        for a in stray:
            reason = f"{a.channel} does not follow {a.against}"
            if abs(a.correlation) < RELATED:
                reason += f" (correlation {a.correlation:.2f})"
            if a.channel in used or not self.columns[a.channel].named:
                yield self.refusal([a.channel], reason, _FIND)
            else:
                yield reason

    def exchanged(self, wrong: set[tuple[str, str]]) -> InputProblem | str | None:
        """Two channels with which, if they are exchanged, all ``wrong`` pairs agree."""
        swappable = [name for name in _SWAPPED if name in self.columns]
        for pair in itertools.combinations(swappable, 2):
            other = dict(zip(pair, reversed(pair), strict=True))
            channels = [
                replace(c, quantity=other.get(c.quantity, c.quantity)) for c in self.track.channels
            ]
            track = replace(self.track, channels=tuple(channels))
            turned = agreements(track, self.motion, self.vehicle)
            right = {(a.channel, a.gains[0].of) for a in turned if a.gains[0] in a.judged}
            if wrong <= right and not any(a.strays for a in turned) and not _wrong_gains(turned):
                names = ", ".join(f'{a} = "{self.columns[b].header}"' for a, b in other.items())
                remedy = f"exchange them in [columns]: {names}"
                return self.refusal(pair, f"{pair[0]} and {pair[1]} are exchanged", remedy)
        return None

    def fault_words(self, fault: Fault) -> tuple[str, str]:
        """Reason and remedy of a fault."""
        if fault.channels[0] in ("y", "yaw") and not fault.unit:
            # A compass heading and the path add up to 90 deg; with a mirrored axis, to 0.
            total = self.drift(-1)
            if abs(abs(total) - math.pi / 2) < SIDEWAYS:
                if fault.channels[0] == "y":
                    return "x and y are exchanged", "exchange x and y in [columns]"
                unit = self.columns["yaw"].unit.removeprefix("-")
                turn = f"yaw_offset = {-self.vehicle.yaw_offset - total:.3g}"
                clockwise = "yaw is measured clockwise, from the y axis"
                return clockwise, f'set yaw = "-{unit}" in [units] and {turn}'
        names = [n for c in fault.channels for n in (("x", "y") if c == "xy" else (c,))]
        column, several = self.columns[names[0]], len(names) > 1
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

    def delays_and_offsets(self, pairs: Iterable[Agreement]) -> Iterator[InputProblem | str]:
        """Delays that change a channel by more than ``CHANGED``; delays and zero errors of the
        a_y from which forces are computed."""
        reported = set()
        for a in pairs:
            forces = a.channel == "a_y" in self.vehicle.columns.motion and a.judged
            size = f"{abs(a.delay):.2g} ± {a.delay_std:.1g} s"
            rows = round((abs(a.delay) - SURE * a.delay_std) * self.vehicle.filter.sample_rate)
            changed = 0.0
            if rows > 0 and a.has_delay and self.columns[a.channel].named:
                moved = a.values[rows:] - a.values[:-rows]
                changed = math.sqrt(np.nanmean(moved**2) / np.nanmean(a.values**2))
            if changed > CHANGED:
                pose = {"xy", "yaw"} & set(a.gains[0].powers)
                two = (a.channel, "the pose" if pose else a.against)
                late, other = two if a.delay > 0 else two[::-1]
                reason = f"{late} is {size} later than {other}, which changes {a.channel} by"
                remedy = f"shift {late} in the log, or name columns of the same clock in [columns]"
                if "a_y" in two:
                    remedy += "; leave a_y out of them if its sensor is not at the tracked point"
                if late not in reported:
                    reason = f"{reason} {100 * changed:.0f} % (rms)"
                    yield self.refusal([a.channel], reason, remedy)
                reported.add(late)
            elif forces and a.has_delay and abs(a.delay) > max(_LATE, 3 * a.delay_std):
                yield (
                    f"a_y is {size} {'late' if a.delay > 0 else 'early'} against {a.against}:"
                    " fy and alpha are not simultaneous; shift it in the log"
                )
            if forces and abs(a.offset) > max(_OFFSET, 3 * a.offset_std):
                yield (
                    f"a_y is {a.offset:+.2g} ± {a.offset_std:.1g} m/s2 where it is 0 by speeds"
                    f" and yaw rate: fy is wrong by {self.vehicle.mass * a.offset:.2g} N in total,"
                    " unless the road is banked"
                )


# --- words ----------------------------------------------------------------------


def _gain_words(gain: Gain) -> str:
    what = "the yaw rate" if gain.channel == "yaw" else gain.channel
    return f"{what} is {gain.value:.3g} ± {gain.std:.1g} times {gain.of}"


def _line(pairs: Iterable[Agreement], vehicle: Vehicle) -> str:
    """One line for the summary on the agreement of the channels."""
    gains, late = [], [(0.0, "")]
    for a in pairs:
        gains += [f"{gain.channel} {gain.value:.2f} of {gain.of}" for gain in a.judged]
        if a.has_delay and a.delay_std < _LATE / 3:
            late.append((abs(a.delay), f"{a.channel} against {a.against}"))
    message = "channels: not compared, too little motion or too few channels"
    if gains:
        message = f"channels compared: {', '.join(gains)} (1: they agree"
        steers = any(gain.startswith("steering") for gain in gains)
        message += "; steering: above 1 if the car understeers)" if steers else ")"
        longest, where = max(late)
        message += f", delays up to {longest:.2f} s ({where})" if longest >= 0.005 else ""
    follows = "; a_y is computed from the speeds and checks no other channel"
    return message + (follows if vehicle.columns.a_y_follows else "")
