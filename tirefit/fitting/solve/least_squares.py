"""Least squares: the solver of every fit, and solvers of other libraries in its place.

The only importer of optimistix and jaxopt. :func:`least_squares` runs :class:`NormalEquations`, or
a least-squares solver of these libraries, in a compiled program; :func:`on_host` runs it where
NumPy code collects the normal equations of a large problem.
"""

import warnings
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float, Int, PyTree

from tirefit.compiled import BRIEF
from tirefit.params import Values
from tirefit.results import UsageError

TOLERANCE = 1e-9  # share of the cost that a step could change, at the end of a search
MAX_STEPS = 200


class Solution(NamedTuple):
    """End of a search: z (p,), sum of squares, whether it converged, steps, and the normal
    matrix (p, p) there, half the curvature of the sum; None from another library."""

    z: Any
    cost: Any
    converged: Any
    steps: Any
    normal: Any = None


Residual = Callable[[Float[Array, " p"]], tuple[Float[Array, " n"], Float[Array, " n"] | None]]
"""z (p,) -> (residuals, scoring weights), each (n,); None: all weights are 1.

The weight is 1 for an ordinary residual r. With a noisy slip the square of r is the
deviance of a row: r has no sign and r'r no curvature. The weight is then r itself,
before any inflation, so that weight x slope is the gradient of the row's log
likelihood, whose outer products estimate the information (Berndt, Hall, Hall & Hausman
1974).
"""

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
"""Factors of the damping after a good, a fair and any other trial; the last is doubled at
each further one. A factor of ten up and down oscillates at the edge of a
valley: magic-formula on ``fits/cmu_wheel`` took all 200 trials from two of eight starts."""

LEAST_DAMPING = 1e-9
"""A lower damping has no effect in rounding; this keeps a singular matrix solvable."""

STUCK = 1e9  # damping at which steps are too small to change anything: the search ends

LONGEST_STEP = 3.0
"""A parameter crosses its whole range within ten in z; longer steps are useless."""

NO_CURVATURE = 1e-9
"""Added to the diagonal, so that an element without information does not move."""


class Normal(NamedTuple):
    """Sum of squares at a point, half its curvature (p, p) and half its gradient (p,)."""

    cost: Any
    normal: Any
    gradient: Any
    beside: Any = 0.0
    """Decrease of the sum by unknowns that were eliminated and move with the next trial."""


class _State(NamedTuple):
    best: Normal
    trial: Any
    damping: Any
    stiffen: Any  # factor of the damping after the next refusal
    promised: Any  # decrease by the trial, if the residuals are linear
    done: Any


def directions(elements: Int[Values, "n q"], size: int) -> Float[Array, "q size"]:
    """Tangents (q, size) that give all derivatives in q passes: a row depends on only q
    elements of z, one in each column of ``elements``."""
    columns = jnp.broadcast_to(jnp.arange(elements.shape[1]), elements.shape)
    return jnp.zeros((elements.shape[1], size)).at[columns, elements].set(1.0)


def _linearise(
    residual: Residual, z: Float[Array, " p"], elements: Int[Array, "n q"] | None = None
) -> Normal:
    """Normal equations, from one pass of forward tangents."""
    each = jnp.eye(z.size) if elements is None else directions(elements, z.size)

    def push(direction: Array) -> tuple[Array, Array, Array | None]:
        return jax.jvp(residual, (z,), (direction,), has_aux=True)

    values, rows, weights = jax.vmap(push, out_axes=(None, 0, None))(each)
    # Otherwise the compiler recomputes every tangent for each product.
    values, rows = jax.lax.optimization_barrier((values, rows))
    weighted = rows if weights is None else rows * weights[None]
    if elements is None:
        return Normal(values @ values, weighted @ weighted.T, rows @ values)
    pairs = weighted.T[:, :, None] * weighted.T[:, None, :]
    normal = jnp.zeros((z.size, z.size))
    normal = normal.at[elements[:, :, None], elements[:, None, :]].add(pairs)
    gradient = jnp.zeros(z.size).at[elements].add(rows.T * values[:, None])
    return Normal(values @ values, normal, gradient)


def _gain(move: Array, at: Normal) -> Array:
    """Predicted decrease of the cost if the residuals are linear."""
    return at.beside - move @ (2 * at.gradient + at.normal @ move)


def at_least_a_share(size: Float[Array, " p"]) -> Float[Array, " p"]:
    """Damping of each element from the diagonal of the normal matrix, by ``LEAST_SCALE``."""
    return jnp.maximum(size, LEAST_SCALE * jnp.max(size)) + NO_CURVATURE


