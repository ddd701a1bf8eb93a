"""Pairs of redundant channels of a vehicle log.

At the tracked point, in the axes of the car (x forward, y left), with the speed v along
the path and the rate psi' of its direction:

.. math:: a_y = v_x r + \\dot v_y, \\quad a_x = \\dot v_x - v_y r, \\quad
   r = \\dot\\psi, \\quad v_x = v \\cos\\beta, \\quad \\delta \\approx L r / v_x

The channels are compared below a fifth of the filter's cutoff, where noise is smaller.
Sensors are assumed to be at the tracked point, which causes smaller errors than a wrong
unit. The equation of the steering is valid up to a factor of a few, as cars understeer.
"""

from collections.abc import Mapping

import numpy as np

from tirefit.data.agreement import Agreement, Pair, Term, agreement
from tirefit.data.motion import SLOWER, Motion, slowed
from tirefit.data.track import Track
from tirefit.data.vehicle import Vehicle

_STANDING = 0.1
"""Share of the high speeds (95th percentile) below which rows are not compared."""

SIDEWAYS = 0.6  # largest mean angle between heading and path with which cars drive [rad]

_ZEROS = {"yaw": 0.01, "yaw_rate": 0.03, "a_y": 0.5, "a_x": 0.5, "steering": 0.05}
"""Channel -> zero error of a good sensor: 2 deg/s of a gyro, 3 deg of tilt; 0.02 of a
speed itself. The entry of ``yaw`` is that of its rate."""

_SPEED_ZERO = 0.02
_FLOORS = {
    "yaw": 0.03,
    "yaw_rate": 0.03,
    "a_y": 0.3,
    "a_x": 0.3,
    "steering": 0.005,
    "v_x": 0.3,
    "v_y": 0.1,
}
"""Channel -> smallest rms with which it can be compared [SI]."""

Signals = Mapping[str, np.ndarray]


def agreements(
    track: Track, motion: Motion, vehicle: Vehicle, swapped: tuple[str, str] | None = None
) -> list[Agreement]:
    """The estimates of all pairs of the log with enough samples.

    Args:
        swapped: two channels to exchange.
    """
    if not motion.settled.any():
        return []
    of = _slowly(track, motion, vehicle)
    if swapped is not None:
        one, other = swapped
        of[one], of[other] = of[other], of[one]
    usable = _usable(track, motion, vehicle, of)
    if not usable.any():
        return []
    rate, cutoff = vehicle.filter.sample_rate, vehicle.filter.cutoff

    def held(pairs: list[Pair]) -> list[Agreement]:
        some = (agreement(p, motion.part, usable, rate, SLOWER / cutoff) for p in pairs)
        return [result for result in some if result is not None]

    compared = []
    if {"x", "y"} <= set(of):
        path = _path(of, rate)
        compared = held(_of_heading(of, path, rate))
        heading = of.get("yaw") if _drives_ahead(compared, of, path, usable) else None
        compared += held(_of_path(of, path, heading, rate, vehicle))
    elif {"yaw", "yaw_rate"} <= set(of):
        compared = held([_gyro(of, rate)])
    return compared + held(_of_rates(of, rate, vehicle))


def heading_off_path(track: Track, motion: Motion, vehicle: Vehicle, sign: int) -> float:
    """Mean of ``sign`` x path direction - yaw [rad], in ±pi; NaN without a pose."""
    if not motion.settled.any():
        return np.nan
    of = _slowly(track, motion, vehicle)
    if not {"x", "y", "yaw"} <= set(of):
        return np.nan
    path = _path(of, vehicle.filter.sample_rate)
    return _askew(of["yaw"], sign * path["course"], _usable(track, motion, vehicle, of))


# --- signals --------------------------------------------------------------------


