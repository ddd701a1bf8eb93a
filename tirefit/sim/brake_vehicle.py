"""The vehicle that is braked: a quarter car, or a car on four wheels.

Axes of ISO 8855 (x forward, y left) at the centre of gravity. Per-wheel values come
along one axis of length w: one wheel, or four in the order of
:data:`tirefit.data.table.WHEELS`.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float

from tirefit.data.table import WHEELS
from tirefit.sim.drive import Car

GRAVITY = 9.81

Wheels = Float[Array | np.ndarray, " w"]
Number = Float[Array | np.ndarray, ""] | float


class Vehicle(NamedTuple):
    """Masses, geometry and brakes.

    ``mass`` [kg], ``yaw_inertia`` [kg m2]; ``x``, ``y`` (w,) [m]: wheels from the
    centre of gravity; ``fz`` (w,) [N]: static loads; ``pitch``, ``roll`` (w,) [kg]:
    load gained by each m/s2 of deceleration, of acceleration to the left;
    ``transfer_time`` [s] in which they follow; ``radius`` (w,) [m], effective;
    ``inertia`` (w,) [kg m2] of a wheel; ``brake_gain`` (w,) [N m/Pa]: torque by
    pressure; ``steered`` (w,): 1 where the wheel is steered.
    """

    mass: Number
    yaw_inertia: Number
    x: Wheels
    y: Wheels
    fz: Wheels
    pitch: Wheels
    roll: Wheels
    transfer_time: Number
    radius: Wheels
    inertia: Wheels
    brake_gain: Wheels
    steered: Wheels

    @property
    def wheels(self) -> tuple[str, ...]:
        """Suffixes of the wheels' columns: none for a quarter car."""
        return tuple(f"_{name}" for name in WHEELS) if len(self.fz) == 4 else ("",)


_FRONT_GAIN, _REAR_GAIN = 1.35e-4, 0.75e-4
"""Brake torque by pressure [N m/Pa]. At the front of :class:`Car` 3 MPa then stay just
below the friction of packed snow (mu 0.35), as in O Figure 3 (b); the rear, with three
fifths of it, has the smaller share that its load under braking asks for."""
_TRANSFER_TIME = 0.1


def four_wheels() -> Vehicle:
    """A car whose loads move between front and rear, left and right."""
    car = Car()
    base = car.l_f + car.l_r
    front = np.array([1.0, 1.0, 0.0, 0.0])
    left = np.array([1.0, -1.0, 1.0, -1.0])
    weight = car.mass * GRAVITY / base / 2
    share = np.where(front == 1, car.l_r, car.l_f) / base
    return Vehicle(
        mass=car.mass, yaw_inertia=car.yaw_inertia,
        x=np.where(front == 1, car.l_f, -car.l_r), y=left * car.track / 2,
        fz=weight * np.where(front == 1, car.l_r, car.l_f),
        pitch=car.mass * car.height / base / 2 * (2 * front - 1),
        roll=-left * share * car.mass * car.height / car.track,
        transfer_time=_TRANSFER_TIME, radius=np.full(4, car.radius),
        inertia=np.full(4, car.wheel_inertia),
        brake_gain=np.where(front == 1, _FRONT_GAIN, _REAR_GAIN), steered=front,
    )  # fmt: skip


def quarter_car() -> Vehicle:
    """One front wheel with the mass that it carries; its load is constant."""
    car = Car()
    load = car.mass * GRAVITY * car.l_r / (car.l_f + car.l_r) / 2
    zero = np.zeros(1)
    return Vehicle(
        mass=load / GRAVITY, yaw_inertia=1.0, x=zero, y=zero, fz=np.array([load]),
        pitch=zero, roll=zero, transfer_time=_TRANSFER_TIME,
        radius=np.array([car.radius]), inertia=np.array([car.wheel_inertia]),
        brake_gain=np.array([_FRONT_GAIN]), steered=zero,
    )  # fmt: skip
