r"""Integral over the true slip of a row whose slip is measured with noise.

The likelihood of a row is :math:`\int N(F \mid f(s), \sigma) N(s_i \mid s, \tau) g(s) ds`
with g the density of the true slips. Between two nodes the force is taken as linear in the
slip, so that the product of the normal densities has closed integrals. Their cost does not
depend on the noise of the force, which may be far smaller than the change of the force
between two nodes.

The density is estimated, and an error in it must not move the parameters. Where the curve is
steep the force shows the true slip of a row: if the parameters change, the same force belongs
to another slip. The nodes, and the density with them, therefore move with the parameters,

.. math:: \delta s = -\frac{\tau^2 f'\, \delta f}{\sigma^2 + \tau^2 f'^2} .

The likelihood is then that of the least favourable path of the density, to first order in the
curvature within the noise: its slope does not depend on the density where the force shows the
slip (only the measured slips count, as in orthogonal distance regression) nor where it shows
nothing, and its curvature has the uncertainty of the density in it (Murphy and van der Vaart,
Journal of the American Statistical Association 95, 2000).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

_HALF = np.array([0.5, 1.0, 1.5, 2.0, 2.5, 3.25, 4.5, 6.5])
OFFSETS = np.concatenate([-_HALF[::-1], [0.0], _HALF])
"""Nodes around the measured slip, in slip standard deviations: a row beyond the last one is
as rare as 1e-10."""
_SPACING = np.diff(OFFSETS)
_FARTHEST = 3.0
"""Slip standard deviations by which a node moves at most."""
_CLOSEST = 0.05
"""Share of their first distance to which two nodes may approach each other."""

_ERFCX = (
    -1.26551223, 1.00002368, 0.37409196, 0.09678418, -0.18628806,
    0.27886807, -1.13520398, 1.48851587, -0.82215223, 0.17087277,
)  # fmt: skip


class SlipNodes(NamedTuple):
    """True slips of every row that its integral uses, laid out for one estimate of z."""

    slip: Float[Array, "n q"]
    density: Float[Array, "n q"]  # of the true slips, up to a factor
    shift: Float[Array, "n q w"]  # change of the slip per element of z that the row has
    origin: Float[Array, "n w"]  # these elements of z at the estimate


def node_weights(std: Float[Array, " n"]) -> Float[Array, "n q"]:
    """Probability of each node by the measured slip alone; where a slip is exact, the same."""
    around = np.exp(-(OFFSETS**2) / 2)
    share = np.convolve(_SPACING, [0.5, 0.5])
    return jnp.broadcast_to(jnp.asarray(around * share), (len(std), len(OFFSETS)))


def places(nodes: SlipNodes, own: Float[Array, "n w"], std) -> Float[Array, "n q"]:
    """Slips of the nodes for the elements of z that each row has, rising along a row."""
    move = jnp.einsum("nqw,nw->nq", nodes.shift, own - nodes.origin)
    most = _FARTHEST * std[:, None]
    slip = nodes.slip + most * jnp.tanh(move / jnp.maximum(most, 1e-300))
    apart = jnp.maximum(jnp.diff(slip, axis=1), _CLOSEST * jnp.diff(nodes.slip, axis=1))
    return jnp.concatenate([slip[:, :1], slip[:, :1] + jnp.cumsum(apart, axis=1)], axis=1)


def shifts(std, slope: dict, change: dict, scale: dict):
    """Change of the slip of each node per element of z that the row has (n, q, w), and the
    root of the information on a slip there (n, q), one without a force.

    Args:
        std: (n,) slip noise.
        slope, change: by force, its derivatives in the slip (n, q) and in z (n, q, w).
        scale: by force, its noise (n,).
    """
    square, product = jnp.asarray(std[:, None] ** -2.0), jnp.zeros(())
    for name, along in slope.items():
        precision = scale[name][:, None] ** -2.0
        square = square + precision * along**2
        product = product + (precision * along)[..., None] * change[name]
    return -product / square[..., None], std[:, None] * jnp.sqrt(square)


def unbent(force: Float[Array, "n q"]) -> Float[Array, "n q"]:
    """Forces at the nodes whose chords have no error on average: chords of a curve lie on
    its inner side."""
    bend = 2 * jnp.diff(jnp.diff(force, axis=1) / _SPACING[None], axis=1)
    bend = bend / (_SPACING[1:] + _SPACING[:-1])[None]
    off = bend * (_SPACING[1:] ** 2 + _SPACING[:-1] ** 2)[None] / 24
    return force.at[:, 1:-1].add(-off)


def _erfcx(x):
    """exp(x^2) erfc(x) for x >= 0 within 1.2e-7 (Press et al., Numerical Recipes, 6.2)."""
    t = 1 / (1 + 0.5 * x)
    power = jnp.full_like(t, _ERFCX[-1])
    for coefficient in _ERFCX[-2::-1]:
        power = power * t + coefficient
    return t * jnp.exp(power)


def integrals(place: Float[Array, "n q"], residuals: list[Float[Array, "n q"]]):
    """Weights of the nodes in the integral of a density that is linear between them.

    Args:
        place: nodes from the measured slip, in slip standard deviations.
        residuals: of each force at the nodes, in standard deviations.

    Returns:
        (log of a factor (n,), weights (n, q)): the likelihood of a row is the factor times
        the sum of weights and density.
    """
    left, wide = place[:, :-1], jnp.diff(place, axis=1)
    precision, pull, square = jnp.ones_like(left), jnp.zeros_like(left), jnp.zeros_like(left)
    for residual in residuals:
        slope = -jnp.diff(residual, axis=1) / wide
        there = residual[:, :-1] + slope * left  # at the measured slip
        precision, pull = precision + slope**2, pull + slope * there
        square = square + there**2
    peak = pull / precision
    least = jnp.maximum(square - pull * peak, 0.0) / 2
    std = 1 / jnp.sqrt(precision)
    low, high = (left - peak) / std, (left + wide - peak) / std
    mass, first, log = _normal_part(low, high)
    share = jnp.clip((first / mass - low) * std / wide, 0.0, 1.0)
    log_mass = jnp.log(mass * std * _SPACING[None] / wide) - least + log
    most = jax.lax.stop_gradient(jnp.max(log_mass, axis=1))
    part = jnp.exp(log_mass - most[:, None])
    weight = jnp.pad(part * (1 - share), ((0, 0), (0, 1)))
    return most, weight + jnp.pad(part * share, ((0, 0), (1, 0)))


def _normal_part(low, high):
    """Integrals of exp(-x^2/2) and x exp(-x^2/2) from low to high, and the log of a factor
    of both, which keeps them finite far from zero."""
    mirrored = low + high < 0
    near, far = jnp.where(mirrored, -high, low), jnp.where(mirrored, -low, high)
    outside = near > 0
    log = jnp.where(outside, -(near**2) / 2, 0.0)
    at_near = jnp.exp(-(near**2) / 2 - log)
    at_far = jnp.exp(-(far**2) / 2 - log)
    root = np.sqrt(0.5)
    beyond = _erfcx(root * far) * at_far
    before = _erfcx(root * jnp.abs(near)) * at_near
    mass = jnp.where(outside, before - beyond, 2 - before - beyond) * np.sqrt(np.pi / 2)
    first = jnp.where(mirrored, -1.0, 1.0) * (at_near - at_far)
    return jnp.maximum(mass, 1e-30), first, log
