r"""The braked vehicle (a quarter car or four wheels), its brakes, and tires on a road.

Axes are those of ISO 8855 (x forward, y left) at the centre of gravity. Arrays of values
per wheel have an axis of length w: one wheel, or four in the order of
:data:`tirefit.data.table.WHEELS`.

The friction of the road scales a tire by similarity: same stiffness, peak of the road:

.. math:: F(\sigma) = \lambda F_0(\sigma / \lambda), \qquad
    \lambda = \mu_{road} / \mu_0

with :math:`\mu_0` the largest force over load of the given tire. For a brush this
changes only :math:`\mu`, for LuGre only g. The sliding speed is not scaled.
"""

import re
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tirefit.arrays import Number, Scalar
from tirefit.data.table import WHEELS
from tirefit.models import AbstractTire, TireInputs
from tirefit.online.vehicle import GRAVITY
from tirefit.results import UsageError
from tirefit.sim.drive import Car
from tirefit.slip import sigma_from_kappa

Wheels = Float[Array | np.ndarray, " w"]


class Vehicle(NamedTuple):
    """Masses, geometry and brakes."""

    mass: Scalar  # [kg]
    yaw_inertia: Scalar  # [kg m2]
    x: Wheels  # [m] position of the wheels ahead of the centre of gravity
    y: Wheels  # [m] position of the wheels to its left
    fz: Wheels  # [N] static loads
    pitch: Wheels  # [kg] change of load by each m/s2 of deceleration
    roll: Wheels  # [kg] change of load by each m/s2 of acceleration to the left
    transfer_time: Scalar  # [s] time constant of these changes
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
    arm = np.where(front == 1, car.l_r, car.l_f)
    return Vehicle(
        mass=car.mass, yaw_inertia=car.yaw_inertia,
        x=np.where(front == 1, car.l_f, -car.l_r), y=left * car.track / 2, fz=weight * arm,
        pitch=car.mass * car.height / base / 2 * (2 * front - 1),
        roll=-left * (arm / base) * car.mass * car.height / car.track,
        transfer_time=_TRANSFER_TIME,
        radius=np.full(4, car.radius), inertia=np.full(4, car.wheel_inertia),
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


class Hydraulics(NamedTuple):
    r"""A master cylinder, and an inlet and an outlet valve at each wheel.

    The driver's pressure :math:`p_m` rises at a constant rate. While the inlet is open,
    the wheel's pressure p follows it; while the outlet is open, p falls. The command is
    the share u of an interval for which the inlet (u > 0) or outlet (u < 0) is open:

    .. math:: \dot p = u^+ \min\{(p_m - p)/T, R_+\} - u^- \min\{p/T, R_-\}

    """

    demand: float = 12e6  # [Pa] of the driver
    ramp: float = 60e6  # [Pa/s] at which it is reached
    rise: float = 40e6  # [Pa/s] fastest change through an open inlet
    fall: float = 80e6  # [Pa/s] through an open outlet
    lag: float = 0.02  # T [s] of an orifice
    delay: float = 0.01  # [s] of a command, rounded to whole samples of the controller

    def master(self, t: Scalar) -> Array:
        """Pressure [Pa] of the master cylinder ``t`` [s] after the braking begins."""
        return jnp.minimum(self.demand, self.ramp * jnp.maximum(t, 0.0))

    def flow(self, t: Scalar, pressure: Array, valve: Array) -> Array:
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


ROADS = ("mu=0.4", "mu=0.3:0.8@20", "left=0.3,right=0.8")
"""Examples of the syntax of a road: constant; another friction after 20 m; split."""
_LEAST, _MOST = 0.05, 2.0


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
        # Length [m] of the contact patch, over which a change of friction is linear.
        share = jnp.clip((distance - self.jump) / 0.2 + 0.5, 0.0, 1.0)
        side = (jnp.asarray(y) < 0).astype(int)
        before, after = jnp.asarray(self.before)[side], jnp.asarray(self.after)[side]
        return before + share * (after - before)

    @property
    def split(self) -> bool:
        """Whether left and right differ."""
        return bool(np.ptp(self.before) or np.ptp(self.after))


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
    if constant is not None:
        before, after = float(constant[1]), float(constant[2] or constant[1])
        road = Road(np.full(2, before), np.full(2, after), float(constant[3] or "inf"))
    else:
        assert sides is not None
        both = np.array([float(sides[1]), float(sides[2])])
        road = Road(both, both, np.inf)
    for mu in {*road.before.tolist(), *road.after.tolist()}:
        if not _LEAST <= mu <= _MOST:
            reason = f"--road {text!r}: friction {mu:g} is out of range"
            raise UsageError(reason, f"give {_LEAST:g} (ice) to {_MOST:g}")
    return road


LOW_SPEED = 0.3
"""Speed [m/s] below which the slip velocity is divided by this speed, as the slip would
be infinitely stiff at standstill. The force of a locked wheel fades below a tenth of it,
in the last 0.1 m."""
_LOCKED = 0.99  # largest kappa, that of a standing wheel (sigma 99)
_SPEEDS, _LOADS, _SLIPS = 16, 5, 200


class Slips(NamedTuple):
    """Slips of the wheels."""

    kappa: Float[Array, " w"]  # practical slip
    alpha: Float[Array, " w"]  # [rad]
    speed: Float[Array, " w"]  # [m/s] by which the sliding speed was divided


def wheel_slips(v_x: Array, v_y: Array, turning: Array) -> Slips:
    """Slips of wheels (w,) from the speeds of their centres along and across them, and
    their circumferential speed R omega; all [m/s]."""
    speed = jnp.maximum(v_x, LOW_SPEED)
    kappa = jnp.clip((v_x - turning) / speed, -5.0, _LOCKED)
    return Slips(kappa, jnp.arctan2(v_y, speed), speed)


class RoadTire(eqx.Module):
    """A tire with a table of its peaks.

    ``peak`` (roads, speeds, loads): largest force over load; ``at``: its kappa, for the
    ascending frictions ``roads``, for ``speeds`` [m/s] and ``loads`` [N]; ``usual``: the
    peak of the given tire, mu_0.
    """

    tire: AbstractTire
    usual: Number
    roads: Float[Array, " m"]
    speeds: Float[Array, " s"]
    loads: Float[Array, " l"]
    peak: Float[Array, "m s l"]
    at: Float[Array, "m s l"]

    def forces(
        self, mu: Float[Array, " w"], slips: Slips, fz: Float[Array, " w"]
    ) -> tuple[Float[Array, " w"], Float[Array, " w"]]:
        """Forces [N] (w,) along and across wheels on a road of friction mu (w,)."""

        def forces_at(mu: Array, *at: Array) -> tuple[Array, Array]:
            made = self.tire(_similar(mu / self.usual, *at))
            across = jnp.zeros(()) if made.fy is None else made.fy
            return mu / self.usual * jnp.asarray(made.fx), mu / self.usual * across

        return jax.vmap(forces_at)(mu, *slips, jnp.maximum(fz, 1.0))

    def peaks(self, mu: Array, speed: Array, fz: Array) -> tuple[Array, Array]:
        """Largest braking force over load (w,) on roads mu (w,), at speeds [m/s] and
        loads [N] (w,); and its kappa (w,)."""
        place = [
            jnp.interp(value, known, jnp.arange(len(known), dtype=float))
            for value, known in ((mu, self.roads), (speed, self.speeds), (fz, self.loads))
        ]
        peak, at = (
            jax.scipy.ndimage.map_coordinates(table, place, order=1, mode="nearest")
            for table in (self.peak, self.at)
        )
        return peak, at


def _similar(factor: Array, kappa: Array, alpha: Scalar, speed: Array, fz: Array) -> TireInputs:
    """The inputs of the given tire that are similar to inputs on a road."""
    sigma = sigma_from_kappa(kappa)
    scaled = sigma / factor
    # Change alpha and speed so that sigma_y is scaled and v_s is not.
    narrower = (1 + sigma) / (1 + scaled)
    angle = jnp.arctan(jnp.tan(alpha) / factor * narrower)
    return TireInputs(scaled, angle, fz, speed * factor / narrower)


def on_road(tire: AbstractTire, speed: Scalar, fz: Scalar, roads: Float[Array, " m"]) -> RoadTire:
    """A tire with its peaks, for braking from ``speed`` [m/s] at load ``fz`` [N] on
    ``roads`` (m,), given by their friction."""
    # Decided here from the values of a .tir file, which a traced program does not know.
    return _peaked(tire, speed, fz, roads, "v" not in tire.needs)


@eqx.filter_jit
def _peaked(
    tire: AbstractTire, speed: Scalar, fz: Scalar, roads: Float[Array, " m"], one_speed: bool
) -> RoadTire:
    shares = jnp.geomspace(0.01, 1.0, _SPEEDS)[-1 if one_speed else 0 :]
    speeds = jnp.asarray(speed) * shares
    loads = jnp.asarray(fz) * jnp.linspace(0.2, 2.4, _LOADS)
    roads = jnp.sort(jnp.asarray(roads, float))

    def of_tire(k: Array) -> Array:
        return jnp.asarray(tire(TireInputs(sigma_from_kappa(k), 0.0, fz, speed)).fx) / fz

    usual, _ = _highest(of_tire)

    def highest(mu: Array, v: Array, load: Array) -> tuple[Array, Array]:
        def curve(k: Array) -> Array:
            inputs = _similar(mu / usual, k, 0.0, v, load)
            return mu / usual * jnp.asarray(tire(inputs).fx) / load

        return _highest(curve)

    over_loads = jax.vmap(highest, (None, None, 0))
    over_speeds = jax.vmap(over_loads, (None, 0, None))
    peak, at = jax.vmap(over_speeds, (0, None, None))(roads, speeds, loads)
    return RoadTire(tire, usual, roads, speeds, loads, peak, at)


def _highest(curve: Callable[[Array], Array]) -> tuple[Array, Array]:
    """Largest value of a curve over kappa, and its kappa; the first of a plateau."""
    grid = jnp.concatenate(
        [jnp.geomspace(1e-4, 0.1, _SLIPS), jnp.linspace(0.1, _LOCKED, _SLIPS)[1:]]
    )
    best = jnp.argmax(jax.vmap(curve)(grid))
    shorter = (np.sqrt(5) - 1) / 2

    def narrow(_: Array | int, ends: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = ends
        left, right = high - shorter * (high - low), low + shorter * (high - low)
        keep = curve(left) >= curve(right)
        return jnp.where(keep, low, left), jnp.where(keep, right, high)

    ends = grid[jnp.maximum(best - 1, 0)], grid[jnp.minimum(best + 1, len(grid) - 1)]
    # Golden-section steps about the best slip of a grid: the peak is exact to rounding.
    low, high = jax.lax.fori_loop(0, 60, narrow, ends)
    place = (low + high) / 2
    return curve(place), place
