"""Least squares of many coefficients: rows in blocks, priors as further residuals.

The coefficients are searched in units of their priors' spreads about the centres, u: a
prior is then the residual u itself, and the problem is scaled. Coefficients whose sign
is without effect are searched by their logarithms, for at zero a force has no slope in
them, and a least-squares search no way. Each row's force has the
gradient of all coefficients by one reverse pass, which is some five evaluations
whatever their number; forward tangents would be one each. Blocks of one size let every
file, force and stage share three programs.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from tirefit.compiled import compiled
from tirefit.fitting.mf.parts import influences
from tirefit.models import TireInputs, forces
from tirefit.models.mf import MFTire, curvatures
from tirefit.padding import pad_rows
from tirefit.params import with_values

_ROWS = (8192, 1024)
"""Of a block: each call costs as much as some 1000 rows, and the last block is filled
up. Few sizes, for each is compiled."""

_MAX_STEPS = 200
_FIRST_DAMPING, _LEAST_DAMPING, _STUCK = 1.0, 1e-6, 1e10
_GOOD, _FAIR = 0.75, 0.25
_SETTLED = 1e-6
"""Deviance that one more undamped step would gain: a thousandth of a standard error."""

_RESTS, _GAINED = 15, 1e-3
"""So many passes gained so little deviance, a thirtieth of a standard error, in all: at
an edge of the formula (a changing sign) no step is undamped."""

_LIMITED = 256
"""Points at which the curvature factors of a force are limited to one."""

_LARGEST_E, _OVER = 0.98, 0.005
"""Curvature factor from which on it costs, and how far beyond it costs one of deviance
a point: short of one, so that every reader of the coefficients draws the same curve."""


class Block(NamedTuple):
    """Rows of one force: inputs, the measured force and 1 / noise, which is zero where
    the block is only filled up; each (n,), n of ``_ROWS``."""

    force: str
    inputs: TireInputs
    observed: np.ndarray
    weight: np.ndarray


@dataclass(frozen=True)
class Problem:
    """What is searched: the rows, and which coefficients may move.

    ``tire`` holds the nominal state, the scaling factors and what is fixed; ``names``
    order u, whose units are ``spread`` about ``centre``, each (p,), of the logarithm
    over that of the centre where ``log`` (p,); ``free`` (p,) says which of them this
    stage moves. ``limits``: force -> inputs at which its curvature factors stay below
    one.
    """

    tire: MFTire
    names: tuple[str, ...]
    centre: np.ndarray
    spread: np.ndarray
    log: np.ndarray
    free: np.ndarray
    blocks: tuple[Block, ...]
    limits: Mapping[str, TireInputs] = field(default_factory=dict)

    def values(self, u) -> dict[str, float]:
        """Coefficient -> value at u (p,)."""
        return dict(zip(self.names, self.natural(u).tolist(), strict=True))

    def natural(self, u) -> np.ndarray:
        """Coefficients (p,) at u (p,)."""
        moved = self.spread * u
        raised = self.centre * np.exp(np.where(self.log, moved, 0.0))
        return np.where(self.log, raised, self.centre + moved)

    def scale(self, u) -> np.ndarray:
        """Their slopes in u (p,)."""
        return self.spread * np.where(self.log, self.natural(u), 1.0)

    def unit(self, name: str, value: float) -> float:
        """The element of u that gives a coefficient this value."""
        i = self.names.index(name)
        if self.log[i]:
            return float(np.log(value / self.centre[i]) / self.spread[i])
        return float((value - self.centre[i]) / self.spread[i])

    def with_free(self, names: Sequence[str]) -> "Problem":
        """The same, with these coefficients moved by the search."""
        return replace(self, free=np.isin(self.names, list(names)))

    def with_blocks(
        self, blocks: Sequence[Block], limits: Mapping[str, TireInputs] | None = None
    ) -> "Problem":
        """The same, of other rows."""
        return replace(self, blocks=tuple(blocks), limits=limits or {})

    def columns(self, force: str) -> tuple[tuple[str, ...], np.ndarray]:
        """Coefficients on which a force depends, and their places in u."""
        names = influences(self.tire.version, force)
        return names, np.array([self.names.index(name) for name in names])


class Minimum(NamedTuple):
    """Where a search ended: u (p,), sum of squares with that of the priors, and the
    number of passes over the rows."""

    u: np.ndarray
    cost: float
    converged: bool
    steps: int


def blocks_of(force: str, inputs: TireInputs, observed, std) -> tuple[Block, ...]:
    """Rows (n,) cut into blocks; the last one is filled with its first row.

    Args:
        std: noise of each row (n,).
    """
    rows = np.stack([*inputs, observed, 1 / std])
    blocks, start = [], 0
    while start < rows.shape[1]:
        left = rows.shape[1] - start
        size = next((size for size in _ROWS if size <= left), _ROWS[-1])
        part = rows[:, start : start + size]
        filler = np.repeat(part[:, :1], size - part.shape[1], axis=1)
        filler[-1] = 0.0
        part = np.concatenate([part, filler], axis=1)
        blocks.append(Block(force, TireInputs(*part[:-2]), part[-2], part[-1]))
        start += size
    return tuple(blocks)


def _gradients(force: str, names: tuple[str, ...], tire: MFTire, theta, inputs):
    """Force (n,) of each row, and its slope in each coefficient (p, n)."""

    def one(given, sample):
        return getattr(with_values(tire, given)(sample), force)

    given = dict(zip(names, theta, strict=True))
    value, slopes = jax.vmap(jax.value_and_grad(one), in_axes=(None, 0))(given, inputs)
    # Else the compiler works the whole formula out anew for every column.
    columns = jax.lax.optimization_barrier([slopes[name] for name in names])
    return value, jnp.stack(columns)


@compiled(static=("force", "names"), brief=True)
def _pass(force, names, tire, theta, scale, inputs, observed, weight):
    """Of a block: residuals (n,) over the noise, and their slopes in u (p, n)."""
    value, slope = _gradients(force, names, tire, theta, inputs)
    residual = (value - observed) * weight
    return residual, slope * (weight[None, :] * scale[:, None])


def _passes(problem: Problem, u: np.ndarray) -> Iterator[tuple]:
    """Every block with the places of its coefficients in u, its residuals (n,) and
    their slopes in u (p, n)."""
    natural, scale = problem.natural(u), problem.scale(u)
    for block in problem.blocks:
        names, at = problem.columns(block.force)
        residual, slope = _pass(
            block.force, names, problem.tire, jnp.asarray(natural[at]),
            jnp.asarray(scale[at]), block.inputs, block.observed, block.weight,
        )  # fmt: skip
        yield block, at, np.asarray(residual), np.asarray(slope)


@compiled(static=("force", "names"), brief=True)
def _excess(force, names, tire, theta, scale, inputs):
    """How far curvature factors exceed their limit (n,), and its slopes in u (p, n)."""

    def one(given, sample):
        largest = curvatures(with_values(tire, given), sample)[force][0]
        return jnp.maximum(largest - _LARGEST_E, 0.0) / _OVER

    given = dict(zip(names, theta, strict=True))
    value, slopes = jax.vmap(jax.value_and_grad(one), in_axes=(None, 0))(given, inputs)
    return value, jnp.stack([slopes[name] for name in names]) * scale[:, None]


def limits_of(force: str, inputs: Sequence[TireInputs]) -> dict[str, TireInputs]:
    """The points at which the curvature factors of a force are limited: some of the
    inputs (each of arrays), from the least to the largest load."""
    if force not in ("fx", "fy", "mz"):
        return {}
    columns = [np.concatenate(parts) for parts in zip(*inputs, strict=True)]
    order = np.argsort(columns[TireInputs._fields.index("fz")], kind="stable")
    some = order[np.linspace(0, len(order) - 1, _LIMITED).astype(int)]
    return {force: TireInputs(*(column[some] for column in columns))}


def _all_passes(problem: Problem, u: np.ndarray) -> Iterator[tuple]:
    """Places in u, residuals (n,), slopes (p, n): of the blocks and of the limits."""
    for _, at, residual, slopes in _passes(problem, u):
        yield at, residual, slopes
    for force, inputs in problem.limits.items():
        names, at = problem.columns(force)
        natural, scale = problem.natural(u)[at], problem.scale(u)[at]
        value, slope = _excess(
            force, names, problem.tire, jnp.asarray(natural), jnp.asarray(scale), inputs
        )
        yield at, np.asarray(value), np.asarray(slope)


def _passed(problem: Problem, u: np.ndarray, moved: np.ndarray):
    """Sum of squares, half the curvature and half the slope of the rows, at u; the
    curvature with those that ``moved`` (p,) says."""
    size = len(u)
    cost, curvature, slope = 0.0, np.zeros((size, size)), np.zeros(size)
    for at, residual, slopes in _all_passes(problem, u):
        cost += float(residual @ residual)
        chosen = moved[at]
        at, slopes = at[chosen], slopes[chosen]
        # NumPy's product of a matrix with itself takes half the time of XLA's.
        curvature[np.ix_(at, at)] += slopes @ slopes.T
        slope[at] += slopes @ residual
    return cost, curvature, slope


def row_values(
    problem: Problem, u: np.ndarray, force: str, inputs: TireInputs
) -> np.ndarray:
    """The force (n,) [N, N m] at u (p,) and inputs of arrays (n,)."""
    tire = with_values(problem.tire, problem.values(u))
    size = len(np.asarray(inputs.fz))
    step, values = _ROWS[size < _ROWS[0]], []
    for start in range(0, size, step):
        part = (pad_rows(np.asarray(c)[start : start + step], step) for c in inputs)
        values.append(np.asarray(getattr(forces(tire, TireInputs(*part)), force)))
    return np.concatenate(values)[:size]


def row_gradients(problem: Problem, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residuals over the noise (n,) of the problem's rows, and their slopes in u (n, p)
    in its order; the rows that fill a block up are left out."""
    values, slopes = [], []
    for block, at, residual, slope in _passes(problem, u):
        used = block.weight > 0
        values.append(residual[used])
        whole = np.zeros((len(values[-1]), len(u)))
        whole[:, at] = slope.T[used]
        slopes.append(whole)
    return np.concatenate(values), np.concatenate(slopes)


