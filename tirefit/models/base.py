"""Inputs and outputs of a tire model, and the function that batches it."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from tirefit.arrays import Number, Scalar


class TireInputs(NamedTuple):
    """One sample in the canonical convention of ``tirefit.slip``, or n of them.

    A model lists in ``needs`` which of the last four change its force.

    Attributes:
        sigma_x: longitudinal slip [-], braking positive.
        alpha: slip angle [rad].
        fz: load [N].
        v: forward speed of the wheel centre [m/s]; at 0 a rolling resistance is that of
            the nominal speed.
        gamma: camber [rad].
        pressure: inflation pressure [Pa]; 0 for the nominal one.
        time: [s].

    Example:
        >>> sample = TireInputs(sigma_x=0.5, fz=4000.0)
        >>> round(float(forces(MODELS["brush"], sample).fx))
        4000
    """

    sigma_x: Float[Array | np.ndarray, "*n"] | float = 0.0
    alpha: Float[Array | np.ndarray, "*n"] | float = 0.0
    fz: Float[Array | np.ndarray, "*n"] | float = 0.0
    v: Float[Array | np.ndarray, "*n"] | float = 0.0
    gamma: Float[Array | np.ndarray, "*n"] | float = 0.0
    pressure: Float[Array | np.ndarray, "*n"] | float = 0.0
    time: Float[Array | np.ndarray, "*n"] | float = 0.0


class TireForces(NamedTuple):
    """Forces [N] and moments [N m] of one sample; None if not modelled.

    ``mz`` aligning, ``mx`` overturning, ``my`` rolling resistance moment.
    """

    fx: Float[Array, "*n"] | None
    fy: Float[Array, "*n"] | None
    mz: Float[Array, "*n"] | None
    mx: Float[Array, "*n"] | None = None
    my: Float[Array, "*n"] | None = None


class AbstractTire(eqx.Module):
    """A tire model: parameter fields, and the forces of *one* sample."""

    def __call__(self, inputs: TireInputs) -> TireForces:
        raise NotImplementedError

    @property
    def needs(self) -> tuple[str, ...]:
        """Inputs beyond slip and load that change the force: v, gamma, time, ...; by default those
        of the ``tire`` inside."""
        return self.tire.needs if hasattr(self, "tire") else ()

    @property
    def transient(self) -> bool:
        """Whether the force depends on earlier slips (``felt`` changes the inputs)."""
        return False

    def static_friction(self, fz: Scalar) -> Scalar | None:
        """Static friction coefficient [-] at load fz [N]; None if the model has none."""
        del fz
        return getattr(self, "mu", None)

    def felt(self, inputs: TireInputs, run: Int[Array | np.ndarray, " n"]) -> TireInputs:
        """Inputs at the contact patch, after any lag; rows in time order, arrays (n,).

        They are those of the wheel for a steady-state model; for a transient one they
        lag behind, from a steady state at the start of each ``run`` (n,).
        """
        del run
        return inputs


def _of_sample(model: AbstractTire, sample: TireInputs) -> TireForces:
    """One function for all calls: JAX traces it once for each structure of a model."""
    return model(sample)


def modelled(model: AbstractTire) -> tuple[str, ...]:
    """Names of the forces and moments that the model computes."""
    # Traced zeros: a model may divide by an input, which Python's own 0.0 does not allow.
    zeros = np.zeros(len(TireInputs._fields))
    outputs = jax.eval_shape(_of_sample, model, TireInputs(*zeros))
    return tuple(name for name, value in outputs._asdict().items() if value is not None)


@jax.jit
def _batched(model: AbstractTire, inputs: TireInputs, run: Int[Array, " n"]) -> TireForces:
    felt = model.felt(inputs, run)
    return jax.vmap(lambda sample: model(sample))(felt)


def forces(
    model: AbstractTire, inputs: TireInputs, run: Int[Array | np.ndarray, "*n"] | int = 0
) -> TireForces:
    """Forces of a batch of samples.

    Args:
        model: any registered tire model with its parameter values.
        inputs: scalars or arrays of shape ``(n,)``; scalars are broadcast.
        run: run of each row, ``(n,)``, or one for all; a transient model starts in steady
            state with each run, and takes its rows in time order.

    Returns:
        fx, fy [N] and moments [N m] of shape ``(n,)`` (``()`` if all inputs are
        scalars); None for those that the model does not give.

    Raises:
        ValueError: an input has more than one dimension.

    Example:
        >>> tire = with_values(MODELS["brush"], {"mu": 0.9})
        >>> sliding = TireInputs(alpha=np.array([0.5, -0.5]), fz=4000.0)
        >>> np.asarray(forces(tire, sliding).fy).round()
        array([ 3600., -3600.])
    """
    # JAX compiles each of these operations for every shape; NumPy does not, and serves
    # where no input is an array of JAX.
    numbers = jnp if any(isinstance(value, jax.Array) for value in (*inputs, run)) else np
    arrays = [numbers.asarray(value, float) for value in inputs]
    if any(array.ndim > 1 for array in arrays):
        raise ValueError("inputs must be scalars or one-dimensional arrays")
    shape = jnp.broadcast_shapes(*(array.shape for array in arrays))
    arrays.append(numbers.asarray(run, int))
    *columns, runs = (jnp.asarray(numbers.broadcast_to(array, shape or (1,))) for array in arrays)
    batch = TireInputs(*columns)
    result = _batched(model, batch, runs)
    return result if shape else jax.tree.map(lambda array: array[0], result)


def largest(values: Float[Array, " n"]) -> Number:
    """The largest value, with the slope of that one.

    The derivative of ``jnp.max`` compares the values with their maximum. A compiled program
    may compute the values twice; where their last digits differ, that derivative is NaN.
    """
    return values[jnp.argmax(values)]
