"""Find channels of a vehicle log that contradict each other, and the wrong unit or sign."""

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from tirefit.data.vehicle.agreement import Agreement
from tirefit.data.vehicle.faults import (
    CHANGED,
    RELATED,
    SEEN,
    SURE,
    Fault,
    explained,
    judged,
    not_explained,
    strays,
)
from tirefit.data.vehicle.motion import Motion
from tirefit.data.vehicle.redundancy import SIDEWAYS, STEADY, agreements
from tirefit.data.vehicle.track import Channel, Track
from tirefit.data.vehicle.vehicle import POSE, Vehicle
from tirefit.results import InputProblem

_LATE = 0.05
_OFFSET = 0.3
"""Smallest delay [s] and offset [m/s2] of a used a_y that cause a warning."""

_SURELY = 3.0  # standard errors of a delay or offset that causes a warning
_SWAPPED = ("v_x", "v_y", "a_x", "a_y", "yaw_rate")  # channels that may be exchanged
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

    def as_dicts(self) -> list[dict[str, Any]]:
        """Each pair with its estimates, for the companion file."""
        return [
            {
                "channel": a.pair.channel,
                "against": a.pair.words,
                "gains": [
                    {"of": term.words, "value": gain, "std": std}
                    for term, gain, std in zip(a.pair.terms, a.gains, a.gain_stds, strict=True)
                ],
                "delay": a.delay,
                "delay_std": a.delay_std,
                "offset": a.offset,
                "offset_std": a.offset_std,
                "correlation": a.correlation,
                "samples": a.samples,
                "effective_samples": a.effective,
                "judged": any(judged(a)),
            }
            for a in self.pairs
        ]


def compare(track: Track, motion: Motion, vehicle: Vehicle, file: str) -> Comparison:
    """Compare every channel with the others; the car must drive forward."""
    pairs, direction = [], list(_direction(motion, vehicle))
    found = direction
    if not direction or abs(_drift(motion, vehicle)) < math.pi - SIDEWAYS:
        pairs = agreements(track, motion, vehicle)
        found = list(_gains(pairs, track, motion, vehicle))
    if not any(_header(one, track) for one in found):
        found += [*direction, *_delays_and_offsets(pairs, track, vehicle)]
    problems, warnings = [], []
    for one in found:
        if header := _header(one, track):
            reason = f"channels contradict each other: {one.reason}"
            problems.append(InputProblem(reason, one.remedy, file, column=header))
        elif one.refuses:
            warnings.append(f"{one.reason}; [columns] does not name it, so it is not used here")
        elif not problems:
            warnings.append(one.reason)
    return Comparison(tuple(pairs), tuple(problems), tuple(warnings), _line(pairs, vehicle))


def _column(track: Track, name: str) -> Channel:
    return next(c for c in track.channels if c.quantity == {"xy": "x"}.get(name, name))


def _header(one: Deviation, track: Track) -> str:
    """The header of the first column of a deviation that refuses the log and that ``[columns]``
    names; empty without one."""
    columns = [_column(track, name) for name in one.channels] if one.refuses else []
    return next((column.header for column in columns if column.named), "")


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


# --- gains ----------------------------------------------------------------------


def _gains(
    pairs: Sequence[Agreement], track: Track, motion: Motion, vehicle: Vehicle
) -> Iterator[Deviation]:
    """Gains that are not 1: exchanged channels, wrong units and signs, or neither."""
    off, stray = not_explained(pairs), [a for a in pairs if strays(a)]
    if not off and not stray:
        return
    faults, alternatives = explained(pairs, track)
    left = not_explained(pairs, faults)
    wrong = {(a.pair.channel, a.pair.words) for a in (*(a for a, k in off if k == 0), *stray)}
    swap = _swapped(track, motion, vehicle, wrong) if left or stray or len(faults) > 1 else None
    if swap:
        one, other = (_column(track, name).header for name in swap)
        remedy = f'exchange them in [columns]: {swap[0]} = "{other}", {swap[1]} = "{one}"'
        yield Deviation(swap, f"{swap[0]} and {swap[1]} are exchanged", remedy)
        return
    if faults:
        solved = [gain for gain in off if gain not in left] or off
        evidence = _evidence(*max(solved, key=lambda gain: _clearness(gain[0], gain[1], faults)))
        total = _drift(motion, vehicle, -1)
        means = [_fault_words(one, track, vehicle, total) for one in (*faults, *alternatives)]
        word = " and " if len(faults) > 1 else ", or "
        reason, remedy = (word.join(dict.fromkeys(each)) for each in zip(*means, strict=True))
        yield Deviation([c for f in faults for c in f.channels], f"{evidence}: {reason}", remedy)
    for a, k in {id(a): (a, k) for a, k in reversed(left)}.values():  # one of each pair
        reason = f"{_evidence(a, k)}, which no unit explains"
        far = not 0.5 < a.gains[k] < 2 and a.pair.channel != "steering"
        if far and _used(a.pair.terms[k].powers, a, track, vehicle):
            yield Deviation([a.pair.channel], reason, _FIND)
        elif k == 0:
            reason += ": one of the sensors has a wrong scale or mounting"
            yield Deviation((), reason, refuses=False)
    for a in stray:
        reason = f"{a.pair.channel} does not follow {a.pair.words}"
        if abs(a.correlation) < RELATED:
            reason += f" (correlation {a.correlation:.2f})"
        refuses = _used([a.pair.channel], a, track, vehicle)
        yield Deviation([a.pair.channel], reason, _FIND, refuses)