def _after_step(
    z: Float[Array, " p"],
    at: Normal,
    damping: Float[Array, " p"],
    allowed: Callable[[Array], Array],
    longest: float,
) -> Float[Array, " p"]:
    """z (p,) after one damped step in which no element moves by more than longest.

    Elements that would move further, or leave their range, are limited, and the step of
    the others is recomputed: near its bound an element has almost no slope and a very
    large step, which would distort the steps of the others.
    """

    def limited(move: Array) -> tuple[Array, Array]:
        asked = z + jnp.clip(move, -longest, longest)
        return allowed(asked), asked

    system = at.normal + jnp.diag(damping)
    move = -jnp.linalg.solve(system, at.gradient)
    reached, asked = limited(move)
    free = (reached == asked) & (jnp.abs(move) <= longest)
    fixed = jnp.where(free, 0.0, reached - z)
    system = jnp.where(free[:, None] & free[None, :], system, jnp.eye(z.size))
    beside = jnp.where(free, -at.gradient - at.normal @ fixed, fixed)
    return limited(jnp.linalg.solve(system, beside))[0]


class NormalEquations(eqx.Module):
    """Levenberg's method (1944) on the normal equations of some parameters.

    optimistix's Levenberg-Marquardt factorises the Jacobian, and finds the same minimum. 512 fits
    of 400 rows side by side took 34 us against 282 us a fit for the brush, and 0.83 against 5.7 ms
    for the Magic Formula, in 5 to 6 steps against 14 to 15; it compiles in half of the time.

    A trial is accepted only if its sum of squares is lower, so NaN is rejected. The start is the
    first trial, so that the residuals are compiled only once.

    Attributes:
        rtol, atol: the search ends where an undamped step would lower the sum of squares by
            less than this share of it, or this amount.
        first_damping: before the first trial; a large one stays near the start.
        scaling: the damping of each element (p,) from the diagonal of the normal matrix.
    """

    rtol: float = TOLERANCE
    atol: float = TOLERANCE**2
    first_damping: float = FIRST_DAMPING
    scaling: Callable[[Array], Array] = eqx.field(default=at_least_a_share, static=True)

    def begin(self, z: Float[Values, " p"]) -> _State:
        """State before the first trial, which is z."""
        # The start has no predicted decrease, so its share is infinite.
        nothing = Normal(np.inf, np.eye(z.size), np.zeros(z.size), 0.0)
        return _State(nothing, z, self.first_damping, STIFFEN, 1.0, False)

    def advance(
        self,
        z: Array,
        state: _State,
        equations: Normal,
        lower: Values | float | None = None,
        upper: Values | float | None = None,
    ) -> tuple[Array, _State]:
        """(z, state) after the normal ``equations`` at the trial: the better of trial
        and z, the damping that follows from it, and the next trial."""
        best = state.best
        better, share = equations.cost < best.cost, (best.cost - equations.cost) / state.promised
        keep = partial(jax.tree.map, partial(jnp.where, better))
        z, best = keep(state.trial, z), keep(equations, best)
        eased = jnp.where(share > GOOD, EASE, EASE_A_LITTLE)
        fair = better & (share > FAIR)
        damping = state.damping * jnp.where(fair, eased, state.stiffen)
        damping = jnp.maximum(damping, LEAST_DAMPING)
        stiffen = jnp.where(fair, STIFFEN, 2 * state.stiffen)
        limits = partial(jnp.clip, min=lower, max=upper)
        size = self.scaling(jnp.diagonal(best.normal))
        whole = _after_step(z, best, LEAST_DAMPING * size, limits, jnp.inf)
        settled = jnp.abs(_gain(whole - z, best)) <= self.rtol * best.cost + self.atol
        trial = _after_step(z, best, damping * size, limits, LONGEST_STEP)
        promised = _gain(trial - z, best)
        done = settled | (damping > STUCK)
        return z, _State(best, trial, damping, stiffen, promised, done)


_advance = jax.jit(NormalEquations.advance, compiler_options=BRIEF)


def advanced(
    solver: NormalEquations,
    z: Values,
    state: _State,
    equations: Normal,
    lower: Values | float | None,
    upper: Values | float | None,
) -> tuple[Array, _State]:
    """:meth:`NormalEquations.advance`, compiled, for NumPy code."""
    # One type of every number: one compiled program.
    known = jax.tree.map(np.asarray, (z, state, equations))
    return _advance(solver, *known, lower, upper)


