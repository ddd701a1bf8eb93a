r"""Simulate the sensors of a car that drives and brakes on a winding road.

The car has four brush tires, load transfer by roll and pitch, and a driver who keeps the
lane; the curvature of the road is a sine of time. With braking forces :math:`F_x`
positive and :math:`F_y` to the left, in the axes of the car and of each wheel,

.. math::
   m (\dot v_x - v_y r) &= X, \quad m (\dot v_y + v_x r) = Y, \quad
   I_z \dot r = N, \quad J \dot\omega_i = R F_{x,i} - T_i \\
   I_\varphi \dot p &= -k \varphi - c p + h Y, \quad
   \dot e_y = v_x \sin\psi_e + v_y \cos\psi_e, \quad \dot\psi_e = r - \dot\psi_d

which diffrax integrates. The stiffness of a tire is proportional to its load.
"""

from typing import Any, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from tirefit.arrays import Numbers
from tirefit.data.table import WHEELS
from tirefit.online.vehicle import GRAVITY, axle_angles, brush_share, clipped
from tirefit.params import Values
from tirefit.results import UsageError
from tirefit.sim.braking import SLOWEST, SimulatedLog
from tirefit.sim.settings import Drive

_PREVIEW = 15.0  # distance [m] at which the driver looks at the lane
_FRONT_BRAKES = 0.6


class Car(NamedTuple):
    """A mid-size car; stiffness: 2 c_p a^2 of a tire over its load, front and rear."""

    mass: Any = 1500.0
    yaw_inertia: Any = 2500.0
    l_f: Any = 1.2
    l_r: Any = 1.4
    track: Any = 1.5
    height: Any = 0.5
    radius: Any = 0.3
    wheel_inertia: Any = 1.2
    roll_inertia: Any = 500.0
    roll_stiffness: Any = 8e4
    roll_damping: Any = 5e3
    stiffness_f: Any = 11.0
    stiffness_r: Any = 13.0


class _State(NamedTuple):
    """The state of the ODE; ``lag``: lagged deceleration that sets the loads [m/s2]."""

    v_x: jax.Array
    v_y: jax.Array
    yaw_rate: jax.Array
    omega: jax.Array
    roll: jax.Array
    roll_rate: jax.Array
    lag: jax.Array
    offset: jax.Array
    heading: jax.Array
    road_heading: jax.Array
    x: jax.Array
    y: jax.Array


class _Numbers(NamedTuple):
    """Traced numbers of a drive: of the car, and of the drive by name; mu before and after."""

    car: Car
    how: dict[str, jax.Array]
    mu: tuple[jax.Array, jax.Array]
    change: jax.Array


def _road_rate(numbers: _Numbers, t: Numbers, v_x: Array) -> Array:
    """Yaw rate [rad/s] that follows the road: its curvature times the speed."""
    how, grip = numbers.how, numbers.mu[0] * GRAVITY
    curvature = how["bend"] * grip / how["speed"] ** 2
    return v_x * curvature * jnp.sin(2 * jnp.pi * t / how["bend_period"])


def _steering(numbers: _Numbers, t: Numbers, s: _State) -> Array:
    """Road wheel angle [rad] of a driver who looks ahead along the lane."""
    car = numbers.car
    base = car.l_f + car.l_r
    # Time [s] by which the driver steers before a bend: the lag of the car.
    curvature = _road_rate(numbers, t + 0.15, s.v_x) / s.v_x
    course = s.heading + s.v_y / s.v_x - s.road_heading
    aside = s.offset + _PREVIEW * course
    softer = 1 / car.stiffness_f - 1 / car.stiffness_r
    understeer = softer * s.v_x**2 * curvature / GRAVITY
    return base * curvature + understeer - 2 * base / _PREVIEW**2 * aside


def _torques(numbers: _Numbers, t: Numbers, s: _State) -> Array:
    """Brake minus drive torque (4,) [N m]: saw-teeth; the rear wheels drive in between."""
    car, how = numbers.car, numbers.how
    phase = (t % how["brake_period"]) / how["brake_period"]
    braking = (phase < 0.5) & (how["brake"] > 0)
    grip = numbers.mu[0] * GRAVITY
    asked = 2 * phase * how["brake"] * grip
    rear = 1 - _FRONT_BRAKES
    share = jnp.array([_FRONT_BRAKES, _FRONT_BRAKES, rear, rear]) / 2
    wanted = jnp.clip(0.5 * (how["speed"] - s.v_x), -0.1 * grip, 0.2 * grip)
    driven = -wanted * jnp.array([0.0, 0.0, 0.5, 0.5])
    full = car.mass * car.radius
    return full * jnp.where(braking, asked * share, driven)


