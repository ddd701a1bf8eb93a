r"""Least squares, covariance and the level of intervals of one problem.

Everything rests on one function of z, the *deviance* D(z) = -2 log L + 2 log L(best):

* noise given: D = sum of squares / inflation, where the inflation is the number of
  rows per independent row (autocorrelation), times chi2/dof where that says that the
  given noise is too small;
* noise estimated: the scale is integrated out under the 1/sigma prior,
  D = n_eff log(S / S_min), which in a linear model gives exactly Student's t.
"""

from collections.abc import Mapping
from functools import partial
from types import ModuleType
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.special import ndtri, stdtrit

from tirefit.arrays import Scalar
from tirefit.compiled import BRIEF
from tirefit.fitting.problem.likelihood import FitProblem, Rule, blocks_and_moments, root_deviance
from tirefit.fitting.solve.least_squares import SOLVERS, Solver, directions, least_squares
from tirefit.params import Values

REACH = 12.0
"""|z| at which a parameter counts as at its bound (6e-6 of the range away)."""


def residuals(
    problem: FitProblem, z: Float[Values, " p"]
) -> tuple[Float[Array, " m"], Float[Array, " m"]]:
    """All residuals, priors last, and their scoring weights. Those of the rows are
    divided by the root of their inflation. See ``least_squares.Residual``."""
    values, weights = [], []
    for name, block in root_deviance(problem, z).items():
        values.append(block / jnp.sqrt(problem.rules[name].inflation))
        noisy = name in problem.rows.nodes
        weights.append(jax.lax.stop_gradient(block) if noisy else jnp.ones_like(block))
    pulls = problem.layout.prior_residual(z)
    values.append(pulls)
    weights.append(jnp.ones_like(pulls))
    return jnp.concatenate(values), jnp.concatenate(weights)


class Minima(NamedTuple):
    """Ends of several searches, in order: see :class:`least_squares.Solution`."""

    z: Float[Values, "m p"]
    cost: Float[Values, " m"]
    deviance: Float[Values, " m"]
    converged: Bool[Values, " m"]


@partial(jax.jit, static_argnames=("solver",))
def _minima(
    problem: FitProblem,
    starts: Array,
    index: Array,
    values: Array,
    count: Array,
    arrays: Any,
    solver: Any,
) -> Minima:
    """:func:`minima` of the first ``count`` of m searches; the others are skipped."""
    solver = eqx.combine(arrays, solver)
    blocks = len(problem.rules)
    elements = None
    if problem.layout.is_sparse:
        parts = [problem.layout.elements_of(problem.rows.run)] * blocks
        elements = jnp.concatenate([*parts, problem.layout.prior_elements])

    def search_one(k: Array, ends: Minima) -> Minima:
        def held(z: Array) -> Array:
            return z.at[index[k]].set(values[k], mode="drop")

        end = least_squares(
            lambda z: residuals(problem, held(z)),
            starts[k],
            solver,
            elements=elements,
            lower=-REACH,
            upper=REACH,
        )
        z = held(end.z)
        here = Minima(z, end.cost, deviance(problem, z), end.converged)
        return jax.tree.map(lambda all, new: all.at[k].set(new), ends, here)

    m, nowhere = len(starts), jnp.full(len(starts), jnp.nan)
    nothing = Minima(jnp.full_like(starts, jnp.nan), nowhere, nowhere, jnp.zeros(m, bool))
    return jax.lax.fori_loop(0, count, search_one, nothing)


def minima(
    problem: FitProblem,
    starts: Float[np.ndarray, "m p"],
    index: Int[np.ndarray, " m"] | None = None,
    values: Float[np.ndarray, " m"] | None = None,
    solver: Solver = "gauss-newton",
) -> Minima:
    """Least squares from several starts, with one element of each held if requested.

    One compiled program serves the starts of a fit, its rounds of noise and its profiles.

    Args:
        starts: first z of every search.
        index: element that a search holds; None: none.
        values: value at which it is held.
        solver: a name, or a least-squares solver of optimistix.
    """
    # A solver with arrays in it cannot be hashed.
    chosen = eqx.partition(SOLVERS.get(solver) if isinstance(solver, str) else solver, eqx.is_array)
    count, size = np.shape(starts)
    index = np.full(count, size) if index is None else index
    values = np.zeros(count) if values is None else values
    room, parts = max(8, 2 * size), []
    for first in range(0, count, room):
        rows = np.arange(first, min(first + room, count))
        filled = np.resize(rows, room)
        given = (np.asarray(each)[filled] for each in (starts, index, values))
        ends = _minima(problem, *given, len(rows), *chosen)
        parts.append(jax.tree.map(lambda a, n=len(rows): np.asarray(a)[:n], ends))
    return jax.tree.map(lambda *all: np.concatenate(all), *parts)


def best_of(solution: Minima) -> int:
    """Index of the lowest finite cost, converged starts preferred."""
    cost = np.where(np.isfinite(solution.cost), solution.cost, np.inf)
    settled = np.where(solution.converged, cost, np.inf)
    best = int(np.argmin(settled))
    # An unconverged start counts only if it is lower by more than rounding.
    lowest = int(np.argmin(cost))
    return best if settled[best] <= cost[lowest] * (1 + 1e-6) + 1e-12 else lowest


