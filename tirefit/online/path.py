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
from tirefit.online import base, vehicle
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
        """The observer after ``dt`` [s] with a torque [N m], corrected by a wheel speed omega;
        both errors of the discrete loop shrink by exp(-pole dt) per sample, at any dt; radius
        [m] and inertia J [kg m2] of the wheel, pole p [1/s]."""
        lever = radius * dt / inertia
        ahead = self.omega + lever * self.force - dt * torque / inertia
        error = omega - ahead
        keep = jnp.exp(-pole * dt)
        gain = (1 - keep) ** 2 / jnp.maximum(lever, 1e-12)
        return Observer(ahead + (1 - keep * keep) * error, self.force + gain * error)


def observer_std(
    omega_std: float, torque_std: float, dt: Scalar, radius: float, inertia: float, pole: float
) -> Number:
    """Standard deviation [N] of the force of the observer, due to white noise ``omega_std``
    [rad/s], ``torque_std`` [N m] of a sample, ``dt`` [s]; pole dt << 1."""
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


_USUAL = 0.02  # time [s] between samples for which the noise of the forces is stated
_PRIOR_MU, _PRIOR_STIFFNESS = 0.5, 0.3  # relative std of the expected mu and of C_f, C_r
_DRIFT_MU, _DRIFT_STIFFNESS = 0.05, 0.03  # relative random walks of these [1/sqrt(s)]
_DISTURBANCE = 0.2  # unknown lateral acceleration [m/s2/sqrt(Hz)]
_FORCE_NOISE = 0.15  # std of the force over the load, errors of the tire model included
_FIRST = (0.5, 0.5, 0.05, 0.1)
"""Std of the first y [m], dy/dt [m/s], heading [rad] and yaw rate [rad/s]."""


class PathState(NamedTuple):
    """States of the bicycle with ln of C_f, C_r over the expected ones, and their
    covariance; front force; ln mu and its variance; friction used; rates of the forces
    [N/s] by the two estimators; the last inputs; time to lane crossing and its std [s], NaN
    between samples."""

    z: Float[Array, "6"]
    covariance: Float[Array, "6 6"]
    observer: Observer
    rls: WheelRls
    log_mu: Number
    mu_variance: Number
    used: Number
    rates: Float[Array, "2"]
    inputs: dict[str, Number]
    tlc: Float[Array, "2"]


