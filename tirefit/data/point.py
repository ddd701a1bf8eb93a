"""Estimate the tracked point of a log from the rear axle's force against its slip.

A point x further ahead lowers the slip angle by :math:`x r / v_x` and the lateral
acceleration by :math:`x \\dot r`. At moderate slip
:math:`\\alpha = c_1 F + c_3 F^3 + \\alpha_0` holds. The Gauss-Newton method fits x,
c_1, c_3 and, if the log turns both ways, :math:`\\alpha_0`. As in
:mod:`tirefit.data.agreement`, values before and after a row are its instruments, and
standard errors use the effective number of rows. A wrong yaw inertia, a delay and another
place of the accelerometer act alike: the message names them.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tirefit.data.agreement import EACH, FEWEST, around, instrumented, surrounded
from tirefit.data.candidates import candidates_of
from tirefit.data.faults import ALIKE, CHANGED, SURE
from tirefit.data.findings import point_words
from tirefit.data.motion import Motion, further_ahead, slip_and_force
from tirefit.data.vehicle import POSE, Vehicle
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
    key = "yaw_offset" if pose else "sideslip_offset"
    given = getattr(vehicle, key)
    what, logged, turns = "sideslip", "sideslip", "raises"
    assumed = "the speeds are taken as along the car's axes; a sensor that is rotated to"
    assumed += " the right by an angle makes alpha too large by this angle"
    if pose:
        what, logged, turns = "heading", "yaw", "lowers"
        assumed = "the logged yaw is taken as the heading; if the heading is larger, alpha"
        assumed += " is too large by the difference"
    message = f"{what} offset: none assumed, {assumed}"
    if given:
        message = f"{what} offset: {given:g} rad were added to the logged {logged}, as"
        message += f" declared, which {turns} alpha by as much"
    left = _alpha_at_rest(alpha, fy) if axle == "rear" else None
    if left is None:
        return message, None
    takes_out = given + left if pose else given - left
    return (
        f"{message}; estimated from these data: alpha is {left:+.4f} rad where fy = 0;"
        f" for a symmetric tire, {key} = {takes_out:.4f} corrects it"
    ), left


def _alpha_at_rest(alpha: np.ndarray, fy: np.ndarray) -> float | None:
    """Slip angle [rad] at zero side force, by an odd cubic through the weaker half of fy.

    None unless left and right turns each have a tenth of those samples.
    """
    strong = np.percentile(abs(fy), 95)
    weak = abs(fy) < 0.5 * strong
    share = fy[weak] / strong
    if not turns_both_ways(share):
        return None
    terms = np.column_stack([np.ones(len(share)), share, share**3])
    return float(np.linalg.lstsq(terms, alpha[weak])[0][0])


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

_ON_CAR = (-0.5, 1.5)
"""Smallest and largest position on a car [wheelbases ahead of the rear axle]."""

_KNOWN = 0.15
"""Largest standard error [wheelbases] of an estimate that is reported: a quarter of
the distance from the centre of gravity to an axle, about."""

_ONE_POINT = 0.05
"""Standard deviation of the force over the strong force below which the log has one
operating point and its slope is undefined."""

_MOST_ROWS, _ROUNDS = 20_000, 8


class PointCheck(NamedTuple):
    """The estimate of the tracked point."""

    line: str  # sentence for the summary
    estimate: tuple[float, float] | None  # [m ahead of the rear axle], standard error
    problems: tuple[InputProblem, ...] = ()
    warnings: tuple[str, ...] = ()


class _Fit(NamedTuple):
    """The point, fitted."""

    ahead: float = 0.0  # of the stated point [m]
    std: float = math.inf  # its standard error
    effect: float = 0.0  # of the distance on the slip angle (rms over rms)
    slope: float = 0.0  # at the point (:func:`_slope`)

    @property
    def is_off(self) -> bool:
        """Whether the stated point is wrong by more than the error, with an effect."""
        sure = self.slope > 0 and abs(self.ahead) > SURE * self.std
        return sure and self.effect > CHANGED


class _Rows(NamedTuple):
    """Rows to fit, distance of the instruments [rows], the strong force [N], and the prior
    standard deviation of alpha_0: infinite if it is fitted, else 0."""

    rows: np.ndarray
    step: int
    strong: float
    offset: float


def check_point(motion: Motion, vehicle: Vehicle, kept, file: str) -> PointCheck:
    """Estimate the tracked point; refuse a force in the direction of the axle's slip.

    Args:
        kept: (n,) bool, the samples that will be written.
    """
    check = PointCheck("tracked point: this log does not determine it", None)
    step = max(1, round(vehicle.filter.sample_rate / vehicle.filter.cutoff))
    known = np.isfinite(slip_and_force(motion, vehicle)).all(axis=0)
    every = surrounded(motion.part, kept & known, known, 2 * step + 1)
    every = every[:: max(1, step // EACH, len(every) // _MOST_ROWS)]
    if len(every) < FEWEST:
        return check
    # The smaller slope: without and with a zero error.
    rows = _moderate(motion, vehicle, every, step)
    free = rows._replace(offset=math.inf)
    slope = min(_slope(motion, vehicle, some) for some in (rows, free))
    fit = _point(motion, vehicle, every, step)
    stated = vehicle.l_r - vehicle.cg_from_tracked[0]
    tried = candidates_of(motion, vehicle, kept)
    low, high = (share * vehicle.wheelbase for share in _ON_CAR)
    found = fit.slope > 0 and fit.std < _KNOWN * vehicle.wheelbase
    on_car = low < stated + fit.ahead < high
    other = None if found and fit.is_off else tried.other
    check = check._replace(line=f"{check.line}{tried.words}")
    if found and on_car and not other:
        line = f"tracked point: {point_words(fit.ahead, fit.std)}"
        check = PointCheck(line, (stated + fit.ahead, fit.std))
    if found and on_car and fit.is_off:
        words, remedy = _words(fit, stated, vehicle)
    elif other:
        words, remedy = other
    elif not found and _fits_flipped(motion, vehicle, free):
        words, remedy = _flipped(vehicle)
    elif slope <= -SURE:
        may_flip = _may_flip(motion, vehicle, every, step, found)
        words, remedy = (_flipped if may_flip else _nothing_fits)(vehicle)
    else:
        return check
    if slope > -SURE:
        message = f"lateral force against slip angle: {words}; {remedy}"
        return check._replace(warnings=(message,))
    reason = "channels contradict each other: the lateral force acts in the direction"
    reason += f" of the axle's slip ({-slope:.0f} standard errors): {words}"
    return check._replace(problems=(InputProblem(reason, remedy, file),))


def _words(fit: _Fit, stated: float, vehicle: Vehicle) -> tuple[str, str]:
    """Reason and remedy of a wrong point."""
    at, left = stated + fit.ahead, (vehicle.tracked_point or (0.0, 0.0))[1]
    place = f"{at:.3g} ± {fit.std:.1g} m ahead of the rear axle"
    reason = f"the tracked point is {place}, not {stated:.3g} m"
    remedy = f"set tracked_point = [{at:.3g}, {left:g}] in vehicle.toml"
    remedy += "" if vehicle.tracked_point else " (or correct l_r)"
    sensor = "the place of the a_y sensor, " if "a_y" in vehicle.columns.motion else ""
    return reason, (
        f"{remedy}, unless one of these is wrong, which acts alike: the time of a channel,"
        f" {sensor}yaw_inertia ({vehicle.inertia_ratio:.2g} mass l_f l_r)"
    )


def _mirrored(motion: Motion, vehicle: Vehicle) -> Motion:
    """The motion with the other sign of v_y of the tracked point, and of the a_y that
    follows from it where none is logged."""
    v_y = 2 * vehicle.cg_from_tracked[0] * motion.yaw_rate - motion.v_y
    a_y = motion.a_y
    if vehicle.columns.a_y_follows:
        a_y = a_y + motion.rate_of(v_y - motion.v_y)
    return replace(motion, v_y=v_y, a_y=a_y)


def _may_flip(motion: Motion, vehicle: Vehicle, every, step: int, found: bool) -> bool:
    """Whether the stated point fits the flipped v_y, or neither v_y determines one."""
    if vehicle.columns.motion == POSE:
        return False
    again = _point(_mirrored(motion, vehicle), vehicle, every, step)
    if again.std > _KNOWN * vehicle.wheelbase:
        return not found
    return again.slope > 0 and not again.is_off


def _flipped(vehicle: Vehicle) -> tuple[str, str]:
    """Reason and remedy of a wrong sign."""
    other = "yaw_rate" if vehicle.columns.a_y_follows else "a_y"
    unit = f"-{vehicle.units.get('v_y', 'm/s')}".removeprefix("--")
    remedy = f'set v_y = "{unit}" in [units] of vehicle.toml'
    return f"v_y or {other} has the wrong sign", remedy


def _nothing_fits(vehicle: Vehicle) -> tuple[str, str]:
    """Reason and remedy where no point explains the force."""
    remedy = "check tracked_point, the signs of the channels and yaw_inertia, which is"
    remedy += f" {vehicle.inertia_ratio:.2g} mass l_f l_r (about 1 of cars)"
    return "no point on the car explains it", remedy


# --- fit ------------------------------------------------------------------------


def _moderate(motion: Motion, vehicle: Vehicle, every, step: int) -> _Rows:
    """The rows of moderate force among ``every`` (n,), or all if they are too few."""
    force = slip_and_force(motion, vehicle)[1][every]
    strong = max(float(np.percentile(np.abs(force), 95)), 1e-300)
    weak = np.abs(force) <= _MODERATE * strong
    weak |= weak.sum() < FEWEST
    offset = math.inf if turns_both_ways(force[weak] / strong) else 0.0
    return _Rows(every[weak], step, strong, offset)


def _shape(force, rows: _Rows) -> np.ndarray:
    share = force / rows.strong
    return np.column_stack([share, share**3])


def _fits_flipped(motion: Motion, vehicle: Vehicle, rows: _Rows) -> bool:
    """Whether the force follows the slip with -v_y, and fits better than as stated."""
    if vehicle.columns.motion == POSE:
        return False
    other = _mirrored(motion, vehicle)
    if _slope(other, vehicle, rows) <= SURE:
        return False
    misfits = []
    for some in (motion, other):
        alpha, force, _ = slip_and_force(some, vehicle)
        try:
            misfits.append(float(np.std(_solved(alpha, _shape(force, rows), rows).error)))
        except np.linalg.LinAlgError:
            return False
    return misfits[1] * ALIKE < misfits[0]


def _point(motion: Motion, vehicle: Vehicle, every: np.ndarray, step: int) -> _Fit:
    """Fit of the tracked point; starts at the best point of a grid."""
    stated, best = vehicle.l_r - vehicle.cg_from_tracked[0], (math.inf, 0.0)
    names = Motion.__dataclass_fields__
    few = Motion(**{name: getattr(motion, name)[every] for name in names})
    for share in np.arange(_ON_CAR[0], _ON_CAR[1] + 0.01, 0.1):
        x = float(share) * vehicle.wheelbase - stated
        moved, _ = further_ahead(few, vehicle, x)
        rows = _moderate(moved, vehicle, np.arange(len(every)), step)
        alpha, force = (values[rows.rows] for values in slip_and_force(moved, vehicle)[:2])
        one = np.ones((len(alpha), 1 if rows.offset else 0))
        sides = np.hstack([_shape(force, rows), one])
        theta = np.linalg.lstsq(sides, alpha)[0]
        if theta[0] > 0:
            best = min(best, (float(np.var(alpha - sides @ theta)), x))
    start, small = best[1], 0.01 * vehicle.wheelbase
    rows = _moderate(further_ahead(motion, vehicle, start)[0], vehicle, every, step)
    x, fit = start, None
    try:
        for _ in range(_ROUNDS):
            alpha, force, _ = slip_and_force(*further_ahead(motion, vehicle, x))
            sides = _shape(force, rows)
            theta = _solved(alpha, sides, rows).theta[:2]
            moved = slip_and_force(*further_ahead(motion, vehicle, x + small))
            bent = (_shape(moved[1], rows) - sides) @ theta
            sides = np.column_stack([sides, (moved[0] - alpha - bent) / small])
            fit = _solved(alpha, sides, rows)
            x -= float(fit.theta[2])
            if abs(fit.theta[2]) < 0.05 * fit.std[2]:
                break
        std = _with_zero(fit, alpha, sides, rows)[-1]
    except np.linalg.LinAlgError:
        return _Fit()
    assert fit is not None  # the loop has at least one round
    size = max(float(np.mean(alpha[rows.rows] ** 2)), 1e-300)
    effect = abs(x) * math.sqrt(np.mean(sides[rows.rows, -1] ** 2) / size)
    # With instruments, the bias of least squares over their F statistic remains: Bound,
    # Jaeger, Baker, JASA 1995, eq. 7.
    share, count = fit.seen[-1], around(sides, rows.rows[:1], 0).shape[1]
    strength = share / max(1 - share, 1e-9) * fit.effective / count
    bias = abs(x - start) / max(strength - 1, 1e-9)
    slope = _slope(*further_ahead(motion, vehicle, x), rows)
    return _Fit(x, math.hypot(std, bias), effect, slope)


def _slope(motion: Motion, vehicle: Vehicle, rows: _Rows) -> float:
    """Slope of the slip angle over the force, in its standard errors."""
    alpha, force, _ = slip_and_force(motion, vehicle)
    sides = force[:, None] / rows.strong
    if np.std(sides[rows.rows]) < _ONE_POINT:
        return 0.0
    try:
        fit = _solved(alpha, sides, rows)
        weight = sides[rows.rows] ** 2
        if fit.effective * np.mean(weight) ** 2 / np.mean(weight**2) < SURE**2:
            return 0.0  # too few effective rows
        return float(fit.theta[0] / max(_with_zero(fit, alpha, sides, rows)[0], 1e-300))
    except np.linalg.LinAlgError:
        return 0.0


def _with_zero(fit, alpha, sides, rows: _Rows) -> np.ndarray:
    """Standard errors (k,), with that by a zero error that is not fitted."""
    if rows.offset:
        return fit.std[:-1]
    other = _solved(alpha + _ZERO, sides, rows)
    return np.hypot(fit.std[:-1], (other.theta - fit.theta)[:-1])


def _solved(alpha, sides, rows: _Rows):
    near = around(sides, rows.rows, rows.step)
    fit = instrumented(alpha[rows.rows], sides[rows.rows], near, lambda _: rows.offset)
    if fit is None:
        raise np.linalg.LinAlgError
    return fit
