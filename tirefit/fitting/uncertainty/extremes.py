"""Largest and smallest value of a quantity within the 95 % region of a fit."""

from collections.abc import Callable

import numpy as np
from scipy.special import expit, logit

from tirefit.fitting.solve.inference import REACH, deviance_at, inflation, linearise
from tirefit.fitting.solve.least_squares import Normal, NormalEquations, on_host
from tirefit.fitting.solve.multistart import Solved

Quantity = Callable[[np.ndarray], tuple[float, np.ndarray]]
"""z (p,) -> a quantity and its slope (p,)."""


def _bowl(solved: Solved, z: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Deviance at z, half its slope (p,), and half its curvature (p, p)."""
    problem = solved.problem
    at = linearise(problem, z)
    slope, curvature = np.zeros(len(z)), np.zeros((len(z), len(z)))
    for name, slopes in at.slopes.items():
        values, slopes = np.asarray(at.values[name]), np.asarray(slopes)
        weight = 1 / inflation(problem, name)
        if name in problem.rules and problem.rules[name].smallest > 0:
            weight = problem.rules[name].effective / (values @ values)
        slope += weight * (values @ slopes)
        curvature += weight * (slopes.T @ slopes)
    return deviance_at(problem, at), slope, curvature


_NEXT_TO_BOUND = 1e-9

_LONGEST_SHARE = 0.3  # share of an element's range that one step may cross

_LEAST_CURVATURE = 1.0
"""Curvature of the deviance in shares below which a direction counts as free: its standard
error is the whole range. The step then goes to a bound; without a floor, a direction with
no information would be left out, as if it were known exactly."""


def _step(
    slope: np.ndarray, pull: np.ndarray, curvature: np.ndarray, room: float, share: np.ndarray
) -> np.ndarray:
    """The step (p,) of :func:`_stepped` from shares at (p,).

    An element that would cross its bound is held there.
    """
    free, step = np.ones(len(share), bool), np.zeros(len(share))
    for _ in range(2):
        values, axes = np.linalg.eigh(curvature[np.ix_(free, free)])
        inverse = (axes / np.maximum(values, _LEAST_CURVATURE)) @ axes.T
        left = room + slope[free] @ inverse @ slope[free]
        reach = pull[free] @ inverse @ pull[free]
        size = np.sqrt(max(left, 0.0) / max(reach, 1e-300))
        step[free] = inverse @ (size * pull - slope)[free]
        free = _inside(share + step) != share
        step[~free] = 0.0
    return step


def _inside(share: np.ndarray) -> np.ndarray:
    return np.clip(share, _NEXT_TO_BOUND, 1 - _NEXT_TO_BOUND)


def _stepped(solved: Solved, quantity: Quantity, sign: int) -> float:
    """Largest (sign 1) or smallest (-1) value of a quantity within the 95 % region.

    Venzon and Moolgavkar's iteration (Applied Statistics 37, 1988) for a function of
    the parameters: for a quadratic deviance and a linear quantity, one step is exact.
    Elements are expressed as shares of their range, so that bounds are finite. NaN if it
    does not converge.
    """
    level, fixed = solved.level, np.linalg.inv(solved.covariance)
    share = _inside(expit(solved.z))
    here = _bowl(solved, logit(share))
    base, before, damping = here[0], np.inf, 1.0
    for _ in range(60):
        total, slope, curvature = here
        scale = share * (1 - share)
        value, pull = quantity(logit(share))
        # The deviance of rows with slip noise is not a square: use the curvature at the estimate.
        curvature = fixed if solved.problem.rows.nodes else curvature
        step = _step(
            slope / scale,
            sign * pull / scale,
            curvature / np.outer(scale, scale),
            level - total + base,
            share,
        )
        length = float((step / scale) @ curvature @ (step / scale))
        if not np.isfinite(length):
            break
        if length < 1e-6 * level and abs(total - base - level) < 1e-2 * level:
            return float(value)
        # Near a bound the deviance may have no curvature to limit a step.
        step *= min(1.0, _LONGEST_SHARE / max(np.max(np.abs(step)), 1e-300))
        damping = damping / 2 if length > before else min(1.0, 1.5 * damping)
        before, start = length, share
        # Stay near the region, as there are other minima beyond it.
        while damping > 1e-4:
            share = _inside(start + damping * step)
            here = _bowl(solved, logit(share))
            if here[0] - base < 2 * level:
                break
            damping /= 2
        else:
            break
    return float("nan")


_STRIDES = 30
"""Number of steps of a walk, each twice as long as the previous one, from a third of a
standard error: farther than any quantity can go."""

_ENDLESS = 1e3  # multiple of the estimate above which a quantity has no end

_NARROWED_ENDS = 12
_ON_LEVEL = 2e-3  # distance from the level, in standard errors, that counts as there

_CREEPING = 10
"""Steps that together lower the deviance by less than :data:`_ON_LEVEL` of the level, after
which a search ends: forces with slip noise have no exact curvature, and it creeps."""

_SETTLED = 1e-7
"""Decrease of the deviance by one more step, over the level, at a point that has converged."""


def _settled(
    solved: Solved, quantity: Quantity, z: np.ndarray, target: float, spread: float
) -> tuple[np.ndarray, float, float]:
    """The minimum of deviance + ((quantity - target) / spread)^2, which has the smallest
    deviance for its value of the quantity: (z, value, deviance)."""

    def at(z: np.ndarray) -> Normal:
        total, slope, curvature = _bowl(solved, z)
        value, pull = quantity(z)
        miss, pull = (value - target) / spread, pull / spread
        return Normal(total + miss**2, curvature + np.outer(pull, pull), slope + miss * pull)

    law = NormalEquations(0.0, _SETTLED * solved.level)
    rest = _CREEPING, _ON_LEVEL * solved.level
    z = on_host(at, z, law, lower=-REACH, upper=REACH, rest=rest).z
    return z, quantity(z)[0], _bowl(solved, z)[0]


def _walked(solved: Solved, quantity: Quantity, sign: int) -> float:
    """As :func:`_stepped`, along the points of smallest deviance for each value of the
    quantity: slower, but reliable if the valley of the deviance is curved (redundant
    parameters). NaN if the quantity is unbounded."""
    base = _bowl(solved, solved.z)[0]
    first, pull = quantity(solved.z)
    std = float(np.sqrt(pull @ solved.covariance @ pull))
    spread = float(np.clip(std, 1e-3 * abs(first), 0.1 * abs(first)))

    def reached(z: np.ndarray, target: float) -> tuple[np.ndarray, float, float]:
        """The point of convergence, its value, and the excess over the level, which is
        linear in the target if the deviance is quadratic."""
        z, value, total = _settled(solved, quantity, z, target, spread)
        return z, value, np.sqrt(max(total - base, 0.0)) - np.sqrt(solved.level)

    z, value, below = solved.z, first, -float(np.sqrt(solved.level))
    inside, stride = float(first), 0.3 * spread
    for _ in range(_STRIDES):
        outside = inside + sign * stride
        there, farther, above = reached(z, outside)
        if above > 0:
            break
        if not abs(farther) < _ENDLESS * abs(first):
            return float("nan")
        z, value, inside, below, stride = there, farther, outside, above, 2 * stride
    else:
        return float("nan")
    for _ in range(_NARROWED_ENDS):
        part = np.clip(below / (below - above), 0.1, 0.9)
        middle = inside + part * (outside - inside)
        there, between, height = reached(z, middle)
        if height > 0:
            outside, above = middle, height
        else:
            z, value, inside, below = there, between, middle, height
        if abs(height) < _ON_LEVEL:
            return float(between)
    return float(value)


def extreme(solved: Solved, quantity: Quantity, sign: int) -> float:
    """Largest (sign 1) or smallest (-1) value of a quantity over all parameters whose
    deviance is below the level; NaN if there is none.

    Args:
        quantity: z (p,) -> its value, and its slope (p,).
    """
    quick = _stepped(solved, quantity, sign)
    return quick if np.isfinite(quick) else _walked(solved, quantity, sign)
