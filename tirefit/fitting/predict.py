"""Forces that a fit or a model predicts, row by row, with their spread."""

import jax
import jax.numpy as jnp
import numpy as np

from tirefit.compiled import compiled
from tirefit.fitting.likelihood import predict

__all__ = ["moments", "predict_forces", "row_moments"]


@compiled(static=("layout", "channels"))
def moments(model, layout, z, rows, channels):
    """Mean and variance of each fitted force given the measured slip, by channel (n,).

    Where the slip has noise, both are over the latent slips of the row.
    """
    mean, variance = {}, {}
    plain = predict(model, layout, z, rows.inputs, rows.run)
    for name, slip in ((channel.name, channel.slip) for channel in channels):
        if slip not in rows.nodes:
            mean[name], variance[name] = plain[name], rows.scale[name] ** 2
            continue
        nodes = rows.nodes[slip]
        weight = jax.nn.softmax(nodes.log_weight, axis=1)

        def at(slips, slip=slip, name=name):
            inputs = rows.inputs._replace(**{slip: slips})
            return predict(model, layout, z, inputs, rows.run)[name]

        forces = jax.vmap(at, in_axes=1, out_axes=1)(nodes.slip)
        mean[name] = jnp.sum(weight * forces, axis=1)
        spread = jnp.sum(weight * (forces - mean[name][:, None]) ** 2, axis=1)
        variance[name] = rows.scale[name] ** 2 + spread
    return mean, variance


def row_moments(problem, z) -> tuple[dict, dict]:
    """:func:`moments` of a problem's own rows, without padding."""
    mean, variance = moments(
        problem.model, problem.layout, z, problem.rows, problem.channels
    )
    return (
        {name: problem.used(value) for name, value in mean.items()},
        {name: problem.used(value) for name, value in variance.items()},
    )


@compiled(static=("layout",))
def _linearised(model, layout, z, covariance, inputs, run):
    def force(z):
        found = predict(model, layout, z, inputs, run)
        return {k: v for k, v in found.items() if v is not None}

    slope = jax.jacfwd(force)(z)
    return force(z), {k: jnp.sum(g @ covariance * g, axis=1) for k, g in slope.items()}


def predict_forces(model, layout, z, covariance, inputs, run) -> tuple[dict, dict]:
    """Forces and the variance that the parameters' uncertainty gives them.

    Args:
        model: template with the fixed parameters.
        layout, z, covariance: estimate in the unconstrained space.
        inputs: ``TireInputs`` of arrays (n,).
        run: run of each row, (n,).

    Returns:
        (force, variance): dicts of arrays (n,) for fx, fy and, where modelled, mz.
    """
    force, variance = _linearised(
        model, layout, jnp.asarray(z), jnp.asarray(covariance), inputs, jnp.asarray(run)
    )
    return (
        {k: np.asarray(v) for k, v in force.items()},
        {k: np.asarray(v) for k, v in variance.items()},
    )