def pushed(turn: Array, x: Values, y: Values, along: Array, across: Array) -> tuple[Array, ...]:
    """Force [N] on a car forward and to the left, and its yaw moment [N m].

    Args:
        turn: (w,) steering angles of the wheels [rad].
        x, y: (w,) wheels ahead and to the left of the centre of gravity [m].
        along, across: (w,) forces [N], braking and to the left.
    """
    cos, sin = jnp.cos(turn), jnp.sin(turn)
    ahead, left = -along * cos - across * sin, across * cos - along * sin
    return jnp.sum(ahead), jnp.sum(left), jnp.sum(jnp.asarray(x) * left - jnp.asarray(y) * ahead)


def _tires(numbers: _Numbers, t: Numbers, s: _State) -> tuple[Any, ...]:
    """Steering, slips (4,), angles (2,), loads (4,), forces along and across (4,), and
    what they make with the car: :func:`pushed`."""
    car = numbers.car
    steering = _steering(numbers, t, s)
    angles = jnp.stack(axle_angles(s.v_x, s.v_y, s.yaw_rate, steering, car.l_f, car.l_r))
    left = jnp.array([1.0, -1.0, 1.0, -1.0])
    sigma = clipped(s.omega, s.v_x - car.track / 2 * s.yaw_rate * left, car.radius, SLOWEST)
    stiffness = jnp.repeat(jnp.stack([car.stiffness_f, car.stiffness_r]), 2)
    mu = jnp.where(t < numbers.change, *numbers.mu)
    shares = brush_share(sigma, jnp.repeat(angles, 2), stiffness, mu)
    base = car.l_f + car.l_r
    weight = car.mass * GRAVITY / base
    forward = car.mass * car.height * s.lag / base
    front, rear = weight * car.l_r + forward, weight * car.l_f - forward
    # A force to the left rolls the car to the right and loads the wheels there.
    moment = car.roll_stiffness * s.roll + car.roll_damping * s.roll_rate
    loads = jnp.stack([front, front, rear, rear]) / 2 - moment / car.track * 0.5 * left
    loads = jnp.maximum(loads, 1.0)
    along, across = (loads * share for share in shares)
    x = jnp.stack([car.l_f, car.l_f, -car.l_r, -car.l_r])
    turn = jnp.array([1.0, 1.0, 0.0, 0.0]) * steering
    on_car = pushed(turn, x, car.track / 2 * left, along, across)
    return steering, sigma, angles, loads, along, across, on_car


def _rate(t: Numbers, s: _State, numbers: _Numbers) -> _State:
    car = numbers.car
    *_, along, _, (forward, left, moment) = _tires(numbers, t, s)
    torque = _torques(numbers, t, s)
    spun = car.radius * along - torque
    holds = (s.omega * car.radius <= SLOWEST * s.v_x) & (spun < 0)
    askew = s.heading - s.road_heading
    sin, cos = jnp.sin(askew), jnp.cos(askew)
    roll = car.height * left - car.roll_stiffness * s.roll
    return _State(
        v_x=forward / car.mass + s.v_y * s.yaw_rate,
        v_y=left / car.mass - s.v_x * s.yaw_rate,
        yaw_rate=moment / car.yaw_inertia,
        omega=jnp.where(holds, 0.0, spun / car.wheel_inertia),
        roll=s.roll_rate,
        roll_rate=(roll - car.roll_damping * s.roll_rate) / car.roll_inertia,
        # Lag [s] of the axle loads behind the deceleration.
        lag=(-forward / car.mass - s.lag) / 0.1,
        offset=s.v_x * sin + s.v_y * cos,
        heading=s.yaw_rate,
        road_heading=_road_rate(numbers, t, s.v_x),
        x=s.v_x * jnp.cos(s.heading) - s.v_y * jnp.sin(s.heading),
        y=s.v_x * jnp.sin(s.heading) + s.v_y * jnp.cos(s.heading),
    )