def _slowly(track: Track, motion: Motion, vehicle: Vehicle) -> dict[str, np.ndarray]:
    """Channel -> values (n,) on the grid, low-passed; NaN where it is not known."""
    slow = slowed(motion.logged, motion, vehicle)
    reach = round(SLOWER * vehicle.filter.settling * vehicle.filter.sample_rate)
    for rows in motion.stretches:
        unknown = ~np.isfinite(motion.logged[rows])
        slow[rows] = np.where(_far_from(unknown, reach), slow[rows], np.nan)
    names = [channel.quantity for channel in track.channels]
    of = dict(zip(names, slow.T.copy(), strict=True))
    if "steering" in of:
        assert vehicle.steering is not None  # the vehicle file has both or neither
        of["steering"] = np.interp(of["steering"], vehicle.steering.command, vehicle.steering.angle)
    return of


def _far_from(marked: np.ndarray, reach: int) -> np.ndarray:
    """Rows (n, k) bool that have no marked row of their column within ``reach``."""
    n = len(marked)
    counts = np.vstack([np.zeros((1, marked.shape[1]), int), np.cumsum(marked, axis=0)])
    rows = np.arange(n)
    last, first = np.minimum(rows + reach + 1, n), np.maximum(rows - reach, 0)
    return counts[last] == counts[first]


def _usable(track: Track, motion: Motion, vehicle: Vehicle, of: Signals) -> np.ndarray:
    """Grid samples (n,) bool: driven, in motion, and away from edges."""
    last_row = np.searchsorted(track.time, motion.time, side="right") - 1
    settled = motion.within >= SLOWER * vehicle.filter.settling
    if "v_x" in vehicle.columns.motion:
        speed = np.hypot(of["v_x"], of["v_y"])
    else:
        speed = _path(of, vehicle.filter.sample_rate)["speed"]
    settled &= track.active[last_row] & np.isfinite(speed)
    if not settled.any():
        return settled
    return settled & (speed > _STANDING * np.percentile(speed[settled], 95))


def _path(of: Signals, rate: float) -> dict[str, np.ndarray]:
    """The path on the ground, (n,) each: velocity, acceleration, speed, direction."""
    v = [np.gradient(of[name], 1 / rate) for name in ("x", "y")]
    a = [np.gradient(part, 1 / rate) for part in v]
    speed = np.hypot(*v)
    with np.errstate(divide="ignore", invalid="ignore"):
        turning = (v[0] * a[1] - v[1] * a[0]) / speed**2
    return {
        "v_x": v[0],
        "v_y": v[1],
        "a_x": a[0],
        "a_y": a[1],
        "speed": speed,
        "turning": turning,
        "course": np.arctan2(v[1], v[0]),
    }


def _askew(yaw, course, usable) -> float:
    """Circular mean of course - yaw [rad]."""
    there = usable & np.isfinite(yaw) & np.isfinite(course)
    if not there.any():
        return np.nan
    return float(np.angle(np.mean(np.exp(1j * (course - yaw)[there]))))


def _drives_ahead(compared: list[Agreement], of: Signals, path, usable) -> bool:
    """Whether the yaw is the heading of a car on this path."""
    turns = [a.gains[0] for a in compared if a.pair.channel == "yaw"]
    if not turns or not 0.7 < turns[0] < 1.4:
        return False
    return abs(_askew(of["yaw"], path["course"], usable)) < SIDEWAYS


# --- pairs ----------------------------------------------------------------------


def _pair(channel: str, words: str, values, *terms: Term, zero=None) -> Pair:
    zero = _ZEROS[channel] if zero is None else zero
    level, exact = channel == "v_x", channel not in ("yaw", "steering")
    exact &= not (channel == "a_y" and words == "v_x r")
    return Pair(channel, words, values, terms, zero, _FLOORS[channel], level, exact)


def _gyro(of: Signals, rate: float) -> Pair:
    powers = {"yaw_rate": 1, "yaw": -1}
    turned = Term(np.gradient(of["yaw"], 1 / rate), powers, "dyaw/dt")
    return _pair("yaw_rate", "the rate of the heading", of["yaw_rate"], turned)


