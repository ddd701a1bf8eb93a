"""Least squares of many coefficients: rows in blocks, priors as further residuals.

The search variable u is the coefficient minus the centre of its prior, over the spread
of the prior, so that a prior is the residual u itself. A coefficient whose sign has no
effect is searched by its logarithm: at zero the force has no slope in it. One reverse
pass per row gives the gradient of its force at the cost of about five evaluations;
forward tangents would cost one evaluation per coefficient.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tirefit.compiled import BRIEF
from tirefit.fitting.mf.parts import influences
from tirefit.fitting.solve.least_squares import (
    MAX_STEPS,
    Normal,
    NormalEquations,
    Solution,
    on_host,
)
from tirefit.models import TireInputs, forces
from tirefit.models.mf import MFTire, curvatures
from tirefit.padding import pad_rows
from tirefit.params import Values, with_values

_ROWS = (8192, 1024)
"""Numbers of rows of a block, of many and of few rows: few sizes, as each is compiled. A
call costs as much as about 1000 rows."""

_FIRST_DAMPING = 10.0  # of the search; the first trial has a tenth of it
_SETTLED = 1e-6  # least gain in deviance of one more undamped step: 0.001 of a standard error
_REST = 15, 1e-3
"""The search ends if this number of passes gained less than this deviance (a thirtieth
of a standard error) in all: at a kink of the formula every step stays damped."""

_LIMITED = 256  # number of points at which the curvature factors of a force are limited
_LARGEST_E, _OVER = 0.98, 0.005
"""Curvature factor above which a penalty applies, and the excess that costs one of
deviance per point. The limit is below one so that every reader of the coefficients
draws the same curve, whether it limits E to one or not."""


class Block(NamedTuple):
    """Rows of one force, or points at which its curvature factors are limited; (n,) each."""

    force: str
    inputs: TireInputs
    observed: np.ndarray
    weight: np.ndarray  # 1 / noise, zero in padding rows
    is_limit: bool = False  # the residual is the excess of the curvature factors


@dataclass(frozen=True)
class Problem:
    """A least-squares problem: the rows, and the coefficients that may move."""

    tire: MFTire  # nominal state, scaling factors, fixed coefficients
    names: tuple[str, ...]  # order of u
    centre: np.ndarray  # (p,) of the priors
    spread: np.ndarray  # (p,) of the priors
    log: np.ndarray  # (p,) where u is log(coefficient / centre)
    free: np.ndarray  # (p,) coefficients that this stage moves
    blocks: tuple[Block, ...]

    def values(self, u: np.ndarray) -> dict[str, float]:
        """Coefficient -> value at u (p,)."""
        return dict(zip(self.names, self.natural(u).tolist(), strict=True))

    def natural(self, u: np.ndarray) -> np.ndarray:
        """Coefficients (p,) at u (p,)."""
        raised = self.centre * np.exp(np.where(self.log, self.spread * u, 0.0))
        return np.where(self.log, raised, self.centre + self.spread * u)

    def scale(self, u: np.ndarray) -> np.ndarray:
        """Derivatives (p,) of the coefficients in u."""
        return self.spread * np.where(self.log, self.natural(u), 1.0)

    def started(self, u: np.ndarray, values: Mapping[str, float]) -> np.ndarray:
        """u (p,) with the free coefficients at these values; none has a logarithm."""
        given = np.array([values.get(name, np.nan) for name in self.names])
        moved = (given - self.centre) / self.spread
        return np.where(self.free & np.isfinite(given), moved, u)

    def with_free(self, names: Collection[str]) -> "Problem":
        """The same problem with exactly these coefficients free."""
        return replace(self, free=np.isin(self.names, list(names)))


def _padded(columns: np.ndarray) -> Iterator[np.ndarray]:
    """Columns (k, n) cut into parts of one size; the last is padded with its first row."""
    size = _ROWS[columns.shape[1] < _ROWS[0]]
    for start in range(0, columns.shape[1], size):
        yield pad_rows(columns[:, start : start + size].T, size).T


def blocks_of(
    force: str, inputs: TireInputs, observed: np.ndarray, std: np.ndarray
) -> tuple[Block, ...]:
    """Cut rows (n,) into blocks of one size; the last is padded with rows of no weight.

    Args:
        std: standard deviation of each row (n,).
    """
    blocks, left = [], len(observed)
    for *columns, of_force, weight in _padded(np.stack([*inputs, observed, 1 / std])):
        weight = np.where(np.arange(len(weight)) < left, weight, 0.0)
        blocks.append(Block(force, TireInputs(*columns), of_force, weight))
        left -= len(weight)
    return tuple(blocks)


@partial(jax.jit, static_argnames=("force", "is_limit", "names"), compiler_options=BRIEF)
def _pass(
    force: str,
    is_limit: bool,
    names: tuple[str, ...],
    tire: MFTire,
    theta: Values,
    scale: Values,
    inputs: TireInputs,
    observed: Values,
    weight: Values,
) -> tuple[Float[Array, " n"], Float[Array, "p n"]]:
    """Residuals (n,) of a block over the noise, and their derivatives in u (p, n)."""

    def at_row(given: dict[str, Array], sample: TireInputs) -> Array:
        changed = with_values(tire, given)
        if not is_limit:
            return getattr(changed(sample), force)
        largest = curvatures(changed, sample)[force][0]
        return jnp.maximum(largest - _LARGEST_E, 0.0) / _OVER

    given = dict(zip(names, theta, strict=True))
    value, slopes = jax.vmap(jax.value_and_grad(at_row), in_axes=(None, 0))(given, inputs)
    # Without the barrier the compiler evaluates the formula again for every column.
    columns = jax.lax.optimization_barrier([slopes[name] for name in names])
    residual = (value - observed) * weight
    return residual, jnp.stack(columns) * (weight[None, :] * scale[:, None])


def _passes(
    problem: Problem, u: np.ndarray
) -> Iterator[tuple[Block, np.ndarray, np.ndarray, np.ndarray]]:
    """For every block: the block, the indices in u of its coefficients, its residuals
    (n,) and their derivatives (p, n)."""
    natural, scale = problem.natural(u), problem.scale(u)
    for block in problem.blocks:
        names = influences(problem.tire.version, block.force)
        at = np.array([problem.names.index(name) for name in names])
        rows = block.inputs, block.observed, block.weight
        given = names, problem.tire, natural[at], scale[at]
        residual, slope = _pass(block.force, block.is_limit, *given, *rows)
        yield block, at, np.asarray(residual), np.asarray(slope)


def limit_of(force: str, inputs: Sequence[TireInputs]) -> list[Block]:
    """The points at which the curvature factors of a force are limited: some of the
    inputs (of arrays), evenly taken in the order of load; none for M_x and M_y."""
    if force not in ("fx", "fy", "mz"):
        return []
    joined = TireInputs(*(np.concatenate(parts) for parts in zip(*inputs, strict=True)))
    order = np.argsort(joined.fz, kind="stable")
    some = order[np.linspace(0, len(order) - 1, _LIMITED).astype(int)]
    points = TireInputs(*(np.asarray(column)[some] for column in joined))
    return [Block(force, points, np.zeros(_LIMITED), np.ones(_LIMITED), is_limit=True)]


def normal_equations(
    problem: Problem, u: np.ndarray, moved: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """Sum of squares of the rows at u, and half its curvature and half its gradient in
    the coefficients ``moved`` (p,)."""
    size = len(u)
    cost, curvature, slope = 0.0, np.zeros((size, size)), np.zeros(size)
    for _, at, residual, slopes in _passes(problem, u):
        cost += float(residual @ residual)
        chosen = moved[at]
        at, slopes = at[chosen], slopes[chosen]
        # NumPy's product of a matrix with its transpose is twice as fast as XLA's.
        curvature[np.ix_(at, at)] += slopes @ slopes.T
        slope[at] += slopes @ residual
    return cost, curvature, slope


def row_values(problem: Problem, u: np.ndarray, force: str, inputs: TireInputs) -> np.ndarray:
    """The force (n,) [N, N m] at u (p,) and inputs of arrays (n,)."""
    tire = with_values(problem.tire, problem.values(u))
    parts = (forces(tire, TireInputs(*part)) for part in _padded(np.stack(inputs)))
    values = np.concatenate([np.asarray(getattr(part, force)) for part in parts])
    return values[: np.size(inputs.fz)]


def row_gradients(problem: Problem, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residuals (n,) of the problem's rows over the noise, and their derivatives in u
    (n, p); padding rows and limits are omitted."""
    parts = []
    for block, at, residual, slope in _passes(problem, u):
        whole = np.zeros((len(u) + 1, len(residual)))
        whole[at], whole[-1] = slope, residual
        parts.append(whole[:, (block.weight > 0) & (not block.is_limit)])
    joined = np.concatenate(parts, axis=1).T
    return joined[:, -1], joined[:, :-1]


