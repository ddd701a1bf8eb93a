"""The braked vehicle (a quarter car or four wheels), its brakes, sensors and road.

Axes are those of ISO 8855 (x forward, y left) at the centre of gravity. Arrays of values
per wheel have an axis of length w: one wheel, or four in the order of
:data:`tirefit.data.table.WHEELS`.
"""

import re
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tirefit.data.table import WHEELS
from tirefit.online.vehicle import GRAVITY
from tirefit.results import UsageError
from tirefit.sim.drive import Car

Wheels = Float[Array | np.ndarray, " w"]
Number = Float[Array | np.ndarray, ""] | float


class Vehicle(NamedTuple):
    """Masses, geometry and brakes."""

    mass: Number  # [kg]
    yaw_inertia: Number  # [kg m2]
    x: Wheels  # [m] position of the wheels ahead of the centre of gravity
    y: Wheels  # [m] position of the wheels to its left
    fz: Wheels  # [N] static loads
    pitch: Wheels  # [kg] change of load by each m/s2 of deceleration
    roll: Wheels  # [kg] change of load by each m/s2 of acceleration to the left
    transfer_time: Number  # [s] time constant of these changes
    radius: Wheels  # [m], effective
    inertia: Wheels  # [kg m2] of a wheel
    brake_gain: Wheels  # [N m/Pa] brake torque over pressure
    steered: Wheels  # 1 for steered wheels

    @property
    def wheels(self) -> tuple[str, ...]:
        """Suffixes of the wheels' columns: none for a quarter car."""
        return tuple(f"_{name}" for name in WHEELS) if len(self.fz) == 4 else ("",)


_FRONT_GAIN, _REAR_GAIN = 1.35e-4, 0.75e-4
"""Brake torque over pressure [N m/Pa]. At the front of :class:`Car`, 3 MPa need slightly
less than the friction of packed snow (mu 0.35), as in O Figure 3 (b). The rear has three
fifths of it, as braking unloads the rear."""
_TRANSFER_TIME = 0.1


def four_wheels() -> Vehicle:
    """A car with load transfer between front and rear, left and right."""
    car = Car()
    base = car.l_f + car.l_r
    front = np.array([1.0, 1.0, 0.0, 0.0])
    left = np.array([1.0, -1.0, 1.0, -1.0])
    weight = car.mass * GRAVITY / base / 2
    share = np.where(front == 1, car.l_r, car.l_f) / base
    return Vehicle(
        mass=car.mass,
        yaw_inertia=car.yaw_inertia,
        x=np.where(front == 1, car.l_f, -car.l_r),
        y=left * car.track / 2,
        fz=weight * np.where(front == 1, car.l_r, car.l_f),
        pitch=car.mass * car.height / base / 2 * (2 * front - 1),
        roll=-left * share * car.mass * car.height / car.track,
        transfer_time=_TRANSFER_TIME,
        radius=np.full(4, car.radius),
        inertia=np.full(4, car.wheel_inertia),
        brake_gain=np.where(front == 1, _FRONT_GAIN, _REAR_GAIN),
        steered=front,
    )


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


class Hydraulics(NamedTuple):
    r"""A master cylinder, and an inlet and an outlet valve at each wheel.

    The driver's pressure :math:`p_m` rises at a constant rate. While the inlet is open,
    the wheel's pressure p follows it; while the outlet is open, p falls. The command is
    the share u of an interval for which the inlet (u > 0) or outlet (u < 0) is open:

    .. math:: \dot p = u^+ \min\{(p_m - p)/T, R_+\} - u^- \min\{p/T, R_-\}

    ``demand`` [Pa] of the driver, reached at ``ramp`` [Pa/s]; ``rise``, ``fall``
    [Pa/s]: fastest change through an open valve; ``lag`` T [s] of an orifice; ``delay``
    [s] of a command, rounded to whole samples of the controller."""

    demand: float = 12e6
    ramp: float = 60e6
    rise: float = 40e6
    fall: float = 80e6
    lag: float = 0.02
    delay: float = 0.01

    def master(self, t):
        """Pressure [Pa] of the master cylinder ``t`` [s] after the braking begins."""
        return jnp.minimum(self.demand, self.ramp * jnp.maximum(t, 0.0))

    def flow(self, t, pressure, valve):
        """Rate of the wheels' pressure (w,) [Pa/s] under commands (w,) in [-1, 1]."""
        up = jnp.clip((self.master(t) - pressure) / self.lag, 0.0, self.rise)
        down = jnp.clip(pressure / self.lag, 0.0, self.fall)
        # If the driver reduces the pressure, a check valve passes that on at once.
        back = jnp.minimum((self.master(t) - pressure) / self.lag, 0.0)
        turned = jnp.maximum(valve, 0.0) * up - jnp.maximum(-valve, 0.0) * down
        return turned + jnp.maximum(back, -self.fall)

    def queue(self, rate: float) -> int:
        """Delay of a command, in samples at ``rate`` [1/s]."""
        return round(self.delay * rate)


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


