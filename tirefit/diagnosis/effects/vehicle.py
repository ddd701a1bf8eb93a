"""Effects of the vehicle: of the past (delays, relaxation, steering lag), changing radii, speed
offsets, the other force, load transfer, inertia, the ground, the two wheels of an axle, steering.

A force derived from the motion shares its channels with the slip, so an effect of yaw rate or
acceleration may fit any remainder, also on held-out data. The prior of such an effect is
therefore the error of a measured quantity if the file states it (``tirefit derive`` copies it
from vehicle.toml), else the error of a guess."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from tirefit.data.vehicle.findings import error_of_point
from tirefit.diagnosis.effects.record import (
    LEAST_FACTOR,
    PER_MILLE,
    Code,
    Constants,
    Prior,
    adds,
    blend,
    multiplies,
    scaled,
    xp,
)
from tirefit.diagnosis.effects.state import Covariates, State
from tirefit.diagnosis.engine import NONZERO
from tirefit.diagnosis.rows.rig import Rig
from tirefit.diagnosis.rows.slips import AGES, AHEAD
from tirefit.params import Values
from tirefit.slip import GRAVITY

if TYPE_CHECKING:
    from tirefit.diagnosis.rows.prepared import Prepared

_FAR = 6.0  # bounds of a prior in standard deviations

_QUANTITIES = {
    # Errors over the arm of an axle (1 mm on a 1:10 car, 4 cm on a car) and over the
    # wheelbase. The yaw inertia of most vehicle files is an estimate.
    "position": ("tracked_point", 0.03, 0.1),
    "clock": ("clock", 0.005, 0.1),
    "yaw_inertia": ("yaw_inertia", 0.3, 1.0),
}
"""Key of ``[vehicle]`` in rig.toml -> key of the quantity in vehicle.toml, and its standard error
if that file states it, and if it does not."""


def _error(key: str, prepared: "Prepared", rig: Rig) -> tuple[float | None, bool]:
    """Standard error [m, s, share], and whether it or the quantity is stated; None if the
    force was measured and neither is stated."""
    (name, known, guess), derived = _QUANTITIES[key], prepared.derived
    if key in rig.vehicle:
        return rig.vehicle[key], True
    if derived is None:
        return None, False
    constants = prepared.data.source.constants
    stated = name in constants
    error = constants[name] if key == "clock" and stated else known if stated else guess
    if key == "position":
        # The wheelbase, if not stated, is about twice the arm of an axle.
        error *= derived.arm if stated else constants.get("wheelbase", 2 * derived.arm)
    return error, stated


def _of_scale(prior: Prior, scale: float) -> Prior:
    return prior._replace(scale=scale, low=-_FAR * scale, high=_FAR * scale)


def _narrowed(prior: Prior, scale: float) -> Prior:
    """The prior with at most this scale."""
    narrow = _of_scale(prior, min(prior.scale, scale))
    return narrow._replace(low=max(prior.low, narrow.low), high=min(prior.high, narrow.high))


def _of_quantity(key: str, prior: Prior, prepared: "Prepared", rig: Rig) -> Prior:
    error, stated = _error(key, prepared, rig)
    if error is None:
        return prior
    return _narrowed(prior, error) if stated else _of_scale(prior, error)


def of_a_known_position(prior: Prior, prepared: "Prepared", rig: Rig) -> Prior:
    """Prior of an error of the tracked point along the vehicle: as ``tirefit derive`` estimated
    it from the same logs; without an estimate, that of a ruler for a stated point."""
    known = error_of_point(prepared.data.source.constants)
    if known is None or "position" in rig.vehicle:
        return _of_quantity("position", prior, prepared, rig)
    error, std = known
    # No error remains within the bounds.
    low, high = min(error, 0.0) - _FAR * std, max(error, 0.0) + _FAR * std
    return Prior(std, error, low, high)


def odds_of_derive(prepared: "Prepared") -> float:
    """Prior log odds of an error of the tracked point: log likelihood ratio of the error that
    ``tirefit derive`` found against no error, at most 30; 0 without an estimate."""
    known = error_of_point(prepared.data.source.constants)
    return 0.0 if known is None else min((known[0] / known[1]) ** 2 / 2, 30.0)


def of_a_known_inertia(prior: Prior, prepared: "Prepared", rig: Rig) -> Prior:
    """Prior of an error of the yaw inertia over the wheelbase."""
    if prepared.derived is None:
        return prior
    share, _ = _error("yaw_inertia", prepared, rig)
    assert share is not None  # a derived force has an error of each quantity
    return _of_scale(prior, share * prepared.derived.inertia)


def of_a_known_height(prior: Prior, prepared: "Prepared", rig: Rig) -> Prior:
    """Prior of the load transfer m h a_x / wheelbase over the range of a_x."""
    if "a_x" not in prepared.data:
        return prior
    span = float(np.ptp(prepared.column("a_x"))) / GRAVITY
    # The height of the centre of gravity of a car is 0.3 to 0.6 of the arm of an axle.
    return _narrowed(prior, 0.4 * span)


def of_a_known_force(prior: Prior, prepared: "Prepared", rig: Rig) -> Prior:
    """Prior of the share of the friction that the other force uses, widened by the error
    of that force (twice, for its square)."""
    name = "fx_std" if prepared.mode == "y" else "fy_std"
    if name not in prepared.data:
        return prior
    size, std = (
        float(np.sqrt(np.mean(np.square(values))))
        for values in (prepared.covariates.across, prepared.column(name))
    )
    error = 2 * prior.center * std / max(size, NONZERO)
    return prior._replace(scale=float(np.hypot(prior.scale, error)))


def _within_the_past(prior: Prior, prepared: "Prepared", rig: Rig) -> Prior:
    """The prior within the past and future that each row has."""
    first, last = AGES[[0, -1]] * float(prepared.covariates.interval[0])
    return prior._replace(low=max(prior.low, first), high=min(prior.high, last))


def notes_on_motion(rows: "Prepared", rig: Rig) -> tuple[str, ...]:
    """A sentence about a force if it was derived from the motion."""
    derived = rows.derived
    if derived is None:
        return ()
    message = f"fy was derived from a_y ({derived.mass:.4g} kg of it) and yaw_acceleration:"
    message += " it shares its channels with the slip, and so does held-out data"
    if unstated := [of[0] for key, of in _QUANTITIES.items() if not _error(key, rows, rig)[1]]:
        message += f"; vehicle.toml does not state {', '.join(unstated)}: measure them"
    return (message,)


def _late(past: Values, delay: float, rows: Covariates) -> np.ndarray:
    """Change of values (n, k) by a delay [s]: (n,).

    Exact for values that are linear between columns.
    """
    age = xp.clip(delay / rows.interval, AGES[0], AGES[-1])
    low = xp.clip(xp.searchsorted(AGES, age, side="right") - 1, 0, len(AGES) - 2)
    (early, before), (late, after) = (
        (xp.take(AGES, at), xp.take_along_axis(past, at[:, None], axis=1)[:, 0])
        for at in (low, low + 1)
    )
    share = (age - early) / (late - early)
    return before + share * (after - before) - past[:, AHEAD]


def lag(length: float, step: Values) -> Callable[..., Any]:
    """The change of values (n, k) by a first-order lag over a length: values -> (n,).

    Exact for values that are constant before the first column and linear between
    columns. A negative length counts as zero.

    Args:
        length: of the response, in the unit of ``step``.
        step: (n,) of one of :data:`AGES`.
    """
    # At a length of zero, here 1e-12 of a step, the slope is that of positive lengths.
    length = xp.where(length < 0, 0.0, length) + 1e-12 * step
    ways = (step / length)[:, None] * np.diff(AGES[AHEAD:])[None]
    # Response to values that rise over the distance, and its remainder at the row.
    decay = xp.exp(-ways)
    since = xp.cumprod(decay, axis=1)
    # Of short steps the first term of the series.
    share = xp.where(ways < 1e-4, ways / 2, 1 - (1 - decay) / ways)

    def change(past: np.ndarray) -> np.ndarray:
        after, before = past[:, AHEAD:-1], past[:, AHEAD + 1 :]
        risen = before + share * (after - before) - decay * before
        earlier = xp.sum(since[:, :-1] * risen[:, 1:], axis=1)
        return risen[:, 0] + earlier + since[:, -1] * past[:, -1] - past[:, AHEAD]

    return change


def _with_lag(state: State, length: float, step: Values, rows: Covariates) -> State:
    """The forces behind by a first-order lag."""
    change = lag(length, step)
    force, moment = state.force + change(rows.pull), state.moment + change(rows.twist)
    return state._replace(force=force, moment=moment)


def _delay(state: State, delay: float, constants: Constants, rows: Covariates) -> State:
    """Delay the slip, or the forces (at the delayed slip and load), or filter the
    forces by a first-order lag with the delay as time constant [s]."""
    _, force, filtered = constants
    if filtered:
        return _with_lag(state, delay, rows.interval, rows)
    if force:
        # A brush with another load equals one with another friction, see S(12).
        state = scaled(state, "friction", 1 + _late(rows.burden, delay, rows))
    return state._replace(shift=state.shift + _late(rows.past, delay, rows))


def _relax(state: State, length: float, constants: Constants, rows: Covariates) -> State:
    if constants[1]:
        return _with_lag(state, length, rows.step, rows)
    return state._replace(shift=state.shift + lag(length, rows.step)(rows.past))


def _steer(late: Callable[..., Any]) -> Callable[..., Any]:
    """Change by a road wheel angle that differs from the logged one by ``late(past,
    amplitude, rows)`` (n,) [rad]; a force derived across the wheels turns with them."""

    def change(state: State, amplitude: float, constants: Constants, rows: Covariates) -> State:
        slip, turned = rows.past[:, AHEAD], late(rows.steered, amplitude, rows)
        shift = state.shift + xp.tan(xp.arctan(slip) - turned) - slip
        return state._replace(shift=shift, force=state.force + rows.pivot * turned)

    return change


_PAST: Code = {
    # A delay between channels of one log.
    "channel_delay": dict(
        change=_delay,
        prior=lambda prior, rows, rig: _within_the_past(
            _of_quantity("clock", prior, rows, rig), rows, rig
        ),
    ),
    "relaxation_length": _relax,
    "steering_delay": dict(change=_steer(_late), prior=_within_the_past),
    "steering_lag": _steer(lambda past, a, rows: lag(a, rows.interval)(past)),
}


_DIRECTIONS = tuple(np.radians([0.0, 45.0, 90.0, 135.0]))
"""Directions of a slope of the ground; opposite ones have the opposite sign."""


def _slip_speed(share: float, constants: Constants, rows: Covariates) -> Values:
    """Slip due to a radius that grows with v or v^2; zero at rest or at usual speed."""
    grown = blend(constants[:2], rows.v, rows.v**2 / rows.cruise)
    return share * (grown - constants[2] * rows.cruise)


def _drag(share: float, constants: Constants, rows: Covariates) -> Values:
    ratio = rows.v / rows.cruise
    return PER_MILLE * rows.load * (share * blend(constants, ratio, ratio**2))


def _ellipse(state: State, share: float, constants: Constants, rows: Covariates) -> State:
    """Factor on the friction, or on the whole force."""
    (whole,) = constants
    used = rows.across / (rows.peak * rows.fz * rows.load)
    # The other force uses at most .95 of the friction; what it adds at most doubles it.
    left = xp.sqrt(1 - xp.clip(share * used**2, -3.0, 0.95))
    stiffness = state.stiffness * (1 - whole * (1 - left))
    return state._replace(friction=state.friction * left, stiffness=stiffness)


def _slope(slope: float, constants: Constants, rows: Covariates) -> np.ndarray:
    along, across = constants
    towards = along * xp.cos(rows.heading) + across * xp.sin(rows.heading)
    return slope * rows.load * rows.fz * towards


def _of_the_axle(factor: Callable[..., Any]) -> Callable[..., Any]:
    """A factor that depends on the lateral acceleration, on friction, stiffness or both."""

    def change(state: State, amplitude: float, constants: Constants, rows: Covariates) -> State:
        times = xp.maximum(factor(amplitude, rows.lean), LEAST_FACTOR)
        friction, stiffness = (times**power for power in constants)
        friction, stiffness = state.friction * friction, state.stiffness * stiffness
        return state._replace(friction=friction, stiffness=stiffness)

    return change


CODE: Code = {
    **_PAST,
    "slip_offset_load": adds("shift", lambda a, about, rows: a * (rows.fz - about[0])),
    "slip_offset_speed": adds("shift", _slip_speed),
    "speed_zero": adds("shift", lambda a, _, rows: a / rows.pace),
    "speed_drag": adds("force", _drag),
    "friction_ellipse": dict(change=_ellipse, prior=of_a_known_force),
    "tracked_point": dict(
        change=adds("shift", lambda a, _, rows: a * rows.yaw),
        odds=odds_of_derive,
        prior=of_a_known_position,
    ),
    "load_transfer": dict(
        change=multiplies("friction", lambda a, _, rows: 1 + a * rows.ahead / rows.fz),
        prior=of_a_known_height,
    ),
    "yaw_inertia": dict(
        change=adds("force", lambda a, _, rows: a * rows.swing), prior=of_a_known_inertia
    ),
    "floor_slope": dict(
        change=adds("force", _slope),
        variants=tuple((float(np.cos(d)), float(np.sin(d))) for d in _DIRECTIONS),
    ),
    "toe": adds("shift", lambda a, _, rows: a * rows.lean),
    "lateral_load_transfer": _of_the_axle(lambda a, lean: 1 - a * lean**2),
    "unlike_tires": _of_the_axle(lambda a, lean: 1 + a * lean),
    "steering_gain": adds("shift", lambda a, _, rows: a * rows.steering),
}
