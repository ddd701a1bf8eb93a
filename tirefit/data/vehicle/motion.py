"""Compute the motion of the centre of gravity from a vehicle log: :func:`read_motion`.

The usable rows of the log are resampled at a uniform rate between gaps, filtered by a
zero-phase low-pass, moved to the centre of gravity and differentiated. Axes are those of
ISO 8855: x forward, y left, yaw counter-clockwise.
"""

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from tirefit.data.readers.remote import Place, file_at
from tirefit.data.vehicle.track import Track, read_track
from tirefit.data.vehicle.vehicle import POSE, RATES, Vehicle
from tirefit.results import DataError


@dataclass(frozen=True)
class Motion:
    """Motion of the centre of gravity on the grid, (n,) each, SI, ISO 8855 axes;
    ``heading``, ``x`` and ``y`` are NaN for a log of rates."""

    time: np.ndarray
    v_x: np.ndarray
    v_y: np.ndarray
    a_x: np.ndarray
    a_y: np.ndarray
    yaw_rate: np.ndarray
    yaw_acceleration: np.ndarray
    heading: np.ndarray  # [rad, not wrapped]
    x: np.ndarray  # [m] on the ground
    y: np.ndarray
    command: np.ndarray  # of the steering, 0 without one
    part: np.ndarray  # int, counts the stretches between gaps
    within: np.ndarray  # [s] to the nearer end of the stretch of the sample
    settled: np.ndarray  # bool, False near an edge or gap, where values may be NaN
    logged: np.ndarray  # (n, k) the channels of a ``Track``, through the same filter

    def rate_of(self, values: np.ndarray) -> np.ndarray:
        """Time derivative (n,) of values (n,), by central differences within each
        stretch; NaN in a stretch of a single sample."""
        rate = np.full(len(values), np.nan)
        for rows in self.stretches:
            if rows.stop - rows.start > 1:
                rate[rows] = np.gradient(values[rows], self.time[rows])
        return rate

    @property
    def stretches(self) -> list[slice]:
        """The rows of each stretch between gaps."""
        cuts = (np.flatnonzero(np.diff(self.part)) + 1).tolist()
        return [slice(a, b) for a, b in itertools.pairwise([0, *cuts, len(self.part)])]


def read_motion(path: str | Place, vehicle: Vehicle) -> tuple[Track, Motion, int]:
    """The usable samples of a log, the motion on the grid, and the number of gaps.

    Raises:
        DataError: unreadable file, missing column, text, or too low a rate.
    """
    track = read_track(file_at(path), vehicle)
    return track, *motion_of(track, vehicle)


def with_noise(
    track: Track, motion: Motion, vehicle: Vehicle, generator: np.random.Generator
) -> Motion:
    """The motion of the same track with white noise added to each channel except the
    steering, of the size of the noise that it has.

    The size is that of the part of a channel that the filter removes at settled times,
    increased by the share of white noise that passes the filter.
    """
    settled = np.interp(track.time, motion.time, motion.settled.astype(float)) == 1
    smooth = [np.interp(track.time, motion.time, values) for values in motion.logged.T]
    rest = np.nan_to_num(track.signals - np.transpose(smooth))[settled]
    frequency = np.linspace(0, 0.5 / np.median(np.diff(track.time)), 200)
    settings = vehicle.filter
    passed = 1 / (1 + (frequency / settings.cutoff) ** (2 * settings.order))
    std = np.sqrt(np.mean(rest**2, axis=0) / np.mean((1 - passed) ** 2))
    std *= [channel.quantity != "steering" for channel in track.channels]
    noise = std * generator.standard_normal(track.signals.shape)
    return motion_of(replace(track, signals=track.signals + noise), vehicle)[0]


def not_ahead(motion: Motion, vehicle: Vehicle) -> dict[str, np.ndarray]:
    """Reason -> samples (n,) bool that a single track driving forward does not describe;
    the first reason counts."""
    speed = np.hypot(motion.v_x, motion.v_y)
    return {
        f"slower than {vehicle.v_min:g} m/s": speed <= vehicle.v_min,
        "spinning or reversing": motion.v_x <= vehicle.v_min,
    }


