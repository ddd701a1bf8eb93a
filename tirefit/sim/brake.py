r"""A braked vehicle in closed loop: equations of motion, sensors, and any controller.

Braking forces :math:`F_x` are positive, lateral forces point to the right for a positive
slip angle, and forces :math:`d` of the uneven road add to the braking forces, O(1):

.. math::
   J \dot\omega_i &= R (F_{x,i} + d_i) - T_i, \quad T_i = g_i p_i \\
   m (\dot v_x - v_y r) &= X, \quad m (\dot v_y + v_x r) = Y, \quad I_z \dot r = N

The loads follow the accelerations with a lag. The brake is dry friction: it holds a
locked wheel at exactly zero speed until the road turns it, and never turns it backwards.
diffrax integrates from one sample of the controller (:mod:`tirefit.online.braking.controller`) to
the next with an explicit method of order five. At low speed its steps become shorter, as the slip
is stiff with :math:`C_x R^2/(J v)` (bounded by :data:`tirefit.sim.brake_vehicle.LOW_SPEED`).
"""

from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tirefit.arrays import Number, Numbers, Scalar
from tirefit.online.braking.controller import AbstractController, Measurement, Truth
from tirefit.sim.brake_vehicle import Hydraulics, Road, RoadTire, Slips, Vehicle, wheel_slips
from tirefit.sim.drive import pushed

Wheels = Float[Array, " w"]


class Plant(NamedTuple):
    """The vehicle, its tires and the road; ``steering`` [rad] of the steered wheels."""

    vehicle: Vehicle
    tire: RoadTire
    road: Road
    hydraulics: Hydraulics
    steering: Number


class Motion(NamedTuple):
    """State of the vehicle."""

    distance: Number  # [m] travelled
    x: Number  # [m] position on the ground
    y: Number  # [m]
    heading: Number  # [rad]
    v_x: Number  # [m/s]
    v_y: Number  # [m/s]
    yaw_rate: Number  # [rad/s]
    slowing: Number  # [m/s2] deceleration, lagged, that sets the loads
    aside: Number  # [m/s2] acceleration to the left, lagged, that sets the loads
    omega: Wheels  # [rad/s]
    pressure: Wheels  # [Pa]


class Contacts(NamedTuple):
    """Slips, friction, loads and forces of the wheels in a state, (w,) each."""

    slips: Slips
    v_x: Wheels  # [m/s] along the wheels
    mu: Wheels  # friction of the road
    fz: Wheels  # [N]
    fx: Wheels  # [N]
    fy: Wheels  # [N]


class Drive(NamedTuple):
    """The inputs between two samples."""

    valve: Wheels
    begin: Wheels  # [N] force d of the uneven road at the first sample
    end: Wheels  # [N] at the second sample; linear in between
    free: Number  # 1 while the car rolls unbraked at constant speed, before braking
    moving: Number  # 0 when it stands and the state is constant


def rolling(plant: Plant, speed: Number) -> Motion:
    """The state of straight, unbraked rolling at a speed [m/s]."""
    zero = jnp.zeros(())
    still = dict.fromkeys(Motion._fields, zero)
    radius = jnp.asarray(plant.vehicle.radius, float)
    speed = jnp.asarray(speed, float)
    wheels = {"omega": speed / radius, "pressure": jnp.zeros_like(radius)}
    return Motion(**still | {"v_x": speed} | wheels)


def contacts(plant: Plant, s: Motion) -> Contacts:
    """The :class:`Contacts` of a state."""
    car = plant.vehicle
    turn = jnp.asarray(car.steered) * plant.steering
    cos, sin = jnp.cos(turn), jnp.sin(turn)
    ahead = s.v_x - s.yaw_rate * car.y
    left = s.v_y + s.yaw_rate * car.x
    along, across = ahead * cos + left * sin, left * cos - ahead * sin
    slips = wheel_slips(along, across, s.omega * car.radius)
    fz = jnp.maximum(car.fz + car.pitch * s.slowing + car.roll * s.aside, 0.0)
    mu = plant.road.mu(s.distance + car.x - jnp.max(jnp.asarray(car.x)), car.y)
    fx, fy = plant.tire.forces(mu, slips, fz)
    return Contacts(slips, along, mu, fz, jnp.where(fz > 0, fx, 0.0), fy * (fz > 0))


