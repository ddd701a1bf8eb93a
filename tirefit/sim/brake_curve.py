"""The tire's curve on the roads of a manoeuvre, to see a stop against it."""

import jax
import jax.numpy as jnp
import numpy as np

from tirefit.sim.brake_request import Request, plant_of
from tirefit.sim.brake_tire import wheel_slips


def tire_curve(
    request: Request, most: float, points: int = 200
) -> dict[float, tuple[np.ndarray, np.ndarray]]:
    """Friction of the road -> (kappa, F_x / F_z), each (points,).

    Args:
        request: whose tire and roads are meant; at the static load of the first wheel
            and half the speed of the manoeuvre.
        most: largest kappa.
    """
    plant = plant_of(request)
    kappa = jnp.linspace(0.0, min(most, 0.99), points)
    speed = 0.5 * jnp.asarray(request.speed, float)
    fz = plant.vehicle.fz[0]
    curves = {}
    for mu in np.unique(np.r_[plant.road.before, plant.road.after]):

        def one(k, mu=mu):
            slips = wheel_slips(speed[None], jnp.zeros(1), speed * (1 - k)[None])
            fx, _ = plant.tire.forces(jnp.full(1, mu), slips, fz[None])
            return fx[0] / fz

        curves[float(mu)] = (np.asarray(kappa), np.asarray(jax.vmap(one)(kappa)))
    return curves
