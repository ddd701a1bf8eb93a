r"""Covariance and profile likelihood around a least-squares estimate.

Everything rests on one function of z, the *deviance* D(z) = -2 log L + 2 log L(best):

* noise given: D = sum of squares / inflation, where the inflation is the number of
  rows per independent row (autocorrelation), times chi2/dof where that says that the
  given noise is too small;
* noise estimated: the scale is integrated out under the 1/sigma prior,
  D = n_eff log(S / S_min), which in a linear model gives exactly Student's t.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.special import stdtrit

from tirefit.fit.layout import Layout
from tirefit.fit.least_squares import Solution, damped_gauss_newton, solve
from tirefit.fit.likelihood import Rows, root_deviance

__all__ = [
    "Profile",
    "Rule",
    "best_of",
    "covariance",
    "deviance",
    "profile_all",
    "solve_starts",
    "threshold",
]

_CHI2_95 = 3.841458820694124
"""95 % quantile of chi-squared with one degree of freedom."""

REACH = 12.0
"""|z| at which a parameter has all but reached its bound (6e-6 of the range away)."""


class Rule(NamedTuple):
    """How one block of residuals enters the deviance.

    ``inflation``: rows per independent row (times chi2/dof where applied);
    ``effective``: effective number of rows; ``smallest``: sum of squares at the best
    fit, zero where the noise was given.
    """

    inflation: Float[Array, ""] | float = 1.0
    effective: Float[Array, ""] | float = 1.0
    smallest: Float[Array, ""] | float = 0.0


def _stacked(model, layout, z, rows, channels, loss, rules):
    blocks = root_deviance(model, layout, z, rows, channels, loss)
    parts = [
        block / jnp.sqrt(rules[name].inflation) if name in rules else block
        for name, block in blocks.items()
    ]
    return jnp.concatenate([*parts, layout.prior_residual(z)])


@partial(jax.jit, static_argnames=("layout", "channels", "loss", "solver"))
def solve_starts(
    model, layout: Layout, starts, rows: Rows, channels, loss, rules, solver
) -> Solution:
    """Least squares from every start; rules of shape () by block name."""

    def residual(z):
        return _stacked(model, layout, z, rows, channels, loss, rules)

    return solve(residual, starts, solver)


def best_of(solution: Solution) -> int:
    """Index of the lowest finite cost, converged starts preferred."""
    cost = np.where(np.isfinite(solution.cost), solution.cost, np.inf)
    settled = np.where(solution.converged, cost, np.inf)
    best = int(np.argmin(settled))
    # An unconverged start counts only if it is lower by more than rounding.
    lowest = int(np.argmin(cost))
    return best if settled[best] <= cost[lowest] * (1 + 1e-6) + 1e-12 else lowest


def deviance(model, layout: Layout, z, rows: Rows, channels, loss, rules):
    """-2 log likelihood at z relative to the best fit, priors included (scalar)."""
    blocks = root_deviance(model, layout, z, rows, channels, loss)
    total = jnp.sum(layout.prior_residual(z) ** 2)
    for name, block in blocks.items():
        rule = rules[name]
        squares = jnp.sum(block**2)
        known = squares / rule.inflation
        safe = jnp.where(rule.smallest > 0, rule.smallest, 1.0)
        estimated = rule.effective * jnp.log(squares / safe)
        total = total + jnp.where(rule.smallest > 0, estimated, known)
    return total


@partial(jax.jit, static_argnames=("layout", "channels", "loss"))
def covariance(model, layout: Layout, z, rows: Rows, channels, loss, rules):
    """Covariance of z, shape (p, p): the inverse of the curvature of the deviance.

    The Gauss-Newton curvature J'J; with slip noise the exact Hessian, because there
    the rows are no sum of squares. Directions without information get the variance of
    a parameter spread over its whole range.
    """

    def residual(z):
        return _stacked(model, layout, z, rows, channels, loss, rules)

    if rows.nodes:
        information = jax.hessian(lambda z: residual(z) @ residual(z) / 2)(z)
    else:
        jacobian = jax.jacfwd(residual)(z)
        information = jacobian.T @ jacobian
    values, vectors = jnp.linalg.eigh(information)
    return (vectors / jnp.maximum(values, 1 / REACH**2)) @ vectors.T


@partial(jax.jit, static_argnames=("layout", "channels", "loss"))
def _profile_points(model, layout, index, values, starts, rows, channels, loss, rules):
    """Deviance minimised over all but one element, at (m,) values of that element."""

    def one(index, value, start):
        def residual(z):
            z = z.at[index].set(value)
            return _stacked(model, layout, z, rows, channels, loss, rules)

        end = damped_gauss_newton(residual, start, max_steps=60, tolerance=1e-7)
        z = end.z.at[index].set(value)
        return deviance(model, layout, z, rows, channels, loss, rules), z

    # In small batches: the slowest of a batch holds up the others, and arrays of a
    # few thousand rows stay in cache.
    return jax.lax.map(lambda a: one(*a), (index, values, starts), batch_size=8)


class Profile(NamedTuple):
    """Profile of one element of z: points (m,), their deviance, and the 95 % interval.

    ``open_low`` / ``open_high``: the deviance does not reach the threshold before the
    bound, so the data do not limit the parameter on that side.
    """

    z: np.ndarray
    deviance: np.ndarray
    low: float
    high: float
    open_low: bool
    open_high: bool


def threshold(estimated: bool, effective: float, parameters: int) -> float:
    """Deviance at the ends of a 95 % interval: chi-squared, or Student's t."""
    if not estimated:
        return _CHI2_95
    dof = max(effective - parameters, 1.0)
    return float(effective * np.log1p(stdtrit(dof, 0.975) ** 2 / dof))


