r"""Any tire of the library on a road of given friction, and the slip of its peak.

The friction of the road scales the tire by similarity: same stiffness, peak of the road:

.. math:: F(\sigma) = \lambda F_0(\sigma / \lambda), \qquad
    \lambda = \mu_{road} / \mu_0

with :math:`\mu_0` the largest force over load of the given tire. For a brush this
changes only :math:`\mu`, for LuGre only g. The sliding speed is not scaled.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tirefit.models import AbstractTire, TireInputs
from tirefit.slip import sigma_from_kappa

LOW_SPEED = 0.3
"""Speed [m/s] below which the slip velocity is divided by this speed, as the slip would
be infinitely stiff at standstill. The force of a locked wheel fades below a tenth of it,
in the last 0.1 m."""
_LOCKED = 0.99  # largest kappa, that of a standing wheel (sigma 99)
_LEAST_KAPPA = -5.0
_LEAST_LOAD = 1.0
_SPEEDS, _LOADS, _SLIPS = 16, 5, 200
_HALVINGS = 60
"""Golden-section steps about the best slip of a grid: the peak is exact to rounding."""


class Slips(NamedTuple):
    """Slips of the wheels."""

    kappa: Float[Array, " w"]  # practical slip
    alpha: Float[Array, " w"]  # [rad]
    speed: Float[Array, " w"]  # [m/s] by which the sliding speed was divided


def wheel_slips(v_x, v_y, turning) -> Slips:
    """Slips of wheels (w,) from the speeds of their centres along and across them, and
    their circumferential speed R omega; all [m/s]."""
    speed = jnp.maximum(v_x, LOW_SPEED)
    kappa = jnp.clip((v_x - turning) / speed, _LEAST_KAPPA, _LOCKED)
    return Slips(kappa, jnp.arctan2(v_y, speed), speed)


class RoadTire(eqx.Module):
    """A tire with a table of its peaks.

    ``peak`` (roads, speeds, loads): largest force over load; ``at``: its kappa, for the
    ascending frictions ``roads``, for ``speeds`` [m/s] and ``loads`` [N]; ``usual``: the
    peak of the given tire, mu_0.
    """

    tire: AbstractTire
    usual: Float[Array, ""]
    roads: Float[Array, " m"]
    speeds: Float[Array, " s"]
    loads: Float[Array, " l"]
    peak: Float[Array, "m s l"]
    at: Float[Array, "m s l"]

    def forces(
        self, mu: Float[Array, " w"], slips: Slips, fz: Float[Array, " w"]
    ) -> tuple[Float[Array, " w"], Float[Array, " w"]]:
        """Forces [N] (w,) along and across wheels on a road of friction mu (w,)."""
        return jax.vmap(self._force)(mu, *slips, jnp.maximum(fz, _LEAST_LOAD))

    def _force(self, mu, kappa, alpha, speed, fz):
        inputs = _similar(mu / self.usual, kappa, alpha, speed, fz)
        made = self.tire(inputs)
        across = jnp.zeros(()) if made.fy is None else made.fy
        return mu / self.usual * made.fx, mu / self.usual * across

    def peaks(self, mu, speed, fz):
        """Largest braking force over load (w,) on roads mu (w,), at speeds [m/s] and
        loads [N] (w,); and its kappa (w,)."""
        place = [
            jnp.interp(value, known, jnp.arange(len(known), dtype=float))
            for value, known in ((mu, self.roads), (speed, self.speeds), (fz, self.loads))
        ]
        peak, at = (
            jax.scipy.ndimage.map_coordinates(table, place, order=1, mode="nearest")
            for table in (self.peak, self.at)
        )
        return peak, at


def _similar(factor, kappa, alpha, speed, fz) -> TireInputs:
    """The inputs of the given tire that are similar to inputs on a road."""
    sigma = sigma_from_kappa(kappa)
    scaled = sigma / factor
    # Change alpha and speed so that sigma_y is scaled and v_s is not.
    narrower = (1 + sigma) / (1 + scaled)
    angle = jnp.arctan(jnp.tan(alpha) / factor * narrower)
    return TireInputs(scaled, angle, fz, speed * factor / narrower)


def on_road(tire: AbstractTire, speed, fz, roads) -> RoadTire:
    """A tire with its peaks, for braking from ``speed`` [m/s] at load ``fz`` [N] on
    ``roads`` (m,), given by their friction."""
    # Decided here from the values of a .tir file, which a traced program does not know.
    return _peaked(tire, speed, fz, roads, "v" not in tire.needs)


@eqx.filter_jit
def _peaked(tire: AbstractTire, speed, fz, roads, one_speed: bool) -> RoadTire:
    shares = jnp.geomspace(0.01, 1.0, _SPEEDS)[-1 if one_speed else 0 :]
    speeds = jnp.asarray(speed) * shares
    loads = jnp.asarray(fz) * jnp.linspace(0.2, 2.4, _LOADS)
    roads = jnp.sort(jnp.asarray(roads, float))

    def own(k):
        return tire(TireInputs(sigma_from_kappa(k), 0.0, fz, speed)).fx / fz

    usual, _ = _highest(own)

    def highest(mu, v, load):
        def curve(k):
            inputs = _similar(mu / usual, k, 0.0, v, load)
            return mu / usual * tire(inputs).fx / load

        return _highest(curve)

    over_loads = jax.vmap(highest, (None, None, 0))
    over_speeds = jax.vmap(over_loads, (None, 0, None))
    peak, at = jax.vmap(over_speeds, (0, None, None))(roads, speeds, loads)
    return RoadTire(tire, usual, roads, speeds, loads, peak, at)


def _highest(curve):
    """Largest value of a curve over kappa, and its kappa; the first of a plateau."""
    grid = jnp.concatenate(
        [jnp.geomspace(1e-4, 0.1, _SLIPS), jnp.linspace(0.1, _LOCKED, _SLIPS)[1:]]
    )
    best = jnp.argmax(jax.vmap(curve)(grid))
    shorter = (np.sqrt(5) - 1) / 2

    def narrow(_, ends):
        low, high = ends
        left, right = high - shorter * (high - low), low + shorter * (high - low)
        keep = curve(left) >= curve(right)
        return jnp.where(keep, low, left), jnp.where(keep, right, high)

    ends = grid[jnp.maximum(best - 1, 0)], grid[jnp.minimum(best + 1, len(grid) - 1)]
    low, high = jax.lax.fori_loop(0, _HALVINGS, narrow, ends)
    place = (low + high) / 2
    return curve(place), place
