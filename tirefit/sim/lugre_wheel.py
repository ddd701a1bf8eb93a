r"""A braked wheel on a LuGre tire whose bristles follow in time.

The balance of :mod:`tirefit.sim.braking`, :math:`J \dot\Omega = R F - T`, together with
the bristles of :mod:`tirefit.sim.lugre`: those of the whole patch, or their mean, which
the tread carries out of the patch at the rate :math:`\kappa |\Omega R| / 2a`,

.. math:: \dot z = v_s - \frac{\sigma_0 |v_s|}{\theta g(v_s)} z
    - \kappa \frac{|\Omega R|}{2a} z

With kappa = 2 it is as stiff at small slip as the patch under an even pressure.
"""

from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from tirefit.models import LuGre
from tirefit.online.lugre_observer import peak_share
from tirefit.sim.lugre import (
    Bristles,
    Contact,
    bristle_forces,
    bristle_rate,
    distributed,
)

__all__ = ["PATCH", "WheelNumbers", "averaged", "lugre_tire", "lugre_wheel"]

_SLOWEST = 0.01
"""Wheel speed over that of free rolling below which a wheel is locked."""


def averaged(kappa: float = 2.0) -> Bristles:
    """One bristle for the mean of the patch, carried out of it at the rate kappa."""
    return Bristles(np.ones(1), np.ones(1), np.full((1, 1), kappa))


PATCH = distributed(1)
"""Four bristles: S(18) to 1e-4 of the load."""


def lugre_tire(peak: float, v: float) -> LuGre:
    """The LuGre tire with g replaced by theta g, S section 3.4, for a wanted peak.

    Args:
        peak: largest steady force over the load [-] at the speed v [m/s].
    """
    tire = LuGre()
    low, high = 0.005, 4.0
    for _ in range(50):
        theta = (low + high) / 2
        beyond = float(peak_share(tire, theta, v)) > peak
        low, high = (low, theta) if beyond else (theta, high)
    return LuGre(mu_s=theta * tire.mu_s, mu_c=theta * tire.mu_c)


class WheelNumbers(NamedTuple):
    """What :class:`tirefit.sim.braking.Braking` says, as numbers: the full torque
    [N m], period [s], radius [m], inertia [kg m2], speed [m/s], load [N], time of the
    change and interval of the samples [s]."""

    full: Any
    period: Any
    radius: Any
    inertia: Any
    v: Any
    fz: Any
    change: Any
    interval: Any


def lugre_wheel(
    numbers: WheelNumbers, tires: tuple[LuGre, LuGre], bristles: Bristles, time, teeth
):
    """Wheel speed [rad/s], force [N] and mean deflection [m] at the times (n,).

    Args:
        numbers: of the wheel and its brake.
        tires: before and after the change.
        bristles: :data:`PATCH`, or ``averaged()``.
        time: increasing instants [s]; ``teeth``: saw-teeth until then.
    """
    traced = jax.tree.map(lambda x: jnp.asarray(x, float), (numbers, tires))
    moved = _integrate(traced, bristles, jnp.asarray(time), teeth)
    return tuple(np.asarray(part) for part in moved)


def _contact(numbers: WheelNumbers, turning) -> Contact:
    rolling = numbers.v * turning
    return Contact(jnp.stack([numbers.v - rolling, 0.0]), rolling, numbers.fz)


@eqx.filter_jit
def _integrate(traced, bristles, time, teeth: int):
    numbers, tires = traced
    _, period, radius, inertia, v, _, change, interval = numbers

    def parts(t, y):
        turning, z = jnp.clip(y[0], _SLOWEST), y[1]
        tire = jax.tree.map(lambda a, b: jnp.where(t < change, a, b), *tires)
        now = _contact(numbers, turning)
        force = bristle_forces(tire, bristles, z, now).fx
        return tire, now, turning, force

    def rate(t, y, args):
        del args
        tire, now, turning, force = parts(t, y)
        torque = numbers.full * (t % period) / period
        # A brake holds a wheel that stands; it does not turn it.
        holds = (turning <= _SLOWEST) & (torque > radius * force)
        spun = jnp.where(holds, 0.0, (radius * force - torque) * radius / inertia / v)
        return spun, bristle_rate(tire, bristles, y[1], now)

    jumps = jnp.append(period * jnp.arange(1, teeth + 1), change)
    controller = diffrax.ClipStepSizeController(
        diffrax.PIDController(rtol=1e-7, atol=1e-10, dtmax=interval), step_ts=time,
        jump_ts=jnp.sort(jnp.where(jnp.isfinite(jumps), jumps, time[-1] + 1.0)),
    )  # fmt: skip
    rest = jnp.ones(()), jnp.zeros((len(bristles.weight), 2))
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(rate), diffrax.Tsit5(), time[0], time[-1], None, rest,
        saveat=diffrax.SaveAt(ts=time), stepsize_controller=controller,
        max_steps=2**22,
    )  # fmt: skip

    def seen(t, y):
        _, _, turning, force = parts(t, y)
        return turning * v / radius, force, jnp.asarray(bristles.weight) @ y[1][:, 0]

    return jax.vmap(seen)(time, solution.ys)
