"""Find channels of a vehicle log that contradict each other, and the wrong unit or sign."""

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from tirefit.data.agreement import Agreement
from tirefit.data.faults import (
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
from tirefit.data.motion import Motion
from tirefit.data.redundancy import SIDEWAYS, agreements, heading_off_path
from tirefit.data.track import Track
from tirefit.data.vehicle import POSE, Vehicle
from tirefit.results import InputProblem

_LATE = 0.05
_OFFSET = 0.3
"""Smallest delay [s] and offset [m/s2] of a used a_y that cause a warning."""


@dataclass(frozen=True)
class Comparison:
    """The comparison of redundant channels of a log."""

    pairs: tuple[Agreement, ...]  # every pair that was compared
    problems: tuple[InputProblem, ...]  # contradictions: channel, unit or sign, remedy
    warnings: tuple[str, ...]  # sentences on smaller or irrelevant differences
    line: str  # for the summary

    def as_dicts(self) -> list[dict]:
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
    if backwards := _backwards(track, motion, vehicle, file):
        return Comparison((), (backwards,), (), "channels: not compared")
    pairs = agreements(track, motion, vehicle)
    off = not_explained(pairs, ())
    stray = [a for a in pairs if strays(a)]
    problems: list[InputProblem] = []
    warnings: list[str] = []
    if off or stray:
        faults, alternatives = explained(pairs, off, track)
        whole = len(faults) == 1 and not stray and not not_explained(pairs, faults)
        wrong = [*(a for a, k in off if k == 0), *stray]
        swap = None if whole or not wrong else _swapped(track, motion, vehicle, wrong)
        if swap:
            problems.append(_swap_problem(swap, track, file))
            off, stray = [], []
        elif faults:
            problem = _fault_problem(faults, alternatives, off, track, motion, vehicle)
            _file_away(problem, faults, track, file, problems, warnings)
            off = not_explained(pairs, faults)
        for a, k in off:
            if k > 0 and any(a is other and j == 0 for other, j in off):
                continue  # reported above
            _unexplained(a, k, vehicle, track, file, problems, warnings)
        for a in stray:
            _no_relation(a, vehicle, track, file, problems, warnings)
    if not problems:
        problems += _sideways(track, motion, vehicle, file)
        problems += _another_clock(pairs, track, vehicle, file)
    warnings += [] if problems else _late_or_off(pairs, vehicle)
    return Comparison(tuple(pairs), tuple(problems), tuple(warnings), _line(pairs, vehicle))


def _backwards(track, motion, vehicle: Vehicle, file: str) -> InputProblem | None:
    """A problem if the car mostly drives backwards, or its axes point backwards."""
    fast = motion.settled & (np.hypot(motion.v_x, motion.v_y) > vehicle.v_min)
    share = float(np.mean(motion.v_x[fast] < 0)) if fast.any() else 0.0
    if share < _MOSTLY:
        return None
    if vehicle.columns.motion == POSE:
        name, how = "yaw", f"yaw_offset = {vehicle.yaw_offset + math.pi:.5g}"
    else:
        unit = f"-{vehicle.units.get('v_x', 'm/s')}".removeprefix("--")
        name, how = "v_x", f'v_x = "{unit}" (and v_y, a_x, a_y alike) in [units]'
    reason = f"the car drives backwards for {share:.0%} of the time in motion"
    remedy = f"if it drove forward, set {how} of vehicle.toml; if not, cut this part from"
    remedy += " the log: the equations hold for driving forward only"
    return InputProblem(reason, remedy, file, column=_column(track, name).header)


_MOSTLY = 0.9  # share of the time in motion; a manoeuvre in reverse takes less

_SWAPPED = ("v_x", "v_y", "a_x", "a_y", "yaw_rate")


def _swapped(track, motion, vehicle, wrong) -> tuple[str, str] | None:
    """Two channels whose exchange resolves all contradictions."""
    there = {c.quantity for c in track.channels}
    names = {(a.pair.channel, a.pair.words) for a in wrong}
    for pair in itertools.combinations([c for c in _SWAPPED if c in there], 2):
        turned = agreements(track, motion, vehicle, pair)
        right = {(a.pair.channel, a.pair.words) for a in turned if judged(a)[0]}
        if names <= right and not any(map(strays, turned)):
            if not not_explained(turned, ()):
                return pair
    return None


# --- words ----------------------------------------------------------------------


def _column(track: Track, name: str):
    return next(c for c in track.channels if c.quantity == {"xy": "x"}.get(name, name))


def _names(fault: Fault) -> str:
    names = {"xy": "x and y", "y": "y"}
    return " and ".join(names.get(name, name) for name in fault.channels)


def _guessed(fault: Fault, track: Track) -> tuple[str, str]:
    """Reason and remedy of a fault."""
    names = [n for c in fault.channels for n in (("x", "y") if c == "xy" else (c,))]
    read = _column(track, names[0])
    is_or_are, has_or_have = ("are", "have") if len(names) > 1 else ("is", "has")
    flipped = fault.factor < 0
    text = fault.unit or read.unit.removeprefix("-")
    if flipped != read.unit.startswith("-"):
        text = f"-{text}"
    messages = []
    if fault.unit:
        read_in = read.unit or "rad by the map"
        messages.append(f"{_names(fault)} {is_or_are} in {fault.unit}, but read in {read_in}")
    if flipped:
        messages.append(f"{_names(fault)} {has_or_have} the wrong sign")
    if read.quantity == "steering":
        return " and ".join(messages), "correct [steering] of vehicle.toml" + (
            ": reverse the signs of angle" * (flipped and not fault.unit)
        )
    lines = ", ".join(f'{name} = "{text}"' for name in names)
    options = " ".join(f"--unit {name}={text}" for name in names)
    return " and ".join(messages), f"set {lines} in [units] of vehicle.toml, or {options}"


def _evidence(a: Agreement, k: int) -> str:
    return (
        f"{a.pair.channel if a.pair.channel != 'yaw' else 'the yaw rate'} is"
        f" {a.gains[k]:.3g} ± {a.gain_stds[k]:.1g} times"
        f" {a.pair.words if len(a.gains) == 1 else a.pair.terms[k].words}"
    )


def _clearness(a, k, faults) -> tuple[bool, float]:
    """Sort key of gains that show a fault: gains of its own channel are the clearest."""
    own = any(a.pair.channel in fault.channels for fault in faults)
    return own, abs(a.gains[k]) / max(a.gain_stds[k], 1e-300)


def _fault_problem(faults, alternatives, off, track, motion, vehicle) -> InputProblem:
    clear = max(off, key=lambda item: _clearness(item[0], item[1], faults))
    messages = [_guessed(fault, track) for fault in (*faults, *alternatives)]
    word = " and " if len(faults) > 1 else ", or "
    reasons, remedies = zip(*messages, strict=True)
    mirrored = _mirrored(faults, alternatives, track, motion, vehicle)
    if mirrored is not None:
        reasons, remedies = mirrored
    what = word.join(dict.fromkeys(reasons))
    reason = f"channels contradict each other: {_evidence(*clear)}: {what}"
    return InputProblem(reason, word.join(dict.fromkeys(remedies)))


def _mirrored(faults, alternatives, track, motion, vehicle):
    """Reasons and remedies if the path turns the other way than the heading, as yaw is a
    compass heading or x and y are exchanged; else None."""
    channels = {c for f in (*faults, *alternatives) for c in f.channels}
    if not channels <= {"y", "yaw"} or any(f.unit for f in faults):
        return None
    # Course and compass heading add up to 90 deg; with a mirrored axis, to 0.
    total = heading_off_path(track, motion, vehicle, -1)
    if not abs(abs(total) - math.pi / 2) < SIDEWAYS:
        return None
    turn = -vehicle.yaw_offset - total
    unit = _column(track, "yaw").unit.removeprefix("-")
    swapped = "x and y are exchanged", "exchange x and y in [columns]"
    compass = (
        "yaw is measured clockwise, from the y axis",
        f'set yaw = "-{unit}" in [units] and yaw_offset = {turn:.3g}',
    )
    messages = [swapped] if "y" in channels else []
    messages += [compass] if "yaw" in channels else []
    return tuple(zip(*messages, strict=True))


def _used(names: Iterable[str], vehicle: Vehicle) -> bool:
    """Whether the derived quantities depend on one of the channels."""
    needed = {"xy": "x"}
    motion = (*vehicle.columns.motion, "steering")
    return any(needed.get(name, name) in motion for name in names)


def _file_away(problem, faults, track, file, problems, warnings) -> None:
    """Add a fault as an error, or as a warning if ``[columns]`` does not name its column."""
    columns = [_column(track, name) for f in faults for name in f.channels]
    if any(column.named for column in columns):
        header = next(column.header for column in columns if column.named)
        problems.append(InputProblem(problem.reason, problem.remedy, file, column=header))
    else:
        warnings.append(f"{problem.reason}; [columns] does not name it, so it is not used here")


def _unexplained(a, k, vehicle, track, file, problems, warnings) -> None:
    """Add a gain that no unit explains: an error if it is off by 2 and used."""
    message = f"{_evidence(a, k)}, which no unit explains"
    column = _column(track, a.pair.channel)
    names = {a.pair.channel, *a.pair.terms[k].powers}
    far = not 0.5 < a.gains[k] < 2 and a.pair.channel != "steering"
    if far and column.named and _used(names, vehicle):
        remedy = "find the wrong column and correct [columns] or [units], or derive with --believe"
        reason = f"channels contradict each other: {message}"
        problems.append(InputProblem(reason, remedy, file, column=column.header))
    elif k == 0:
        warnings.append(f"{message}: one of the sensors has a wrong scale or mounting")


def _no_relation(a, vehicle, track, file, problems, warnings) -> None:
    message = f"{a.pair.channel} does not follow {a.pair.words}"
    if abs(a.correlation) < RELATED:
        message += f" (correlation {a.correlation:.2f})"
    column = _column(track, a.pair.channel)
    if column.named and _used([a.pair.channel], vehicle):
        remedy = "find the wrong column and correct [columns], or derive with --believe"
        reason = f"channels contradict each other: {message}"
        problems.append(InputProblem(reason, remedy, file, column=column.header))
    else:
        warnings.append(message)


def _swap_problem(swap, track, file) -> InputProblem:
    one, other = (_column(track, name) for name in swap)
    return InputProblem(
        f"channels contradict each other: {swap[0]} and {swap[1]} are exchanged",
        f'exchange them in [columns]: {swap[0]} = "{other.header}", {swap[1]} = "{one.header}"',
        file,
        column=one.header,
    )


def _sideways(track, motion, vehicle, file) -> list[InputProblem]:
    """Add a problem if the heading is always far off the direction of the path."""
    if vehicle.columns.motion != POSE:
        return []
    off = heading_off_path(track, motion, vehicle, 1)
    if not SIDEWAYS < abs(off) < math.pi - SIDEWAYS:
        return []
    return [
        InputProblem(
            f"channels contradict each other: the car would drive"
            f" {abs(math.degrees(off)):.0f} deg sideways: yaw is measured from another axis",
            f"set yaw_offset = {vehicle.yaw_offset + off:.3g} in vehicle.toml",
            file,
            column=_column(track, "yaw").header,
        )
    ]


def _another_clock(pairs, track, vehicle, file) -> list[InputProblem]:
    """Problems of delays that change a channel by more than ``CHANGED``."""
    problems: dict[str, InputProblem] = {}
    for a in pairs:
        column, values = _column(track, a.pair.channel), a.pair.values
        least = abs(a.delay) - SURE * a.delay_std
        rows = round(least * vehicle.filter.sample_rate)
        if rows < 1 or not (column.named and _has_delay(a)):
            continue
        moved = values[rows:] - values[:-rows]
        changed = math.sqrt(np.nanmean(moved**2) / np.nanmean(values**2))
        pose = {"xy", "yaw"} & set(a.pair.terms[0].powers)
        late, other = a.pair.channel, "the pose" if pose else a.pair.words
        late, other = (late, other) if a.delay > 0 else (other, late)
        reason = f"channels contradict each other: {late} is {abs(a.delay):.2g} ±"
        reason += f" {a.delay_std:.1g} s later than {other}, which changes"
        reason += f" {a.pair.channel} by {100 * changed:.0f} % (rms)"
        remedy = f"shift {late} in the log, or name columns of the same clock in [columns]"
        if "a_y" in (late, other):
            remedy += "; leave a_y out of them if its sensor is not at the tracked point"
        if changed > CHANGED and late not in problems:
            problems[late] = InputProblem(reason, remedy, file, column=column.header)
    return list(problems.values())


def _late_or_off(pairs, vehicle) -> list[str]:
    """Warnings on delay and zero error of the a_y from which forces are computed."""
    messages = []
    for a in pairs:
        if a.pair.channel != "a_y" or not any(judged(a)):
            continue
        if "a_y" not in vehicle.columns.motion:
            continue
        if _has_delay(a) and abs(a.delay) > max(_LATE, 3 * a.delay_std):
            how = "late" if a.delay > 0 else "early"
            messages.append(
                f"a_y is {abs(a.delay):.2g} ± {a.delay_std:.1g} s {how} against"
                f" {a.pair.words}: fy and alpha are not simultaneous; shift it in the"
                " log"
            )
        if abs(a.offset) > max(_OFFSET, 3 * a.offset_std):
            messages.append(
                f"a_y is {a.offset:+.2g} ± {a.offset_std:.1g} m/s2 where it is 0 by speeds"
                f" and yaw rate: fy is wrong by {vehicle.mass * a.offset:.2g} N in total,"
                " unless the road is banked"
            )
    return messages


def _has_delay(a: Agreement) -> bool:
    """Whether an estimated delay cannot be caused by the dynamics of the car."""
    return any(judged(a)) and a.pair.exact and a.delay_seen > SEEN


def _line(pairs, vehicle: Vehicle) -> str:
    """One line for the summary on the agreement of the channels."""
    gains, late = [], [(0.0, "")]
    for a in pairs:
        several = len(a.gains) > 1
        gains += [
            f"{a.pair.channel} {gain:.2f} of {term.words if several else a.pair.words}"
            for gain, term, known in zip(a.gains, a.pair.terms, judged(a), strict=True)
            if known
        ]
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
