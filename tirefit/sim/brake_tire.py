r"""Any tire of the library on any road, and where its peak is.

The road scales the tire by similarity, which keeps its stiffness and makes its peak
that of the road:

.. math:: F(\sigma) = \lambda F_0(\sigma / \lambda), \qquad
    \lambda = \mu_{road} / \mu_0

with :math:`\mu_0` the largest force over load of the tire as it is. For a brush that is
a change of :math:`\mu` alone, for LuGre one of g. The sliding speed stays what it is.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from tirefit.models import AbstractTire, TireInputs
from tirefit.models.base import modelled
from tirefit.slip import kappa_from_sigma, sigma_from_kappa

__all__ = ["LOW_SPEED", "RoadTire", "Slips", "on_road", "wheel_slips"]

LOW_SPEED = 0.3
"""Speed [m/s] below which slip is taken over this speed, lest it be infinitely stiff
at a standstill; a locked wheel's force fades at a tenth of it, a hand's breadth of way
before the end."""
_LOCKED = 0.99
"""Largest kappa: of a wheel that stands (sigma 99)."""
_LEAST_KAPPA = -5.0
_LEAST_LOAD = 1.0
_SPEEDS, _LOADS, _SLIPS = 8, 5, 1000


class Slips(NamedTuple):
    """``kappa``, ``alpha`` (w,): practical slip and slip angle [rad]; ``speed`` (w,)
    [m/s]: that by which the sliding speed was divided."""

    kappa: Float[Array, " w"]
    alpha: Float[Array, " w"]
    speed: Float[Array, " w"]


def wheel_slips(v_x, v_y, turning) -> Slips:
    """Slips of wheels (w,) from the speeds of their centres along and across them, and
    their circumferential speed R omega; all [m/s]."""
    speed = jnp.maximum(v_x, LOW_SPEED)
    kappa = jnp.clip((v_x - turning) / speed, _LEAST_KAPPA, _LOCKED)
    return Slips(kappa, jnp.arctan2(v_y, speed), speed)


class RoadTire(eqx.Module):
    """A tire with a table of its peaks.

    ``peak`` (speeds, loads): largest force over load; ``at``: the kappa where it lies,
    both as the tire is, at ``speeds`` [m/s] and ``loads`` [N]; ``usual``: the peak on
    which the road's friction is put.
    """

    tire: AbstractTire
    speeds: Float[Array, " s"]
    loads: Float[Array, " l"]
    peak: Float[Array, "s l"]
    at: Float[Array, "s l"]
    usual: Float[Array, ""]

    def forces(
        self, mu: Float[Array, " w"], slips: Slips, fz: Float[Array, " w"]
    ) -> tuple[Float[Array, " w"], Float[Array, " w"]]:
        """Forces [N] (w,) along and across wheels on a road of friction mu (w,)."""
        return jax.vmap(self._force)(mu, *slips, jnp.maximum(fz, _LEAST_LOAD))

    def _force(self, mu, kappa, alpha, speed, fz):
        factor = mu / self.usual
        sigma = sigma_from_kappa(kappa)
        scaled = sigma / factor
        # Where alpha and speed go so that sigma_y scales and v_s does not.
        narrower = (1 + sigma) / (1 + scaled)
        angle = jnp.arctan(jnp.tan(alpha) / factor * narrower)
        inputs = TireInputs(scaled, angle, fz, speed * factor / narrower)
        made = self.tire(inputs)
        across = jnp.zeros(()) if made.fy is None else made.fy
        return factor * made.fx, factor * across

    def peaks(self, mu, speed, fz):
        """Largest braking force over load (w,) on roads mu (w,), at speeds [m/s] and
        loads [N] (w,); and the kappa (w,) where it lies."""
        factor = mu / self.usual
        row = jnp.interp(speed, self.speeds, jnp.arange(len(self.speeds), dtype=float))
        column = jnp.interp(fz, self.loads, jnp.arange(len(self.loads), dtype=float))
        place = [row, column]
        peak, at = (
            jax.scipy.ndimage.map_coordinates(table, place, order=1, mode="nearest")
            for table in (self.peak, self.at)
        )
        return factor * peak, kappa_from_sigma(factor * sigma_from_kappa(at))


def on_road(tire: AbstractTire, speed, fz) -> RoadTire:
    """A tire with its peaks, for braking from ``speed`` [m/s] at load ``fz`` [N]."""
    one_speed = "v" not in tire.needs
    shares = jnp.linspace(1.0 if one_speed else 0.02, 1.0, 1 if one_speed else _SPEEDS)
    speeds = jnp.asarray(speed) * shares
    loads = jnp.asarray(fz) * jnp.linspace(0.2, 2.4, _LOADS)
    kappas = jnp.concatenate(
        [jnp.geomspace(1e-4, 0.1, _SLIPS // 2), jnp.linspace(0.1, _LOCKED, _SLIPS)[1:]]
    )

    def at(v, load):
        forces = jax.vmap(
            lambda k: tire(TireInputs(sigma_from_kappa(k), 0.0, load, v)).fx / load
        )(kappas)
        largest = jnp.argmax(forces)
        return forces[largest], kappas[largest]

    peak, place = jax.vmap(lambda v: jax.vmap(lambda load: at(v, load))(loads))(speeds)
    usual, _ = at(speeds[-1], jnp.asarray(fz, float))
    return RoadTire(tire, speeds, loads, peak, place, usual)


def gives_lateral(tire: AbstractTire) -> bool:
    """Whether a tire has lateral forces."""
    return "fy" in modelled(tire)
