"""Least squares: optimistix, jaxopt as a second opinion, and a batched Gauss-Newton.

The only importer of optimistix and jaxopt. All three minimise the sum of squares of a
residual function from several starts and return the same record. optimistix's
Levenberg-Marquardt factorises the Jacobian; ``damped_gauss_newton`` works on the
normal equations of a handful of parameters, which is several times faster in batches
(profiles, many data sets).
"""

import warnings
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.export
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

__all__ = ["SOLVERS", "Solution", "damped_gauss_newton", "solve"]

_TOLERANCE = 1e-8
_MAX_STEPS = 200


class Solution(NamedTuple):
    """End of one start: estimate (p,), sum of squares, whether it converged, steps."""

    z: Float[Array, " p"]
    cost: Float[Array, ""]
    converged: Bool[Array, ""]
    steps: Int[Array, ""]


jax.export.register_namedtuple_serialization(
    Solution, serialized_name="tirefit.Solution"
)

Residual = Callable[[Float[Array, " p"]], tuple[Float[Array, " n"], Float[Array, " n"]]]
"""z (p,) -> (residuals, scoring weights), each (n,).

The weight is 1 where the row is an ordinary residual r. Where the square of r is the
deviance of a row (noisy slip), r carries no sign and r'r no curvature; there the weight
is r itself, before any inflation, so that weight x slope is the gradient of the row's
log likelihood, whose outer products estimate the information (Berndt, Hall, Hall &
Hausman 1974).
"""


class _State(NamedTuple):
    z: Array
    cost: Array
    normal: Array
    gradient: Array
    damping: Array
    step: Array
    done: Array


def _linearise(residual: Residual, z):
    """Cost, curvature and gradient from one pass of forward tangents."""
    values, push, weights = jax.linearize(residual, z, has_aux=True)
    jacobian = jax.vmap(push)(jnp.eye(z.size))
    weighted = jacobian * weights[None]
    return values @ values, weighted @ weighted.T, jacobian @ values


def damped_gauss_newton(
    residual: Residual, start, max_steps: int = _MAX_STEPS, tolerance=_TOLERANCE
) -> Solution:
    """Levenberg-Marquardt on the normal equations, for few parameters in batches.

    Args:
        residual: residuals and scoring weights; p up to about ten.
        start: first z, shape (p,).
        max_steps: limit of trial steps.
        tolerance: share of the cost that one undamped step could still gain; below it
            the search ends.

    A trial step is accepted only if its cost is lower, so NaN loses.
    """

    def gain(normal, gradient):
        scale = jnp.maximum(jnp.diagonal(normal), 1e-12)
        move = jnp.linalg.solve(normal + 1e-9 * jnp.diag(scale), gradient)
        return gradient @ move

    def small(cost, normal, gradient):
        return gain(normal, gradient) <= tolerance * (cost + tolerance)

    def trial(state: _State) -> _State:
        scale = jnp.maximum(jnp.diagonal(state.normal), 1e-12)
        damped = state.normal + state.damping * jnp.diag(scale)
        move = -jnp.linalg.solve(damped, state.gradient)
        # In z a parameter crosses its whole range within ten; longer steps are wild.
        move = move * jnp.minimum(1.0, 3.0 / jnp.maximum(jnp.max(jnp.abs(move)), 1e-12))
        z = state.z + move
        cost, normal, gradient = _linearise(residual, z)
        keep = partial(jnp.where, cost < state.cost)
        new = _State(
            keep(z, state.z),
            keep(cost, state.cost),
            keep(normal, state.normal),
            keep(gradient, state.gradient),
            keep(state.damping / 8, state.damping * 8),
            state.step + 1,
            state.done,
        )
        stuck = new.damping > 1e10
        return new._replace(done=small(new.cost, new.normal, new.gradient) | stuck)

    def going(state: _State):
        return ~state.done & (state.step < max_steps)

    cost, normal, gradient = _linearise(residual, start)
    state = _State(
        start, cost, normal, gradient, jnp.array(1e-4), jnp.array(0), jnp.array(False)
    )
    end = jax.lax.while_loop(going, trial, state)
    return Solution(end.z, end.cost, end.done & jnp.isfinite(end.cost), end.step)


def _ordinary(residual: Residual, start) -> Callable:
    """Residuals that a least-squares library can take, with the same minimum.

    The rows of noisy slip become sqrt(1 + r^2 - r(start)^2): the sum of squares changes
    by a constant, and near the start, where it must be, Gauss-Newton's curvature is
    that of scoring.
    """
    first, weights = residual(start)
    deviance_row = weights != 1.0

    def ordinary(z):
        values, _ = residual(z)
        # Reverse mode multiplies the branch not taken by zero: it must stay finite.
        safe = jnp.where(deviance_row, values, first)
        root = jnp.sqrt(jnp.maximum(1 + safe**2 - first**2, 1e-6))
        return jnp.where(deviance_row, root, values)

    return ordinary


def _optimistix(residual: Residual, start) -> Solution:
    import optimistix as optx

    ordinary = _ordinary(residual, start)
    solver = optx.LevenbergMarquardt(rtol=_TOLERANCE, atol=_TOLERANCE)
    solution = optx.least_squares(
        lambda z, _: ordinary(z), solver, start, max_steps=_MAX_STEPS, throw=False
    )
    values, _ = residual(solution.value)
    return Solution(
        solution.value,
        values @ values,
        solution.result == optx.RESULTS.successful,
        solution.stats["num_steps"],
    )


def _jaxopt(residual: Residual, start) -> Solution:
    ordinary = _ordinary(residual, start)
    with warnings.catch_warnings():
        # jaxopt announces at import that it is no longer maintained.
        warnings.simplefilter("ignore")
        import jaxopt

        # Its accepted and rejected steps are blended by multiplication, so a single
        # non-finite residual would stall it for good.
        solver = jaxopt.LevenbergMarquardt(
            residual_fun=lambda z: jnp.nan_to_num(ordinary(z), nan=1e6, posinf=1e6),
            maxiter=_MAX_STEPS,
            tol=1e-6,
            xtol=1e-10,
            gtol=1e-6,
        )
        z, state = solver.run(start)
    values, _ = residual(z)
    cost = values @ values
    converged = jnp.isfinite(cost) & (state.iter_num < _MAX_STEPS)
    return Solution(z, cost, converged, state.iter_num)


SOLVERS = {
    "optimistix": _optimistix,
    "jaxopt": _jaxopt,
    "gauss-newton": damped_gauss_newton,
}
"""Solver name -> (residual, start) -> Solution; each can be vmapped over starts."""


def solve(residual: Residual, starts, solver: str) -> Solution:
    """All starts at once; every field has a leading axis (starts,)."""
    return jax.vmap(lambda start: SOLVERS[solver](residual, start))(starts)