def propagated(
    problem: Problem, u: np.ndarray, covariance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Residuals (n,) of the problem's rows over the noise, and their variance (n,) for
    a covariance of u (p, p)."""
    parts = []
    for block, at, residual, slope in _passes(problem, u):
        variance = np.einsum("pn,pn->n", slope, covariance[np.ix_(at, at)] @ slope)
        parts.append(np.stack([residual, variance])[:, block.weight > 0])
    residuals, variances = np.concatenate(parts, axis=1)
    return residuals, variances


def _between(size: Array) -> Array:
    """Damping by the geometric mean of that of the priors (Levenberg) and that of the rows
    (Marquardt). Of six starts of pure F_y, either one alone ended in another minimum, at a
    kink of the formula, from three, and the mean from one."""
    return jnp.sqrt(size)


def minimise(
    problem: Problem, start: np.ndarray, max_steps: int = MAX_STEPS, settled: float = _SETTLED
) -> Solution:
    """Least squares over the free coefficients, from ``start`` (p,), until one more step would
    gain less than ``settled`` of deviance."""

    def normal(u: np.ndarray) -> Normal:
        rows, curvature, slope = normal_equations(problem, u, problem.free)
        downhill = np.where(problem.free, slope + u, 0.0)
        return Normal(rows + float(u @ u), curvature + np.eye(len(u)), downhill)

    solver = NormalEquations(0.0, settled, first_damping=_FIRST_DAMPING, scaling=_between)
    return on_host(normal, start, solver, max_steps=max_steps, rest=_REST)
