"""A braking manoeuvre in closed loop: plant, sensors and any controller, in one scan.

The loop takes any controller: a record with ``rate``, ``init`` and ``step``
(:mod:`tirefit.online.controller`). Many stops are run by ``vmap`` over it.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from tirefit.online.controller import Measurement, Truth
from tirefit.sim.brake_plant import (
    Contacts,
    Drive,
    Motion,
    Plant,
    accelerations,
    advance,
    contacts,
    rolling,
)
from tirefit.sim.brake_vehicle import Noise, Sensors, draw_noise, wheel_speeds

STANDS = 0.1
"""Speed [m/s] below which the car has stopped: 1.3 cm before standstill at mu 0.04."""
SPUN = 1.5708  # heading [rad] above which a car has spun: at right angles to its first one
_RUN_IN = 2.0  # time [s] of a turn at constant speed before braking


class Log(NamedTuple):
    """The record of a stop, sample by sample: (n,) or (n, w); SI, braking positive."""

    moving: Float[Array, "*n"]  # 1 while the car moves
    motion: Motion
    contacts: Contacts
    xbs_true: Float[Array, "*n w"]  # [N s/m] slope of force by slip velocity
    valve: Float[Array, "*n w"]  # command at the valve, after the delay
    d: Float[Array, "*n w"]  # [N] force of the uneven road
    reading: Measurement  # sensor values, and the true peaks
    info: dict[str, Float[Array, "*n w"]]  # of the controller
    fine: Float[Array, "*n"]  # 1 if the integration to the next sample succeeded


def xbs_true(plant: Plant, s: Motion) -> Float[Array, " w"]:
    """Slope k [N s/m] of each braking force over its slip velocity, O(1)-(2)."""

    def braked(omega):
        return contacts(plant, s._replace(omega=omega)).fx

    # A force depends only on the speed of its own wheel; slip velocity is v - R omega.
    _, slope = jax.jvp(braked, (s.omega,), (jnp.ones_like(s.omega),))
    return -slope / jnp.asarray(plant.vehicle.radius, float)


def _read(plant: Plant, sensors: Sensors, s, now: Contacts, t, noise: Noise, d):
    """The sensor values in a state, with forces d (w,) [N] of the uneven road."""
    peak, at = plant.tire.peaks(now.mu, now.slips.speed, now.fz)
    slowing, _, _ = accelerations(plant, now.fx + d, now.fy)
    turning = s.omega * jnp.asarray(plant.vehicle.radius)
    return Measurement(
        time=t,
        wheel_speed=wheel_speeds(sensors, turning, noise.speed),
        pressure=s.pressure + sensors.pressure_std * noise.pressure,
        deceleration=slowing + sensors.deceleration_std * noise.deceleration,
        demand=plant.hydraulics.master(t),
        steering=plant.steering,
        yaw_rate=s.yaw_rate,
        truth=Truth(now.v_x, now.slips.kappa, at, peak, now.fz),
    )


def _moves(s: Motion, start: Motion):
    """1 while the car has neither stopped nor spun."""
    spun = jnp.abs(s.heading - start.heading) > SPUN
    return ((s.v_x > STANDS) & ~spun).astype(float)


def _loop(plant: Plant, controller, sensors, start: Motion, noise, queue, period):
    """The scan: the log of a stop that begins in a state; leaves (n, ...)."""
    static = jnp.asarray(plant.vehicle.fz, float)
    forces = noise.road * static[None]
    wheels = static.shape

    def read(s, t, at, d):
        return _read(plant, sensors, s, contacts(plant, s), t, at, d)

    at_samples = noise._replace(road=noise.road[:-1])
    first = jax.tree.map(lambda part: part[0], at_samples)
    memory = controller.init(read(start, jnp.zeros(()), first, forces[0]))

    def sample(carry, given):
        s, memory, waiting = carry
        k, at, begin, end = given
        t = k * period
        now = contacts(plant, s)
        reading = _read(plant, sensors, s, now, t, at, begin)
        memory, command, info = controller.step(memory, reading)
        asked = jnp.clip(command.valve, -1.0, 1.0)
        waiting = jnp.concatenate([waiting, asked[None]])
        valve, waiting = waiting[0], waiting[1:]
        moving = _moves(s, start)
        drive = Drive(valve, begin, end, jnp.zeros(()), moving)
        later, fine = advance(plant, s, drive, t, period)
        row = Log(moving, s, now, xbs_true(plant, s), valve, begin, reading, info, fine)
        return (later, memory, waiting), row

    n = len(noise.deceleration)
    given = (jnp.arange(n, dtype=float), at_samples, forces[:-1], forces[1:])
    carry = (start, memory, jnp.zeros((queue, *wheels)))
    _, log = jax.lax.scan(sample, carry, given)
    return log


def _started(plant: Plant, speed) -> Motion:
    """The state in which braking begins: straight ahead, or in a steady turn if steered."""
    straight = rolling(plant, speed)
    if plant.vehicle.steered.shape == (1,):
        return straight
    none = jnp.zeros_like(straight.omega)
    drive = Drive(none, none, none, jnp.ones(()), jnp.ones(()))
    turning, _ = advance(plant, straight, drive, jnp.zeros(()), _RUN_IN)
    zero = jnp.zeros(())
    return turning._replace(distance=zero, x=zero, y=zero, heading=zero)


@eqx.filter_jit
def simulate_stop(
    plant: Plant, controller, sensors: Sensors, speed, key, samples: int, queue: int
) -> Log:
    """Simulate one stop.

    Args:
        plant: vehicle, tire, road, hydraulics: leaves are arrays.
        controller: a record with ``period``, ``init`` and ``step``.
        sensors: the noise of the sensors.
        speed: initial speed [m/s].
        key: random key of the noise.
        samples: time limit, in samples of the controller.
        queue: delay of a command, in samples.

    Returns:
        The log, leaves (samples, ...); after the stop its rows repeat.
    """
    wheels = len(plant.vehicle.fz)
    noise = draw_noise(key, sensors, samples, wheels, controller.rate)
    start = _started(plant, speed)
    period = 1 / controller.rate
    return _loop(plant, controller, sensors, start, noise, queue, period)
