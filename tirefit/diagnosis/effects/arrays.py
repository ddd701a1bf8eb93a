"""Array functions of NumPy and JAX under one name.

A diagnosis changes the state of every row thousands of times, on plain arrays: XLA would
compile the fifty effects for 15 s of processor time. A tire with effects
(:mod:`tirefit.diagnosis.extended`) is traced by JAX.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np


class _Arrays:
    def __getattr__(self, name: str):
        def function(*given, **options):
            traced = any(isinstance(one, jax.Array) for one in given)
            return getattr(jnp if traced else np, name)(*given, **options)

        setattr(self, name, function)
        return function


xp: Any = _Arrays()
"""``xp.exp`` and so on: the function of JAX if an argument is an array of JAX or a tracer,
else that of NumPy."""
