"""Least squares over windows whose start states are eliminated one by one."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from tirefit.fitting.solve.least_squares import (
    EASE,
    FIRST_DAMPING,
    LEAST_DAMPING,
    MAX_STEPS,
    Normal,
    NormalEquations,
    on_host,
)
from tirefit.fitting.uncertainty.profile import Side
from tirefit.params import Values

_SETTLED = 1e-8  # share of the squares that one more step would take off
AT_BOUND = 6.0
"""|z| of an element at its bound, 0.25 % of the range away, where the squares hardly change."""


class Data(NamedTuple):
    """Windows: speed (w, k), steering (w, l + k) with its lead, logged channels
    (w, k, c), NaN where they are not known, and start states (w, s) with their standard
    errors."""

    v_x: jax.Array
    steering: jax.Array
    logged: jax.Array
    start: jax.Array
    std: jax.Array


_BLOCKS = 40
"""Largest number of blocks of windows of the sandwich, whose scores are independent."""


def linearised(missed: Callable[..., Any], parts: int) -> Callable[..., Any]:
    """Residuals (w, k, c) and their derivatives by z (w, k, c, p) and by the start of
    the own window (w, k, c, s), compiled."""

    def of_window(z: jax.Array, start: jax.Array, window: Data) -> tuple[jax.Array, ...]:
        def twice(z: jax.Array, start: jax.Array) -> tuple[jax.Array, jax.Array]:
            residual = missed(z, start, window, parts)
            return residual, residual

        slopes, residual = jax.jacfwd(twice, (0, 1), has_aux=True)(z, start)
        return residual, *slopes

    return jax.jit(jax.vmap(of_window, (None, 0, 0)))


@jax.jit
def eliminated(
    missed: jax.Array,
    by_z: jax.Array,
    by_start: jax.Array,
    noise: jax.Array,
    off: jax.Array,
    root: jax.Array,
    damping: jax.Array | float = 0.0,
) -> tuple[jax.Array, ...]:
    """The normal equations of z without the start states: score (w, p), information
    (w, p, p), and the terms of the step of each start: (w, s) and (w, s, p).

    A start state that the car forgets quickly is hardly determined; its steps are damped.

    Args:
        off: start states less measured ones, over their standard errors (w, s).
        root: one over these standard errors (w, s).
    """
    w = len(missed)
    weight = 1 / noise[None, None]
    r = (missed * weight).reshape(w, -1)
    a = (by_z * weight[..., None]).reshape(w, r.shape[1], -1)
    b = (by_start * weight[..., None]).reshape(w, r.shape[1], -1)
    r = jnp.concatenate([r, off], axis=1)
    a = jnp.pad(a, ((0, 0), (0, off.shape[1]), (0, 0)))
    b = jnp.concatenate([b, root[..., None] * jnp.eye(off.shape[1])[None]], axis=1)
    normal = jnp.einsum("wms,wmt->wst", b, b)
    trace = jnp.trace(normal, axis1=1, axis2=2)[:, None, None]
    eye = jnp.eye(normal.shape[1])[None]
    normal = normal + damping * normal * eye + 1e-9 * trace * eye
    step = -jnp.linalg.solve(normal, jnp.einsum("wms,wm->ws", b, r)[..., None])[..., 0]
    tied = -jnp.linalg.solve(normal, jnp.einsum("wms,wmp->wsp", b, a))
    rest = a + jnp.einsum("wms,wsp->wmp", b, tied)
    score = jnp.einsum("wmp,wm->wp", rest, r)
    return score, jnp.einsum("wmp,wmq->wpq", rest, a), step, tied


class Squares(NamedTuple):
    """The squares of residuals over their noise (c,), of z with the precision ``pull`` (p,), and
    of start states less ``measured`` (w, s) over ``std`` (w, s); infinite: they are free.

    ``run`` gives the residuals and their derivatives for z and the start states (w, s), as
    :func:`linearised` does.
    """

    run: Callable[[Any, Any], tuple[Values, ...]]
    noise: jax.Array
    pull: jax.Array
    measured: Values | float = 0.0
    std: Values | float = np.inf

    def held(self, starts: Values) -> tuple[jax.Array, jax.Array]:
        """Start states less measured ones, over their standard errors, and one over these."""
        root = jnp.broadcast_to(1 / jnp.asarray(self.std), starts.shape)
        return root * (starts - self.measured), root

    def of(self, missed: Values, starts: Values) -> float:
        """Those of the residuals (w, k, c) and start states alone."""
        off = self.held(starts)[0]
        return float(jnp.sum((missed / self.noise[None, None]) ** 2) + jnp.sum(off**2))

    def at(self, end: "End") -> float:
        return self.of(end.now[0], end.starts) + float(self.pull @ end.z**2)

    def eliminated(self, end: "End", damping: float = 0.0) -> tuple[jax.Array, ...]:
        """:func:`eliminated` at an end."""
        return eliminated(*end.now, self.noise, *self.held(end.starts), damping)

    def begun(self, z: Values, starts: Values) -> "End":
        """Where a search begins."""
        return End(z, starts, self.run(z, starts))


class End(NamedTuple):
    """Where a search begins or ends: z, the start states, what ``run`` gives there, and
    whether the search converged."""

    z: Any
    starts: Any
    now: tuple[Values, ...]
    converged: bool = False


class _Windows:
    """Normal equations of z whose start states follow every step of z."""

    def __init__(self, squares: Squares, start: End) -> None:
        self.squares, self.end = squares, start._replace(z=np.asarray(start.z))
        self.cost, self.damping = np.inf, FIRST_DAMPING / EASE
        self.step: Any = 0.0
        self.tied: Any = None

    def __call__(self, z: np.ndarray) -> Normal:
        squares, trial = self.squares, self.end._replace(z=z)
        if self.tied is not None:
            starts = self.end.starts + self.step + self.tied @ (z - self.end.z)
            trial = squares.begun(z, starts)
        cost = squares.at(trial)
        if cost < self.cost:
            self.end, self.cost = trial, cost
            self.damping = max(self.damping * EASE, LEAST_DAMPING)
        else:
            self.damping /= EASE
        now, pull = self.end.now, np.asarray(squares.pull)
        score, information, self.step, self.tied = squares.eliminated(self.end, self.damping)
        missed, _, by_start = now
        after = missed + jnp.einsum("wkcs,ws->wkc", by_start, self.step)
        starts = self.end.starts
        beside = squares.of(missed, starts) - squares.of(after, starts + self.step)
        normal = np.asarray(information.sum(axis=0)) + np.diag(pull)
        return Normal(cost, normal, np.asarray(score.sum(axis=0)) + pull * z, beside)


def minimised(
    squares: Squares,
    start: End,
    bounds: Sequence[np.ndarray | None] = (None, None),
    tolerance: float = _SETTLED,
    most: int = MAX_STEPS,
    rest: tuple[int, float] = (MAX_STEPS, 0.0),
) -> End:
    """The end of least squares in z within its bounds and in all start states. It has converged
    if, after at most ``most`` trials, a step would change the cost by less than ``tolerance``
    of it; ``rest`` as in :func:`on_host`."""
    at = _Windows(squares, start)
    solver, (lower, upper) = NormalEquations(tolerance), bounds
    solved = on_host(at, start.z, solver, lower=lower, upper=upper, max_steps=most, rest=rest)
    return at.end._replace(z=jnp.asarray(at.end.z), converged=solved.converged)


def minimised_inside(
    squares: Squares,
    start: End,
    held: np.ndarray | bool = False,
    rest: tuple[int, float] = (MAX_STEPS, 0.0),
) -> End:
    """As :func:`minimised`, with held elements (p,) at their value. If free ones end at a bound,
    where the squares have no slope, the search also begins in the middle of their range, and the
    lower end counts."""
    bounds = np.where(held, start.z, -np.inf), np.where(held, start.z, np.inf)
    end = minimised(squares, start, bounds, rest=rest)
    at_bound = (np.abs(end.z) > AT_BOUND) & np.logical_not(held)
    if not at_bound.any():
        return end
    inside = squares.begun(jnp.where(at_bound, 0.0, end.z), end.starts)
    return min(end, minimised(squares, inside, bounds, rest=rest), key=squares.at)


def sandwich(squares: Squares, end: End) -> tuple[np.ndarray, int, np.ndarray]:
    """Covariance (p, p) of z from the scores of blocks of windows; their number; and its
    diagonal over that for independent residuals (p,)."""
    score, information, *_ = squares.eliminated(end)
    pull = jnp.maximum(squares.pull, _LEAST_PRECISION)
    inverse = np.linalg.inv(np.asarray(information.sum(axis=0)) + np.diag(pull))
    blocks = np.array_split(np.asarray(score), min(_BLOCKS, len(score)))
    sums = np.array([block.sum(axis=0) for block in blocks])
    count = len(blocks)
    middle = count / max(count - 1, 1) * sums.T @ sums
    covariance = inverse @ (middle + np.diag(pull)) @ inverse
    return covariance, count, np.diag(covariance) / np.diag(inverse)


_LEAST_PRECISION = 1e-6
"""Smallest 1/variance of an element of z: one at its bound has no slope; its interval is wide."""

_POINTS = 8  # largest number of points on one side of a profile
_RESTS, _ROUGHLY = 3, 0.01
"""The search of a point ends where so many steps take less than this share of the level off."""


def profile_ends(
    squares: Squares, end: End, element: int, std: float, reach: float, widened: float
) -> np.ndarray:
    """Ends (2,) of the interval of an element of z: where the squares, least over all else,
    exceed those at their minimum, ``end``, by those of ``reach`` standard errors; infinite if
    they never do.

    The squares are not quadratic in the friction of a tire whose peak is not reached: the more
    friction, the less they change with it.

    Args:
        std: standard error of the element, by which the search begins.
        widened: its square over that for independent residuals, see :func:`sandwich`.
    """
    best, least, ends, level = float(end.z[element]), squares.at(end), [], reach**2 * widened
    held, rest = np.arange(len(end.z)) == element, (_RESTS, _ROUGHLY * level)
    for sign in (-1, 1):
        side, at = Side(best, sign, min(std, AT_BOUND), level), end
        for _ in range(_POINTS):
            distance = side.next_distance()
            z = at.z.at[element].set(best + sign * distance)
            at = minimised_inside(squares, squares.begun(z, at.starts), held, rest)
            side.add(distance, squares.at(at) - least)
            if side.done:
                break
        ends.append(sign * np.inf if side.open else best + sign * side.end)
    return np.array(ends)
