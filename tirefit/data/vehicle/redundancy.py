"""Pairs of redundant channels of a vehicle log.

At the tracked point, in the axes of the car (x forward, y left), with the speed v along
the path and the rate psi' of its direction:

.. math:: a_y = v_x r + \\dot v_y, \\quad a_x = \\dot v_x - v_y r, \\quad
   r = \\dot\\psi, \\quad v_x = v \\cos\\beta, \\quad \\delta \\approx L r / v_x

The channels are compared below a fifth of the filter's cutoff, where noise is smaller.
Sensors are assumed to be at the tracked point, which causes smaller errors than a wrong
unit. The equation of the steering is valid up to a factor of a few, as cars understeer.
"""

from collections import Counter
from collections.abc import Mapping

import numpy as np

from tirefit.data.vehicle.agreement import Agreement, Pair, Term, agreement
from tirefit.data.vehicle.motion import SLOWER, Motion, slowed
from tirefit.data.vehicle.track import Track
from tirefit.data.vehicle.vehicle import Vehicle

_PAIRS = (
    ("yaw", "the direction of travel", {"rate of the path's direction": "turning"}),
    ("yaw_rate", "the rate of the heading", {"dyaw/dt": "yaw_turn"}),
    ("v_x", "the speed of the positions", {"positions": "path_v_x"}),
    ("v_y", "the speed of the positions", {"positions": "path_v_y"}),
    ("a_x", "the acceleration of the positions", {"positions": "path_a_x"}),
    ("a_y", "the acceleration of the positions", {"positions": "path_a_y"}),
    ("steering", "the path's curvature", {"curvature": "path_curve"}),
    ("a_y", "", {"v_x r": "v_x yaw_rate", "dv_y/dt": "v_y_rate"}),
    ("a_x", "", {"dv_x/dt": "v_x_rate", "(-v_y r)": "-v_y yaw_rate"}),
    ("steering", "", {"L r / v_x": "curve"}),
)
"""A channel, words for its prediction (else those of its terms), and the terms: words -> the
signals of :func:`_signals` whose product it is. Terms of missing signals but the first are
left out."""

_POWERS: dict[str, dict[str, int]] = {
    "turning": {"y": 1},
    "yaw_turn": {"yaw": 1},
    "path_v_x": {"xy": 1},
    "path_v_y": {"xy": 1, "y": 1},
    "path_a_x": {"xy": 1},
    "path_a_y": {"xy": 1, "y": 1},
    "path_curve": {"xy": -1, "y": 1},
    "v_x_rate": {"v_x": 1},
    "v_y_rate": {"v_y": 1},
    "curve": {"yaw_rate": 1, "v_x": -1},
}
"""Signal -> the power of each channel in it: ``xy`` for the unit of both positions, ``y``
for the sign of y. A signal that is not listed is a channel."""

_STANDING = 0.1
"""Share of the high speeds (95th percentile) below which rows are not compared."""

SIDEWAYS = 0.6  # largest mean angle between heading and path with which cars drive [rad]

STEADY = 0.8
"""Smallest length of the mean direction of the path in the axes of the heading, 1 if it is
constant, for which the yaw is the heading: a drift by 37 deg to both sides."""

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

_UNKNOWN = 1e-3
"""Weight of unknown samples in a low-passed one above which it is not known."""


def agreements(
    track: Track, motion: Motion, vehicle: Vehicle, swapped: tuple[str, str] | None = None
) -> list[Agreement]:
    """The estimates of all pairs of the log with enough samples.

    Args:
        swapped: two channels to exchange.
    """
    of, usable = _signals(track, motion, vehicle, swapped)
    rate, apart = vehicle.filter.sample_rate, SLOWER / vehicle.filter.cutoff
    if not usable.any():
        return []
    pairs = (_pair(of, usable, *row) for row in _PAIRS)
    found = (agreement(p, motion.part, usable, rate, apart) for p in pairs if p is not None)
    return [result for result in found if result is not None]