@eqx.filter_jit
def _integrate(numbers: _Numbers, time: Array, max_steps: int) -> tuple[_State, Array]:
    """States (n, ...) at the times, and whether the integration reached them."""
    v = numbers.how["speed"]
    zero = jnp.zeros(())
    rolling = jnp.full(4, v / numbers.car.radius)
    still = dict.fromkeys(_State._fields, zero)
    start = _State(**still | {"v_x": v, "omega": rolling})
    controller = diffrax.PIDController(rtol=1e-7, atol=1e-8, dtmax=0.02)
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(_rate), diffrax.Tsit5(), time[0], time[-1], None, start,
        numbers, saveat=diffrax.SaveAt(ts=time), stepsize_controller=controller,
        max_steps=max_steps, throw=False,
    )  # fmt: skip
    return solution.ys, diffrax.is_successful(solution.result)


@eqx.filter_jit
def _measured(numbers: _Numbers, time: Array, states: _State) -> dict[str, jax.Array]:
    """Measured and true columns from the states (n, ...) at the times."""

    def columns_at(t: Array, s: _State) -> dict[str, Array]:
        steering, sigma, angles, loads, along, across, (forward, left, _) = _tires(numbers, t, s)
        wheels = {"omega": s.omega, "torque": _torques(numbers, t, s)}
        wheels |= {"sigma_x": sigma, "fx": along, "fz": loads}
        each = {
            f"{kind}_{wheel}": values[k]
            for kind, values in wheels.items()
            for k, wheel in enumerate(WHEELS)
        }
        return each | {
            "time": t, "v": s.v_x, "v_y": s.v_y, "yaw_rate": s.yaw_rate,
            "roll_rate": s.roll_rate, "a_x": forward / numbers.car.mass,
            "a_y": left / numbers.car.mass, "steering": steering,
            "offset": s.offset, "heading": s.heading, "road_heading": s.road_heading,
            "x": s.x, "y": s.y, "alpha_f": angles[0], "alpha_r": angles[1],
            "fy_f": across[0] + across[1], "fy_r": across[2] + across[3],
            "mu": jnp.where(t < numbers.change, *numbers.mu),
        }  # fmt: skip

    return jax.vmap(columns_at)(time, states)


def simulate_drive(
    how: Drive | None = None, car: Car | None = None, max_steps: int = 2**20
) -> SimulatedLog:
    """Simulate the log of a drive.

    Args:
        max_steps: limit of integration steps; a spinning car would need any number.

    Returns:
        The measured canonical columns: time, steering, road_heading without noise, offset, heading,
        v, x, y, yaw_rate, roll_rate, a_x, a_y, omega and torque of the wheels. The true columns are
        these without noise, v_y, the slips, slip angles, loads and forces of the tires, and mu.

    Raises:
        UsageError: the drive needs more steps.
    """
    how, car = Drive() if how is None else how, Car() if car is None else car
    n = round(how.duration * how.rate)
    time = jnp.arange(n) / how.rate
    change, after = (np.inf, how.friction) if how.drop is None else how.drop
    mu = (jnp.asarray(how.friction), jnp.asarray(after))
    values = {k: jnp.asarray(float(v)) for k, v in vars(how).items() if k != "drop"}
    car = jax.tree.map(lambda value: jnp.asarray(value, float), car)
    numbers = _Numbers(car, values, mu, jnp.asarray(change))
    states, followed = _integrate(numbers, time, max_steps)
    if not followed:
        raise UsageError(
            f"the drive needs more than {max_steps} steps: a car spins where braking"
            " and bends together need more than the friction",
            "reduce the lateral acceleration or the braking, or raise the friction",
        )
    truth = {k: np.asarray(v) for k, v in _measured(numbers, time, states).items()}
    random = np.random.default_rng(how.seed)
    stds = {"time": 0.0} | dict.fromkeys(("offset", "x", "y"), how.gps_std)
    stds |= {"heading": how.heading_std, "v": how.speed_std}
    stds |= dict.fromkeys(("yaw_rate", "roll_rate"), how.gyro_std)
    stds |= dict.fromkeys(("a_x", "a_y"), how.acceleration_std)
    for wheel in WHEELS:
        stds |= {f"omega_{wheel}": how.omega_std, f"torque_{wheel}": how.torque_std}
    stds |= {"steering": 0.0, "road_heading": 0.0}
    columns = {k: truth[k] + std * random.standard_normal(n) for k, std in stds.items()}
    return SimulatedLog(columns, {"time": truth.pop("time"), **truth})