def accelerations(plant: Plant, fx: Array, fy: Array) -> tuple[Array, Array, Array]:
    """Deceleration, acceleration to the left [m/s2], yaw acceleration [rad/s2], under
    forces (w,) [N] along and across the wheels."""
    car = plant.vehicle
    turn = jnp.asarray(car.steered) * plant.steering
    forward, left, moment = pushed(turn, car.x, car.y, fx, -fy)
    return -forward / car.mass, left / car.mass, moment / car.yaw_inertia


def _rate(since: Numbers, s: Motion, args: tuple[Plant, Drive, Scalar, Scalar]) -> Motion:
    plant, drive, start, period = args
    car = plant.vehicle
    now = contacts(plant, s)
    share = since / period
    felt = now.fx + drive.begin + share * (drive.end - drive.begin)
    slowing, aside, yawing = accelerations(plant, felt, now.fy)
    turned = felt * car.radius - jnp.asarray(car.brake_gain) * s.pressure
    # A brake holds a standing wheel; it does not turn it backwards.
    holds = (s.omega <= 0) & (turned < 0)
    flow = plant.hydraulics.flow(start + since, s.pressure, drive.valve)
    cos, sin = jnp.cos(s.heading), jnp.sin(s.heading)
    rate = Motion(
        distance=s.v_x,
        x=s.v_x * cos - s.v_y * sin,
        y=s.v_x * sin + s.v_y * cos,
        heading=s.yaw_rate,
        v_x=jnp.where(drive.free > 0, 0.0, -slowing + s.v_y * s.yaw_rate),
        v_y=aside - s.v_x * s.yaw_rate,
        yaw_rate=yawing,
        slowing=(slowing - s.slowing) / car.transfer_time,
        aside=(aside - s.aside) / car.transfer_time,
        omega=jnp.where(holds, 0.0, turned / car.inertia),
        pressure=jnp.where(drive.free > 0, 0.0, flow),
    )
    return jax.tree.map(lambda value: value * drive.moving, rate)


TOLERANCE = 1e-6  # largest error of a step, in units of the scales below
_SCALES = {"heading": 0.1, "yaw_rate": 0.1, "pressure": 1e6}
"""Scales of the errors of states; 1 in SI units for the others."""


def _error(scaled: Motion) -> Array:
    """Largest error over its scale; each wheel must meet the tolerance."""
    parts = scaled._asdict().items()
    sizes = [jnp.max(jnp.abs(e)) / _SCALES.get(name, 1.0) for name, e in parts]
    return jnp.max(jnp.stack(sizes))


def advance(
    plant: Plant, s: Motion, drive: Drive, t: Number, period: float
) -> tuple[Motion, Number]:
    """The state after ``period`` [s], and whether the integration succeeded (1 or 0).

    Args:
        t: time [s] of the state ``s`` since braking began.
        period: a number, not an array.
    """
    # Absolute errors in units of the scales suffice: no state grows far beyond its scale.
    controller = diffrax.PIDController(rtol=0.0, atol=TOLERANCE, norm=_error)
    # Counted from the sample: diffrax then knows the times as it traces, and need not
    # check them in the program. One that calls Python back to complain is not kept
    # between processes, and a stop takes seconds to compile.
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(_rate), diffrax.Tsit5(), 0.0, period, period, s,
        (plant, drive, t, period), stepsize_controller=controller,
        saveat=diffrax.SaveAt(t1=True), max_steps=4096, throw=False,
    )  # fmt: skip
    end = jax.tree.map(lambda value: value[0], solution.ys)
    # A step beyond standstill is within the tolerance of the solver.
    end = end._replace(omega=jnp.maximum(end.omega, 0.0), pressure=jnp.maximum(end.pressure, 0.0))
    fine = solution.result == diffrax.RESULTS.successful
    return end, fine.astype(float)


class Sensors(NamedTuple):
    """Noise of the sensors and unevenness of the road."""

    speed_std: float = 0.005  # [m/s] of a wheel's circumferential speed
    speed_step: float = 0.01  # [m/s] resolution of that speed
    deceleration_std: float = 0.1  # [m/s2]
    pressure_std: float = 2e4  # [Pa]
    road_std: float = 0.01  # standard deviation of the force d over the static load
    road_corner: float = 1.0  # [Hz] corner frequency of d


class Noise(NamedTuple):
    """Standard normal numbers of a stop of n samples on w wheels. ``road`` (n + 1, w) is
    the force d over the static load, a stationary process of first order. In the 2-20 Hz
    of O, above its corner, the rate of d is white: the w of O(2)."""

    speed: Float[Array, "n w"]
    pressure: Float[Array, "n w"]
    deceleration: Float[Array, " n"]
    road: Float[Array, "m w"]


