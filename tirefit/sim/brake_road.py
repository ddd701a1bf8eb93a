"""The road under the wheels: its friction by distance and side.

A friction is the largest force over load that the tire has on it, at its static load
and the speed at which the braking begins.
"""

import re
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tirefit.results import UsageError

ROADS = ("mu=0.4", "mu=0.3:0.8@20", "left=0.3,right=0.8")
"""How a road is written: constant; another friction from 20 m on; split."""

_LEAST, _MOST = 0.05, 2.0
_PATCH = 0.2  # length [m] of the contact patch, which comes onto a new road bit by bit


class Road(NamedTuple):
    """Friction on the left and on the right."""

    before: Float[Array | np.ndarray, " 2"]
    after: Float[Array | np.ndarray, " 2"]
    jump: Float[Array | np.ndarray, ""] | float  # [m] from where the braking begins

    def mu(
        self, distance: Float[Array, " w"], y: Float[Array | np.ndarray, " w"]
    ) -> Float[Array, " w"]:
        """Friction under wheels that are ``distance`` [m] on, and ``y`` [m] left."""
        share = jnp.clip((distance - self.jump) / _PATCH + 0.5, 0.0, 1.0)
        side = (jnp.asarray(y) < 0).astype(int)
        before, after = jnp.asarray(self.before)[side], jnp.asarray(self.after)[side]
        return before + share * (after - before)

    @property
    def split(self) -> bool:
        """Whether left and right differ."""
        sides = (self.before, self.after)
        return any(float(side[0]) != float(side[1]) for side in sides)

    @property
    def jumps(self) -> bool:
        """Whether the friction changes on the way."""
        return bool(np.isfinite(self.jump))


def road_of(text: str) -> Road:
    """The road that is written as in :data:`ROADS`.

    Raises:
        UsageError: it is written otherwise, or a friction is out of range.
    """
    number = r"(\d*\.?\d+)"
    constant = re.fullmatch(rf"mu={number}(?::{number}@{number})?", text.strip())
    sides = re.fullmatch(rf"left={number},\s*right={number}", text.strip())
    if constant is None and sides is None:
        remedy = (
            f"write it as {', '.join(ROADS)}; friction from {_LEAST:g} to {_MOST:g}"
        )
        raise UsageError(f"--road {text!r} is not a road", remedy)
    if sides is not None:
        both = np.array([float(sides[1]), float(sides[2])])
        road = Road(both, both, np.inf)
    else:
        assert constant is not None
        before = float(constant[1])
        after = before if constant[2] is None else float(constant[2])
        jump = np.inf if constant[3] is None else float(constant[3])
        road = Road(np.full(2, before), np.full(2, after), jump)
    for mu in {*road.before.tolist(), *road.after.tolist()}:
        if not _LEAST <= mu <= _MOST:
            reason = f"--road {text!r}: friction {mu:g} is out of range"
            raise UsageError(reason, f"give {_LEAST:g} (ice) to {_MOST:g}")
    return road
