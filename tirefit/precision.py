"""64-bit floats: what every estimate needs, and JAX does not have unless told so.

A sum of squares of some thousand rows differs between two good estimates in the eighth
digit. Models alone evaluate in either precision.
"""

import jax.numpy as jnp

from tirefit.results import UsageError


def require_x64(task: str) -> None:
    """Nothing where JAX computes in 64-bit floats.

    Args:
        task: what needs them, for the message.

    Raises:
        UsageError: 32-bit floats are in use.
    """
    if jnp.result_type(float) != jnp.float64:
        raise UsageError(
            f"{task} needs 64-bit floats, and JAX computes in 32 bits",
            "jax.config.update('jax_enable_x64', True) before the first array, or"
            " JAX_ENABLE_X64=1 in the environment",
        )
