"""Largest and smallest value of a quantity within the 95 % region of a fit."""

from collections.abc import Callable

import numpy as np

from tirefit.fitting.solve.inference import REACH, deviance_at, linearise, slope_and_curvature
from tirefit.fitting.solve.least_squares import Normal, NormalEquations, on_host
from tirefit.fitting.solve.multistart import Solved

Quantity = Callable[[np.ndarray], tuple[float, np.ndarray]]
"""z (p,) -> a quantity and its slope (p,)."""


def _bowl(solved: Solved, z: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Deviance at z, half its slope (p,), and half its curvature (p, p)."""
    at = linearise(solved.problem, z)
    slopes = slope_and_curvature(solved.problem, at, of_deviance=True)
    return deviance_at(solved.problem, at), *slopes


_SEARCHES = 42
"""Largest number of searches: of up to 30 the next goes up to twice as far as the previous one."""

_BEYOND = 1.5
"""How far the next search goes, over the distance at which the root of the deviance would reach
the level if it went on as a line: far outside the level a search takes ten times as many steps."""

_ENDLESS = 1e3  # multiple of the estimate above which a quantity has no end

_ON_LEVEL = 1e-3  # distance from the level, in standard errors, that counts as there

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


def extreme(solved: Solved, quantity: Quantity, sign: int) -> float:
    """Largest (sign 1) or smallest (-1) value of a quantity over all parameters whose
    deviance is below the level; NaN if there is none.

    The search follows the points of smallest deviance for each value of the quantity, which
    is reliable if the valley of the deviance is curved (redundant parameters).

    Args:
        quantity: z (p,) -> its value, and its slope (p,).
    """
    base, goal = _bowl(solved, solved.z)[0], float(np.sqrt(solved.level))
    first, pull = quantity(solved.z)
    std = float(np.sqrt(pull @ solved.covariance @ pull))
    spread = float(np.clip(std, 1e-3 * abs(first), 0.1 * abs(first)))
    # This target is exact for a linear quantity and a quadratic deviance.
    stride = goal * (std + spread**2 / std) if std <= spread else 0.3 * spread
    z, value, below, inside = solved.z, float(first), -goal, float(first)
    outside: float | None = None
    above = 0.0
    for _ in range(_SEARCHES):
        if outside is None:
            target, stride = inside + sign * stride, 2 * stride
        elif abs(outside - inside) < _ON_LEVEL * spread:
            break  # the deviance jumps here from one valley to another
        else:
            target = inside + np.clip(below / (below - above), 0.1, 0.9) * (outside - inside)
        there, reached, total = _settled(solved, quantity, z, target, spread)
        # Excess over the level, which is linear in the target if the deviance is quadratic.
        excess = float(np.sqrt(max(total - base, 0.0))) - goal
        if abs(excess) < _ON_LEVEL:
            return float(reached + (reached - value) * excess / (below - excess))
        if excess > 0:
            outside, above = target, excess
        elif not abs(reached) < _ENDLESS * abs(first):
            return float("nan")
        else:
            if below < excess:
                ahead = abs(target - inside) * excess / (below - excess)
                stride = min(stride, _BEYOND * ahead)
            z, value, inside, below = there, reached, target, excess
    return float("nan") if outside is None else value
