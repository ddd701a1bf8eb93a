r"""The dynamic LuGre tire: lumped, S(17), and distributed over the patch.

Every bristle follows S(17a) while the tread carries it from the leading edge
(:math:`\zeta = 0`) through the patch:

.. math:: \frac{\partial z}{\partial t} + |\Omega R_e| \frac{\partial z}{\partial \zeta}
    = v_s - \frac{\sigma_0 |v_s|}{g(|v_s|)} z, \qquad z(t, 0) = 0

The patch is cut into elements. In each, z is the polynomial that satisfies the equation at the
points of a Radau quadrature; the last point is the outlet, whose value enters the next element.
This upwind scheme conserves the balance of the patch exactly. The lumped form is one bristle
without transport. Both are ordinary differential equations, linear in z, which diffrax integrates.
"""

from functools import cache
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tirefit.models import LuGre, TireForces
from tirefit.models.brush import resultant
from tirefit.params import Values

_POINTS = 4


class Bristles(NamedTuple):
    """The places of the bristles and their transport by the tread; z = 0 at the leading edge."""

    place: np.ndarray  # (n,) distance from the leading edge over the patch length
    weight: np.ndarray  # (n,) of each bristle in the mean over the patch
    transport: np.ndarray  # (n, n) matrix of the derivative along the patch, times length


def _radau() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points on (0, 1], weights and derivative matrix of polynomials that are 0 at 0."""
    coefficients = np.zeros(_POINTS + 1)
    coefficients[-2:] = -1, 1
    points = (1 + np.sort(np.polynomial.legendre.legroots(coefficients))) / 2
    powers = np.arange(_POINTS)
    integrals = points[:, None] ** (powers + 1) / (powers + 1)
    integration = integrals @ np.linalg.inv(points[:, None] ** powers)
    return points, integration[-1], np.linalg.inv(integration)


@cache
def distributed(elements: int = 4) -> Bristles:
    """Four bristles in each of equally long elements.

    Four elements give S(18) to 1e-7 at every slip; the kink that a sudden start sends
    through the patch costs 1e-4 of the load until it has left.
    """
    points, weights, derivative = _radau()
    inflow = -np.outer(derivative.sum(1), np.eye(_POINTS)[-1])
    along = np.kron(np.eye(elements), derivative)
    along += np.kron(np.eye(elements, k=-1), inflow)
    place = (np.arange(elements)[:, None] + points) / elements
    return Bristles(place.ravel(), np.tile(weights, elements) / elements, elements * along)


class Contact(NamedTuple):
    """Motion and load of the patch at one instant, or at n of them."""

    sliding: Float[Array, "*n 2"]  # [m/s] v_s of the patch over the road, x and y
    rolling: Float[Array, "*n"]  # [m/s] |Omega R_e| of the tread through the patch
    fz: Float[Array, "*n"]  # [N]


def _give(tire: LuGre, z: Values, now: Contact) -> Array:
    """Rate of deflection (n, 2) [m/s] of travelling bristles, S(17a)."""
    speed = resultant(*now.sliding)
    return now.sliding[None] - tire.sigma0 * speed / tire.level(speed) * z


def bristle_rate(tire: LuGre, bristles: Bristles, z: Values, now: Contact) -> Array:
    """Time derivative (n, 2) [m/s] of the deflections z (n, 2) [m] at their places."""
    carried = now.rolling / tire.length * (jnp.asarray(bristles.transport) @ z)
    return _give(tire, z, now) - carried


def bristle_forces(tire: LuGre, bristles: Bristles, z: Values, now: Contact) -> TireForces:
    """Force [N] of the deflections z (n, 2) [m], S(17b) averaged over the patch."""
    each = tire.sigma0 * z + tire.sigma1 * _give(tire, z, now)
    mean = jnp.asarray(bristles.weight) @ each + tire.sigma2 * now.sliding
    force = (now.fz > 0) * now.fz * mean
    return TireForces(force[0], force[1], None)