def on_host(
    linearise: Callable[[np.ndarray], Normal],
    start: Float[Values, " p"],
    solver: NormalEquations | None = None,
    *,
    lower: Values | float | None = None,
    upper: Values | float | None = None,
    max_steps: int = MAX_STEPS,
    rest: tuple[int, float] = (MAX_STEPS, 0.0),
) -> Solution:
    """Least squares from ``start`` (p,), of a function that gives the normal equations.

    Args:
        rest: the search also ends if this number of steps gained less than this in all.
    """
    solver, rests = solver or NormalEquations(), False
    z: Values = np.asarray(start, float)
    costs: list[float] = []
    state = solver.begin(z)
    while len(costs) < max_steps and not (state.done or rests):
        equations = linearise(np.asarray(state.trial))
        z, state = advanced(solver, z, state, equations, lower, upper)
        costs.append(float(state.best.cost))
        rests = len(costs) > rest[0] and costs[-1 - rest[0]] - costs[-1] < rest[1]
    ended = bool(state.done or rests) and np.isfinite(costs[-1])
    return Solution(np.asarray(z), costs[-1], ended, len(costs), np.asarray(state.best.normal))


def _jaxopt(residual: Callable[[Array], Array], start: Array) -> tuple[Array, Array, Array]:
    with warnings.catch_warnings():
        # jaxopt announces at import that it is no longer maintained.
        warnings.simplefilter("ignore")
        import jaxopt

        # Its accepted and rejected steps are blended by multiplication, so a single
        # non-finite residual would stall it for good.
        solver = jaxopt.LevenbergMarquardt(
            residual_fun=lambda z: jnp.nan_to_num(residual(z), nan=1e6, posinf=1e6),
            maxiter=MAX_STEPS,
            tol=1e-6,
            xtol=1e-10,
            gtol=1e-6,
        )
        z, state = solver.run(start)
    return z, state.iter_num < MAX_STEPS, state.iter_num


Solver = NormalEquations | optx.AbstractLeastSquaresSolver[PyTree, PyTree, PyTree, PyTree] | str
SOLVERS: dict[str, Solver] = {
    "gauss-newton": NormalEquations(),
    "optimistix": optx.LevenbergMarquardt(rtol=1e-8, atol=1e-8),
    "jaxopt": "jaxopt",
}
"""Solver by its name in ``fit.toml``; the last has another interface."""


def solver_name(solver: object) -> str:
    """Name of a solver in results.

    Raises:
        UsageError: neither a name nor a least-squares solver of optimistix.
    """
    if isinstance(solver, str) and solver in SOLVERS:
        return solver
    if isinstance(solver, optx.AbstractLeastSquaresSolver):
        return type(solver).__name__
    given = solver.__name__ + " itself" if isinstance(solver, type) else repr(solver)
    remedy = f"valid: {', '.join(SOLVERS)}, or a least-squares solver of optimistix"
    raise UsageError(
        f"solver is {given}", remedy + ", such as optx.LevenbergMarquardt(rtol=1e-8, atol=1e-8)"
    )


def least_squares(
    residual: Residual,
    start: Float[Array, " p"],
    solver: Solver = "gauss-newton",
    max_steps: int = MAX_STEPS,
    *,
    elements: Int[Array, "n q"] | None = None,
    lower: Values | float | None = None,
    upper: Values | float | None = None,
) -> Solution:
    """Least squares from a start, by any solver; can be compiled and vmapped.

    Args:
        residual: residuals and scoring weights, which only :class:`NormalEquations` uses: the
            other solvers get no rows with noisy slips.
        start: first z.
        solver: a name of :data:`SOLVERS`, or a solver.
        max_steps: largest number of trials, including the start.
        elements: of z that each residual depends on; all if None. For :class:`NormalEquations`.
        lower, upper: smallest and largest z (p,) of a trial of :class:`NormalEquations`.
    """
    chosen: Any = SOLVERS[solver] if isinstance(solver, str) else solver
    if isinstance(chosen, NormalEquations):

        def step(carry: tuple[Array, _State, Array]) -> tuple[Array, _State, Array]:
            z, state, steps = carry
            equations = _linearise(residual, state.trial, elements)
            return *chosen.advance(z, state, equations, lower, upper), steps + 1

        first = jax.tree.map(jnp.asarray, (start, chosen.begin(start), 0))
        z, state, steps = jax.lax.while_loop(
            lambda carry: ~carry[1].done & (carry[2] < max_steps), step, first
        )
        converged = state.done & jnp.isfinite(state.best.cost)
        return Solution(z, state.best.cost, converged, steps, state.best.normal)

    def values(z: Array, _: None = None) -> Array:
        return residual(z)[0]

    if isinstance(chosen, str):
        z, converged, steps = _jaxopt(values, start)
    else:
        end: Any = optx.least_squares(values, chosen, start, max_steps=max_steps, throw=False)
        converged = end.result == optx.RESULTS.successful
        z, steps = end.value, end.stats["num_steps"]
    cost = jnp.sum(values(z) ** 2)
    return Solution(z, cost, jnp.asarray(converged) & jnp.isfinite(cost), steps)
