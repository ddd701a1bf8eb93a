"""Estimate the tracked point of a log from the rear axle's force against its slip; warn of forces
beyond friction: :func:`check_point`, :func:`doubts`.

A point x further ahead lowers the slip angle by :math:`x r / v_x` and the lateral
acceleration by :math:`x \\dot r`. At moderate slip
:math:`\\alpha = c_1 F + c_3 F^3 + \\alpha_0` holds. The Gauss-Newton method fits x,
c_1, c_3 and, if the log turns both ways, :math:`\\alpha_0`, from the x of least squares. As in
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


def zero_of_alpha(
    vehicle: Vehicle, axle: str, alpha: np.ndarray, fy: np.ndarray
) -> tuple[str, float | None]:
    """A sentence on the offset of the slip angle, and alpha at zero side force [rad],
    None if it is not known.

    A symmetric axle has no side force at zero slip angle. Alpha where fy = 0 is therefore
    the error of the yaw that was used, at the front plus that of the steering.
    """
    what, logged, key, turns, sign = "sideslip", "sideslip", "sideslip_offset", "raises", -1
    if vehicle.columns.motion == POSE:
        what, logged, key, turns, sign = "heading", "yaw", "yaw_offset", "lowers", 1
    given = getattr(vehicle, key)
    added = f"{given:g} rad were added to the logged {logged}" if given else "none assumed"
    message = f"{what} offset: {added}; a {key} that is added {turns} alpha by as much"
    strong = np.percentile(abs(fy), 95)
    weak = abs(fy) < _MODERATE * strong
    share = fy[weak] / strong
    if axle != "rear" or not _turns_both_ways(share):
        return message, None
    terms = np.column_stack([np.ones(len(share)), share, share**3])
    left = float(np.linalg.lstsq(terms, alpha[weak])[0][0])
    return (
        f"{message}; estimated from these data: alpha is {left:+.4f} rad where fy = 0;"
        f" for a symmetric tire, {key} = {given + sign * left:.4f} corrects it"
    ), left


def _turns_both_ways(share: np.ndarray) -> bool:
    """Whether more than a tenth of the samples, of (n,) force over the strong force, are turns to
    the rarer side."""
    return bool(min(np.sum(share > 0.05), np.sum(share < -0.05)) > 0.1 * len(share))


class PointCheck(NamedTuple):
    """The estimate of the tracked point."""

    line: str  # sentence for the summary
    estimate: tuple[float, float] | None  # [m ahead of the rear axle], standard error
    problems: tuple[InputProblem, ...] = ()
    warnings: tuple[str, ...] = ()


class _Point(NamedTuple):
    """The point, fitted."""

    ahead: float = 0.0  # of the stated point [m]
    std: float = math.inf  # its standard error
    effect: float = 0.0  # of the distance on the slip angle (rms over rms)
    misfit: float = 0.0  # rms of the slip angle that is not explained [rad]
    known: bool = False  # whether a stable tire at this point on the car explains the force
    slope: float = 0.0  # slip angle over force at the stated point, in its standard errors

    @property
    def is_off(self) -> bool:
        """Whether the stated point is wrong by more than the error, with an effect."""
        return self.known and abs(self.ahead) > SURE * self.std and self.effect > CHANGED


def check_point(motion: Motion, vehicle: Vehicle, kept: np.ndarray, file: str) -> PointCheck:
    """Estimate the tracked point; refuse a force in the direction of the axle's slip.

    Args:
        kept: (n,) bool, the samples that will be written.
    """
    point, stated = _point(motion, vehicle, kept), vehicle.l_r - vehicle.cg_from_tracked[0]
    check = PointCheck("tracked point: this log does not determine it", None)
    at = stated + point.ahead
    if point.known:
        line = f"tracked point: {point_words(point.ahead, point.std)}"
        check = PointCheck(line, (at, point.std))
    if (point.is_off or not point.known) and _fits_mirrored(motion, vehicle, kept, point):
        other = "yaw_rate" if vehicle.columns.a_y_follows else "a_y"
        unit = f"-{vehicle.units.get('v_y', 'm/s')}".removeprefix("--")
        words = f"v_y or {other} has the wrong sign"
        remedy = f'set v_y = "{unit}" in [units] of vehicle.toml'
    elif point.is_off:
        words = f"the tracked point is {at:.3g} ± {point.std:.1g} m ahead of the rear axle,"
        words += f" not {stated:.3g} m"
        remedy = f"set tracked_point = [{at:.3g}, {(vehicle.tracked_point or (0, 0))[1]:g}]"
        remedy += " in vehicle.toml"
        if not vehicle.tracked_point:
            words += " (the centre of gravity, which is assumed, as tracked_point is not stated)"
            remedy += " (or correct l_r)"
        sensor = "the place of the a_y sensor, " if "a_y" in vehicle.columns.motion else ""
        remedy += ", unless one of these is wrong, which acts alike: the time of a channel,"
        remedy += f" {sensor}yaw_inertia ({vehicle.inertia_ratio:.2g} mass l_f l_r)"
    elif point.slope <= -SURE:
        words = "no point on the car explains it"
        remedy = "check tracked_point, the signs of the channels and yaw_inertia, which is"
        remedy += f" {vehicle.inertia_ratio:.2g} mass l_f l_r (about 1 of cars)"
    else:
        return check
    if point.slope > -SURE:
        return check._replace(warnings=(f"lateral force against slip angle: {words}; {remedy}",))
    reason = "channels contradict each other: the lateral force acts in the direction"
    reason += f" of the axle's slip ({-point.slope:.0f} standard errors): {words}"
    return check._replace(problems=(InputProblem(reason, remedy, file),))


def _fits_mirrored(motion: Motion, vehicle: Vehicle, kept: np.ndarray, point: _Point) -> bool:
    """Whether the stated point fits the other sign of v_y of the tracked point (and of the a_y
    that follows from it where none is logged) better than ``point`` fits the logged one. If
    neither sign determines a point, whether the force is in the direction of the slip only as
    stated."""
    if vehicle.columns.motion == POSE:
        return False
    v_y = 2 * vehicle.cg_from_tracked[0] * motion.yaw_rate - motion.v_y
    turned = motion.rate_of(v_y - motion.v_y) if vehicle.columns.a_y_follows else 0.0
    other = _point(replace(motion, v_y=v_y, a_y=motion.a_y + turned), vehicle, kept)
    if not other.known:
        return not point.known and point.slope <= -SURE < other.slope
    return not other.is_off and (not point.known or other.misfit < point.misfit)


# --- fit ------------------------------------------------------------------------


class _Signals(NamedTuple):
    """Signals (n,) of the rear axle: tangent of the slip angle and force [N] at the stated point,
    and their changes over the distance x [m] to a point further ahead."""

    slip: np.ndarray
    force: np.ndarray
    slip_x: np.ndarray
    force_x: np.ndarray
    rows: np.ndarray  # those that are used
    step: int  # distance of the instruments [rows]

    def moderate(self, x: float) -> tuple[np.ndarray, float, bool]:
        """Rows of moderate force at a point, all if they are too few; the strong force [N]; and
        whether they turn both ways, so that alpha_0 is fitted."""
        force = (self.force + x * self.force_x)[self.rows]
        strong = max(float(np.percentile(abs(force), 95)), 1e-300)
        weak = abs(force) <= _MODERATE * strong
        weak |= weak.sum() < FEWEST
        return self.rows[weak], strong, _turns_both_ways(force[weak] / strong)

    def at(self, x: float, strong: float) -> tuple[np.ndarray, np.ndarray]:
        """Slip angle (n,) at a point, and force over the strong force and its cube (n, 2)."""
        share = (self.force + x * self.force_x) / strong
        return np.arctan(self.slip + x * self.slip_x), np.column_stack([share, share**3])

    def misfit(self, x: float) -> float:
        """Variance of the slip angle that least squares leave; all of it if no stable tire fits."""
        rows, strong, both = self.moderate(x)
        alpha, sides = (values[rows] for values in self.at(x, strong))
        sides = np.hstack([sides, np.ones((len(rows), int(both)))])
        theta = np.linalg.lstsq(sides, alpha)[0]
        return float(np.var(alpha - sides @ theta if theta[0] > 0 else alpha))

    def fit(self, alpha: np.ndarray, sides: np.ndarray, rows: np.ndarray, both: bool) -> Fit:
        """Fit alpha by the sides (n, k); a zero error that is not fitted widens the errors."""
        near = around(sides, rows, self.step)
        zero = math.inf if both else 0.0
        fit = instrumented(alpha[rows], sides[rows], near, lambda _: zero)
        moved = fit if both else instrumented(alpha[rows] + _ZERO, sides[rows], near, lambda _: 0)
        if fit is None or moved is None:
            raise np.linalg.LinAlgError
        return fit._replace(std=np.hypot(fit.std, moved.theta - fit.theta))


def _signals(motion: Motion, vehicle: Vehicle, kept: np.ndarray) -> _Signals | None:
    """The filtered signals; None if too few rows are known."""
    if not kept.any():
        return None
    alpha, force, _ = slip_and_force(motion, vehicle)
    force_x = vehicle.mass * vehicle.l_f / vehicle.wheelbase * motion.yaw_acceleration
    with np.errstate(divide="ignore", invalid="ignore"):
        signals = np.stack([np.tan(alpha), force, -motion.yaw_rate / motion.v_x, force_x], axis=1)
    # Values of other rows, as at standstill, are arbitrary.
    signals = np.clip(signals, np.nanmin(signals[kept], axis=0), np.nanmax(signals[kept], axis=0))
    slower = 1.0
    if vehicle.columns.motion == POSE:
        highest = _PER_WHEELBASE * float(np.median(motion.v_x[kept])) / vehicle.wheelbase
        slower = max(1.0, vehicle.filter.cutoff / highest)
        signals = slowed(signals, motion, vehicle, slower)
        kept = kept & (motion.within >= slower * vehicle.filter.settling)
    step = max(1, round(slower * vehicle.filter.sample_rate / vehicle.filter.cutoff))
    known, within = np.isfinite(signals).all(axis=1), motion.within * vehicle.filter.sample_rate
    rows = surrounded(within, kept & known, known, 2 * step + 1)
    rows = rows[:: max(1, step // EACH, len(rows) // _MOST_ROWS)]
    return _Signals(*np.nan_to_num(signals.T), rows, step) if len(rows) >= FEWEST else None


def _point(motion: Motion, vehicle: Vehicle, kept: np.ndarray) -> _Point:
    """Fit of the tracked point."""
    from scipy.optimize import minimize_scalar  # slow, and no other reader needs it

    signals = _signals(motion, vehicle, kept)
    if signals is None:
        return _Point()
    stated, slope = vehicle.l_r - vehicle.cg_from_tracked[0], 0.0
    bounds = [share * vehicle.wheelbase - stated for share in _ON_CAR]
    x = start = float(minimize_scalar(signals.misfit, bounds=bounds, method="bounded").x)
    try:
        slope = _slope(signals)
        rows, strong, both = signals.moderate(start)
        for _ in range(_ROUNDS):
            alpha, sides = signals.at(x, strong)
            theta = signals.fit(alpha, sides, rows, both).theta
            bend = (theta[0] + 3 * theta[1] * sides[:, 0] ** 2) * signals.force_x / strong
            sides = np.column_stack([sides, signals.slip_x * np.cos(alpha) ** 2 - bend])
            fit = signals.fit(alpha, sides, rows, both)
            x -= float(fit.theta[2])
            if abs(fit.theta[2]) < 0.05 * fit.std[2]:
                break
    except np.linalg.LinAlgError:
        return _Point(slope=slope)
    size = max(float(np.mean(alpha[rows] ** 2)), 1e-300)
    effect = abs(x) * math.sqrt(np.mean(sides[rows, 2] ** 2) / size)
    # With instruments, the bias of least squares over their F statistic remains: Bound,
    # Jaeger, Baker, JASA 1995, eq. 7. F itself is known to 0.5 at best.
    strength = fit.seen[2] / max(1 - fit.seen[2], 1e-9) * fit.effective / (3 * len(AROUND))
    bias = 0.01 * vehicle.wheelbase  # by the cube of a filtered force, in simulated drives
    std = math.hypot(fit.std[2], abs(x - start) / max(strength - 1, 0.5), bias)
    stable = float(np.mean(sides[rows, 0] * (sides[rows, :2] @ fit.theta[:2]))) > 0
    # Largest standard error [wheelbases] of an estimate that is reported: a quarter of the distance
    # from the centre of gravity to an axle, about.
    known = bounds[0] < x < bounds[1] and stable and std < 0.15 * vehicle.wheelbase
    misfit = math.sqrt(np.mean(fit.error**2))
    return _Point(x, std, effect, misfit, known, slope) if known else _Point(slope=slope)


def _slope(signals: _Signals) -> float:
    """Slope of the slip angle over the force at the stated point, in its standard errors: the
    lower one, without and with alpha_0; 0 if too few independent rows determine it."""
    rows, strong, both = signals.moderate(0.0)
    alpha, sides = signals.at(0.0, strong)
    share, slopes = sides[rows, 0], [0.0]
    for free in {both, True} if np.std(share) > 0.05 else ():  # not one operating point
        fit = signals.fit(alpha, sides[:, :1], rows, free)
        if fit.effective * np.mean(share**2) ** 2 / np.mean(share**4) >= SURE**2:
            slopes.append(float(fit.theta[0] / max(fit.std[0], 1e-300)))
    return min(slopes)


# --- forces beyond friction -------------------------------------------------------


def doubts(columns: Mapping[str, np.ndarray], kept: np.ndarray, vehicle: Vehicle) -> Iterator[str]:
    """A warning on forces larger than tires transmit without downforce, or mostly due to yaw
    inertia (at the limit, F_y / F_z is about |a_y| / g).

    Args:
        columns: :attr:`tirefit.data.vehicle.derive.DerivedLog.columns` of every grid sample.
        kept: (n,) bool, the samples that will be written.
    """

    def high(values: np.ndarray) -> float:
        return float(np.percentile(np.abs(values[kept]), 99))

    share = high(columns["fy"] / columns["fz"])
    level = high(columns["a_y"]) / vehicle.gravity
    by_inertia = share > max(1.0, ALIKE * level)  # 1.0: of road tires on dry asphalt
    if share >= 1.5 or by_inertia:  # 1.5: of racing tires
        message = f"|fy| reaches {share:.2g} fz (99th percentile), more than a tire's friction"
        if by_inertia:
            moment = vehicle.yaw_inertia * columns["yaw_acceleration"] / vehicle.wheelbase
            message += (
                f", while |a_y| reaches {level:.2g} g: yaw_inertia dr/dt / wheelbase alone"
                f" is {high(moment / columns['fz']):.2g} fz, and yaw_inertia"
                f" {vehicle.inertia_ratio:.2g} mass l_f l_r (about 1 of cars)"
            )
        yield f"{message}: check mass, yaw_inertia and the unit of a_y or of the positions"