class Path(vehicle.AbstractVehicleMethod):
    """Friction, cornering stiffness and the time to lane crossing."""

    method: ClassVar[base.Method] = base.Method(
        "path", "bicycle along the lane, friction at combined slip, lane crossing",
        ("offset", "heading", "road_heading", "yaw_rate", "a_x", "a_y", "steering", "v",
         "omega_fl", "omega_fr", "torque_fl", "torque_fr"),
        ("mu", "C_f", "C_r", "F_xf", "F_xf_rls", "used", "tlc"),
        "40 to 100 % of the friction; C_f, C_r and tlc of a linear tire, below 50 %",
        "S §3.8",
    )  # fmt: skip

    radius: float = par(0.3, (0.01, 2.0), "m", "rolling radius")
    wheel_inertia: float = par(1.2, (1e-6, 1e3), "kg m2", "of one wheel")
    height: float = par(0.5, (0.0, 5.0), "m", "height of the CG")
    mu: float = base.nominal_friction(0.9)
    gps_std: float = par(0.02, (1e-5, 10.0), "m", "noise of offset")
    heading_std: float = par(0.002, (1e-6, 1.0), "rad", "noise of heading")
    gyro_std: float = par(0.002, (1e-6, 1.0), "rad/s", "of yaw rate")
    omega_std: float = par(0.05, (1e-5, 10.0), "rad/s", "of omega")
    torque_std: float = par(10.0, (0.0, 1e5), "N m", "of torques")
    pole: float = par(40.0, (0.1, 1e3), "1/s", "of the observer")
    memory: float = par(0.1, (1e-3, 10.0), "s", "of the RLS")
    lane: float = par(0.9, (0.05, 20.0), "m", "offset at which the lane is left")
    horizon: float = par(4.0, (0.2, 20.0), "s", "looked ahead")
    warn: float = par(0.85, (0.1, 1.0), "-", "used friction warned of")

    def init(self) -> PathState:
        zero, none = jnp.zeros(()), jnp.full((), jnp.nan)
        inputs = dict.fromkeys(("steering", "v", "road_heading"), zero)
        wheel = Observer(zero, zero), WheelRls(zero, zero, self._widest())
        mu = jnp.log(self.mu), jnp.asarray(_PRIOR_MU**2)
        return PathState(
            jnp.zeros(6), self._first(), *wheel, *mu, none, jnp.zeros(2), inputs,
            jnp.full(2, jnp.nan),
        )  # fmt: skip

    def wait(self, state: PathState, dt: Number, steps: Number) -> PathState:
        variance = jnp.minimum(state.mu_variance + _DRIFT_MU**2 * dt, _PRIOR_MU**2)
        return state._replace(mu_variance=variance, tlc=jnp.full(2, jnp.nan))

    def open(self, state: PathState) -> PathState:
        return state._replace(mu_variance=jnp.full_like(state.mu_variance, _PRIOR_MU**2))

    def update(self, state: PathState, sample: base.Sample) -> base.Updated:
        dt, anew = jnp.minimum(sample["dt"], base.LONGEST), sample["dt"] > base.LONGEST
        omega = (sample["omega_fl"] + sample["omega_fr"]) / 2
        torque = (sample["torque_fl"] + sample["torque_fr"]) / 2
        turned = vehicle.wrapped(sample["road_heading"] - state.inputs["road_heading"])
        bend = jnp.where(anew, 0.0, turned / jnp.maximum(dt, 1e-3))
        aside = vehicle.wrapped(sample["heading"] - sample["road_heading"])
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
        state, surprise = self._with_friction(base.choose(anew, began, moved), sample, omega)

        def crossing(z: Float[Array, "6"]) -> Number:
            a, drive = self._lane_rates(z, sample["steering"], sample["v"], bend)
            return lane_crossing(z[:4], a, drive, self.lane, self.horizon)

        time, slope = jax.value_and_grad(crossing)(state.z)
        tlc = jnp.stack([time, jnp.sqrt(slope @ state.covariance @ slope)])
        state = state._replace(inputs={name: sample[name] for name in state.inputs}, tlc=tlc)
        return state, jnp.zeros((), int), jnp.where(anew, jnp.nan, surprise)

    def _first(self) -> Float[Array, "6 6"]:
        return jnp.diag(base.floats(*_FIRST, *[_PRIOR_STIFFNESS] * 2) ** 2)

    def _widest(self) -> Number:
        return jnp.asarray(self.mass * vehicle.GRAVITY, float) ** 2

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

        q, c = _DISTURBANCE**2, _DRIFT_STIFFNESS**2
        turning = q * (self.mass * self.l_f / self.yaw_inertia) ** 2
        noise = dt * jnp.diag(base.floats(0.0, q, 0.0, turning, c, c))
        z, covariance = base.kalman_predict(ahead, state.z, state.covariance, noise)
        return state._replace(z=z, covariance=covariance)

    def _corrected(self, state: PathState, sample: base.Sample) -> PathState:
        """Correct the state by the driven path."""
        aside = vehicle.wrapped(sample["heading"] - sample["road_heading"])
        seen = jnp.stack([sample["offset"], aside, sample["yaw_rate"]])
        rows = jnp.eye(6)[jnp.array([0, 2, 3])]
        noise = jnp.diag(base.floats(self.gps_std, self.heading_std, self.gyro_std) ** 2)
        error = seen - rows @ state.z
        z, covariance, _ = base.kalman_update(state.z, state.covariance, rows, error, noise)
        return state._replace(z=z, covariance=covariance)

    def _with_friction(
        self, state: PathState, sample: base.Sample, omega: Number
    ) -> tuple[PathState, Number]:
        """ln mu after one sample of the forces of the front axle, S(21)."""
        v, force = sample["v"], 2 * state.observer.force
        load = self.loads[0] - self.height / self.base * self.mass * sample["a_x"]
        across = self.mass * sample["a_y"] * self.l_r / self.base
        sigma = vehicle.clipped(omega, v, self.radius)
        v_y = state.z[1] - v * state.z[2]
        angle, _ = vehicle.axle_angles(v, v_y, state.z[3], sample["steering"], self.l_f, self.l_r)

        def shares(log_mu: Array) -> Float[Array, "2"]:
            return jnp.stack(
                vehicle.brush_share(sigma, angle, self.stiffness_f, jnp.exp(log_mu[0]))
            )

        prior, variance = state.log_mu[None], state.mu_variance[None, None]
        error = jnp.stack([force, across]) / load - shares(prior)
        slope = jax.jacfwd(shares)(prior)
        noise = _FORCE_NOISE**2 * jnp.eye(2)
        (moved,), ((after,),), _ = base.kalman_update(prior, variance, slope, error, noise)
        # The largest step of the logarithm of mu per sample.
        log_mu = state.log_mu + jnp.clip(moved - state.log_mu, -0.1, 0.1)
        used = jnp.hypot(force, across) / (jnp.exp(log_mu) * load)
        size = jnp.sum(slope**2)
        along = slope[:, 0] @ error / jnp.sqrt(size * (noise[0, 0] + variance[0, 0] * size) + 1e-20)
        return state._replace(log_mu=log_mu, mu_variance=after, used=used), along

    def estimate(self, state: PathState) -> base.Estimate:
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
        tlc, tlc_std = state.tlc
        value = [mu, *stiffness, *forces, state.used, tlc]
        std = [mu * mu_std, *(stiffness * spread), observed, fitted, state.used * mu_std, tlc_std]
        flag = base.flag_of((state.used > self.warn, base.Flag.NEAR_LIMIT))
        return base.Estimate(jnp.stack(value), jnp.stack(std), flag)
