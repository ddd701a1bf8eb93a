r"""First-order lag of the slip, which turns a steady-state tire into a transient one.

The slip :math:`\sigma'` of the contact patch follows the slip of the wheel over a
relaxation length L of travel,

.. math:: \frac{d\sigma'}{dt} = \frac{|v|}{L} (\sigma - \sigma'),

for both the longitudinal slip :math:`\sigma_x` and the lateral one :math:`\tan\alpha`.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from tirefit.arrays import Numbers, Scalar
from tirefit.models.base import AbstractTire, TireForces, TireInputs
from tirefit.models.brush import Brush
from tirefit.params import par


def _recursion(keep: Float[Array, " n"], add: Float[Array, " n"]) -> Float[Array, " n"]:
    """All y_i = keep_i y_(i-1) + add_i from y = 0, (n,)."""

    def follow(y: Array, row: tuple[Array, Array]) -> tuple[Array, Array]:
        y = row[0] * y + row[1]
        return y, y

    return jax.lax.scan(follow, jnp.zeros((), add.dtype), (keep, add))[1]


def lag(
    slip: Float[Array, " n"], travel: Float[Array, " n"], length: Scalar, starts: Bool[Array, " n"]
) -> Float[Array, " n"]:
    """Lagged slip minus slip of the wheel, row by row.

    Exact for a slip that is linear in the distance travelled between two rows.

    Args:
        slip: slip of the wheel, rows in time order.
        travel: distance from the previous row [m], >= 0, shape (n,).
        length: relaxation length [m], a scalar or (n,).
        starts: (n,) bool; these rows start in steady state.
    """
    share = jnp.where(starts, 0.0, travel) / length
    moving = share > 0
    safe = jnp.where(moving, share, 1.0)
    # Mean remaining part of a slip change within the step.
    left = jnp.where(moving, -jnp.expm1(-safe) / safe, 1.0)
    change = jnp.diff(slip, prepend=slip[:1])
    keep = jnp.where(starts, 0.0, jnp.exp(-share))
    add = jnp.where(starts, 0.0, -left * change)
    return _recursion(keep, add)


class Relaxed(AbstractTire):
    """A steady-state tire with a relaxation length.

    ``__call__`` gives the steady force; ``felt`` the slips of the patch in a time series.
    A row that does not follow the previous one (another run, or a time that does not
    advance) starts in steady state.
    """

    tire: AbstractTire = Brush()
    relaxation_length: float = par(
        0.3, (1e-3, 20.0), "m",
        "travel over which the slip of the patch follows that of the wheel", "first-order lag",
        "L", scale="log",
    )  # fmt: skip

    @property
    def needs(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys((*self.tire.needs, "v", "time")))

    @property
    def transient(self) -> bool:
        return True

    def static_friction(self, fz: Scalar) -> Scalar | None:
        return self.tire.static_friction(fz)

    def felt(self, inputs: TireInputs, run: Int[Array | np.ndarray, " n"]) -> TireInputs:
        time = jnp.asarray(inputs.time)
        step = jnp.diff(time, prepend=time[:1])
        # The first row has no time step.
        starts = (step <= 0) | (jnp.diff(run, prepend=run[:1]) != 0)
        speed = jnp.abs(inputs.v)
        before = jnp.concatenate([speed[:1], speed[:-1]])
        travel = jnp.where(starts, 0.0, (before + speed) / 2 * step)

        def follow(slip: Numbers) -> Float[Array, " n"]:
            slip = jnp.asarray(slip)
            return slip + lag(slip, travel, self.relaxation_length, starts)

        return inputs._replace(
            sigma_x=follow(inputs.sigma_x), alpha=jnp.arctan(follow(jnp.tan(inputs.alpha)))
        )

    def __call__(self, inputs: TireInputs) -> TireForces:
        return self.tire(inputs)
