r"""A single-track car on two axles' tires, integrated in JAX.

With the canonical forces :math:`F` (positive to the right) of the axles at their slip
angles, in the axes of ISO 8855 (x forward, y left, yaw counter-clockwise),

.. math::
   m (\dot v_y + v_x r) &= -(F_f \cos\delta + F_r), \quad
   I_z \dot r = -(l_f F_f \cos\delta - l_r F_r), \quad \dot\psi = r \\
   \dot x &= v_x \cos\psi - v_y \sin\psi, \quad
   \dot y = v_x \sin\psi + v_y \cos\psi

:math:`v_x` and :math:`\delta` are given: they are the log's. The same equations, solved
for the forces, are those of :mod:`tirefit.data.derive`.
"""

import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from tirefit.data.vehicle import Vehicle
from tirefit.models import AbstractTire, TireInputs

_STABLE, _MOST_PARTS = 0.5, 50
"""Largest step of the integration over the car's shortest time constant; most steps
from one sample to the next."""


class Car(eqx.Module):
    """A car: front and rear tire of a whole axle, and what moves on them.

    Attributes:
        front, rear: tires; their loads are those of the axles.
        mass: [kg].
        yaw_inertia: about the centre of gravity [kg m2].
        l_f, l_r: the axles ahead of and behind the centre of gravity [m].
        gravity: [m/s2].
    """

    front: AbstractTire
    rear: AbstractTire
    mass: Float[Array, ""] | float
    yaw_inertia: Float[Array, ""] | float
    l_f: Float[Array, ""] | float
    l_r: Float[Array, ""] | float
    gravity: Float[Array, ""] | float

    @property
    def loads(self):
        """Static load of the front and the rear axle [N]."""
        weight = self.mass * self.gravity / (self.l_f + self.l_r)
        return weight * self.l_r, weight * self.l_f


def car_of(
    vehicle: Vehicle, front: AbstractTire, rear: AbstractTire, inertia=1.0
) -> Car:
    """The car of a vehicle on two tires; ``inertia`` is a factor on its yaw inertia."""
    return Car(
        front, rear, vehicle.mass, inertia * vehicle.yaw_inertia, vehicle.l_f,
        vehicle.l_r, vehicle.gravity,
    )  # fmt: skip


class State(NamedTuple):
    """What is predicted: speed to the left [m/s] of the centre of gravity, yaw rate
    [rad/s], heading [rad] and place [m]."""

    v_y: Any
    yaw_rate: Any
    heading: Any
    x: Any
    y: Any


def accelerations(car: Car, v_x, steering, v_y, yaw_rate):
    """Lateral acceleration [m/s2] to the left, and yaw acceleration [rad/s2].

    Args:
        v_x: forward speed [m/s]; steering: road wheel angle [rad], left positive.
    """
    ahead, behind = car.loads
    front = jnp.arctan2(v_y + car.l_f * yaw_rate, v_x) - steering
    rear = jnp.arctan2(v_y - car.l_r * yaw_rate, v_x)
    f = car.front(TireInputs(alpha=front, fz=ahead, v=v_x)).fy
    r = car.rear(TireInputs(alpha=rear, fz=behind, v=v_x)).fy
    assert f is not None and r is not None  # axle_tire has checked it
    f = f * jnp.cos(steering)
    return -(f + r) / car.mass, -(car.l_f * f - car.l_r * r) / car.yaw_inertia


def steps_a_sample(car: Car, slowest: float, rate: float) -> int:
    """Steps of the integration from one sample to the next, at a rate [Hz]."""
    return min(max(math.ceil(stiffest(car, slowest) / rate / _STABLE), 1), _MOST_PARTS)


def stiffest(car: Car, slowest: float) -> float:
    """Fastest rate [1/s] at which the car answers, at its slowest speed [m/s]."""

    def moved(motion):
        lateral, yaw = accelerations(car, slowest, 0.0, *motion)
        return jnp.stack([lateral - slowest * motion[1], yaw])

    slopes = jax.jacfwd(moved)(jnp.zeros(2))
    return float(jnp.max(jnp.abs(jnp.linalg.eigvals(slopes))))


def predicted(car: Car, start: State, v_x, steering, step: float, parts: int) -> State:
    """The states at every sample from a start on: (n,) each.

    Args:
        start: the state at the first sample, scalars.
        v_x, steering: (n,) at the samples, linear between them.
        step: time between samples [s].
        parts: steps of Runge-Kutta of the fourth order from one sample to the next.
    """
    width = step / parts

    def slope(state: State, speed, angle) -> State:
        lateral, yaw = accelerations(car, speed, angle, state.v_y, state.yaw_rate)
        cos, sin = jnp.cos(state.heading), jnp.sin(state.heading)
        return State(
            lateral - speed * state.yaw_rate, yaw, state.yaw_rate,
            speed * cos - state.v_y * sin, speed * sin + state.v_y * cos,
        )  # fmt: skip

    def onward(state: State, given):
        speed, angle, faster, turned = given

        def at(part, now, move):
            share = part / parts
            moved = jax.tree.map(lambda s, m: s + m, now, move)
            return slope(moved, speed + share * faster, angle + share * turned)

        def small(k, now):
            k1 = at(k, now, jax.tree.map(jnp.zeros_like, now))
            k2 = at(k + 0.5, now, jax.tree.map(lambda d: width / 2 * d, k1))
            k3 = at(k + 0.5, now, jax.tree.map(lambda d: width / 2 * d, k2))
            k4 = at(k + 1.0, now, jax.tree.map(lambda d: width * d, k3))
            return jax.tree.map(
                lambda s, a, b, c, d: s + width / 6 * (a + 2 * b + 2 * c + d),
                now, k1, k2, k3, k4,
            )  # fmt: skip

        state = jax.lax.fori_loop(0, parts, small, state)
        return state, state

    start = State(*(jnp.asarray(s, float) for s in start))
    given = (v_x[:-1], steering[:-1], jnp.diff(v_x), jnp.diff(steering))
    _, states = jax.lax.scan(onward, start, given)
    return jax.tree.map(lambda first, rest: jnp.append(first, rest), start, states)