def draw_noise(key, sensors: Sensors, samples: int, wheels: int, rate: float) -> Noise:
    """The noise of one stop; controllers with the same key have the same noise."""
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
        jax.random.normal(keys[0], shape),
        jax.random.normal(keys[1], shape),
        jax.random.normal(keys[2], (samples,)),
        road,
    )


def wheel_speeds(sensors: Sensors, turning, noise):
    """Measured circumferential speeds (w,) [m/s]: with noise, then rounded to steps; zero
    for a standing wheel, which gives no pulses."""
    step = sensors.speed_step
    noisy = turning + sensors.speed_std * noise * (turning > 0)
    safe = jnp.where(step > 0, step, 1.0)
    reported = jnp.where(step > 0, jnp.round(noisy / safe) * step, noisy)
    return jnp.maximum(reported, 0.0)


ROADS = ("mu=0.4", "mu=0.3:0.8@20", "left=0.3,right=0.8")
"""Examples of the syntax of a road: constant; another friction after 20 m; split."""

_LEAST, _MOST = 0.05, 2.0
_PATCH = 0.2  # length [m] of the contact patch, over which a change of friction is linear


class Road(NamedTuple):
    """Friction on the left and on the right: the largest force over load of the tire
    there, at its static load and the initial speed."""

    before: Float[Array | np.ndarray, " 2"]
    after: Float[Array | np.ndarray, " 2"]
    jump: Float[Array | np.ndarray, ""] | float  # [m] place of the change of friction

    def mu(
        self, distance: Float[Array, " w"], y: Float[Array | np.ndarray, " w"]
    ) -> Float[Array, " w"]:
        """Friction under wheels after ``distance`` [m], and ``y`` [m] left of the centre."""
        share = jnp.clip((distance - self.jump) / _PATCH + 0.5, 0.0, 1.0)
        side = (jnp.asarray(y) < 0).astype(int)
        before, after = jnp.asarray(self.before)[side], jnp.asarray(self.after)[side]
        return before + share * (after - before)

    @property
    def split(self) -> bool:
        """Whether left and right differ."""
        sides = (self.before, self.after)
        return any(float(side[0]) != float(side[1]) for side in sides)

    @property
    def jumps(self) -> bool:
        """Whether the friction changes along the road."""
        return bool(np.isfinite(self.jump))


def road_of(text: str) -> Road:
    """The road described by a text as in :data:`ROADS`.

    Raises:
        UsageError: another syntax, or a friction out of range.
    """
    number = r"(\d*\.?\d+)"
    constant = re.fullmatch(rf"mu={number}(?::{number}@{number})?", text.strip())
    sides = re.fullmatch(rf"left={number},\s*right={number}", text.strip())
    if constant is None and sides is None:
        remedy = f"write it as {', '.join(ROADS)}; friction from {_LEAST:g} to {_MOST:g}"
        raise UsageError(f"--road {text!r} is not a road", remedy)
    if sides is not None:
        both = np.array([float(sides[1]), float(sides[2])])
        road = Road(both, both, np.inf)
    else:
        assert constant is not None
        before = float(constant[1])
        after = before if constant[2] is None else float(constant[2])
        jump = np.inf if constant[3] is None else float(constant[3])
        road = Road(np.full(2, before), np.full(2, after), jump)
    for mu in {*road.before.tolist(), *road.after.tolist()}:
        if not _LEAST <= mu <= _MOST:
            reason = f"--road {text!r}: friction {mu:g} is out of range"
            raise UsageError(reason, f"give {_LEAST:g} (ice) to {_MOST:g}")
    return road
