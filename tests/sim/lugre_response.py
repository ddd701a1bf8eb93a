"""The response of a dynamic LuGre tire to a given motion, integrated by diffrax."""

from typing import NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tirefit.models import LuGre, TireForces, TireInputs
from tirefit.sim.lugre import Bristles, Contact, bristle_forces, bristle_rate
from tirefit.slip import lateral_slip

LUMPED = Bristles(np.ones(1), np.ones(1), np.zeros((1, 1)))
"""One bristle for the whole patch, never carried out of it: S(17)."""


def contact(inputs: TireInputs) -> Contact:
    """The motion that gives slips and speed of steady-state inputs (n,)."""
    arrays = [jnp.asarray(value, float) for value in inputs]
    slip_x, alpha, fz, v, *_ = jnp.broadcast_arrays(*arrays)
    rolling = v / (1 + slip_x)
    slip = jnp.stack([slip_x, lateral_slip(jnp.tan(alpha), slip_x)], axis=-1)
    return Contact(slip * rolling[..., None], rolling, fz)


class Response(NamedTuple):
    """Forces (t,) [N] and deflections (t, n, 2) [m] at the requested times."""

    forces: TireForces
    deflection: Float[Array, "t n 2"]


def simulate(
    tire: LuGre, bristles: Bristles, time: Float[Array | np.ndarray, " t"], motion: Contact
) -> Response:
    """The tire's response to a given motion.

    Args:
        tire: parameters.
        bristles: ``LUMPED`` or ``distributed(elements)``.
        time: increasing instants [s]; a jump takes two of them close together.
        motion: the patch at these instants (t,), linear between them.
    """
    time = jnp.asarray(time, float)
    # As arrays, to avoid a compilation for every new value.
    return _integrate(jax.tree.map(jnp.asarray, tire), bristles, time, motion)


@eqx.filter_jit
def _integrate(tire, bristles, time, motion):
    start = jnp.zeros((len(bristles.weight), 2))
    course = diffrax.LinearInterpolation(time, motion)
    term = diffrax.ODETerm(lambda t, z, tire: bristle_rate(tire, bristles, z, course.evaluate(t)))
    # Deflections are of the order of 1 mm. A step across a sample could miss a short pulse.
    controller = diffrax.ClipStepSizeController(
        diffrax.PIDController(rtol=1e-8, atol=1e-11), step_ts=time
    )
    solution = diffrax.diffeqsolve(
        term, diffrax.Tsit5(), time[0], time[-1], None, start, tire,
        saveat=diffrax.SaveAt(ts=time), stepsize_controller=controller,
        max_steps=2**20,
    )  # fmt: skip
    forces = jax.vmap(lambda z, now: bristle_forces(tire, bristles, z, now))
    return Response(forces(solution.ys, motion), solution.ys)
