"""Estimate the tracked point of a log from the rear axle's force against its slip; warn of parts
of a log that a tire hardly caused: :func:`check_point`, :func:`doubts`.

A point x further ahead lowers the slip angle by :math:`x r / v_x` and the lateral
acceleration by :math:`x \\dot r`. At moderate slip
:math:`\\alpha = c_1 F + c_3 F^3 + \\alpha_0` holds. The Gauss-Newton method fits x,
c_1, c_3 and, if the log turns both ways, :math:`\\alpha_0`. As in
:mod:`tirefit.data.vehicle.pairs`, values before and after a row are its instruments, and
standard errors use the effective number of rows. The signals of a pose are low-passed further,
as noise that is differentiated twice may hide the force (:data:`_PER_WHEELBASE`). A wrong
yaw inertia, a delay and another place of the accelerometer act alike: the message names them.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tirefit.data.vehicle.findings import point_words
from tirefit.data.vehicle.motion import Motion, slip_and_force, slowed
from tirefit.data.vehicle.pairs import (
    ALIKE,
    AROUND,
    CHANGED,
    EACH,
    FEWEST,
    SURE,
    Fit,
    around,
    instrumented,
    surrounded,
)
from tirefit.data.vehicle.vehicle import POSE, Vehicle
from tirefit.results import InputProblem


def zero_of_alpha(
    vehicle: Vehicle, axle: str, alpha: np.ndarray, fy: np.ndarray
) -> tuple[str, float | None]:
    """A sentence on the offset of the slip angle, and alpha at zero side force [rad],
    None if it is not known.

    A symmetric axle has no side force at zero slip angle. Alpha where fy = 0 is therefore
    the error of the yaw that was used, at the front plus that of the steering.
    """
    pose = vehicle.columns.motion == POSE
    what, logged, key, turns = "sideslip", "sideslip", "sideslip_offset", "raises"
    if pose:
        what, logged, key, turns = "heading", "yaw", "yaw_offset", "lowers"
    given = getattr(vehicle, key)
    added = f"{given:g} rad were added to the logged {logged}" if given else "none assumed"
    message = f"{what} offset: {added}; a {key} that is added {turns} alpha by as much"
    strong = np.percentile(abs(fy), 95)
    weak = abs(fy) < _MODERATE * strong
    share = fy[weak] / strong
    if axle != "rear" or not turns_both_ways(share):
        return message, None
    terms = np.column_stack([np.ones(len(share)), share, share**3])
    left = float(np.linalg.lstsq(terms, alpha[weak])[0][0])
    takes_out = given + left if pose else given - left
    return (
        f"{message}; estimated from these data: alpha is {left:+.4f} rad where fy = 0;"
        f" for a symmetric tire, {key} = {takes_out:.4f} corrects it"
    ), left


def turns_both_ways(share: np.ndarray) -> bool:
    """Whether more than a tenth of the samples are turns to the rarer side.

    Args:
        share: (n,) lateral force over the strong force.
    """
    rarer = min(np.count_nonzero(share > 0.05), np.count_nonzero(share < -0.05))
    return bool(rarer > 0.1 * len(share))


_MODERATE = 0.5
"""Largest force in the fit over the strong force (95th percentile), where the cubic is valid."""

_ZERO = 0.02
"""Zero error [rad] of heading or mounting that is assumed if a log turns to one side
only: 1 deg, twice the errors found in measured logs."""

_ON_CAR = (-0.5, 1.5)  # positions on a car [wheelbases ahead of the rear axle]

_MOST_ROWS, _ROUNDS = 20_000, 8

_PER_WHEELBASE = 0.3
"""Highest frequency of the signals of a pose [cycles per wheelbase travelled]: the motion of a car
is slower, and above it noise that is differentiated twice hides the force. With 0.5, noise of 2 cm
hides that of a full-size car; with 0.15, a log of a 1:10 car has too few independent rows."""


class PointCheck(NamedTuple):
    """The estimate of the tracked point."""

    line: str  # sentence for the summary
    estimate: tuple[float, float] | None  # [m ahead of the rear axle], standard error
    problems: tuple[InputProblem, ...] = ()
    warnings: tuple[str, ...] = ()


class _Point(NamedTuple):
    """A point on the car at which a stable tire explains the force."""

    at: float  # [m] ahead of the rear axle
    ahead: float  # of the stated point [m]
    std: float  # its standard error
    effect: float  # of the distance on the slip angle (rms over rms)
    misfit: float  # rms of the slip angle that is not explained [rad]

    @property
    def is_off(self) -> bool:
        """Whether the stated point is wrong by more than the error, with an effect."""
        return abs(self.ahead) > SURE * self.std and self.effect > CHANGED


def check_point(motion: Motion, vehicle: Vehicle, kept: np.ndarray, file: str) -> PointCheck:
    """Estimate the tracked point; refuse a force in the direction of the axle's slip.

    Args:
        kept: (n,) bool, the samples that will be written.
    """
    point, slope = _point(motion, vehicle, kept)
    line, estimate = "this log does not determine it", None
    if point:
        line, estimate = point_words(point.ahead, point.std), (point.at, point.std)
    check = PointCheck(f"tracked point: {line}", estimate)
    against, is_off = slope <= -SURE, point is None or point.is_off
    if is_off and _fits_mirrored(motion, vehicle, kept, point, against):
        other = "yaw_rate" if vehicle.columns.a_y_follows else "a_y"
        unit = f"-{vehicle.units.get('v_y', 'm/s')}".removeprefix("--")
        words = f"v_y or {other} has the wrong sign"
        remedy = f'set v_y = "{unit}" in [units] of vehicle.toml'
    elif point and is_off:
        stated, left = point.at - point.ahead, (vehicle.tracked_point or (0.0, 0.0))[1]
        words = f"the tracked point is {point.at:.3g} ± {point.std:.1g} m ahead of the rear axle,"
        words += f" not {stated:.3g} m"
        remedy = f"set tracked_point = [{point.at:.3g}, {left:g}] in vehicle.toml"
        if not vehicle.tracked_point:
            words += " (the centre of gravity, which is assumed, as tracked_point is not stated)"
            remedy += " (or correct l_r)"
        sensor = "the place of the a_y sensor, " if "a_y" in vehicle.columns.motion else ""
        remedy += ", unless one of these is wrong, which acts alike: the time of a channel,"
        remedy += f" {sensor}yaw_inertia ({vehicle.inertia_ratio:.2g} mass l_f l_r)"
    elif against:
        words = "no point on the car explains it"
        remedy = "check tracked_point, the signs of the channels and yaw_inertia, which is"
        remedy += f" {vehicle.inertia_ratio:.2g} mass l_f l_r (about 1 of cars)"
    else:
        return check
    if not against:
        return check._replace(warnings=(f"lateral force against slip angle: {words}; {remedy}",))
    reason = "channels contradict each other: the lateral force acts in the direction"
    reason += f" of the axle's slip ({-slope:.0f} standard errors): {words}"
    return check._replace(problems=(InputProblem(reason, remedy, file),))


def _fits_mirrored(
    motion: Motion, vehicle: Vehicle, kept: np.ndarray, point: _Point | None, against: bool
) -> bool:
    """Whether the stated point fits the other sign of v_y of the tracked point (and of the a_y
    that follows from it where none is logged) better than ``point`` fits the logged one. If
    neither sign determines a point, whether the force is in the direction of the slip only as
    stated, which ``against`` tells."""
    if vehicle.columns.motion == POSE:
        return False
    v_y = 2 * vehicle.cg_from_tracked[0] * motion.yaw_rate - motion.v_y
    a_y = motion.a_y
    if vehicle.columns.a_y_follows:
        a_y = a_y + motion.rate_of(v_y - motion.v_y)
    other, slope = _point(replace(motion, v_y=v_y, a_y=a_y), vehicle, kept)
    if other is None:
        return point is None and against and slope > -SURE
    return not other.is_off and (point is None or other.misfit < point.misfit)


# --- fit ------------------------------------------------------------------------


class _Lines(NamedTuple):
    """Tangent of the slip angle and force [N], which are lines over the position x [m ahead of
    the stated point] of the tracked point: (n,) each."""

    slip: np.ndarray
    force: np.ndarray
    slip_x: np.ndarray  # change over x
    force_x: np.ndarray
    every: np.ndarray  # the rows to use
    step: int  # distance of the instruments [rows]

    def moderate(self, x: float) -> tuple[np.ndarray, float, float]:
        """The rows of moderate force at a point, or all if they are too few; the strong force
        [N]; and the prior standard deviation of alpha_0: infinite if it is fitted, else 0."""
        force = (self.force + x * self.force_x)[self.every]
        strong = max(float(np.percentile(abs(force), 95)), 1e-300)
        weak = abs(force) <= _MODERATE * strong
        weak |= weak.sum() < FEWEST
        both = turns_both_ways(force[weak] / strong)
        return self.every[weak], strong, math.inf if both else 0.0

    def at(self, x: float, strong: float) -> tuple[np.ndarray, np.ndarray]:
        """Slip angle (n,) at a point, and force over the strong force and its cube (n, 2)."""
        share = (self.force + x * self.force_x) / strong
        return np.arctan(self.slip + x * self.slip_x), np.column_stack([share, share**3])

    def solved(self, alpha: np.ndarray, sides: np.ndarray, rows: np.ndarray, zero: float) -> Fit:
        """The fit of alpha by the sides (n, k), with standard errors that include a zero error
        that is not fitted."""
        near = around(sides, rows, self.step)
        fit = instrumented(alpha[rows], sides[rows], near, lambda _: zero)
        if zero:
            return fit
        other = instrumented(alpha[rows] + _ZERO, sides[rows], near, lambda _: zero)
        return fit._replace(std=np.hypot(fit.std, other.theta - fit.theta))


def _lines(motion: Motion, vehicle: Vehicle, kept: np.ndarray) -> _Lines | None:
    """The lines of the filtered signals; None if too few rows are known."""
    if not kept.any():
        return None
    alpha, force, _ = slip_and_force(motion, vehicle)
    # A point further ahead has v_y - x r and a_y - x dr/dt.
    with np.errstate(divide="ignore", invalid="ignore"):
        slip_x = -motion.yaw_rate / motion.v_x
    force_x = vehicle.mass * vehicle.l_f / (vehicle.l_f + vehicle.l_r) * motion.yaw_acceleration
    signals = np.stack([np.tan(alpha), force, slip_x, force_x], axis=1)
    # Values of other rows, as at standstill, are arbitrary.
    signals = np.clip(signals, np.nanmin(signals[kept], axis=0), np.nanmax(signals[kept], axis=0))
    slower = 1.0
    if vehicle.columns.motion == POSE:
        highest = _PER_WHEELBASE * float(np.median(motion.v_x[kept])) / vehicle.wheelbase
        slower = max(1.0, vehicle.filter.cutoff / highest)
        signals = slowed(signals, motion, vehicle, slower)
        kept = kept & (motion.within >= slower * vehicle.filter.settling)
    step = max(1, round(slower * vehicle.filter.sample_rate / vehicle.filter.cutoff))
    known = np.isfinite(signals).all(axis=1)
    every = surrounded(motion.part, kept & known, known, 2 * step + 1)
    every = every[:: max(1, step // EACH, len(every) // _MOST_ROWS)]
    if len(every) < FEWEST:
        return None
    slip, force, slip_x, force_x = np.nan_to_num(signals.T)
    return _Lines(slip, force, slip_x, force_x, every, step)


def _point(motion: Motion, vehicle: Vehicle, kept: np.ndarray) -> tuple[_Point | None, float]:
    """Fit of the tracked point, which starts at the best point of a grid, None if it is not
    determined; and the slope of the slip angle over the force at the stated point."""
    lines = _lines(motion, vehicle, kept)
    if lines is None:
        return None, 0.0
    stated = vehicle.l_r - vehicle.cg_from_tracked[0]
    slope, start, smallest = _slope(lines), 0.0, math.inf
    for share in np.arange(_ON_CAR[0], _ON_CAR[1] + 0.01, 0.1):
        x = float(share) * vehicle.wheelbase - stated
        rows, strong, zero = lines.moderate(x)
        alpha, sides = (values[rows] for values in lines.at(x, strong))
        sides = np.hstack([sides, np.ones((len(rows), int(zero == math.inf)))])
        theta = np.linalg.lstsq(sides, alpha)[0]
        variance = float(np.var(alpha - sides @ theta))
        if theta[0] > 0 and variance < smallest:
            start, smallest = x, variance
    rows, strong, zero = lines.moderate(start)
    x, fit = start, None
    try:
        for _ in range(_ROUNDS):
            alpha, sides = lines.at(x, strong)
            theta = lines.solved(alpha, sides, rows, zero).theta
            bend = (theta[0] + 3 * theta[1] * sides[:, 0] ** 2) * lines.force_x / strong
            turn = lines.slip_x * np.cos(alpha) ** 2
            sides = np.column_stack([sides, turn - bend])
            fit = lines.solved(alpha, sides, rows, zero)
            x -= float(fit.theta[2])
            if abs(fit.theta[2]) < 0.05 * fit.std[2]:
                break
    except np.linalg.LinAlgError:
        return None, slope
    assert fit is not None  # the loop has at least one round
    size = max(float(np.mean(alpha[rows] ** 2)), 1e-300)
    effect = abs(x) * math.sqrt(np.mean(sides[rows, 2] ** 2) / size)
    # With instruments, the bias of least squares over their F statistic remains: Bound,
    # Jaeger, Baker, JASA 1995, eq. 7. F itself is known to 0.1 at best.
    share, count = fit.seen[2], sides.shape[1] * len(AROUND)
    strength = share / max(1 - share, 1e-9) * fit.effective / count
    bias = 0.01 * vehicle.wheelbase  # by the cube of a filtered force, in simulated drives
    std = math.hypot(fit.std[2], abs(x - start) / max(strength - 1, 0.1), bias)
    on_car = _ON_CAR[0] < (stated + x) / vehicle.wheelbase < _ON_CAR[1]
    stable = float(np.mean(sides[rows, 0] * (sides[rows, :2] @ fit.theta[:2]))) > 0
    # Largest standard error [wheelbases] of an estimate that is reported: a quarter of the distance
    # from the centre of gravity to an axle, about.
    if not (on_car and stable and std < 0.15 * vehicle.wheelbase):
        return None, slope
    return _Point(stated + x, x, std, effect, math.sqrt(np.mean(fit.error**2))), slope


def _slope(lines: _Lines) -> float:
    """Slope of the slip angle over the force at the stated point, in its standard errors, with any
    zero error."""
    rows, strong, _ = lines.moderate(0.0)
    alpha, sides = lines.at(0.0, strong)
    share = sides[rows, :1]
    if np.std(share) < 0.05:  # one operating point, at which the slope is undefined
        return 0.0
    try:
        fit = lines.solved(alpha, sides[:, :1], rows, math.inf)
    except np.linalg.LinAlgError:
        return 0.0
    enough = fit.effective * np.mean(share**2) ** 2 / np.mean(share**4) >= SURE**2
    return float(fit.theta[0] / max(fit.std[0], 1e-300)) if enough else 0.0


# --- parts that a tire hardly caused ----------------------------------------------

_CUT, _MUCH_CUT = 0.7, 0.05
"""Share of the bandwidth above which the filter attenuates, and the smallest share of a
column's variance there that causes a warning."""

