r"""A wheel with saw-tooth brake torque, integrated by diffrax.

The balance is :math:`J \dot\Omega = R F - T`. The force is that of a tire in steady state
at the slip, or that of a transient LuGre tire with bristles (:mod:`tirefit.sim.lugre`).
"""

from functools import cache
from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from tirefit.models import LuGre
from tirefit.online.lugre_observer import peak_share
from tirefit.results import UsageError
from tirefit.sim.lugre import Bristles, Contact, bristle_forces, bristle_rate, distributed

SLOWEST = 0.01
"""Wheel speed over that of free rolling below which a wheel is locked: a brake can hold
a wheel but cannot turn it backwards."""


PATCH = distributed(1)  # four bristles: S(18) to 1e-4 of the load
STEADY = Bristles(np.zeros(0), np.zeros(0), np.zeros((0, 0)))
"""No bristles: the force of a tire in steady state follows the slip without lag."""


@cache
def lugre_tire(peak: float, v: float) -> LuGre:
    """The LuGre tire with a given peak: g is replaced by theta g, S section 3.4.

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
    """Numbers of :class:`tirefit.sim.settings.Braking`: the full torque [N m], period
    [s], radius [m], inertia [kg m2], speed [m/s], load [N], time of the change of
    friction [s] and sampling interval [s]."""

    full: Any
    period: Any
    radius: Any
    inertia: Any
    v: Any
    fz: Any
    change: Any
    interval: Any


def braked_wheel(
    numbers: WheelNumbers, tires: tuple, bristles: Bristles, time, teeth: int, max_steps=2**22
) -> tuple[np.ndarray, ...]:
    """Wheel speed [rad/s], force [N] and mean deflection [m] at the times (n,).

    Args:
        numbers: of the wheel and its brake.
        tires: before and after the change, two :class:`LuGre` or two steady tires.
        bristles: :data:`PATCH` for LuGre tires; :data:`STEADY` for steady tires.
        time: increasing instants [s]; ``teeth``: number of saw-teeth.
        max_steps: limit of integration steps.

    Raises:
        UsageError: the braking needs more steps.
    """
    traced = jax.tree.map(lambda x: jnp.asarray(x, float), (numbers, tires))
    *moved, followed = _integrate(traced, bristles, jnp.asarray(time), teeth, max_steps)
    if not followed:
        raise UsageError(
            f"the braking needs more than {max_steps} steps", "shorten it or raise the inertia"
        )
    return tuple(np.asarray(part) for part in moved)


@eqx.filter_jit
def _integrate(traced, bristles, time, teeth: int, max_steps: int):
    numbers, tires = traced
    _, period, radius, inertia, v, fz, change, interval = numbers

    def parts(t, y):
        """Wheel speed over that of free rolling, force, rate of the bristles."""
        turning, z = jnp.clip(y[0], SLOWEST), y[1]
        tire = jax.tree.map(lambda a, b: jnp.where(t < change, a, b), *tires)
        if not len(bristles.place):
            return turning, tire.pure(1 - turning, fz), z
        now = Contact(jnp.stack([v - v * turning, 0.0]), v * turning, fz)
        force = bristle_forces(tire, bristles, z, now).fx
        return turning, force, bristle_rate(tire, bristles, z, now)

    def rate(t, y, args):
        del args
        turning, force, bent = parts(t, y)
        torque = numbers.full * (t % period) / period
        # A brake holds a standing wheel; it does not turn it backwards.
        holds = (turning <= SLOWEST) & (torque > radius * force)
        spun = jnp.where(holds, 0.0, (radius * force - torque) * radius / inertia / v)
        return spun, bent

    jumps = jnp.append(period * jnp.arange(1, teeth + 1), change)
    controller = diffrax.ClipStepSizeController(
        diffrax.PIDController(rtol=1e-7, atol=1e-10, dtmax=interval),
        step_ts=time,
        jump_ts=jnp.sort(jnp.where(jnp.isfinite(jumps), jumps, time[-1] + 1.0)),
    )
    rest = jnp.ones(()), jnp.zeros((len(bristles.weight), 2))
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(rate),
        diffrax.Tsit5(),
        time[0],
        time[-1],
        None,
        rest,
        saveat=diffrax.SaveAt(ts=time),
        stepsize_controller=controller,
        max_steps=max_steps,
        throw=False,
    )

    def seen(t, y):
        turning, force, _ = parts(t, y)
        return turning * v / radius, force, jnp.asarray(bristles.weight) @ y[1][:, 0]

    return *jax.vmap(seen)(time, solution.ys), diffrax.is_successful(solution.result)
