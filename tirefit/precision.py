"""Require 64-bit floats, which every estimate needs and JAX does not use by default.

Between two good estimates, a sum of squares of some thousand rows differs in the eighth
digit. The models themselves can be evaluated in either precision.
"""

import jax.numpy as jnp

from tirefit.results import UsageError


def require_x64(task: str) -> None:
    """Check that JAX computes in 64-bit floats.

    Args:
        task: the task that needs them, for the message.

    Raises:
        UsageError: 32-bit floats are in use.
    """
    if jnp.result_type(float) != jnp.float64:
        raise UsageError(
            f"{task} needs 64-bit floats, and JAX computes in 32 bits",
            "jax.config.update('jax_enable_x64', True) before the first array, or"
            " JAX_ENABLE_X64=1 in the environment",
        )
