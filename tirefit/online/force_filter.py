r"""Tire forces of a four-wheel vehicle, then friction by hypotheses, S §3.2 (Ray).

A discretised extended Kalman-Bucy filter estimates the states of the vehicle and the forces

.. math:: x = [v_x, v_y, r, p, \omega_{fl..rr}, F_{x,fl..rr}, F_{y,f}, F_{y,r}],

with the forces as random walks, from :math:`y = [r, \omega_{fl..rr}, a_x, a_y, p]` and
the speed, without which :math:`v_x` would only be integrated. Every :math:`\mu_j` of a
grid is then a hypothesis: the brush gives the forces at the estimated slips, and their
difference from the estimated forces weighs the hypothesis by the covariance of the
filter; mu is the weighted mean. Errors within one time constant of the forces count once.

The surprise, for the detection of changes, is the difference of the forces from those
of the expected mu, along the direction in which another mu would change them. It is
scaled by recent surprises, as the stated errors of model and forces are usually too large.
"""

from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from tirefit.arrays import Number, Scalar
from tirefit.data.table import WHEELS
from tirefit.online import base, vehicle
from tirefit.params import par

HYPOTHESES = tuple(0.05 * k for k in range(2, 27))
"""Friction 0.1 to 1.3 [-], all equally likely at first."""
_MEMORY, _LEAST_SQUARE = 0.9, 0.02
"""Weight of the previous mean square surprise, and its smallest value."""
_FORCE_DRIFT = 0.5  # random walk of the forces, over the load [1/sqrt(s)]
_TIRE_ERROR = 0.03  # error of the tire model, over the load
_CORRELATION = 0.5  # correlation time [s] of errors
_STATES, _FORCES = 8, 6
_TORQUES = tuple(f"torque_{wheel}" for wheel in WHEELS)
_OMEGAS = tuple(f"omega_{wheel}" for wheel in WHEELS)
_SEEN = ("yaw_rate", *_OMEGAS, "a_x", "a_y", "roll_rate", "v")


class ForceState(NamedTuple):
    """States and forces, their covariance, and surprises not yet reported."""

    x: Float[Array, "14"]
    covariance: Float[Array, "14 14"]
    log_weight: Float[Array, " j"]  # ln of the hypotheses' weights
    inputs: Float[Array, "5"]  # the last torques and steering angle
    surprises: Number  # sum over ``seconds``, times dt
    seconds: Number  # [s] not reported yet
    square: Number  # mean square of those reported recently


