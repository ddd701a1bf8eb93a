"""Free forms of an effect: its parameter varies with its quantity by smooth functions
instead of a formula."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from tirefit.diagnosis.negligible import ROUNDING
from tirefit.diagnosis.rows.basis import FULL_SLIDING, functions_of

ONE_WAY, BOTH_WAYS = 4, 5
"""Numbers of smooth functions of a covariate, too few to follow noise. The odd number has
a function at the middle, for a covariate with two signs."""

_OF_THE_CURVE, _OF_SPEED, _OF_RATE = 9, 8, 6
"""The same for force over slip, friction over sliding speed and friction over the rate
of the slip, which vary within a part of the range."""

_QUICKEST = 3.0  # largest rate over the usual one; faster ones are limited to it

_CERTAIN, _TURNS = 0.99, 0.1
"""Smallest size of ``turning`` with a certain direction; largest share of uncertain rows
that are turns of the slip and not a slip at rest."""


class Form(NamedTuple):
    """``field`` of the state changes by ``size`` times the smooth functions
    ``shapes(rows, u)`` (n, k); u is slip over that of full sliding, (n,).

    A form is not used if the data lack ``needs`` (at one speed, any function of the sliding speed
    is one of the slip), or if the covariate ``by`` is a function of the slip, as it would fit any
    remainder. A form may add 1/8 to 1/2 of the usual change by the formula."""

    field: str
    size: float
    shapes: Callable
    needs: str = ""
    by: str = ""


def _about_mean(shapes):
    return shapes - shapes.mean(axis=0)


_UNITS = {"shift": "rise", "force": "load"}
"""Field of the state -> covariate by which its forms are scaled; none for factors."""


def over(field: str, size: float, covariate: str, count: int = ONE_WAY) -> tuple[Form, ...]:
    """A field with ``count`` smooth functions of a covariate, minus their means."""

    def shapes(rows, u):
        free = _about_mean(functions_of(getattr(rows, covariate), count))
        unit = _UNITS.get(field)
        return free if unit is None else free * getattr(rows, unit)[:, None]

    return (Form(field, size, shapes, by=covariate),)


def _of_slip(u, count: int = ONE_WAY):
    return functions_of(np.minimum(np.abs(u), FULL_SLIDING), count)


def _by_slip(factor: str, count: int = ONE_WAY):
    """Functions of the size of the slip, times a covariate."""
    return lambda rows, u: _of_slip(u, count) * getattr(rows, factor)[:, None]


def _of_shape(rows, u):
    """Force over load as any odd function of the slip fraction."""
    return _by_slip("side", _OF_THE_CURVE)(rows, u) * (rows.fz * rows.load)[:, None]


def _of_sliding(rows, u):
    return functions_of(np.sqrt(rows.sliding), _OF_SPEED)


def _of_rate(rows, u):
    """Functions of the rate of change of the size of the slip."""
    rate = rows.rate * rows.side
    usual = max(np.mean(np.abs(rate)), ROUNDING)
    return functions_of(np.clip(rate / usual, -_QUICKEST, _QUICKEST), _OF_RATE)


def _by_lag(rows, u):
    """Functions of the size of the slip minus their means (the mean is the formula),
    times the change of the slip with distance."""
    return _about_mean(_of_slip(u)) * rows.lag[:, None]


def _by_delay(rows, u):
    """The same functions times the change of the slip with time, in the unit of ``lag``."""
    change = rows.lag * rows.pace
    usual = np.mean(change**2) / max(np.mean(rows.lag**2), ROUNDING)
    return _by_lag(rows._replace(lag=change / max(np.sqrt(usual), ROUNDING)), u)


def _at_a_turn(rows, u):
    """One column for each row at which the direction of the slip is uncertain."""
    unsure = np.flatnonzero((np.abs(rows.turning) < _CERTAIN) & (rows.turning != 0))
    if len(unsure) > _TURNS * len(rows.turning):
        unsure = unsure[:0]
    return np.eye(len(rows.turning))[:, unsure]


def _guided(rows, u):
    """A force that depends on the direction: functions of the size of the slip, times the load."""
    return _by_slip("turning")(rows, u) * (rows.side * rows.fz * rows.load)[:, None]


def _rate_of_force(rows, u):
    return _of_rate(rows, u) * (rows.side * rows.load)[:, None]


def _other_slip(rows, u):
    return functions_of(rows.other / rows.fz, BOTH_WAYS)


SHAPE_OF_THE_CURVE = (Form("force", 0.01, _of_shape),)


FRICTION_BY_SPEED = tuple(
    Form(field, 0.06, _of_sliding, "speeds") for field in ("friction", "kinetic")
)
SHIFT_BY_DELAY = (Form("shift", 0.04, _by_delay),)
SHIFT_BY_LAG = (Form("shift", 0.04, _by_lag),)
FRICTION_BY_DIRECTION = (
    Form("friction", 0.02, _by_slip("turning")),
    Form("friction", 0.02, _of_rate),
    Form("friction", 0.05, _at_a_turn),
)
BY_SIDE = (
    Form("friction", 0.02, _by_slip("side")),
    Form("stiffness", 0.02, lambda rows, u: rows.side[:, None]),
)
FORCE_BY_DIRECTION = (
    Form("force", 0.004, _guided),
    Form("force", 0.004, _rate_of_force),
    Form("force", 0.02, lambda rows, u: _at_a_turn(rows, u) * rows.load[:, None]),
)
FORCE_BY_LOAD = over("force", 0.01, "fz")
SKEW_BY_LOAD = (over("skew", 0.1, "fz")[0]._replace(needs="loads"),)
FRICTION_BY_LOAD = over("friction", 0.03, "fz")
SHIFT_BY_SPEED = over("shift", 0.1, "v")
BY_OTHER_SLIP = tuple(Form(f, 0.03, _other_slip) for f in ("friction", "stiffness"))
SHIFT_BY_CAMBER = over("shift", 0.1, "gamma", BOTH_WAYS)
