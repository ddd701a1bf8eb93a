r"""Covariance and profile likelihood around a least-squares estimate.

Everything rests on one function of z, the *deviance* D(z) = -2 log L + 2 log L(best):

* noise given: D = sum of squares / inflation, where the inflation is the number of
  rows per independent row (autocorrelation), times chi2/dof where that says that the
  given noise is too small;
* noise estimated: the scale is integrated out under the 1/sigma prior,
  D = n_eff log(S / S_min), which in a linear model gives exactly Student's t.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.special import stdtrit

from tirefit.compiled import compiled
from tirefit.fitting.layout import Layout
from tirefit.fitting.least_squares import Solution, damped_gauss_newton, solve
from tirefit.fitting.likelihood import Rows, root_deviance
from tirefit.fitting.predict import moments

__all__ = [
    "Profile",
    "Rule",
    "best_of",
    "Linearised",
    "covariance",
    "deviance",
    "linearise",
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
    """All residuals and their scoring weights, see ``least_squares.Residual``."""
    blocks = root_deviance(model, layout, z, rows, channels, loss)
    values, weights = [], []
    for name, block in blocks.items():
        inflation = rules[name].inflation if name in rules else 1.0
        values.append(block / jnp.sqrt(inflation))
        noisy = name in rows.nodes
        weights.append(jax.lax.stop_gradient(block) if noisy else jnp.ones_like(block))
    pulls = layout.prior_residual(z)
    values.append(pulls)
    weights.append(jnp.ones_like(pulls))
    return jnp.concatenate(values), jnp.concatenate(weights)


@compiled(static=("layout", "channels", "loss", "solver"))
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


@compiled(static=("layout", "channels", "loss"))
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


class Linearised(NamedTuple):
    """Residuals of every row at z, their slopes, and the moments of the forces.

    ``values`` (n,) and ``slopes`` (n, p) by block, the Gaussian priors as the block
    ``prior``; ``mean`` and ``variance`` (n,) of each force given the measured slip.
    """

    values: dict[str, Array]
    slopes: dict[str, Array]
    mean: dict[str, Array]
    variance: dict[str, Array]


jax.export.register_namedtuple_serialization(
    Linearised, serialized_name="tirefit.Linearised"
)


@compiled(static=("layout", "channels", "loss"))
def linearise(model, layout: Layout, z, rows: Rows, channels, loss) -> Linearised:
    """All that the analysis of an estimate needs of the model, in one program."""

    def blocks(z):
        found = root_deviance(model, layout, z, rows, channels, loss)
        return found | {"prior": layout.prior_residual(z)}

    mean, variance = moments(model, layout, z, rows, channels)
    return Linearised(blocks(z), jax.jacfwd(blocks)(z), mean, variance)


@compiled(static=("layout", "channels", "loss"))
def _hessian(model, layout: Layout, z, rows: Rows, channels, loss, rules):
    def half(z):
        values, _ = _stacked(model, layout, z, rows, channels, loss, rules)
        return values @ values / 2

    return jax.hessian(half)(z)


def covariance(
    model, layout: Layout, z, rows: Rows, channels, loss, rules, at: Linearised
) -> np.ndarray:
    """Covariance of z, shape (p, p): the inverse of the curvature of the deviance.

    The Gauss-Newton curvature J'J; with slip noise the exact Hessian, because there
    the rows are no sum of squares. Directions without information get the variance of
    a parameter spread over its whole range.
    """
    if rows.nodes:
        information = _hessian(model, layout, z, rows, channels, loss, rules)
    else:
        information = sum(
            slope.T @ slope / (rules[name].inflation if name in rules else 1.0)
            for name, slope in ((k, np.asarray(v)) for k, v in at.slopes.items())
        )
    values, vectors = np.linalg.eigh(np.asarray(information))
    return (vectors / np.maximum(values, 1 / REACH**2)) @ vectors.T


@compiled(static=("layout", "channels", "loss"))
def _profile_points(model, layout, index, values, starts, rows, channels, loss, rules):
    """Deviance minimised over all but one element, at (m,) values of that element."""

    def one(index, value, start):
        def residual(z):
            z = z.at[index].set(value)
            return _stacked(model, layout, z, rows, channels, loss, rules)

        end = damped_gauss_newton(residual, start, max_steps=60, tolerance=1e-7)
        z = end.z.at[index].set(value)
        return deviance(model, layout, z, rows, channels, loss, rules), z

    return jax.lax.map(lambda a: one(*a), (index, values, starts))


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


class _Side:
    """One side of a profile: the search for the distance where the deviance, whose
    root is nearly straight, reaches the level."""

    def __init__(self, center: float, sign: int, std: float, level: float):
        self.center, self.sign, self.goal = center, sign, np.sqrt(level)
        self.reach = max(REACH - sign * center, 1e-3)
        self.distances, self.roots = [0.0], [0.0]
        self.std = min(std, self.reach / 3)
        self.done = False

    def next_distance(self) -> float:
        count = len(self.distances) - 1
        if count < 2:
            return min((0.8, 1.5)[count] * self.std, self.reach)
        if self.done:
            # One point beyond the interval, for the eye.
            return min(1.3 * self.end, self.reach)
        above = [
            d for d, r in zip(self.distances, self.roots, strict=True) if r > self.goal
        ]
        if above:
            guess = np.interp(self.goal, *self._rising())
            inner = max(d for d in self.distances if d < min(above))
            # Interpolation that creeps along one end is pushed into the bracket.
            return float(
                np.clip(guess, inner + 0.05 * (min(above) - inner), min(above))
            )
        far, root = self.distances[-1], max(self.roots[-1], 1e-3)
        return float(min(far * np.clip(1.02 * self.goal / root, 1.2, 4.0), self.reach))

    def _rising(self) -> tuple[np.ndarray, np.ndarray]:
        order = np.argsort(self.distances)
        distances = np.array(self.distances)[order]
        return np.maximum.accumulate(np.array(self.roots)[order]), distances

    def add(self, distance: float, deviance: float) -> None:
        self.distances.append(distance)
        self.roots.append(float(np.sqrt(max(deviance, 0.0))))
        close = abs(self.roots[-1] - self.goal) < 3e-3 * self.goal
        exhausted = distance >= self.reach and self.roots[-1] <= self.goal
        self.done = self.done or close or exhausted

    @property
    def open(self) -> bool:
        return max(self.roots) < self.goal * (1 - 3e-3)

    @property
    def end(self) -> float:
        """Distance of the crossing, or the reach where there is none."""
        if self.open:
            return self.reach
        roots, distances = self._rising()
        return float(np.interp(self.goal, roots, distances))


_ROUNDS = 16


def profile_all(
    model, layout: Layout, z, cov, rows: Rows, channels, loss, rules, level: float
) -> list[Profile]:
    """Profile likelihood of every element of z, all sides searched together."""
    z, cov = np.asarray(z), np.asarray(cov)
    std = np.sqrt(np.diag(cov))
    sides = [_Side(z[i], s, std[i], level) for i in range(layout.size) for s in (-1, 1)]
    index = np.repeat(np.arange(layout.size), 2)
    signs = np.tile([-1, 1], layout.size)
    # How the other elements follow, at first by the covariance, then as last found.
    follow = signs[:, None] * (cov[:, index] / np.diag(cov)[index]).T
    # The first round has distance zero: the deviance of the best fit itself.
    base, distance = None, np.zeros(len(sides))
    for _ in range(_ROUNDS):
        finished = all(side.done for side in sides)
        starts = np.clip(z + follow * distance[:, None], -REACH, REACH)
        values = np.clip(z[index] + signs * distance, -REACH, REACH)
        found, ends = _profile_points(
            model, layout, index, values, starts, rows, channels, loss, rules
        )
        if base is None:
            base = float(np.min(found))
        else:
            found = np.nan_to_num(np.asarray(found) - base, nan=1e9, posinf=1e9)
            follow = (np.asarray(ends) - z) / np.maximum(distance, 1e-9)[:, None]
            for side, d, value in zip(sides, distance, found, strict=True):
                side.add(d, value)
        if finished:
            break
        distance = np.array([side.next_distance() for side in sides])
    return [_joined(z[i], sides[2 * i], sides[2 * i + 1]) for i in range(layout.size)]


def _joined(center: float, low: _Side, high: _Side) -> Profile:
    distances = np.concatenate([-np.array(low.distances), np.array(high.distances[1:])])
    roots = np.concatenate([low.roots, high.roots[1:]])
    order = np.argsort(distances)
    return Profile(
        center + distances[order], roots[order] ** 2, center - low.end,
        center + high.end, low.open, high.open,
    )  # fmt: skip
