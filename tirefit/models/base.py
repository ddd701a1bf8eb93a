"""Inputs and outputs of a tire model, and the one place that batches it."""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

__all__ = ["AbstractTire", "TireForces", "TireInputs", "forces"]


class TireInputs(NamedTuple):
    """One sample in the canonical convention of ``tirefit.slip`` (or a batch of them).

    ``sigma_x`` [-], ``alpha`` [rad], ``fz`` [N], ``v`` [m/s] forward speed of the
    wheel centre. Speed matters only to speed-dependent friction.
    """

    sigma_x: Float[Array, "*n"] | float = 0.0
    alpha: Float[Array, "*n"] | float = 0.0
    fz: Float[Array, "*n"] | float = 0.0
    v: Float[Array, "*n"] | float = 0.0


class TireForces(NamedTuple):
    """Forces [N] and aligning moment [N m] of one sample; None where not modelled."""

    fx: Float[Array, "*n"]
    fy: Float[Array, "*n"]
    mz: Float[Array, "*n"] | None


class AbstractTire(eqx.Module):
    """A tire model: parameter fields, and the forces of *one* sample."""

    def __call__(self, inputs: TireInputs) -> TireForces:
        raise NotImplementedError


@partial(jax.jit, static_argnames=())
def _batched(model: AbstractTire, inputs: TireInputs) -> TireForces:
    return jax.vmap(lambda sample: model(sample))(inputs)


def forces(model: AbstractTire, inputs: TireInputs) -> TireForces:
    """Forces of a batch of samples: the one ``vmap`` and ``jit``.

    Args:
        model: any registered tire model with its parameter values.
        inputs: scalars or arrays of shape ``(n,)``; scalars are broadcast.

    Returns:
        fx, fy [N] and mz [N m] of shape ``(n,)`` (``()`` if all inputs are scalars).

    Raises:
        ValueError: an input has more than one dimension.
    """
    arrays = [jnp.asarray(value, float) for value in inputs]
    if any(array.ndim > 1 for array in arrays):
        raise ValueError("inputs must be scalars or one-dimensional arrays")
    shape = jnp.broadcast_shapes(*(array.shape for array in arrays))
    batch = TireInputs(*(jnp.broadcast_to(array, shape or (1,)) for array in arrays))
    result = _batched(model, batch)
    return result if shape else jax.tree.map(lambda array: array[0], result)