def _used(names: Iterable[str], a: Agreement, track: Track, vehicle: Vehicle) -> bool:
    """Whether ``[columns]`` names the channel of a pair, and the derived quantities depend on one
    of the channels."""
    used = {*vehicle.columns.motion, "steering"}
    used |= {"xy"} if "x" in used else set()
    return _column(track, a.pair.channel).named and not used.isdisjoint(names)


def _swapped(
    track: Track, motion: Motion, vehicle: Vehicle, wrong: set[tuple[str, str]]
) -> tuple[str, str] | None:
    """Two channels whose exchange resolves the contradictions of the pairs ``wrong``."""
    there = {c.quantity for c in track.channels}
    for pair in itertools.combinations([c for c in _SWAPPED if c in there], 2) if wrong else ():
        turned = agreements(track, motion, vehicle, pair)
        right = {(a.pair.channel, a.pair.words) for a in turned if judged(a)[0]}
        if wrong <= right and not any(map(strays, turned)) and not not_explained(turned):
            return pair
    return None


def _fault_words(fault: Fault, track: Track, vehicle: Vehicle, total: float) -> tuple[str, str]:
    """Reason and remedy of a fault.

    Args:
        total: mean sum of the directions of path and heading, negative: a compass heading and
            the path add up to 90 deg; with a mirrored axis, to 0.
    """
    if fault.channels[0] in ("y", "yaw") and not fault.unit:
        if abs(abs(total) - math.pi / 2) < SIDEWAYS:
            if fault.channels[0] == "y":
                return "x and y are exchanged", "exchange x and y in [columns]"
            unit = _column(track, "yaw").unit.removeprefix("-")
            turn = f"yaw_offset = {-vehicle.yaw_offset - total:.3g}"
            clockwise = "yaw is measured clockwise, from the y axis"
            return clockwise, f'set yaw = "-{unit}" in [units] and {turn}'
    names = [n for c in fault.channels for n in (("x", "y") if c == "xy" else (c,))]
    read, several = _column(track, names[0]), len(names) > 1
    text = fault.unit or read.unit.removeprefix("-")
    if (fault.factor < 0) != read.unit.startswith("-"):
        text = f"-{text}"
    reasons = []
    if fault.unit:
        read_in = read.unit or "rad by the map"
        reasons.append(f"{'are' if several else 'is'} in {fault.unit}, but read in {read_in}")
    if fault.factor < 0:
        reasons.append(f"{'have' if several else 'has'} the wrong sign")
    what = " and ".join(names)
    reason = " and ".join(f"{what} {one}" for one in reasons)
    if read.quantity == "steering":
        turn = ": reverse the signs of angle" * (not fault.unit)
        return reason, f"correct [steering] of vehicle.toml{turn}"
    lines = ", ".join(f'{name} = "{text}"' for name in names)
    options = " ".join(f"--unit {name}={text}" for name in names)
    return reason, f"set {lines} in [units] of vehicle.toml, or {options}"


def _evidence(a: Agreement, k: int) -> str:
    what = "the yaw rate" if a.pair.channel == "yaw" else a.pair.channel
    other = a.pair.words if len(a.gains) == 1 else a.pair.terms[k].words
    return f"{what} is {a.gains[k]:.3g} ± {a.gain_stds[k]:.1g} times {other}"


def _clearness(a: Agreement, k: int, faults: Iterable[Fault]) -> tuple[bool, float]:
    """Sort key of gains that show a fault: gains of its own channel are the clearest."""
    own = any(a.pair.channel in fault.channels for fault in faults)
    return own, abs(a.gains[k]) / max(a.gain_stds[k], 1e-300)


# --- delays and offsets ---------------------------------------------------------


def _delays_and_offsets(
    pairs: Iterable[Agreement], track: Track, vehicle: Vehicle
) -> Iterator[Deviation]:
    """Delays that change a channel by more than ``CHANGED``; delays and zero errors of the a_y
    from which forces are computed."""
    reported = set()
    for a in pairs:
        channel, values, against = a.pair.channel, a.pair.values, a.pair.words
        forces = channel == "a_y" and "a_y" in vehicle.columns.motion and any(judged(a))
        size = f"{abs(a.delay):.2g} ± {a.delay_std:.1g} s"
        rows = round((abs(a.delay) - SURE * a.delay_std) * vehicle.filter.sample_rate)
        changed = 0.0
        if rows > 0 and _has_delay(a) and _column(track, channel).named:
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
        elif forces and _has_delay(a) and abs(a.delay) > max(_LATE, _SURELY * a.delay_std):
            reason = f"a_y is {size} {'late' if a.delay > 0 else 'early'} against {against}"
            reason += ": fy and alpha are not simultaneous; shift it in the log"
            yield Deviation((), reason, refuses=False)
        if forces and abs(a.offset) > max(_OFFSET, _SURELY * a.offset_std):
            reason = f"a_y is {a.offset:+.2g} ± {a.offset_std:.1g} m/s2 where it is 0 by speeds"
            reason += f" and yaw rate: fy is wrong by {vehicle.mass * a.offset:.2g} N in total,"
            yield Deviation((), f"{reason} unless the road is banked", refuses=False)


def _has_delay(a: Agreement) -> bool:
    """Whether an estimated delay cannot be caused by the dynamics of the car."""
    return any(judged(a)) and a.pair.exact and a.delay_seen > SEEN


def _line(pairs: Iterable[Agreement], vehicle: Vehicle) -> str:
    """One line for the summary on the agreement of the channels."""
    gains, late = [], [(0.0, "")]
    for a in pairs:
        for gain, term, known in zip(a.gains, a.pair.terms, judged(a), strict=True):
            words = term.words if len(a.gains) > 1 else a.pair.words
            gains += [f"{a.pair.channel} {gain:.2f} of {words}"] * known
        if _has_delay(a) and a.delay_std < _LATE / 3:
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
