r"""Path prediction with the friction in use, S section 3.8 (Liu and Peng).

It has four parts of the source:

* the braking force F of the front wheels from their speed and torque,
  :math:`J \dot\omega = R F - T`, by recursive least squares with forgetting on
  :math:`\omega_i - \omega_{i-1} + T \Delta t / J = (R \Delta t / J) F` and by an
  adaptive observer, :math:`\dot{\hat\omega} = (R \hat F - T)/J + 2 p \tilde\omega,
  \; \dot{\hat F} = p^2 (J / R) \tilde\omega`, whose error dies as :math:`e^{-pt}`;
* friction from S(21): the longitudinal and lateral force of the brush at the resultant
  slip are compared with F and with :math:`m a_y l_r / (l_f + l_r)`;
* the bicycle S(22), whose :math:`C_f, C_r` are corrected by the difference of driven and
  predicted path: an extended Kalman filter on its states and on :math:`\ln C_f, \ln C_r`;
* the time to lane crossing with constant steering and road curvature, and its standard
  deviation from the covariance of that filter.

A row is flagged if the front axle uses more of the friction than ``warn``.
"""

from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from tirefit.arrays import Number, Scalar
from tirefit.data.table import WHEELS
from tirefit.online.base import Estimate, Flag, Method, Sample, choose, flag_of, floats
from tirefit.online.vehicle import (
    GRAVITY,
    AbstractVehicleMethod,
    axle_angles,
    brush_share,
    clipped,
    kalman_update,
    wrapped,
)
from tirefit.params import par


def bicycle(
    c_f: Array, c_r: Array, mass: float, yaw_inertia: float, l_f: float, l_r: float, u: Array
) -> tuple[Float[Array, "4 4"], Float[Array, "4"], Float[Array, "4"]]:
    """S(22), corrected: matrices of (y, dy/dt, heading off the road, its rate).

    Args:
        c_f, c_r: positive cornering stiffness of the axles [N/rad]: 2 |C_f| of S(22),
            where C is negative and that of one tire.
        l_f, l_r: a and b of S(22) [m]; u: speed [m/s].

    Returns:
        A (4, 4), and the columns (4,) of the steering angle and the road's yaw rate.
    """
    both, turned = c_f + c_r, l_f * c_f - l_r * c_r
    damped = l_f**2 * c_f + l_r**2 * c_r
    zero, ones = jnp.zeros_like(u), jnp.ones_like(u)
    a = jnp.stack(
        [
            jnp.stack([zero, ones, zero, zero]),
            jnp.stack([zero, -both / u, both, -turned / u]) / mass,
            jnp.stack([zero, zero, zero, ones]),
            jnp.stack([zero, -turned / u, turned, -damped / u]) / yaw_inertia,
        ]
    )
    steered = jnp.stack([zero, c_f / mass, zero, l_f * c_f / yaw_inertia])
    return a, steered, jnp.stack([zero, -u, -ones, zero])


def lane_crossing(
    state: Float[Array, "4"], a: Float[Array, "4 4"], drive: Float[Array, "4"], edge: float,
    horizon: float, steps: int = 40,
) -> Number:  # fmt: skip
    """Time [s] at which ``|y|`` reaches ``edge`` [m] on the predicted path.

    Args:
        state: (4,) as in :func:`bicycle`; drive: (4,) constant terms of the inputs.
        horizon: predicted time [s], in ``steps``.

    Returns:
        The time, NaN if the vehicle stays in its lane.
    """
    h = horizon / steps

    def rate(x: Float[Array, "4"]) -> Float[Array, "4"]:
        return a @ x + drive

    def step(x: Float[Array, "4"], _: None) -> tuple[Float[Array, "4"], Number]:
        # Classical Runge-Kutta; h is a tenth of a second.
        k1 = rate(x)
        k2 = rate(x + h / 2 * k1)
        k3 = rate(x + h / 2 * k2)
        k4 = rate(x + h * k3)
        after = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return after, after[0]

    _, path = jax.lax.scan(step, state, length=steps)
    path = jnp.concatenate([state[:1], path])
    beyond = jnp.abs(path) >= edge
    k = jnp.maximum(jnp.argmax(beyond), 1)
    before, after = jnp.abs(path[k - 1]), jnp.abs(path[k])
    rise = jnp.where(after > before, after - before, 1.0)
    share = jnp.clip((edge - before) / rise, 0.0, 1.0)
    return jnp.where(jnp.any(beyond), h * (k - 1 + share), jnp.nan)