_INNER = np.array([0.3, 0.7, 1.1, 1.5, 1.9, 2.3, 2.8, 3.5, 5.0])


def _offsets(std: float, reach: float) -> np.ndarray:
    """Twelve distances from the estimate: dense to 5 std, then out to the bound."""
    if not np.isfinite(std) or 6 * std >= reach:
        return reach * np.linspace(1 / 12, 1, 12)
    outer = np.geomspace(5 * std, reach, 4)[1:]
    return np.concatenate([_INNER * std, outer])


def profile_all(
    model, layout: Layout, z, cov, rows: Rows, channels, loss, rules, level: float
) -> list[Profile]:
    """Profile likelihood of every element of z, in two passes: bracket, then refine."""
    z, cov = np.asarray(z), np.asarray(cov)
    size = layout.size

    def evaluate(index, values):
        shift = cov[:, index] / np.diag(cov)[index]
        starts = z + (shift * (values - z[index])).T
        starts = jnp.asarray(np.clip(starts, -REACH, REACH))
        found, _ = _profile_points(
            model, layout, jnp.asarray(index), jnp.asarray(values), starts, rows,
            channels, loss, rules,
        )  # fmt: skip
        return np.nan_to_num(np.asarray(found), nan=np.inf)

    base = float(deviance(model, layout, jnp.asarray(z), rows, channels, loss, rules))
    sides = [(index, sign) for index in range(size) for sign in (-1, 1)]
    std = np.sqrt(np.diag(cov))
    grids = np.array(
        [
            z[i] + sign * _offsets(std[i], max(REACH - sign * z[i], 1e-3))
            for i, sign in sides
        ]
    )
    index = np.repeat([i for i, _ in sides], grids.shape[1])
    first = evaluate(index, grids.ravel()).reshape(grids.shape) - base
    brackets = [
        _bracket(z[i], grid, value, level)
        for (i, _), grid, value in zip(sides, grids, first, strict=True)
    ]
    steps = np.linspace(0, 1, grids.shape[1] + 2)[1:-1]
    fine = np.array([low + (high - low) * steps for low, high in brackets])
    second = evaluate(index, fine.ravel()).reshape(fine.shape) - base
    profiles = []
    for i in range(size):
        ends = [
            _crossing(
                z[i],
                np.concatenate([grids[2 * i + k], fine[2 * i + k]]),
                np.concatenate([first[2 * i + k], second[2 * i + k]]),
                level,
            )
            for k in (0, 1)
        ]
        both = slice(2 * i, 2 * i + 2)
        points = np.concatenate([grids[both].ravel(), fine[both].ravel(), [z[i]]])
        values = np.concatenate([first[both].ravel(), second[both].ravel(), [0.0]])
        order = np.argsort(points)
        (low, open_low), (high, open_high) = ends
        profiles.append(
            Profile(points[order], values[order], low, high, open_low, open_high)
        )
    return profiles


def _bracket(center, grid, values, level):
    """Interval of one side that holds the first crossing (or the whole side)."""
    above = np.flatnonzero(values > level)
    if len(above) == 0:
        return center, grid[-1]
    first = above[0]
    return (center if first == 0 else grid[first - 1]), grid[first]


def _crossing(center, points, values, level) -> tuple[float, bool]:
    """First crossing of the level on one side, by the root of the deviance, which is
    straight for a parabola; (the outermost point, True) where there is none."""
    order = np.argsort(np.abs(points - center))
    points = np.concatenate([[center], points[order]])
    roots = np.sqrt(np.maximum(np.concatenate([[0.0], values[order]]), 0.0))
    above = np.flatnonzero(roots > np.sqrt(level))
    if len(above) == 0:
        return float(points[-1]), True
    upto = above[0] + 1
    rising = np.maximum.accumulate(roots[:upto])
    if not np.isfinite(rising[-1]):
        return float(points[upto - 1]), False
    return float(np.interp(np.sqrt(level), rising, points[:upto])), False
