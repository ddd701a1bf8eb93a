"""Find where a Magic Formula depends on the limit of its curvature factors E to 1."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from tirefit.models.base import TireInputs
from tirefit.models.mf.fields import Curve, ratio
from tirefit.models.mf.tire import MFTire


def curvatures(tire: MFTire, inputs: TireInputs) -> dict[str, Float[Array, " n"]]:
    """Largest curvature factor E of each force, before the limit to one.

    At E > 1 the curve bends back. Some programs limit E to one, as
    :func:`~tirefit.models.magic_formula.bent` does, others do not. F_x and F_y have two
    factors each: of the pure curve and of the weighting function.

    Args:
        tire: the tire.
        inputs: scalars or arrays (n,).

    Returns:
        ``fx``, ``fy``, ``mz``, as far as the tire has them: (n,). An E without effect
        on a sample (zero argument, weight without shape, zero load) counts as zero.
        That of M_z does not include those of F_x and F_y, on which M_z also depends.
    """
    arrays = [jnp.atleast_1d(jnp.asarray(value, float)) for value in inputs]
    return jax.vmap(lambda sample: _largest(tire, sample))(
        TireInputs(*jnp.broadcast_arrays(*arrays))
    )


def _largest(tire: MFTire, inputs: TireInputs) -> dict:
    """:func:`curvatures` of one sample."""
    at, scale = tire.point(inputs), tire.scaling
    fz0 = tire.nominal.FNOMIN * scale.LFZO
    side = tire.lateral.pure(at, scale, fz0)
    _, stiffness = tire.longitudinal.pure(at, scale)
    slip = ratio(stiffness, side.stiffness) * at.kappa

    def acting(curve: Curve, shape=1.0):
        acts = (curve.x * shape != 0) & (inputs.fz > 0)
        return jnp.where(acts, curve.curvature, 0.0)

    def weighting(force, weight):
        if force in tire.similarity:
            return 0.0
        # Without the other slip the weight is one for any E.
        moved = weight.curve.x - weight.x_at_rest
        return acting(Curve(moved, weight.curve.curvature), weight.shape)

    along, across = tire.longitudinal, tire.lateral
    weights = {"fx": along.weight(at, scale), "fy": across.weight(at, scale)}
    found = {
        "fx": acting(along.curve(at, scale)),
        "fy": acting(side.curve),
        "mz": acting(tire.aligning.curve(at, scale, slip), tire.aligning.QDZ1),
    }
    for force, weight in weights.items():
        found[force] = jnp.maximum(found[force], weighting(force, weight))
    return {force: value for force, value in found.items() if force not in tire.lacks}