def _of_heading(of: Signals, path: Signals, rate: float) -> list[Pair]:
    """The pairs of the heading with the path and with the yaw rate."""
    if "yaw" not in of:
        return []
    turning = Term(path["turning"], {"yaw": 1, "y": -1}, "rate of the path's direction")
    turned = np.gradient(of["yaw"], 1 / rate)
    pairs = [_pair("yaw", "the direction of travel", turned, turning)]
    return pairs + ([_gyro(of, rate)] if "yaw_rate" in of else [])


def _of_path(of: Signals, path: Signals, yaw, rate: float, vehicle) -> list[Pair]:
    """The pairs of speeds, accelerations and steering with positions, in the axes of the
    car if the heading ``yaw`` is plausible, else in those of the path."""
    speed, turning = path["speed"], path["turning"]
    moved = {"v_x": speed, "a_x": np.gradient(speed, 1 / rate), "a_y": speed * turning}
    if yaw is not None:
        cos, sin = np.cos(yaw), np.sin(yaw)
        for kind in ("v", "a"):
            x, y = path[f"{kind}_x"], path[f"{kind}_y"]
            moved |= {f"{kind}_x": cos * x + sin * y, f"{kind}_y": cos * y - sin * x}
    zero = _SPEED_ZERO * float(np.sqrt(np.nanmean(speed**2)))
    pairs = []
    for name in ("v_x", "v_y", "a_x", "a_y"):
        if name in of and name in moved:
            powers = {name: 1, "xy": -1} | ({"y": -1} if name.endswith("y") else {})
            words = f"the {'speed' if name[0] == 'v' else 'acceleration'} of the positions"
            own = zero if name[0] == "v" else None
            term = Term(moved[name], powers, "positions")
            pairs.append(_pair(name, words, of[name], term, zero=own))
    if "steering" in of and "v_x" not in vehicle.columns.motion:
        with np.errstate(divide="ignore", invalid="ignore"):
            curved = vehicle.wheelbase * turning / speed
        powers = {"steering": 1, "xy": 1, "y": -1}
        term = Term(curved, powers, "curvature")
        pairs.append(_pair("steering", "the path's curvature", of["steering"], term))
    return pairs


def _of_rates(of: Signals, rate: float, vehicle: Vehicle) -> list[Pair]:
    """The pairs of accelerations and steering with speeds and yaw rate."""
    pairs = []
    if {"v_x", "yaw_rate", "a_y"} <= set(of):
        powers = {"a_y": 1, "v_x": -1, "yaw_rate": -1}
        terms = [Term(of["v_x"] * of["yaw_rate"], powers, "v_x r")]
        if "v_y" in of:
            powers, rates = {"a_y": 1, "v_y": -1}, np.gradient(of["v_y"], 1 / rate)
            terms.append(Term(rates, powers, "dv_y/dt"))
        pairs.append(_pair("a_y", _sum(terms), of["a_y"], *terms))
    if {"v_x", "a_x"} <= set(of):
        rates = np.gradient(of["v_x"], 1 / rate)
        terms = [Term(rates, {"a_x": 1, "v_x": -1}, "dv_x/dt")]
        if {"v_y", "yaw_rate"} <= set(of):
            powers = {"a_x": 1, "v_y": -1, "yaw_rate": -1}
            terms.append(Term(-of["v_y"] * of["yaw_rate"], powers, "(-v_y r)"))
        pairs.append(_pair("a_x", _sum(terms), of["a_x"], *terms))
    if "steering" in of and "v_x" in vehicle.columns.motion:
        powers = {"steering": 1, "yaw_rate": -1, "v_x": 1}
        with np.errstate(divide="ignore", invalid="ignore"):
            curved = vehicle.wheelbase * of["yaw_rate"] / of["v_x"]
        term = Term(curved, powers, "L r / v_x")
        pairs.append(_pair("steering", "L r / v_x", of["steering"], term))
    return pairs


def _sum(terms: list[Term]) -> str:
    return " + ".join(term.words for term in terms)
