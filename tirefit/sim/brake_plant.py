r"""Equations of motion of a braked vehicle: body, wheels, tires, hydraulics.

Braking forces :math:`F_x` are positive, lateral forces point to the right for a positive
slip angle, and forces :math:`d` of the uneven road add to the braking forces, O(1):

.. math::
   J \dot\omega_i &= R (F_{x,i} + d_i) - T_i, \quad T_i = g_i p_i \\
   m (\dot v_x - v_y r) &= X, \quad m (\dot v_y + v_x r) = Y, \quad I_z \dot r = N

The loads follow the accelerations with a lag. The brake is dry friction: it holds a
locked wheel at exactly zero speed until the road turns it, and never turns it backwards.
diffrax integrates from one sample of the controller to the next with an explicit method
of order five. At low speed its steps become shorter, as the slip is stiff with
:math:`C_x R^2/(J v)` (bounded by :data:`tirefit.sim.brake_tire.LOW_SPEED`).
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


def _steer(plant: Plant):
    angle = jnp.asarray(plant.vehicle.steered) * plant.steering
    return jnp.cos(angle), jnp.sin(angle)


def contacts(plant: Plant, s: Motion) -> Contacts:
    """The :class:`Contacts` of a state."""
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


def _error(scaled: Motion):
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
