r"""A braked vehicle: body, wheels, tires, hydraulics, between two samples.

With braking forces :math:`F_x` positive, lateral forces to the right for a positive
slip angle, and forces :math:`d` of the uneven road that act with them, O(1):

.. math::
   J \dot\omega_i &= R (F_{x,i} + d_i) - T_i, \quad T_i = g_i p_i \\
   m (\dot v_x - v_y r) &= X, \quad m (\dot v_y + v_x r) = Y, \quad I_z \dot r = N

The loads follow the accelerations with a lag. The brake is dry friction: it holds a
wheel that stands until the road turns it, and never turns it itself, so a locked wheel
is exactly that. diffrax integrates from one sample of the controller to the next with
an explicit method of order five; steps shorten as the slip stiffens with
:math:`C_x R^2/(J v)` at low speed (:data:`tirefit.sim.brake_tire.LOW_SPEED` bounds it).
"""

from typing import NamedTuple

import diffrax
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from tirefit.sim.brake_tire import RoadTire, Slips, wheel_slips
from tirefit.sim.brake_vehicle import Hydraulics, Road, Vehicle

Wheels = Float[Array, " w"]
Number = Float[Array, ""]


class Plant(NamedTuple):
    """What is braked, and on what; ``steering`` [rad] of the steered wheels."""

    vehicle: Vehicle
    tire: RoadTire
    road: Road
    hydraulics: Hydraulics
    steering: Number


class Motion(NamedTuple):
    """State of the vehicle."""

    distance: Number  # [m] along the way
    x: Number  # [m] on the ground
    y: Number  # [m]
    heading: Number  # [rad]
    v_x: Number  # [m/s]
    v_y: Number  # [m/s]
    yaw_rate: Number  # [rad/s]
    slowing: Number  # [m/s2] backward, that the loads have followed
    aside: Number  # [m/s2] to the left, likewise
    omega: Wheels  # [rad/s]
    pressure: Wheels  # [Pa]


class Contacts(NamedTuple):
    """What a state does on the road, (w,) each."""

    slips: Slips
    v_x: Wheels  # [m/s] along the wheels
    mu: Wheels  # friction of the road
    fz: Wheels  # [N]
    fx: Wheels  # [N]
    fy: Wheels  # [N]


class Drive(NamedTuple):
    """What acts between two samples."""

    valve: Wheels
    begin: Wheels  # [N] force d of the uneven road at the first, linear between
    end: Wheels  # [N] at the second
    free: Number  # 1 where the car rolls unbraked at constant speed, before a manoeuvre
    moving: Number  # 0 where it stands, and nothing changes


def rolling(plant: Plant, speed: Number) -> Motion:
    """Straight on at a speed [m/s], without brakes."""
    zero = jnp.zeros(())
    still = dict.fromkeys(Motion._fields, zero)
    radius = jnp.asarray(plant.vehicle.radius, float)
    speed = jnp.asarray(speed, float)
    wheels = {"omega": speed / radius, "pressure": jnp.zeros_like(radius)}
    return Motion(**still | {"v_x": speed} | wheels)


def _steer(plant: Plant):
    angle = jnp.asarray(plant.vehicle.steered) * plant.steering
    return jnp.cos(angle), jnp.sin(angle)


def contacts(plant: Plant, s: Motion) -> Contacts:
    """Slips, loads and forces of a state."""
    car = plant.vehicle
    cos, sin = _steer(plant)
    ahead = s.v_x - s.yaw_rate * car.y
    left = s.v_y + s.yaw_rate * car.x
    along, across = ahead * cos + left * sin, left * cos - ahead * sin
    slips = wheel_slips(along, across, s.omega * car.radius)
    fz = jnp.maximum(car.fz + car.pitch * s.slowing + car.roll * s.aside, 0.0)
    mu = plant.road.mu(s.distance + car.x - jnp.max(jnp.asarray(car.x)), car.y)
    fx, fy = plant.tire.forces(mu, slips, fz)
    return Contacts(slips, along, mu, fz, jnp.where(fz > 0, fx, 0.0), fy * (fz > 0))


def _pushed(plant: Plant, fx, fy):
    """Force [N] on the car forward and to the left, and the yaw moment [N m]."""
    car = plant.vehicle
    cos, sin = _steer(plant)
    ahead, left = -fx * cos + fy * sin, -fx * sin - fy * cos
    moment = jnp.sum(jnp.asarray(car.x) * left - jnp.asarray(car.y) * ahead)
    return jnp.sum(ahead), jnp.sum(left), moment


def accelerations(plant: Plant, fx, fy):
    """Deceleration, acceleration to the left [m/s2], yaw acceleration [rad/s2], under
    forces (w,) [N] along and across the wheels."""
    car = plant.vehicle
    forward, left, moment = _pushed(plant, fx, fy)
    return -forward / car.mass, left / car.mass, moment / car.yaw_inertia


def _rate(since, s: Motion, args) -> Motion:
    plant, drive, start, period = args
    car = plant.vehicle
    now = contacts(plant, s)
    share = since / period
    felt = now.fx + drive.begin + share * (drive.end - drive.begin)
    slowing, aside, yawing = accelerations(plant, felt, now.fy)
    turned = felt * car.radius - jnp.asarray(car.brake_gain) * s.pressure
    # A brake holds a wheel that stands; it does not turn it.
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


TOLERANCE = 1e-6  # largest error of a step, in the scales below
_SCALES = {"heading": 0.1, "yaw_rate": 0.1, "pressure": 1e6}
"""Of states, by which their errors are judged; 1 in SI units of the others."""


def _error(scaled: Motion):
    """Largest error over its scale; every wheel is held to it alone."""
    parts = scaled._asdict().items()
    sizes = [jnp.max(jnp.abs(e)) / _SCALES.get(name, 1.0) for name, e in parts]
    return jnp.max(jnp.stack(sizes))


def advance(
    plant: Plant, s: Motion, drive: Drive, t: Number, period: float
) -> tuple[Motion, Number]:
    """The state after ``period`` [s], and whether the integration went well (1 or 0).

    Args:
        t: time [s] since the braking began, at ``s``.
        period: a number, not an array.
    """
    # Errors are absolute in units of the scales: none of the states outgrows its own.
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
    # What a step passed a standstill by is within its tolerance.
    end = end._replace(omega=jnp.maximum(end.omega, 0.0), pressure=jnp.maximum(end.pressure, 0.0))
    fine = solution.result == diffrax.RESULTS.successful
    return end, fine.astype(float)
