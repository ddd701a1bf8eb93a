r"""Data, slips and loads of the vehicle, for methods that use its whole motion.

Axes of ISO 8855 (x forward, y left); tire forces in the signs of the package: braking
positive, and to the left for a positive slip angle,
:math:`\alpha_f = \delta - \arctan((v_y + l_f r)/v_x)`.
"""

import jax.numpy as jnp
from jaxtyping import Array

from tirefit.arrays import Scalar
from tirefit.models.combined import mu_rate
from tirefit.online.base import AbstractEstimator
from tirefit.params import par

GRAVITY = 9.81
"""Gravity of the methods and the simulated cars [m/s2], rounded as in their sources; files
and logs use :data:`tirefit.slip.GRAVITY`."""


class AbstractVehicleMethod(AbstractEstimator):
    """A method on the motion of a vehicle; the defaults are those of a mid-size car.

    Samples are not averaged first, as such methods use the motion between them.
    """

    average: float = 1.0
    mass: float = par(1500.0, (0.1, 1e5), "kg", "mass of the vehicle")
    yaw_inertia: float = par(2500.0, (1e-4, 1e6), "kg m2", "yaw inertia")
    l_f: float = par(1.2, (0.01, 10.0), "m", "front axle ahead of the CG")
    l_r: float = par(1.4, (0.01, 10.0), "m", "rear axle behind the CG")
    stiffness_f: float = par(11.0, (0.5, 100.0), "1/rad", "stiffness 2 c_p a^2 over load, front")
    stiffness_r: float = par(13.0, (0.5, 100.0), "1/rad", "stiffness 2 c_p a^2 over load, rear")

    @property
    def base(self) -> float:
        """Wheelbase [m]."""
        return self.l_f + self.l_r

    @property
    def loads(self) -> tuple[float, float]:
        """Loads [N] of the front and the rear axle at rest."""
        weight = self.mass * GRAVITY / self.base
        return weight * self.l_r, weight * self.l_f


def axle_angles(
    v_x: Array, v_y: Array, yaw_rate: Array, steering: Array, l_f: Scalar, l_r: Scalar
) -> tuple[Array, Array]:
    """Slip angles [rad] of the front and the rear axle, positive for a force left.

    Args:
        v_x, v_y: velocity [m/s] of the CG, v_x > 0.
        yaw_rate: [rad/s]; steering: road wheel angle [rad].
        l_f, l_r: axles before and behind the CG [m].
    """
    front = steering - jnp.arctan((v_y + l_f * yaw_rate) / v_x)
    return front, -jnp.arctan((v_y - l_r * yaw_rate) / v_x)


def brush_share(sigma_x: Array, alpha: Array, stiffness: Scalar, mu: Scalar) -> tuple[Array, Array]:
    """Forces [-] over the load, braking and to the left, of a brush, S(12) on the resultant slip.

    If the stiffness is proportional to the load, tires of an axle with equal slips act as
    one tire at the load of the axle.

    Args:
        sigma_x: physical slip [-] > -1; alpha: slip angle [rad].
        stiffness: 2 c_p a^2 over the load [-]; mu: friction [-].
    """
    sigma_y = jnp.tan(alpha) * (1 + sigma_x)
    # Not exactly zero at rest, where its direction is not differentiable.
    slip = jnp.sqrt(sigma_x * sigma_x + sigma_y * sigma_y + 1e-20)
    force = jnp.asarray(mu * mu_rate(slip, stiffness, mu))
    return force * sigma_x / slip, force * sigma_y / slip


def clipped(omega: Array, v: Array, radius: Scalar, slowest: float = 0.01) -> Array:
    """Physical slip [-] of a wheel, limited to 99 when it nearly locks.

    Args:
        omega: wheel speed [rad/s]; v: speed of its centre [m/s] > 0; radius [m].
    """
    turning = jnp.maximum(omega * radius / v, slowest)
    return 1 / turning - 1


def wrapped(angle: Array) -> Array:
    """The same angle [rad] in [-pi, pi)."""
    return (angle + jnp.pi) % (2 * jnp.pi) - jnp.pi
