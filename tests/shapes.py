"""The checker of annotations that runs in the tests: shapes and types, as stated.

``float`` is a number here, or the scalar array that a traced number is: a parameter of
a model is one before ``jax.jit`` and the other inside. ``bool`` and ``int`` may be
NumPy's.
"""

import jax
import numpy as np
from beartype import BeartypeConf, FrozenDict, beartype

NUMBER = float | int | np.number | jax.Array | np.ndarray

_WIDER = {float: NUMBER, bool: bool | np.bool, int: int | np.integer}

checked = beartype(conf=BeartypeConf(hint_overrides=FrozenDict(_WIDER)))