def _of_squares(rule: Rule, squares: Scalar, library: ModuleType) -> Scalar:
    """Deviance of a block from the sum of its squares."""
    known = squares / rule.inflation
    given = rule.smallest <= 0
    # Both branches are evaluated: the logarithm of one where the noise is given.
    ratio = library.where(given, 1.0, squares) / library.where(given, 1.0, rule.smallest)
    return library.where(given, known, rule.effective * library.log(ratio))


@jax.jit
def deviance(problem: FitProblem, z: Float[Values, " p"]) -> Float[Array, ""]:
    """-2 log likelihood at z relative to the best fit, priors included."""
    total = jnp.sum(problem.layout.prior_residual(z) ** 2)
    for name, block in root_deviance(problem, z).items():
        total = total + _of_squares(problem.rules[name], jnp.sum(block**2), jnp)
    return total


class Linearised(NamedTuple):
    """Residuals of every row at z, slopes, moments of the forces given the measured slip."""

    values: Mapping[str, Values]  # (n,) by block; Gaussian priors are the block ``prior``
    slopes: Mapping[str, Values]  # (n, p) by block
    mean: Mapping[str, Values]  # (n,) by force
    variance: Mapping[str, Values]  # (n,) by force
    unlikely: Mapping[str, Values]  # (n,) by noisy slip: -2 log likelihood of the forces


@partial(jax.jit, compiler_options=BRIEF)
def linearise(problem: FitProblem, z: Float[Values, " p"]) -> Linearised:
    """Residuals, slopes and moments at z, from one compiled program."""

    def everything(z: Array) -> tuple[dict[str, Array], list[Any]]:
        values, *rest = blocks_and_moments(problem, z)
        return values | {"prior": problem.layout.prior_residual(z)}, rest

    def push(direction: Array) -> tuple[Any, Any, Any]:
        return jax.jvp(everything, (z,), (direction,), has_aux=True)

    def spread(slopes: Array, elements: Values) -> Array:
        rows = jnp.broadcast_to(jnp.arange(len(elements))[:, None], elements.shape)
        return jnp.zeros((len(elements), z.size)).at[rows, elements].add(slopes)

    layout = problem.layout
    elements = layout.elements_of(problem.rows.run)
    each = directions(elements, z.size) if layout.is_sparse else jnp.eye(z.size)
    # One pass of forward tangents, so that the model is compiled once.
    values, slopes, rest = jax.vmap(push, out_axes=(None, -1, None))(each)
    if layout.is_sparse:
        slopes = {
            k: spread(v, layout.prior_elements if k == "prior" else elements)
            for k, v in slopes.items()
        }
    return Linearised(values, slopes, *rest)


def deviance_at(problem: FitProblem, at: Linearised) -> float:
    """:func:`deviance` where the problem is linearised, on the host."""
    squares = {name: float(np.sum(np.square(v))) for name, v in at.values.items()}
    return squares["prior"] + sum(
        float(_of_squares(rule, squares[name], np)) for name, rule in problem.rules.items()
    )


_STEP = 1e-4
"""Of z, for central differences of the slope: their error is of its square."""


def covariance(
    problem: FitProblem, z: Float[Values, " p"], at: Linearised
) -> Float[np.ndarray, "p p"]:
    """Covariance of z: the inverse of the curvature of the deviance.

    The Gauss-Newton curvature J'J; with slip noise the Hessian, because the
    deviance is then not a sum of squares.
    """
    if not problem.rows.nodes:
        return inverse_of(slope_and_curvature(problem, at)[1])
    # A program for the exact curvature takes longer to compile than the whole fit.
    steps = _STEP * np.eye(len(z))
    up, down = (
        np.array([slope_and_curvature(problem, linearise(problem, there))[0] for there in ends])
        for ends in (z + steps, z - steps)
    )
    rows = (up - down) / (2 * _STEP)
    return inverse_of((rows + rows.T) / 2)


def slope_and_curvature(
    problem: FitProblem, at: Linearised, *, of_deviance: bool = False
) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, "p p"]]:
    """Half the slope (p,) of the sum of squares over the inflation, or of the deviance, and half
    its curvature (p, p) from the slopes of the rows."""
    size = problem.layout.size
    slope, curvature = np.zeros(size), np.zeros((size, size))
    for name, slopes in at.slopes.items():
        values, slopes = np.asarray(at.values[name]), np.asarray(slopes)
        rule = problem.rules.get(name, Rule())
        weight = 1 / rule.inflation
        if of_deviance and rule.smallest > 0:
            weight = rule.effective / (values @ values)
        slope += weight * (values @ slopes)
        curvature += weight * (slopes.T @ slopes)
    return slope, curvature


def inverse_of(information: Float[np.ndarray, "p p"]) -> Float[np.ndarray, "p p"]:
    """The covariance of z from its information; an element without information is spread over
    its whole range."""
    values, vectors = np.linalg.eigh(information)
    return (vectors / np.maximum(values, 1 / REACH**2)) @ vectors.T


def half_width_95(estimated: bool, dof: float) -> float:
    """Half-width of a 95 % interval in standard deviations: normal if the noise is
    given, Student's t if it is estimated."""
    return float(stdtrit(max(dof, 1.0), 0.975) if estimated else ndtri(0.975))


def threshold(estimated: bool, effective: float, parameters: int) -> float:
    """Deviance at the ends of a 95 % interval: chi-squared, or Student's t."""
    dof = max(effective - parameters, 1.0)
    square = half_width_95(estimated, dof) ** 2
    return float(effective * np.log1p(square / dof)) if estimated else square