class ForceFilter(vehicle.AbstractVehicleMethod):
    """All tire forces, and friction by Bayesian selection."""

    method: ClassVar[base.Method] = base.Method(
        "force-filter",
        "Kalman-Bucy filter of tire forces, friction hypotheses",
        (*_SEEN, "steering", *_TORQUES),
        ("mu", "F_x", "F_yf", "F_yr"),
        "40 to 100 % of the friction; below, mu is flagged",
        "S §3.2",
    )

    track: float = par(1.5, (0.05, 5.0), "m", "track")
    height: float = par(0.5, (0.0, 5.0), "m", "height of the CG")
    radius: float = par(0.3, (0.01, 2.0), "m", "rolling radius")
    wheel_inertia: float = par(1.2, (1e-6, 1e3), "kg m2", "of one wheel")
    gyro_std: float = par(0.002, (1e-6, 1.0), "rad/s", "of yaw rate")
    omega_std: float = par(0.05, (1e-5, 10.0), "rad/s", "of omega")
    acceleration_std: float = par(0.05, (1e-4, 10.0), "m/s2", "of a_x and a_y")
    v_std: float = par(0.03, (1e-4, 10.0), "m/s", "of v")

    def init(self) -> ForceState:
        flat = jnp.full(len(HYPOTHESES), -jnp.log(float(len(HYPOTHESES))))
        zero = jnp.zeros(())
        x = jnp.zeros(_STATES + _FORCES).at[0].set(1.0)
        return ForceState(x, self._first(), flat, jnp.zeros(5), zero, zero, jnp.ones(()))

    def wait(self, state: ForceState, dt: Number, steps: Number) -> ForceState:
        keep = jnp.exp(-dt / 10.0)  # time [s] in which the hypotheses become equal again
        mixed = keep * jnp.exp(state.log_weight) + (1 - keep) / len(HYPOTHESES)
        return state._replace(log_weight=jnp.log(mixed))

    def open(self, state: ForceState) -> ForceState:
        return state._replace(log_weight=self.init().log_weight)

    def update(self, state: ForceState, sample: base.Sample) -> base.Updated:
        dt, anew = jnp.minimum(sample["dt"], base.LONGEST), sample["dt"] > base.LONGEST
        inputs = jnp.stack([*(sample[name] for name in _TORQUES), sample["steering"]])
        seen = jnp.stack([sample[name] for name in _SEEN])
        began = self.init()._replace(
            x=self._from(sample), log_weight=state.log_weight, inputs=inputs
        )
        moved = self._predicted(state._replace(inputs=(state.inputs + inputs) / 2), dt)
        moved, _ = self.corrected(moved._replace(inputs=inputs), seen)
        state = base.choose(anew, began, moved)
        log_weight, surprise = self._weighed(state, dt)
        # Report one surprise per time constant: the mean of those within it.
        total, seconds = state.surprises + dt * surprise, state.seconds + dt
        due = (seconds >= _CORRELATION) & ~anew
        mean = total / jnp.maximum(seconds, 1e-9)
        # Limit the effect of a single large surprise on the scale.
        grown = jnp.minimum(mean * mean, 4 * state.square) - state.square
        square = state.square + (1 - _MEMORY) * grown
        weighed = state._replace(
            log_weight=log_weight,
            surprises=jnp.where(due, 0.0, total),
            seconds=jnp.where(due, 0.0, seconds),
            square=jnp.where(due, square, state.square),
        )
        reported = mean / jnp.sqrt(jnp.maximum(state.square, _LEAST_SQUARE))
        surprise = jnp.where(due, reported, jnp.nan)
        return base.choose(anew, state, weighed), jnp.zeros((), int), surprise

    def _first(self) -> Float[Array, "14 14"]:
        load = self.mass * vehicle.GRAVITY
        stds = [0.1, 0.02, 0.05, 0.1, *[0.5] * 4]
        forces = [0.1 * load] * 4 + [0.3 * load] * 2
        return jnp.diag(base.floats(*stds, *forces) ** 2)

    def _from(self, sample: base.Sample) -> Float[Array, "14"]:
        zero = jnp.zeros(())
        motion = [sample["v"], zero, sample["yaw_rate"], sample["roll_rate"]]
        wheels = [sample[name] for name in _OMEGAS]
        side = self.mass * sample["a_y"] / self.base
        forces = [sample[name] / self.radius for name in _TORQUES]
        return jnp.stack([*motion, *wheels, *forces, side * self.l_r, side * self.l_f])

    def pushed(self, x: Float[Array, "14"], steering: Number) -> tuple[Array, Array, Array]:
        """Accelerations a_x, a_y [m/s2] and yaw acceleration [rad/s2] of the forces."""
        along, front, rear = x[8:12], x[12], x[13]
        cos, sin = jnp.cos(steering), jnp.sin(steering)
        braked = along[0] + along[1]
        left = front * cos - braked * sin
        ahead = -braked * cos - front * sin - along[2] - along[3]
        twist = (along[0] - along[1]) * cos + along[2] - along[3]
        turned = self.l_f * left - self.l_r * rear + self.track / 2 * twist
        return ahead / self.mass, (left + rear) / self.mass, turned / self.yaw_inertia

    def rates(self, x: Float[Array, "14"], inputs: Float[Array, "5"]) -> Float[Array, "14"]:
        """Time derivative (14,) of the states; forces and roll rate are random walks."""
        a_x, a_y, turned = self.pushed(x, inputs[4])
        spun = (self.radius * x[8:12] - inputs[:4]) / self.wheel_inertia
        motion = [a_x + x[1] * x[2], a_y - x[0] * x[2], turned, jnp.zeros(())]
        return jnp.concatenate([jnp.stack(motion), spun, jnp.zeros(_FORCES)])

    def seen(self, x: Float[Array, "14"], inputs: Float[Array, "5"]) -> Float[Array, "9"]:
        """The measurements (9,) of a state: y of S, and the speed."""
        a_x, a_y, _ = self.pushed(x, inputs[4])
        return jnp.stack([x[2], *x[4:8], a_x, a_y, x[3], x[0]])

    def _noise(self) -> Float[Array, "9"]:
        """Variances (9,) of the measurements."""
        stds = [self.gyro_std, *[self.omega_std] * 4, *[self.acceleration_std] * 2]
        stds += [self.gyro_std, self.v_std]
        return base.floats(*stds) ** 2

    def _predicted(self, state: ForceState, dt: Number) -> ForceState:
        def ahead(x: Float[Array, "14"]) -> Float[Array, "14"]:
            half = x + dt / 2 * self.rates(x, state.inputs)
            return x + dt * self.rates(half, state.inputs)

        load = _FORCE_DRIFT * self.mass * vehicle.GRAVITY
        # Unknown acceleration [m/s2], of yaw and roll, of the wheels; random walks of forces [N].
        q = [0.02] * 2 + [0.01, 1.0] + [0.1] * 4 + [load / 4] * 4 + [0.15 * load] * 2
        grown = dt * jnp.diag(base.floats(*q) ** 2)
        x, covariance = base.kalman_predict(ahead, state.x, state.covariance, grown)
        return state._replace(x=x, covariance=covariance)

    def corrected(
        self, state: ForceState, seen: Float[Array, "9"]
    ) -> tuple[ForceState, Float[Array, "9"]]:
        """The state corrected by measurements (9,), and their difference from prediction."""
        slope = jax.jacfwd(self.seen)(state.x, state.inputs)
        error = seen - self.seen(state.x, state.inputs)
        noise = jnp.diag(self._noise())
        x, covariance, _ = base.kalman_update(state.x, state.covariance, slope, error, noise)
        return state._replace(x=x, covariance=covariance), error

    def modelled(
        self, x: Float[Array, "14"], inputs: Float[Array, "5"], mu: Scalar
    ) -> Float[Array, "6"]:
        """Forces (6,) [N] of the brush at the slips of a state, for one friction."""
        v_x = jnp.maximum(x[0], 0.5)
        front, rear = vehicle.axle_angles(v_x, x[1], x[2], inputs[4], self.l_f, self.l_r)
        side = self.track / 2 * x[2] * jnp.array([-1.0, 1.0, -1.0, 1.0])
        sigma = vehicle.clipped(x[4:8], v_x + side, self.radius)
        a_x, a_y, _ = self.pushed(x, inputs[4])
        forward = -self.mass * self.height * a_x / self.base
        aside = self.mass * self.height * a_y / self.track / 4
        loads = self.loads
        axles = jnp.stack([loads[0] + forward, loads[1] - forward]) / 2
        shift = 2 * aside * jnp.array([-0.5, 0.5, -0.5, 0.5])
        load = jnp.maximum(jnp.repeat(axles, 2) + shift, 1.0)
        stiffness = base.floats(self.stiffness_f, self.stiffness_r)
        angles = jnp.repeat(jnp.stack([front, rear]), 2)
        along, across = vehicle.brush_share(sigma, angles, jnp.repeat(stiffness, 2), mu)
        y = load * across
        return jnp.concatenate([load * along, jnp.stack([y[0] + y[1], y[2] + y[3]])])

    def _weighed(self, state: ForceState, dt: Number) -> tuple[Float[Array, " j"], Number]:
        """ln of the weights after one sample, and the surprise of the expected mu."""
        load = self.mass * vehicle.GRAVITY
        model = _TIRE_ERROR * load * jnp.array([0.25] * 4 + [0.5] * 2)

        def missed(x: Float[Array, "14"], mu: Scalar) -> Float[Array, "6"]:
            return x[_STATES:] - self.modelled(x, state.inputs, mu)

        def whitened(mu: Scalar) -> tuple[Float[Array, "6"], Float[Array, "6 6"]]:
            """Force errors of mu, whitened, and the root of their covariance."""
            error, slope = missed(state.x, mu), jax.jacfwd(missed)(state.x, mu)
            spread = slope @ state.covariance @ slope.T + jnp.diag(model**2)
            root = jnp.linalg.cholesky(spread)
            return jax.scipy.linalg.solve_triangular(root, error, lower=True), root

        def log_likelihood(mu: Scalar) -> Number:
            z, root = whitened(mu)
            return -0.5 * z @ z - jnp.sum(jnp.log(jnp.diag(root)))

        grid = jnp.array(HYPOTHESES)
        share = jnp.minimum(dt / _CORRELATION, 1.0)
        fresh = share * jax.vmap(log_likelihood)(grid)
        total = state.log_weight + fresh
        expected = jnp.exp(state.log_weight) @ grid
        z, root = whitened(expected)
        by_mu = jax.jacfwd(missed, argnums=1)(state.x, expected)
        way = jax.scipy.linalg.solve_triangular(root, by_mu, lower=True)
        # The direction is undefined if mu + 1 changes less than a standard deviation.
        surprise = way @ z / jnp.maximum(jnp.sqrt(way @ way), 1.0)
        return total - jax.scipy.special.logsumexp(total), surprise

    def estimate(self, state: ForceState) -> base.Estimate:
        grid, weight = jnp.array(HYPOTHESES), jnp.exp(state.log_weight)
        mu = weight @ grid
        # Add the variance of a uniform distribution within a step of the grid.
        step = HYPOTHESES[1] - HYPOTHESES[0]
        mu_std = jnp.sqrt(weight @ (grid - mu) ** 2 + step * step / 12)
        rows = jnp.zeros((3, _STATES + _FORCES)).at[0, 8:12].set(1.0)
        rows = rows.at[1, 12].set(1.0).at[2, 13].set(1.0)
        stds = jnp.sqrt(jnp.diag(rows @ state.covariance @ rows.T))
        value = jnp.concatenate([mu[None], rows @ state.x])
        std = jnp.concatenate([mu_std[None], stds])
        return base.Estimate(value, std)