class Observer(NamedTuple):
    """Wheel speed [rad/s] and force [N] of the adaptive observer."""

    omega: Any
    force: Any

    def after(
        self, omega: Array, torque: Array, dt: Array, radius: float, inertia: float, pole: float
    ) -> "Observer":
        """The observer after ``dt`` [s] with a torque [N m], corrected by a wheel speed omega.

        With these gains both errors of the discrete loop shrink by exp(-pole dt) per sample, at
        any dt; radius [m] and inertia J [kg m2] of the wheel, pole p [1/s].
        """
        lever = radius * dt / inertia
        ahead = self.omega + lever * self.force - dt * torque / inertia
        error = omega - ahead
        keep = jnp.exp(-pole * dt)
        gain = (1 - keep) ** 2 / jnp.maximum(lever, 1e-12)
        return Observer(ahead + (1 - keep * keep) * error, self.force + gain * error)


def observer_std(
    omega_std: float, torque_std: float, dt: Scalar, radius: float, inertia: float, pole: float
) -> Number:
    """Standard deviation [N] of the force of the observer, due to white noise.

    ``omega_std`` [rad/s], ``torque_std`` [N m] of a sample, ``dt`` [s]; pole dt << 1.
    """
    of_speed = inertia * omega_std * jnp.sqrt(dt * pole**3 / 4)
    return jnp.hypot(of_speed, torque_std * jnp.sqrt(dt * pole / 4)) / radius


class WheelRls(NamedTuple):
    """Wheel speed [rad/s] of the last sample; force [N] and P [N2], by least squares."""

    omega: Any
    force: Any
    spread: Any

    def after(
        self, omega: Array, torque: Array, dt: Array, radius: float, inertia: float,
        memory: float, omega_std: float,
    ) -> "WheelRls":  # fmt: skip
        """The force after one more sample: ``omega`` [rad/s] with noise of ``omega_std``, and the
        torque [N m] since then; in ``memory`` [s] the weight of a sample falls to 1/e."""
        lever = radius * dt / inertia
        # The difference of two speeds has the noise of both.
        noise = 2 * omega_std**2
        grown = self.spread * jnp.exp(dt / memory)
        gain = grown * lever / (lever * lever * grown + noise)
        error = omega - self.omega + torque * dt / inertia - lever * self.force
        return WheelRls(omega, self.force + gain * error, grown * (1 - gain * lever))


_LONGEST = 0.5  # time [s] without samples after which the motion is initialised again
_USUAL = 0.02  # time [s] between samples for which the noise of the forces is stated
_FARTHEST = 0.1  # largest step of the logarithm of mu per sample
_FIRST = (0.5, 0.5, 0.05, 0.1)
"""Std of the first y [m], dy/dt [m/s], heading [rad] and yaw rate [rad/s]."""


class PathState(NamedTuple):
    """States of the bicycle with ln of C_f, C_r over the expected ones, and their
    covariance; front force; ln mu and its variance; friction used; rates of the forces
    [N/s] by the two estimators; the last inputs, and the time [s] since then."""

    z: Float[Array, "6"]
    covariance: Float[Array, "6 6"]
    observer: Observer
    rls: WheelRls
    log_mu: Number
    mu_variance: Number
    used: Number
    rates: Float[Array, "2"]
    inputs: dict[str, Number]
    waited: Number


