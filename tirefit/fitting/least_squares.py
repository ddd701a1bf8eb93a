"""Least squares: our Gauss-Newton, and optimistix and jaxopt to check it.

The only importer of optimistix and jaxopt. All three minimise the sum of squares of a
residual function and return the same record; :func:`damped_gauss_newton` also serves
the profiles, the batches of fits and the refits of a diagnosis.
"""

import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

TOLERANCE = 1e-9  # share of the cost that a step could change, at the end of a search
MAX_STEPS = 200


class Solution(NamedTuple):
    """End of one start: estimate (p,), sum of squares, whether it converged, steps."""

    z: Float[Array, " p"]
    cost: Float[Array, ""]
    converged: Bool[Array, ""]
    steps: Int[Array, ""]


Residual = Callable[[Float[Array, " p"]], tuple[Float[Array, " n"], Float[Array, " n"]]]
"""z (p,) -> (residuals, scoring weights), each (n,).

The weight is 1 for an ordinary residual r. With a noisy slip the square of r is the
deviance of a row: r has no sign and r'r no curvature. The weight is then r itself,
before any inflation, so that weight x slope is the gradient of the row's log
likelihood, whose outer products estimate the information (Berndt, Hall, Hall & Hausman
1974).
"""


class Minimum(NamedTuple):
    """End of :func:`damped_gauss_newton`: z (p,), its sum of squares, and the normal
    matrix (p, p) there, half the curvature of the sum of squares."""

    z: Float[Array, " p"]
    cost: Float[Array, ""]
    normal: Float[Array, "p p"]
    converged: Bool[Array, ""]
    steps: Int[Array, ""]


class _State(NamedTuple):
    best: Minimum
    gradient: Float[Array, " p"]
    trial: Float[Array, " p"]
    damping: Float[Array, ""]
    promised: Float[Array, ""]
    done: Bool[Array, ""]


FIRST_DAMPING = 1e-3
"""Share of the diagonal added to the normal matrix, before the first trial."""

LEAST_SCALE = 0.1
"""Smallest damping of any element, as a share of the largest element of the diagonal.
Without it a poorly determined element runs ahead along a curved valley: of eight starts
on ``fits/lugre_figure_11`` one converged in 200 trials; with 0.1 four do. With 0.3 all
do, but d of a brush-d creeps to its bound."""

GOOD, FAIR = 0.75, 0.25
"""Shares of the predicted decrease above which a trial is good, or fair."""

EASE, EASE_A_LITTLE, STIFFEN = 1 / 10, 1 / 3, 2.0
"""Factors of the damping after a good, a fair and any other trial. A factor of ten up
and down oscillates at the edge of a valley: magic-formula on ``fits/cmu_wheel`` took
all 200 trials from two of eight starts; with these it takes 51 to 80 from each."""

LEAST_DAMPING = 1e-9
"""A lower damping has no effect in rounding; this keeps a singular matrix solvable."""

STUCK = 1e9  # damping at which steps are too small to change anything: the search ends

LONGEST_STEP = 3.0
"""A parameter crosses its whole range within ten in z; longer steps are useless."""

NO_CURVATURE = 1e-9
"""Added to the diagonal, so that an element without information does not move."""


def directions(elements: Int[Array, "n q"], size: int) -> Float[Array, "q size"]:
    """Tangents (q, size) that give all derivatives in q passes: a row depends on only q
    elements of z, one in each column of ``elements``."""
    columns = jnp.broadcast_to(jnp.arange(elements.shape[1]), elements.shape)
    return jnp.zeros((elements.shape[1], size)).at[columns, elements].set(1.0)


def _linearise(residual: Residual, z: Float[Array, " p"], elements=None):
    """Cost, normal matrix and gradient from one pass of forward tangents."""
    each = jnp.eye(z.size) if elements is None else directions(elements, z.size)

    def push(direction):
        return jax.jvp(residual, (z,), (direction,), has_aux=True)

    values, rows, weights = jax.vmap(push, out_axes=(None, 0, None))(each)
    # Otherwise the compiler recomputes every tangent for each product.
    values, rows = jax.lax.optimization_barrier((values, rows))
    weighted = rows * weights[None]
    if elements is None:
        return values @ values, weighted @ weighted.T, rows @ values
    pairs = weighted.T[:, :, None] * weighted.T[:, None, :]
    normal = jnp.zeros((z.size, z.size))
    normal = normal.at[elements[:, :, None], elements[:, None, :]].add(pairs)
    gradient = jnp.zeros(z.size).at[elements].add(rows.T * values[:, None])
    return values @ values, normal, gradient


def _anywhere(z: Float[Array, " p"]) -> Float[Array, " p"]:
    return z


def _after_step(z, normal, gradient, damping, allowed: Callable, longest: float):
    """z (p,) after one damped step in which no element moves by more than longest.

    Elements that would move further, or leave their range, are limited, and the step of
    the others is recomputed: near its bound an element has almost no slope and a very
    large step, which would distort the steps of the others.
    """

    def limited(move):
        asked = z + jnp.clip(move, -longest, longest)
        return allowed(asked), asked

    size = jnp.diagonal(normal)
    size = jnp.maximum(size, LEAST_SCALE * jnp.max(size)) + NO_CURVATURE
    system = normal + damping * jnp.diag(size)
    move = -jnp.linalg.solve(system, gradient)
    reached, asked = limited(move)
    free = (reached == asked) & (jnp.abs(move) <= longest)
    fixed = jnp.where(free, 0.0, reached - z)
    system = jnp.where(free[:, None] & free[None, :], system, jnp.eye(z.size))
    beside = jnp.where(free, -gradient - normal @ fixed, fixed)
    return limited(jnp.linalg.solve(system, beside))[0]


