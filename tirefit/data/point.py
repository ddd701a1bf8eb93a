"""Estimate the tracked point of a log from the rear axle's force against its slip.

A point x further ahead lowers the slip angle by :math:`x r / v_x` and the lateral
acceleration by :math:`x \\dot r`. At moderate slip
:math:`\\alpha = c_1 F + c_3 F^3 + \\alpha_0` holds; Gauss and Newton fit x, c_1, c_3
and, if the log turns both ways, :math:`\\alpha_0`. As in :mod:`tirefit.data.agreement`
values before and after are the instruments, and standard errors count effective rows.
Other faults with a like effect (yaw inertia, delay, sign) are fitted the same way.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tirefit.data.agreement import EACH, FEWEST, around, instrumented, surrounded
from tirefit.data.faults import ALIKE, CHANGED, SURE
from tirefit.data.motion import Motion, slip_and_force
from tirefit.data.vehicle import POSE, Vehicle
from tirefit.data.zero import turns_both_ways
from tirefit.results import InputProblem

_MODERATE = 0.5
"""Share of the strong forces (95th percentile) up to which the cubic holds."""

_ZERO = 0.02
"""Zero error [rad] of a heading or a sensor's mounting that turns to one side hide: 1
deg, twice what was found on measured logs."""

_ON_CAR = (-0.5, 1.5)
"""Wheelbases ahead of the rear axle between which a car has points."""

_KNOWN = 0.15
"""Standard error [wheelbases] up to which an estimate counts: four of them reach from
the centre of gravity to an axle."""

_ONE_POINT = 0.05
"""Standard deviation of the force over a strong one below which the log holds one
operating point, which has no slope."""

_MOST_ROWS, _ROUNDS = 20_000, 8

_Change = Callable[[Motion, Vehicle, float], tuple[Motion, Vehicle]]


class PointCheck(NamedTuple):
    """``line`` for the summary; ``estimate`` of the point [m ahead of the rear axle]
    and its standard error, None if the log does not show it; an error or a warning."""

    line: str
    estimate: tuple[float, float] | None
    problems: tuple[InputProblem, ...] = ()
    warnings: tuple[str, ...] = ()


class _Fit(NamedTuple):
    """Amount of a change, its standard error, the rms that is left of the slip angle
    [rad], the share of the slip angle that the change makes, the slope with the change
    (:func:`_slope`), and the F statistic of the instruments."""

    amount: float = 0.0
    std: float = math.inf
    misfit: float = math.inf
    effect: float = 0.0
    slope: float = 0.0
    strength: float = 0.0


class _Rows(NamedTuple):
    """Rows to fit, rows between the instruments, the strong force [N], and the prior
    standard deviation of alpha_0: infinite where it is fitted, else 0."""

    rows: np.ndarray
    step: int
    strong: float
    offset: float


def check_point(motion: Motion, vehicle: Vehicle, kept, file: str) -> PointCheck:
    """Estimate the tracked point; refuse a force that acts the way the axle slides.

    Args:
        kept: (n,) bool, the samples that will be written.
    """
    check = PointCheck("tracked point: this log does not show where it is", None)
    step = max(1, round(vehicle.filter.sample_rate / vehicle.filter.cutoff))
    known = np.isfinite(slip_and_force(motion, vehicle)).all(axis=0)
    every = surrounded(motion.part, kept & known, known, 2 * step + 1)
    every = every[:: max(1, step // EACH, len(every) // _MOST_ROWS)]
    if len(every) < FEWEST:
        return check
    rows = _moderate(motion, vehicle, every, step)
    # With and without a zero error.
    free = rows._replace(offset=math.inf)
    slope = min(_slope(motion, vehicle, some) for some in (rows, free))
    fit, rows = _point(motion, vehicle, every, step)
    stated = vehicle.l_r - vehicle.cg_from_tracked[0]
    low, high = (share * vehicle.wheelbase for share in _ON_CAR)
    found = fit.slope > 0 and fit.std < _KNOWN * vehicle.wheelbase
    on_car = low < stated + fit.amount < high
    if found and on_car:
        side = "ahead of" if fit.amount > 0 else "behind"
        check = PointCheck(
            f"tracked point: force and slip fit best with it {abs(fit.amount):.2g} ±"
            f" {fit.std:.1g} m {side} the stated one",
            (stated + fit.amount, fit.std),
        )
    off = found and _sure(fit) and fit.effect > CHANGED
    flipped = not found and _fits_flipped(motion, vehicle, free)
    if not (off or flipped) and slope > -SURE:
        return check
    others = _others(motion, vehicle, rows)
    best = fit.misfit if off else min((misfit for misfit, *_ in others), default=0.0)
    named = [(reason, remedy) for m, reason, remedy in others if m <= best * ALIKE]
    named = [_words(fit, stated, vehicle), *named] if off and on_car else named
    if not named and slope > -SURE and not flipped:
        return check
    named = [_flipped(vehicle)] if flipped or not named else named
    reasons, remedies = (", or ".join(words) for words in zip(*named, strict=True))
    if slope > -SURE:
        said = f"the force would follow the slip if {reasons}; {remedies}"
        return check._replace(warnings=(said,))
    reason = "channels contradict each other: the side force acts the way the axle"
    reason += f" slides ({-slope:.0f} standard errors): {reasons}"
    return check._replace(problems=(InputProblem(reason, remedies, file),))


def _sure(fit: _Fit) -> bool:
    return fit.slope > 0 and abs(fit.amount) > SURE * fit.std


# --- changes --------------------------------------------------------------------


def _further_ahead(motion: Motion, vehicle: Vehicle, x: float):
    """Move the tracked point x [m] ahead; changes what alpha and F need only."""
    v_y = motion.v_y - x * motion.yaw_rate
    a_y = motion.a_y - x * motion.yaw_acceleration
    return replace(motion, v_y=v_y, a_y=a_y), vehicle


def _more_inertia(motion: Motion, vehicle: Vehicle, x: float):
    inertia = (1 + x) * vehicle.yaw_inertia
    return motion, vehicle.model_copy(update={"yaw_inertia": inertia})


def _earlier(name: str) -> _Change:
    """Move the logged v_y or a_y, or the yaw of a pose, to an earlier time [s]."""

    def change(motion: Motion, vehicle: Vehicle, x: float):
        if name == "yaw":
            v_y = motion.v_y - x * motion.v_x * motion.yaw_rate
            return replace(motion, v_y=v_y), vehicle
        values = getattr(motion, name)
        return replace(motion, **{name: values + x * motion.rate_of(values)}), vehicle

    return change


def _mirrored(motion: Motion, vehicle: Vehicle, x: float):
    """Flip v_y of the tracked point."""
    moved = 2 * vehicle.cg_from_tracked[0] * motion.yaw_rate
    return replace(motion, v_y=moved - motion.v_y), vehicle


def _words(fit: _Fit, stated: float, vehicle: Vehicle) -> tuple[str, str]:
    """Reason and remedy of a wrong point."""
    at, left = stated + fit.amount, (vehicle.tracked_point or (0.0, 0.0))[1]
    reason = (
        f"the log's point is {at:.3g} ± {fit.std:.1g} m ahead of the rear axle, and"
    )
    reason += f" not {stated:.3g} m"
    remedy = f"say tracked_point = [{at:.3g}, {left:g}] in vehicle.toml"
    return reason, remedy + ("" if vehicle.tracked_point else " (or correct l_r)")


def _others(motion, vehicle: Vehicle, rows: _Rows) -> list[tuple[float, str, str]]:
    """Misfit [rad], reason and remedy of what else would explain the force."""
    pose, found = vehicle.columns.motion == POSE, []
    fit = _fitted(_more_inertia, 0.1, motion, vehicle, rows)
    changed = _more_inertia(motion, vehicle, fit.amount)[1]
    if _sure(fit) and set(changed.doubts()) <= set(vehicle.doubts()):
        reason = (
            f"yaw_inertia is {1 + fit.amount:.2g} ± {fit.std:.1g} of the stated one"
        )
        remedy = f"say yaw_inertia = {changed.yaw_inertia:.3g}"
        found.append((fit.misfit, reason, remedy))
    for name in ("yaw",) if pose else ("v_y", "a_y"):
        small = 1 / vehicle.filter.sample_rate
        fit = _fitted(_earlier(name), small, motion, vehicle, rows)
        if _sure(fit):
            how = "late" if fit.amount > 0 else "early"
            reason = f"{name} is {abs(fit.amount):.2g} ± {fit.std:.1g} s {how}"
            found.append((fit.misfit, reason, f"shift {name} in the log"))
    fit = _fitted(_mirrored, 0.0, motion, vehicle, rows)
    if not pose and fit.slope > 0:
        found.append((fit.misfit, *_flipped(vehicle)))
    return found


def _fits_flipped(motion, vehicle: Vehicle, rows: _Rows) -> bool:
    """Whether the force follows the slip with the other v_y, and no point makes it."""
    if vehicle.columns.motion == POSE:
        return False
    stated = _fitted(_more_inertia, 0.0, motion, vehicle, rows)
    other = _fitted(_mirrored, 0.0, motion, vehicle, rows)
    return other.slope > SURE and other.misfit * ALIKE < stated.misfit


def _flipped(vehicle: Vehicle) -> tuple[str, str]:
    """Reason and remedy of a wrong sign."""
    names = (
        ("yaw", "y", "rad") if vehicle.columns.motion == POSE else ("v_y", "a_y", "m/s")
    )
    unit = f"-{vehicle.units.get(names[0], names[2])}".removeprefix("--")
    remedy = f'say {names[0]} = "{unit}" in [units] of vehicle.toml'
    return f"{names[0]} or {names[1]} has the other sign", remedy


# --- fit ------------------------------------------------------------------------


def _moderate(motion: Motion, vehicle: Vehicle, every, step: int) -> _Rows:
    """The rows of moderate force among ``every`` (n,); all of a log that has few."""
    force = slip_and_force(motion, vehicle)[1][every]
    strong = max(float(np.percentile(np.abs(force), 95)), 1e-300)
    weak = np.abs(force) <= _MODERATE * strong
    weak |= weak.sum() < FEWEST
    offset = math.inf if turns_both_ways(force[weak] / strong) else 0.0
    return _Rows(every[weak], step, strong, offset)


def _shape(force, rows: _Rows) -> np.ndarray:
    share = force / rows.strong
    return np.column_stack([share, share**3])


def _point(motion, vehicle, every, step: int) -> tuple[_Fit, _Rows]:
    """Fit of the tracked point, from the best of a grid by least squares; its rows."""
    stated, best = vehicle.l_r - vehicle.cg_from_tracked[0], (math.inf, 0.0)
    names = Motion.__dataclass_fields__
    few = Motion(**{name: getattr(motion, name)[every] for name in names})
    for share in np.arange(_ON_CAR[0], _ON_CAR[1] + 0.01, 0.1):
        x = float(share) * vehicle.wheelbase - stated
        moved, _ = _further_ahead(few, vehicle, x)
        rows = _moderate(moved, vehicle, np.arange(len(every)), step)
        alpha, force = (
            values[rows.rows] for values in slip_and_force(moved, vehicle)[:2]
        )
        one = np.ones((len(alpha), 1 if rows.offset else 0))
        sides = np.hstack([_shape(force, rows), one])
        theta = np.linalg.lstsq(sides, alpha)[0]
        if theta[0] > 0:
            best = min(best, (float(np.var(alpha - sides @ theta)), x))
    moved, _ = _further_ahead(motion, vehicle, best[1])
    rows = _moderate(moved, vehicle, every, step)
    small = 0.01 * vehicle.wheelbase
    fit = _fitted(_further_ahead, small, motion, vehicle, rows, best[1])
    # Instruments leave the bias of least squares over their F statistic: Bound, Jaeger,
    # Baker, JASA 1995, eq. 7.
    bias = abs(fit.amount - best[1]) / max(fit.strength - 1, 1e-9)
    return fit._replace(std=math.hypot(fit.std, bias)), rows


def _fitted(
    change: _Change, small: float, motion, vehicle, rows: _Rows, x: float = 0.0
) -> _Fit:
    """Fit the amount of a change with which the slip angle follows the force.

    Args:
        small: amount whose effect is linear; 0 of a change that has none.
        x: amount to begin with.
    """
    keep = rows.rows
    try:
        for _ in range(_ROUNDS):
            alpha, force, _ = slip_and_force(*change(motion, vehicle, x))
            sides = _shape(force, rows)
            fit = _solved(alpha, sides, rows)
            if not small:
                break
            moved = slip_and_force(*change(motion, vehicle, x + small))
            bent = (_shape(moved[1], rows) - sides) @ fit.theta[:2]
            sides = np.column_stack([sides, (moved[0] - alpha - bent) / small])
            fit = _solved(alpha, sides, rows)
            x -= float(fit.theta[2])
            if abs(fit.theta[2]) < 0.05 * fit.std[2]:
                break
        std = _with_zero(fit, alpha, sides, rows)[-1]
    except np.linalg.LinAlgError:
        return _Fit()
    size = max(float(np.mean(alpha[keep] ** 2)), 1e-300)
    effect = abs(x) * math.sqrt(np.mean(sides[keep, -1] ** 2) / size)
    share, count = fit.seen[-1], around(sides, keep[:1], 0).shape[1]
    strength = share / max(1 - share, 1e-9) * fit.effective / count
    slope = _slope(*change(motion, vehicle, x), rows)
    return _Fit(x, std, float(np.std(fit.error)), effect, slope, strength)


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
            return 0.0  # of few facts any slope may be chance
        return float(fit.theta[0] / max(_with_zero(fit, alpha, sides, rows)[0], 1e-300))
    except np.linalg.LinAlgError:
        return 0.0


def _with_zero(fit, alpha, sides, rows: _Rows) -> np.ndarray:
    """Standard errors (k,), with the share of a zero error that is not fitted."""
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