def draw_noise(key: Array, sensors: Sensors, samples: int, wheels: int, rate: float) -> Noise:
    """The noise of one stop; controllers with the same key have the same noise."""
    keys = jax.random.split(key, 4)
    shape = (samples, wheels)
    kept = jnp.exp(-2 * np.pi * sensors.road_corner / rate)
    pushes = jax.random.normal(keys[3], (samples + 1, wheels))

    def move(d: Array, push: Array) -> tuple[Array, Array]:
        d = kept * d + jnp.sqrt(1 - kept**2) * push
        return d, d

    first, rest = pushes[0], pushes[1:]
    _, later = jax.lax.scan(move, first, rest)
    road = sensors.road_std * jnp.concatenate([first[None], later])
    return Noise(
        jax.random.normal(keys[0], shape),
        jax.random.normal(keys[1], shape),
        jax.random.normal(keys[2], (samples,)),
        road,
    )


def wheel_speeds(sensors: Sensors, turning: Array, noise: Array) -> Array:
    """Measured circumferential speeds (w,) [m/s]: with noise, then rounded to steps; zero
    for a standing wheel, which gives no pulses."""
    step = sensors.speed_step
    noisy = turning + sensors.speed_std * noise * (turning > 0)
    safe = jnp.where(step > 0, step, 1.0)
    reported = jnp.where(step > 0, jnp.round(noisy / safe) * step, noisy)
    return jnp.maximum(reported, 0.0)


STANDS = 0.1
"""Speed [m/s] below which the car has stopped: 1.3 cm before standstill at mu 0.04."""
SPUN = 1.5708  # heading [rad] above which a car has spun: at right angles to its first one


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

    def braked(omega: Array) -> Array:
        return contacts(plant, s._replace(omega=omega)).fx

    # A force depends only on the speed of its own wheel; slip velocity is v - R omega.
    _, slope = jax.jvp(braked, (s.omega,), (jnp.ones_like(s.omega),))
    return -slope / jnp.asarray(plant.vehicle.radius, float)


def _read(
    plant: Plant, sensors: Sensors, s: Motion, now: Contacts, t: Array, noise: Noise, d: Array
) -> Measurement:
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


@eqx.filter_jit
def simulate_stop(
    plant: Plant, controller: AbstractController, sensors: Sensors, speed: Number, key: Array,
    samples: int, queue: int,
) -> Log:  # fmt: skip
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
    period, zero = 1 / controller.rate, jnp.zeros(())
    static = jnp.asarray(plant.vehicle.fz, float)
    noise = draw_noise(key, sensors, samples, len(static), controller.rate)
    start = rolling(plant, speed)
    if len(static) > 1:  # begin in a steady turn, if steered
        none = jnp.zeros_like(start.omega)
        drive = Drive(none, none, none, jnp.ones(()), jnp.ones(()))
        # Time [s] of a turn at constant speed before braking.
        start, _ = advance(plant, start, drive, zero, 2.0)
        start = start._replace(distance=zero, x=zero, y=zero, heading=zero)
    forces = noise.road * static[None]
    at_samples = noise._replace(road=noise.road[:-1])
    first = jax.tree.map(lambda part: part[0], at_samples)
    now = contacts(plant, start)
    memory = controller.init(_read(plant, sensors, start, now, zero, first, forces[0]))

    def sample(carry: Any, given: Any) -> tuple[Any, Log]:
        s, memory, waiting = carry
        k, at, begin, end = given
        t = k * period
        now = contacts(plant, s)
        reading = _read(plant, sensors, s, now, t, at, begin)
        memory, asked, info = controller.step(memory, reading)
        waiting = jnp.concatenate([waiting, jnp.clip(asked, -1.0, 1.0)[None]])
        valve, waiting = waiting[0], waiting[1:]
        spun = jnp.abs(s.heading - start.heading) > SPUN
        moving = ((s.v_x > STANDS) & ~spun).astype(float)
        later, fine = advance(plant, s, Drive(valve, begin, end, zero, moving), t, period)
        row = Log(moving, s, now, xbs_true(plant, s), valve, begin, reading, info, fine)
        return (later, memory, waiting), row

    given = (jnp.arange(samples, dtype=float), at_samples, forces[:-1], forces[1:])
    carry = (start, memory, jnp.zeros((queue, *static.shape)))
    _, log = jax.lax.scan(sample, carry, given)
    return log