class Path(AbstractVehicleMethod):
    """Friction, cornering stiffness and the time to lane crossing."""

    method: ClassVar[Method] = Method(
        "path", "bicycle along the lane, friction at combined slip, lane crossing",
        ("offset", "heading", "road_heading", "yaw_rate", "a_x", "a_y", "steering", "v",
         *(f"{kind}_{wheel}" for kind in ("omega", "torque") for wheel in WHEELS
           if wheel in ("fl", "fr"))),
        ("mu", "C_f", "C_r", "F_xf", "F_xf_rls", "used", "tlc"),
        "40 to 100 % of the friction; C_f, C_r and tlc of a linear tire, below 50 %",
        "S §3.8",
    )  # fmt: skip

    radius: float = par(0.3, (0.01, 2.0), "m", "rolling radius", "", "R")
    wheel_inertia: float = par(1.2, (1e-6, 1e3), "kg m2", "of one wheel", "", "J")
    height: float = par(0.5, (0.0, 5.0), "m", "height of the CG", "", "h")
    mu: float = par(0.9, (0.01, 5.0), "-", "expected friction", "S(21)", r"\mu_0")
    prior_mu: float = par(0.5, (1e-3, 3.0), "-", "relative std of it", "", r"\sigma")
    drift_mu: float = par(0.05, (0.0, 1.0), "1/sqrt(s)", "relative random walk of mu", "", r"q_\mu")
    drift_stiffness: float = par(
        0.03, (0.0, 1.0), "1/sqrt(s)", "relative random walk of C_f, C_r", "", "q_C"
    )
    prior_stiffness: float = par(
        0.3, (1e-3, 3.0), "-", "relative std of the expected C_f, C_r", "", r"\sigma_C"
    )
    disturbance: float = par(
        0.2, (1e-6, 100.0), "m/s2/sqrt(Hz)", "unknown lateral acceleration", "", "q_y"
    )
    force_noise: float = par(
        0.15, (1e-4, 1.0), "-", "std of the force over the load, tire included", "", r"\sigma_F"
    )
    gps_std: float = par(0.02, (1e-5, 10.0), "m", "noise of offset", "", r"\sigma_y")
    heading_std: float = par(0.002, (1e-6, 1.0), "rad", "noise of heading", "", r"\sigma_\psi")
    gyro_std: float = par(0.002, (1e-6, 1.0), "rad/s", "of yaw rate", "", r"\sigma_r")
    omega_std: float = par(0.05, (1e-5, 10.0), "rad/s", "of omega", "", r"\sigma_w")
    torque_std: float = par(10.0, (0.0, 1e5), "N m", "of torques", "", r"\sigma_T")
    pole: float = par(40.0, (0.1, 1e3), "1/s", "of the observer", "S §3.8", "p")
    memory: float = par(0.1, (1e-3, 10.0), "s", "of the RLS", "S §3.8", r"\tau")
    lane: float = par(0.9, (0.05, 20.0), "m", "offset at which the lane is left", "S §3.8", "y_l")
    horizon: float = par(4.0, (0.2, 20.0), "s", "looked ahead", "S §3.8", "t_h")
    warn: float = par(0.85, (0.1, 1.0), "-", "used friction warned of", "S §3.8", "w")

    def init(self) -> PathState:
        zero, none = jnp.zeros(()), jnp.full((), jnp.nan)
        inputs = dict.fromkeys(("steering", "v", "road_heading"), zero)
        mu = floats(self.mu, self.prior_mu)
        wheel = Observer(zero, zero), WheelRls(zero, zero, self._widest())
        return PathState(
            jnp.zeros(6), self._first(), *wheel, jnp.log(mu[0]), mu[1] ** 2, none,
            jnp.zeros(2), inputs, jnp.full((), 2 * _LONGEST),
        )  # fmt: skip

    def hold(self, state: PathState, dt: Number, steps: Number) -> tuple[PathState, Estimate]:
        variance = jnp.minimum(state.mu_variance + self.drift_mu**2 * dt, self.prior_mu**2)
        held = state._replace(waited=state.waited + dt, mu_variance=variance)
        # Between samples there is no time to lane crossing.
        return held, self._estimate(held, jnp.full(2, jnp.nan), jnp.nan)

    def open(self, state: PathState) -> PathState:
        return state._replace(mu_variance=jnp.full_like(state.mu_variance, self.prior_mu**2))

    def step(self, state: PathState, sample: Sample) -> tuple[PathState, Estimate]:
        dt = jnp.minimum(state.waited, _LONGEST)
        anew = state.waited > _LONGEST
        omega = (sample["omega_fl"] + sample["omega_fr"]) / 2
        torque = (sample["torque_fl"] + sample["torque_fr"]) / 2
        turned = wrapped(sample["road_heading"] - state.inputs["road_heading"])
        bend = jnp.where(anew, 0.0, turned / jnp.maximum(dt, 1e-3))
        aside = wrapped(sample["heading"] - sample["road_heading"])
        # The motion initialised from this sample; the knowledge of the tires is kept.
        motion = jnp.stack([sample["offset"], sample["v"] * aside, aside, sample["yaw_rate"]])
        began = state._replace(
            z=jnp.concatenate([motion, state.z[4:]]),
            covariance=self._first().at[4:, 4:].set(state.covariance[4:, 4:]),
            observer=Observer(omega, torque / self.radius),
            rls=WheelRls(omega, torque / self.radius, self._widest()),
        )
        wheel = (omega, torque, dt, self.radius, self.wheel_inertia)
        observer = state.observer.after(*wheel, self.pole)
        rls = state.rls.after(*wheel, self.memory, self.omega_std)
        rise = jnp.stack([observer.force - state.observer.force, rls.force - state.rls.force])
        moved = self._corrected(self._predicted(state, dt, bend), sample)
        rates = rise / jnp.maximum(dt, 1e-3)
        moved = moved._replace(observer=observer, rls=rls, rates=rates)
        state = choose(anew, began, moved)
        state, surprise = self._with_friction(state, sample, omega)

        def crossing(z: Float[Array, "6"]) -> Number:
            a, drive = self._lane_rates(z, sample["steering"], sample["v"], bend)
            return lane_crossing(z[:4], a, drive, self.lane, self.horizon)

        time, slope = jax.value_and_grad(crossing)(state.z)
        tlc = jnp.stack([time, jnp.sqrt(slope @ state.covariance @ slope)])
        kept = {name: sample[name] for name in state.inputs}
        state = state._replace(inputs=kept, waited=jnp.zeros(()))
        return state, self._estimate(state, tlc, jnp.where(anew, jnp.nan, surprise))

    def _first(self) -> Float[Array, "6 6"]:
        return jnp.diag(floats(*_FIRST, *[self.prior_stiffness] * 2) ** 2)

    def _widest(self) -> Number:
        return jnp.asarray(self.mass * GRAVITY, float) ** 2

    def stiffness(self, z: Float[Array, "6"]) -> Float[Array, "2"]:
        """C_f and C_r [N/rad] of the axles, of a state's z (6,)."""
        loads = self.loads
        expected = jnp.stack([self.stiffness_f * loads[0], self.stiffness_r * loads[1]])
        return expected * jnp.exp(z[4:])

    def _lane_rates(
        self, z: Float[Array, "6"], steering: Number, v: Number, bend: Number
    ) -> tuple[Float[Array, "4 4"], Float[Array, "4"]]:
        """A (4, 4) and the terms of the inputs (4,) of the bicycle with stiffness of z."""
        c_f, c_r = self.stiffness(z)
        a, steered, bent = bicycle(c_f, c_r, self.mass, self.yaw_inertia, self.l_f, self.l_r, v)
        return a, steered * steering + bent * bend

    def _predicted(self, state: PathState, dt: Number, bend: Number) -> PathState:
        steering, v = state.inputs["steering"], jnp.maximum(state.inputs["v"], 0.5)

        def ahead(z: Float[Array, "6"]) -> Float[Array, "6"]:
            a, drive = self._lane_rates(z, steering, v, bend)
            half = z[:4] + dt / 2 * (a @ z[:4] + drive)
            return z.at[:4].add(dt * (a @ half + drive))

        slope = jax.jacfwd(ahead)(state.z)
        q, c = self.disturbance**2, self.drift_stiffness**2
        turning = q * (self.mass * self.l_f / self.yaw_inertia) ** 2
        noise = dt * jnp.diag(floats(0.0, q, 0.0, turning, c, c))
        covariance = slope @ state.covariance @ slope.T + noise
        return state._replace(z=ahead(state.z), covariance=covariance)

    def _corrected(self, state: PathState, sample: Sample) -> PathState:
        """Correct the state by the driven path."""
        aside = wrapped(sample["heading"] - sample["road_heading"])
        seen = jnp.stack([sample["offset"], aside, sample["yaw_rate"]])
        rows = jnp.eye(6)[jnp.array([0, 2, 3])]
        noise = jnp.diag(floats(self.gps_std, self.heading_std, self.gyro_std) ** 2)
        error = seen - rows @ state.z
        z, covariance = kalman_update(state.z, state.covariance, rows, error, noise)
        return state._replace(z=z, covariance=covariance)

    def _with_friction(
        self, state: PathState, sample: Sample, omega: Number
    ) -> tuple[PathState, Number]:
        """ln mu after one sample of the forces of the front axle, S(21)."""
        v, force = sample["v"], 2 * state.observer.force
        load = self.loads[0] - self.height / self.base * self.mass * sample["a_x"]
        across = self.mass * sample["a_y"] * self.l_r / self.base
        sigma = clipped(omega, v, self.radius)
        v_y = state.z[1] - v * state.z[2]
        angle, _ = axle_angles(v, v_y, state.z[3], sample["steering"], self.l_f, self.l_r)

        def shares(log_mu: Number) -> Float[Array, "2"]:
            return jnp.stack(brush_share(sigma, angle, self.stiffness_f, jnp.exp(log_mu)))

        error = jnp.stack([force, across]) / load - shares(state.log_mu)
        slope = jax.jacfwd(shares)(state.log_mu)
        noise = self.force_noise**2
        held = state.mu_variance
        size = slope @ slope
        change = held * (slope @ error) / (held * size + noise)
        change = jnp.clip(change, -_FARTHEST, _FARTHEST)
        log_mu = state.log_mu + change
        used = jnp.hypot(force, across) / (jnp.exp(log_mu) * load)
        after = state._replace(
            log_mu=log_mu, mu_variance=held * noise / (held * size + noise), used=used
        )
        along = slope @ error / jnp.sqrt(size * (noise + held * size) + 1e-20)
        return after, along

    def _estimate(self, state: PathState, tlc: Float[Array, "2"], surprise: Scalar) -> Estimate:
        mu, mu_std = jnp.exp(state.log_mu), jnp.sqrt(state.mu_variance)
        stiffness = self.stiffness(state.z)
        spread = jnp.sqrt(jnp.diag(state.covariance))[4:]
        stds = self.omega_std, self.torque_std
        wheel = self.radius, self.wheel_inertia, self.pole
        # The observed force is the mean of two wheels with independent noise.
        observed = jnp.sqrt(2.0) * observer_std(*stds, _USUAL, *wheel)
        # Both estimators lag a rising force by a known time.
        late = 2 * jnp.abs(state.rates) * jnp.stack([2 / self.pole, self.memory])
        forces = 2 * jnp.stack([state.observer.force, state.rls.force])
        of_torque = self.torque_std**2 * _USUAL / self.memory / self.radius**2
        fitted = jnp.sqrt(2 * state.rls.spread + of_torque)
        observed, fitted = jnp.hypot(jnp.stack([observed, fitted]), late)
        value = jnp.stack([mu, *stiffness, *forces, state.used, tlc[0]])
        std = jnp.stack(
            [mu * mu_std, *(stiffness * spread), observed, fitted, state.used * mu_std, tlc[1]]
        )
        flag = flag_of((state.used > self.warn, Flag.NEAR_LIMIT))
        return Estimate(value, std, flag, jnp.asarray(surprise))