def _gain(move, normal, gradient):
    """Predicted decrease of the cost if the residuals are linear."""
    return -move @ (2 * gradient + normal @ move)


def damped_gauss_newton(
    residual: Residual,
    start: Float[Array, " p"],
    *,
    elements: Int[Array, "n q"] | None = None,
    allowed: Callable = _anywhere,
    max_steps: int = MAX_STEPS,
) -> Minimum:
    """Levenberg-Marquardt on the normal equations of a handful of parameters.

    Used because it is faster here than optimistix's Levenberg-Marquardt, which factorises the
    Jacobian, at the same minimum. 512 fits of 400 rows, time per fit on two shared cores, median
    costs equal to eight digits for the brush: under vmap (64 at once) 34 us against 282 us for the
    brush and 0.83 ms against 5.7 ms for the Magic Formula; one after the other 53 against 211 us
    and 0.28 against 0.55 ms. It takes 5 to 6 steps against 14 to 15, and half as long to compile
    (0.8 to 1.5 s against 1.4 to 3.1 s).

    Args:
        residual: residuals and scoring weights; p up to about ten.
        start: first z.
        elements: elements of z that each residual depends on, or None for all.
        allowed: maps a trial z to the nearest permitted one.
        max_steps: largest number of trials, including the start.

    A trial is accepted only if its cost is lower, so NaN is rejected. The start is the
    first trial, so that the residuals are compiled only once.
    """

    def step(state: _State) -> _State:
        best = state.best
        cost, normal, gradient = _linearise(residual, state.trial, elements)
        better, share = cost < best.cost, (best.cost - cost) / state.promised

        def keep(new: Array, old: Array) -> Array:
            return jnp.where(better, new, old)

        z, cost = keep(state.trial, best.z), keep(cost, best.cost)
        normal, gradient = keep(normal, best.normal), keep(gradient, state.gradient)
        # The start has no predicted decrease, so its share is infinite.
        eased = jnp.where(share > GOOD, EASE, EASE_A_LITTLE)
        fair = better & (share > FAIR)
        damping = state.damping * jnp.where(fair, eased, STIFFEN)
        damping = jnp.maximum(damping, LEAST_DAMPING)
        ahead = z, normal, gradient
        whole = _after_step(*ahead, LEAST_DAMPING, allowed, jnp.inf)
        settled = jnp.abs(_gain(whole - z, normal, gradient)) <= (TOLERANCE * cost + TOLERANCE**2)
        trial = _after_step(*ahead, damping, allowed, LONGEST_STEP)
        promised = _gain(trial - z, normal, gradient)
        done = settled | (damping > STUCK)
        best = Minimum(z, cost, normal, done & jnp.isfinite(cost), best.steps + 1)
        return _State(best, gradient, trial, damping, promised, done)

    def going(state: _State):
        return ~state.done & (state.best.steps < max_steps)

    size, no = start.size, jnp.array(False)
    nothing = Minimum(start, jnp.array(jnp.inf), jnp.eye(size), no, jnp.array(0))
    one = jnp.array(1.0)
    first = _State(nothing, jnp.zeros(size), start, FIRST_DAMPING * one, one, no)
    return jax.lax.while_loop(going, step, first).best


def _ordinary(residual: Residual, start) -> Callable:
    """Residuals that a least-squares library can take, with the same minimum.

    Rows with noisy slip become sqrt(1 + r^2 - r(start)^2): the sum of squares changes by
    a constant, and near the start Gauss-Newton has the curvature of scoring.
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
    import optimistix as optx  # slow to import, and for this solver alone

    ordinary = _ordinary(residual, start)
    solver: optx.LevenbergMarquardt[Array, Array, Any] = optx.LevenbergMarquardt(
        rtol=1e-8, atol=1e-8
    )
    solution: optx.Solution[Array, Any] = optx.least_squares(
        lambda z, _: ordinary(z), solver, start, max_steps=MAX_STEPS, throw=False
    )
    values, _ = residual(solution.value)
    return Solution(
        solution.value,
        values @ values,
        jnp.asarray(solution.result == optx.RESULTS.successful),
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
            maxiter=MAX_STEPS,
            tol=1e-6,
            xtol=1e-10,
            gtol=1e-6,
        )
        z, state = solver.run(start)
    values, _ = residual(z)
    cost = values @ values
    converged = jnp.isfinite(cost) & (state.iter_num < MAX_STEPS)
    return Solution(z, cost, converged, state.iter_num)


def _gauss_newton(residual: Residual, start) -> Solution:
    end = damped_gauss_newton(residual, start)
    return Solution(end.z, end.cost, end.converged, end.steps)


SOLVERS = {"gauss-newton": _gauss_newton, "optimistix": _optimistix, "jaxopt": _jaxopt}
"""Solver name -> (residual, start) -> Solution; each can be vmapped over starts."""


def solve(residual: Residual, starts, solver: str) -> Solution:
    """All starts at once; every field has a leading axis (starts,)."""
    return jax.vmap(lambda start: SOLVERS[solver](residual, start))(starts)
