"""Least squares over windows whose start states are eliminated one by one."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from tirefit.fitting.solve import least_squares as law
from tirefit.fitting.solve.least_squares import MAX_STEPS, Normal, NormalEquations, on_host
from tirefit.fitting.uncertainty.profile import Side
from tirefit.params import Values

_SETTLED = 1e-8  # share of the squares that one more step would take off
_AT_BOUND = 6.0
"""|z| of an element at its bound, 0.25 % of the range away, where the squares hardly change."""


class Data(NamedTuple):
    """Windows: speed (w, k), steering (w, l + k) with its lead, logged channels
    (w, k, c), NaN where they are not known, and start states (w, s)."""

    v_x: jax.Array
    steering: jax.Array
    logged: jax.Array
    start: jax.Array


_BLOCKS = 40
"""Largest number of blocks of windows of the sandwich, whose scores are independent."""


def linearised(missed: Callable[..., Any], parts: int) -> Callable[..., Any]:
    """Residuals (w, k, c) and their derivatives by z (w, k, c, p) and by the start of
    the own window (w, k, c, s), compiled."""

    def one(z: jax.Array, start: jax.Array, window: Data) -> tuple[jax.Array, jax.Array, jax.Array]:
        def both(z: jax.Array, start: jax.Array) -> tuple[jax.Array, jax.Array]:
            found = missed(z, start, window, parts)
            return found, found

        slopes, found = jax.jacfwd(both, (0, 1), has_aux=True)(z, start)
        return found, *slopes

    return jax.jit(jax.vmap(one, (None, 0, 0)))


def eliminated(
    missed: jax.Array,
    by_z: jax.Array,
    by_start: jax.Array,
    noise: jax.Array,
    damping: jax.Array | float = 0.0,
) -> tuple[jax.Array, ...]:
    """The normal equations of z without the start states: score (w, p), information
    (w, p, p), and the terms of the step of each start: (w, s) and (w, s, p).

    A start state that the car forgets quickly is hardly determined; its steps are damped.
    """
    w = len(missed)
    weight = 1 / noise[None, None]
    r = (missed * weight).reshape(w, -1)
    a = (by_z * weight[..., None]).reshape(w, r.shape[1], -1)
    b = (by_start * weight[..., None]).reshape(w, r.shape[1], -1)
    own = jnp.einsum("wms,wmt->wst", b, b)
    trace = jnp.trace(own, axis1=1, axis2=2)[:, None, None]
    eye = jnp.eye(own.shape[1])[None]
    own = own + damping * own * eye + 1e-9 * trace * eye
    step = -jnp.linalg.solve(own, jnp.einsum("wms,wm->ws", b, r)[..., None])[..., 0]
    tied = -jnp.linalg.solve(own, jnp.einsum("wms,wmp->wsp", b, a))
    rest = a + jnp.einsum("wms,wsp->wmp", b, tied)
    score = jnp.einsum("wmp,wm->wp", rest, r)
    return score, jnp.einsum("wmp,wmq->wpq", rest, a), step, tied


eliminate = jax.jit(eliminated)


class _Windows:
    """Normal equations of z whose start states follow every step of z."""

    def __init__(
        self,
        run: Callable[..., Any],
        z: jax.Array,
        starts: jax.Array,
        now: tuple[Values, ...],
        data: Data | None,
        noise: jax.Array,
        pull: Values,
    ) -> None:
        self.run, self.data, self.noise, self.pull = run, data, noise, np.asarray(pull)
        self.z, self.starts, self.now = np.asarray(z), starts, now
        self.cost, self.damping = np.inf, law.FIRST_DAMPING / law.EASE
        self.step: Any = 0.0
        self.tied: Any = None

    def __call__(self, z: np.ndarray) -> Normal:
        starts, now = self.starts, self.now
        if self.tied is not None:
            starts = starts + self.step + self.tied @ (z - self.z)
            now = self.run(z, starts, self.data)
        cost = self.squares(now[0]) + float(self.pull @ z**2)
        if cost < self.cost:
            self.z, self.starts, self.now, self.cost = z, starts, now, cost
            self.damping = max(self.damping * law.EASE, law.LEAST_DAMPING)
        else:
            self.damping /= law.EASE
        score, information, self.step, self.tied = eliminate(*self.now, self.noise, self.damping)
        missed, _, by_start = self.now
        after = missed + jnp.einsum("wkcs,ws->wkc", by_start, self.step)
        beside = self.squares(missed) - self.squares(after)
        normal = np.asarray(information.sum(axis=0)) + np.diag(self.pull)
        return Normal(cost, normal, np.asarray(score.sum(axis=0)) + self.pull * z, beside)

    def squares(self, missed: Values) -> float:
        return float(jnp.sum((missed / self.noise[None, None]) ** 2))


def minimised(
    run: Callable[..., Any],
    z: jax.Array,
    starts: jax.Array,
    now: tuple[Values, ...],
    data: Data | None,
    noise: jax.Array,
    pull: Values,
    bounds: Sequence[np.ndarray | None] = (None, None),
    tolerance: float = _SETTLED,
    most: int = MAX_STEPS,
) -> tuple[jax.Array, jax.Array, tuple[Values, ...], bool]:
    """Least squares in z within its bounds and in all start states; ``now`` is the result
    of ``run`` there. Returns the end values, and whether it converged in at most ``most``
    trials: a step would change the cost by less than ``tolerance`` of it."""
    at = _Windows(run, z, starts, now, data, noise, pull)
    solver, (lower, upper) = NormalEquations(tolerance), bounds
    end = on_host(at, z, solver, lower=lower, upper=upper, max_steps=most)
    return jnp.asarray(at.z), at.starts, at.now, end.converged


def _squares(z: jax.Array, missed: Values, noise: jax.Array, pull: Values) -> float:
    return float(jnp.sum((missed / noise[None, None]) ** 2) + pull @ z**2)


def minimised_inside(
    run: Callable[..., Any],
    z: jax.Array,
    starts: jax.Array,
    now: tuple[Values, ...],
    data: Data | None,
    noise: jax.Array,
    pull: jax.Array,
    held: np.ndarray | None = None,
    tolerance: float = _SETTLED,
) -> tuple[jax.Array, jax.Array, tuple[Values, ...], bool]:
    """As :func:`minimised`; if free elements end at a bound, which they cannot leave, also from
    the middle of their range: the lower end.

    Args:
        held: (p,) whether an element keeps its value; None: none does.
    """
    held = np.zeros(len(z), bool) if held is None else held
    bounds = np.where(held, z, -np.inf), np.where(held, z, np.inf)
    end = minimised(run, z, starts, now, data, noise, pull, bounds, tolerance)
    at_bound = (np.abs(end[0]) > _AT_BOUND) & ~held
    if at_bound.any():
        inside = jnp.where(at_bound, 0.0, end[0])
        here = run(inside, end[1], data)
        other = minimised(run, inside, end[1], here, data, noise, pull, bounds, tolerance)
        ends = sorted((end, other), key=lambda one: _squares(one[0], one[2][0], noise, pull))
        return ends[0]
    return end


def sandwich(
    missed: jax.Array, by_z: jax.Array, by_start: jax.Array, noise: jax.Array, pull: jax.Array
) -> tuple[np.ndarray, int, np.ndarray]:
    """Covariance (p, p) of z from the scores of blocks of windows; their number; and its
    diagonal over that for independent residuals (p,)."""
    score, information, *_ = eliminate(missed, by_z, by_start, noise)
    inverse = np.linalg.inv(np.asarray(information.sum(axis=0)) + np.diag(pull))
    blocks = np.array_split(np.asarray(score), min(_BLOCKS, len(score)))
    sums = np.array([block.sum(axis=0) for block in blocks])
    count = len(blocks)
    middle = count / max(count - 1, 1) * sums.T @ sums
    covariance = inverse @ (middle + np.diag(pull)) @ inverse
    return covariance, count, np.diag(covariance) / np.diag(inverse)


_POINTS = 12  # largest number of points on one side of a profile
_ROUGHLY = 1e-6  # share of the squares that one more step would take off at one of them


def profile_ends(
    run: Callable[..., Any],
    z: jax.Array,
    starts: jax.Array,
    now: tuple[Values, ...],
    data: Data | None,
    noise: jax.Array,
    pull: jax.Array,
    element: int,
    std: float,
    level: float,
) -> np.ndarray:
    """Ends (2,) of the interval of an element of z: where the squares, least over all else,
    exceed those of :func:`minimised`, which are at z, by ``level``; infinite if they never do.

    They are not quadratic in the friction of a tire whose peak is not reached: more friction
    than the windows reach changes them less and less.

    Args:
        std: standard error of the element, by which the search begins.
    """
    best, least, ends = float(z[element]), _squares(z, now[0], noise, pull), []
    held = np.arange(len(z)) == element
    for sign in (-1, 1):
        side, at, begin = Side(best, sign, std, level), z, starts
        for _ in range(_POINTS):
            distance = side.next_distance()
            at = at.at[element].set(best + sign * distance)
            given = at, begin, run(at, begin, data), data, noise, pull
            at, begin, here, _ = minimised_inside(run, *given, held, _ROUGHLY)
            side.add(distance, _squares(at, here[0], noise, pull) - least)
            if side.done:
                break
        ends.append(sign * np.inf if side.open else best + sign * side.end)
    return np.array(ends)