def propagated(
    problem: Problem, u: np.ndarray, covariance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Residuals over the noise (n,) of the problem's rows, and the variance (n,) that a
    covariance of u (p, p) gives them."""
    values, variances = [], []
    for block, at, residual, slope in _passes(problem, u):
        used = block.weight > 0
        spread = covariance[np.ix_(at, at)] @ slope
        values.append(residual[used])
        variances.append(np.einsum("pn,pn->n", slope, spread)[used])
    return np.concatenate(values), np.concatenate(variances)


def curvature_at(problem: Problem, u: np.ndarray) -> np.ndarray:
    """Half the curvature of the rows alone at u (p,), in all coefficients: (p, p)."""
    return _passed(problem, u, np.full(len(u), True))[1]


def minimise(
    problem: Problem,
    start: np.ndarray,
    max_steps: int = _MAX_STEPS,
    settled: float = _SETTLED,
) -> Minimum:
    """Levenberg-Marquardt over the free coefficients, from ``start`` (p,), until one
    more step would gain less than ``settled`` of deviance.

    A trial whose cost is not finite is refused like any that is worse. A step is damped
    in the geometric mean of two measures, the priors' (Levenberg) and the rows' own
    (Marquardt): from six starts of pure F_y both alone ended in other minima, at edges
    of the formula, from three, and this from one.
    """
    free = np.flatnonzero(problem.free)
    u = np.array(start, float)
    rows, curvature, slope = _passed(problem, u, problem.free)
    cost, steps = rows + float(u @ u), 1
    damping, stiffen = _FIRST_DAMPING, 2.0
    converged, costs = False, [cost]
    while steps < max_steps and damping < _STUCK:
        normal = curvature[np.ix_(free, free)] + np.eye(len(free))
        downhill = -(slope + u)[free]
        left = float(downhill @ np.linalg.solve(normal, downhill))
        rests = len(costs) > _RESTS and costs[-1 - _RESTS] - costs[-1] < _GAINED
        if left < settled or rests:
            converged = True
            break
        damped = normal + damping * np.diag(np.sqrt(np.diagonal(normal)))
        move = np.linalg.solve(damped, downhill)
        promised = float(move @ (2 * downhill - normal @ move))
        trial = u.copy()
        trial[free] += move
        passed = _passed(problem, trial, problem.free)
        steps += 1
        gain = cost - passed[0] - float(trial @ trial)
        share = gain / promised
        if gain > 0:
            u, (rows, curvature, slope) = trial, passed
            cost -= gain
        costs.append(cost)
        if gain > 0 and share > _FAIR:
            damping, stiffen = damping * (0.1 if share > _GOOD else 1 / 3), 2.0
        else:
            # Twice, then four, eight times: refusals in a row soon find the scale.
            damping, stiffen = damping * stiffen, 2 * stiffen
        damping = max(damping, _LEAST_DAMPING)
    return Minimum(u, cost, converged or damping >= _STUCK, steps)
