"""Free forms of an effect: the same parameter varies with the same quantity, in a shape
that no formula has."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from tirefit.diagnosis.negligible import ROUNDING
from tirefit.diagnosis.rows.basis import FULL_SLIDING, functions_of

ONE_WAY, BOTH_WAYS = 4, 5
"""Smooth functions of a covariate, few enough to follow no noise; an odd number has one
at the middle, for a covariate that has two sides."""

_OF_THE_CURVE, _OF_SPEED, _OF_RATE = 9, 8, 6
"""The same of the whole curve of force over slip and of friction over sliding speed,
which rise and fall within a part of the range, and of the rate of the slip."""

_QUICKEST = 3.0
"""Rates over the usual one that count as this one: a jump."""


_SURE, _TURNS = 0.99, 0.1
"""Certainty of a direction from which there is no doubt about it; share of the rows up
to which the others are turns of the slip, and not slips that hardly move."""


class Form(NamedTuple):
    """``field`` of the state that moves by ``size`` times smooth functions of what
    ``shapes(rows, u)`` gives, (n, k); u is slip over that of full sliding, (n,).
    ``needs`` is what the data must hold: at one speed any function of the sliding speed
    is one of the slip, and would explain whatever there is. So would one of ``by``, the
    covariate whose functions they are, where that follows the slip. A form may add an
    eighth to a half of what the formula beside it may."""

    field: str
    size: float
    shapes: Callable
    needs: str = ""
    by: str = ""


def _about_mean(shapes):
    return shapes - shapes.mean(axis=0)


def over(
    field: str, size: float, covariate: str, count: int, times: Callable | None = None
) -> tuple[Form, ...]:
    """A field as ``count`` smooth functions of one covariate about their means, in
    units of ``times(rows)`` (n,) where they are given: what stays is no change."""

    def shapes(rows, u):
        free = _about_mean(functions_of(getattr(rows, covariate), count))
        return free if times is None else free * times(rows)[:, None]

    return (Form(field, size, shapes, by=covariate),)


def rise(rows):
    """Slip at half of the largest force, (n,): the unit of a shift of the slip."""
    return rows.rise


def weight(rows):
    """Mean load [N], (n,): the unit of a force."""
    return rows.load


def _of_slip(u, count: int = ONE_WAY):
    return functions_of(np.minimum(np.abs(u), FULL_SLIDING), count)


def _by_slip(factor: str, count: int = ONE_WAY):
    """Functions of the size of the slip, times a covariate."""

    def shapes(rows, u):
        return _of_slip(u, count) * getattr(rows, factor)[:, None]

    return shapes


def _of_shape(rows, u):
    """Force over load as any odd function of the slip fraction."""
    return _by_slip("side", _OF_THE_CURVE)(rows, u) * (rows.fz * rows.load)[:, None]


def _of_sliding(rows, u):
    return functions_of(np.sqrt(rows.sliding), _OF_SPEED)


def _of_rate(rows, u):
    """Functions of how fast the slip grows or shrinks in size."""
    rate = rows.rate * rows.side
    usual = max(np.mean(np.abs(rate)), ROUNDING)
    return functions_of(np.clip(rate / usual, -_QUICKEST, _QUICKEST), _OF_RATE)


def _by_lag(rows, u):
    """Functions of the size of the slip about their means, times its change with the
    way: what is the same at every slip is the formula."""
    return _about_mean(_of_slip(u)) * rows.lag[:, None]


def _by_delay(rows, u):
    """The same of its change with time, in the unit of ``lag``."""
    change = rows.lag * rows.pace
    usual = np.mean(change**2) / max(np.mean(rows.lag**2), ROUNDING)
    return _by_lag(rows._replace(lag=change / max(np.sqrt(usual), ROUNDING)), u)


def _at_a_turn(rows, u):
    """Each row by itself of which nobody can say which way the slip moves there."""
    unsure = np.flatnonzero((np.abs(rows.turning) < _SURE) & (rows.turning != 0))
    if len(unsure) > _TURNS * len(rows.turning):
        unsure = unsure[:0]
    return np.eye(len(rows.turning))[:, unsure]


def _guided(rows, u):
    """Force on the way up or down, by the size of the force: a function of the slip
    fraction times the load."""
    return _by_slip("turning")(rows, u) * (rows.side * rows.fz * rows.load)[:, None]


SHAPE_OF_THE_CURVE = (Form("force", 0.01, _of_shape),)


def moved_by(forms: tuple[Form, ...]) -> frozenset[str]:
    """What effects of these forms move: fields of the state, or the curve itself."""
    fields = frozenset(form.field for form in forms)
    return frozenset({"curve"}) if forms == SHAPE_OF_THE_CURVE else fields


FRICTION_BY_SPEED = (
    Form("friction", 0.06, _of_sliding, "speeds"),
    Form("kinetic", 0.06, _of_sliding, "speeds"),
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
    Form(
        "force",
        0.004,
        lambda rows, u: _of_rate(rows, u) * (rows.side * rows.load)[:, None],
    ),
    Form("force", 0.02, lambda rows, u: _at_a_turn(rows, u) * rows.load[:, None]),
)
FORCE_BY_LOAD = over("force", 0.01, "fz", ONE_WAY, weight)
SKEW_BY_LOAD = tuple(
    form._replace(needs="loads") for form in over("skew", 0.1, "fz", ONE_WAY)
)
FRICTION_BY_LOAD = over("friction", 0.03, "fz", ONE_WAY)
SHIFT_BY_SPEED = over("shift", 0.1, "v", ONE_WAY, rise)
BY_OTHER_SLIP = tuple(
    Form(field, 0.03, lambda rows, u: functions_of(rows.other / rows.fz, BOTH_WAYS))
    for field in ("friction", "stiffness")
)
SHIFT_BY_CAMBER = over("shift", 0.1, "gamma", BOTH_WAYS, rise)
