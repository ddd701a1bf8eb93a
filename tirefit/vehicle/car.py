r"""A single-track car on the tires of two axles, integrated in JAX.

With the canonical forces :math:`F` (positive to the right) of the axles at their slip
angles, in the axes of ISO 8855 (x forward, y left, yaw counter-clockwise),

.. math::
   m (\dot v_y + v_x r) &= -(F_f \cos\delta + F_r), \quad
   I_z \dot r = -(l_f F_f \cos\delta - l_r F_r), \quad \dot\psi = r \\
   \dot x &= v_x \cos\psi - v_y \sin\psi, \quad
   \dot y = v_x \sin\psi + v_y \cos\psi

:math:`v_x` and :math:`\delta` are given by the log. :mod:`tirefit.data.vehicle.derive` solves the
same equations for the forces.
"""

import math
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tirefit.data.vehicle.vehicle import Vehicle
from tirefit.models import AbstractTire, TireForces, TireInputs
from tirefit.params import Values

_STABLE, _MOST_PARTS = 0.5, 50
"""Largest step of the integration over the car's shortest time constant; most steps
from one sample to the next."""

AXLES = ("front", "rear")
_NONE = 1e-9  # time constant [s] of no lag, and play [rad] of no play


class LinearTire(AbstractTire):
    """A lateral force in proportion to the slip angle.

    Attributes:
        stiffness: force over slip angle and load [1/rad].
    """

    stiffness: Float[Array, ""] | float

    def __call__(self, inputs: TireInputs) -> TireForces:
        force = jnp.asarray(self.stiffness * inputs.fz * inputs.alpha)
        return TireForces(None, force, None)


