r"""Integral over the true slip of a row whose slip is measured with noise.

The likelihood of a row is :math:`p = \int N(F \mid f(s), \sigma) N(s_i \mid s, \tau) g(s) ds`
with g the density of the true slips, which is estimated
(:func:`tirefit.fitting.problem.slip_noise.slip_density`). Between two nodes the force and the
density are taken as linear in the slip, so that the product of the normal densities has closed
integrals. Their cost does not depend on the noise of the force, which may be far smaller than
the change of the force between two nodes.

Where the noise of the slip changes the force by much more than the noise of the force, each
force shows the true slip of its row closely. The distribution of the forces then shows details
of g that a smooth density does not have, and p is wrong. The likelihood of the measured slip
for the force, :math:`p / \int N(F \mid f(s), \sigma) g(s) ds`, depends on g little there, and
takes its place: in the limit of an exact force it is that of a regression of the measured slip
on the slip that belongs to the force.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tirefit.params import Values

_HALF = np.array([0.5, 1.0, 1.5, 2.0, 2.5, 3.25, 4.5, 6.5])
OFFSETS = np.concatenate([-_HALF[::-1], [0.0], _HALF])
"""Nodes around the measured slip, in slip standard deviations: a row beyond the last one is
as rare as 1e-10."""
_APART = 1e-3
"""Slip standard deviations by which two nodes of a row differ at least."""
_SLIGHT = 1e-3
"""Slope, per width of a cell, by which the integral over an unmeasured slip falls: no cell
changes by more than 1e-6, and a constant force has a finite integral."""

_ERFCX = (
    0.22567583479, 0.22567586005, 0.20761373141, 0.17173925767, 0.11900846725, 0.08391580273,
    -0.04689385451, 0.13755961386, -0.23552577026, 0.14044603484, -0.02921498401,
)  # fmt: skip
"""Coefficients of erfcx(x) / t in t = 2.5 / (2.5 + x), of least largest relative error."""


class SlipNodes(NamedTuple):
    """Slips between which the integral of each row is closed."""

    slip: Float[Array, "n q"]  # rising along a row
    density: Float[Array, "n q"]  # of the true slips, up to a factor
    of_force: Float[Array, ""] | None = None  # not None: the likelihood of the slip for the force


def slips_of_nodes(
    slip: np.ndarray, std: np.ndarray, everywhere: np.ndarray | None = None
) -> Float[np.ndarray, "n q"]:
    """Slips of the nodes of rows with measured slips (n,) of noise std (n,).

    Args:
        everywhere: (k,) slips that are nodes of every row, for an integral over all slips.
    """
    nodes = slip[:, None] + std[:, None] * OFFSETS
    if everywhere is None:
        return nodes
    every = np.broadcast_to(everywhere, (len(slip), len(everywhere)))
    nodes = np.sort(np.concatenate([nodes, every], axis=1), axis=1)
    apart = np.maximum(np.diff(nodes, axis=1), _APART * std[:, None])
    return np.concatenate([nodes[:, :1], nodes[:, :1] + np.cumsum(apart, axis=1)], axis=1)


def node_weights(place: Float[Array, "n q"]) -> Float[Array, "n q"]:
    """Weights of the trapezoid rule for nodes at distances from the measured slip, in slip
    standard deviations, by the measured slip alone."""
    wide = jnp.diff(place, axis=1)
    share = (jnp.pad(wide, ((0, 0), (1, 0))) + jnp.pad(wide, ((0, 0), (0, 1)))) / 2
    return jnp.exp(-(place**2) / 2) * share


def unbent(
    force: Float[Array, "n q"], place: Float[Array, "n q"], within: bool
) -> Float[Array, "n q"]:
    """Forces (n, q) at the nodes whose chords have no error on average: chords of a curve lie
    on its inner side. ``within``: no node moves past a neighbour, and so above a peak."""
    wide, step = jnp.diff(place, axis=1), jnp.diff(force, axis=1)
    before, after = wide[:, :-1], wide[:, 1:]
    # The curvature times the mean square of both widths, over 24.
    off = (step[:, 1:] * before - step[:, :-1] * after) * (before**2 + after**2)
    off = off / (12 * (before + after) * before * after)
    if within:
        least = jnp.minimum(jnp.abs(step[:, 1:]), jnp.abs(step[:, :-1]))
        off = jnp.clip(off, -least, least)
    return force.at[:, 1:-1].add(-off)


def _erfcx(x: Values) -> Array:
    """exp(x^2) erfc(x) for x >= 0 within 1e-8 of itself."""
    t = 2.5 / (2.5 + x)
    power = jnp.full_like(t, _ERFCX[-1])
    for coefficient in _ERFCX[-2::-1]:
        power = power * t + coefficient
    return power * t


def integrals(
    place: Float[Array, "n q"],
    residuals: list[Float[Array, "n q"]],
    density: Float[Array, "n q"],
    *,
    measured: bool = True,
) -> tuple[Float[Array, " n"], Float[Array, "n q"]]:
    """Likelihood of each row with a density of the true slips that is linear between nodes.

    Args:
        place: nodes from the measured slip, in slip standard deviations.
        residuals: of each force at the nodes, in standard deviations.
        density: of the true slips at the nodes.
        measured: whether the measured slip counts; else the forces alone.

    Returns:
        (log likelihood (n,), weights of the density at the nodes in the likelihood (n, q), up
        to a factor of the row).
    """
    left, wide = place[:, :-1], jnp.diff(place, axis=1)
    fall = jnp.ones_like(left) if measured else _SLIGHT / wide
    start = jnp.zeros_like(left) if measured else left
    precision, pull, square = fall**2, fall**2 * start, (fall * start) ** 2
    for residual in residuals:
        slope = -jnp.diff(residual, axis=1) / wide
        there = residual[:, :-1] + slope * left  # at the measured slip
        precision, pull = precision + slope**2, pull + slope * there
        square = square + there**2
    peak = pull / precision
    least = jnp.maximum(square - pull * peak, 0.0) / 2
    root = jnp.sqrt(precision)
    low, high = (left - peak) * root, (left + wide - peak) * root
    mass, first, log = _normal_part(low, high)
    share = jnp.clip((first / mass - low) / (root * wide), 0.0, 1.0)
    # Without the mass, so that a program does not compute it twice.
    most = jax.lax.stop_gradient(jnp.max(log - least, axis=1))
    part = mass / root * jnp.exp(log - least - most[:, None])
    mean = density[:, :-1] + share * jnp.diff(density, axis=1)
    weight = jnp.pad(part * (1 - share), ((0, 0), (0, 1)))
    weight = weight + jnp.pad(part * share, ((0, 0), (1, 0)))
    return most + jnp.log(jnp.sum(part * mean, axis=1)), weight


def _normal_part(low: Values, high: Values) -> tuple[Array, Array, Array]:
    """Integrals of exp(-x^2/2) and x exp(-x^2/2) from low to high, and the log of a factor
    of both, which keeps them finite far from zero."""
    mirrored = low + high < 0
    inner, outer = jnp.where(mirrored, -high, low), jnp.where(mirrored, -low, high)
    outside = inner > 0
    log = jnp.where(outside, -(inner**2) / 2, 0.0)
    at_near = jnp.where(outside, 1.0, jnp.exp(-(inner**2) / 2))
    at_far = jnp.exp(-(outer**2) / 2 - log)
    half = np.sqrt(0.5)
    beyond = _erfcx(half * outer) * at_far
    before = _erfcx(half * jnp.abs(inner)) * at_near
    mass = jnp.where(outside, before - beyond, 2 - before - beyond) * np.sqrt(np.pi / 2)
    first = jnp.where(mirrored, -1.0, 1.0) * (at_near - at_far)
    return jnp.maximum(mass, 1e-30), first, log
