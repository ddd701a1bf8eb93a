r"""From parameters to residuals whose sum of squares is -2 log likelihood.

Every solver, the profile and the samplers use the one function
:func:`root_deviance`. Without slip noise its entries are the whitened residuals. With
slip noise of standard deviation :math:`\tau` the true slip of a row is latent, and is
integrated over the distribution that the slips of this file come from:

.. math::
   L_i = \int N(F_i \mid f(s), \sigma)\, N(s_i \mid s, \tau)\, g(s)\, ds

by the trapezoid rule on nodes around the measured slip (spectrally accurate for smooth
integrands). The entry is then :math:`\sqrt{2 (\log L_i^{max} - \log L_i)}`, which is
the absolute whitened residual in the limit of no slip noise, so Gauss-Newton steps
carry over.
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from tirefit.compiled import compiled
from tirefit.fitting.layout import Layout
from tirefit.models import AbstractTire, TireInputs
from tirefit.params import with_values

__all__ = [
    "CHANNEL_SLIP",
    "LOSSES",
    "Channel",
    "Rows",
    "noise_factor",
    "predict",
    "root_deviance",
]

CHANNEL_SLIP = {"fx": "sigma_x", "fy": "alpha", "mz": "alpha"}
"""Force channel -> the slip that drives it in pure slip."""


def _huber(square):
    """Quadratic to 1.345 standard deviations, linear beyond (95 % efficiency)."""
    k = 1.345
    inside = square <= k**2
    size = jnp.sqrt(jnp.where(inside, 1.0, square))
    return jnp.where(inside, square, 2 * k * size - k**2)


def _soft_l1(square):
    return 2 * (jnp.sqrt(1 + square) - 1)


def _cauchy(square):
    """Redescending; scale 2.385 gives 95 % efficiency at Gaussian noise."""
    k = 2.385
    return k**2 * jnp.log1p(square / k**2)


LOSSES = {
    "squares": lambda square: square,
    "huber": _huber,
    "soft-l1": _soft_l1,
    "cauchy": _cauchy,
}
"""Robust losses: squared whitened residual -> contribution to -2 log likelihood."""


@dataclass(frozen=True)
class Channel:
    """One fitted force: its name and whether its noise scale is estimated.

    ``slip`` is the slip whose noise, if any, is integrated out for it: its own in pure
    slip.
    """

    name: str
    noise_estimated: bool = True
    slip: str = ""

    def __post_init__(self):
        object.__setattr__(self, "slip", self.slip or CHANNEL_SLIP[self.name])


class SlipNodes(NamedTuple):
    """Latent slips of every row and the log of their weight, each (n, nodes)."""

    slip: Float[Array, "n q"]
    log_weight: Float[Array, "n q"]


class Rows(NamedTuple):
    """The used rows of a data set, padded so that few shapes are ever compiled.

    ``weight`` (n,) is 0 for padding; ``observed`` and ``scale`` hold an array (n,) per
    channel, ``nodes`` the latent slips by slip name where the slip has noise.
    """

    inputs: TireInputs
    run: Int[Array, " n"]
    weight: Float[Array, " n"]
    observed: dict[str, Float[Array, " n"]]
    scale: dict[str, Float[Array, " n"]]
    nodes: dict[str, SlipNodes]


def predict(
    model: AbstractTire, layout: Layout, z, inputs: TireInputs, run
) -> dict[str, Array]:
    """Forces of every row, by channel, each of shape (n,).

    Args:
        model: template that holds the fixed parameters.
        layout: meaning of z.
        z: unconstrained free parameters, shape (size,).
        inputs: arrays of shape (n,).
        run: run of each row, shape (n,).
    """
    values = layout.natural(z)
    rows = {
        name: value[run] if jnp.ndim(value) else value for name, value in values.items()
    }
    axes = {name: 0 if jnp.ndim(value) else None for name, value in rows.items()}
    felt = with_values(model, rows).felt(inputs, run)

    def one(values, sample):
        return with_values(model, values)(sample)._asdict()

    return jax.vmap(one, in_axes=(axes, 0))(rows, felt)


def _node_squares(model, layout, z, rows, slip, names, loss):
    """Sum over channels of the losses at each latent slip, (n, nodes)."""

    def at(slips):
        inputs = rows.inputs._replace(**{slip: slips})
        predicted = predict(model, layout, z, inputs, rows.run)
        return sum(
            loss(((rows.observed[name] - predicted[name]) / rows.scale[name]) ** 2)
            for name in names
        )

    return jax.vmap(at, in_axes=1, out_axes=1)(rows.nodes[slip].slip)


@compiled(static=("layout", "channels", "loss"))
def root_deviance(model, layout: Layout, z, rows: Rows, channels, loss: str):
    """Residuals whose squares sum to -2 log likelihood, by block.

    Returns:
        dict of arrays (n,): one per channel, or one per slip name where that slip has
        noise (its channels share the latent slip). Padding rows are zero.
    """
    function = LOSSES[loss]
    blocks = {}
    predicted = None
    for slip in ("sigma_x", "alpha"):
        names = [c.name for c in channels if c.slip == slip]
        if names and slip in rows.nodes:
            squares = _node_squares(model, layout, z, rows, slip, names, function)
            log_weight = rows.nodes[slip].log_weight
            log_most = jax.nn.logsumexp(log_weight, axis=1)
            log_row = jax.nn.logsumexp(log_weight - squares / 2, axis=1)
            # The floor keeps the slope of the root finite for a perfect row.
            deviance = jnp.maximum(2 * (log_most - log_row), 1e-12)
            blocks[slip] = rows.weight * jnp.sqrt(deviance)
        elif names:
            if predicted is None:
                predicted = predict(model, layout, z, rows.inputs, rows.run)
            for name in names:
                residual = (rows.observed[name] - predicted[name]) / rows.scale[name]
                blocks[name] = rows.weight * _signed_root(function, residual, loss)
    return blocks


@compiled(static=("layout", "channels", "loss"))
def noise_factor(model, layout: Layout, z, rows: Rows, channels, loss: str):
    """Factor on all force scales that maximises the likelihood of rows with noisy slip.

    There the size of the residuals does not give the noise: the slip's share depends
    on where each row lies. Newton's method on the logarithm of the factor.
    """

    def objective(log_factor):
        scale = {k: v * jnp.exp(log_factor) for k, v in rows.scale.items()}
        blocks = root_deviance(
            model, layout, z, rows._replace(scale=scale), channels, loss
        )
        squares = sum(jnp.sum(block**2) for block in blocks.values())
        return squares / 2 + jnp.sum(rows.weight) * len(channels) * log_factor

    def step(_, log_factor):
        slope = jax.grad(objective)(log_factor)
        curvature = jnp.maximum(
            jax.hessian(objective)(log_factor), jnp.sum(rows.weight)
        )
        return log_factor - jnp.clip(slope / curvature, -0.7, 0.7)

    return jnp.exp(jax.lax.fori_loop(0, 6, step, 0.0))


def _signed_root(function, residual, loss: str):
    if loss == "squares":
        return residual
    # sqrt(loss) has no slope at zero; below 1e-6 every loss is the square itself.
    small = jnp.abs(residual) < 1e-6
    safe = jnp.where(small, 1.0, residual)
    return jnp.where(small, residual, jnp.sign(safe) * jnp.sqrt(function(safe**2)))