class Car(eqx.Module):
    """A car: mass, geometry, and front and rear tire, each for a whole axle.

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


def axle_loads(car: Car | Vehicle) -> tuple[jax.Array | float, jax.Array | float]:
    """Static load of the front and the rear axle [N]."""
    weight = car.mass * car.gravity / (car.l_f + car.l_r)
    return weight * car.l_r, weight * car.l_f


def car_of(vehicle: Vehicle, front: AbstractTire, rear: AbstractTire, inertia: Any = 1.0) -> Car:
    """The car of a vehicle on two tires; ``inertia`` is a factor on its yaw inertia."""
    v, turning = vehicle, inertia * vehicle.yaw_inertia
    return Car(front, rear, v.mass, turning, v.l_f, v.l_r, v.gravity)


class State(NamedTuple):
    """The predicted state: speed to the left [m/s] of the centre of gravity, yaw rate
    [rad/s], heading [rad] and position [m]."""

    v_y: Any
    yaw_rate: Any
    heading: Any
    x: Any
    y: Any


class Driven(NamedTuple):
    """A predicted motion at samples (n,): the states, both slip angles (n, 2) [rad] and the
    acceleration to the left [m/s2]."""

    states: State
    angles: Any
    lateral: Any


class Axle(NamedTuple):
    """Changes at an axle, each a number for each sample."""

    stiffness: Any = 1.0  # factor
    friction: Any = 1.0  # factor
    load: Any = 1.0  # factor
    slip: Any = 0.0  # added to the slip angle [rad]
    fall: Any = 0.0  # share of the friction that is lost while the tire slides
    sliding: Any = 1.0  # slip at which half of that is lost
    force: Any = 0.0  # added, to the right [N]


class Changes(NamedTuple):
    """Changes of the car, each a number for each sample."""

    front: Axle = Axle()
    rear: Axle = Axle()
    inertia: Any = 1.0  # factor
    l_f: Any = 0.0  # added [m]
    l_r: Any = 0.0  # added [m]
    force: Any = 0.0  # to the left [N]
    moment: Any = 0.0  # counter-clockwise [N m]
    relaxation: Any = 0.0  # distance [m] by which the slip angles lag


NO_CHANGES = Changes()


def slip_angles(
    car: Car,
    v_x: jax.Array,
    steering: jax.Array | float,
    v_y: jax.Array,
    yaw_rate: jax.Array,
    changes: Changes = NO_CHANGES,
) -> tuple[jax.Array, jax.Array]:
    """Slip angle [rad] of the front and the rear axle."""
    front = jnp.arctan2(v_y + (car.l_f + changes.l_f) * yaw_rate, v_x) - steering
    return front, jnp.arctan2(v_y - (car.l_r + changes.l_r) * yaw_rate, v_x)


def _across(
    tire: AbstractTire, slip: jax.Array, fz: jax.Array, v: jax.Array, axle: Axle
) -> jax.Array:
    """Force of an axle to the right [N]: stiffness times s and friction times g give
    g F(slip s / g), exact for a brush."""
    ratio = axle.stiffness / axle.friction
    angle = jnp.arctan(ratio * jnp.tan(slip + axle.slip))
    force = tire(TireInputs(alpha=angle, fz=fz * axle.load, v=v)).fy
    assert force is not None  # checked by axle_tire
    beyond = (jnp.tan(angle) / axle.sliding) ** 2
    return axle.friction * (1 - axle.fall * beyond / (1 + beyond)) * force + axle.force


def accelerations(
    car: Car,
    v_x: jax.Array,
    steering: jax.Array | float,
    v_y: jax.Array,
    yaw_rate: jax.Array,
    changes: Changes = NO_CHANGES,
    late: jax.Array | tuple[int, ...] = (0, 0),
) -> tuple[jax.Array, jax.Array]:
    """Lateral acceleration [m/s2] to the left, and yaw acceleration [rad/s2].

    Args:
        v_x: forward speed [m/s]; steering: road wheel angle [rad], left positive.
        changes: of this sample.
        late: what is added to the slip angles [rad].
    """
    l_f, l_r = car.l_f + changes.l_f, car.l_r + changes.l_r
    weight = car.mass * car.gravity / (l_f + l_r)
    front, rear = slip_angles(car, v_x, steering, v_y, yaw_rate, changes)
    f = _across(car.front, front + late[0], weight * l_r, v_x, changes.front)
    r = _across(car.rear, rear + late[1], weight * l_f, v_x, changes.rear)
    f = f * jnp.cos(steering)
    moment = changes.moment - (l_f * f - l_r * r)
    lateral = (changes.force - (f + r)) / car.mass
    return lateral, moment / (changes.inertia * car.yaw_inertia)


def steps_a_sample(car: Car, slowest: float, rate: float) -> int:
    """Steps of the integration from one sample to the next, at a rate [Hz]."""
    return min(max(math.ceil(stiffest(car, slowest) / rate / _STABLE), 1), _MOST_PARTS)


def stiffest(car: Car, slowest: float) -> float:
    """Fastest rate [1/s] of the dynamics of the car, at its slowest speed [m/s]."""
    return float(np.abs(np.linalg.eigvals(_slopes(car, slowest))).max())


@jax.jit
def _slopes(car: Car, speed: jax.Array) -> jax.Array:
    """Derivatives of the rates of v_y and yaw rate by both, driving straight ahead."""

    def moved(motion: jax.Array) -> jax.Array:
        lateral, yaw = accelerations(car, speed, 0.0, *motion)
        return jnp.stack([lateral - speed * motion[1], yaw])

    return jax.jacfwd(moved)(jnp.zeros(2))


_Moving = tuple[State, jax.Array]  # the motion of a car, and the lags of its slip angles [rad]


def predicted(
    car: Car,
    start: State,
    v_x: jax.Array,
    steering: jax.Array,
    step: float | Values,
    parts: int,
    changes: Changes = NO_CHANGES,
) -> Driven:
    """The motion at every sample, from a start state.

    Args:
        start: the state at the first sample, scalars.
        v_x, steering: (n,) at the samples, interpolated by :func:`cubic`.
        step: time between samples [s].
        parts: steps of Runge-Kutta of the fourth order from one sample to the next.
        changes: numbers or (n,), each held until the next sample.
    """
    width, count = step / parts, len(v_x) - 1
    each = lambda x: jnp.broadcast_to(jnp.asarray(x, float), count + 1)  # noqa: E731
    changes = jax.tree.map(each, changes)

    @jax.jit  # traced once for the four slopes of a step
    def slope(
        state: State, speed: jax.Array, angle: jax.Array, change: Changes, late: jax.Array
    ) -> State:
        motion = state.v_y, state.yaw_rate
        lateral, yaw = accelerations(car, speed, angle, *motion, change, late)
        cos, sin = jnp.cos(state.heading), jnp.sin(state.heading)
        return State(
            lateral - speed * state.yaw_rate,
            yaw,
            state.yaw_rate,
            speed * cos - state.v_y * sin,
            speed * sin + state.v_y * cos,
        )

    def onward(carried: _Moving, given: Any) -> tuple[_Moving, _Moving]:
        speeds, angles, change = given

        def steered(part: jax.Array) -> tuple[Any, Any]:
            share = part / parts
            return cubic(share, *speeds), cubic(share, *angles)

        def slips(part: jax.Array, state: State) -> jax.Array:
            motion = state.v_y, state.yaw_rate
            return jnp.stack(slip_angles(car, *steered(part), *motion, change))

        def small(k: jax.Array, carried: _Moving) -> _Moving:
            now, late = carried

            def at(share: float, move: State) -> State:
                moved = jax.tree.map(lambda s, m: s + share * width * m, now, move)
                return slope(moved, *steered(k + share), change, late)

            k1 = slope(now, *steered(k), change, late)
            k2 = at(0.5, k1)
            k3 = at(0.5, k2)
            k4 = at(1.0, k3)
            then = jax.tree.map(
                lambda s, a, b, c, d: s + width / 6 * (a + 2 * b + 2 * c + d), now, k1, k2, k3, k4
            )
            rate = (slips(k + 1.0, then) - slips(k, now)) / width
            return then, _later(late, rate, change.relaxation / speeds[0], width)

        carried = jax.lax.fori_loop(0, parts, small, carried)
        return carried, carried

    first = State(*(jnp.asarray(s, float) for s in start)), jnp.zeros(2)
    held: Changes = jax.tree.map(lambda x: x[:-1], changes)
    _, later = jax.lax.scan(onward, first, (_with_bends(v_x), _with_bends(steering), held))
    whole = lambda first, rest: jnp.concatenate([first[None], rest])  # noqa: E731
    states, late = jax.tree.map(whole, first, later)
    motion = v_x, steering, states.v_y, states.yaw_rate, changes
    lateral, _ = jax.vmap(partial(accelerations, car))(*motion, late)
    return Driven(states, jnp.stack(slip_angles(car, *motion), axis=1), lateral)


def cubic(
    share: jax.Array, first: jax.Array, last: jax.Array, bend: jax.Array, next_bend: jax.Array
) -> jax.Array:
    """Value at a share of the interval from one sample to the next, on the cubic through
    four samples; ``bend`` are their second differences."""
    pull = (2 - share) * bend + (1 + share) * next_bend
    return first + share * (last - first) - share * (1 - share) / 6 * pull


def _with_bends(values: jax.Array) -> tuple[jax.Array, ...]:
    """Arguments of :func:`cubic` for each sample but the last: four of (n - 1,)."""
    if len(values) < 3:
        return values[:-1], values[1:], jnp.zeros(1), jnp.zeros(1)
    bends = jnp.pad(jnp.diff(values, 2), 1, mode="edge")
    return values[:-1], values[1:], bends[:-1], bends[1:]


def delayed(values: jax.Array, samples: Values | float) -> jax.Array:
    """Values (n,) delayed by a number of samples; the first value before the start."""
    count = len(values) - 1
    place = jnp.clip(jnp.arange(count + 1) - samples, 0, count)
    whole = jnp.clip(jnp.floor(place).astype(int), 0, count - 1)
    return cubic(place - whole, *(part[whole] for part in _with_bends(values)))


def _later(late: jax.Array, rate: jax.Array, time: jax.Array, step: float | Values) -> jax.Array:
    """Distance, a step later, of a first-order lag with a time constant [s] from its
    input; exact for an input with constant rate, and smooth at a time constant of zero."""
    kept = jnp.exp(-step / jnp.maximum(time, _NONE))
    return late * kept - time * rate * (1 - kept)


def lagged(values: jax.Array, time: jax.Array, step: float | jax.Array) -> jax.Array:
    """Values (n,) through a first-order lag with a time constant [s]; no lag at first."""
    rates = jnp.diff(values) / step

    def onward(late: jax.Array, rate: jax.Array) -> tuple[jax.Array, jax.Array]:
        late = _later(late, rate, time, step)
        return late, late

    first = -time * rates[0]
    _, late = jax.lax.scan(onward, first, rates)
    return values + jnp.append(first, late)


def with_play(values: jax.Array, half: float) -> jax.Array:
    """Values (n,) with play: constant until the input differs by more than ``half``."""
    half = half + _NONE  # distinct sides of the gap

    def onward(held: jax.Array, value: jax.Array) -> tuple[jax.Array, jax.Array]:
        held = jnp.clip(held, value - half, value + half)
        return held, held

    return jax.lax.scan(onward, values[0], values)[1]