def _pair(
    of: dict[str, np.ndarray],
    usable: np.ndarray,
    channel: str,
    words: str,
    terms: Mapping[str, str],
) -> Pair | None:
    """The pair of a row of :data:`_PAIRS`; None if a signal is missing."""
    own = "yaw_turn" if channel == "yaw" else channel
    summands = []
    for text, product in terms.items():
        names = product.removeprefix("-").split()
        if not set(names) <= set(of):
            break
        powers = Counter({channel: 1})
        for name in names:
            powers.subtract(_POWERS.get(name, {name: 1}))
        sign = -1 if product.startswith("-") else 1
        summands.append(
            Term(sign * np.prod([of[name] for name in names], axis=0), dict(powers), text)
        )
    if own not in of or not summands:
        return None
    words = words or " + ".join(term.words for term in summands)
    zero = _ZEROS.get(channel) or _SPEED_ZERO * float(np.sqrt(np.mean(of["speed"][usable] ** 2)))
    exact = channel not in ("yaw", "steering") and words != "v_x r"
    floor = _FLOORS[channel]
    return Pair(channel, words, of[own], tuple(summands), zero, floor, channel == "v_x", exact)


def _signals(
    track: Track, motion: Motion, vehicle: Vehicle, swapped: tuple[str, str] | None = None
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Channels, and signals that follow from them -> values (n,), low-passed, NaN where they are
    not known; and which samples (n,) bool can be compared: in motion, away from edges."""
    unknown = slowed(np.where(np.isfinite(motion.logged), 0.0, 1.0), motion, vehicle)
    slow = slowed(motion.logged, motion, vehicle)
    slow[np.abs(unknown) > _UNKNOWN] = np.nan
    of = {c.quantity: values for c, values in zip(track.channels, slow.T.copy(), strict=True)}
    if swapped is not None:
        one, other = swapped
        of[one], of[other] = of[other], of[one]
    last_row = np.searchsorted(track.time, motion.time, side="right") - 1
    usable = (motion.within >= SLOWER * vehicle.filter.settling) & track.active[last_row]

    def rate_of(values: np.ndarray) -> np.ndarray:
        return np.gradient(values, 1 / vehicle.filter.sample_rate)

    if not motion.settled.any():
        return of, usable & False
    if "steering" in of:
        assert vehicle.steering is not None  # the vehicle file has both or neither
        of["steering"] = np.interp(of["steering"], vehicle.steering.command, vehicle.steering.angle)
    of |= {f"{name}_rate": rate_of(of[name]) for name in ("v_x", "v_y") if name in of}
    if "yaw" in of:
        of["yaw_turn"] = rate_of(of["yaw"])
    by_rates = "v_x" in vehicle.columns.motion
    with np.errstate(divide="ignore", invalid="ignore"):
        if {"x", "y"} <= set(of):
            velocity = rate_of(of["x"]) + 1j * rate_of(of["y"])
            acceleration = rate_of(velocity)
            speed, course = np.abs(velocity), np.angle(velocity)
            turning = np.imag(np.conj(velocity) * acceleration) / speed**2
            of |= {"speed": speed, "course": course, "turning": turning}
        if by_rates:
            of["speed"] = np.hypot(of["v_x"], of["v_y"])
            of["curve"] = vehicle.wheelbase * of["yaw_rate"] / of["v_x"]
        usable &= np.isfinite(of["speed"])
        fast = _STANDING * np.percentile(of["speed"][usable], 95) if usable.any() else 0.0
        usable &= of["speed"] > fast
        if "course" in of:
            if not by_rates:
                of["path_curve"] = vehicle.wheelbase * of["turning"] / of["speed"]
            ahead = of["course"]
            askew = np.exp(1j * (ahead - of["yaw"]))[usable] if "yaw" in of else np.zeros(1)
            mean = np.mean(askew, where=np.isfinite(askew)) if np.isfinite(askew).any() else 0.0
            known = abs(mean) > STEADY and abs(np.angle(mean)) < SIDEWAYS
            turn = np.exp(-1j * (of["yaw"] if known else ahead))
            for kind, moved in (("v", velocity * turn), ("a", acceleration * turn)):
                of[f"path_{kind}_x"] = moved.real
                if known or kind == "a":  # else nothing moves across the path
                    of[f"path_{kind}_y"] = moved.imag
    return of, usable
