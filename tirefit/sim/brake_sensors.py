"""What the sensors say, the uneven road, and the noise of both.

The force d of the road on a wheel is a stationary process of first order below whose
corner, under the 2-20 Hz that O listens to, its rate is white: the w of O(2).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


class Sensors(NamedTuple):
    """``speed_std`` [m/s]: noise of a wheel's circumferential speed; ``speed_step``
    [m/s], in which it is told; ``deceleration_std`` [m/s2]; ``pressure_std`` [Pa];
    ``road_std``: of the force d over the static load; ``road_corner`` [Hz]: of d."""

    speed_std: float = 0.005
    speed_step: float = 0.01
    deceleration_std: float = 0.1
    pressure_std: float = 2e4
    road_std: float = 0.01
    road_corner: float = 1.0


class Noise(NamedTuple):
    """Standard normal numbers of a stop of n samples on w wheels, except ``road``
    (n + 1, w): the force d over the static load."""

    speed: Float[Array, "n w"]
    pressure: Float[Array, "n w"]
    deceleration: Float[Array, " n"]
    road: Float[Array, "m w"]


def draw_noise(key, sensors: Sensors, samples: int, wheels: int, rate: float) -> Noise:
    """The noise of one stop; the same for every controller that has the key."""
    keys = jax.random.split(key, 4)
    shape = (samples, wheels)
    kept = jnp.exp(-2 * np.pi * sensors.road_corner / rate)
    pushes = jax.random.normal(keys[3], (samples + 1, wheels))

    def move(d, push):
        d = kept * d + jnp.sqrt(1 - kept**2) * push
        return d, d

    first, rest = pushes[0], pushes[1:]
    _, later = jax.lax.scan(move, first, rest)
    road = sensors.road_std * jnp.concatenate([first[None], later])
    return Noise(
        jax.random.normal(keys[0], shape), jax.random.normal(keys[1], shape),
        jax.random.normal(keys[2], (samples,)), road,
    )  # fmt: skip


def wheel_speeds(sensors: Sensors, turning, noise):
    """Circumferential speeds (w,) [m/s] as they are told: noise, then steps; a wheel
    that stands gives no pulses."""
    step = sensors.speed_step
    noisy = turning + sensors.speed_std * noise * (turning > 0)
    safe = jnp.where(step > 0, step, 1.0)
    told = jnp.where(step > 0, jnp.round(noisy / safe) * step, noisy)
    return jnp.maximum(told, 0.0)