def not_driven(track: Track, motion: Motion, vehicle: Vehicle) -> dict[str, np.ndarray]:
    """Reason of ``[keep]`` -> samples (n,) bool in which the vehicle is not driven, or near a
    glitch of the motion tracking; the first reason counts."""
    keep, last_row = vehicle.keep, np.searchsorted(track.time, motion.time, side="right") - 1
    reasons = {"not active": ~track.active[last_row]}
    if keep.a_y_max is not None:
        # The filter spreads a glitch over its settling time, which is dropped as well.
        glitches = motion.time[np.abs(motion.a_y) > keep.a_y_max]
        until = np.searchsorted(glitches, motion.time + vehicle.margin, side="right")
        name = f"near |a_y| above {keep.a_y_max:g} m/s2"
        reasons[name] = until > np.searchsorted(glitches, motion.time - vehicle.margin)
    return reasons


def slip_and_force(
    motion: Motion, vehicle: Vehicle, axle: str = "rear"
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Slip angle [rad], lateral force [N] and forward speed [m/s] of an axle, (n,)
    each, in canonical signs; formulas: :mod:`tirefit.data.vehicle.derive`.
    """
    arm, steer = -vehicle.l_r, np.zeros(len(motion.time))
    if axle != "rear":
        arm, steer = vehicle.l_f, road_wheel(motion, vehicle)
    sideways = motion.v_y + arm * motion.yaw_rate
    alpha = np.arctan2(sideways, motion.v_x) - steer
    force = -_lateral(motion, vehicle, axle) / np.cos(steer)
    if axle == "front" and vehicle.driven in ("front", "all"):
        force = force - force_along(motion, vehicle, axle) * np.tan(steer)
    return alpha, force, motion.v_x * np.cos(steer) + sideways * np.sin(steer)


def _lateral(motion: Motion, vehicle: Vehicle, axle: str) -> np.ndarray:
    """Force across the vehicle at an axle [N], to the left: (n,)."""
    arm, sign = (vehicle.l_f, -1) if axle == "rear" else (vehicle.l_r, 1)
    inertial = sign * vehicle.yaw_inertia * motion.yaw_acceleration
    return (vehicle.mass * arm * motion.a_y + inertial) / (vehicle.l_f + vehicle.l_r)


def force_along(motion: Motion, vehicle: Vehicle, axle: str) -> np.ndarray:
    """Force along the wheels of an axle [N], braking positive: (n,).

    Both axles together give m a_x, the drag, and the component of the side force of
    steered wheels: T (s + (1 - s) / cos(delta)) = m a_x + drag v^2 + Y_f tan(delta), with
    s the part of the rear axle and Y_f the force across the vehicle at the front.
    """
    rear = _part(vehicle, "rear")
    steer = road_wheel(motion, vehicle) if vehicle.steering else 0 * motion.time
    needed = vehicle.mass * motion.a_x + (vehicle.drag or 0.0) * motion.v_x**2
    needed = needed + _lateral(motion, vehicle, "front") * np.tan(steer)
    return -_part(vehicle, axle) * needed / (rear + (1 - rear) / np.cos(steer))


def _part(vehicle: Vehicle, axle: str) -> float:
    """Part of the force along the vehicle that acts on an axle."""
    rear = {"rear": 1.0, "front": 0.0}.get(vehicle.driven or "", vehicle.rear_share)
    rear = 0.5 if rear is None else rear
    return rear if axle == "rear" else 1 - rear


def road_wheel(motion: Motion, vehicle: Vehicle) -> np.ndarray:
    """Road wheel angle [rad] from the steering map, left positive: (n,)."""
    assert vehicle.steering is not None  # checked by :func:`derive`
    return np.interp(motion.command, vehicle.steering.command, vehicle.steering.angle)


def error_along(force: np.ndarray, vehicle: Vehicle, axle: str) -> np.ndarray:
    """Standard error (n,) [N] of the force along a driven axle."""
    total = force / (_part(vehicle, axle) or 1.0)
    part: float | np.ndarray = _SHARE_ASSUMED if vehicle.rear_share is None else _SHARE_STATED
    if vehicle.driven != "all":
        part = np.where(force > 0, _SHARE_BRAKING, _SHARE_STATED)
    rolling = _ROLLING[vehicle.drag is not None] * vehicle.mass * vehicle.gravity
    return np.hypot(part * total, rolling)


def low_passed(uniform: np.ndarray, vehicle: Vehicle, slower: float = 1.0) -> np.ndarray | None:
    """Filter signals (n, k) at the rate of the grid, with zero phase.

    Args:
        slower: Factor by which the cutoff is lower.

    Returns:
        None if there are too few samples.
    """
    from scipy.signal import sosfiltfilt  # slow, and no other reader needs it

    order, rate = vehicle.filter.order, vehicle.filter.sample_rate
    padding = math.ceil(slower * vehicle.filter.settling * rate)
    if len(uniform) <= 2 * padding:
        return None
    sections = _sections(order, vehicle.filter.cutoff / slower, rate)
    return sosfiltfilt(sections, uniform, axis=0, padlen=padding)


SLOWER = 5.0
"""Factor by which signals that are compared with each other are slower than the filter's
cutoff: noise of a point differentiated twice would hide a relation of faster ones."""


def slowed(
    signals: np.ndarray, motion: "Motion", vehicle: Vehicle, slower: float = SLOWER
) -> np.ndarray:
    """Signals (n, k) low-passed at the cutoff over ``slower`` in each stretch, with zero
    where they are not known; NaN in a stretch that is too short."""
    slow = np.full_like(signals, np.nan)
    for rows in motion.stretches:
        known = np.where(np.isfinite(signals[rows]), signals[rows], 0.0)
        smooth = low_passed(known, vehicle, slower)
        if smooth is not None:
            slow[rows] = smooth
    return slow


@cache
def _sections(order: int, cutoff: float, rate: float) -> np.ndarray:
    """The filter, stored because its design takes longer than its use on a short stretch."""
    from scipy.signal import butter

    return butter(order, cutoff, fs=rate, output="sos")


_SHARE_STATED, _SHARE_ASSUMED, _SHARE_BRAKING = 0.05, 0.15, 0.3
"""Standard errors of the part of an axle in the force along the vehicle: with stated
driven axles and shares; with an assumed even split; and of braking if one axle is
driven, as cars brake with both."""

_ROLLING = (0.02, 0.005)
"""Error of drag and rolling resistance over the weight, without and with stated drag."""

_MOST_SAMPLES = 3_000_000  # samples on the grid of one log: 8 h at 100 Hz

_LOST = 3.5  # largest gap in a channel that has blanks between its samples, in its periods

_Rates = tuple[np.ndarray, ...]
"""v_x, v_y, a_x, a_y, r, r', heading, x, y of the centre of gravity, (n,) each."""


def motion_of(track: Track, vehicle: Vehicle) -> tuple[Motion, int]:
    """The motion on a uniform grid without the gaps, and the number of gaps."""
    rate, margin = vehicle.filter.sample_rate, vehicle.margin
    broken = (np.diff(track.time) > track.max_gap) | (np.diff(track.run) != 0)
    splits = np.flatnonzero(broken) + 1
    steps = np.diff(track.time)
    steps[splits - 1] = 0.0
    count = float(steps.sum()) * rate
    if count > _MOST_SAMPLES:  # the grid would not fit in memory
        raise DataError(
            f"at {rate:g} Hz the log has {count:.2g} samples, more than {_MOST_SAMPLES:,}",
            "lower filter.sample_rate, split the log, or check the unit of time",
        )
    convert = _from_pose if vehicle.columns.motion == POSE else _from_rates
    names = [channel.quantity for channel in track.channels]
    parts = []
    for number, rows in enumerate(np.split(np.arange(len(track.time)), splits)):
        time = track.time[rows]
        first, last = math.ceil(time[0] * rate), math.floor(time[-1] * rate)
        grid = np.arange(first, last + 1) / rate
        signals = _on_grid(time, track.signals[rows], grid, track.max_gap, vehicle)
        part = np.full(len(grid), number)
        within = np.minimum(grid - time[0], time[-1] - grid)
        inside = (grid >= time[0] + margin) & (grid <= time[-1] - margin)
        if signals is None:
            nan, never = np.full(len(grid), np.nan), np.zeros(len(grid), bool)
            logged = np.full((len(grid), len(names)), np.nan)
            parts.append((grid, *[nan] * 10, part, within, never, logged))
            continue
        of = dict(zip(names, signals.T, strict=True))
        command = of.get("steering", np.zeros(len(grid)))
        if vehicle.steering is not None:
            late = grid - vehicle.steering.delay
            command = np.interp(late, grid, command, left=np.nan, right=np.nan)
        rates = convert(of, vehicle)
        parts.append((grid, *rates, command, part, within, inside, signals))
    return Motion(*map(np.concatenate, zip(*parts, strict=True))), len(splits)


def _on_grid(
    time: np.ndarray, signals: np.ndarray, grid: np.ndarray, max_gap: float, vehicle: Vehicle
) -> np.ndarray | None:
    """Signals (n, k) on the grid, low-passed, NaN in long gaps; None if too short."""
    from scipy.interpolate import CubicSpline  # slow, and no other reader needs it

    # Cubic interpolation, as a straight line would cut the corners of a turn.
    there = np.isfinite(signals)
    whole = there.all(axis=0)
    uniform = np.zeros((len(grid), signals.shape[1]))
    in_gap = np.zeros(uniform.shape, bool)
    if len(time) > 1:
        uniform[:, whole] = CubicSpline(time, signals[:, whole])(grid)
    for k in np.flatnonzero(~whole):
        known = time[there[:, k]]
        if len(known) < 2:
            in_gap[:, k] = True
            continue
        uniform[:, k] = np.interp(grid, known, signals[there[:, k], k])
        after = np.clip(np.searchsorted(known, grid), 1, len(known) - 1)
        longest = max(max_gap, _LOST * float(np.median(np.diff(known))))
        in_gap[:, k] = (known[after] - known[after - 1] > longest) | (grid > known[-1])
    smooth = low_passed(uniform, vehicle)
    return smooth if smooth is None else np.where(in_gap, np.nan, smooth)


def _from_pose(of: Mapping[str, np.ndarray], vehicle: Vehicle) -> _Rates:
    """:data:`_Rates` from x, y, yaw."""
    rate = vehicle.filter.sample_rate
    x, y, yaw = (of[name] for name in POSE)
    cos, sin = np.cos(yaw), np.sin(yaw)
    ahead, left = vehicle.cg_from_tracked
    position = np.array([x + ahead * cos - left * sin, y + ahead * sin + left * cos])
    velocity = np.gradient(position, 1 / rate, axis=1)
    acceleration = np.gradient(velocity, 1 / rate, axis=1)
    yaw_rate = np.gradient(yaw, 1 / rate)

    def body(world: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return cos * world[0] + sin * world[1], cos * world[1] - sin * world[0]

    turning = yaw_rate, np.gradient(yaw_rate, 1 / rate)
    return (*body(velocity), *body(acceleration), *turning, yaw, *position)


def _from_rates(of: Mapping[str, np.ndarray], vehicle: Vehicle) -> _Rates:
    """As :func:`_from_pose`, from v_x, v_y, yaw rate at the point, any a_y and a_x."""
    rate = vehicle.filter.sample_rate
    v_x, v_y, yaw_rate = (of[name] for name in RATES)
    cos, sin = np.cos(vehicle.sideslip_offset), np.sin(vehicle.sideslip_offset)
    v_x, v_y = cos * v_x - sin * v_y, cos * v_y + sin * v_x
    yaw_acceleration = np.gradient(yaw_rate, 1 / rate)
    ahead, left = vehicle.cg_from_tracked
    v_x, v_y = v_x - yaw_rate * left, v_y + yaw_rate * ahead
    a_x = np.gradient(v_x, 1 / rate) - yaw_rate * v_y
    if "a_x" in vehicle.columns.motion:
        a_x = of["a_x"] - yaw_acceleration * left - yaw_rate**2 * ahead
    a_y = np.gradient(v_y, 1 / rate) + yaw_rate * v_x
    if not vehicle.columns.a_y_follows:
        a_y = of["a_y"] + yaw_acceleration * ahead - yaw_rate**2 * left
    return (v_x, v_y, a_x, a_y, yaw_rate, yaw_acceleration, *[np.full(len(v_x), np.nan)] * 3)