_GRIP = 1.5  # largest |F_y| / F_z of racing tires on dry asphalt, without downforce
_DRY = 1.0  # largest |F_y| / F_z of road tires on dry asphalt


def doubts(
    columns: Mapping[str, np.ndarray], motion: Motion, kept: np.ndarray, vehicle: Vehicle
) -> Iterator[str]:
    """Warnings on content that a tire model should not be fitted to: forces larger than tires
    transmit without downforce or mostly due to yaw inertia (at the limit, F_y / F_z is about
    |a_y| / g), samples next to an edge, and much variance just below the bandwidth, and so above.

    Args:
        columns: :attr:`tirefit.data.vehicle.derive.DerivedLog.columns` of every grid sample.
        kept: (n,) bool, the samples that will be written.
    """

    def high(values: np.ndarray) -> float:
        return float(np.percentile(np.abs(values[kept]), 99))

    share = high(columns["fy"] / columns["fz"])
    level = high(columns["a_y"]) / vehicle.gravity
    by_inertia = share > max(_DRY, ALIKE * level)
    if share >= _GRIP or by_inertia:
        message = f"|fy| reaches {share:.2g} fz (99th percentile), more than a tire's friction"
        if by_inertia:
            moment = vehicle.yaw_inertia * columns["yaw_acceleration"] / vehicle.wheelbase
            message += (
                f", while |a_y| reaches {level:.2g} g: yaw_inertia dr/dt / wheelbase alone"
                f" is {high(moment / columns['fz']):.2g} fz, and yaw_inertia"
                f" {vehicle.inertia_ratio:.2g} mass l_f l_r (about 1 of cars)"
            )
        yield f"{message}: check mass, yaw_inertia and the unit of a_y or of the positions"
    reach = vehicle.filter.settling
    if inside := np.count_nonzero(kept & (motion.within < reach * (1 - 1e-9))):
        yield (
            f"{inside} samples are within {reach:.2g} s of an edge or a gap, where the"
            " filter has not settled: raise keep.margin, or omit it"
        )
    band = vehicle.filter.bandwidth
    signals = np.stack([columns["alpha"], columns["fy"]], axis=1)
    slow = slowed(signals, motion, vehicle, vehicle.filter.cutoff / (_CUT * band))
    there = kept & np.isfinite(slow).all(axis=1)
    if not there.any():
        return
    cut = np.mean((signals - slow)[there] ** 2, axis=0)
    shares = cut / np.maximum(np.var(signals[there], axis=0), 1e-300)  # 0 if it never changes
    for name, share in zip(("alpha", "fy"), shares, strict=True):
        if share > _MUCH_CUT:
            yield (
                f"{100 * share:.0f} % of the variance of {name} lies above"
                f" {_CUT * band:.2g} Hz, where the filter ({band:.3g} Hz) cuts: raise"
                " filter.cutoff, unless that is noise"
            )
