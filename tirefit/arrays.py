"""Types of the numbers in a formula that serves Python, NumPy and JAX alike."""

from typing import TypeVar

import numpy as np
from jaxtyping import Array, Float

Scalar = Float[Array | np.ndarray, ""] | float
"""One number; a JAX array while JAX traces the formula."""

Number = Float[Array, ""]
"""One number inside a program of JAX."""

Numbers = Float[Array | np.ndarray, "..."] | float
"""One number or an array of any shape; the formula works elementwise."""

Kept = TypeVar("Kept", float, np.ndarray, Array, Array | np.ndarray, Numbers)
"""The type and shape that a function keeps."""

Same = TypeVar("Same", np.ndarray, Array, Array | np.ndarray)
"""An array of NumPy or of JAX, as the argument is."""

Tree = TypeVar("Tree")
"""A state or record of arrays, of the same structure in arguments and result."""
